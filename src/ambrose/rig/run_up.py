"""A run-up through a range of speeds, or of pressures, with disturbances on the way: the linear
time-varying loop, and how each step settles.

The plant is computed at a few speeds in states that mean the same at all of them (modes of the free
rotor) and is linear in between; speeds are added until half-way between two of them it agrees with
the plant computed there. The controller is taken at every speed as it is. The linear simulation
then holds both over short intervals, as many as its answer needs (rig/linear.py).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ambrose.core.checks import check_positive, invalid
from ambrose.core.response import settling_time
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import closed_loop
from ambrose.law.scheduling import PRESSURE, SPEED, Scheduling
from ambrose.model.basis import bending_modes_of
from ambrose.model.effects.rotor import mass_properties
from ambrose.model.plant import Plant
from ambrose.model.reduce import free_mode_reduction
from ambrose.rig import linear
from ambrose.rig.scenario import Scenario
from ambrose.rig.trace import Trace

_COARSEST, _FINEST = 9, 513  # speeds at which a plant is computed
_STRAIGHT = 1e-3  # of a row's largest entry: how far the plant may bend between two of them


@dataclass(frozen=True, slots=True)
class Step:
    """One window of a run-up. start [s] and speed [rad/s] at its start; peak of |signal| in the
    signals' unit; settling [s] until it stays within the band of the peak around zero (inf: not
    within the window); crossings: sign changes of the largest signal before that, beyond the band
    (two or more ring).
    """

    start: float
    speed: float
    peak: float
    settling: float
    crossings: int


def loops_along(
    plant: Plant,
    controller: LawLike,
    low: float,
    high: float,
    along: Scheduling = SPEED,
    *,
    bending_modes: int = 12,
    points: int | None = None,
) -> linear.LoopAt:
    """The closed loop as a function of speed [rad/s] or pressure [Pa] from low to high, in the same
    states, for ``linear.run``.

    controller: fixed or scheduled (ScheduledSystem), continuous or sampled. bending_modes: kept per
    plane, fewer where the mesh has fewer; a turboexpander's run-up is good to 2 % of the peak with
    2, 0.4 % with 4 and 0.01 % with 12, for what is cut off also gives way statically. points:
    values at which the plant is computed, evenly; None: as many as it takes for every row of its
    matrix to be good to 0.1 % of the row's largest entry half-way between them. Raises
    InvalidInput.
    """
    if not low < high:
        raise invalid(
            f"the {along.name}s",
            f"{low:g} to {high:g} {along.unit}",
            "a range that ascends",
            "exchange them",
        )
    kept = min(bending_modes, bending_modes_of(plant.rotor_model))

    def plant_at(value: float) -> Plant:
        return free_mode_reduction(replace(plant, point=along.moved(plant.point, value)), kept)

    if points is None:
        members = _refined(plant_at, low, high)
    else:
        count = max(int(check_positive(points, "points", "leave it out")), 2)
        members = {float(value): plant_at(float(value)) for value in np.linspace(low, high, count)}
    first = members[low]
    grid = sorted(members)
    between = ScheduledSystem(
        grid, [members[value].system for value in grid], along.name, along.unit
    )

    law = law_of(controller)

    def loop_at(value: float) -> StateSpace:
        at_value = replace(
            first, system=between.at(value), point=along.moved(plant.point, float(value))
        )
        return closed_loop(at_value, law)

    return loop_at


def _refined(plant_at: Callable[[float], Plant], low: float, high: float) -> dict[float, Plant]:
    """Plants from low to high, intervals halved where the plant half-way is not the mean of those
    at the ends.
    """
    members = {float(value): plant_at(float(value)) for value in np.linspace(low, high, _COARSEST)}
    open_ = list(pairwise(sorted(members)))
    while open_ and len(members) < _FINEST:
        following = []
        for left, right in open_:
            middle = (left + right) / 2
            members[middle] = plant_at(middle)
            # each row in units of its largest entry
            A = members[middle].system.A
            mean = (members[left].system.A + members[right].system.A) / 2
            if (np.abs(A - mean).max(axis=1) > _STRAIGHT * np.abs(A).max(axis=1)).any():
                following += [(left, middle), (middle, right)]
        open_ = following
    return members


def spin_up(
    plant: Plant,
    controller: LawLike,
    scenario: Scenario,
    *,
    bending_modes: int = 12,
    points: int | None = None,
) -> Trace:
    """The scenario's run-up or changes of pressure on the linear loop of a full plant; see
    ``loops_along`` and ``linear.run``.

    Raises InvalidInput where neither changes, or both.
    """
    scenario = scenario.on(plant.machine)
    linear.check_scenario(scenario)
    along = SPEED if scenario.runs_up or not scenario.pressures else PRESSURE
    if along is SPEED:
        values = (
            [scenario.speed_at(0.0), scenario.speed_at(scenario.duration)]
            if scenario.runs_up
            else [0.0, 0.0]
        )
    else:
        values = [plant.point.seal_pressure, *(change.pressure for change in scenario.pressures)]
    if min(values) == max(values):
        what = "one whose speed or pressure changes"
        raise invalid(
            "the scenario",
            repr(scenario.name),
            what,
            'the bundled "spin-up-steps" and "pressure-steps" are such',
        )
    loop_at = loops_along(
        plant,
        controller,
        min(values),
        max(values),
        along,
        bending_modes=bending_modes,
        points=points,
    )
    gaps = [b.touchdown_gap for b in plant.machine.bearings if b.touchdown_gap is not None]
    return linear.run(
        loop_at,
        scenario,
        machine=plant.machine.name,
        point=plant.point,
        displacement_limit=min(gaps, default=None),
        mass=mass_properties(plant.rotor_model).mass,
        along=along,
    )


def steps(
    trace: Trace,
    scenario: Scenario,
    signals: Sequence[str],
    *,
    every: float = 0.05,
    band: float = 0.05,
) -> tuple[Step, ...]:
    """How the signals answer in each window of ``every`` seconds, for disturbances that change at
    the start of each.
    """
    every = check_positive(every, "every", "the bundled scenario disturbs every 50 ms")
    time, values = trace.record.time, trace.record.select(list(signals)).values
    intervals = []
    for k in range(int(time[-1] / every + 1e-6)):
        inside = (time >= k * every - 1e-9) & (time < (k + 1) * every - 1e-9)
        part = values[:, inside]
        peak = float(np.abs(part).max())
        after = settling_time(time[inside] - k * every, part, band) if peak > 0 else 0.0
        # the signal with the largest peak, what is beyond the band: its sign changes
        row = part[int(np.argmax(np.abs(part).max(axis=1)))]
        row = row[np.abs(row) > band * peak]
        intervals.append(
            Step(
                k * every,
                scenario.speed_at(k * every),
                peak,
                after,
                int((np.diff(np.sign(row)) != 0).sum()),
            )
        )
    return tuple(intervals)
