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

They are also the derivatives dz/d e^{lambda_i T}. The rule:

- Where the modes above half the sample rate take more part in a pole than all else together, Re
  sum p_i > 1/2, that is |sum p_i| > |1 - sum p_i|, it belongs to that one of them, lambda_i, which
  takes the largest part. Its own place is s = log(z)/T + 2 pi j k/T on the branch of lambda_i.
- A pole that the loop has not moved from there by more than half of the mode's own decay, |s -
  lambda_i| <= |Re lambda_i|/2, is read there: it is the plant's mode, as damped as without control.
- One that the loop has moved by more stays within half the sample rate, where the controller sees
  it and answers: what the loop does to it is judged, not hidden. Unless it is unstable: then it
  is read at its own place again, for a verdict should name the mode that is lost.

The real part ln|z|/T, which decides stability, is the same on every branch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import check_finite, check_positive, check_shape, named_failure
from ambrose.core.statespace import balance_matrix as balance

# |z| below which a pole is overdamped wherever it is read: -ln 0.001 is 2.2 times pi
_DEEP = 1e-3
_COINCIDE = 1e-6  # of the largest modulus: so near, left and right eigenvectors are not paired
_HALF = 0.5  # of a pole, and of a mode's decay: see the rule above


@dataclass(frozen=True, slots=True, eq=False)
class FastModes:
    """A plant's modes above half the sample rate, as parts of the state of a loop around it.

    dt [s]: the sample time; poles (h,) [rad/s] of the continuous plant, both of every pair; right
    (n, h) and left (h, n): their eigenvectors in the loop's first n states, left @ right = I.
    """

    dt: float
    poles: np.ndarray
    right: np.ndarray
    left: np.ndarray

    def read(
        self, values: np.ndarray, vectors: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which poles are read at these modes' frequencies (k,), and all where they are read (k,)
        [rad/s], by the rule of this file's head.

        values (k,): log(z)/dt of poles of a loop; vectors (N, k) and rows (k, N): their right and
        left eigenvectors, rows @ vectors = I.
        """
        # participations (k, h)
        n = len(self.right)
        part = (rows[:, :n] @ self.right) * (self.left @ vectors[:n]).T
        theirs = self.poles[np.abs(part).argmax(axis=1)]

        # s = log(z)/T + 2 pi j k/T with the k that comes nearest to the mode
        turns = np.rint((theirs.imag - values.imag) * self.dt / (2 * np.pi))
        s = values + 2j * np.pi * turns / self.dt
        kept = np.abs(s - theirs) <= _HALF * np.abs(theirs.real)
        at_mode = (part.sum(axis=1).real > _HALF) & (kept | (s.real >= 0))

        # a pole on the real axis stands for e^{j 2 pi k/T} and for its conjugate alike
        s = np.where((values.imag == 0) & (s.imag < 0), s.conj(), s)
        return at_mode, np.where(at_mode, s, values)

    def scaled(self, t: np.ndarray) -> FastModes:
        """The same for states x_s with x = diag(t) x_s, t (n,)."""
        return FastModes(self.dt, self.poles, self.right / t[:, None], self.left * t)

    def behind(self, count: int) -> FastModes:
        """The same in a loop that has ``count`` other states before the plant's."""
        right = np.pad(self.right, ((count, 0), (0, 0)))
        return FastModes(self.dt, self.poles, right, np.pad(self.left, ((0, 0), (count, 0))))


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
    right = right[:, fast]
    left = _divided(values[fast], left[:, fast].conj().T, right)
    return FastModes(dt, values[fast], right * t[:, None], left / t)


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
            values = logarithm(values, dt)
        return values, vectors * t[:, None]
    z, left, vectors = sla.eig(A, left=True)
    values = logarithm(z, dt)

    # Rows of the left eigenvectors, left @ vectors = I; those of delays, which hardly divide, are
    # left out: they are read alike on every branch.
    shallow = np.flatnonzero(np.abs(z) > _DEEP)
    right = vectors[:, shallow]
    rows = _divided(z[shallow], left[:, shallow].conj().T, right)
    _, values[shallow] = fast.scaled(t[: len(fast.right)]).read(values[shallow], right, rows)
    return values, vectors * t[:, None]


def logarithm(z: np.ndarray, dt: float) -> np.ndarray:
    """log(z)/dt [rad/s] within half the sample rate; z = 0 (a delay) far to the left."""
    return np.asarray(np.log(np.where(z == 0, np.finfo(float).tiny, z)) / dt)


def _divided(values: np.ndarray, rows: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Left eigenvectors (k, N) divided so that rows @ right = I, right (N, k)."""
    # rows @ right is diagonal but where eigenvalues coincide, as those of two planes alike
    near = np.abs(values[:, None] - values) <= _COINCIDE * np.abs(values).max(initial=0.0)
    alone = near.sum(axis=1) == 1
    rows = rows.copy()
    rows[alone] /= np.einsum("ki,ik->k", rows[alone], right[:, alone])[:, None]
    if not alone.all():
        groups = rows[~alone] @ right[:, ~alone]
        try:
            rows[~alone] = np.linalg.solve(groups, rows[~alone])
        except np.linalg.LinAlgError:
            rows[~alone] = np.linalg.pinv(groups) @ rows[~alone]
    return rows


# What no linear controller can do: the least sensitivity that unstable poles and a delay in the
# loop allow.
#
# The output sensitivity S vanishes on the plant's unstable poles, S = S_1 B with B inner, and S - I
# carries the loop's delay e^{-s tau}. Hence S_1 = B^{-1} up to what is later than tau, and the
# least norm of S is that of the unstable all-pass B^{-1} acting on L2[0, tau] (Sarason 1967; Zhou &
# Khargonekar 1987; Foias, Oezbay & Tannenbaum 1996). It is attained in the limit where the rest of
# the plant can be inverted, and a lower bound everywhere.


_CELLS = 24  # of [0, tau]; with twice as many, extrapolated: 1e-5 at p tau = 1
_MARGINAL = 1e-6  # of the largest pole: slower ones bind nothing, and count as stable
_BEYOND = 20.0  # p tau from which the limit, some e^{p tau}, is called infinite


@named_failure("the least sensitivity")
def least_sensitivity(A: ArrayLike, C: ArrayLike, delay: float) -> float:
    """The infimum of ||S||_inf over all controllers of a plant with dynamics A (n, n), measurements
    C (m, n) and ``delay`` [s].

    S = (I + G K)^-1 on the m measurements; stable poles of A drop out. 1 without unstable poles or
    delay; for one real pole p e^{p tau}. inf where an unstable motion shows in no measurement.
    Raises InvalidInput.
    """
    a, c = check_shape(A, "A", "(n, n)"), check_finite(C, "C")
    check_positive(delay, "the delay [s]", "zero is none", zero_allowed=True)
    floor = _MARGINAL * max(np.abs(np.linalg.eigvals(a)).max(initial=0.0), 1e-300)

    # The unstable part to the front: leading Schur vectors are invariant, stable poles drop out.
    T, Q, count = sla.schur(a, output="real", sort=lambda re, im: re > floor)
    if count == 0 or delay == 0:
        return 1.0
    a, c = T[:count, :count], c @ Q[:, :count]
    if np.linalg.eigvals(a).real.max() * delay > _BEYOND:
        return float("inf")

    # The inner factor's inverse from the observability of the unstable part (-A is stable).
    observability = sla.solve_continuous_lyapunov(a.T, c.T @ c)  # A^T W + W A = C^T C
    size = np.linalg.eigvalsh((observability + observability.T) / 2)

    # W singular: an unstable motion that shows in no measurement.
    if size[0] <= 1e-13 * size[-1]:
        return float("inf")
    b = np.linalg.solve(observability, c.T)  # B^{-1}(s) = I + C (s - A)^{-1} B is all-pass

    # The error falls with the cell's width squared: extrapolated from two grids (Richardson).
    coarse, fine = (
        _truncated_norm(a, b, c, delay, _CELLS),
        _truncated_norm(a, b, c, delay, 2 * _CELLS),
    )
    return float(fine + (fine - coarse) / 3)


def _truncated_norm(A: np.ndarray, B: np.ndarray, C: np.ndarray, delay: float, cells: int) -> float:
    """The norm of I + C (s - A)^{-1} B between functions on [0, delay] that are constant on equal
    cells: from below.
    """
    n = len(A)
    m = len(C)
    h = delay / cells
    zero, one = np.zeros((n, n)), np.eye(n)
    E = sla.expm(h * np.block([[A, one, zero], [zero, zero, one], [zero, zero, zero]]))
    # e^{A h}, its integral, and the integral of that
    step = E[:n, :n]
    once = E[:n, n : 2 * n]
    twice = E[:n, 2 * n :]

    # Unit functions 1/sqrt(h) on a cell. The kernel I delta(t) + C e^{A t} B averaged from cell 0
    # to cell i:
    # i = 0: I + C twice B/h,   i > 0: C once e^{A h (i - 1)} once B/h
    column = [np.eye(m) + C @ twice @ B / h]
    state = once @ B
    for _ in range(cells - 1):
        column.append(C @ once @ state / h)
        state = step @ state

    # Causal and the same from every cell: block lower triangular Toeplitz.
    whole = np.zeros((cells, m, cells, m))
    for i in range(cells):
        for j in range(i + 1):
            whole[i, :, j] = column[i - j]
    return float(np.linalg.norm(whole.reshape(cells * m, cells * m), 2))
