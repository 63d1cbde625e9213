"""A controller by the name of its method: designed on the reduced plant, then certified on the full one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ambrose.core.checks import invalid
from ambrose.core.statespace import StateSpace
from ambrose.machine.description import Tolerance
from ambrose.machine.machine import Machine
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.synthesis.certificate import certify
from ambrose.synthesis.fixed_order.polish import polish_synthesis
from ambrose.synthesis.hinf.synthesis import hinf_synthesis
from ambrose.synthesis.loop_delay import late
from ambrose.synthesis.lpv.machine import POINTS, design_over_speed
from ambrose.synthesis.mu.synthesis import mu_synthesis
from ambrose.synthesis.pid import pid_controller, pid_synthesis
from ambrose.synthesis.problem import design_plant, open_model
from ambrose.synthesis.result import Status, Synthesis
from ambrose.synthesis.weight_tuning import direct_gain_mismatch, tune_control_weight
from ambrose.synthesis.weights import machine_weights

METHODS = ("pid", "hinf", "mu", "polish", "lpv")
POLISH_ROUNDS = 6
JUDGED_ROUNDS = (
    2  # few long ones leave a smoother loop: sampled S_o on the seal rig 2.73 instead of 2.85, identified 2.65, 3.01
)
LEAST_TOLERANCE = 0.05  # relative; narrower tolerances are left to verification, which takes them all
SCALING_ORDER = 1  # d(s) I of first order for mu: 20 -> 24 states on the seal rig, as in P5

Progress = Callable[[str], None]


def methods_for(plant: Plant) -> tuple[str, ...]:
    """What the machine file allows: "pid" with [controller], "hinf" with [weights], mu with [[tolerance]] as well.

    "lpv" is asked for by name: it is one controller for all speeds instead of one for the plant's.
    """
    machine = plant.machine
    robust = machine.weights is not None and bool(machine.tolerances)
    possible = {"pid": machine.controller is not None, "hinf": machine.weights is not None, "mu": robust, "polish": robust}
    return tuple(method for method in METHODS if possible.get(method))


def design(
    plant: Plant,
    method: str,
    *,
    bending_modes: int = 0,
    match_reference: bool | None = None,
    order: int | None = None,
    delay: float = 0.0,
    judge: Callable[[StateSpace], float] | None = None,
    speeds: tuple[float, float] | None = None,
    progress: Progress = lambda text: None,
) -> Synthesis:
    """One controller for a full plant.

    method: "pid" (the machine's reference controller), "hinf" (H-infinity for the nominal plant), "mu" (D-K iteration over the
    machine's tolerances), "polish" (the mu controller at half its order, refined for the worst case), "lpv" (scheduled over
    ``speeds``, lowest and highest [rad/s]; None: those of the operating points with the plant's seal pressure).
    bending_modes: how many the design model keeps per plane. match_reference: scale the control weight until the direct gains
    below 200 Hz match the reference controller's, so that controllers are comparable (P5); default: where the machine has a
    reference controller and a constant control weight. order: states of the polished controller. delay [s]: of the sampled loop
    it is for (``latency.loop_delay``), inside the design model; certified without it, as ``export.sampling`` verifies the
    sampled loop. judge: decides between the rounds of polishing (``lowering.sampled_sensitivity``; None: its own norm).
    The certificate's margins gain "full_spectral_abscissa" and "full_sensitivity_peak", recomputed on ``plant``; a controller
    that does not hold it has the status "unstable". Raises InvalidInput for an unknown method or a machine file that lacks
    what the method needs.
    """
    if method not in METHODS:
        raise invalid("method", repr(method), f"one of {', '.join(METHODS)}", "choose one of them")
    if order is not None and method != "polish":
        raise invalid("order", order, f"None for method {method!r}", "only method 'polish' can choose it")
    if speeds is not None and method != "lpv":
        raise invalid("speeds", speeds, f"None for method {method!r}", "only method 'lpv' is scheduled over them")
    if method == "pid":
        return pid_synthesis(plant)
    if method == "lpv":
        if delay:
            raise invalid("delay", delay, "0 for method 'lpv'", "choose another method, or sample it much faster")
        grid = None if speeds is None else np.linspace(*speeds, POINTS)
        return design_over_speed(plant, grid, bending_modes=bending_modes, progress=progress)
    machine, weights = plant.machine, machine_weights(plant.machine)
    uncertain = method in {"mu", "polish"}
    small = reduce(plant, bending_modes)
    wide = design_tolerances(machine) if uncertain else None
    model = late(open_model(small, wide, uncertain), delay)
    synthesize = hinf_synthesis if method == "hinf" else lambda problem: mu_synthesis(problem, order=SCALING_ORDER)
    if match_reference is None:
        constant = machine.weights is not None and machine.weights.control_crossover is None
        match_reference = machine.controller is not None and constant
    reference = None if machine.controller is None else pid_controller(machine.controller, machine)
    extra: dict[str, float] = {}
    if wide is not None and len(wide) < len(machine.tolerances):
        names = ", ".join(item.parameter for item in wide)
        progress(f"designing for {names}; tolerances below {LEAST_TOLERANCE:.0%} are left to verification")
        extra["design_tolerances"] = float(len(wide))
    if match_reference:
        if reference is None:
            raise invalid("match_reference", True, "False without a [controller] table", "add the reference controller")
        tuned = tune_control_weight(model, weights, reference, synthesize, uncertain=uncertain)
        progress(f"control weight times {tuned.factor:.3g}: direct gains {100 * tuned.mismatch:+.1f} % of the reference's")
        result, weights = tuned.synthesis, tuned.weights
    else:
        result = synthesize(design_plant(model, weights, uncertain=uncertain))
    if method == "polish":
        rounds = POLISH_ROUNDS if judge is None else JUDGED_ROUNDS
        start = result
        lower = (start.controller.n_states - (len(machine.axes) if delay else 0)) // 2 if order is None else order
        result = polish_synthesis(
            design_plant(model, weights), start.controller, order=lower, rounds=rounds, judge=judge, progress=progress
        )
        early = [result.stopped_early, start.stopped_early and f"its start, by mu: {start.stopped_early}"]
        result = replace(result, stopped_early="; ".join(filter(None, early)) or None)  # or polishing would hide the start's
    if reference is not None:  # of the controller that is returned: polishing moves it
        extra["direct_gain_mismatch"] = direct_gain_mismatch(result.controller, reference)[0]
    return on_full_plant(plant, replace(result, weights=weights), extra)


def design_tolerances(machine: Machine) -> tuple[Tolerance, ...]:
    """The tolerances that a design is made for: all of at least 5 %, or all where none is as wide.

    Every real parameter costs D-K iteration states and time; what identification has narrowed to a percent is within the margin
    that the wide ones force, and verification over all tolerances says whether that is so.
    """
    wide = tuple(item for item in machine.tolerances if item.relative is None or item.relative >= LEAST_TOLERANCE)
    return wide or machine.tolerances


def on_full_plant(plant: Plant, result: Synthesis, extra: dict[str, float]) -> Synthesis:
    """The synthesis with what ``plant`` says about its controller added to the certificate."""
    full = certify(plant, result.controller)
    margins = {
        **result.certificate.margins,
        **extra,
        "full_spectral_abscissa": full.spectral_abscissa,
        "full_sensitivity_peak": full.closed_loop_norm,
    }
    stable = result.certificate.stable and full.stable
    before = result.certificate.plant
    label = before if full.plant in before else f"{before}; {full.plant}"  # a kept controller carries it already
    certificate = replace(result.certificate, stable=stable, margins=margins, plant=label)
    return replace(result, certificate=certificate, status=result.status if stable else Status.UNSTABLE)
