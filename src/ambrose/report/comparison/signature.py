"""What is signed: machine file and controllers by their hashes, critical speeds, program and date,
and room for names.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import date as calendar

from ambrose.judge.checks import Checks
from ambrose.judge.critical_speeds import critical_speeds
from ambrose.machine.file.toml import machine_hash
from ambrose.machine.machine import Machine
from ambrose.model.separation import LEAST_AMPLIFICATION
from ambrose.report import units
from ambrose.report.page import Cell, Row, Section, Table
from ambrose.rig.candidate import Candidate
from ambrose.version import __version__

# the rotor assembled at every speed where that was done, else frozen at one
_CURVES = ("unbalance.assembled", "unbalance")
_WORDS = (
    "Hashes are SHA-256: of all that is computed with in the machine file, and the digest in each "
    "controller's file. "
    "Critical speeds: peaks of the unbalance response with an amplification factor of "
    f"{LEAST_AMPLIFICATION:g} or more (peak "
    "speed over half-power band, as in API 617), at the operating point where the largest factor "
    "was found."
)


def signature_section(
    machine: Machine,
    candidates: Sequence[Candidate],
    date: str,
    names: Sequence[str] = ("Prepared", "Checked", "Released"),
) -> Section:
    """One table: what was judged, with what and when, and a line for each of ``names``."""
    own = machine_hash(machine)
    rows: list[Row] = [("Machine file", machine.name, _hash(own), "")]
    rows += [(candidate.name, *_controller(candidate, own)) for candidate in candidates]
    rows += [
        ("Program", f"ambrose {__version__}", "", ""),
        ("Date", date or calendar.today().isoformat(), "", ""),
    ]
    rows += [(name, Cell("", "sign"), Cell("", "sign"), "name, date, signature") for name in names]
    columns = ("", "What", "Hash", "Critical speeds (amplification factor)")
    return Section(
        "To be signed", _WORDS, (), (Table("", columns, tuple(rows), "", (16, 26, 28, 30)),)
    )


def _controller(candidate: Candidate, own: str) -> tuple[Cell, Cell, Cell]:
    made = candidate.synthesis
    loop = candidate.timing.partition(":")[0]
    origin = made.provenance.machine_hash
    other = f"designed for another machine file: {origin}" if origin not in {None, own} else ""
    what = Cell(f"method {made.method}, {made.controller.n_states} states, {loop}", detail=other)
    return what, _hash(made.digest), _critical(candidate.checks)


def _hash(digest: str) -> Cell:
    return Cell("", detail=digest)


def _critical(points: Sequence[Checks]) -> Cell:
    """Critical speeds at the operating point that has the largest amplification factor."""
    curves = [
        (checks.label, next((c for name in _CURVES for c in checks.curves if c.name == name), None))
        for checks in points
    ]
    known = [(label, critical_speeds(curve)) for label, curve in curves if curve is not None]
    if not known:
        return Cell("not evaluated", "muted")
    label, found = max(known, key=lambda item: max((factor for _, factor in item[1]), default=0.0))
    if not found:
        return Cell("none: critically damped")
    words = [
        f"{units.join(units.number(speed * units.RPM, 4), 'rpm')} ({units.number(factor, 2)})"
        for speed, factor in found
    ]
    return Cell(", ".join(words), detail=f"at {label}")
