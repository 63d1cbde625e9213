"""A controller by the name of its method: designed on the reduced plant, then certified on the full
one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, fields, replace
from typing import Any, cast

from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput, NumericalFailure, invalid
from ambrose.core.presentation import to_plain
from ambrose.judge.as_it_runs import certify_as_it_runs, without_fast_poles
from ambrose.judge.certificate import certify_envelope, certify_on_full_plant, full_plant_margins
from ambrose.judge.envelope import envelope_of
from ambrose.judge.result import Provenance, Synthesis
from ambrose.law.design_problem import (
    LEAST_TOLERANCE,
    apply_delay,
    design_plant,
    design_tolerances,
    open_model,
)
from ambrose.law.weights import machine_weights
from ambrose.machine.file.toml import machine_hash
from ambrose.machine.machine import Machine
from ambrose.machine.messages import suggestion
from ambrose.model.plant import Plant
from ambrose.model.reduce import free_mode_reduction, reduce
from ambrose.registry import registered, resolve
from ambrose.synthesis.envelope_model import envelope_model
from ambrose.synthesis.explanation import explained, why_none
from ambrose.synthesis.fixed_order.polish import JUDGED_ROUNDS, polish_synthesis
from ambrose.synthesis.fixed_order.tuning import tune_controller
from ambrose.synthesis.hinf.synthesis import hinf_synthesis
from ambrose.synthesis.mu.synthesis import mu_synthesis
from ambrose.synthesis.options import DesignOptions
from ambrose.synthesis.order_selection import reduce_order, sampled_sensitivity
from ambrose.synthesis.pid import first_settings, pid_controller, pid_synthesis
from ambrose.synthesis.weight_tuning import direct_gain_mismatch, tune_control_weight

METHODS = ("tuned", "pid", "hinf", "mu", "polish", *registered("method"))
POLISH_ROUNDS = 6
SCALING_ORDER = 1  # d(s) I of first order for mu: 20 -> 24 states on the seal rig, as in P5

Progress = Callable[[str], None]


def methods_for(plant: Plant) -> tuple[str, ...]:
    """What the machine file allows: "tuned" always, "pid" with [controller], "hinf" with [weights],
    mu with [[tolerance]], too.

    "lpv" is asked for by name: it is one controller for all speeds or pressures instead of one for
    the plant's.
    """
    machine = plant.machine
    robust = machine.weights is not None and bool(machine.tolerances)
    possible = {
        "tuned": True,
        "pid": machine.reference is not None,
        "hinf": machine.weights is not None,
        "mu": robust,
        "polish": robust,
    }
    return tuple(method for method in METHODS if possible.get(method))


@names_wrong_types
def design(
    plant: Plant,
    method: str = "tuned",
    options: DesignOptions | None = None,
    *,
    progress: Progress = lambda text: None,
    **choices: Any,
) -> Synthesis:
    """One controller for a full plant.

    method: "tuned" (to the requirements themselves, at all operating points of the plant's machine
    and with the worst corners of the tolerances around each; the others know the plant's point
    alone), "pid" (the machine's reference controller), "hinf" (H-infinity for the nominal plant),
    "mu" (D-K iteration over the machine's tolerances), "polish" (the mu controller at half its
    order, refined for the worst case), "lpv" (scheduled over speed, pressure or both). options: all
    of them, or single ones by name as ``choices``: rate, delay_samples, loss, order, bending_modes,
    match_reference, speeds, speed_rate, pressures, pressure_rate, tolerances, backoff, structure,
    envelope (DesignOptions).

    Where a rate is known (options, else the machine file) the delay of the sampled loop is in the
    design model (not in that of "pid"), polishing is judged round by round by the worst sampled
    sensitivity, and poles beyond half the rate are residualised. The certificate's margins gain
    "full_spectral_abscissa" and "full_sensitivity_peak", recomputed on ``plant``, with a rate also
    "sampled_spectral_abscissa" and "sampled_sensitivity_peak" of the loop as it runs; a controller
    that does not hold one of the two has the status "unstable". The certificate's ``envelope``
    tells the stability at every operating point of the machine, and ``Synthesis.verdict`` where
    "verified" holds. Raises InvalidInput for an unknown method or option or a machine file that
    lacks what the method needs.
    """
    options = _chosen(options, choices)
    if not isinstance(plant, Plant):
        raise invalid(
            "plant", type(plant).__name__, "a Plant", "assemble(machine, point) gives one"
        )
    if method not in METHODS:
        raise invalid(
            "method",
            repr(method),
            f"one of {', '.join(METHODS)}",
            suggestion(str(method).lower(), METHODS),
        )
    if options.order is not None and method not in {"polish", "tuned"}:
        raise invalid(
            "order",
            options.order,
            f"None for method {method!r}",
            "only 'polish' and 'tuned' can choose it",
        )
    if options.structure != "free" and method != "tuned":
        raise invalid(
            "structure",
            repr(options.structure),
            f"'free' for method {method!r}",
            "only 'tuned' can choose it",
        )
    if options.loss is not None and method == "tuned":
        raise invalid(
            "loss",
            options.loss,
            "None for method 'tuned'",
            "give the order, from which it is tuned",
        )
    if options.envelope and method not in {"hinf", "mu"}:
        raise invalid(
            "envelope",
            True,
            f"False for method {method!r}",
            "'hinf' and 'mu' can span it; 'tuned' always does",
        )
    if options.tolerances and method != "lpv":
        raise invalid(
            "tolerances",
            True,
            f"False for method {method!r}",
            "it is for 'lpv'; 'mu', 'polish', 'tuned' always do",
        )
    if options.backoff is not None and method != "lpv":
        raise invalid(
            "backoff", options.backoff, f"None for method {method!r}", "only 'lpv' can choose it"
        )
    for along, ends, rate in options.schedules:
        if method != "lpv":
            name, value = (
                (f"{along.name}s", ends) if ends is not None else (f"{along.name}_rate", rate)
            )
            raise invalid(
                name,
                value,
                f"None for method {method!r}",
                f"only method 'lpv' is scheduled over the {along.name}",
            )
    timing, options = options.timing(plant.machine), options.on(plant.machine)
    try:
        result = (
            pid_synthesis(plant, timing=timing)
            if method == "pid"
            else _designed(plant, method, options, progress)
        )
    except NumericalFailure as error:
        if why := why_none(plant, timing):
            raise NumericalFailure(f"{error}; {why}") from error
        raise
    if options.loss is not None:
        progress("lowering the order")
        result = reduce_order(plant, result, options, progress)
    if method != "pid":
        result = certify_as_it_runs(plant, result, timing)
    result = certify_envelope(envelope_of(plant), result, timing)
    modes = int(result.certificate.margins.get("bending_modes", options.bending_modes or 0))
    result = explained(plant, result, timing, modes)
    return replace(result, provenance=provenance(plant, method, options))


def _designed(plant: Plant, method: str, options: DesignOptions, progress: Progress) -> Synthesis:
    if (place := registered("method").get(method)) is not None:
        return cast(Synthesis, resolve(place).design(plant, options, progress))
    return (
        _tuned(plant, options, progress)
        if method == "tuned"
        else _by_weights(plant, method, options, progress)
    )


def _chosen(options: DesignOptions | None, choices: dict[str, Any]) -> DesignOptions:
    """The options with single ones replaced. Raises InvalidInput for other names."""
    names = [item.name for item in fields(DesignOptions)]
    for name in choices:
        if name not in names:
            raise InvalidInput(f"design has no option {name!r}; {suggestion(name, names)}")
    return replace(options or DesignOptions(), **choices)


def provenance(plant: Plant, method: str, options: DesignOptions) -> Provenance:
    """Machine and settings of a design: its key decides which controller comes out."""
    settings = {
        "method": method,
        **asdict(options.on(plant.machine)),
        "point": asdict(plant.point),
        "plant_states": plant.system.n_states,
    }
    machine = plant.machine
    return Provenance(
        machine=machine.name, machine_hash=machine_hash(machine), settings=to_plain(settings)
    )


def _tuned(plant: Plant, options: DesignOptions, progress: Progress) -> Synthesis:
    """One controller tuned to the requirements at every operating point of the machine, from its
    PID or a first guess.
    """
    machine, timing = plant.machine, options.timing()
    settings = machine.reference or first_settings(machine)
    start = pid_controller(settings, machine)
    result = tune_controller(
        envelope_of(plant),
        settings,
        timing,
        order=options.order,
        structure=options.structure,
        bending_modes=options.bending_modes,
        reference=start if options.match_reference else None,
        progress=progress,
    )
    _, margins, _ = full_plant_margins(plant, result.controller)
    if machine.reference is not None:
        margins["direct_gain_mismatch"] = direct_gain_mismatch(result.controller, start)[0]
    certificate = replace(result.certificate, margins={**result.certificate.margins, **margins})
    return replace(result, certificate=certificate)


def _by_weights(plant: Plant, method: str, options: DesignOptions, progress: Progress) -> Synthesis:
    """H-infinity, mu or polished mu for the machine's weights."""
    machine, weights = plant.machine, machine_weights(plant.machine)
    uncertain = method in {"mu", "polish"}
    wide = design_tolerances(machine) if uncertain else None
    modes, timing = options.bending_modes or 0, options.timing()
    small, lag = reduce(plant, modes), 0.0 if timing is None else timing.lag
    if options.envelope:
        model = apply_delay(
            envelope_model([free_mode_reduction(item, modes) for item in envelope_of(plant)], wide),
            lag,
        )
        uncertain = True
    else:
        model = apply_delay(open_model(small, wide, uncertain), lag)
    synthesis = (
        hinf_synthesis
        if not uncertain
        else lambda problem: mu_synthesis(problem, order=SCALING_ORDER)
    )
    reference = None if machine.reference is None else pid_controller(machine.reference, machine)
    margins: dict[str, float] = {}
    if wide is not None and len(wide) < len(machine.tolerances):
        names = ", ".join(item.parameter for item in wide)
        progress(
            f"designing for {names}; tolerances below {LEAST_TOLERANCE:.0%} are left to "
            "verification"
        )
        margins["design_tolerances"] = float(len(wide))
    if _matched(machine, options):
        if reference is None:
            raise invalid(
                "match_reference",
                True,
                "False without a [controller] table",
                "add the reference controller",
            )
        tuned = tune_control_weight(model, weights, reference, synthesis, uncertain=uncertain)
        progress(
            f"control weight times {tuned.factor:.3g}: direct gains {100 * tuned.mismatch:+.1f} % "
            "of the reference's"
        )
        result, weights = tuned.synthesis, tuned.weights
    else:
        result = synthesis(design_plant(model, weights, uncertain=uncertain))
    if method == "polish":
        start, judge = result, None
        if timing is not None:
            judge = sampled_sensitivity(reduce(plant, modes + 1), timing)
        delay_states = len(machine.axes) if timing is not None else 0
        result = polish_synthesis(
            design_plant(model, weights),
            start.controller,
            order=(start.controller.n_states - delay_states) // 2
            if options.order is None
            else options.order,
            rounds=POLISH_ROUNDS if judge is None else JUDGED_ROUNDS,
            judge=judge,
            progress=progress,
        )
        early = [
            result.stopped_early,
            start.stopped_early and f"its start, by mu: {start.stopped_early}",
        ]
        # or polishing would hide the start's
        result = replace(result, stopped_early="; ".join(filter(None, early)) or None)
    if timing is not None:
        result = without_fast_poles(result, timing, design_plant(small, weights, uncertain=False))
    if reference is not None:  # of the controller that is returned: polishing moves it
        margins["direct_gain_mismatch"] = direct_gain_mismatch(result.controller, reference)[0]
    return certify_on_full_plant(plant, replace(result, weights=weights), margins)


def _matched(machine: Machine, options: DesignOptions) -> bool:
    if options.match_reference is not None:
        return options.match_reference
    return (
        machine.reference is not None
        and machine.weights is not None
        and machine.weights.control_crossover is None
    )
