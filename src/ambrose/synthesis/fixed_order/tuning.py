"""One controller of fixed order for the whole envelope, tuned to the requirements themselves.

From a start that need not hold every point, a smooth maximum of all ratios of a requirement to its limit (objective.py) is
moved downhill with exact gradients, over the models of all operating points at once, as the loop runs: sampled and late. Rounds
raise the power of the p-norm; after each the frequency grid takes in the loops' resonances and true peaks, for what the grid
does not see gets exploited, and the worst member of the tolerances around every point joins the models (Apkarian & Noll 2006;
Apkarian, Gahinet & Buhr 2014 tune to requirements this way). All rounds are judged on the full plants and on all the members
that were found by the end, and the best is returned.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, NumericalFailure, invalid, named_failure
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace
from ambrose.machine.controller import PidSettings
from ambrose.machine.limits import STATES
from ambrose.machine.machine import Machine
from ambrose.physics.rotor import free_modes
from ambrose.plant.assemble import assemble, bending_modes_of
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce, reduce_from
from ambrose.plant.timing import Timing
from ambrose.plant.uncertainty import perturbed, tolerances_around, with_offsets_of
from ambrose.synthesis.certificate import certify, fastest_pole
from ambrose.synthesis.envelope.between import search
from ambrose.synthesis.fixed_order.aims import Aims, aims_of, highest_verified
from ambrose.synthesis.fixed_order.bank import BANKS, FilterBank, advice, at_limits, filter_bank, first_bank
from ambrose.synthesis.fixed_order.descent import descend
from ambrose.synthesis.fixed_order.loops import LoopModel, loop_model, unwarped, warped
from ambrose.synthesis.fixed_order.members import worst_member
from ambrose.synthesis.fixed_order.objective import Objective, Ratio
from ambrose.synthesis.fixed_order.structure import Groups, Structure, axis_groups, structured
from ambrose.synthesis.pid import pid_controller
from ambrose.synthesis.result import Certificate, Status, Synthesis
from ambrose.synthesis.time_limit import TimeLimit

_POWERS = (10.0, 25.0, 60.0, 120.0, 120.0)
INTERRUPTED = "interrupted"
_AGAIN = 2  # the first of these rounds for a law that was tuned before
_ITERATIONS = 200  # of L-BFGS, a round
_HOLDING = 60  # of L-BFGS, towards a controller that holds all models; so many times at most:
_TRIES = 20
_DECAY = 5.0  # rad/s; slowest pole asked for before the first round
_LOWEST = 1.0  # rad/s, start of the grid
_TUNED, _JUDGED = 22, 80  # points per decade
_AROUND = 15  # points around a peak that is judged
_LAG = 2 * np.pi * 400  # rad/s; appended where the start is too fast for its sample rate
_WEAK = 1e-3  # of the start's gain: states that are added to reach the order
_FASTEST = 3.0  # times the fastest pole of the start, or the grid's end
_STATES_PER_AXIS = 3
_ROUNDING, _DRIFT = 1e-9, 0.1  # rad/s; of an integrator that is set back
_BEYOND = 1.02  # of the fastest pole allowed: where its barrier is infinite
_HEARD, _LISTENED = 0.15, 12  # loop gain of a mode that is kept; modes above the others that are looked at
_BELOW = 0.95  # of half the rate: the fastest pole of a filter bank
Law = StateSpace | PidSettings  # what is tuned: matrices, or the chains of a filter bank


@dataclass(slots=True, eq=False)
class Job:
    """What is tuned, and the models it has collected so far."""

    full: tuple[Plant, ...]
    small: tuple[Plant, ...]
    timing: Timing | None
    aims: Aims
    groups: Groups
    models: list[LoopModel]
    clock: TimeLimit
    say: Callable[[str], None]
    reference: StateSpace | None
    fastest: float  # pole of a filter bank [rad/s]
    structure: str
    extra: list[float] = field(default_factory=list)  # frequencies of true peaks [rad/s]
    members: set[tuple[str, tuple[tuple[str, float], ...]]] = field(default_factory=set)


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    law: Law
    ratios: Mapping[str, Ratio]  # on the models, or on the full plants

    @property
    def worst(self) -> float:
        return max((ratio.value for ratio in self.ratios.values()), default=np.inf)


@named_failure("the tuned controller")
def tune_controller(
    plants: Sequence[Plant],
    start: Law,
    timing: Timing | None = None,
    *,
    order: int | None = None,
    structure: str = "free",
    bending_modes: int | None = None,
    reference: StateSpace | None = None,
    time_limit: float = 120.0,
    progress: Callable[[str], None] | None = None,
) -> Synthesis:
    """The controller that comes nearest to meeting every requirement at every one of ``plants``, or exceeds them all the most.

    plants: the full plants of one machine at its operating points. start: a continuous controller err -> u, or the settings
    of one ([controller]); it need not hold them all. order: its states (None: three per axis, or those of the
    start). structure: "free", "plane" (bearings at one angle: what zeta and eta read is kept apart), "axis" (every axis alone),
    or a filter bank: "pid" (every channel its own PID and low pass) or "filters" (and notches). bending_modes: per plane in the
    models that are tuned on (None: all below the frequency up to which sensitivity is judged, and one more).
    reference: a controller whose direct gains below 200 Hz are kept within 8 % rms (None: free). time_limit [s] of computing.

    The tolerances around each point are those of the machine. ``gamma`` is the largest ratio of a requirement to its limit on
    the full plants, and on the reduced models of the worst corners found: below 1 all are met there. ``stopped_early`` also
    where a corner was found that nothing of this order holds. Raises InvalidInput, NumericalFailure where nothing holds every
    point.
    """
    job = prepare(plants, start, timing, order, structure, bending_modes, reference, time_limit, progress)
    return tuned(job, first_law(job, start, order, structure), structure)


def tuned(job: Job, law: Law, structure: str, *, again: bool = False) -> Synthesis:
    """``tune_controller`` from a law on; again: it was tuned before with this job, only the last rounds are made."""
    powers = _POWERS[_AGAIN:] if again else _POWERS
    reason: str | None = None
    rounds: list[_Round] = []
    history: list[dict[str, float]] = []
    try:
        law = _holding(job, law)
        if again:
            rounds.append(_judged(job, law, job.models))
        for number, power in enumerate(powers, 1):
            if number > 1 or again:  # fewer unknowns first
                job.groups = axis_groups(job.full[0].machine, structure)
            law, used = _descended(job, law, power)
            rounds.append(_judged(job, law, job.models))
            history.append(_row(job, number, power, used, rounds[-1]))
            job.say(f"round {number}: {used} steps at p = {power:g}, {len(job.models)} models; {_in_words(rounds[-1])}")
            if job.clock.left <= 0:
                reason = job.clock.reached
                break
            if number < len(powers):
                law = _add_members(job, law)
    except KeyboardInterrupt:
        if not rounds:
            raise
        reason = INTERRUPTED
    except NumericalFailure as error:  # of a member that nothing was found to hold: what the rounds gave is kept
        if not rounds:
            raise
        reason = str(error)
    return _result(job, _best(job, rounds), tuple(history), reason)


def prepare(
    plants: Sequence[Plant], start: Law, timing: Timing | None, order: int | None, structure: str,
    bending_modes: int | None, reference: StateSpace | None, time_limit: float, progress: Callable[[str], None] | None,
) -> Job:  # fmt: skip
    """What is tuned; arguments as of ``tune_controller``. Raises InvalidInput."""
    full = tuple(plants)
    if not full or any(plant.machine is not full[0].machine for plant in full):
        raise InvalidInput("tuning needs plants of one machine at its operating points; assemble them from the same machine")
    if structure in BANKS and not isinstance(start, PidSettings):
        raise invalid("start", type(start).__name__, f"PidSettings with structure {structure!r}", "give the [controller] table")
    machine = full[0].machine
    start = _system(start, machine)
    if start.dt is not None:
        raise invalid("the start's dt", start.dt, "None (continuous)", "give the continuous controller and the timing")
    if order is not None and (isinstance(order, bool) or not isinstance(order, int | np.integer) or order < 1):
        raise invalid("order", repr(order), "a whole number, at least 1", "leave the default")
    if order is not None and order > STATES:
        raise invalid("order", order, f"at most {STATES}, as in a controller file", "three per axis are the default")
    modes = max(bending_modes_for(plant, start, timing) for plant in full) if bending_modes is None else bending_modes
    reduced = reduce_from if bending_modes is None else reduce
    small = tuple(reduced(plant, modes) if plant.bending_modes is None else plant for plant in full)
    aims = aims_of(machine, start)
    fastest = _FASTEST * max(fastest_pole(start), aims.highest) if timing is None else _BELOW * np.pi / timing.sample_time
    return Job(
        full, small, timing, aims, axis_groups(machine, "plane" if structure == "free" else structure),
        [loop_model(plant, timing) for plant in small], TimeLimit(time_limit), progress or (lambda _: None), reference, fastest,
        structure,
    )  # fmt: skip


def _system(law: Law, machine: Machine) -> StateSpace:
    return pid_controller(law, machine) if isinstance(law, PidSettings) else law


def _unknowns(job: Job, law: Law) -> tuple[Structure | FilterBank, np.ndarray]:
    """The structure of what is tuned, and its unknowns."""
    if isinstance(law, PidSettings):
        return filter_bank(law, job.full[0].machine, job.fastest)
    return structured(law, job.groups)


def _law(structure: Structure | FilterBank, x: np.ndarray) -> Law:
    return structure.settings(x) if isinstance(structure, FilterBank) else structure.controller(x)


def bending_modes_for(plant: Plant, start: StateSpace | None = None, timing: Timing | None = None) -> int:
    """How many bending modes per plane a model needs to be tuned on: all that the sensitivity is judged at, and one more.

    With a controller to start from also all at whose resonances sigma_max(G K) reaches ``_HEARD``: what is left out is excited.
    """
    available = bending_modes_of(plant.rotor_model)
    frequencies = free_modes(plant.rotor_model, available).frequencies[4::2]
    judged = min(int((frequencies <= highest_verified(plant.machine)).sum()) + 1, available)
    top = np.inf if timing is None else np.pi / timing.sample_time
    above = np.flatnonzero(frequencies[judged:] < top)[:_LISTENED]
    if start is None or not len(above):
        return judged
    near = (frequencies[judged:][above][:, None] * np.linspace(0.99, 1.01, 9)).ravel()
    G = loop_model(plant, timing).response(near)[:, : len(plant.axes), : len(plant.axes)]
    gain = np.linalg.norm(G @ frequency_response(start, warped(near, timing)).values, 2, axis=(1, 2)).reshape(len(above), -1)
    heard = np.flatnonzero(gain.max(axis=1) >= _HEARD)
    return judged + (int(above[heard[-1]]) + 1 if len(heard) else 0)


def first_law(job: Job, start: Law, order: int | None, structure: str) -> Law:
    """The start with a lag where its sample rate cannot show its poles, and with weak states, or filters, up to the order."""
    if structure in BANKS and isinstance(start, PidSettings):
        return first_bank(start, job.full[0].machine, structure, order, job.fastest)
    start = _system(start, job.full[0].machine)
    m, n = start.D.shape[0], start.n_states
    late = job.timing is not None and fastest_pole(start) * job.timing.sample_time > 0.5 * np.pi
    if late and (order is None or n + m <= order):
        A = np.block([[start.A, np.zeros((n, m))], [_LAG * start.C, -_LAG * np.eye(m)]])
        B, C = np.vstack([start.B, _LAG * start.D]), np.hstack([np.zeros((m, n)), np.eye(m)])
        start = StateSpace(A, B, C, np.zeros((m, m)), start.inputs, start.outputs)
    wanted = max(_STATES_PER_AXIS * len(start.inputs), start.n_states) if order is None else order
    if wanted < start.n_states:
        raise invalid("order", wanted, f"{start.n_states} or more, as the start has", "simplify the [controller], or give more")
    return with_states(start, wanted - start.n_states, job.groups)


def with_states(K: StateSpace, extra: int, groups: Groups) -> StateSpace:
    """The controller with ``extra`` weakly coupled, well damped states, shared by the groups."""
    rng = np.random.default_rng(0)
    m = K.D.shape[0]
    gain = float(np.abs(frequency_response(K, np.geomspace(1.0, 1e5, 30)).values).max())
    A, B, C = [K.A], [K.B], [K.C]
    for k, axes in enumerate(groups):
        size = extra // len(groups) + (k < extra % len(groups))
        if not size:
            continue
        rates = np.geomspace(100.0, 6000.0, size)
        block = -np.diag(rates)
        for j in range(0, size - 1, 2):
            block[j : j + 2, j : j + 2] = rates[j] * np.array([[-0.5, 0.87], [-0.87, -0.5]])
        root, into, out = np.sqrt(np.abs(np.diag(block))), np.zeros((size, m)), np.zeros((m, size))
        into[:, list(axes)] = rng.normal(size=(size, len(axes))) * root[:, None]
        out[list(axes)] = _WEAK * gain * rng.normal(size=(len(axes), size)) * root
        A, B, C = [*A, block], [*B, into], [*C, out]
    return StateSpace(sla.block_diag(*A), np.vstack(B), np.hstack(C), K.D, K.inputs, K.outputs)


def _holding(job: Job, law: Law) -> Law:
    """A controller that holds all models, with some decay, by descent on the poles' real parts alone."""
    for attempt in range(_TRIES + 1):
        structure, x = _unknowns(job, law)
        cost = Objective(structure, job.models, np.array([100.0]), job.aims)
        abscissa = cost.abscissa(x)
        if abscissa < (-0.5 if attempt == 0 else -_DECAY):
            return law
        if attempt == _TRIES or job.clock.left <= 0:
            break
        if attempt == 0:
            job.say(f"the start does not hold every model ({abscissa:+.3g} rad/s): looking for one that does")
        x, _ = descend(cost.unstable, lambda trial: True, x, _HOLDING, 1e-6, lambda: job.clock.left > 0)
        law = _law(structure, x)
    if abscissa < 0:
        return law
    raise NumericalFailure(
        f"no controller of order {structure.controller(x).n_states} that holds all {len(job.models)} models was found (a pole "
        f"stays at {abscissa:+.3g} rad/s); {advice(job.structure)}, give another [controller] to start from, or drop a point"
    )


def _grid(job: Job, cost: Objective, x: np.ndarray, per_decade: int) -> np.ndarray:
    """A logarithmic grid with the loops' resonances, half a bandwidth to either side of light ones, and known peaks."""
    top = job.aims.highest if job.timing is None else min(job.aims.highest, 0.97 * np.pi / job.timing.sample_time)
    grid = np.geomspace(_LOWEST, top, int(per_decade * np.log10(top / _LOWEST)))
    poles = cost.poles(x)
    poles = poles[(poles.imag > 0) & (np.abs(poles.real) < 0.5 * np.abs(poles))]
    at, half = unwarped(poles.imag, job.timing), np.abs(poles.real)
    light = half < 0.06 * at
    more = np.concatenate([at, (at + half)[light], (at - half)[light], np.array(job.extra)])
    grid = np.unique(np.concatenate([grid, more[(more >= _LOWEST) & (more <= top)]]))
    kept = [grid[0]]
    for omega in grid[1:]:
        if omega > 1.002 * kept[-1]:
            kept.append(omega)
    if job.timing is None:
        kept += [3 * top, 10 * top, 100 * top]
    return np.array(kept)


def _descended(job: Job, law: Law, power: float) -> tuple[Law, int]:
    """One descent; true peaks of a denser grid are kept for the next."""
    structure, x = _unknowns(job, law)
    controller = structure.controller(x)
    rough = Objective(structure, job.models, np.array([100.0]), job.aims)
    cost = Objective(structure, job.models, _grid(job, rough, x, _TUNED), job.aims, job.reference)
    fastest = _FASTEST * max(fastest_pole(controller), job.aims.highest)
    if isinstance(structure, FilterBank):  # whose poles end at their limit softly
        fastest = max(fastest, job.fastest)
    if job.timing is not None:  # export refuses poles beyond half the rate
        fastest = min(fastest, max(np.pi / job.timing.sample_time, fastest_pole(controller)))

    def allowed(trial: np.ndarray) -> bool:
        return float(np.abs(np.linalg.eigvals(structure.matrices(trial)[0])).max(initial=0.0)) <= fastest

    if not isinstance(structure, FilterBank):
        cost.fence = _BEYOND * fastest
    x, used = descend(lambda v: cost(v, power), allowed, x, _ITERATIONS, 1e-4, lambda: job.clock.left > 0)
    law = _law(structure, x)
    if isinstance(law, StateSpace) and (settled := without_drift(law)) is not law:
        law, (structure, x) = settled, _unknowns(job, settled)
        cost = Objective(structure, job.models, cost.omega, job.aims, job.reference)
    dense = Objective(structure, job.models, _grid(job, cost, x, _JUDGED), job.aims)
    job.extra += [float(dense.omega[i]) for i in set(dense.sensitivity(x).argmax(axis=1))]
    return law, used


def without_drift(law: StateSpace) -> StateSpace:
    """A - 2 a I where the controller's rightmost pole a is over the imaginary axis by at most ``_DRIFT``; else the same.

    The loop holds so slow a pole and no requirement sees it, but the controller would run away when the loop is open.
    """
    drift = float(np.linalg.eigvals(law.A).real.max(initial=-np.inf))
    if not _ROUNDING < drift <= _DRIFT:
        return law
    A = law.A - 2 * drift * np.eye(law.n_states)
    return StateSpace(A, law.B, law.C, law.D, law.inputs, law.outputs)


def _best(job: Job, rounds: list[_Round]) -> _Round:
    """The round that does best on all models by the end, members included, and on the full plants."""
    full = [loop_model(plant, job.timing) for plant in job.full]
    best = _Round(rounds[-1].law, {})
    for known in sorted(rounds, key=lambda item: item.worst):
        if known.worst >= best.worst:
            break  # more models, and the full plants, can only be worse
        item = _judged(job, known.law, job.models)
        if item.worst < best.worst:
            best = min(best, _both(item, _judged(job, item.law, full)), key=lambda item: item.worst)
    if not np.isfinite(best.worst):
        raise NumericalFailure(
            f"no controller of order {_system(best.law, job.full[0].machine).n_states} that holds the full plant at all "
            f"{len(job.full)} operating points was found; {advice(job.structure)}, allow more bending modes, or drop a point"
        )
    return best


def _both(one: _Round, other: _Round) -> _Round:
    """The larger ratio of each requirement; none where one of the two has none, for it is unstable there."""
    if not one.ratios or not other.ratios:
        return _Round(one.law, {})
    return _Round(one.law, {
        name: max(ratio, other.ratios[name], key=lambda item: item.value) for name, ratio in one.ratios.items()
    })  # fmt: skip


def _judged(job: Job, law: Law, models: Sequence[LoopModel]) -> _Round:
    """All ratios on models, on a dense grid that is denser still around every model's peak; none where one is unstable."""
    structure, x = _unknowns(job, law)
    rough = Objective(structure, models, np.array([100.0]), job.aims)
    if rough.abscissa(x) >= 0:
        return _Round(law, {})
    grid = _grid(job, rough, x, _JUDGED)
    peaks = np.unique(Objective(structure, models, grid, job.aims).sensitivity(x).argmax(axis=1))
    near = [np.geomspace(grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)], _AROUND) for i in peaks]
    cost = Objective(structure, models, np.unique(np.concatenate([grid, *near])), job.aims, job.reference)
    return _Round(law, cost.ratios(x))


def _add_members(job: Job, law: Law) -> Law:
    """The worst corner of the tolerances around every point, and the worst point of every range, join the models; the
    controller brought to hold them all."""
    controller = _system(law, job.full[0].machine)
    for plant in job.small:
        found = worst_member(plant, controller, job.timing, job.aims)
        key = (plant.point.label, tuple(sorted(found.items())))
        if found and key not in job.members:
            job.members.add(key)
            label = f"{plant.point.label}, {', '.join(f'{name} {value:+.3g}' for name, value in found.items())}"
            job.models.append(loop_model(perturbed(plant, found, tolerances_around(plant)), job.timing, label))
    for area in job.full[0].machine.operation.ranges:
        point = search(job.full[0].machine, area, controller, job.timing).worst(area)
        if (point.label, ()) not in job.members and point not in area.corners:
            job.members.add((point.label, ()))
            modes = job.small[0].bending_modes or 0
            between = with_offsets_of(assemble(job.full[0].machine, point), job.full[0])
            job.models.append(loop_model(reduce(between, modes), job.timing, point.label))
    return _holding(job, law)


def _in_words(item: _Round) -> str:
    if not item.ratios:
        return "unstable"
    parts = [f"{name} {ratio.value:.3f}" for name, ratio in sorted(item.ratios.items(), key=lambda pair: -pair[1].value)]
    return f"of their limits: {', '.join(parts)}"


def _row(job: Job, number: int, power: float, used: int, item: _Round) -> dict[str, float]:
    row = {
        "iteration": float(number),
        "power": power,
        "steps": float(used),
        "models": float(len(job.models)),
        "gamma": item.worst,
    }
    return {**row, **{name: ratio.value for name, ratio in item.ratios.items()}, "seconds": job.clock.elapsed}


def _result(job: Job, best: _Round, history: tuple[dict[str, float], ...], reason: str | None) -> Synthesis:
    """The synthesis, with stability and the norm of S_o of the loop as it runs recomputed on every full plant.

    Tuning leaves the sampled plant's aliases out of its frequency responses: where the norm says more, it is the ratio.
    """
    controller = _system(best.law, job.full[0].machine)
    runs = controller if job.timing is None else job.timing.in_loop(controller)
    found = [certify(plant, runs) for plant in job.full]
    worst = max(range(len(found)), key=lambda k: found[k].closed_loop_norm)
    machine, ratios = job.full[0].machine, dict(best.ratios)
    exact = Ratio(found[worst].closed_loop_norm / job.aims.sensitivity, job.full[worst].point.label, np.nan)
    ratios["sensitivity"] = max(ratios["sensitivity"], exact, key=lambda ratio: ratio.value)
    certificate = Certificate(
        all(item.stable for item in found), max(item.spectral_abscissa for item in found), found[worst].closed_loop_norm,
        fastest_pole(controller),
        {"bending_modes": float(job.small[0].bending_modes or 0)} | {f"ratio_{name}": r.value for name, r in ratios.items()},
        f"{machine.name}, full plant at {len(found)} operating points",
    )  # fmt: skip
    binding = max(ratios, key=lambda name: ratios[name].value)
    at = ratios[binding]
    where = f" at {at.frequency / (2 * np.pi):.4g} Hz" if np.isfinite(at.frequency) else ""
    notes = [f"{binding} binds: {at.value:.3f} of its limit at {at.label}{where}"]
    missed = [f"{name} ({ratio.value:.3f})" for name, ratio in ratios.items() if ratio.value > 1]
    if missed:
        notes.append(f"not met: {', '.join(missed)}; {advice(job.structure)}, or relax a requirement")
    if isinstance(best.law, PidSettings) and (ends := at_limits(best.law, machine, job.fastest)):
        notes.append(f"at a limit of the search: {'; '.join(ends)}")
    status = Status.VERIFIED if certificate.stable else Status.UNSTABLE
    return Synthesis(
        controller, "tuned", at.value, status, certificate, history, tuple(notes), stopped_early=reason,
        filters=best.law if isinstance(best.law, PidSettings) else None,
    )  # fmt: skip
