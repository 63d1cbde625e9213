"""A system in real block-diagonal form: every state couples only with those whose poles it cannot
be told from.

A dense state matrix costs n^2 products a step and spreads the rounding of one coefficient over all
poles. In modal form a single pole is a block of one state, a complex pair a rotation of two, and
poles so near each other that separating them would need large, cancelling transforms stay together
(Bavely & Stewart 1979, SIAM J. Numer. Anal. 16, 359-367).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure, named_failure
from ambrose.core.realisation.balancing import balance_system
from ambrose.core.statespace import StateSpace, as_statespace

_GROWTH = 1e4  # largest entry of a transform that separates two blocks
_RESIDUAL = 1e-9  # relative, of A X = X T and of Y X = I


@dataclass(frozen=True, slots=True, eq=False)
class ModalForm:
    """``system`` has a block-diagonal A with blocks of ``sizes`` (they add up to n); complex pairs
    are [[a, b], [-b, a]].
    """

    system: StateSpace
    sizes: tuple[int, ...]

    @property
    def starts(self) -> tuple[int, ...]:
        """The first state of every block."""
        return tuple(int(i) for i in np.cumsum([0, *self.sizes])[:-1])


@named_failure("the modal form")
def modal_form(system: Any, growth: float = _GROWTH) -> ModalForm:
    """``system`` in real block-diagonal coordinates, slow blocks first; inputs, outputs and sample
    time are kept.

    A transform that separates two blocks has entries up to ``growth``, so that at most 4 digits are
    lost; beyond, the blocks stay one. Raises NumericalFailure when the transform does not give the
    system back to 1e-9.
    """
    system = as_statespace(system)
    n = system.n_states
    if n == 0:
        return ModalForm(system, ())
    A, B, C, _ = balance_system(system.A, system.B, system.C)
    T, X = sla.schur(A, output="real")

    # A X = X T and Y X = I are checked: X and Y were built up side by side, without an inverse.
    T, X, Y, sizes = _separated(T, X, growth)
    size = np.abs(A).max()
    if (
        not np.abs(A @ X - X @ T).max() <= _RESIDUAL * size * np.abs(X).max()
        or not np.abs(Y @ X - np.eye(n)).max() <= _RESIDUAL
    ):
        raise NumericalFailure(
            f"the modal form of a system with {n} states misses its matrix by more than "
            f"{_RESIDUAL:g}; "
            "reduce the controller's order"
        )

    # Scaled block by block, which leaves T block-diagonal.
    t = np.ones(n)
    start = 0
    for k in sizes:
        _scale_block(T, Y @ B, C @ X, t, slice(start, start + k))
        start += k
    T = T * t / t[:, None]
    B = (Y @ B) / t[:, None]
    C = (C @ X) * t
    order, sizes = _slow_first(T, sizes, system.dt)
    T = T[np.ix_(order, order)]
    B = B[order]
    C = C[:, order]
    return ModalForm(StateSpace(T, B, C, system.D, system.inputs, system.outputs, system.dt), sizes)


def _separated(
    T: np.ndarray, X: np.ndarray, growth: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, tuple[int, ...]]:
    """The real Schur form T (n, n) with vectors X made block-diagonal: T, X, X^-1 and the sizes."""
    T, X, Y = T.copy(), X.copy(), X.T.copy()
    n, start = len(T), 0
    sizes: list[int] = []
    while start < n:
        end = start + _first_block(T, start)
        while end < n:
            # The block start..end and all that follows: T11 R - R T22 = -T12 makes T12 zero.
            R = _separator(T, start, end)
            if R is not None and np.abs(R).max() <= growth:
                # X [I R; 0 I] and [I -R; 0 I] Y
                X[:, end:] += X[:, start:end] @ R
                Y[start:end] -= R @ Y[end:]
                T[start:end, end:] = 0.0
                break

            # R too large: the block grows by the nearest pole of the rest.
            end = _take_nearest(T, X, Y, start, end)
        sizes.append(end - start)
        start = end
    return T, X, Y, tuple(sizes)


def _first_block(T: np.ndarray, i: int) -> int:
    return 2 if i + 1 < len(T) and T[i + 1, i] != 0 else 1


def _separator(T: np.ndarray, start: int, end: int) -> np.ndarray | None:
    """R with T11 R - R T22 = -T12; None where the two share a pole."""
    T11 = T[start:end, start:end]
    T12 = T[start:end, end:]
    T22 = T[end:, end:]
    if not T12.any():
        return np.zeros_like(T12)
    X, scale, info = sla.lapack.dtrsyl(T11, T22, -T12, isgn=-1)
    if info != 0 or not scale > 0 or not np.isfinite(X).all():
        return None
    return X / scale


def _take_nearest(T: np.ndarray, X: np.ndarray, Y: np.ndarray, start: int, end: int) -> int:
    """Move the block whose pole is nearest to those of start..end next to them, in place; the new
    end.
    """
    # Blocks of T22, of one or two states each.
    eigenvalues = np.linalg.eigvals(T[start:end, start:end])
    rest = T[end:, end:]
    best = np.inf
    at = 0
    i = 0
    while i < len(rest):
        k = _first_block(rest, i)
        distance = np.abs(
            np.linalg.eigvals(rest[i : i + k, i : i + k])[:, None] - eigenvalues
        ).min()
        if distance < best:
            best, at = distance, i
        i += k

    # T22 = Q moved Q^T, the block now first; T12, X and Y turn with it.
    moved, Q, info = sla.lapack.dtrexc(rest, np.eye(len(rest)), at + 1, 1)
    if info != 0:
        raise NumericalFailure(
            "two poles of the controller are too near each other to be reordered; reduce its order"
        )
    T[end:, end:] = moved
    T[:end, end:] = T[:end, end:] @ Q
    X[:, end:] = X[:, end:] @ Q
    Y[end:] = Q.T @ Y[end:]
    return end + _first_block(T, end)


def _scale_block(T: np.ndarray, B: np.ndarray, C: np.ndarray, t: np.ndarray, block: slice) -> None:
    """Factors t of the block's states: a pair becomes a rotation, and the block is as large from
    the input as to the output.
    """
    i = block.start
    if block.stop - i == 2 and T[i, i + 1] * T[i + 1, i] < 0:
        # a pair [[a, b], [c, a]], b c < 0: t_2/t_1 = sqrt(-c/b) makes the two couplings equal
        t[i + 1] = np.sqrt(-T[i + 1, i] / T[i, i + 1])

    # One power of two for the whole block: exact, and a rotation stays one.
    gain_in, gain_out = (
        np.linalg.norm(B[block] / t[block, None]),
        np.linalg.norm(C[:, block] * t[block]),
    )
    if gain_in > 0 and gain_out > 0:
        t[block] *= np.exp2(np.round(0.5 * np.log2(gain_in / gain_out)))


def _slow_first(
    T: np.ndarray, sizes: tuple[int, ...], dt: float | None
) -> tuple[np.ndarray, tuple[int, ...]]:
    starts = np.cumsum([0, *sizes])[:-1]
    rates = []
    for start, k in zip(starts, sizes, strict=True):
        poles = np.linalg.eigvals(T[start : start + k, start : start + k])

        # sampled: |z - 1|, small for slow poles
        rates.append(np.abs(poles if dt is None else poles - 1).max())
    order = np.argsort(rates, kind="stable")
    states = np.concatenate([np.arange(starts[k], starts[k] + sizes[k]) for k in order])
    return states, tuple(sizes[k] for k in order)
