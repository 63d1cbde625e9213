"""A block that moves once a turn, in its loop: exact multipliers over a turn.

Over a turn of N samples the amplitude a stands still. With the loop x[k+1] = A x[k] + B c[k],
s[k] = C x[k] + D c[k], c[k] = Re(e^{j n phi k} a), phi = 2 pi/N, and the mean of what it read

    m = (1/N) sum_k T s[k] e^{-j n phi k}                                                  (1)
    a+ = (1 - leak t) a + eps t m,    t = N Ts                                             (2)

the state (x, a, m) at the end of a turn is linear in that at its begin: x and m are driven by x and
the a that (2) has just made. The loop is stable where all multipliers lie within the unit circle.
Everything but (2) is independent of eps and computed once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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

    def multipliers(self, gain: float, leak: float = 0.0) -> np.ndarray:
        """Of the state (x, a, m) over a turn; gain eps and leak [1/s]."""
        n, a = len(self.x_by_x), len(self.m_by_a)
        keep, learn = (1 - leak * self.time) * np.eye(a), gain * self.time * np.eye(a)
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
    assert loop.dt is not None
    samples = int(np.clip(round(2 * np.pi / (speed * loop.dt)), 2 * harmonic + 1, _MOST))
    n, a = len(loop.A), T.shape[0]
    # columns: unit states, then unit real and imaginary parts of a
    x = np.hstack([np.eye(n), np.zeros((n, 2 * a))])
    total = np.zeros((a, n + 2 * a), complex)
    for k in range(samples):
        turn = np.exp(2j * np.pi * harmonic * k / samples)
        c = np.zeros((a, n + 2 * a))
        c[:, n : n + a] = turn.real * np.eye(a)
        c[:, n + a :] = -turn.imag * np.eye(a)
        total += (T @ (loop.C @ x + loop.D @ c)) * np.conj(turn)
        x = loop.A @ x + loop.B @ c
    mean = total / samples
    m = np.vstack([mean.real, mean.imag])
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
