"""The proof that a gamma bounds a loop's gain, whatever its parameters do within their range and
their rates.

V = s^T X s over the widened loop's state s, with X from the worst case of sigma + |y|^2 - gamma^2
|d|^2 over all time to come. What is checked is an inequality for the X that was found: over one
period, for every s, every w(t) and w2(t) within it and d,

    V(after) - V(before) + integral of sigma + |y|^2 - gamma^2 |d|^2 <= -s^T W s,    W > 0.

Since sigma >= 0 for every admitted motion, also within a sample, the gain from d to y is at most
gamma along each. V need not be positive for all s: on the states that an admitted motion reaches
(zeta = delta xi - eta) its matrix solves, for every frozen delta, a strict Lyapunov inequality; it
is positive for delta = 0, where the loop is stable, and cannot become singular on the way to
another delta, for there V could not fall. It is positive for every delta then, and falls along
every admitted motion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.core.checks import NumericalFailure
from ambrose.core.statespace import is_stable
from ambrose.core.varying.loop import VaryingLoop, Widened, widen
from ambrose.core.varying.multipliers import ROOMS, Multipliers, find_multipliers, unit_of_w
from ambrose.core.varying.two_port import TwoPort, cost_before, flow, forever, instant, linear

# of the slowest decay under the worst inputs, by which V falls beyond what is needed
_MARGIN = 1e-4
_FLOOR = 1e-6  # of the largest eigenvalue of X, below which a direction counts as of that size
_TINY = 1e-20  # of its largest diagonal entry
STEP = 1e-4  # s, period of a continuous loop


@dataclass(frozen=True, slots=True, eq=False)
class Proof:
    """gamma holds for every admitted motion: X (N, N) in the states of the widened loop at the
    samples (and the controller's).

    slack: smallest eigenvalue of the inequality in states in which |X| is about I; rounding: a
    bound of its error.
    """

    gamma: float
    X: np.ndarray
    slack: float
    rounding: float


def period(wide: Widened, multipliers: Multipliers, gamma: float) -> TwoPort:
    """One sample of a sampled loop, STEP of a continuous one."""
    P = multipliers.matrix
    rows = wide.rows
    q = wide.driven
    n = len(wide.A)
    C = wide.C[:rows]
    D = wide.D[:rows]
    C_y = wide.C[rows:]
    D_y = wide.D[rows:]
    K = wide.controller
    if K is None:
        # sigma + |y|^2 - gamma^2 |d|^2 = x^T Q x + 2 x^T S v + v^T R v,   v = (w, w2, d)
        Q = C.T @ P @ C + C_y.T @ C_y
        S = C.T @ P @ D + C_y.T @ D_y
        R = D.T @ P @ D + D_y.T @ D_y
        R[q:, q:] -= gamma**2 * np.eye(len(R) - q)
        return flow(wide.A, wide.B, Q, S, R, STEP)

    # Sampled: the order of states at the samples is (x, x_K), that of inputs between them (w, w2).
    k = K.n_states
    m = len(C_y)
    u = wide.B.shape[1] - q
    N = n + u + k  # between the samples: x, and u and the controller's next state, which stay

    # x' = A x + B_w (w, w2) + B_u u,   u' = 0,   x_K' = 0; the cost between samples is sigma alone
    A, B = np.zeros((N, N)), np.zeros((N, q))
    A[:n, :n] = wide.A
    A[:n, n : n + u] = wide.B[:, q:]
    B[:n] = wide.B[:, :q]
    C, D = np.hstack([C, D[:, q:], np.zeros((rows, k))]), D[:, :q]
    between = flow(A, B, C.T @ P @ C, C.T @ P @ D, D.T @ P @ D, float(K.dt or 0.0))

    # at the end of the sample u is dropped: (x, u, x_K) -> (x, x_K)
    keep = np.delete(np.eye(N), np.arange(n, n + u), axis=0)

    # At its start the controller acts: u = C_K x_K - D_K (C_y x + d), x_K+ = A_K x_K - B_K (C_y x +
    # d), as a jump (x, x_K) -> (x, u, x_K+) driven by d.
    rest = np.vstack([np.hstack([-K.D @ C_y, K.C]), np.hstack([-K.B @ C_y, K.A])])
    jump, into = np.vstack([np.eye(n, n + k), rest]), np.vstack([np.zeros((n, m)), -K.D, -K.B])

    # |y + d|^2 - gamma^2 |d|^2 there, y = C_s (x, x_K)
    C_s = np.hstack([C_y, np.zeros((m, k))])
    start = instant(jump, into, C_s.T @ C_s, C_s.T, (1 - gamma**2) * np.eye(m))
    return start.then(between).then(linear(keep))


def in_fitting_states(wide: Widened, X: np.ndarray) -> tuple[Widened, np.ndarray]:
    """The loop with every state in a unit in which it costs about 1, and these units (N,)."""
    size = np.abs(np.diag(X))
    t = 1 / np.sqrt(np.maximum(size, _TINY * size.max()))

    # x = a x', x_K = b x_K'
    n, K = len(wide.A), wide.controller
    a, b = t[:n], t[n:]
    if K is not None:
        K = replace(K, A=K.A * b / b[:, None], B=K.B / b[:, None], C=K.C * b)
    return replace(
        wide, A=wide.A * a / a[:, None], B=wide.B / a[:, None], C=wide.C * a, controller=K
    ), t


def prove(wide: Widened, multipliers: Multipliers, gamma: float) -> Proof:
    """The inequality, checked by eigenvalues with an X of its own. Raises NumericalFailure where it
    does not hold.
    """
    # with D > 0, sigma >= 0 along every admitted motion
    for M in (multipliers.D, multipliers.D2):
        if M.size and np.linalg.eigvalsh(M)[0] <= 0:
            raise NumericalFailure("a multiplier is not positive definite")

    # States in which X is about diag(+-1), in two steps: units first, then its eigenvectors.
    wide, t = in_fitting_states(wide, forever(period(wide, multipliers, gamma)))
    port = period(wide, multipliers, gamma)
    values, V = np.linalg.eigh(forever(port))
    unit = V / np.sqrt(np.abs(values) + _FLOOR * np.abs(values).max())
    inverse = np.linalg.inv(unit)
    port = port.in_states(unit, inverse)

    # Under the worst inputs x1 = E x0 + G X x1: x1 = (I - G X)^-1 E x0; its spectral radius is the
    # slowest decay.
    one = np.eye(len(unit))
    worst = np.linalg.solve(one - port.G @ (start := forever(port)), port.E)
    decay = 1 - np.abs(np.linalg.eigvals(worst)).max() ** 2
    if not decay > 0 or not np.isfinite(start).all():
        raise NumericalFailure("the worst inputs do not let the loop decay")

    # X of a cost larger by margin |x0|^2 per period: what V falls by beyond the inequality
    X = forever(replace(port, F=port.F + _MARGIN * decay * one))

    # The inequality for this X, whatever its origin: X - (largest cost of a period with x1^T X x1
    # at its end) >= slack I, and that cost is finite, room > 0.
    before, room = cost_before(port, X)
    slack = float(np.linalg.eigvalsh(X - before)[0])
    largest = max(1.0, *(float(np.linalg.norm(M, 2)) for M in (X, port.F, port.E)))
    rounding = (
        float(len(X) * np.finfo(float).eps * largest**3 / min(1.0, room)) if room > 0 else np.inf
    )
    if not slack > rounding:
        raise NumericalFailure(
            f"the inequality does not hold with certainty (slack {slack:.1e}, rounding "
            f"{rounding:.1e})"
        )

    # x = t unit x', so x' = unit^-1 (x / t)
    back = inverse / t
    return Proof(gamma, back.T @ X @ back, slack, rounding)


def proved_gain(
    loop: VaryingLoop,
    poles: Sequence[complex] = (),
    rates: Sequence[float] = (),
    *,
    tell: Callable[[str], None] = lambda text: None,
) -> Proof:
    """The smallest gamma for which a proof is found, over all motions of the parameters with
    |delta'| <= rates (k,) [1/s].

    poles (f,) [rad/s]: of the filters that a bounded rate needs; without them, or for an infinite
    rate, any motion is admitted. Raises NumericalFailure where none is found, with the reason.
    """
    if not is_stable(loop.closed(np.zeros(loop.parameters))):
        raise NumericalFailure(
            "the loop is unstable with every parameter in the middle of its range"
        )
    wide = widen(loop.scaled(unit_of_w(loop)), poles, rates)
    reason = ""
    for multipliers in find_multipliers(wide, tell):
        try:
            return prove(wide, multipliers, multipliers.gamma)
        except NumericalFailure as error:
            reason = str(error)
            tell(f"not proved at {multipliers.gamma:.4f}: {reason}")
    raise NumericalFailure(
        f"the proof ends {ROOMS[-1]:.0%} above the smallest gain of the search: {reason}"
    )
