"""Identification from closed-loop records with its checks: the records before, the result after; a
refusal instead of a silent wrong number.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

from ambrose.core.checks import InvalidInput
from ambrose.identification import youla
from ambrose.identification.data_quality.controller import controller_match, seen_delay
from ambrose.identification.data_quality.diagnosis import diagnose_records
from ambrose.identification.findings import WARNING, Code, Finding, refuse
from ambrose.identification.output_error import closed_loop
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.output_error.magnetic_force import (
    with_magnets_unsure,
    without_magnets,
)
from ambrose.identification.output_error.problem import (
    FitOptions,
    build_experiment,
    deployed_controller,
    modelled_modes,
)
from ambrose.identification.parameters import COVERAGE, plant_at, split_timing
from ambrose.identification.result import LoopIdentification
from ambrose.identification.validation.places import standing
from ambrose.identification.validation.plausibility import (
    chain_lags,
    delay_findings,
    diagnose_fit,
    diagnose_result,
    diagnose_values,
    fit_with_priors,
    prior_of,
    words as priors_in_words,
)
from ambrose.identification.validation.repeatability import of_estimates, simulate_outputs
from ambrose.identification.validation.suspects import (
    Suspect,
    chosen_modes,
    explained,
    is_checked,
    judged,
    rest_of,
    suspects,
)
from ambrose.law.law import LawLike, law_of
from ambrose.machine.description import AMPLIFIER_PARAMETERS
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import CONTROLLER_DELAY, EXCITATION_DELAY, TIMING, parse_parameter
from ambrose.record.record import Record
from ambrose.record.response import Response

_SHORT = 1.0  # [s] of every record on which other delays are tried
Progress = Callable[[str], None]


def identify_loop(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    unknown: Sequence[str],
    *,
    method: str = "closed-loop",
    start: Mapping[str, float] | None = None,
    repeats: bool = False,
    others: Sequence[Record] = (),
    along: bool = False,
    more_modes: bool = False,
    progress: Progress = lambda stage: None,
    options: FitOptions | None = None,
) -> LoopIdentification:
    """``closed_loop.identify`` or ``youla.identify`` between diagnose_records and diagnose_result;
    ``machine`` is not yet updated.

    unknown: none means usual_unknowns. repeats: the records repeat one experiment; each is
    identified alone, too, and a standard deviation below what their scatter allows for is widened
    to it. others: records that are checked with these, as further numbers, and not fitted. along:
    where nothing but the residuals speaks against the result, the machine file's own numbers are
    found along, if that explains them (validation/plausibility.py). more_modes: further bending
    modes than the options' are modelled where the records tell them. Raises
    InvalidInput with every error that was found, each with its evidence and remedy.
    """
    options = options or FitOptions()
    unknown = tuple(unknown) or usual_unknowns(machine, records)
    paths = [path for kind in split_timing(machine, unknown) for path in kind]
    if method == "youla":
        for path in paths:
            if path in TIMING:
                raise InvalidInput(
                    f"{path} as an unknown goes with the method closed-loop; its delay must be "
                    "known here"
                )

    # A delay to be found begins at the one by which the recorded u follows the controller.
    measured_delay = None
    if CONTROLLER_DELAY in paths and CONTROLLER_DELAY not in (start or {}):
        law = deployed_controller(
            plant_at(machine, records[0].point, {}), controller, records[0].dt, 0
        )
        measured_delay = seen_delay(controller_match(machine, records[0], law))
    if measured_delay is not None:
        options = replace(options, computing_delay=measured_delay)
    setup: dict[str, Any] = {
        "bending_modes": options.bending_modes,
        "computing_delay": options.computing_delay,
    }
    progress("checking the records")
    known = {path: value for path, value in (start or {}).items() if path not in TIMING}
    checks = diagnose_records(machine, (*records, *others), controller, start=known, **setup)
    if EXCITATION_DELAY in paths:
        checks = tuple(finding for finding in checks if finding.code != Code.EXCITATION)
    if CONTROLLER_DELAY in paths:  # then the delay is found, not given
        checks = tuple(finding for finding in checks if finding.code != Code.OTHER_DELAY)
    refuse(checks)
    experiment = (
        build_experiment(machine, records, controller, unknown, options)
        if method == "closed-loop"
        else None
    )

    def identify_alone(record: Record, begin: Mapping[str, float]) -> ParameterEstimate:
        assert options is not None  # set above; with the bending modes that were chosen since
        if method == "youla":
            return youla.identify(
                machine, record, controller, unknown, start=begin, **asdict(options)
            ).estimate
        return closed_loop.fit(
            build_experiment(machine, record, controller, unknown, options), begin
        )

    progress(f"identifying {len(paths)} parameters")
    residual = None
    magnets, measured = None, records
    if experiment is not None:
        result = None
        try:
            result = closed_loop.fit(experiment, start)
        except InvalidInput:
            if measured_delay is None or len(paths) == 1:
                raise
        if (
            measured_delay is not None
            and len(paths) > 1
            and (result is None or _unsure(result, records[0].dt))
        ):
            progress(
                "the delay cannot be identified; u follows the controller after "
                f"{measured_delay} samples: taken as its delay"
            )
            paths = [path for path in paths if path != CONTROLLER_DELAY]
            unknown = tuple(paths)
            experiment = build_experiment(machine, records, controller, paths, options)
            result = closed_loop.fit(experiment, start)
        else:
            measured_delay = None
        assert result is not None
        if result.converged and options.period is None:
            progress("taking out what the magnets' nonlinearity makes")
            magnets, records, experiment, result = without_magnets(
                machine, records, controller, experiment, result
            )
        while result.converged and more_modes:
            count = chosen_modes(machine, records, controller, result, options)
            if count <= options.bending_modes:
                break
            progress(f"identifying again with {count} bending modes, which the records tell")
            options = replace(options, bending_modes=count)
            setup["bending_modes"] = count
            experiment = build_experiment(machine, measured, controller, unknown, options)
            begin = dict(zip(result.paths, result.values.tolist(), strict=True))
            result = replace(closed_loop.fit(experiment, begin), start=result.start)
            magnets, records = None, measured
            if result.converged and options.period is None:
                magnets, records, experiment, result = without_magnets(
                    machine, records, controller, experiment, result
                )
        if result.converged and options.period is not None:
            result = with_magnets_unsure(machine, records, controller, experiment, result)
    else:
        residual = youla.identify(
            machine, records, controller, unknown, start=start, **asdict(options)
        )
        result = residual.estimate
        experiment = build_experiment(machine, records, controller, unknown, FitOptions(**setup))
        result = with_magnets_unsure(machine, records, controller, experiment, result)
    progress("checking the result")
    outputs = simulate_outputs(experiment, records, result.values)
    # no longer relevant
    checks = tuple(finding for finding in checks if finding.code != Code.FAR_FROM_START)
    of_values = diagnose_values(machine, result, outputs)
    doubts = diagnose_fit(machine, result, outputs)
    suspected: tuple[Suspect, ...] = ()
    if method == "closed-loop" and (
        result.converged or any(item.code == Code.MISSING_RESPONSE for item in doubts)
    ):
        progress("looking for what the model lacks")
        suspected = suspects(machine, records, controller, result, options)
    doubts = tuple(explained(item, suspected) for item in doubts)
    refuse((*checks, *of_values, *doubts))
    fitted, words = result, ""
    if result.converged and method == "closed-loop":
        result = judged(result, suspected, records[0].dt, rest_of(magnets))
        # what is far, or moved alone, is so beyond the intervals as they are now
        of_values = diagnose_values(machine, result, outputs)
    checks += (*of_values, *doubts)
    if along and method == "closed-loop" and not (result.adequate or checks or repeats):
        progress("finding the machine file's own numbers along")
        further = fit_with_priors(machine, records, controller, fitted, options)
        if further is not None:
            tried, estimate = further
            prior = prior_of(tried, len(fitted.paths))
            lacking = suspects(machine, records, controller, estimate, options, prior)
            estimate = judged(estimate, lacking, records[0].dt, rest_of(magnets))
            simulated = simulate_outputs(tried, records, estimate.values)
            if not estimate.warnings and not diagnose_result(machine, estimate, simulated):
                result, outputs = estimate, simulated
                words = priors_in_words(result, len(fitted.paths))
    if not result.adequate and not any(finding.code == Code.OTHER_DELAY for finding in checks):
        # what was taken out went by the wrong one
        checks += _other_delay(machine, measured, controller, result, options)
    loads = {} if magnets is None else magnets.loads
    stood = standing(machine, measured, result, loads, options.bending_modes)
    if stood is not None:
        result = stood.carried(result)
    done = LoopIdentification(
        given=machine,
        machine=machine,
        result=result,
        checks=checks,
        outputs=outputs,
        controller=controller,
        residual=residual,
        magnets=magnets,
        standing=stood,
        found_along=words,
        notes=_notes(machine, measured, controller, result, setup),
        **setup,
    )
    if measured_delay is not None:
        done = replace(done, seen_delay=measured_delay)
    return _with_repeats(done, records, identify_alone, progress) if repeats else done


def _notes(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    result: ParameterEstimate,
    setup: Mapping[str, Any],
) -> tuple[str, ...]:
    """What was not checked, what the model was given beyond the usual, and what the amplifier's lag
    stands for; a sentence each without its stop.
    """
    notes = []
    blind = [number for number, record in enumerate(records, 1) if not is_checked(machine, record)]
    if blind:
        where = "" if len(blind) == len(records) else f" in record {', '.join(map(str, blind))}"
        unseen = "the controller's file was not checked against what ran"
        if law_of(controller).sample_time is None:
            late = setup["computing_delay"]
            unseen += (
                ", nor how it is sampled: taken as by Tustin's rule at "
                f"{records[0].sample_rate_hz:.6g} Hz, {late:g} sample{'s' * (late != 1)} late"
            )
        notes.append(f"no u_<axis> is recorded{where}: {unseen}. Record u, or be sure of the file")
    notes += modelled_modes(setup["bending_modes"])
    notes += [
        f"{result.paths[k]} is the lag of the whole chain: it takes in filters and delays that the "
        "file does not state"
        for k, _, _ in chain_lags(machine, result)
    ]
    return tuple(notes)


def _unsure(result: ParameterEstimate, dt: float) -> bool:
    """Whether a fitted delay of the controller says nothing: not converged, or known to half a
    sample at most.
    """
    deviation = float(result.standard_deviations[result.paths.index(CONTROLLER_DELAY)])
    return not result.converged or COVERAGE * deviation > 0.5 * dt


def _other_delay(
    machine: Machine,
    records: Sequence[Record],
    controller: LawLike,
    result: ParameterEstimate,
    options: FitOptions,
) -> tuple[Finding, ...]:
    """Whether another delay explains the first second of the records better, all parameters
    free.
    """
    early = [record.between(record.start_time, record.start_time + _SHORT) for record in records]
    begin = dict(zip(result.paths, result.values.tolist(), strict=True))

    def refit(delay: float, *extra: str) -> ParameterEstimate:
        changed = replace(options, computing_delay=delay, period=None)
        return closed_loop.fit(
            build_experiment(machine, early, controller, (*result.paths, *extra), changed), begin
        )

    delay = float(options.computing_delay)
    try:
        refitted = refit(delay)
    except InvalidInput:  # the first second says too little
        return ()
    return delay_findings(
        refitted, delay, records[0].dt, lambda: refit(delay, CONTROLLER_DELAY), refit
    )


def _with_repeats(
    done: LoopIdentification,
    records: Sequence[Record],
    identify_alone: Callable[[Record, Mapping[str, float]], ParameterEstimate],
    progress: Progress,
) -> LoopIdentification:
    """With what every record alone gives, and a covariance as wide as their scatter."""
    begin = dict(zip(done.result.paths, done.result.values.tolist(), strict=True))
    estimates, lost = [], []
    for number, record in enumerate(records, 1):
        progress(f"identifying record {number} of {len(records)} alone")
        estimates.append(identify_alone(record, begin))
        if not estimates[-1].converged:
            remedy = "the scatter of the repeats holds a value that is not the best"
            lost.append(
                Finding(
                    Code.NOT_CONVERGED,
                    WARNING,
                    f"record {number} alone did not converge",
                    remedy=remedy,
                )
            )

    # half_width is that of a 95 % interval, COVERAGE standard deviations
    repeats = of_estimates(estimates)
    result = done.result.widened(repeats.half_width / COVERAGE)
    return replace(
        done, result=replace(result, warnings=(*result.warnings, *lost)), repeats=repeats
    )


def usual_unknowns(machine: Machine, records: Sequence[Record | Response] = ()) -> tuple[str, ...]:
    """What is identified when nothing is named: the machine's uncertain parameters, K_i and K_s of
    every bearing and axis, and the amplifier's lag (its bandwidth, or its natural frequency).

    A seal's coefficient that scales with the pressure is left out where no record was taken under
    pressure; so is one that a table or a geometry gives, for it could not be written back. A seal's
    uncertain pressure, which comes with a record, stands for k, the coefficient that a record tells
    best (C and c are several times less certain).
    """
    paths = [*machine.magnet_paths]
    lag = [name for name in AMPLIFIER_PARAMETERS[machine.amplifier.order] if name != "damping"]
    paths += [f"amplifier.{name}" for name in lag[:1]]
    pressed = any(record.point.seal_pressure for record in records) or not records
    for tolerance in machine.tolerances:
        parameter = parse_parameter(tolerance.parameter)
        if parameter.quantity == "core_scale":
            continue  # its lag resembles the amplifier's and the delay's
        if parameter.quantity == "pressure":
            parameter = parse_parameter(f"seal.{parameter.name}.k")
        if parameter.table == "seal":
            seal = next(item for item in machine.seals if item.name == parameter.name)
            if parameter.quantity in seal.scales_with_pressure and not pressed:
                continue
            tabulated = seal.table is not None and parameter.quantity in dict(seal.table.values)
            if tabulated or seal.geometry is not None:
                continue
        if not any(parameter.overlaps(parse_parameter(path)) for path in paths):
            paths.append(parameter.path)
    if not paths:
        raise InvalidInput(f"machine {machine.name!r} has nothing to identify; name the parameters")
    return tuple(paths)
