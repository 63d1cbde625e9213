"""A law along the one quantity that moves: between knots its matrices are affine in it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ambrose.core.statespace import StateSpace
from ambrose.law.law import LawLike, law_of
from ambrose.law.loop import match_controller
from ambrose.model.plant import Plant


@dataclass(frozen=True, slots=True, eq=False)
class MovingLaw:
    """at: speed [rad/s] or pressure [Pa] as it is told -> the law there, its signals in the order
    of a plant's axes. grid (k,): of a schedule, whose matrices are linear between its values; None:
    the law is the same at all of them. dt [s]: sample time, None where it is continuous.
    """

    at: Callable[[float], StateSpace]
    grid: np.ndarray | None
    n_states: int
    dt: float | None

    def knots(self, low: float, high: float, cells: int) -> list[float]:
        """The values between which it is affine: a schedule's grid; of a law that does not change
        the ends of ``cells`` intervals from low to high.
        """
        inner = np.linspace(low, high, cells + 1) if self.grid is None else self.grid
        return [float(value) for value in inner.tolist()]

    def reach(self, low: float, high: float) -> tuple[float, float]:
        """As much of low to high as a schedule covers."""
        if self.grid is None:
            return low, high
        return max(low, float(self.grid[0])), min(high, float(self.grid[-1]))


def moving_law(law: LawLike, plant: Plant) -> MovingLaw:
    """A schedule over one quantity, or a law that does not change with it, along that quantity.

    Raises InvalidInput where it is not one for the plant's machine.
    """
    schedule = law_of(law).schedule
    if schedule is None:
        still = match_controller(law, plant)
        return MovingLaw(lambda value: still, None, still.n_states, still.dt)
    matrices = schedule
    return MovingLaw(
        lambda value: match_controller(matrices.at(value), plant),
        schedule.grid,
        schedule.n_states,
        schedule.dt,
    )
