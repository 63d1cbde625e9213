"""What the structured singular value needs to know about a list of blocks: where each one sits, and
how to balance M.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import InvalidInput, check_finite, invalid
from ambrose.core.lft import Block, ComplexBlock, FullBlock, RealBlock

_SWEEPS = 30  # Osborne iterations; each is one pass over all groups


@dataclass(frozen=True, slots=True)
class Place:
    """One block, the rows of w and the rows of z it owns."""

    block: Block
    w: slice
    z: slice


@dataclass(frozen=True, slots=True)
class Structure:
    """The blocks in order, w = Delta z. ``places`` has one entry per block; n_w, n_z are the
    totals.
    """

    places: tuple[Place, ...]
    n_w: int
    n_z: int

    @property
    def real(self) -> tuple[Place, ...]:
        return tuple(place for place in self.places if isinstance(place.block, RealBlock))

    @property
    def complex(self) -> tuple[Place, ...]:
        return tuple(place for place in self.places if not isinstance(place.block, RealBlock))


def structure_of(blocks: Sequence[Block]) -> Structure:
    """The places of ``blocks``. Raises InvalidInput when the list is empty or holds something else
    than blocks.
    """
    blocks = list(blocks)
    if not blocks:
        raise InvalidInput(
            "the list of blocks is empty; give at least one RealBlock, ComplexBlock or FullBlock"
        )
    places = []
    i = 0
    j = 0
    for block in blocks:
        if not isinstance(block, RealBlock | ComplexBlock | FullBlock):
            raise invalid(
                "a block",
                repr(block),
                "a RealBlock, ComplexBlock or FullBlock",
                "see ambrose.core.lft",
            )
        places.append(Place(block, slice(i, i + block.n_w), slice(j, j + block.n_z)))
        i, j = i + block.n_w, j + block.n_z
    return Structure(tuple(places), i, j)


def check_matrix(M: ArrayLike, structure: Structure) -> np.ndarray:
    """``M`` as a complex array (..., n_z, n_w). Raises InvalidInput naming both sizes when the
    blocks do not fit, or on NaN.
    """
    M = check_finite(M, "M")
    if M.ndim < 2 or M.shape[-2:] != (structure.n_z, structure.n_w):
        listed = ", ".join(
            f"{place.block.name} {place.block.n_z} x {place.block.n_w}"
            for place in structure.places
        )
        raise invalid(
            "the shape of M",
            M.shape,
            f"(..., {structure.n_z}, {structure.n_w}), from the blocks' z and w sizes ({listed})",
            "M maps w to z: one column per input w = Delta z, one row per output z; list the "
            "blocks in that order",
        )
    return M.astype(complex)


def channel_groups(structure: Structure) -> tuple[np.ndarray, np.ndarray]:
    """Which channel is in which of Osborne's groups, (groups, n_w), (groups, n_z): full blocks
    whole, other channels alone.
    """
    w_group = []
    z_group = []
    count = 0
    for place in structure.places:
        block = place.block
        if isinstance(block, FullBlock):
            w_group += [count] * block.n_w
            z_group += [count] * block.n_z
            count += 1
        else:
            w_group += range(count, count + block.repeat)
            z_group += range(count, count + block.repeat)
            count += block.repeat
    numbers = np.arange(count)[:, None]
    return (numbers == np.array(w_group)).astype(float), (numbers == np.array(z_group)).astype(
        float
    )


def osborne(M: np.ndarray, structure: Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Diagonal scalings that even out the off-diagonal blocks: M' = diag(d_z) M diag(1/d_w), d_z
    (b, n_z), d_w (b, n_w).

    Osborne's iteration on Frobenius norms (Osborne 1960). Norms are floored at 1e-9 of the largest,
    so that a reducible M gives finite scalings. M (b, n_z, n_w).
    """
    # N_gj = |M_gj|^2, Frobenius, between the groups; M over its largest entry
    P_w, P_z = channel_groups(structure)
    groups = len(P_w)
    top = np.abs(M).max(axis=(1, 2), keepdims=True)
    N = P_z @ (np.abs(M / np.where(top > 0, top, 1.0)) ** 2) @ P_w.T
    log_d = np.zeros((len(M), groups))  # log of d squared
    off = ~np.eye(groups, dtype=bool)
    for _ in range(_SWEEPS if groups > 1 else 0):
        before = log_d.copy()
        for g in range(groups):
            # weight_j = d_j^2 / d_g^2
            weight = np.exp(np.clip(log_d - log_d[:, g : g + 1], -600, 600))
            row = (N[:, g, :] / weight)[:, off[g]].sum(axis=1)  # |d_g M_gj / d_j|^2
            column = (N[:, :, g] * weight)[:, off[g]].sum(axis=1)

            # d_g^2 times f gives row f and column / f: equal for f = sqrt(column / row)
            floor = 1e-18 * (N[:, g, g] + row + column) + 1e-200
            log_d[:, g] -= 0.5 * np.log((row + floor) / (column + floor))
        if np.abs(log_d - before).max(initial=0.0) < 1e-2:
            break

    # A common factor of all d changes nothing: their geometric mean is 1.
    log_d -= log_d.mean(axis=1, keepdims=True)
    d = np.exp(0.5 * np.clip(log_d, -100, 100))  # a ratio of 1e43: its square, in X, stays in range
    d_z, d_w = d @ P_z, d @ P_w
    return d_z[:, :, None] * M / d_w[:, None, :], d_z, d_w
