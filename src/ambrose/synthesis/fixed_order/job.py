"""The task of tuning: models of all operating points, what is asked of them, and the controller
that it starts from.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import cast

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.frequency import frequency_response, largest_gain
from ambrose.core.processes import TimeLimit
from ambrose.core.statespace import StateSpace
from ambrose.judge.result import fastest_pole
from ambrose.law.loop import Timing
from ambrose.law.pid import pid_controller
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import STATES
from ambrose.machine.part import PidSettings
from ambrose.model.assemble import bending_modes_of, modes_judged
from ambrose.model.effects.rotor import free_modes
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import reduce, reduce_from
from ambrose.synthesis.fixed_order.bank import BANKS, first_bank
from ambrose.synthesis.fixed_order.channels import Aims, LoopModel, aims_of, loop_model, warped
from ambrose.synthesis.fixed_order.objective import Objective
from ambrose.synthesis.fixed_order.structure import Groups, axis_groups, structured

_LAG = 2 * np.pi * 400  # rad/s; appended where the start is too fast for its sample rate
_WEAK = 1e-3  # of the start's gain: states that are added to reach the order
STATES_PER_AXIS, _MOST_PER_AXIS = 3, 6  # at first, and at most while requirements are not met
HOLDS = -0.5  # rad/s; every pole of every model to the left of it: a start that holds them all
FASTEST = 3.0  # times the fastest pole of the start, or the grid's end
_BELOW = 0.95  # of half the rate: the fastest pole of a filter bank
_ABOVE = 1.2  # times the highest bending mode of the models: there the grid ends at least
# loop gain of a mode that is kept; modes above the others that are looked at
_HEARD, _LISTENED = 0.15, 12
# (number of the operating point, omega (w,) [rad/s], G (w, a, a)) of each measured plant, with hold
# and without delay
MeasuredPlants = Sequence[tuple[int, np.ndarray, np.ndarray]]
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
    most_states: int | None = None  # the order may grow to so many
    narrowed: bool = False  # the unknowns are those of the structure that was asked for
    extra: list[float] = field(default_factory=list)  # frequencies of true peaks [rad/s]
    measured: MeasuredPlants = ()
    # the aims before each time that what `verify` asks beyond them joined (None: it never does)
    before: list[Aims] | None = None
    members: set[tuple[str, tuple[tuple[str, float], ...]]] = field(default_factory=set)
    whole: list[LoopModel] = field(default_factory=list)  # of the full plants, where it judged them

    @property
    def bank(self) -> bool:
        """Whether the chains of a filter bank are tuned: else matrices are."""
        return self.structure in BANKS


def prepare(
    plants: Sequence[Plant],
    start: Law,
    timing: Timing | None,
    order: int | None,
    structure: str,
    bending_modes: int | None,
    reference: StateSpace | None,
    time_limit: float,
    progress: Callable[[str], None] | None,
    measured: MeasuredPlants = (),
) -> Job:
    """What is tuned; arguments as of ``tune_controller``. Raises InvalidInput."""
    full = tuple(plants)
    if not full or any(plant.machine is not full[0].machine for plant in full):
        raise InvalidInput(
            "tuning needs plants of one machine at its operating points; assemble them from the "
            "same machine"
        )
    if structure in BANKS and not isinstance(start, PidSettings):
        raise invalid(
            "start",
            type(start).__name__,
            f"PidSettings with structure {structure!r}",
            "give the [controller] table",
        )
    machine = full[0].machine
    start = as_system(start, machine)
    if start.dt is not None:
        raise invalid(
            "the start's dt",
            start.dt,
            "None (continuous)",
            "give the continuous controller and the timing",
        )
    if order is not None and (
        isinstance(order, bool) or not isinstance(order, int | np.integer) or order < 1
    ):
        raise invalid("order", repr(order), "a whole number, at least 1", "leave the default")
    if order is not None and order > STATES:
        raise invalid(
            "order",
            order,
            f"at most {STATES}, as in a controller file",
            "three per axis are the default",
        )
    modes = (
        max(bending_modes_for(plant, start, timing) for plant in full)
        if bending_modes is None
        else bending_modes
    )
    reduced = reduce_from if bending_modes is None else reduce
    small = tuple(reduced(plant, modes) if plant.bending_modes is None else plant for plant in full)
    aims = aims_of(machine, start)
    bending = free_modes(
        full[0].rotor_model, min(modes, bending_modes_of(full[0].rotor_model))
    ).frequencies[4:]
    aims = replace(aims, highest=max(aims.highest, _ABOVE * float(bending.max(initial=0.0))))
    fastest = (
        FASTEST * max(fastest_pole(start), aims.highest)
        if timing is None
        else _BELOW * np.pi / timing.sample_time
    )
    return Job(
        full,
        small,
        timing,
        aims,
        axis_groups(machine, "plane" if structure == "free" else structure),
        loop_models(small, timing, measured),
        TimeLimit(time_limit),
        progress or (lambda _: None),
        reference,
        fastest,
        structure,
        len(start.inputs) * _MOST_PER_AXIS if order is None and structure not in BANKS else None,
        extra=[peak for _, omega, G in measured for peak in _largest(omega, G)],
        measured=measured,
    )


def loop_models(
    plants: Sequence[Plant], timing: Timing | None, measured: MeasuredPlants
) -> list[LoopModel]:
    """The models of plants, then of those that were measured."""
    models = [loop_model(plant, timing) for plant in plants]
    return models + [models[k].as_measured(omega, G) for k, omega, G in measured]


def _largest(omega: np.ndarray, G: np.ndarray) -> list[float]:
    """Where a measured plant (w, a, a) has its maxima [rad/s]; its model may lack some."""
    size = np.linalg.norm(G, axis=(1, 2))
    inner = size[1:-1]
    return omega[1:-1][(inner > size[:-2]) & (inner > size[2:])].tolist()


def as_system(law: Law, machine: Machine) -> StateSpace:
    """The controller itself, of settings too."""
    return pid_controller(law, machine) if isinstance(law, PidSettings) else law


def bending_modes_for(
    plant: Plant, start: StateSpace | None = None, timing: Timing | None = None
) -> int:
    """How many bending modes per plane a model needs to be tuned on: all that the sensitivity is
    judged at, and one more.

    With a controller to start from also all at whose resonances sigma_max(G K) reaches ``_HEARD``:
    what is left out is excited.
    """
    available = bending_modes_of(plant.rotor_model)
    frequencies = free_modes(plant.rotor_model, available).frequencies[4::2]
    judged = modes_judged(plant)
    top = np.inf if timing is None else np.pi / timing.sample_time
    above = np.flatnonzero(frequencies[judged:] < top)[:_LISTENED]
    if start is None or not len(above):
        return judged

    # sigma_max(G K) within 1 % of each mode; up to the last one that is heard all are taken
    near = (frequencies[judged:][above][:, None] * np.linspace(0.99, 1.01, 9)).ravel()
    G = loop_model(plant, timing).response(near)[:, : len(plant.axes), : len(plant.axes)]
    gain = largest_gain(G @ frequency_response(start, warped(near, timing)).values).reshape(
        len(above), -1
    )
    heard = np.flatnonzero(gain.max(axis=1) >= _HEARD)
    return judged + (int(above[heard[-1]]) + 1 if len(heard) else 0)


def first_law(job: Job, start: Law, order: int | None, structure: str) -> Law:
    """The first of ``first_laws``."""
    return first_laws(job, start, order, structure)[0]


def first_laws(job: Job, start: Law, order: int | None, structure: str) -> tuple[Law, ...]:
    """Laws to begin with, the best first: the start with weak states, or filters, up to the order,
    and the same with a lag where its sample rate cannot show its poles.

    The lag of 400 Hz costs phase where the damping of rigid and bending modes comes from: it comes
    first where it holds all models, or comes nearer to it than the start itself.
    """
    if structure in BANKS:
        filters = cast(PidSettings, start)
        return (first_bank(filters, job.full[0].machine, structure, order, job.fastest),)
    start = as_system(start, job.full[0].machine)
    plain = _of_order(job, start, order)
    late = job.timing is not None and fastest_pole(start) * job.timing.sample_time > 0.5 * np.pi
    if not late or (order is not None and start.n_states + len(start.D) > order):
        return (plain,)
    lagged = _of_order(job, _lagged(start), order)
    by_lag = _abscissa(job, lagged)
    if by_lag < HOLDS or by_lag < _abscissa(job, plain):
        return lagged, plain
    return plain, lagged


def _lagged(K: StateSpace) -> StateSpace:
    """With a lag l on every output: u' = l (C x + D err - u); states (x, u)."""
    m, n = K.D.shape[0], K.n_states
    A = np.block([[K.A, np.zeros((n, m))], [_LAG * K.C, -_LAG * np.eye(m)]])
    B, C = np.vstack([K.B, _LAG * K.D]), np.hstack([np.zeros((m, n)), np.eye(m)])
    return StateSpace(A, B, C, np.zeros((m, m)), K.inputs, K.outputs)


def _abscissa(job: Job, law: StateSpace) -> float:
    """The largest real part of any model's closed-loop pole (in w) [rad/s]."""
    structure, x = structured(law, job.groups)
    return Objective(structure, job.models, np.array([100.0]), job.aims).abscissa(x)


def _of_order(job: Job, start: StateSpace, order: int | None) -> StateSpace:
    """The start with weak states up to the order. Raises InvalidInput for one that it exceeds."""
    wanted = max(STATES_PER_AXIS * len(start.inputs), start.n_states) if order is None else order
    if wanted < start.n_states:
        raise invalid(
            "order",
            wanted,
            f"{start.n_states} or more, as the start has",
            "simplify the [controller], or give more",
        )
    return with_states(start, wanted - start.n_states, job.groups)


def with_states(K: StateSpace, extra: int, groups: Groups) -> StateSpace:
    """The controller with ``extra`` weakly coupled, well damped states, shared by the groups."""
    rng = np.random.default_rng(0)
    m = K.D.shape[0]
    gain = float(np.abs(frequency_response(K, np.geomspace(1.0, 1e5, 30)).values).max())
    A = [K.A]
    B = [K.B]
    C = [K.C]
    for k, axes in enumerate(groups):
        size = extra // len(groups) + (k < extra % len(groups))
        if not size:
            continue

        # Complex pairs of modulus w and damping 0.5 (a real pole if one is left over); B and C in
        # proportion to sqrt(w), so that all respond alike; C small: the start hardly changes.
        rates = np.geomspace(100.0, 6000.0, size)
        block = -np.diag(rates)
        for j in range(0, size - 1, 2):
            block[j : j + 2, j : j + 2] = rates[j] * np.array([[-0.5, 0.87], [-0.87, -0.5]])
        root = np.sqrt(np.abs(np.diag(block)))
        into = np.zeros((size, m))
        out = np.zeros((m, size))
        into[:, list(axes)] = rng.normal(size=(size, len(axes))) * root[:, None]
        out[list(axes)] = _WEAK * gain * rng.normal(size=(len(axes), size)) * root
        A = [*A, block]
        B = [*B, into]
        C = [*C, out]
    return StateSpace(sla.block_diag(*A), np.vstack(B), np.hstack(C), K.D, K.inputs, K.outputs)
