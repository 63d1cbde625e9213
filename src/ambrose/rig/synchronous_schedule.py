"""A scheduled controller as it runs beside synchronous blocks on the virtual rig.

It runs as its generated code does: sampled on a grid, its matrices linear between the
grid's points at what it is told in every sample, in one and the same states. What is lost is the
last one told, what is beyond the range its nearer end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import corners, grid_points, interval_points
from ambrose.core.statespace import StateSpace
from ambrose.law.law import Law
from ambrose.law.loop import match_axes
from ambrose.machine.machine import Machine

_BETWEEN = 3  # points between two of the grid at which the law is sampled


@dataclass(frozen=True, slots=True, eq=False)
class SampledSchedule:
    """x+ = A x + B e, u = C x + D e, each matrix linear between the points of a grid.

    axes: ascending values of each quantity; matrices: A, B, C, D at every point (k, ., .);
    parameter: what it is scheduled over, as a program states it.
    """

    axes: tuple[np.ndarray, ...]
    matrices: tuple[np.ndarray, ...]
    signals: tuple[tuple[str, ...], tuple[str, ...]]
    sample_time: float
    parameter: str

    def at(self, value: Any) -> StateSpace:
        """The law at a value, or at a tuple of several, within the grid or its nearer end."""
        told = np.atleast_1d(value).astype(float)
        inside = [np.clip(v, a[0], a[-1]) for v, a in zip(told, self.axes, strict=True)]
        index, share = corners(self.axes, np.array([inside]))
        A, B, C, D = (np.tensordot(share[0], M[index[0]], 1) for M in self.matrices)
        return StateSpace(A, B, C, D, *self.signals, self.sample_time)


def sampled_schedule(machine: Machine, law: Law, sample_time: float) -> SampledSchedule:
    """A schedule sampled by Tustin's map, its signals in the order of the machine's axes. Raises
    InvalidInput for a law without a grid.
    """
    along, schedule = law.scheduled_over, law.schedule
    if along is None or schedule is None:
        raise InvalidInput(
            "synchronous blocks are simulated beside a fixed controller, or one that is scheduled "
            "on a grid; give its matrices on a grid, or leave the blocks out of its file"
        )
    axes = tuple(interval_points(axis, _BETWEEN) for axis in schedule.axes)
    design = machine.operation.design
    sampled = []
    for value in grid_points(axes):
        found = match_axes(law.at(along.moved(design, value)), machine.axes, repr(machine.name))
        sampled.append(found if found.dt is not None else c2d(found, sample_time, method="tustin"))
    matrices = tuple(np.array([getattr(one, name) for one in sampled]) for name in "ABCD")
    signals = tuple(sampled[0].inputs), tuple(sampled[0].outputs)
    return SampledSchedule(axes, matrices, signals, sample_time, along.name)
