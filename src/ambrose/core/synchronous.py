"""Convergent control at one moving frequency: pole shifts, exact poles, and how far a phase may be
off.

A block adds c to a loop and integrates what is left of the signal e at the frequency W, in
coordinates that turn with it (Herzog, Buehler, Gaehler & Larsonneur, IEEE Trans. Control Systems
Technology 4(5), 1996; Knospe, Tamer & Fittro, Mechatronics 5(4), 1995):

    a[k+1] = (1 - leak Ts) a[k] + eps Ts T exp(-j W k Ts) e[k],    c[k] = Re(exp(j W k Ts) a[k])

With w = exp(j W k Ts) a the same block stands still: w[k+1] = exp(j W Ts) ((1 - leak Ts) w + eps Ts
T e), c = Re w. This is a resonator in skew form, linear and time invariant, so that its poles are
exact. Averaged over a turn, with e = -R c and R = R(exp(j W Ts)), a' = -(leak + (eps/2) T R) a:
each eigenvalue of T R with a positive real part is a direction that converges.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigvalsh

from ambrose.core.checks import check_shape, invalid
from ambrose.core.statespace import StateSpace

_DEFINITE = 1e-14  # of a matrix' size: below this a Hermitian part is not called positive
_LEAST = 1e-9  # of the largest gain tried: where the bisection for it ends


@dataclass(frozen=True, slots=True)
class Border:
    """Where a block begins or ends to be stable. value: the frequency [rad/s]; stable_above: beyond
    it.
    """

    value: float
    stable_above: bool


def convergence(T: np.ndarray, R: np.ndarray) -> np.ndarray:
    """The smallest real part of the eigenvalues of T R, (...); positive: stable for every small
    gain.

    T, R (..., n, n) complex. A block whose gain is small is stable if and only if this is positive.
    """
    return np.asarray(np.linalg.eigvals(T @ R).real.min(axis=-1))


def convergence_angle(M: np.ndarray) -> np.ndarray:
    """By how much all phases of M = T R (..., n, n) may be off [rad], (...): pi/2 - max |arg| of
    its eigenvalues.
    """
    return np.asarray(np.pi / 2 - np.abs(np.angle(np.linalg.eigvals(M))).max(axis=-1))


def hermitian(M: np.ndarray) -> np.ndarray:
    """(M + M^H)/2 of every matrix (..., n, n)."""
    return np.asarray((M + M.conj().swapaxes(-1, -2)) / 2)


def sector_angle(M: np.ndarray) -> float:
    """The largest phi [rad] with Herm(exp(+-j phi) M) >= 0; negative where not even Herm(M) is
    positive.

    M (n, n) complex. With M = H + j K and H > 0 the numerical range of M lies in the sector |arg|
    <= atan(max |eig(K, H)|), and touches it. Where H is not positive the angle is that of -pi/2 ...
    0 by which the matrix fails, found from the eigenvalues alone (no proof rests on it).
    """
    H = hermitian(M)
    size = float(np.linalg.norm(M, 2))
    if float(np.linalg.eigvalsh(H)[0]) <= _DEFINITE * size:
        # no sector: by how much the phase of an eigenvalue exceeds pi/2
        farthest = float(np.abs(np.angle(np.linalg.eigvals(M))).max())
        return min(np.pi / 2 - farthest, 0.0)

    # x^H M x = x^H H x + j x^H K x: its phase is at most atan max |x^H K x/x^H H x|.
    K = (M - M.conj().T) / 2j
    return float(np.pi / 2 - np.arctan(np.abs(eigvalsh(K, H)).max()))


def with_resonator(
    loop: StateSpace, T: np.ndarray, frequency: float, gain: float, leak: float = 0.0
) -> np.ndarray:
    """The state matrix of a sampled loop with the block closed around it.

    loop: from the block's c (n) to the signals e (m) that it reads, sampled (m = n: its transfer
    matrix is -R). T (n, m) complex; frequency W [rad/s], gain eps [1/s], leak [1/s]. States: the
    loop's, then Re w, Im w. Raises InvalidInput for a continuous loop or a T of another size.
    """
    return with_resonators(loop, [(T, frequency, gain, leak)])


def with_resonators(
    loop: StateSpace, blocks: Sequence[tuple[np.ndarray, float, float, float]]
) -> np.ndarray:
    """The state matrix of ``around_resonators``."""
    return around_resonators(loop, blocks).A


def around_resonators(
    loop: StateSpace, blocks: Sequence[tuple[np.ndarray, float, float, float]]
) -> StateSpace:
    """A sampled loop with several blocks closed around it, from what is added to their c to the
    signals: (T, frequency, gain, leak) of each, as ``with_resonator`` takes them. States: the
    loop's, then Re w, Im w of each block.
    """
    if loop.dt is None:
        raise invalid("the loop", "continuous", "sampled", "sample it (core.sampling.c2d)")
    n = len(loop.inputs)
    real_part = np.hstack([np.eye(n), np.zeros((n, n))])
    # c = sum of Re w: the blocks' columns side by side, e = C x + D c
    every = np.hstack([real_part] * len(blocks))
    rows, columns = [np.hstack([loop.A, loop.B @ every])], [loop.B]
    for k, (matrix, frequency, gain, leak) in enumerate(blocks):
        T = check_shape(matrix, "T", "(n, m)", n=n, m=len(loop.outputs))
        turn = frequency * loop.dt
        # exp(j W Ts) acts on (Re w, Im w) as a rotation
        rotation = np.kron([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]], np.eye(n))

        # w[k+1] = rotation ((1 - leak Ts) w + eps Ts T e), e = C x + D c: T e is complex, e real
        drive = gain * loop.dt * np.vstack([T.real, T.imag])
        keep = drive @ loop.D @ every
        keep[:, 2 * n * k : 2 * n * (k + 1)] += np.eye(2 * n) * (1 - leak * loop.dt)
        rows.append(rotation @ np.hstack([drive @ loop.C, keep]))
        columns.append(rotation @ drive @ loop.D)
    C = np.hstack([loop.C, loop.D @ every])
    return StateSpace(
        np.vstack(rows), np.vstack(columns), C, loop.D, loop.inputs, loop.outputs, loop.dt
    )


def slowest_pole(
    loop: StateSpace, T: np.ndarray, frequency: float, gain: float, leak: float = 0.0
) -> float:
    """ln|z|/Ts [rad/s] of the outermost pole of ``with_resonator``: negative where all are
    stable.
    """
    A = with_resonator(loop, T, frequency, gain, leak)
    assert loop.dt is not None
    return float(np.log(max(np.abs(np.linalg.eigvals(A)).max(), 1e-300)) / loop.dt)


def largest_gain(
    loop: StateSpace,
    T: np.ndarray,
    frequency: float,
    highest: float,
    tolerance: float = 0.01,
    leak: float = 0.0,
) -> float:
    """The gain eps [1/s] up to which the loop with the block is stable, by bisection on its exact
    poles.

    highest [1/s]: the largest one of interest, which is returned where it is stable. tolerance:
    relative. 0: unstable for the smallest gain tried (1e-9 of the highest). The bisection assumes
    one border between a stable small gain and an unstable large one, which is checked at three
    gains below the one returned.
    """

    return largest_stable(
        lambda gain: slowest_pole(loop, T, frequency, gain, leak) < 0, highest, tolerance
    )


def largest_stable(
    stable: Callable[[float], bool], highest: float, tolerance: float = 0.01
) -> float:
    """The gain up to which a predicate holds, as ``largest_gain`` describes it."""
    if stable(highest):
        low = highest
    else:
        low, high = 0.0, highest
        trial = highest / 10
        while low == 0.0 and trial > _LEAST * highest:  # a stable gain, from above
            if stable(trial):
                low = trial
            else:
                high, trial = trial, trial / 10

        # Bisection of the logarithm: low is stable, high is not.
        while low > 0 and high > (1 + tolerance) * low:
            middle = float(np.sqrt(low * high))
            if stable(middle):
                low = middle
            else:
                high = middle

    # One border is only assumed: where one of three gains below is not stable, the search begins
    # anew below it.
    for share in (0.75, 0.4, 0.1):
        if low and not stable(share * low):
            below = share * low
            return largest_stable(stable, below, tolerance) if below > _LEAST * highest else 0.0
    return low


def borders(
    value: Callable[[float], float], grid: np.ndarray, tolerance: float = 1e-6
) -> tuple[Border, ...]:
    """Where a function of the frequency changes its sign, each root found between two points of a
    grid.

    value: frequency [rad/s] -> the smallest real part (``convergence``). grid (w,): ascending; two
    roots between neighbouring points are not seen. tolerance: relative, of each root.
    """
    from scipy.optimize import brentq

    levels = [value(float(w)) for w in grid]
    speeds = []
    for k in range(len(grid) - 1):
        if (levels[k] > 0) != (levels[k + 1] > 0):
            root = brentq(value, float(grid[k]), float(grid[k + 1]), rtol=tolerance)
            speeds.append(Border(float(root), levels[k + 1] > 0))
    return tuple(speeds)


def best_inverse(responses: np.ndarray, sweeps: int = 60) -> np.ndarray:
    """One T (n, n) of unit size for several R (k, n, n): T R near the identity for all, the worst
    phase best.

    For one R it is R^-1, whose directions all converge alike. For several it starts at the inverse
    of their mean and turns toward those whose sector angle is smallest: weights of the mean rise
    with each member's shortfall (a multiplicative-weights search, not a proof of the optimum). Unit
    size: ||T||_2 = 1.
    """
    R = np.asarray(responses, complex)
    weights = np.ones(len(R)) / len(R)
    best, most = None, -np.inf
    for _ in range(sweeps if len(R) > 1 else 1):
        # each member counts by its direction, not by its size
        mean = np.einsum("k,kij->ij", weights, R / np.linalg.norm(R, 2, axis=(1, 2))[:, None, None])
        T = np.linalg.inv(mean)
        angles = np.array([sector_angle(T @ member) for member in R])
        if angles.min() > most:
            best, most = T, float(angles.min())

        # The members whose sector is narrowest gain most weight.
        weights = weights * np.exp(2.0 * (angles.max() - angles))
        weights /= weights.sum()
    assert best is not None
    return np.asarray(best / np.linalg.norm(best, 2))


def project(amplitude: np.ndarray, limit: float) -> np.ndarray:
    """The amplitudes a (n,) complex, each no larger than the limit, phases kept."""
    size = np.abs(amplitude)
    return np.where(size > limit, amplitude * (limit / np.maximum(size, 1e-300)), amplitude)


def largest_step(
    gain: float, dt: float, size: float, error: float, amplitude: float, frequency: float
) -> float:
    """Bound on |c[k+1] - c[k]|: eps Ts ||T|| |e| of the update, and |a| W Ts of the turning.

    gain eps [1/s], dt [s], size ||T||, error |e|, amplitude |a|, frequency W [rad/s].
    """
    return gain * dt * size * error + amplitude * frequency * dt


# Blocks that move once a turn, in their loop: exact multipliers over a turn.
#
# Over a turn of N samples the amplitude a stands still. With the loop x[k+1] = A x[k] + B c[k],
# s[k] = C x[k] + D c[k], c[k] = Re(e^{j n phi k} a), phi = 2 pi/N, and the mean of what it read
#
#     m = (1/N) sum_k T s[k] e^{-j n phi k}                                                  (1)
#     a+ = (1 - leak t) a + eps t m,    t = N Ts                                             (2)
#
# the state (x, a, m) at the end of a turn is linear in that at its begin: x and m are driven by x
# and the a that (2) has just made. The loop is stable where all multipliers lie within the unit
# circle. Everything but (2) is independent of eps and computed once.


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
