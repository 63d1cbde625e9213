"""A run-up through a range of speeds with disturbances on the way: the linear time-varying loop, and how each step settles.

The plant is assembled at a few speeds in states that mean the same at all of them (modes of the free rotor) and is linear in
between; the controller is taken at every speed as it is. The linear simulation then holds both over short intervals, as many as
its answer needs (simulate/linear.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import check_positive, invalid
from ambrose.core.response import settling_time
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.physics.rotor import finite_element_rotor, mass_properties
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import closed_loop
from ambrose.plant.model import Plant
from ambrose.plant.reduce import free_mode_reduction
from ambrose.simulate import linear
from ambrose.simulate.scenario import Scenario
from ambrose.simulate.trace import Trace


@dataclass(frozen=True, slots=True)
class Step:
    """One window of a run-up. start [s] and speed [rad/s] at its start; peak of |signal| in the signals' unit; settling [s]
    until it stays within the band of the peak around zero (inf: not within the window); crossings: sign changes of the largest
    signal before that, beyond the band (two or more ring)."""

    start: float
    speed: float
    peak: float
    settling: float
    crossings: int


def loops_over_speed(
    plant: Plant, controller: Any, low: float, high: float, *, bending_modes: int = 2, points: int = 15
) -> linear.LoopAt:
    """The closed loop as a function of speed [rad/s] from low to high, always in the same states, for ``linear.run``.

    controller: fixed or scheduled (ScheduledSystem), continuous or sampled. bending_modes: kept per plane; points: speeds at
    which the plant is assembled. Raises InvalidInput.
    """
    if not low < high:
        raise invalid("the speeds", f"{low:g} to {high:g} rad/s", "a range that ascends", "exchange them")
    grid = np.linspace(low, high, max(int(check_positive(points, "points", "15 suits 20 to 300 Hz")), 2))
    members = [
        free_mode_reduction(assemble(plant.machine, replace(plant.point, speed=float(speed))), bending_modes) for speed in grid
    ]
    between = ScheduledSystem(grid, [member.system for member in members])

    def loop_at(speed: float) -> StateSpace:
        here = replace(members[0], system=between.at(speed), point=replace(plant.point, speed=float(speed)))
        return closed_loop(here, controller)

    return loop_at


def spin_up(plant: Plant, controller: Any, scenario: Scenario, *, bending_modes: int = 2, points: int = 15) -> Trace:
    """The scenario's run-up on the linear loop of a full plant. Raises InvalidInput where the speed does not change."""
    if not scenario.runs_up:
        raise invalid("the scenario", repr(scenario.name), "one whose speed changes", 'the bundled "spin-up-steps" is one')
    ends = sorted((scenario.speed_at(0.0), scenario.speed_at(scenario.duration)))
    loop_at = loops_over_speed(plant, controller, ends[0], ends[1], bending_modes=bending_modes, points=points)
    gaps = [b.touchdown_gap for b in plant.machine.bearings if b.touchdown_gap is not None]
    return linear.run(
        loop_at, scenario, machine=plant.machine.name, point=plant.point, displacement_limit=min(gaps, default=None),
        mass=mass_properties(finite_element_rotor(plant.machine)).mass,
    )  # fmt: skip


def steps(
    trace: Trace, scenario: Scenario, signals: Sequence[str], *, every: float = 0.05, band: float = 0.05
) -> tuple[Step, ...]:
    """How the signals answer in each window of ``every`` seconds, for disturbances that change at the start of each."""
    every = check_positive(every, "every", "the bundled scenario disturbs every 50 ms")
    time, values = trace.record.time, trace.record.select(list(signals)).values
    found = []
    for k in range(int(time[-1] / every + 1e-6)):
        inside = (time >= k * every - 1e-9) & (time < (k + 1) * every - 1e-9)
        part = values[:, inside]
        peak = float(np.abs(part).max())
        after = settling_time(time[inside] - k * every, part, band) if peak > 0 else 0.0
        row = part[int(np.argmax(np.abs(part).max(axis=1)))]
        row = row[np.abs(row) > band * peak]
        found.append(Step(k * every, scenario.speed_at(k * every), peak, after, int((np.diff(np.sign(row)) != 0).sum())))
    return tuple(found)
