"""The lowest order of a controller at a stated loss: reduced in its loop, then polished where
reduction alone goes too far.

Every candidate is judged by the same measure as the controller it comes from, such as the worst
sensitivity of the sampled loop over the tolerances (``sampled_sensitivity``): what a reduced
controller is worth is not read off its Hankel values.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    UnstableSystem,
    check_positive,
    invalid,
)
from ambrose.core.lft import GeneralizedPlant, RealBlock, close_uncertainty
from ambrose.core.statespace import StateSpace
from ambrose.core.worst_case_loop import corners
from ambrose.judge.result import (
    Status,
    Synthesis,
    certify,
    certify_on_full_plant,
    generalized_certificate,
    without_fast_poles,
)
from ambrose.law.design_problem import (
    Weights,
    apply_delay,
    design_plant,
    design_tolerances,
    machine_weights,
    open_model,
)
from ambrose.law.loop import Timing
from ambrose.machine.description import Tolerance
from ambrose.model.assemble import bending_modes_of
from ambrose.model.effects.rotor import free_modes
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import channels, perturbed, reduce
from ambrose.synthesis.fixed_order.job import bending_modes_for
from ambrose.synthesis.fixed_order.polish import JUDGED_ROUNDS, polish_synthesis
from ambrose.synthesis.fixed_order.structure import reduce_controller
from ambrose.synthesis.hinf import hinf_synthesis

# How many bending modes a design model must hold: those that a controller of the machine's weights
# moves.
#
# A mode that the model leaves out does no harm where the loop's gain at its resonance stays small;
# how large that is depends on the controller, which the weights and the plant decide. So the
# nominal H-infinity controller is designed with no bending mode in its model, then with one more at
# a time, and each is judged on the full plant as the loop runs: enough is held where it is stable
# there and its sensitivity is what the design model promises (spillover: Balas 1978).


# of the design model's peak of S_o: by how much more the full plant's may be. Less is what a later
# design of mu or of matched gains moves it by.
_PROMISED = 1.5


def modes_that_matter(
    plant: Plant, weights: Weights, timing: Timing | None, progress: Callable[[str], None]
) -> int:
    """The least number of bending modes per plane with which the nominal H-infinity controller
    holds the full ``plant`` as well as its design model.

    Tried are all below half the sample rate, or where no rate is known, below the frequency up to
    which sensitivity is judged; where none of them does, the number that comes nearest.
    """
    available = bending_modes_of(plant.rotor_model)
    if timing is None:
        most = bending_modes_for(plant)
    else:
        frequencies = free_modes(plant.rotor_model, available).frequencies[4::2]
        most = int((frequencies < np.pi / timing.sample_time).sum())
    tried: dict[int, tuple[float, float]] = {}
    for modes in range(min(most, available) + 1):
        try:
            tried[modes] = _spilled(plant, weights, timing, modes)
        except NumericalFailure:  # such as two modes that cannot be parted: with one more they are
            continue
        abscissa, excess = tried[modes]
        if abscissa < 0 and excess <= _PROMISED:
            break
        words = f"unstable, {abscissa:+.3g} rad/s" if abscissa >= 0 else f"S_o {excess:.3g} times"
        progress(f"{modes} bending modes are too few: {words} on the full plant")
    best = min(tried, key=lambda n: (tried[n][0] >= 0, tried[n][1], tried[n][0]), default=0)
    if best:
        progress(f"design model with {best} bending modes per plane")
    return best


def _spilled(
    plant: Plant, weights: Weights, timing: Timing | None, modes: int
) -> tuple[float, float]:
    """Spectral abscissa [rad/s] of the nominal controller on the full plant, and its peak of S_o
    over that of the design model; both of the loop as it runs.
    """
    small = reduce(plant, modes)
    lag = 0.0 if timing is None else timing.lag
    model = apply_delay(open_model(small, None, False), lag)
    made = hinf_synthesis(design_plant(model, weights, uncertain=False))
    if timing is not None:
        made = without_fast_poles(made, timing, design_plant(small, weights, uncertain=False))
    law = made.controller if timing is None else timing.in_loop(made.controller)
    full = certify(plant, law, margins=False)
    if not full.stable:
        return full.spectral_abscissa, np.inf
    promised = certify(small, law, margins=False)
    return full.spectral_abscissa, full.closed_loop_norm / promised.closed_loop_norm


# Several operating points as one uncertain plant: what changes from point to point becomes real
# parameters.
#
# In common states (``free_mode_reduction``) a plant is one matrix [A B; C D]. The principal
# components of its changes over the points are a few matrices E_j, each of low rank: gyroscopic
# coupling and the seals at their place. The plants lie within M_0 + sum_j delta_j E_j, |delta_j| <=
# 1, so that D-K iteration knows all points at once; it counts combinations, too, that no point has,
# and treats the real delta_j as complex.


# components of at least this share of the largest one; verification on the full plants says what
# the rest does
_KEPT = 0.1
_RANK = 1e-6  # of the largest singular value, below which one is rounding
_NOTHING = 1e-9  # SI; half-width of a relative tolerance where the nominal value is zero


def envelope_model(
    plants: Sequence[Plant], tolerances: Sequence[Tolerance] | None = None
) -> GeneralizedPlant:
    """``open_model`` with the blocks "envelope 1", ... that span the plants, then those of the
    tolerances (None: without).

    plants: reduced in common states, at two operating points at least. Relative tolerances keep
    their share of each point's own value. Raises InvalidInput where the plants do not differ or
    have not the same states.
    """
    models = [
        open_model(
            plant,
            None if tolerances is None else [_held(plant, item) for item in tolerances],
            tolerances is not None,
        )
        for plant in plants
    ]
    first = models[0]
    n = first.system.n_states
    if len({model.system.n_states for model in models}) > 1:
        raise InvalidInput(
            "the plants of the operating points have different numbers of states, as seals with "
            "states under pressure alone "
            "give; design for the points under pressure, or take method 'tuned'"
        )
    whole = np.array(
        [
            np.block([[model.system.A, model.system.B], [model.system.C, model.system.D]])
            for model in models
        ]
    )
    shape = whole.shape[1:]
    middle = (whole.max(axis=0) + whole.min(axis=0)) / 2
    U, size, Vh = np.linalg.svd((whole - middle).reshape(len(whole), -1), full_matrices=False)
    if len(models) < 2 or size[0] <= 1e-12 * np.abs(middle).max():
        raise InvalidInput(
            "the plant is the same at every operating point of the machine; leave envelope out"
        )
    blocks = []
    into = []
    out = []
    for j in np.flatnonzero(size >= _KEPT * size[0]):
        along = U[:, j] * size[j]
        half, centre = np.ptp(along) / 2, (along.max() + along.min()) / 2
        direction = Vh[j].reshape(shape)
        middle = middle + centre * direction
        u, s, vh = np.linalg.svd(half * direction)
        rank = int((s > _RANK * s[0]).sum())
        into.append(u[:, :rank] * np.sqrt(s[:rank]))
        out.append(np.sqrt(s[:rank])[:, None] * vh[:rank])
        blocks.append(RealBlock(f"envelope {j + 1}", rank))
    L, R = np.hstack(into), np.vstack(out)
    w, z = ([f"{letter}_envelope_{k + 1}" for k in range(L.shape[1])] for letter in "wz")
    system = StateSpace(
        middle[:n, :n],
        np.hstack([L[:n], middle[:n, n:]]),
        np.vstack([R[:, :n], middle[n:, :n]]),
        np.block([[np.zeros((len(w), len(w))), R[:, n:]], [L[n:], middle[n:, n:]]]),
        [*w, *first.system.inputs],
        [*z, *first.system.outputs],
    )
    return GeneralizedPlant(
        system, [*w, *first.w], first.u, [*z, *first.z], first.y, [*blocks, *first.blocks]
    )


def _held(plant: Plant, tolerance: Tolerance) -> Tolerance:
    """The tolerance at a plant; a relative one of what is zero there is as good as none."""
    if tolerance.relative is None or any(
        channel.nominal != 0 for channel in channels(plant, tolerance.parameter)
    ):
        return tolerance
    return replace(tolerance, relative=None, absolute=_NOTHING)


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
            "the controller to be lowered is unstable in its loop; give one that stabilises it"
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
        remedy = plant.machine.in_file("add a [[tolerance]]")
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
