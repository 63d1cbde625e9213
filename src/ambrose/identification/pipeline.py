"""Identification with its checks: the records before, the result after; a refusal instead of a silent wrong number."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from typing import Any

import numpy as np

from ambrose import __version__
from ambrose.core.checks import InvalidInput, invalid
from ambrose.identification.data_quality.diagnosis import FAR_FROM_START, OTHER_DELAY, diagnose_records
from ambrose.identification.data_quality.finding import RecordFinding, refuse
from ambrose.identification.output_error.closed_loop import Identification, identify
from ambrose.identification.parameters import split_timing
from ambrose.identification.validation.plausibility import delay_findings, diagnose_result
from ambrose.identification.validation.repeatability import Repeats, of_estimates
from ambrose.identification.validation.simulated_output import Explained, explained
from ambrose.identification.youla import identify as youla
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import AMPLIFIER_PARAMETERS, CONTROLLER_DELAY, TIMING, parse_parameter
from ambrose.machine.record.record import Record
from ambrose.machine.units import DIMENSIONS

METHODS = ("closed-loop", "youla")
_NORMAL = 1.96  # standard deviations of a 95 % interval
_SHORT = 1.0  # [s] of every record on which other delays are tried


@dataclass(frozen=True, slots=True, eq=False)
class CheckedIdentification:
    """A result, the findings that let it pass, and every record beside the model; setup: how it was identified.

    repeats: what every record alone gives, where that was asked for; the result's covariance then allows for their scatter.
    residual: what else the method "youla" found (None: the method was "closed-loop").
    """

    result: Identification
    findings: tuple[RecordFinding, ...]
    pieces: tuple[Explained, ...]
    controller: Any
    computing_delay: float
    bending_modes: int
    repeats: Repeats | None = None
    residual: youla.ResidualIdentification | None = None

    @property
    def method(self) -> str:
        return METHODS[self.residual is not None]

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
    method: str = "closed-loop",
    start: Mapping[str, float] | None = None,
    signals: Sequence[str] | None = None,
    bending_modes: int = 1,
    computing_delay: float = 1,
    repeats: bool = False,
    others: Sequence[Record] = (),
    progress: Callable[[str], None] = lambda stage: None,
) -> CheckedIdentification:
    """``closed_loop.identify`` or ``youla.identify`` between diagnose_records and diagnose_result.

    unknown: none means usual_unknowns. method: "closed-loop" or "youla" (which fits every axis: no signals). repeats: the
    records repeat one experiment; each is identified alone, too, and a standard deviation below what their scatter allows for
    is widened to it. others: records that are checked with these, as further numbers, and not fitted.

    Raises InvalidInput with every error that was found, each with its evidence and remedy.
    """
    records = tuple(records)
    if repeats and len(records) < 2:
        raise invalid("the number of records", len(records), "at least 2 for repeats", "give every repeat as a record")
    unknown = tuple(unknown) or usual_unknowns(machine, records)
    setup: dict[str, Any] = {"bending_modes": bending_modes, "computing_delay": computing_delay}
    paths = [path for kind in split_timing(machine, unknown) for path in kind]
    _check_method(method, paths, signals)
    progress("checking the records")
    known = {path: value for path, value in (start or {}).items() if path not in TIMING}
    findings = diagnose_records(machine, (*records, *others), controller, start=known, **setup)
    if CONTROLLER_DELAY in paths:  # then the delay is found, not given
        findings = tuple(finding for finding in findings if OTHER_DELAY not in finding.what)
    refuse(findings)

    def fitted(chosen: Sequence[Record], start: Mapping[str, float] | None) -> tuple[Identification, Any]:
        if method == "youla":
            found = youla.identify(machine, chosen, controller, unknown, start=start, **setup)
            return found.found, found
        return identify(machine, chosen, controller, unknown, start=start, signals=signals, **setup), None

    progress(f"identifying {len(paths)} parameters")
    result, residual = fitted(records, start)
    progress("checking the result")
    shown = [f"y_{axis}" for axis in machine.axes] if method == "youla" else None
    pieces = explained(machine, records, controller, result, signals=shown, **setup)
    findings = tuple(finding for finding in findings if finding.what != FAR_FROM_START)  # it is no matter any more
    findings += diagnose_result(machine, result, pieces)
    refuse(findings)
    if not all(test.passed for test in result.tests) and not any(OTHER_DELAY in finding.what for finding in findings):
        findings += _other_delay(machine, records, controller, result, signals, setup)
    scatter = None
    if repeats:
        scatter, result = _repeated(records, result, fitted, progress)
    return CheckedIdentification(result, findings, pieces, controller, computing_delay, bending_modes, scatter, residual)


def _check_method(method: str, paths: Sequence[str], signals: Sequence[str] | None) -> None:
    if method not in METHODS:
        raise invalid("method", repr(method), f"one of {', '.join(METHODS)}", "correct it")
    if method == "youla":
        if signals is not None:
            raise InvalidInput("signals go with the method closed-loop; the Youla residual is made of every u_ and y_<axis>")
        for path in paths:
            if path in TIMING:
                raise InvalidInput(f"{path} as an unknown goes with the method closed-loop; its delay must be known here")


def _other_delay(
    machine: Machine,
    records: Sequence[Record],
    controller: Any,
    result: Identification,
    signals: Sequence[str] | None,
    setup: Mapping[str, Any],
) -> tuple[RecordFinding, ...]:
    """Whether another delay explains the first second of the records better, all parameters free."""
    early = [record.between(record.start_time, record.start_time + _SHORT) for record in records]
    begin = dict(zip(result.paths, result.values.tolist(), strict=True))

    def again(delay: float, *more: str) -> Identification:
        other = {**setup, "computing_delay": delay}
        return identify(machine, early, controller, (*result.paths, *more), signals=signals, start=begin, **other)

    delay = float(setup["computing_delay"])
    try:
        given = again(delay)
    except InvalidInput:  # the first second says too little
        return ()
    return delay_findings(given, delay, records[0].dt, lambda: again(delay, CONTROLLER_DELAY), again)


def _repeated(
    records: Sequence[Record],
    result: Identification,
    fitted: Callable[[Sequence[Record], Mapping[str, float] | None], tuple[Identification, Any]],
    progress: Callable[[str], None],
) -> tuple[Repeats, Identification]:
    """What every record alone gives, and the common result with a covariance as wide as their scatter."""
    begin = dict(zip(result.paths, result.values.tolist(), strict=True))
    found, lost = [], []
    for number, record in enumerate(records, 1):
        progress(f"identifying record {number} of {len(records)} alone")
        found.append(fitted([record], begin)[0])
        if not found[-1].converged:
            lost.append(
                f"record {number} alone did not converge; the scatter of the repeats holds a value that is not the best"
            )
    scatter = of_estimates(found)
    wider = np.maximum(scatter.half_width / _NORMAL / result.standard_deviations, 1.0)
    covariance = result.covariance * wider * wider[:, None]
    return scatter, replace(result, covariance=covariance, warnings=(*result.warnings, *lost))


def usual_unknowns(machine: Machine, records: Sequence[Record] = ()) -> tuple[str, ...]:
    """What is identified when nothing is named: the machine's uncertain parameters, K_i and K_s of every bearing and axis, and
    the amplifier's lag (its bandwidth, or its natural frequency).

    A seal's coefficient that scales with the pressure is left out where no record was taken under pressure; so is one that a
    table or a geometry gives, for it could not be written back.
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
            tabulated = seal.table is not None and parameter.quantity in dict(seal.table.values)
            if tabulated or seal.geometry is not None:
                continue
        if not any(parameter.overlaps(parse_parameter(path)) for path in found):
            found.append(tolerance.parameter)
    if not found:
        raise InvalidInput(f"machine {machine.name!r} has nothing to identify; name the parameters")
    return tuple(found)


def as_dict(checked: CheckedIdentification) -> dict[str, Any]:
    """Everything that was found, SI, as plain values for JSON."""
    result = checked.result
    half = _NORMAL * result.standard_deviations
    return {
        "machine": result.machine,
        "method": checked.method,
        "point": {"speed_rad_s": result.point.speed, "seal_pressure_pa": result.point.seal_pressure},
        "good": checked.good,
        "verdict": result.verdict,
        "parameters": [
            {
                "path": path, "unit": _unit(path), "start": start, "value": value, "standard_deviation": deviation,
                "interval_95": [value - width, value + width],
            }
            for path, start, value, deviation, width in zip(
                result.paths, result.start.tolist(), result.values.tolist(), result.standard_deviations.tolist(),
                half.tolist(), strict=True,
            )
        ],
        "correlation": result.correlation.tolist(),
        "column_cosine": result.column_cosine.tolist(),
        "fit_percent": [{"record": n, "signal": name, "fit": float(fit)} for n, name, fit in result.fit],
        "residual_tests": [
            {
                "signal": test.signal, "excitation": test.excitation, "correlation": float(test.correlation),
                "limit": float(test.limit), "lag": int(test.lag), "passed": bool(test.passed),
            }
            for test in result.tests
        ],
        "findings": [
            {"severity": item.severity, "what": item.what, "evidence": item.evidence, "remedy": item.remedy}
            for item in checked.findings
        ],
        "warnings": list(result.warnings),
        "converged": result.converged,
        "iterations": result.iterations,
        "controller_error": None if checked.residual is None else _number(checked.residual.controller_error),
        "repeats": None if checked.repeats is None else _repeats_dict(checked.repeats),
    }  # fmt: skip


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _repeats_dict(repeats: Repeats) -> dict[str, Any]:
    return {
        "count": repeats.count, "values": repeats.values.tolist(), "mean": repeats.mean.tolist(),
        "half_width_95": repeats.half_width.tolist(), "rsd_percent": repeats.rsd.tolist(),
    }  # fmt: skip


def _unit(path: str) -> str:
    return "s" if path in TIMING else DIMENSIONS[parse_parameter(path).dimension].unit


def provenance(checked: CheckedIdentification, records: Sequence[str], controller: str, when: str = "") -> tuple[str, str]:
    """Where the values are from: one line for the machine's ``source``, and a comment to stand above its file.

    records, controller: their files' names; when: ISO date (today if empty).
    """
    result, when = checked.result, when or date.today().isoformat()
    how = "" if checked.residual is None else " by the Youla residual"
    origin = f"{len(result.paths)} parameters identified {when}{how} from {', '.join(records)} with {controller}"
    if not result.converged:
        origin += " (NOT converged)"
    lines = [
        f"Identified {when} by ambrose {__version__} from {', '.join(records)} (controller {controller}),",
        f"at {result.point.speed:g} rad/s and a seal pressure of {result.point.seal_pressure:g} Pa.",
        "The values below are in the file; its tolerances are their 95 % intervals, unless a seal's stated one is wider.",
        f"Verdict: {result.verdict}",
    ]
    lines += [f"Warning: {finding}" for finding in checked.findings]
    lines += [f"Warning: {text}" for text in result.warnings if text != result.verdict]
    for path, value, deviation, start in zip(
        result.paths, result.values, result.standard_deviations, result.start, strict=True
    ):
        lines.append(f"  {path} = {value:.6g} {_unit(path)}, standard deviation {deviation:.2g}, began at {start:.6g}")
    return origin, "".join(f"# {' '.join(line.splitlines())}\n" if line[0] != " " else f"#{line}\n" for line in lines) + "\n"
