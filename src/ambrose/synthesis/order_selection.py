"""The lowest order of a controller at a stated loss: reduced in its loop, then polished where
reduction alone goes too far.

Every candidate is judged by the same measure as the controller it comes from, such as the worst
sensitivity of the sampled loop over the tolerances (``sampled_sensitivity``): what a reduced
controller is worth is not read off its Hankel values.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import NumericalFailure, UnstableSystem, check_positive, invalid
from ambrose.core.lft import GeneralizedPlant, close_uncertainty
from ambrose.core.statespace import StateSpace
from ambrose.core.worst_case.loop import corners
from ambrose.judge.certificate import certify, certify_on_full_plant, generalized_certificate
from ambrose.judge.result import Status, Synthesis
from ambrose.law.design_problem import apply_delay, design_plant, design_tolerances, open_model
from ambrose.law.timing import Timing
from ambrose.law.weights import machine_weights
from ambrose.machine.axial import in_file
from ambrose.model.plant import Plant
from ambrose.model.reduce import reduce
from ambrose.model.uncertainty import perturbed
from ambrose.synthesis.fixed_order.polish import JUDGED_ROUNDS, polish_synthesis
from ambrose.synthesis.fixed_order.reduction import reduce_controller

# of a single parameter; of several their corners and the centre
_LEVELS = (-1.0, -0.5, 0.0, 0.5, 1.0)
# orders in a row beyond the loss: the values come in pairs, and an odd order may be the worse one
_GIVE_UP = 3
Measure = Callable[[StateSpace], float]


@dataclass(frozen=True, slots=True, eq=False)
class LowestOrder:
    """The controller of lowest order whose measure is within the loss; of the start: ``reference``.

    tried: (order, "reduced" or "polished", measure) of all that were looked at, infinite where the
    loop is unstable.
    """

    controller: StateSpace
    measure: float
    reference: float
    tried: tuple[tuple[int, str, float], ...]


def find_lowest_order(
    problem: GeneralizedPlant,
    controller: StateSpace,
    measure: Measure,
    loss: float,
    *,
    polishing: bool = True,
    rounds: int = JUDGED_ROUNDS,
    progress: Callable[[str], None] = lambda text: None,
) -> LowestOrder:
    """Reduce ``controller`` as far as its measure rises by no more than ``loss`` [-] (0.05: 5 %).

    problem: the design problem with its real blocks. measure: StateSpace -> number, less is better,
    infinite where unstable. polishing: orders below the lowest that reduction reaches are tried by
    ``polish``, two states less at a time, with so many ``rounds`` each. Raises InvalidInput, and
    UnstableSystem where the measure of ``controller`` itself is infinite.
    """
    check_positive(loss, "loss", "0.05 allows 5 %", zero_allowed=True)
    reference = measure(controller)
    if not np.isfinite(reference):
        raise UnstableSystem(
            "the controller to be lowered is unstable in its loop; lower one that holds it"
        )
    limit = (1 + loss) * reference
    best, found = controller, reference
    tried: list[tuple[int, str, float]] = [(controller.n_states, "given", reference)]
    models, beyond = _models(problem), 0
    for order in range(controller.n_states - 1, 0, -1):
        candidate = _reduced(models, controller, order)
        if (
            candidate is None
            or candidate.n_states >= best.n_states
            or any(candidate.n_states == row[0] for row in tried)
        ):
            continue
        value = measure(candidate)
        tried.append((candidate.n_states, "reduced", value))
        progress(f"order {candidate.n_states}, reduced: {value:.4g} (at most {limit:.4g})")
        if value <= limit:
            best = candidate
            found = value
            beyond = 0
        else:
            beyond += 1
            if beyond == _GIVE_UP:
                break
    while polishing and best.n_states > 2:
        order = best.n_states - 2
        try:
            polished = polish_synthesis(
                problem, controller, order=order, rounds=rounds, judge=measure, prove=False
            )
            candidate = polished.controller
        except NumericalFailure as error:
            progress(f"order {order}, polished: {error}")
            tried.append((order, "polished", float("inf")))
            break
        value = measure(candidate)
        tried.append((candidate.n_states, "polished", value))
        progress(f"order {candidate.n_states}, polished: {value:.4g} (at most {limit:.4g})")
        if value > limit or candidate.n_states >= best.n_states:
            break
        best, found = candidate, value
    return LowestOrder(best, found, reference, tuple(tried))


def reduce_order(
    plant: Plant,
    result: Synthesis,
    loss: float,
    timing: Timing,
    bending_modes: int,
    progress: Callable[[str], None],
) -> Synthesis:
    """A synthesis at the lowest order for which the sampled loop's worst sensitivity rises by at
    most ``loss`` [-].

    plant: the full one it was made for; timing, bending_modes (per plane in the design model): of
    its design. The weights are the synthesis' (None: the machine's). The certificate is made anew
    on the full plant; margins gain "sampled_sensitivity" and, of the controller before,
    "sampled_sensitivity_given". Raises InvalidInput for a machine without tolerances or weights.
    """
    weights = machine_weights(plant.machine) if result.weights is None else result.weights
    small = reduce(plant, bending_modes)
    problem = design_plant(
        apply_delay(open_model(small, design_tolerances(plant.machine), True), timing.lag), weights
    )
    measure = sampled_sensitivity(reduce(plant, bending_modes + 1), timing)
    lowest = find_lowest_order(problem, result.controller, measure, loss, progress=progress)
    before, after = result.controller.n_states, lowest.controller.n_states
    note = (
        f"lowered from {before} to {after} states: worst sampled sensitivity "
        f"{lowest.reference:.3g} -> {lowest.measure:.3g} "
        f"over the tolerances at {timing.rate:.6g} Hz"
    )
    margins = {"sampled_sensitivity": lowest.measure, "sampled_sensitivity_given": lowest.reference}
    certificate = generalized_certificate(
        design_plant(small, weights, uncertain=False), lowest.controller
    )
    fresh = replace(
        result,
        controller=lowest.controller,
        certificate=certificate,
        status=Status.VERIFIED if certificate.stable else Status.UNSTABLE,
        notes=(*result.notes, note),
        gamma=np.nan,
        filters=None,
    )
    return certify_on_full_plant(plant, fresh, margins)


def sampled_sensitivity(plant: Plant, timing: Timing) -> Measure:
    """A measure: the largest sigma_max(S_o) of the sampled loop over the design's tolerances, at
    corners or five levels.

    plant: reduced, its bending modes kept so that spillover counts. The controller is sampled by
    Tustin's map. Raises InvalidInput for a machine without tolerances.
    """
    names = [tolerance.parameter for tolerance in design_tolerances(plant.machine)]
    if not names:
        remedy = in_file(plant.machine, "add a [[tolerance]]")
        raise invalid("the machine's tolerances", "none", "at least one", remedy)
    points = _points(len(names))
    plants = [perturbed(plant, dict(zip(names, point.tolist(), strict=True))) for point in points]

    def measure(controller: StateSpace) -> float:
        running = timing.in_loop(controller)
        worst = 0.0
        for item in plants:
            worst = max(worst, certify(item, running, margins=False).closed_loop_norm)
            if worst == np.inf:  # unstable, which the poles say at once
                break
        return worst

    return measure


def _models(problem: GeneralizedPlant) -> list[GeneralizedPlant]:
    """The problem's performance at levels or corners of its blocks."""
    names = [block.name for block in problem.blocks]
    n_w = problem.n_w_blocks
    n_z = problem.n_z_blocks
    points = _points(len(names))
    systems = [
        close_uncertainty(problem, dict(zip(names, point.tolist(), strict=True)))
        for point in points
    ]
    return [
        GeneralizedPlant(system, problem.w[n_w:], problem.u, problem.z[n_z:], problem.y)
        for system in systems
    ]


def _points(count: int) -> np.ndarray:
    return (
        np.array(_LEVELS)[:, None]
        if count == 1
        else np.vstack([np.zeros((1, count)), corners(count)])
    )


def _reduced(
    models: Sequence[GeneralizedPlant], controller: StateSpace, order: int
) -> StateSpace | None:
    try:
        return reduce_controller(models, controller, order)[0]
    except NumericalFailure:
        return None
