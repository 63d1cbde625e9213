"""Records at several seal pressures, checked: the bearings from those without pressure, then the
seal at every pressure.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.identification.findings import Code, Finding, refuse
from ambrose.identification.loop import identify_loop, usual_unknowns
from ambrose.identification.output_error import closed_loop
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.output_error.magnetic_force import with_magnets_unsure, without_magnets
from ambrose.identification.output_error.problem import FitOptions, build_experiment
from ambrose.identification.parameters import split_timing
from ambrose.identification.result import LoopIdentification
from ambrose.identification.seal.by_frequency import seal_name
from ambrose.identification.seal.by_pressure import (
    COEFFICIENTS,
    ENTRIES,
    SealByPressure,
    SealFit,
    beyond_tolerance,
    check_reach,
    is_of_seal,
    update_but_seal,
)
from ambrose.identification.validation.places import machine_at_load
from ambrose.identification.validation.plausibility import diagnose_outputs
from ambrose.identification.validation.repeatability import simulate_outputs
from ambrose.law.law import LawLike
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY
from ambrose.model.assemble import seal_coefficients
from ambrose.record.record import Record

# Seal coefficients from any excitation, pressure by pressure: the time-domain fit with all else
# known (P5).


# Which entries make a coefficient of the symmetric model: their mean.
_MEMBERS = {
    "K": ("K_xx", "K_yy"),
    "k": ("k_xy", "k_yx"),
    "C": ("C_xx", "C_yy"),
    "c": ("c_xy", "c_yx"),
}


def identify(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    *,
    seal: str | None = None,
    coefficients: Sequence[str] = COEFFICIENTS,
    entries: bool = False,
    together: bool = True,
    start: Mapping[str, float] | None = None,
    progress: Callable[[str], None] = lambda stage: None,
    **options: Any,
) -> SealFit:
    """The coefficients of a seal at every pressure of the records (record.point.seal_pressure):
    impulses, PRBS, chirps, sines.

    machine: with everything else known, its bearings identified without pressure first. controller,
    start and options: as closed_loop.identify. coefficients: those sought, the others stay the
    machine's. entries: all eight of the matrices (excite along both axes). together: one row per
    pressure from all its records; False: a row per record, so that repeats show how far they
    scatter. Without pressure a coefficient may well be zero, so that it is hardly visible is no
    warning there. Raises InvalidInput, and NumericalFailure where a fit does not converge.
    """
    name = seal_name(machine, seal)
    unknown = [c for c in coefficients if c not in COEFFICIENTS]
    if unknown or not coefficients:
        raise invalid(
            "coefficients", list(coefficients), f"some of {', '.join(COEFFICIENTS)}", "correct them"
        )
    if not records:
        raise InvalidInput("no record was given; give at least one per pressure")
    paths = [f"seal.{name}.{part}" for part in (ENTRIES if entries else coefficients)]
    groups: dict[Any, list[Record]] = {}
    for number, record in enumerate(records):
        groups.setdefault((record.point.seal_pressure, 0 if together else number), []).append(
            record
        )
    rows, warnings = [], []
    estimate: ParameterEstimate | None = None
    for (pressure, _), group in sorted(groups.items(), key=lambda item: item[0]):
        progress(f"seal {name} at {pressure:g} Pa, {len(group)} record{'s' * (len(group) > 1)}")
        estimate = _fit_at(
            machine, group, controller, paths, FitOptions(**options), start, estimate
        )
        rows.append(_row(machine, name, estimate, entries))
        kept = [item for item in estimate.warnings if pressure or item.code != Code.HARDLY_VISIBLE]
        warnings += [replace(item, what=f"at {pressure:g} Pa: {item.what}") for item in kept]
    values, deviations, eight, eight_deviations, cosine, correlation = (
        np.array(part) for part in zip(*rows, strict=True)
    )
    pressure = np.array([pressure for pressure, _ in sorted(groups)])
    return SealFit(
        machine.name,
        name,
        pressure,
        np.full(len(rows), np.nan),
        values,
        deviations,
        eight,
        eight_deviations,
        cosine,
        correlation,
        np.zeros((len(rows), 4)),
        "records in the time domain",
        tuple(warnings),
    )


def _fit_at(
    machine: Machine,
    records: list[Record],
    controller: LawLike,
    paths: list[str],
    options: FitOptions,
    start: Mapping[str, float] | None,
    below: ParameterEstimate | None,
) -> ParameterEstimate:
    """The fit from the start asked for, else from the estimate at the pressure below, else from the
    machine's values.

    Near the stability limit a response rings so long that a start far off leads nowhere. The
    magnets are those at the records' currents and place, which the seal's force moves, and what
    their nonlinearity makes is taken out. Raises NumericalFailure.
    """
    machine = machine_at_load(machine, records)
    experiment = build_experiment(machine, records, controller, paths, options)
    starts = [start]
    if below is not None:
        starts.append(dict(zip(below.paths, below.values.tolist(), strict=True)))
    if starts[0] is not None:
        starts.append(None)
    refused: list[InvalidInput] = []
    for begin in starts:
        try:
            estimate = closed_loop.fit(experiment, begin)
        except InvalidInput as error:  # the loop is unstable there, for instance
            refused.append(error)
            continue
        if estimate.converged:
            if options.period is not None:
                return with_magnets_unsure(machine, records, controller, experiment, estimate)
            return without_magnets(machine, records, controller, experiment, estimate)[3]
    if len(refused) == len(starts):
        raise refused[0]
    raise NumericalFailure(
        f"the fit at {records[0].point.seal_pressure:g} Pa did not converge from {len(starts)} "
        "starts; pass start= nearer "
        "to the truth, excite more, or leave out pressures at which the loop hardly is stable"
    )


def _row(
    machine: Machine, name: str, estimate: ParameterEstimate, entries: bool
) -> tuple[np.ndarray, ...]:
    """Values, deviations (4,), entries, their deviations (8,), cosine, correlation (4, 4)."""
    item = next(one for one in machine.seals if one.name == name)
    coefficients = seal_coefficients(item, estimate.point)
    letters = [path.rpartition(".")[2] for path in estimate.paths]
    mix = np.zeros((4, len(letters)))
    for i, letter in enumerate(COEFFICIENTS):
        members = _MEMBERS[letter] if entries else (letter,)
        for member in members:
            if member in letters:
                mix[i, letters.index(member)] = 1 / len(members)
    sought = mix.any(axis=1)
    values = np.where(
        sought, mix @ estimate.values, [getattr(coefficients, letter) for letter in COEFFICIENTS]
    )
    deviations = np.sqrt(np.einsum("ij,jk,ik->i", mix, estimate.covariance, mix))
    eight, eight_deviations = np.full((2, 8), np.nan)
    cosine, correlation = np.full((2, 4, 4), np.nan)
    if entries:
        eight, eight_deviations = estimate.values, estimate.standard_deviations
    else:
        place = np.ix_(*2 * [[COEFFICIENTS.index(letter) for letter in letters]])
        cosine[place], correlation[place] = estimate.column_cosine, estimate.correlation
    return values, deviations, eight, eight_deviations, cosine, correlation


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
    (seal/pipeline.py).

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
    fit = identify(
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
