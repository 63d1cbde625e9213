"""D scalings as dynamic systems: what the D-step finds and the K-step puts around the plant.

Every block Delta_i has D_i(s), stable with a stable inverse, that commutes with it: D_z = diag(D_i)
multiplies z, D_w^-1 multiplies w, and the H-infinity norm of D_z M D_w^-1 is an upper bound of
mu(M(j omega)) at every frequency, for complex and real Delta. The last block is the reference: its
D is 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.frequency import frequency_response, largest_gain
from ambrose.core.lft import Block, GeneralizedPlant
from ambrose.core.statespace import StateSpace, append, rename, series, static_gain
from ambrose.synthesis.mu.d_fit import RealRational


@dataclass(frozen=True, slots=True, eq=False)
class BlockScaling:
    """left (n_z, n_z): D_i(s) on the block's z; right (n_w, n_w): D_i(s)^-1 on its w; order: of D_i
    per channel.
    """

    left: StateSpace
    right: StateSpace
    order: int


@dataclass(frozen=True, slots=True, eq=False)
class Scaling:
    """One BlockScaling per block, in the order of the blocks."""

    parts: tuple[BlockScaling, ...]

    @property
    def states(self) -> int:
        """How many states the scaled plant has more than the plant."""
        return sum(part.left.n_states + part.right.n_states for part in self.parts)

    @property
    def orders(self) -> tuple[int, ...]:
        return tuple(part.order for part in self.parts)

    @property
    def left(self) -> StateSpace:
        """D_z(s), from z to scaled z."""
        return _side([part.left for part in self.parts])

    @property
    def right(self) -> StateSpace:
        """D_w(s)^-1, from scaled w to w."""
        return _side([part.right for part in self.parts])


def _side(systems: Sequence[StateSpace]) -> StateSpace:
    parts, count = [], 0
    for system in systems:
        size = len(system.inputs)
        parts.append(
            rename(
                system,
                [f"i{count + k}" for k in range(size)],
                [f"o{count + k}" for k in range(size)],
            )
        )
        count += size
    return append(*parts)


def scalar_scaling(block: Block, d: RealRational) -> BlockScaling:
    """d(s) I on every channel of the block."""
    inverse = d.inverse()
    return BlockScaling(
        _side([d.system()] * block.n_z), _side([inverse.system()] * block.n_w), d.order
    )


def scaled_loop(loop: StateSpace, scaling: Scaling) -> StateSpace:
    """D_z M D_w^-1 for a system M from w to z, both with the signals of the blocks only."""
    system = series(series(scaling.right, loop), scaling.left)
    return rename(system, loop.inputs, loop.outputs)


def scaled_plant(plant: GeneralizedPlant, scaling: Scaling) -> GeneralizedPlant:
    """The plant with D_z on its z and D_w^-1 on its w, u and y untouched; the blocks must take up
    all of w and z.
    """
    u, y = (
        static_gain(np.eye(len(side)), [f"i_{s}" for s in side], [f"o_{s}" for s in side])
        for side in (plant.u, plant.y)
    )
    system = series(series(append(scaling.right, u), plant.system), append(scaling.left, y))
    system = rename(system, plant.system.inputs, plant.system.outputs)
    return GeneralizedPlant(system, plant.w, plant.u, plant.z, plant.y, plant.blocks)


def scaled_gain(M: np.ndarray, omega: np.ndarray, scaling: Scaling) -> np.ndarray:
    """sigma_max(D_z M D_w^-1) (w,) for M (w, n_z, n_w) at omega (w,) [rad/s]."""
    left, right = (
        frequency_response(scaling.left, omega).values,
        frequency_response(scaling.right, omega).values,
    )
    return largest_gain(left @ M @ right)
