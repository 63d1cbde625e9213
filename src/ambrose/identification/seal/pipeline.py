"""Records at several seal pressures, checked: the bearings from those without pressure, then the
seal at every pressure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace

from ambrose.core.checks import invalid
from ambrose.identification.findings import Finding, refuse
from ambrose.identification.loop import identify_loop, usual_unknowns
from ambrose.identification.output_error.problem import FitOptions, build_experiment
from ambrose.identification.parameters import split_timing
from ambrose.identification.result import LoopIdentification
from ambrose.identification.seal import time_domain
from ambrose.identification.seal.by_pressure import (
    SealByPressure,
    beyond_tolerance,
    is_of_seal,
    update_but_seal,
)
from ambrose.identification.seal.model_updating import check_reach
from ambrose.identification.seal.result import COEFFICIENTS, SealFit
from ambrose.identification.seal.stepped_sine import seal_name
from ambrose.identification.validation.plausibility import diagnose_outputs
from ambrose.identification.validation.simulated_output import simulate_outputs
from ambrose.law.law import LawLike
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY
from ambrose.record.record import Record

_LEAST = {"line": 3, "table": 2}  # pressures


def identify_seal(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    form: str = "line",
    unknown: Sequence[str] = (),
    *,
    seal: str | None = None,
    start: Mapping[str, float] | None = None,
    options: FitOptions | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> LoopIdentification:
    """Everything but the seal first (``identify_loop``), then the seal at every pressure
    (seal/time_domain.py).

    unknown: what else is sought (none: usual_unknowns). Records without pressure, where there are
    any, decide it alone, and the seal is known there; else all records do, together with the seal's
    coefficients as they follow the pressure in the machine file. form: "line" (regression, three
    pressures or more) or "table"; seal: its name (None: the only one). Records without pressure
    should come first: their numbers in the findings are then those of the list. Raises InvalidInput
    as its parts do, and NumericalFailure where the fit at a pressure does not converge.
    """
    name, options = seal_name(machine, seal), options or FitOptions()
    if form not in _LEAST:
        raise invalid(
            "the form of the seal", repr(form), f"one of {', '.join(_LEAST)}", "correct it"
        )
    pressures = {record.point.seal_pressure for record in records}
    if len(pressures) < _LEAST[form]:
        remedy = "record at more pressures" + (
            ", or take the form table" if len(pressures) == 2 else ""
        )
        raise invalid(
            f"the number of seal pressures for a {form}",
            len(pressures),
            f"at least {_LEAST[form]}",
            remedy,
        )
    if form == "table":  # known before anything is fitted
        check_reach(machine, name, min(pressures), max(pressures))
    calm = [record for record in records if record.point.seal_pressure == 0]
    rest = [record for record in records if record.point.seal_pressure != 0]
    wanted = unknown or usual_unknowns(machine, calm or records)
    paths = [path for kind in split_timing(machine, wanted) for path in kind]
    others = [path for path in paths if not is_of_seal(path, name)]
    if not calm or not others:
        calm = list(records)
        rest = []
        others = [*others, *[f"seal.{name}.{letter}" for letter in COEFFICIENTS]]
    begin = {
        path: value
        for path, value in (start or {}).items()
        if path in others or not is_of_seal(path, name)
    }
    done = identify_loop(
        machine,
        calm,
        controller,
        others,
        others=rest,
        start=begin,
        progress=progress,
        options=options,
    )
    result = done.result
    if CONTROLLER_DELAY in result.paths:
        options = replace(
            options,
            computing_delay=float(result.values[result.paths.index(CONTROLLER_DELAY)])
            / records[0].dt,
        )
    begin = {path: value for path, value in (start or {}).items() if is_of_seal(path, name)}
    known = update_but_seal(machine, result, name)
    fit = time_domain.identify(
        known,
        records,
        controller,
        seal=name,
        start=begin or None,
        progress=progress,
        **asdict(options),
    )
    checks = (
        *_check_fit(known, records, controller, fit, options),
        *beyond_tolerance(machine, fit),
    )
    refuse(checks)
    highest = max(point.seal_pressure for point in machine.operation.envelope)
    return replace(done, checks=(*done.checks, *checks), seal=SealByPressure(fit, form, highest))


def _check_fit(
    known: Machine,
    records: Sequence[Record],
    controller: LawLike,
    fit: SealFit,
    options: FitOptions,
) -> tuple[Finding, ...]:
    """What the model with the seal identified at each pressure misses in the records under
    pressure.
    """
    paths = tuple(f"seal.{fit.seal}.{letter}" for letter in COEFFICIENTS)
    findings: list[Finding] = []
    for pressure, values in zip(fit.pressure.tolist(), fit.values, strict=True):
        numbers = [
            i for i, record in enumerate(records, 1) if record.point.seal_pressure == pressure != 0
        ]
        if numbers:
            at_pressure = [records[i - 1] for i in numbers]
            outputs = simulate_outputs(
                build_experiment(known, at_pressure, controller, paths, options),
                at_pressure,
                values,
            )
            findings += diagnose_outputs(known, outputs, numbers)
    return tuple(findings)
