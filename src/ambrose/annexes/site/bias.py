"""K_i and K_s against bias current (paper P2): at every bias from closed-loop records, K_i from
static loads, into the machine.

    done = identify_over_bias(machine, ["6A.h5", "8A.h5"], {6.0: pid_6, 8.0: pid_8},
    loads=["6A-loads.h5"]) done.machine, done.rows, done.findings

A bias that the machine file knows nothing of begins at the square law, k_i in proportion to the
bias, k_s to its square.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.presentation import Presented
from ambrose.identification.findings import WARNING, Code, Finding
from ambrose.identification.parameters import COVERAGE
from ambrose.identification.pipeline import identify
from ambrose.identification.result import Identification
from ambrose.machine.description import BiasPoint, MagneticBearing
from ambrose.machine.machine import Machine
from ambrose.record.files import names_of_files, read_record
from ambrose.record.record import Record

UNKNOWN = ("bearing.*.force_per_current.*", "bearing.*.negative_stiffness.*")
_AGREE = 0.1  # of K_i that static loads and small motion may differ (P2: "within about 10 %")
_SAME = 1e-6  # relative difference of equal bias currents

Given = Record | str | Path


@dataclass(frozen=True, slots=True, eq=False)
class BiasRow:
    """What was found at one bias current [A]: from closed-loop records, from static loads, or
    both.
    """

    bias: float
    dynamic: Identification | None
    static: Identification | None

    def values(self, static: bool = False) -> dict[str, tuple[float, float]]:
        """Path -> value and half-width of its 95 % interval, SI; static: those of the loads."""
        done = self.static if static else self.dynamic
        if done is None:
            return {}
        rows = zip(
            done.result.paths,
            done.result.values.tolist(),
            done.result.standard_deviations.tolist(),
            strict=True,
        )
        return {path: (value, COVERAGE * deviation) for path, value, deviation in rows}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BiasCampaign(Presented):
    """given: the machine as it was; machine: with a row for every bias current; rows by ascending
    bias; findings: what is doubtful, at which bias; names: of the records.
    """

    given: Machine
    machine: Machine
    rows: tuple[BiasRow, ...]
    findings: tuple[Finding, ...]
    names: tuple[str, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.findings

    @property
    def comment(self) -> str:
        """What the file says above the machine."""
        lines = [
            f"K_i and K_s over bias current from {', '.join(self.names) or 'records'}; 95 % "
            "half-widths in brackets."
        ]
        for row in self.rows:
            for method, static in (("small motion", False), ("static loads", True)):
                parts = [
                    f"{path} {value:.5g} ({half:.2g})"
                    for path, (value, half) in row.values(static).items()
                ]
                if parts:
                    lines.append(f"  {row.bias:g} A, {method}: {', '.join(parts)}")
        lines += [f"Doubt: {finding}" for finding in self.findings]
        return "".join(f"# {line}\n" for line in lines)

    def facts(self) -> dict[str, Any]:
        """At which bias currents."""
        return {
            "machine": self.given.name,
            "bias": [f"{row.bias:g} A" for row in self.rows],
            "findings": len(self.findings),
        }

    def to_dict(self) -> dict[str, Any]:
        """Values and intervals at every bias, SI."""
        rows = [
            {
                "bias": row.bias,
                **{
                    name: {
                        path: {"value": v, "half_width_95": h}
                        for path, (v, h) in row.values(static).items()
                    }
                    for name, static in (("small_motion", False), ("static_loads", True))
                },
            }
            for row in self.rows
        ]
        return {
            "machine": self.given.name,
            "rows": rows,
            "findings": [str(f) for f in self.findings],
            "records": list(self.names),
        }


def identify_over_bias(
    machine: Machine,
    records: Sequence[Given] = (),
    controllers: Mapping[float | None, Any] | None = None,
    *,
    loads: Sequence[Given] = (),
    unknown: Sequence[str] = UNKNOWN,
    progress: Callable[[str], None] = lambda stage: None,
    **options: Any,
) -> BiasCampaign:
    """K_i and K_s of every axis at every bias current of the records (record.point.bias_current;
    none: the bearings' own).

    records: closed-loop, with excitations; controllers: bias current [A] -> the one that ran, None
    -> at all others. loads: records of static loads f_<port>, which give K_i alone: written where
    no closed-loop record tells it, else compared. unknown: what is sought at every bias. options:
    of the closed-loop fit (``pipeline.identify``). Raises InvalidInput.
    """
    machine.across_the_shaft("a bias campaign is of the radial magnets")
    if not records and not loads:
        raise InvalidInput(
            "no record was given; record at several bias currents, with excitation or with static "
            "loads"
        )
    own, laws = _own_bias(machine), dict(controllers or {})
    names = names_of_files((*records, *loads))

    # by bias current: (closed-loop records, records of static loads)
    groups: dict[float, tuple[list[Record], list[Record]]] = {}
    for place, several in enumerate((records, loads)):
        for item in several:
            record = read_record(item)
            bias = own if record.point.bias_current is None else record.point.bias_current
            if bias is None:
                raise InvalidInput(
                    "a record does not state its bias current and the bearings have several; state "
                    "bias_current at its point"
                )
            key = next((known for known in groups if abs(known - bias) <= _SAME * bias), bias)
            groups.setdefault(key, ([], []))[place].append(record)
    rows = []
    findings = []
    known = machine
    # the bearings' own bias last: its intervals are the tolerances that the file keeps
    for bias in sorted(groups, key=lambda b: (own is not None and abs(b - own) <= _SAME * own, b)):
        known = with_bias(known, bias)
        moving, loaded = groups[bias]
        dynamic = static = None
        if moving:
            progress(f"{bias:g} A: {len(moving)} closed-loop record{'s' * (len(moving) > 1)}")

            # the controller of this bias; None stands for all others
            law = laws.get(
                next((b for b in laws if b is not None and abs(b - bias) <= _SAME * bias), None)
            )
            if law is None:
                raise invalid(
                    "the controllers",
                    f"none for {bias:g} A",
                    "the one that ran at every bias",
                    "give it",
                )

            # what small motion tells is written into the machine; static loads only
            # where it tells nothing
            dynamic = _identify(bias, known, moving, law, unknown=tuple(unknown), **options)
            known = dynamic.machine
            findings += _at(bias, dynamic)
        if loaded:
            progress(f"{bias:g} A: static loads")
            static = _identify(bias, known, loaded, method="static")
            known = static.machine if dynamic is None else known
            findings += _at(bias, static)
        row = BiasRow(bias, dynamic, static)
        findings += _disagreement(row)
        rows.append(row)
    return BiasCampaign(
        machine, known, tuple(sorted(rows, key=lambda row: row.bias)), tuple(findings), names
    )


def _identify(bias: float, *given: Any, **options: Any) -> Identification:
    try:
        return identify(*given, **options)
    except InvalidInput as error:
        raise InvalidInput(f"at {bias:g} A: {error}") from error


def with_bias(machine: Machine, bias: float) -> Machine:
    """The machine whose bearings have coefficients at a bias current [A]: where the file has none
    there, a row by the square law from the nearest that it has (without iron: k_i in proportion to
    the bias, k_s to its square).
    """
    return replace(machine, bearings=tuple(_begun(item, bias) for item in machine.bearings))


def _begun(bearing: MagneticBearing, bias: float) -> MagneticBearing:
    # the coefficients that the file has, those at the bearing's own bias among them
    rows = list(bearing.measured)
    if bearing.force_per_current is not None and bearing.negative_stiffness is not None:
        rows.append(
            BiasPoint(bearing.bias_current, bearing.force_per_current, bearing.negative_stiffness)
        )
    if not rows or ((bearing.geometry or bearing.magnet) is not None and not bearing.measured):
        return bearing  # its geometry tells

    # between the rows the file interpolates; beyond, one is added
    currents = [row.bias_current for row in rows]
    if min(currents) * (1 - _SAME) <= bias <= max(currents) * (1 + _SAME):
        return bearing

    # square law: k_i by the bias, k_s by its square
    near = min(rows, key=lambda row: abs(row.bias_current - bias))
    share = bias / near.bias_current
    zeta, eta = (share * k for k in near.force_per_current)
    stiff, other = (share**2 * k for k in near.negative_stiffness)
    added = BiasPoint(bias, (zeta, eta), (stiff, other))
    return replace(
        bearing,
        measured=tuple(sorted((*bearing.measured, added), key=lambda row: row.bias_current)),
    )


def _own_bias(machine: Machine) -> float | None:
    own = {bearing.bias_current for bearing in machine.bearings}
    return own.pop() if len(own) == 1 else None


def _at(bias: float, done: Identification) -> list[Finding]:
    return [replace(one, what=f"at {bias:g} A: {one.what}") for one in done.findings]


def _disagreement(row: BiasRow) -> list[Finding]:
    dynamic, found = row.values(), []
    for path, (value, half) in row.values(static=True).items():
        other, other_half = dynamic.get(path, (np.nan, 0.0))

        # 10 %, and the half-widths of both
        if abs(value - other) > _AGREE * abs(other) + np.hypot(half, other_half):
            what = (
                f"at {row.bias:g} A: {path} by static loads is {value / other:.3g} times that of "
                "small motion"
            )
            remedy = "look for another actuator model, a delay, or loads that saturate the iron"
            found.append(Finding(Code.FAR_FROM_FILE, WARNING, what, "more than 10 % apart", remedy))
    return found
