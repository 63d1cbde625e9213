"""Sampled time responses, exact at the samples, and their parameter derivatives.

Inputs are held between samples (zero-order hold) or follow a polynomial in each interval; nothing
is interpolated behind the caller's back. Long records are computed in blocks of L samples by the
lifted system (Chen & Francis 1995, ch. 8)

    x[k+L] = A^L x[k] + R u_block,    y_block = O x[k] + T u_block,

so that nearly all work is matrix times matrix and the sequential part is one product with A^L per
block. No eigenvectors are formed: defective and badly conditioned systems are as exact as any
other.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from math import ceil, comb, factorial, log2
from typing import Any

import numpy as np
import scipy.linalg as sla
from numpy.typing import ArrayLike

from ambrose.core.checks import (
    InvalidInput,
    NumericalFailure,
    check_positive,
    check_shape,
    invalid,
    same_clock,
)
from ambrose.core.statespace import StateSpace, as_statespace, balance_matrix as balance

_CHUNK = 2_000_000  # numbers held for one batch of blocks: 16 MB, whatever the record length
_DOUBLINGS = 6  # blocks of 64 samples of a free response
_LIFTED = 8_000_000  # numbers allowed in the matrices of the lifted system: 64 MB
# of the diagonal Pade approximant of degree 13 of exp: (26 - j)! 13! / (26! (13 - j)! j!); exact to
# rounding, its derivative too, up to this 1-norm (Al-Mohy & Higham 2009, table 6.1)
_PADE = [comb(13, j) * factorial(26 - j) / factorial(26) for j in range(14)]
_PADE_SIZE = 4.74
_FINITE = (
    "the system is unstable over this record; shorten it, or stop at a limit as "
    "simulate.linear.run does"
)


@dataclass(frozen=True, slots=True, eq=False)
class SystemDerivative:
    """d/dtheta of the four matrices of a StateSpace for one parameter: A (n, n), B (n, m), C (p,
    n), D (p, m).
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray


def simulate(
    system: Any, u: ArrayLike, dt: float | None = None, x0: ArrayLike | None = None
) -> np.ndarray:
    """The outputs y (p, k) at the samples for inputs u (m, k), each held until the next sample.

    dt [s]: needed for a continuous system, which is then sampled exactly; None or the same for a
    sampled one. x0 (n,): the state at the first sample, default zero. Raises InvalidInput, and
    NumericalFailure when an unstable response overflows.
    """
    sampled, t = _sampled(system, dt)
    u = check_shape(u, "u", "(m, k)", m=len(sampled.inputs)).astype(float)
    y, _ = _respond(sampled, u, _start(x0, sampled.n_states) / t)
    return y


def pulses(system: StateSpace, amplitude: float, length: int, samples: int) -> np.ndarray:
    """The outputs (m, p, k) of a sampled system that starts from rest, for a pulse on each of its m
    inputs in turn: ``amplitude`` for ``length`` samples of all k = ``samples``.

    Raises NumericalFailure when an unstable response overflows.
    """
    A, C = system.A, system.C
    p, m = system.D.shape
    # a column for each input
    x = np.zeros((len(A), m))
    y = np.empty((p, m, samples))
    length = min(length, samples)
    with np.errstate(over="ignore", invalid="ignore"):
        for i in range(length):
            y[:, :, i] = C @ x + amplitude * system.D
            x = A @ x + amplitude * system.B
        # free from here on, a block at a time: [C; C A; ...; C A^(L - 1)] x, then A^L x
        many, step = C, A
        for _ in range(_DOUBLINGS):
            many, step = np.vstack([many, many @ step]), step @ step
        for first in range(length, samples, 2**_DOUBLINGS):
            block = (many @ x).reshape(-1, p, m)[: samples - first]
            y[:, :, first : first + len(block)] = block.transpose(1, 2, 0)
            x = step @ x
    if not np.isfinite(y).all():
        raise NumericalFailure(f"the response overflows within {samples} samples: {_FINITE}")
    return y.swapaxes(0, 1)


def simulate_piecewise(
    systems: Iterable[Any],
    inputs: Iterable[ArrayLike],
    x0: ArrayLike | None = None,
    stop: Callable[[np.ndarray], bool] | None = None,
) -> np.ndarray:
    """The outputs y (p, k) of a system that changes from one stretch of samples to the next; the
    state carries over.

    systems: sampled systems with the same states and signals (and dt), one per stretch. inputs: u
    (m, k_i) of each stretch, k = sum k_i, fewer when ``stop`` is true of the outputs (p, k_i) of a
    stretch: that one is the last. Raises InvalidInput, and NumericalFailure when the response
    overflows.
    """
    parts: list[np.ndarray] = []
    x: np.ndarray | None = None
    for stage, piece in zip(systems, inputs, strict=True):
        system, _ = _sampled(stage, None)
        if x is None:
            x = _start(x0, system.n_states)
        elif len(x) != system.n_states:
            raise invalid(
                "a later system's number of states",
                system.n_states,
                str(len(x)),
                "keep one state basis",
            )
        u = check_shape(piece, "u", "(m, k)", m=len(system.inputs)).astype(float)
        y, x = _respond(system, u, x)
        parts.append(y)
        if stop is not None and stop(y):
            break
    if not parts:
        raise InvalidInput("no system was given; a piecewise response needs at least one stretch")
    return np.concatenate(parts, axis=1)


def impulse_response(system: Any, samples: int, dt: float | None = None) -> np.ndarray:
    """The response (p, m, samples) of every output to a unit impulse at every input.

    Continuous: C exp(A t) B at t = 0, dt, ... [unit of y per unit of u and second]. Sampled: the
    Markov parameters D, C B, C A B, ... Raises InvalidInput for a continuous system with direct
    feedthrough (its response holds a Dirac impulse).
    """
    system = as_statespace(system)
    samples = _count(samples)
    if system.dt is not None:
        sampled, _ = _sampled(system, dt)
        return _markov(sampled.A, sampled.B, sampled.C, sampled.D, samples)
    if system.D.any():
        raise invalid("D", "not zero", "zero for an impulse response", "select() outputs without D")
    sampled, t = _sampled(system, dt)

    # D, C B, C exp(A dt) B, ... in balanced states, which the impulse takes to B/t; D is none.
    values = _markov(sampled.A, system.B / t[:, None], sampled.C, system.D, samples + 1)
    return values[:, :, 1:]


def sample_polynomial(system: Any, dt: float, degree: int = 3) -> StateSpace:
    """The exact sampled equivalent for inputs that are polynomials between samples.

    In each interval u_i(tau) = sum_j c_ij (tau/dt)^j, j = 0..degree; the sampled inputs are the
    coefficients, named ``u_i`` for j = 0 and ``u_i^j`` above, in the order j, i. dt [s]. Van Loan
    (1978) with a chain of integrators.
    """
    system = as_statespace(system)
    if system.dt is not None:
        raise invalid(
            "the system's dt", system.dt, "None (continuous)", "a sampled system holds its inputs"
        )
    dt = check_positive(dt, "dt", "give the sample time in seconds")
    n = system.n_states
    m = len(system.inputs)
    d = degree
    A, t = balance(system.A)

    # Time in intervals, states (x, v_0 .. v_d): x' = A dt x + B dt v_0, v_j' = v_(j+1), so that v_0
    # is the polynomial whose j-th derivative at the start is v_j = j! c_j.
    M = np.zeros((n + (d + 1) * m, n + (d + 1) * m))
    M[:n, :n], M[:n, n : n + m] = A * dt, system.B / t[:, None] * dt
    M[n : n + d * m, n + m :] = np.eye(d * m)

    # The column block of v_j is the response to tau^j/j!; back to x = diag(t) z.
    E = sla.expm(M)[:n]
    gains = [factorial(j) * t[:, None] * E[:, n + j * m : n + (j + 1) * m] for j in range(d + 1)]
    names = [name if j == 0 else f"{name}^{j}" for j in range(d + 1) for name in system.inputs]
    Ad = t[:, None] * E[:, :n] / t
    D = np.hstack([system.D, np.zeros((len(system.outputs), d * m))])
    return StateSpace(Ad, np.hstack(gains), system.C, D, names, system.outputs, dt)


def hermite(values: ArrayLike, slopes: ArrayLike, dt: float) -> np.ndarray:
    """Coefficients c (4, m, k) of the cubic through values (m, k + 1) with slopes (m, k + 1) [1/s]
    at both interval ends.

    For ``sample_polynomial(system, dt, 3)``, stacked to (4 m, k). A sine of frequency w is met to
    (w dt)^4/384.
    """
    f = check_shape(values, "values", "(m, k)")
    g = dt * check_shape(slopes, "slopes", "(m, k)", m=f.shape[0], k=f.shape[1])

    # tau in intervals: c(0) = f0, c(1) = f1, c'(0) = g0, c'(1) = g1
    f0 = f[:, :-1]
    f1 = f[:, 1:]
    g0 = g[:, :-1]
    g1 = g[:, 1:]
    return np.stack([f0, g0, 3 * (f1 - f0) - 2 * g0 - g1, 2 * (f0 - f1) + g0 + g1])


def expm_derivative(A: ArrayLike, dA: ArrayLike, t: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """exp(A t) (n, n) and its exact derivatives in the directions dA (..., n, n).

    The diagonal Pade approximant of degree 13 of A t, scaled and squared, each of its steps
    differentiated, all directions at once (Higham 2005, eq. 2.3; Al-Mohy & Higham 2009, algorithm
    6.4), with A balanced. Raises InvalidInput.
    """
    A = check_shape(A, "A", "(n, n)")
    n = len(A)
    dA = check_shape(dA, "dA", "(..., n, n)", n=n)
    if n == 0:
        return np.zeros((0, 0)), np.zeros(dA.shape)

    # A = S A_z S^-1, S = diag(scale): the directions likewise.
    A, scale = balance(A)
    back = scale[:, None] / scale
    E = (dA / back).reshape(-1, n, n) * t
    A = A * t

    # exp(X) = exp(X / 2^s)^(2^s), with s so that the approximant is exact to rounding
    size = float(np.linalg.norm(A, 1))
    squarings = max(0, ceil(log2(size / _PADE_SIZE))) if 0 < size < np.inf else 0
    A, E = A * 2.0**-squarings, E * 2.0**-squarings

    # r(X) = (V - U)^-1 (V + U): U = X W of the odd coefficients, V of the even ones
    A2 = A @ A
    A4 = A2 @ A2
    A6 = A4 @ A2
    d2 = A @ E + E @ A
    d4 = A2 @ d2 + d2 @ A2
    d6 = A4 @ d2 + d4 @ A2
    (W, dW), (V, dV) = (
        (
            A6 @ (c[6] * A6 + c[5] * A4 + c[4] * A2)
            + (c[3] * A6 + c[2] * A4 + c[1] * A2 + c[0] * np.eye(n)),
            A6 @ (c[6] * d6 + c[5] * d4 + c[4] * d2)
            + d6 @ (c[6] * A6 + c[5] * A4 + c[4] * A2)
            + (c[3] * d6 + c[2] * d4 + c[1] * d2),
        )
        for c in (_PADE[1::2], _PADE[0::2])
    )
    U, dU = A @ W, A @ dW + E @ W
    if not np.isfinite(V - U).all():
        raise NumericalFailure(f"exp(A t) overflows over t = {t:g} s: {_FINITE}")
    inverse = np.linalg.inv(V - U)  # of a condition below 20
    X = inverse @ (V + U)
    # (V - U) dr = dV + dU - (dV - dU) r
    dX = inverse @ (dV + dU - (dV - dU) @ X)

    # of X^2: X dX + dX X
    for _ in range(squarings):
        X, dX = X @ X, X @ dX + dX @ X
    if not (np.isfinite(X).all() and np.isfinite(dX).all()):
        raise NumericalFailure(f"exp(A t) overflows over t = {t:g} s: {_FINITE}")
    return X * back, (dX * back).reshape(dA.shape)


def held_derivative(
    A: ArrayLike, B: ArrayLike, dA: ArrayLike, dB: ArrayLike, dt: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The sampled matrices of x' = A x + B u with u held, and their derivatives: Ad, Bd, dAd, dBd.

    A (n, n), B (n, m), dA (..., n, n), dB (..., n, m), dt [s]. Exact: ``expm_derivative`` of [[A,
    B], [0, 0]].
    """
    A = check_shape(A, "A", "(n, n)")
    n = len(A)
    B = check_shape(B, "B", "(n, m)", n=n)
    m = B.shape[1]
    dA, dB = (
        check_shape(dA, "dA", "(..., n, n)", n=n),
        check_shape(dB, "dB", "(..., n, m)", n=n, m=m),
    )
    if dA.shape[:-2] != dB.shape[:-2]:
        raise invalid(
            "the leading axes of dB",
            dB.shape[:-2],
            f"those of dA, {dA.shape[:-2]}",
            "give both per parameter",
        )

    # (x, u)' = [[A, B], [0, 0]] (x, u): exp(M dt) = [[Ad, Bd], [0, I]]
    M = np.zeros((n + m, n + m))
    M[:n, :n], M[:n, n:] = A, B
    dM = np.zeros((*dA.shape[:-2], n + m, n + m))
    dM[..., :n, :n], dM[..., :n, n:] = dA, dB
    E, dE = expm_derivative(M, dM, check_positive(dt, "dt", "give the sample time in seconds"))
    return E[:n, :n], E[:n, n:], dE[..., :n, :n], dE[..., :n, n:]


def settling_time(time: ArrayLike, y: ArrayLike, band: float = 0.05, start: float = 0.0) -> float:
    """The time [s] after ``start`` from which every channel stays within ``band`` times the largest
    excursion; inf if never.

    time (k,) [s]; y (p, k) or (k,); band: fraction of the peak of |y| over all channels and times
    from ``start``. The last crossing is interpolated between samples. Raises InvalidInput.
    """
    time = check_shape(time, "time", "(k)")
    y = check_shape(np.atleast_2d(y), "y", "(p, k)", k=len(time))
    if not 0 < band < 1:
        raise invalid("band", band, "between 0 and 1", "give a fraction of the peak, such as 0.05")
    kept = time >= start
    if not kept.any():
        raise invalid(
            "start",
            start,
            f"at most the last time {time[-1] if len(time) else 0:g}",
            "give a longer record",
        )
    time, envelope = time[kept], np.abs(y).max(axis=0)[kept]
    limit = band * envelope.max()
    outside = np.flatnonzero(envelope > limit)
    if not len(outside):
        return 0.0

    # Linear between the last sample outside the band and the first of those that stay inside.
    i = int(outside[-1])
    if i + 1 == len(time):
        return np.inf
    fraction = (envelope[i] - limit) / (envelope[i] - envelope[i + 1])
    return float(time[i] + fraction * (time[i + 1] - time[i]) - start)


def _sampled(system: Any, dt: float | None) -> tuple[StateSpace, np.ndarray]:
    """The sampled system in balanced states z, and t (n,) with x = t z (ones for a system that is
    sampled already).
    """
    system = as_statespace(system)
    if system.dt is not None:
        if dt is not None and not same_clock(dt, system.dt):
            raise invalid(
                "dt",
                dt,
                f"the system's own {system.dt:g} s, or None",
                "resample the continuous system instead",
            )
        return system, np.ones(system.n_states)
    if dt is None:
        if system.n_states:
            raise invalid("dt", None, "the sample time in seconds", "a continuous system needs one")
        dt = 1.0  # a static gain answers at any rate
    A, t = balance(system.A)
    balanced = StateSpace(
        A, system.B / t[:, None], system.C * t, system.D, system.inputs, system.outputs
    )
    return sample_polynomial(balanced, dt, degree=0), t


def _start(x0: ArrayLike | None, n: int) -> np.ndarray:
    return np.zeros(n) if x0 is None else check_shape(x0, "x0", "(n)", n=n).astype(float)


def _count(samples: int) -> int:
    if samples < 1:
        raise invalid("samples", samples, "at least 1", "ask for a longer response")
    return int(samples)


def _respond(system: StateSpace, u: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (p, k) of a sampled system from state x, and the state after the last sample."""
    # Inputs that are zero throughout cost nothing.
    active = u.any(axis=1)
    B = system.B[:, active]
    D = system.D[:, active]
    u = u[active]
    p, m = D.shape
    n = len(x)
    k = u.shape[1]
    y = np.empty((p, k))
    L = _block_length(n, m, p, k)
    whole = k // L * L
    with np.errstate(over="ignore", invalid="ignore"):
        if whole:
            x = _blocks(_lift(system.A, B, system.C, D, L), L, u[:, :whole], x, y[:, :whole])
        for i in range(whole, k):  # fewer than L samples are left
            y[:, i] = system.C @ x + D @ u[:, i]
            x = system.A @ x + B @ u[:, i]
    if not (np.isfinite(y).all() and np.isfinite(x).all()):
        raise NumericalFailure(f"the response overflows within {k} samples: {_FINITE}")
    return y, x


def _block_length(n: int, m: int, p: int, k: int) -> int:
    """The power of two that makes the estimated work least, in multiplications; the weights only
    steer the choice.
    """
    best = 1
    least = np.inf
    j = 0
    while 2**j <= min(k, 1024):
        L = 2**j
        if j and (p + m) * n * L + p * m * L * L > _LIFTED:
            break

        # ``_lift``: j squarings of A; O and R; T
        setup = j * n**3 + (p + m) * n * n * L + p * m * (n + L) * L
        # matrix times vector: bound by memory and by the interpreter
        steps = k / L * (4 * n * n + 20_000)
        work = setup + steps + k * (p * m * L + (p + m) * n)
        if work < least:
            best, least = L, work
        j += 1
    return best


def _lift(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, L: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A^L (n, n), R (n, L m), O (L p, n) and T (L p, L m) for a power of two L, by doubling."""
    p, m = D.shape
    R = B
    Ob = C

    # From L to 2 L: O = [O; O A^L], R = [A^L R, R] (the first input has the longest way), A^2L
    for _ in range(L.bit_length() - 1):
        Ob = np.vstack([Ob, Ob @ A])
        R = np.hstack([A @ R, R])
        A = A @ A

    # Blocks 0, D, C B, C A B, ...: T has D on its diagonal and the Markov parameter of the lag
    # below.
    markov = np.concatenate([np.zeros((1, p, m)), D[None], (Ob @ B).reshape(L, p, m)[:-1]])
    # 0 picks the zero block: the future
    lag = np.maximum(np.subtract.outer(np.arange(L), np.arange(L)) + 1, 0)
    return A, R, Ob, markov[lag].transpose(0, 2, 1, 3).reshape(L * p, L * m)


def _blocks(
    lifted: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    L: int,
    u: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
) -> np.ndarray:
    """Write the outputs into y (p, k), k a multiple of L, in batches of blocks; returns the state
    after the last block.
    """
    A, R, Ob, T = lifted
    p, k = y.shape
    m = len(u)
    n = len(x)
    batch = max(1, _CHUNK // (L * (p + m) + n))
    for first in range(0, k // L, batch):
        part = slice(first * L, min((first + batch) * L, k))
        count = (part.stop - part.start) // L

        # One column for each block: its L inputs, sample by sample, (L m, count).
        block = u[:, part].reshape(m, count, L).transpose(2, 0, 1).reshape(L * m, count)

        # Only x[k+L] = A^L x[k] + R u_block runs block after block.
        w = np.ascontiguousarray((R @ block).T)
        starts = np.empty((count, n))
        for b in range(count):
            starts[b] = x
            x = A @ x + w[b]

        # y_block = O x[k] + T u_block of all blocks at once, back to (p, samples).
        y[:, part] = (
            (Ob @ starts.T + T @ block)
            .reshape(L, p, count)
            .transpose(1, 2, 0)
            .reshape(p, count * L)
        )
    return x


def _markov(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, k: int) -> np.ndarray:
    """D, C B, C A B, ... as (p, m, k): rows C A^j of one block times columns A^(L i) B of all
    blocks.
    """
    p, m = D.shape
    L = 1

    # L about sqrt(k): as many rows as columns, the least work.
    while k > L * L:
        L *= 2
    power, _, Ob, _ = _lift(A, np.zeros((len(A), 0)), C, np.zeros((p, 0)), L)
    columns = [B]
    with np.errstate(over="ignore", invalid="ignore"):
        while len(columns) * L < k:
            columns.append(power @ columns[-1])

        # C A^(j + L i) B at row j, column block i: sample j + L i after D.
        values = (
            (Ob @ np.hstack(columns))
            .reshape(L, p, len(columns), m)
            .transpose(1, 3, 2, 0)
            .reshape(p, m, -1)
        )
    values = np.concatenate([D[:, :, None], values], axis=2)[:, :, :k]
    if not np.isfinite(values).all():
        raise NumericalFailure(f"the response overflows within {k} samples: {_FINITE}")
    return values
