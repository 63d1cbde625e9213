"""What changes over the grid of a schedule, as few signals: seals and speed enter a rotor at few
places.

    [[A - I, B], [C, D]] at grid point i = fixed + left core_i right

A plant whose states see the parameter through r forces has, by the closed form of the synthesis and
by Tustin's map, a controller that changes in a matrix of rank 2 r between the same two spaces at
every point. The code then takes the fixed part, which is in modal form, once, and interpolates
``core`` alone. Nothing is assumed: the spaces are found from the matrices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

_ROUNDING = 1e-11  # of the rows' and columns' own sizes: what transforms to modal states leave
_SWEEPS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Changes:
    """fixed (n + p, n + m), left (n + p, r), core (k, r, q), right (q, n + m): of states and
    errors, to states and currents.
    """

    fixed: np.ndarray
    left: np.ndarray
    core: np.ndarray
    right: np.ndarray

    @property
    def ranks(self) -> tuple[int, int]:
        """r and q."""
        return self.left.shape[1], len(self.right)

    def single(self) -> Self:
        """In numbers that single precision holds."""
        parts = {
            name: np.float32(getattr(self, name)).astype(float)
            for name in ("fixed", "left", "core", "right")
        }
        return replace(self, **parts)

    def tables(self) -> np.ndarray:
        """The whole matrix (k, n + p, n + m) at every grid point."""
        return np.asarray(self.fixed + self.left @ self.core @ self.right)


def changes_of(tables: np.ndarray, beside: np.ndarray) -> Changes:
    """Of the matrices (k, n + p, n + m) at every grid point; beside (n + p, n + m): what of the
    middle one is rounding.
    """
    middle = tables[len(tables) // 2]

    # differences from the middle point, entries of all about 1: rounding is then of one size
    moved = tables - middle
    rows, columns = _sizes(np.abs(tables).max(axis=0))
    scaled = moved / rows[:, None] / columns
    size = _ROUNDING * max(1.0, np.abs(scaled).max(initial=0.0))

    # columns that span those of every difference, and the same of their rows
    left, right = _space(np.hstack(list(scaled)), size), _space(np.vstack(list(scaled)).T, size)

    # moved_i = rows left (left' scaled_i right) right' columns
    return Changes(
        middle - beside, left * rows[:, None], left.T @ scaled @ right, right.T * columns
    )


def _sizes(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """rows (n,) and columns (m,) by whose products the entries of x (n, m), none negative, are at
    most about 1.
    """
    rows, columns = np.ones(len(x)), np.ones(x.shape[1])
    for _ in range(_SWEEPS if x.size else 0):
        for sizes, axis in ((rows, 1), (columns, 0)):
            # half of each row's excess, then half of each column's: the product tends to 1
            largest = (x / rows[:, None] / columns).max(axis=axis)
            np.multiply(sizes, np.sqrt(np.where(largest > 0, largest, 1.0)), out=sizes)
    return rows, columns


def _space(moved: np.ndarray, size: float) -> np.ndarray:
    """Orthonormal columns (n, r) that span those of ``moved`` but for what is smaller than
    ``size``.
    """
    U, s, _ = np.linalg.svd(moved, full_matrices=False)
    return U[:, s > size * np.sqrt(max(moved.shape))]


def beside_blocks(increments: np.ndarray, sizes: tuple[int, ...]) -> np.ndarray:
    """What the matrix (k, n, n) of the middle point has beside blocks of these sizes (n, n), where
    it is rounding; else 0.
    """
    middle = increments[len(increments) // 2]

    # entries between different blocks; where they are more than rounding they stay
    owner = np.repeat(np.arange(len(sizes)), sizes)
    outside = np.where(owner[:, None] == owner, 0.0, middle)
    small = np.abs(outside).max(initial=0.0) <= _ROUNDING * np.abs(middle).max(initial=0.0)
    return outside if small else np.zeros_like(outside)
