"""Whether a record can be used, and for what: before anybody spends a day on it.

check = check_record("run.h5", "seal-rig")
check.uses                                  # a Use each: usable, and why not
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_path
from ambrose.core.presentation import Presented
from ambrose.core.statespace import poles
from ambrose.identification.data_quality.diagnosis import machine_findings
from ambrose.identification.data_quality.signals import (
    flat_tops,
    point_findings,
    signal_findings,
)
from ambrose.identification.findings import ERROR, WARNING, Code, Finding
from ambrose.identification.one_axis.axis_record import is_text_table, read_axis
from ambrose.identification.one_axis.identify import coarse_steps, dead_channels, identify_generic
from ambrose.machine.criteria import TWO_PI
from ambrose.machine.machine import Machine, point_in_words
from ambrose.machine.units import BULLET
from ambrose.model.assemble import assemble
from ambrose.record.files import names_of_files, read_record
from ambrose.record.record import Record
from ambrose.record.response import QUANTITIES, Response
from ambrose.record.response_files import holds_responses, read_response

# damping ratio of a mode that needs lines of its own, and how far from the file's it may stand
_LIGHT, _NEAR_MODE = 0.03, 0.03
_SHORT = 0.5  # s, below it a record holds few periods of a rigid mode; assumed
_MEASURED = ("y", "u", "i")
# what it can be used for: command, kinds of signal at every axis, at one at least, what is better
_MACHINE_USES = (
    ("the machine's parameters", "identify", "y", "e", "u"),
    ("beyond the model", "identify --method youla", "yue", "", ""),
    ("force per current from loads", "identify --method static", "i", "f", ""),
    ("frequency responses", "frf", "y", "erf", "u"),
    ("a controller retuned", "retune", "y", "e", "u"),
    ("acceptance", "accept", "y", "er", ""),
    ("balancing", "balance", "y", "", "u"),
)
_WORDS = {
    "y": "displacements y_<axis>",
    "u": "controller outputs u_<axis>",
    "e": "excitations e_<axis>",
    "r": "references r_<axis>",
    "f": "forces f_<port>",
    "i": "currents i_<axis>",
}


@dataclass(frozen=True, slots=True)
class Use:
    """One use: what for, by which command, whether the record serves, and why (not)."""

    purpose: str
    command: str
    usable: bool
    reason: str


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class RecordCheck(Presented):
    """What a record holds (words by name), what is wrong with its signals, and what it is good
    for.
    """

    name: str
    contents: tuple[tuple[str, str], ...]
    findings: tuple[Finding, ...]
    uses: tuple[Use, ...]

    @property
    def passed(self) -> bool:
        """Whether it serves for anything, and no signal is useless."""
        wrong = any(finding.severity == ERROR for finding in self.findings)
        return not wrong and any(use.usable for use in self.uses)

    def facts(self) -> dict[str, Any]:
        good = [use.command for use in self.uses if use.usable]
        return {"name": self.name, "usable for": good, "findings": len(self.findings)}

    def to_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "record": self.name,
            "passed": self.passed,
            "contents": dict(self.contents),
            "findings": [
                {"code": str(item.code), "severity": item.severity, "text": str(item)}
                for item in self.findings
            ],
            "uses": [
                {
                    "purpose": use.purpose,
                    "command": use.command,
                    "usable": use.usable,
                    "reason": use.reason,
                }
                for use in self.uses
            ],
        }


def check_record(
    source: Any,
    machine: Machine | None = None,
    *,
    columns: Mapping[str, str] | None = None,
    sample_rate_hz: float | None = None,
    travel: float | None = None,
) -> RecordCheck:
    """Whether a record can be used, and for what.

    source: a path (a record, or a text table of one axis) or a Record. machine: whose record it is,
    None: not known, then the axes are those of its displacements. columns, sample_rate_hz [Hz],
    travel [m]: as for ``identify_generic``. Raises InvalidInput for a file that cannot be read.
    """
    if isinstance(source, Response) or (isinstance(source, str | Path) and holds_responses(source)):
        return _check_responses(source, machine)
    if not isinstance(source, Record) and is_text_table(check_path(source, "record")):
        return _check_table(source, columns, sample_rate_hz, travel)
    record = read_record(source)
    name = "".join(names_of_files([source])) or record.machine
    axes = _axes(record) if machine is None else tuple(machine.axes)
    generic = {"columns": columns, "travel": travel}
    return RecordCheck(
        name,
        (*_contents(record), *_not_checked(record, machine)),
        tuple(_findings(record, machine)),
        (
            *(_use(record, axes, row) for row in _MACHINE_USES),
            _generic_use(source, record, axes, generic),
        ),
    )


# quantities of a closed or open loop, which tell the axis that they are read at
_CLOSED = ("S", "T", "L", "G", "motion")


def _check_responses(source: Any, machine: Machine | None) -> RecordCheck:
    """Frequency responses: what is measured, and that they serve for identification."""
    response = read_response(source)
    name = "".join(names_of_files([source])) or response.machine
    axes = {path.read for path in response.paths if path.quantity in _CLOSED}
    low, high = (response.omega[k] / TWO_PI for k in (0, -1))
    certain = sum(path.variance is not None for path in response.paths)
    contents = (
        ("machine", response.machine),
        ("operating point", point_in_words(response.point)),
        ("frequencies", f"{len(response.omega)}, {low:.4g} to {high:.4g} Hz"),
        *((path.name, QUANTITIES[path.quantity][0]) for path in response.paths),
        ("noise", f"stated for {certain} of {len(response.paths)}"),
    )
    wanted = sorted(axes) if machine is None else machine.axes
    missing = [axis for axis in wanted if axis not in axes]
    lacking = f"nothing is read at {', '.join(missing)}; sweep there, too"
    if not axes:
        lacking = "the controller alone says nothing of the machine; measure S, T, L or the plant"
    other = machine is not None and machine.name != response.machine
    if other:
        lacking = f"they are of {response.machine}, not of {getattr(machine, 'name', '')}"
    good = bool(axes) and not missing and not other
    uses = (
        Use(
            "the machine's parameters and its loop",
            "identify, accept, retune, verify --measured",
            good,
            "with the controller that ran" if good else lacking,
        ),
        Use("the responses themselves", "frf", False, "it makes them, of records in time"),
    )
    findings = list(point_findings(machine, response))
    if machine is not None and good and not findings:
        findings += _far_apart(machine, response)
    return RecordCheck(name, contents, tuple(findings), uses)


def _far_apart(machine: Machine, response: Response) -> Iterator[Finding]:
    """The bending modes of the machine file that no lines resolve: none lie within a half-power
    width of each other near one.
    """
    s, omega = poles(assemble(machine, response.point).system), response.omega
    light = s[(s.imag > omega[0]) & (s.imag < omega[-1]) & (-s.real < _LIGHT * s.imag)]
    middle, spacing = np.sqrt(omega[1:] * omega[:-1]), np.diff(omega)
    far: dict[float, str] = {}
    for pole in light[np.argsort(light.imag)]:
        # the intervals between lines near the mode, that which holds it among them
        near = np.abs(middle / pole.imag - 1) < _NEAR_MODE
        near[np.clip(np.searchsorted(omega, pole.imag) - 1, 0, len(near) - 1)] = True
        least, width = spacing[near].min() / TWO_PI, -2 * pole.real / TWO_PI
        if least > width:
            where = float(f"{pole.imag / TWO_PI:.3g}")  # both planes of a mode are one
            far.setdefault(where, f"{where:.4g} Hz ({least:.2g} Hz, and {width:.2g} Hz wide)")
    if far:
        yield Finding(
            Code.UNCERTAIN_LINES,
            WARNING,
            "lines are farther apart than a bending mode of the machine file is wide",
            ", ".join(far.values()),
            "sweep five lines within the half-power width of each, as measured; one that the "
            "controller damps needs none",
        )


def _check_table(
    source: Any,
    columns: Mapping[str, str] | None,
    sample_rate_hz: float | None,
    travel: float | None,
) -> RecordCheck:
    """A text table of another program: one axis, or nothing before a column map says what is in
    it.
    """
    axis = read_axis(source, columns=dict(columns or {}), sample_rate_hz=sample_rate_hz)
    seconds = len(axis.position) / axis.rate
    contents = (
        ("columns", ", ".join(f"{what} {name}" for what, name in axis.columns)),
        ("samples", f"{len(axis.position)}, {seconds:.6g} s at {axis.rate:.6g} Hz"),
        ("displacement", _range(axis.position, "m")),
        ("drive", _range(axis.drive, axis.unit)),
    )
    options = {"columns": columns, "sample_rate_hz": sample_rate_hz, "travel": travel}
    others = Use(
        "anything of a machine",
        "identify, frf, accept",
        False,
        "a text table names no axes; write it as a record with ambrose convert --columns",
    )
    return RecordCheck(axis.name, contents, (), (_try_generic(source, options), others))


def _try_generic(source: Any, options: Mapping[str, Any]) -> Use:
    """Whether ``identify_generic`` identifies one axis with these keyword arguments: the fit is
    quick, and nothing else tells whether noise drove the loop.
    """
    try:
        done = identify_generic(source, **options)
    except InvalidInput as refusal:
        reason = "; ".join(str(refusal).split(BULLET))
        return Use("one axis, controller unknown", "identify --generic", False, reason)
    doubts = "; ".join(finding.what for finding in done.findings)
    words = f"{done.verdict}: pole {done.pole:.4g} rad/s +- {done.values[0].half_width:.2g}"
    good = done.verdict == "identified"
    return Use(
        "one axis, controller unknown",
        "identify --generic",
        good,
        f"{words}; {doubts}" if doubts else words,
    )


def _generic_use(
    source: Any, record: Record, axes: tuple[str, ...], options: Mapping[str, Any]
) -> Use:
    """As ``_try_generic``; of several axes only where the option ``columns`` names one."""
    if len(axes) > 1 and not options["columns"]:
        reason = (
            f"{len(axes)} axes; name one, such as --displacement y_{axes[0]}; it lacks what "
            "couples them"
        )
        return Use("one axis, controller unknown", "identify --generic", False, reason)
    return _try_generic(source, options)


def _axes(record: Record) -> tuple[str, ...]:
    """The axes whose displacements y_<axis> are recorded."""
    return tuple(name[2:] for name in record.signals if name.startswith("y_"))


def _contents(record: Record) -> tuple[tuple[str, str], ...]:
    """Machine, operating point, samples, then the range of every signal, in words by name."""
    seconds = record.values.shape[1] * record.dt
    words = f"{record.values.shape[1]}, {seconds:.6g} s at {record.sample_rate_hz:.6g} Hz"
    rows = [("machine", record.machine), ("point", point_in_words(record.point))]
    rows += [("samples", words)]
    rows += [
        (name, _range(row, unit))
        for name, unit, row in zip(record.signals, record.units, record.values, strict=True)
    ]
    return tuple(rows)


def _not_checked(record: Record, machine: Machine | None) -> Iterator[tuple[str, str]]:
    """What nothing in the record, or no machine, lets be seen."""
    if machine is None:
        yield "not checked", "whose it is, its limits, channels and sample rate: give the machine"
    elif any(
        all(f"{kind}_{axis}" not in record.signals for kind in kinds)
        for kinds in ("e", "ui")
        for axis in machine.axes
    ):
        yield "not checked", "channels and sample rate against the plant: record e_ and u_ or i_"


def _range(values: np.ndarray, unit: str) -> str:
    return f"{values.min():.4g} to {values.max():.4g} {unit}, rms {values.std():.3g} about its mean"


def _findings(record: Record, machine: Machine | None) -> Iterator[Finding]:
    """What the signals show by themselves; with a machine also its limits."""
    seconds = record.values.shape[1] * record.dt
    if seconds < _SHORT:
        yield Finding(
            Code.NO_RESPONSE,
            WARNING,
            "the record is short",
            f"{seconds:.3g} s contain few periods of the slowest modes",
            "record two seconds and more",
        )
    if machine is not None:
        unknown = [name for name in _axes(record) if name not in machine.axes]
        if unknown:
            yield Finding(
                Code.MIXED_CHANNELS,
                ERROR,
                f"the axes {', '.join(unknown)} are none of the machine's",
                f"it has {', '.join(machine.axes)}",
                "rename the signals, or give the machine that was recorded",
            )
        of_signals = signal_findings(machine, record, 1, excited="")
        yield from of_signals
        if not unknown and not any(item.severity == ERROR for item in of_signals):
            yield from machine_findings(machine, record)
    measured = {
        name: record[name] for name in record.signals if name.partition("_")[0] in _MEASURED
    }
    if machine is None:
        yield from point_findings(None, record)
        yield from dead_channels(measured)
        yield from _clipped(measured)
    yield from coarse_steps({name: row for name, row in measured.items() if np.ptp(row) > 0})


def _clipped(measured: Mapping[str, np.ndarray]) -> Iterator[Finding]:
    for name, values in measured.items():
        count, level = flat_tops(values)
        if count and len(np.unique(values)) > 3:
            yield Finding(
                Code.CLIPPED,
                WARNING,
                f"{name} is clipped",
                f"{count} samples lie at {level:.4g}, in flat tops",
                "reduce the excitation, or widen the range of the sensor or the converter",
            )


def _use(record: Record, axes: tuple[str, ...], row: tuple[str, str, str, str, str]) -> Use:
    """Whether the signals are there; and, for balancing, whether it turns."""
    purpose, command, every, one, better = row
    missing = [
        _WORDS[kind] + (f" ({', '.join(lacking)})" if len(lacking) < len(axes) else "")
        for kind in every
        if (lacking := [axis for axis in axes if not _moves(record, f"{kind}_{axis}")]) or not axes
    ]
    driven = [
        name
        for name in record.signals
        if name[:1] in one and name[1:2] == "_" and not name.startswith("f_magnet_")
    ]
    if one and not any(_moves(record, name) for name in driven):
        what = " or ".join(_WORDS[kind] for kind in one)
        missing.append(f"{what} that {'never change' if driven else 'are not recorded'}")
    if command == "balance" and not record.point.speed:
        missing.append("a speed: it stands still")
    if missing:
        return Use(purpose, command, False, f"it lacks {', '.join(missing)}")
    lacks = [axis for axis in axes if better and not _moves(record, f"{better}_{axis}")]
    return Use(purpose, command, True, f"better with {_WORDS[better]}" if lacks else "")


def _moves(record: Record, name: str) -> bool:
    return name in record.signals and bool(np.ptp(record[name]) > 0)
