"""Blocks that move once a turn, in their loop: exact multipliers over a turn.

Over a turn of N samples the amplitude a stands still. With the loop x[k+1] = A x[k] + B c[k],
s[k] = C x[k] + D c[k], c[k] = Re(e^{j n phi k} a), phi = 2 pi/N, and the mean of what it read

    m = (1/N) sum_k T s[k] e^{-j n phi k}                                                  (1)
    a+ = (1 - leak t) a + eps t m,    t = N Ts                                             (2)

the state (x, a, m) at the end of a turn is linear in that at its begin: x and m are driven by x and
the a that (2) has just made. The loop is stable where all multipliers lie within the unit circle.
Everything but (2) is independent of eps and computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.statespace import StateSpace
from ambrose.core.synchronous import largest_stable

_MOST = 20_000  # samples of a turn; slower turning is taken as at that many


@dataclass(frozen=True, slots=True, eq=False)
class TurnMap:
    """x and m (real parts, then imaginary ones) at the end of a turn of ``time`` [s] from x at its
    begin and from a, real.
    """

    x_by_x: np.ndarray
    x_by_a: np.ndarray
    m_by_x: np.ndarray
    m_by_a: np.ndarray
    time: float

    def multipliers(self, gain: ArrayLike, leak: ArrayLike = 0.0) -> np.ndarray:
        """Of the state (x, a, m) over a turn; gain eps and leak [1/s], of each block or of all."""
        n, a = len(self.x_by_x), len(self.m_by_a)
        # of every block's real and imaginary parts
        eps, leaks = (np.repeat(np.atleast_1d(v), a // np.atleast_1d(v).size) for v in (gain, leak))
        keep, learn = np.diag(1 - leaks * self.time), np.diag(eps * self.time)
        # a+ = keep a + learn m first; x+ = X x + Xa a+,  m+ = M x + Ma a+
        whole = np.block(
            [
                [self.x_by_x, self.x_by_a @ keep, self.x_by_a @ learn],
                [np.zeros((a, n)), keep, learn],
                [self.m_by_x, self.m_by_a @ keep, self.m_by_a @ learn],
            ]
        )
        return np.asarray(np.linalg.eigvals(whole))


def turn_map(loop: StateSpace, T: np.ndarray, speed: float, harmonic: int = 1) -> TurnMap:
    """The map of a sampled loop from c to what the block reads, T (a, m) complex.

    speed [rad/s]: of the rotor; its turn is taken as the nearest whole number of samples.
    """
    return turn_map_of(loop, [(T, harmonic)], speed)


def turn_map_of(
    loop: StateSpace, blocks: Sequence[tuple[np.ndarray, int]], speed: float
) -> TurnMap:
    """The same with several blocks on at once, (T, harmonic) of each; a and m are theirs below each
    other.
    """
    assert loop.dt is not None
    highest = max(harmonic for _, harmonic in blocks)
    samples = int(np.clip(round(2 * np.pi / (speed * loop.dt)), 2 * highest + 1, _MOST))
    n, a = len(loop.A), len(loop.inputs)
    width = n + 2 * a * len(blocks)
    # columns: unit states, then unit real and imaginary parts of every a
    x = np.eye(n, width)
    one = np.eye(a)
    totals = [np.zeros((a, width), complex) for _ in blocks]
    for k in range(samples):
        turns = [np.exp(2j * np.pi * harmonic * k / samples) for _, harmonic in blocks]
        parts = [part for turn in turns for part in (turn.real * one, -turn.imag * one)]
        c = np.hstack([np.zeros((a, n)), *parts])
        s = loop.C @ x + loop.D @ c
        totals = [
            total + (T @ s) * np.conj(turn)
            for total, turn, (T, _) in zip(totals, turns, blocks, strict=True)
        ]
        x = loop.A @ x + loop.B @ c
    m = np.vstack([part for total in totals for part in (total.real, total.imag)]) / samples
    return TurnMap(x[:, :n], x[:, n:], m[:, :n], m[:, n:], samples * loop.dt)


def largest_turn_gain(
    loop: StateSpace,
    T: np.ndarray,
    speed: float,
    highest: float,
    tolerance: float = 0.01,
    leak: float = 0.0,
    harmonic: int = 1,
) -> float:
    """The gain eps [1/s] up to which a block that moves once a turn is stable; as
    ``core.synchronous.largest_gain``.
    """
    over = turn_map(loop, T, speed, harmonic)
    return largest_stable(
        lambda gain: bool(np.abs(over.multipliers(gain, leak)).max() < 1), highest, tolerance
    )
