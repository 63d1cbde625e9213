"""Poles of a sampled loop, read as those of the motion between its samples.

A pole z of a sampled loop stands for e^{s T}, but so does every s + 2 pi j k/T: log(z)/T alone is
the branch within half the sample rate. A rotor on its full model has modes far above that. A mode
at 10 199 Hz, sampled at 10 kHz, would be read as one at 199 Hz, and its real part as the damping
of a mode fifty times slower.

The plant tells the branch. Let x' = A x be the continuous plant, x first among the loop's states,
with right and left eigenvectors r_i, l_i (l_i r_j = 1 for i = j, else 0), and v, w those of a pole
z of the loop, w v = 1. The participation of the plant's mode i in the pole is

    p_i = (w_x r_i)(l_i v_x),

which no scaling and no choice of states changes; over the plant's modes and the controller's
states the participations of a pole add up to 1 (Perez-Arriaga, Verghese & Schweppe 1982).

The rule: where the plant's modes above half the sample rate take more part in a pole than all else
together, Re sum p_i > 1/2, that is |sum p_i| > |1 - sum p_i|, the motion is theirs, and the pole
is s = log(z)/T + 2 pi j k/T on the branch of that one of them that takes the largest part. All
other poles stay on the first branch. So does every pole that the loop has made as much its own as
the plant's: nothing is hidden, and no pole leaves its place for a frequency it does not share. The
real part ln|z|/T, which decides stability, is the same on every branch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.statespace import balance

# |z| below which a pole is overdamped wherever it is read: -ln 0.001 is 2.2 times pi
_DEEP = 1e-3
_HALF = 0.5  # of a pole: see the rule above


@dataclass(frozen=True, slots=True, eq=False)
class FastModes:
    """A plant's modes above half the sample rate, as parts of the state of a loop around it.

    poles (h,) [rad/s] of the continuous plant, both of every pair; right (n, h) and left (h, n):
    their eigenvectors in the loop's first n states, left @ right = I.
    """

    poles: np.ndarray
    right: np.ndarray
    left: np.ndarray

    def participation(self, vectors: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """p (k, h) of every mode in every pole of a loop with the right eigenvectors ``vectors``
        (N, k) and the left ones ``rows`` (k, N), rows @ vectors = I.
        """
        n = len(self.right)
        return np.asarray((rows[:, :n] @ self.right) * (self.left @ vectors[:n]).T)

    def own(self, vectors: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Which poles are these modes' (k,), by the rule of this file's head."""
        return np.asarray(self.participation(vectors, rows).sum(axis=1).real > _HALF)

    def scaled(self, t: np.ndarray) -> FastModes:
        """The same for states x_s with x = diag(t) x_s, t (n,)."""
        return FastModes(self.poles, self.right / t[:, None], self.left * t)


def fast_modes(A: np.ndarray, dt: float) -> FastModes | None:
    """The modes of the continuous plant x' = A x (n, n) beyond pi/dt [rad/s]; None without any."""
    # the largest frequency is no larger than the norm of A's skew part (Bendixson)
    balanced, t = balance(A)
    if np.linalg.norm(balanced - balanced.T) / 2 <= np.pi / dt:
        return None
    values, left, right = sla.eig(balanced, left=True)
    fast = np.abs(values.imag) > np.pi / dt
    if not fast.any():
        return None
    right, left = right[:, fast], left[:, fast].conj().T

    # left @ right is diagonal but for modes that coincide, as those of two planes alike
    left = _divided(left @ right, left)
    return FastModes(values[fast], right * t[:, None], left / t)


def continuous_poles(
    A: np.ndarray, dt: float | None = None, plant: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Poles (N,) [rad/s] of a loop A (N, N) and its eigenvectors (N, N); those of a loop sampled
    every dt [s] as the rule of this file's head reads them, one at z = 0 (a delay) far to the left.

    plant (n, n): A of the continuous system that a sampled loop was closed around, whose states are
    the loop's first; None: every pole is read within half the sample rate.
    """
    # x = diag(t) x_s: the same eigenvalues, eigenvectors t times those of the balanced matrix
    A, t = balance(A)
    fast = None if dt is None or plant is None else fast_modes(plant, dt)
    if dt is None or fast is None:
        values, vectors = sla.eig(A)
        if dt is not None:
            values = _logarithm(values, dt)
        return values, vectors * t[:, None]
    z, left, vectors = sla.eig(A, left=True)
    values = _logarithm(z, dt)

    # Rows of the left eigenvectors, left @ vectors = I; those of delays, which hardly divide, are
    # left out: they are read alike on every branch.
    shallow = np.flatnonzero(np.abs(z) > _DEEP)
    right, rows = vectors[:, shallow], left[:, shallow].conj().T
    rows = _divided(rows @ right, rows)
    part = fast.scaled(t[: len(fast.right)]).participation(right, rows)
    own = part.sum(axis=1).real > _HALF
    nearest = fast.poles[np.abs(part[own]).argmax(axis=1)]

    # s = log(z)/T + 2 pi j k/T with the k that comes nearest to the plant's mode
    turns = np.rint((nearest.imag - values[shallow[own]].imag) * dt / (2 * np.pi))
    moved = values[shallow[own]] + 2j * np.pi * turns / dt

    # A pole on the real axis stands for e^{j 2 pi k/T} and for its conjugate alike.
    single = z[shallow[own]].imag == 0
    values[shallow[own]] = np.where(single & (moved.imag < 0), moved.conj(), moved)
    return values, vectors * t[:, None]


def _logarithm(z: np.ndarray, dt: float) -> np.ndarray:
    return np.asarray(np.log(np.where(z == 0, np.finfo(float).tiny, z)) / dt)


def _divided(matrix: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """matrix^-1 rows, by its pseudo-inverse where eigenvectors coincide."""
    try:
        return np.asarray(np.linalg.solve(matrix, rows))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(matrix) @ rows)
