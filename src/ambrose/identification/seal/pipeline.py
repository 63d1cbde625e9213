"""Records at several seal pressures, checked: the bearings from those without pressure, then the seal at every pressure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import invalid
from ambrose.identification.data_quality.finding import RecordFinding, refuse
from ambrose.identification.model_updating import identified_machine
from ambrose.identification.output_error.closed_loop import Identification
from ambrose.identification.parameters import split_timing
from ambrose.identification.pipeline import CheckedIdentification, checked_identification, usual_unknowns
from ambrose.identification.seal import time_domain as seal_records
from ambrose.identification.seal.model_updating import identified_seal
from ambrose.identification.seal.result import COEFFICIENTS, SealFit, line
from ambrose.identification.seal.stepped_sine import seal_name
from ambrose.identification.validation.plausibility import diagnose_pieces
from ambrose.identification.validation.simulated_output import explained
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY, TIMING, parse_parameter
from ambrose.machine.record.record import Record

FORMS = ("line", "table")
_LEAST = {"line": 3, "table": 2}  # pressures


@dataclass(frozen=True, slots=True, eq=False)
class SealIdentification:
    """checked: the common fit, from the records without pressure where there are any; fit: the seal's coefficients at every
    pressure, all else as ``checked`` found it; form: how the machine holds them, "line" or "table"."""

    checked: CheckedIdentification
    fit: SealFit
    form: str

    @property
    def good(self) -> bool:
        """Nothing doubtful, in the common fit or at any pressure."""
        return self.checked.good and not self.fit.warnings


def seal_identification(
    machine: Machine,
    records: Sequence[Record],
    controller: Any,
    form: str = "line",
    unknown: Sequence[str] = (),
    *,
    seal: str | None = None,
    start: Mapping[str, float] | None = None,
    signals: Sequence[str] | None = None,
    bending_modes: int = 1,
    computing_delay: float = 1,
    progress: Callable[[str], None] = lambda stage: None,
) -> SealIdentification:
    """Everything but the seal first (``checked_identification``), then the seal at every pressure (``seal_fit.from_records``).

    unknown: what else is sought (none: usual_unknowns). Records without pressure, where there are any, decide it alone, and the
    seal is known there; else all records do, together with the seal's coefficients as they follow the pressure in the machine
    file. form: "line" (regression, three pressures or more) or "table"; seal: its name (None: the only one). Records without
    pressure should come first: their numbers in the findings are then those of the list.
    Raises InvalidInput as its parts do, and NumericalFailure where the fit at a pressure does not converge.
    """
    name = seal_name(machine, seal)
    if form not in FORMS:
        raise invalid("the form of the seal", repr(form), f"one of {', '.join(FORMS)}", "correct it")
    pressures = {record.point.seal_pressure for record in records}
    if len(pressures) < _LEAST[form]:
        remedy = "record at more pressures" + (", or take the form table" if len(pressures) == 2 else "")
        raise invalid(f"the number of seal pressures for a {form}", len(pressures), f"at least {_LEAST[form]}", remedy)
    _check_reach(machine, form, pressures)
    calm = [record for record in records if record.point.seal_pressure == 0]
    rest = [record for record in records if record.point.seal_pressure != 0]
    wanted = unknown or usual_unknowns(machine, calm or records)
    paths = [path for kind in split_timing(machine, wanted) for path in kind]
    others = [path for path in paths if not _of_seal(path, name)]
    if not calm or not others:
        calm, rest, others = list(records), [], [*others, *[f"seal.{name}.{letter}" for letter in COEFFICIENTS]]
    setup: dict[str, Any] = {"signals": signals, "bending_modes": bending_modes, "computing_delay": computing_delay}
    begin = {path: value for path, value in (start or {}).items() if path in others or not _of_seal(path, name)}
    checked = checked_identification(machine, calm, controller, others, others=rest, start=begin, progress=progress, **setup)
    if CONTROLLER_DELAY in checked.result.paths:
        setup["computing_delay"] = float(checked.result.values[checked.result.paths.index(CONTROLLER_DELAY)]) / records[0].dt
    setup["start"] = {path: value for path, value in (start or {}).items() if _of_seal(path, name)} or None
    known = _but_the_seal(machine, checked.result, name)
    fit = seal_records.identify(known, records, controller, seal=name, progress=progress, **setup)
    findings = _missed(known, records, controller, checked.result, fit, setup)
    refuse(findings)
    return SealIdentification(replace(checked, findings=(*checked.findings, *findings)), fit, form)


def _missed(
    known: Machine,
    records: Sequence[Record],
    controller: Any,
    common: Identification,
    fit: SealFit,
    setup: dict[str, Any],
) -> tuple[RecordFinding, ...]:
    """What the model with the seal found at each pressure misses in the records under pressure."""
    signals = setup["signals"] or [f"y_{axis}" for axis in known.axes]
    how = {"signals": signals, "bending_modes": setup["bending_modes"], "computing_delay": setup["computing_delay"]}
    paths = tuple(f"seal.{fit.seal}.{letter}" for letter in COEFFICIENTS)
    findings: list[RecordFinding] = []
    for pressure, values in zip(fit.pressure.tolist(), fit.values, strict=True):
        numbers = [i for i, record in enumerate(records, 1) if record.point.seal_pressure == pressure != 0]
        if numbers:
            result = replace(common, paths=paths, values=values)
            pieces = explained(known, [records[i - 1] for i in numbers], controller, result, **how)
            findings += diagnose_pieces(known, pieces, numbers)
    return tuple(findings)


def _check_reach(machine: Machine, form: str, pressures: set[float]) -> None:
    """A table must reach the operating points, which is known before anything is fitted."""
    for point in machine.operation.points if form == "table" else ():
        if not min(pressures) * (1 - 1e-9) <= point.seal_pressure <= max(pressures) * (1 + 1e-9):
            raise invalid(
                f"operating point {point.label!r}", f"{point.seal_pressure:g} Pa",
                f"within the pressures recorded, {min(pressures):g} to {max(pressures):g} Pa, for a table",
                'record there, or take the form "line"',
            )  # fmt: skip


def beyond(machine: Machine, found: SealIdentification) -> str:
    """A note where the machine has operating points above the highest pressure measured, to which the line goes on; else ""."""
    top, highest = float(found.fit.pressure.max()), max(point.seal_pressure for point in machine.operation.points)
    if highest <= top * (1 + 1e-9):
        return ""
    return f"the lines of seal {found.fit.seal} go on to {highest:g} Pa; the highest pressure measured is {top:g} Pa"


def written_machine(machine: Machine, found: SealIdentification, origin: str = "") -> Machine:
    """The machine with the common fit's values, and the seal over pressure in their place, each with its tolerance."""
    known = _but_the_seal(machine, found.checked.result, found.fit.seal)
    made = identified_seal(known, found.fit, found.form)
    return replace(made, source="; ".join(part for part in (machine.source, origin) if part))


def as_dict(found: SealIdentification) -> dict[str, Any]:
    """The seal by pressure as plain values for JSON, SI; ``deviations`` are standard deviations."""
    fit, lines = found.fit, {}
    if found.form == "line":
        for letter in COEFFICIENTS:
            one = line(fit, letter)
            lines[letter] = {
                "intercept": one.intercept, "slope": one.slope, "scatter": one.scatter,
                "covariance": one.covariance.tolist(), "slope_probability": one.slope_probability,
            }  # fmt: skip
    return {
        "name": fit.seal, "form": found.form, "pressure": fit.pressure.tolist(), "coefficients": list(COEFFICIENTS),
        "values": fit.values.tolist(), "deviations": fit.deviations.tolist(), "correlation": fit.correlation.tolist(),
        "lines": lines or None, "warnings": list(fit.warnings),
    }  # fmt: skip


def comment(machine: Machine, found: SealIdentification) -> str:
    """What the file says above the machine about its seal."""
    fit = found.fit
    how = {"line": "the regression lines over pressure", "table": "the values at these pressures, linear between"}[found.form]
    rows = [f"Seal {fit.seal}, pressure by pressure (standard deviations in brackets); in the file: {how}."]
    for i, pressure in enumerate(fit.pressure):
        texts = [f"{c} {fit.values[i, j]:.4g} ({fit.deviations[i, j]:.2g})" for j, c in enumerate(COEFFICIENTS)]
        rows.append(f"  {pressure:g} Pa: {', '.join(texts)}")
    note = beyond(machine, found)
    rows += [f"Note: {note}."] if note else []
    rows += [f"Warning: {text}" for text in fit.warnings]
    return "".join(f"# {row}\n" for row in rows) + "\n"


def _of_seal(path: str, name: str) -> bool:
    if path in TIMING:
        return False
    parameter = parse_parameter(path)
    return (parameter.table, parameter.name) == ("seal", name) and parameter.quantity in COEFFICIENTS


def _but_the_seal(machine: Machine, result: Identification, name: str) -> Machine:
    """The machine with what was found, but for the seal's coefficients."""
    kept = np.array([i for i, path in enumerate(result.paths) if not _of_seal(path, name)], dtype=int)
    if not len(kept):
        return machine
    part = replace(
        result, paths=tuple(result.paths[i] for i in kept), values=result.values[kept], start=result.start[kept],
        covariance=result.covariance[np.ix_(kept, kept)], correlation=result.correlation[np.ix_(kept, kept)],
        column_cosine=result.column_cosine[np.ix_(kept, kept)],
    )  # fmt: skip
    return identified_machine(machine, part, keep_wider=True)
