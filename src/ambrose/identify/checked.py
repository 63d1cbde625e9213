"""Identification with its checks: the records before, the result after; a refusal instead of a silent wrong number."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ambrose.core.checks import InvalidInput
from ambrose.identify.closed_loop import Identification, identify
from ambrose.identify.explained import Explained, explained
from ambrose.identify.record_checks import diagnose_records
from ambrose.identify.record_finding import RecordFinding, refuse
from ambrose.identify.result_checks import delay_findings, diagnose_result
from ambrose.identify.unknowns import expand
from ambrose.machine.description import Machine
from ambrose.machine.parameters import AMPLIFIER_PARAMETERS, parse_parameter
from ambrose.machine.record import Record

_SHORT = 1.0  # [s] of every record on which other delays are tried


@dataclass(frozen=True, slots=True, eq=False)
class CheckedIdentification:
    """A result, the findings that let it pass, and every record beside the model."""

    result: Identification
    findings: tuple[RecordFinding, ...]
    pieces: tuple[Explained, ...]

    @property
    def good(self) -> bool:
        """Nothing doubtful: neither in the records nor in the result."""
        return not self.findings and not self.result.warnings


def checked_identification(
    machine: Machine,
    records: Sequence[Record],
    controller: Any,
    unknown: Sequence[str] = (),
    *,
    start: Mapping[str, float] | None = None,
    signals: Sequence[str] | None = None,
    bending_modes: int = 1,
    computing_delay: int = 1,
    progress: Callable[[str], None] = lambda stage: None,
) -> CheckedIdentification:
    """``closed_loop.identify`` between diagnose_records and diagnose_result; unknown: none means usual_unknowns.

    Raises InvalidInput with every error that was found, each with its evidence and remedy.
    """
    records = tuple(records)
    unknown = tuple(unknown) or usual_unknowns(machine, records)
    setup: dict[str, Any] = {"bending_modes": bending_modes, "computing_delay": computing_delay}
    paths = expand(machine, unknown)
    progress("checking the records")
    findings = diagnose_records(machine, records, controller, start=start, **setup)
    refuse(findings)
    progress(f"identifying {len(paths)} parameters")
    result = identify(machine, records, controller, unknown, start=start, signals=signals, **setup)
    progress("checking the result")
    pieces = explained(machine, records, controller, result, **setup)
    findings += diagnose_result(machine, result, pieces)
    refuse(findings)
    if not all(test.passed for test in result.tests) and not any("u follows" in finding.what for finding in findings):
        early = [record.between(record.start_time, record.start_time + _SHORT) for record in records]
        setup["start"] = dict(zip(result.paths, result.values.tolist(), strict=True))

        def again(delay: int) -> Identification:
            other = {**setup, "computing_delay": delay}
            return identify(machine, early, controller, result.paths, signals=signals, **other)

        findings += delay_findings(again(computing_delay), computing_delay, again)
    return CheckedIdentification(result, findings, pieces)


def usual_unknowns(machine: Machine, records: Sequence[Record] = ()) -> tuple[str, ...]:
    """What is identified when nothing is named: the machine's uncertain parameters, K_i and K_s of every bearing and axis, and
    the amplifier's lag (its bandwidth, or its natural frequency).

    A seal's coefficient that scales with the pressure is left out where no record was taken under pressure.
    """
    found = [
        f"bearing.{item.name}.{quantity}.{axis}"
        for quantity in ("force_per_current", "negative_stiffness")
        for item in machine.bearings
        for axis in ("zeta", "eta")
    ]
    lag = [name for name in AMPLIFIER_PARAMETERS[machine.amplifier.order] if name != "damping"]
    found += [f"amplifier.{name}" for name in lag[:1]]
    pressed = any(record.point.seal_pressure for record in records) or not records
    for tolerance in machine.tolerances:
        parameter = parse_parameter(tolerance.parameter)
        if parameter.table == "seal":
            seal = next(item for item in machine.seals if item.name == parameter.name)
            if parameter.quantity in seal.scales_with_pressure and not pressed:
                continue
        if not any(parameter.overlaps(parse_parameter(path)) for path in found):
            found.append(tolerance.parameter)
    if not found:
        raise InvalidInput(f"machine {machine.name!r} has nothing to identify; name the parameters")
    return tuple(found)
