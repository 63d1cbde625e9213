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

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import NumericalFailure, invalid
from ambrose.core.frequency import SchurForm, evaluate, schur_form
from ambrose.core.matrix_inequalities import Inequality, minimise, svec
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, is_stable

# A loop with real parameters that move: each delta(t) anywhere in -1 .. 1 and, where a bound is
# known, |delta'| <= rate.
#
# The parameters are pulled out of a stable system: w = delta z, channel by channel. For a bounded
# rate the loop carries filters xi' = F xi + H z and eta' = F eta + H w, which change nothing about
# it. As (delta xi)' = F delta xi + H w + delta' xi, delta xi = eta + zeta with zeta' = F zeta +
# delta' xi: the pairs (z, w) and (xi, eta + zeta) both belong to delta, and xi with the input
# delta' xi belongs to its rate (swapping lemma; Jonsson & Rantzer 1996, Int. J. Robust Nonlinear
# Control 6). A rate of zero is a parameter that is not known but stays.


# where within a sample the constraints are read in the search
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(3)
_GONE = 1e-6  # a sampled pole so close to zero has no say in the choice of frequencies


@dataclass(frozen=True, slots=True, eq=False)
class VaryingLoop:
    """x' = A x + B (w, v), (z, y) = C x + D (w, v), w = delta z with as many w as z.

    Without a controller the loop is closed: v is the disturbance d, and the gain from d to y is
    asked. With one, y (p) is sampled, e = -(y + d) goes into ``controller`` (sampled), whose held
    output enters as v (m); asked is the gain from d to y + d at the samples. A (n, n), B (n, r +
    m), C (r + p, n), D (r + p, r + m); a sampled y holds neither w nor v directly. owner (r,): the
    parameter that each w belongs to. Raises InvalidInput.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    owner: np.ndarray
    controller: StateSpace | None = None

    def __post_init__(self) -> None:
        if self.controller is None:
            return
        if self.controller.dt is None:
            raise invalid(
                "the controller", "continuous", "sampled", "close the loop around it, or sample it"
            )
        if np.any(self.D[self.channels :]):
            raise invalid(
                "D of the sampled outputs",
                "not zero",
                "zero",
                "give the sensor or the amplifier a lag",
            )

    @property
    def channels(self) -> int:
        """How many w there are."""
        return len(self.owner)

    @property
    def parameters(self) -> int:
        return int(self.owner.max(initial=-1)) + 1

    @property
    def dt(self) -> float:
        """Sample time [s] of a sampled loop, 0 of a continuous one."""
        return 0.0 if self.controller is None else float(self.controller.dt or 0.0)

    def closed(self, delta: np.ndarray) -> StateSpace:
        """The loop with the parameters held at delta (k,): d -> y, or y + d at the samples."""
        r = self.channels
        S = np.diag(np.asarray(delta, float)[self.owner])
        # w = S z, z = C_z x + D_zw w + D_zv v: w = W (C_z x + D_zv v), W = (I - S D_zw)^-1 S
        W = np.linalg.solve(np.eye(r) - S @ self.D[:r, :r], S)
        B_w = self.B[:, :r]
        B_v = self.B[:, r:]
        C_z = self.C[:r]
        C_y = self.C[r:]
        D = self.D

        # w inserted into x' and into y
        A, B = self.A + B_w @ W @ C_z, B_v + B_w @ W @ D[:r, r:]
        C, D = C_y + D[r:, :r] @ W @ C_z, D[r:, r:] + D[r:, :r] @ W @ D[:r, r:]
        if self.controller is None:
            return StateSpace(A, B, C, D)

        # the plant from sample to sample with v held, and the controller around it
        plant = c2d(StateSpace(A, B, C, D), self.dt)
        A, B, C = sampled_closure(plant.A, plant.B, plant.C, self.controller)
        return StateSpace(A, B, C, np.eye(len(C)), dt=self.dt)

    def scaled(self, factor: float) -> VaryingLoop:
        """The same loop with w and z in units 1/factor as large."""
        # w' = factor w and z' = factor z: D_zw, from w to z, stays
        B = self.B.copy()
        C = self.C.copy()
        D = self.D.copy()
        r = self.channels
        B[:, :r] /= factor
        C[:r] *= factor
        D[:r, r:] *= factor
        D[r:, :r] /= factor
        return replace(self, B=B, C=C, D=D)


def sampled_closure(
    P: np.ndarray, Q: np.ndarray, C: np.ndarray, K: StateSpace
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States (x, x_K) from sample to sample with u = K(-(C x + d)): A, B of d, C of y + d."""
    # u = C_K x_K - D_K (C x + d),   x_K+ = A_K x_K - B_K (C x + d)
    A = np.block([[P - Q @ K.D @ C, Q @ K.C], [-K.B @ C, K.A]])
    return A, np.vstack([-Q @ K.D, -K.B]), np.hstack([C, np.zeros((len(C), K.n_states))])


@dataclass(frozen=True, slots=True, eq=False)
class Widened:
    """The loop with its filters. Inputs (w, w2, v): w2 = (delta'/rate) xi; outputs (z_e, w_e, xi,
    w2, y): w_e = delta z_e.

    A, B, C, D as in VaryingLoop. fast, slow: the owners of z_e and of xi; channels: how many w.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    channels: int
    fast: np.ndarray
    slow: np.ndarray
    controller: StateSpace | None

    @property
    def driven(self) -> int:
        """How many inputs belong to the parameters and their rates."""
        return self.channels + len(self.slow)

    @property
    def rows(self) -> int:
        """How many outputs belong to the constraints."""
        return 2 * (len(self.fast) + len(self.slow))


def _section(pole: complex) -> tuple[np.ndarray, np.ndarray]:
    """A (k, k), b (k, 1) of a filter with the pole [rad/s] (and its conjugate), of gain about 1."""
    # xi' = pole (xi - z); for a pair a +- j b of modulus c: [a, b; -b, a] with [0; c]
    if pole.imag == 0:
        return np.array([[pole.real]]), np.array([[-pole.real]])
    return np.array([[pole.real, pole.imag], [-pole.imag, pole.real]]), np.array(
        [[0.0], [abs(pole)]]
    )


def widen(loop: VaryingLoop, poles: Sequence[complex] = (), rates: Sequence[float] = ()) -> Widened:
    """The loop with filters of the poles (f,) [rad/s] for every parameter of finite rate [1/s];
    none given: any rate.
    """
    r = loop.channels
    n = len(loop.A)
    p = loop.B.shape[1] - loop.channels

    # Channels of a parameter with a finite rate get the filters; the others may move at any speed.
    bound = np.asarray(rates if len(rates) else [np.inf] * loop.parameters, float)[loop.owner]
    filtered = np.flatnonzero(np.isfinite(bound)) if len(poles) else np.empty(0, int)
    sections = [_section(complex(pole)) for pole in poles] if len(filtered) else []
    count = sum(len(b) for _, b in sections)

    # F = diag(F_1, F_2, ...) (x) I over the filtered channels, H the filters' inputs from z.
    if sections:
        F = np.kron(sla.block_diag(*[a for a, _ in sections]), np.eye(len(filtered)))
        H = np.kron(np.concatenate([b for _, b in sections]), np.eye(r)[filtered])
    else:
        F = np.zeros((0, 0))
        H = np.zeros((0, r))
    m = len(F)

    # States (x, xi, eta, zeta), inputs (w, w2 = delta' xi / rate, v).
    N = n + 3 * m
    x = slice(0, n)
    xi = slice(n, n + m)
    eta = slice(n + m, n + 2 * m)
    zeta = slice(n + 2 * m, N)
    w = slice(0, r)
    w2 = slice(r, r + m)
    v = slice(r + m, r + m + p)
    A = np.zeros((N, N))
    B = np.zeros((N, r + m + p))

    # x' = A x + B_w w + B_v v, as without filters
    A[x, x] = loop.A
    B[x, w] = loop.B[:, :r]
    B[x, v] = loop.B[:, r:]

    # xi' = F xi + H z,   z = C_z x + D_zw w + D_zv v
    A[xi, x] = H @ loop.C[:r]
    A[xi, xi] = F
    B[xi, w] = H @ loop.D[:r, :r]
    B[xi, v] = H @ loop.D[:r, r:]

    # eta' = F eta + H w
    A[eta, eta] = F
    B[eta, w] = H

    # zeta' = F zeta + delta' xi = F zeta + rate w2,   |w2| <= |xi|
    A[zeta, zeta] = F
    B[zeta, w2] = np.diag(np.tile(bound[filtered], count)) if count else np.zeros((0, 0))

    # Outputs in pairs: (z, xi) before delta, (w, eta + zeta) after it; (xi, w2) for the rate; then
    # the loop's own y.
    R = r + m
    y = 2 * (r + 2 * m)
    C = np.zeros((y + len(loop.C) - r, N))
    D = np.zeros((y + len(loop.C) - r, r + m + p))

    # what delta acts on: z, and xi
    C[:r, x] = loop.C[:r]
    D[:r, w] = loop.D[:r, :r]
    D[:r, v] = loop.D[:r, r:]
    C[r:R, xi] = np.eye(m)

    # what delta makes of it: w = delta z, and eta + zeta = delta xi
    D[R : R + r, w] = np.eye(r)
    C[R + r : 2 * R, eta] = np.eye(m)
    C[R + r : 2 * R, zeta] = np.eye(m)

    # xi, and what delta' makes of it
    C[2 * R : 2 * R + m, xi] = np.eye(m)
    D[2 * R + m : y, w2] = np.eye(m)

    # y = C_y x + D_yw w + D_yv v
    C[y:, x] = loop.C[r:]
    D[y:, w] = loop.D[r:, :r]
    D[y:, v] = loop.D[r:, r:]
    slow = np.tile(loop.owner[filtered], count) if count else np.empty(0, int)
    return Widened(A, B, C, D, r, np.concatenate([loop.owner, slow]), slow, loop.controller)


@dataclass(frozen=True, slots=True, eq=False)
class Responder:
    """The constraints' outputs at the instants ``nodes`` (g,) [s] of a sample, and y + d, over (w,
    w2, d) at any frequencies.

    In a sampled loop w and w2 go on as sines between the samples, without the aliases that d brings
    in with the held u: good enough for a search, no proof. driven: of the plant alone over (w, w2);
    sampled: of the closed loop over d.
    """

    driven: SchurForm
    sampled: SchurForm | None
    rows: int
    inputs: int
    nodes: np.ndarray
    weights: np.ndarray
    dt: float

    def at(self, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(f, g, rows, q) and (f, p, q) at omega (f,) [rad/s], up to half the sample rate."""
        M = evaluate(self.driven, 1j * omega)
        if self.sampled is None:
            return M[:, None, : self.rows], M[:, self.rows :]

        # d at the samples -> the constraints' outputs at the nodes, and y + d
        g = len(self.nodes)
        over_d = evaluate(self.sampled, np.exp(1j * omega * self.dt))
        constraint, y = (
            over_d[:, : g * self.rows].reshape(len(omega), g, self.rows, -1),
            over_d[:, g * self.rows :],
        )
        # a w alone is measured like a d of this size
        free, measured = M[:, None, : self.rows], M[:, self.rows :]

        # a sine w e^(j omega t) has turned by omega t at the node t
        turn = np.exp(1j * omega[:, None] * self.nodes)[:, :, None, None]
        both = np.concatenate([free * turn + constraint @ measured[:, None], constraint], axis=3)
        return both, np.concatenate([y @ measured, y], axis=2)

    @property
    def poles(self) -> np.ndarray:
        """Of the closed loop [rad/s]."""
        if self.sampled is None:
            return self.driven.poles
        values = self.sampled.poles
        return np.log(values[np.abs(values) > _GONE]) / self.dt


def responder(wide: Widened) -> Responder:
    """Frequency responses of a widened loop."""
    K = wide.controller
    rows = wide.rows
    q = wide.driven
    if K is None:
        whole = schur_form(wide.A, wide.B, wide.C, wide.D, expand=True)
        return Responder(whole, None, rows, wide.B.shape[1], np.zeros(1), np.ones(1), 0.0)
    dt, C_y = float(K.dt or 0.0), wide.C[rows:]

    # plant from sample to sample with u held, closed: states (x, x_K), input d
    by_u = StateSpace(wide.A, wide.B[:, q:], wide.C, wide.D[:, q:])
    over = c2d(by_u, dt)
    A, B, C_d = sampled_closure(over.A, over.B, C_y, K)
    u_x, u_d = np.hstack([-K.D @ C_y, K.C]), -K.D  # u = C_K x_K - D_K (C x + d)

    # at a node t: x(t) = P(t) x + Q(t) u, and C x(t) + D u with u inserted; y + d last
    C = []
    D = []
    nodes = dt * (1 + _NODES) / 2
    for node in nodes:
        part = c2d(by_u, float(node))
        Q = wide.C[:rows] @ part.B + wide.D[:rows, q:]
        C.append(np.hstack([wide.C[:rows] @ part.A, np.zeros((rows, K.n_states))]) + Q @ u_x)
        D.append(Q @ u_d)
    C.append(C_d)
    D.append(np.eye(len(C_y)))
    closed = schur_form(A, B, np.vstack(C), np.vstack(D), expand=True)
    plant = schur_form(wide.A, wide.B[:, :q], wide.C, wide.D[:, :q], expand=True)
    return Responder(plant, closed, rows, q + len(C_y), nodes, dt * _WEIGHTS / 2, dt)


# Worst-case cost to come over a stretch of time, as a two-port between states and costates.
#
# Over a stretch, the largest of the integral of a quadratic form over all inputs, plus lambda1^T x1
# at its end, is described by
#
#     x1 = E x0 + G lambda1,    lambda0 = F x0 + E^T lambda1,
#
# F, G symmetric, G >= 0. Stretches compose; a period composed with itself again and again
# (doubling) goes to E = 0 and to F = X, the stabilising solution of the Riccati equation over all
# time to come (Anderson 1978, Int. J. Control 28; Chu, Fan & Lin 2005, Linear Algebra Appl. 396).
# Where I - G1 F2 has an eigenvalue that is not positive the largest value is infinite.


_LARGEST = 0.5  # norm of the balanced Hamiltonian times the first step
_DOUBLINGS = 60
_STILL = 1e-13  # change of a doubling, relative, from which on it is rounding


@dataclass(frozen=True, slots=True, eq=False)
class TwoPort:
    """E (n1, n0), G (n1, n1), F (n0, n0)."""

    E: np.ndarray
    G: np.ndarray
    F: np.ndarray

    def in_states(self, T: np.ndarray, inverse: np.ndarray) -> TwoPort:
        """In states x = T x', before and after (n0 = n1)."""
        return TwoPort(
            inverse @ self.E @ T,
            _symmetric(inverse @ self.G @ inverse.T),
            _symmetric(T.T @ self.F @ T),
        )

    def then(self, other: TwoPort, bounded: bool = True) -> TwoPort:
        """This stretch followed by another. Raises NumericalFailure where, with ``bounded``, the
        cost of both is not.
        """
        # 1: this stretch, 2: the other. x1 = E1 x0 + G1 lambda1, lambda1 = F2 x1 + E2^T lambda2:
        # (I - G1 F2) x1 = E1 x0 + G1 E2^T lambda2
        M = np.eye(len(self.G)) - self.G @ other.F
        factors = sla.lu_factor(M, check_finite=False)
        both = sla.lu_solve(factors, np.hstack([self.E, self.G @ other.E.T]), check_finite=False)
        E1, G1 = both[:, : self.E.shape[1]], both[:, self.E.shape[1] :]

        # finite where I - G1 F2 has positive eigenvalues alone
        if not np.isfinite(both).all() or (bounded and not _positive(self.G, other.F)):
            raise NumericalFailure("the cost is unbounded")

        # x2 = E2 x1 + G2 lambda2,   lambda0 = F1 x0 + E1^T lambda1
        return TwoPort(
            other.E @ E1,
            _symmetric(other.G + other.E @ G1),
            _symmetric(self.F + self.E.T @ other.F @ E1),
        )


def _positive(G: np.ndarray, F: np.ndarray) -> bool:
    """Whether I - G F has positive eigenvalues alone, G >= 0: I - L^T F L > 0 with G = L L^T."""
    values, V = np.linalg.eigh(G)
    L = V * np.sqrt(np.maximum(values, 0))
    try:
        np.linalg.cholesky(np.eye(len(G)) - _symmetric(L.T @ F @ L))
    except np.linalg.LinAlgError:
        return False
    return True


def cost_before(port: TwoPort, X: np.ndarray) -> tuple[np.ndarray, float]:
    """The matrix of the largest cost over a stretch with x1^T X x1 at its end, and how far it is
    from unbounded (positive).
    """
    values, V = np.linalg.eigh(port.G)
    L = V * np.sqrt(np.maximum(values, 0))

    # lambda1 = X x1, so that x1 = (I - G X)^-1 E x0 and the cost is F + E^T X (I - G X)^-1 E; with
    # G = L L^T: X (I - G X)^-1 = X + X L (I - L^T X L)^-1 L^T X
    inner = np.eye(len(L)) - _symmetric(L.T @ X @ L)
    room = float(np.linalg.eigvalsh(inner)[0])
    XL = X @ L
    return port.F + _symmetric(port.E.T @ (X + XL @ np.linalg.solve(inner, XL.T)) @ port.E), room


def _symmetric(M: np.ndarray) -> np.ndarray:
    return (M + M.T) / 2


def _negative(R: np.ndarray) -> np.ndarray:
    """(-R)^-1. Raises NumericalFailure unless R < 0."""
    if R.size and np.linalg.eigvalsh(R)[-1] >= 0:
        raise NumericalFailure("the cost is unbounded: an input adds to it at once")
    return np.linalg.inv(-R)


def instant(A: np.ndarray, B: np.ndarray, Q: np.ndarray, S: np.ndarray, R: np.ndarray) -> TwoPort:
    """A jump x1 = A x0 + B d with the cost x0^T Q x0 + 2 x0^T S d + d^T R d, R < 0."""
    # the worst input: d = (-R)^-1 (S^T x0 + B^T lambda1)
    inverse = _negative(R)
    return TwoPort(
        A + B @ inverse @ S.T, _symmetric(B @ inverse @ B.T), _symmetric(Q + S @ inverse @ S.T)
    )


def linear(A: np.ndarray) -> TwoPort:
    """x1 = A x0, no cost, no input."""
    return TwoPort(A, np.zeros((len(A), len(A))), np.zeros((A.shape[1],) * 2))


def flow(
    A: np.ndarray, B: np.ndarray, Q: np.ndarray, S: np.ndarray, R: np.ndarray, time: float
) -> TwoPort:
    """x' = A x + B w with the cost integral x^T Q x + 2 x^T S w + w^T R w, R < 0, over ``time``
    [s].
    """
    # the worst input: w = (-R)^-1 (S^T x + B^T lambda)
    inverse = _negative(R)
    a = A + B @ inverse @ S.T

    # x' = a x + B (-R)^-1 B^T lambda,   lambda' = -(Q + S (-R)^-1 S^T) x - a^T lambda
    H = np.block([[a, B @ inverse @ B.T], [-(Q + S @ inverse @ S.T), -a.T]])

    # A first step h, doubled below until it is the whole time. |W22(t) - I| <= e^(|H| t) - 1 <
    # 1 for |H| t <= 1/2, in any units of the states and costates: W22 stays regular within h, so
    # that the cost does, and ``then`` looks at every doubling.
    n, balanced = len(A), sla.matrix_balance(H, permute=False)[0]
    size = max(np.abs(balanced).sum(axis=1).max(), 1e-300)
    count = max(0, int(np.ceil(np.log2(time * size / _LARGEST))))
    W = sla.expm(H * (time / 2**count))

    # (x1, lambda1) = W (x0, lambda0), solved for (x1, lambda0):
    # x1 = W11 x0 + W12 lambda0,   lambda0 = W22^-1 (lambda1 - W21 x0)
    inv = np.linalg.inv(W[n:, n:])
    port = TwoPort(
        W[:n, :n] - W[:n, n:] @ inv @ W[n:, :n],
        _symmetric(W[:n, n:] @ inv),
        _symmetric(-inv @ W[n:, :n]),
    )
    for _ in range(count):
        port = port.then(port)
    return port


def forever(port: TwoPort) -> np.ndarray:
    """X (n, n): the largest cost x0^T X x0 from a state, over repetitions of a period without end.
    Raises NumericalFailure.
    """
    size = 0.0
    for _ in range(_DOUBLINGS):
        new = port.then(port, bounded=False)
        size = max(size, float(np.abs(new.F).max()))
        change = float(np.abs(new.F - port.F).max())
        port = new

        # settled, and of the state at the end nothing comes back to the beginning
        if change < _STILL * size and np.abs(port.E).max() < 1e-6:
            return port.F
    raise NumericalFailure("the cost does not settle: the loop has almost no damping")


# Constant multipliers of moving parameters and their rates, found by cutting planes over the
# frequency.
#
# With D = D^T >= 0 and G = -G^T the form sigma = z^T D z - w^T D w + 2 z^T G w is not negative
# where w = delta z, |delta| <= 1, at every instant, however delta moves; likewise for xi and w2 =
# (delta'/rate) xi. If sigma + |y|^2 - gamma^2 |d|^2 is negative definite in (w, w2, d) at every
# frequency, gamma bounds the gain (S-procedure; Megretski & Rantzer 1997, IEEE Trans. Autom.
# Control 42; Scherer 2001, Automatica 37). The search satisfies this at finitely many frequencies
# and adds those where it fails; ``proof`` proves what it finds.


ROOMS = (1e-3, 4e-3, 1.6e-2, 6e-2)  # of gamma, above the smallest, for multipliers of moderate size
_INSIDE = 0.2  # of the room, how far the inequality is kept from zero, of the squares of w and of y
_CLOSE = 2e-4  # of gamma^2, how far the inequality may fail between the frequencies of the search
_ROUNDS = 15  # of minimum and search for frequencies where the inequality fails; assumed
_FIRST, _ADDED = 16, 8  # frequencies at the start, and per round
_PER_DECADE = 250
_TIME_LIMIT = 60.0  # s, of one minimum


@dataclass(frozen=True, slots=True, eq=False)
class Multipliers:
    """D, G (R, R) of the parameters and D2, G2 (m, m) of their rates; gamma: of the search, not
    proved.
    """

    D: np.ndarray
    G: np.ndarray
    D2: np.ndarray
    G2: np.ndarray
    gamma: float

    @property
    def matrix(self) -> np.ndarray:
        """The symmetric matrix (rows, rows) of sigma over (z_e, w_e, xi, w2)."""
        first, second = (
            np.block([[D, G], [G.T, -D]]) for D, G in ((self.D, self.G), (self.D2, self.G2))
        )
        return sla.block_diag(first, second)


@dataclass(frozen=True, slots=True, eq=False)
class _Entries:
    """The free entries of one D (upper triangle, i <= j) and G (i < j) whose indices have one
    owner; start: first variable.
    """

    owner: np.ndarray
    start: int

    def pairs(self, strict: bool) -> tuple[np.ndarray, np.ndarray]:
        i, j = np.triu_indices(len(self.owner), 1 if strict else 0)
        same = self.owner[i] == self.owner[j]
        return i[same], j[same]

    @property
    def count(self) -> int:
        return len(self.pairs(strict=False)[0]) + len(self.pairs(strict=True)[0])

    def groups(self) -> Iterator[np.ndarray]:
        """The indices of every owner."""
        for name in np.unique(self.owner):
            yield np.flatnonzero(self.owner == name)

    def matrices(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """D and G of all variables x."""
        D, G = np.zeros((2, len(self.owner), len(self.owner)))
        (i, j), (k, m) = self.pairs(strict=False), self.pairs(strict=True)
        D[i, j] = D[j, i] = x[self.start : self.start + len(i)]
        G[k, m] = x[self.start + len(i) : self.start + self.count]
        return D, G - G.T

    def forms(self, constraint: np.ndarray, weights: np.ndarray, first: int) -> np.ndarray:
        """Hermitian matrices (f, k, q, q), one per variable; ``first``: where this pair of signals
        begins in the rows.
        """
        size = len(self.owner)

        # sigma is integrated over the sample: signals times the roots of the nodes' weights
        z, w = (
            np.sqrt(weights)[:, None, None] * constraint[:, :, a : a + size]
            for a in (first, first + size)
        )

        # a_i^* b_j, summed over the nodes g, for each pair (i, j)
        def outer(a: np.ndarray, b: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
            return np.einsum("fgkp,fgkq->fkpq", a[:, :, i].conj(), b[:, :, j], optimize=True)

        (i, j), (k, m) = self.pairs(strict=False), self.pairs(strict=True)

        # by D_ij = D_ji: z_i^* z_j - w_i^* w_j + h.c. (half where i = j);
        # by G_km = -G_mk: z_k^* w_m - z_m^* w_k + h.c.
        D = (outer(z, z, i, j) - outer(w, w, i, j)) * np.where(i == j, 0.5, 1.0)[:, None, None]
        G = outer(z, w, k, m) - outer(z, w, m, k)
        both = np.concatenate([D, G], axis=1)
        return both + both.conj().swapaxes(2, 3)

    def positive(self) -> Iterator[Inequality]:
        """D >= 0, owner by owner."""
        i, j = self.pairs(strict=False)
        for group in self.groups():
            inside = np.flatnonzero(np.isin(i, group))
            place = np.searchsorted(group, i[inside]), np.searchsorted(group, j[inside])
            basis = np.zeros((len(inside), len(group), len(group)))
            at = np.arange(len(inside))
            # D = sum of d_ij (E_ij + E_ji), E_ii once
            basis[at, place[0], place[1]] = basis[at, place[1], place[0]] = 1.0
            rows = svec(basis).T
            yield Inequality(rows, np.zeros(len(rows)), self.start + inside)

    def bounded(self) -> Iterator[Inequality]:
        """[b I - D, G; G^T, b I - D] >= 0 with b the variable 0: it bounds D and G together."""
        (i, j), (k, m) = self.pairs(strict=False), self.pairs(strict=True)
        for group in self.groups():
            d = np.flatnonzero(np.isin(i, group))
            g = np.flatnonzero(np.isin(k, group))
            n = len(group)
            basis = np.zeros((1 + len(d) + len(g), 2 * n, 2 * n))
            # b I
            basis[0] = np.eye(2 * n)

            # -D in both diagonal blocks
            a = np.searchsorted(group, i[d])
            b = np.searchsorted(group, j[d])
            at = 1 + np.arange(len(d))
            for shift in (0, n):
                basis[at, shift + a, shift + b] = basis[at, shift + b, shift + a] = -1.0

            # G with G_mk = -G_km above the diagonal, its transpose below
            a = np.searchsorted(group, k[g])
            b = np.searchsorted(group, m[g])
            at = 1 + len(d) + np.arange(len(g))
            for e, f, sign in ((a, b, 1.0), (b, a, -1.0)):
                basis[at, e, n + f] = basis[at, n + f, e] = sign
            rows = svec(basis).T
            yield Inequality(
                rows, np.zeros(len(rows)), np.r_[0, self.start + d, self.start + len(i) + g]
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """The variables are gamma^2 (or a bound b in its place), then the entries of both pairs of
    signals.

    constraint (f, g, rows, q), weights (g,), y (f, p, q): responses on a fine grid of frequencies.
    """

    wide: Widened
    constraint: np.ndarray
    weights: np.ndarray
    y: np.ndarray
    entries: tuple[_Entries, _Entries]

    def forms(self, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The inequality -(F0 + sum x_k F_k) >= 0 at frequencies: F (f, k, q, q) and F0 (f, q,
        q).
        """
        constraint, y = self.constraint[chosen], self.y[chosen]
        # by gamma^2: -I on d; then D, G of (z_e, w_e), rows from 0, and D2, G2 of (xi, w2) behind
        q = np.arange(self.wide.driven, y.shape[2])
        gain = np.zeros((len(y), 1, *(y.shape[2],) * 2), complex)
        gain[:, 0, q, q] = -1
        places = (0, 2 * len(self.wide.fast))
        parts = [
            e.forms(constraint, self.weights, a) for e, a in zip(self.entries, places, strict=True)
        ]
        return np.concatenate([gain, *parts], axis=1), np.einsum("fip,fiq->fpq", y.conj(), y)

    def multipliers(self, x: np.ndarray) -> Multipliers:
        return Multipliers(
            *self.entries[0].matrices(x), *self.entries[1].matrices(x), float(np.sqrt(x[0]))
        )

    def excess(self, x: np.ndarray) -> np.ndarray:
        """The largest eigenvalue of the inequality's left side at every frequency (f,): not
        positive where it holds.
        """
        P, q = self.multipliers(x).matrix, self.wide.driven
        # |y|^2 + integral of sigma - gamma^2 |d|^2
        H = np.einsum("fip,fiq->fpq", self.y.conj(), self.y)
        for g, weight in enumerate(self.weights):
            o = self.constraint[:, g]
            H += weight * o.conj().swapaxes(1, 2) @ (P @ o)
        d = np.arange(q, H.shape[2])
        H[:, d, d] -= x[0]
        return np.linalg.eigvalsh((H + H.conj().swapaxes(1, 2)) / 2)[:, -1]

    def smallest_gamma(self, F: np.ndarray, F0: np.ndarray) -> np.ndarray:
        found = self._minimum(
            [*_frequencies(F, F0), *(item for e in self.entries for item in e.positive())],
            F.shape[1],
            1e-6,
        )
        if found is None:
            raise NumericalFailure(
                "no quadratic function proves the loop stable while the parameters move"
            )
        return found

    def smallest_multipliers(
        self, F: np.ndarray, F0: np.ndarray, level: float, inside: float
    ) -> np.ndarray | None:
        """For gamma^2 = level, with some room in every inequality: at the smallest gamma
        multipliers tend to infinity.
        """
        q = self.wide.driven
        room = np.diag(np.r_[np.full(q, inside), np.full(F.shape[2] - q, inside * level)])

        # gamma^2 is given and joins the constant; the variable 0 is the bound b now
        without = np.concatenate([np.zeros_like(F[:, :1]), F[:, 1:]], axis=1)
        limits = [item for e in self.entries for item in (*e.positive(), *e.bounded())]
        found = self._minimum(
            [*_frequencies(without, F0 + level * F[:, 0] + room), *limits], F.shape[1], 1e-3
        )
        return None if found is None else np.r_[level, found[1:]]

    @staticmethod
    def _minimum(items: list[Inequality], count: int, tolerance: float) -> np.ndarray | None:
        found = minimise(np.eye(count)[0], items, tolerance=tolerance, time_limit=_TIME_LIMIT)
        return (
            None
            if found.status in ("infeasible", "time limit") or found.primal_error > 1e-6
            else found.x
        )


def _frequencies(F: np.ndarray, F0: np.ndarray) -> list[Inequality]:
    """-(F0 + sum x_k F_k) >= 0 as real matrices, each of norm about 1."""
    size, every = 1 / np.maximum(1.0, np.linalg.norm(F0, 2, axis=(1, 2))), np.arange(F.shape[1])
    rows, constant = (-svec(_real(M)) for M in (F, F0))
    return [
        Inequality(s * row.T, s * c, every) for s, row, c in zip(size, rows, constant, strict=True)
    ]


def _real(H: np.ndarray) -> np.ndarray:
    """[[Re, -Im], [Im, Re]] of Hermitian matrices (..., q, q)."""
    return np.concatenate(
        [np.concatenate([H.real, -H.imag], axis=-1), np.concatenate([H.imag, H.real], axis=-1)],
        axis=-2,
    )


def find_multipliers(
    wide: Widened, tell: Callable[[str], None] = lambda text: None
) -> Iterator[Multipliers]:
    """Multipliers of the smallest gamma on a fine grid of frequencies, and of ROOMS above it, one
    after the other.

    Raises NumericalFailure where there are none.
    """
    fast = _Entries(wide.fast, 1)
    responses = responder(wide)
    constraint, y = responses.at(frequency_grid(responses))
    search = _Search(
        wide, constraint, responses.weights, y, (fast, _Entries(wide.slow, 1 + fast.count))
    )

    # to begin with: evenly spread, and where y answers most
    chosen = np.zeros(len(y), bool)
    chosen[:: max(1, len(y) // _FIRST)] = True
    chosen[np.argsort(np.linalg.norm(y, 2, axis=(1, 2)))[-_ADDED:]] = True

    def add(x: np.ndarray, allowed: float) -> bool:
        """Choose the frequencies at which the inequality fails most; whether there are any."""
        excess = search.excess(x)
        # local maxima alone, the ends included: neighbours of a peak say the same
        peaks = np.r_[True, excess[1:] >= excess[:-1]] & np.r_[excess[:-1] >= excess[1:], True]
        worst = np.flatnonzero((excess > allowed) & ~chosen & peaks)
        worst = worst[np.argsort(excess[worst])[::-1][:_ADDED]]
        chosen[worst] = True
        return worst.size > 0

    for step in range(_ROUNDS):
        x = search.smallest_gamma(*search.forms(chosen))
        tell(
            f"multipliers, round {step + 1}: gain below {np.sqrt(x[0]):.4f} at "
            f"{int(chosen.sum())} frequencies"
        )
        if not add(x, _CLOSE * x[0]):
            break

    # Multipliers of moderate size, with room; frequencies that fail are added for each room.
    least = x[0]
    for room in ROOMS:
        for _ in range(_ROUNDS):
            found = search.smallest_multipliers(
                *search.forms(chosen), least * (1 + room) ** 2, _INSIDE * room
            )
            if found is None or not add(found, 0.0):
                break
        if found is not None:
            yield search.multipliers(found)


def frequency_grid(responses: Responder) -> np.ndarray:
    """Frequencies (f,) [rad/s] from zero to half the sample rate (or beyond the poles), denser at
    light poles.
    """
    poles = responses.poles
    modulus = np.abs(poles[np.abs(poles) > 0])

    # up to just below half the sample rate; from a tenth of the slowest pole
    high = 0.9999 * np.pi / responses.dt if responses.dt else 10 * modulus.max(initial=1.0)
    low = min(max(0.1 * modulus.min(initial=1.0), 1e-6 * high), 0.1 * high)
    net = np.geomspace(low, high, int(_PER_DECADE * np.log10(high / low)) + 2)

    # damping ratio below 0.3: beside the pole at distances of its decay
    light = poles[(poles.imag > 0) & (-poles.real < 0.3 * np.abs(poles))]
    beside = (
        light.imag[:, None] + light.real[:, None] * np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
    ).ravel()
    return np.unique(np.concatenate([[0.0], net, beside[(beside > low) & (beside < high)]]))


def unit_of_w(loop: VaryingLoop) -> float:
    """The factor for ``scaled`` with which w reaches y as strongly as d reaches z."""
    wide, r = widen(loop), loop.channels
    responses = responder(wide)
    omega = frequency_grid(responses)
    constraint, y = responses.at(omega[:: max(1, len(omega) // 100)])

    # d -> z is multiplied by the factor, w -> y divided: equal for factor^2 = out / into
    into = np.linalg.norm(constraint[:, 0, :r, r:], 2, axis=(1, 2)).max()
    out = np.linalg.norm(y[:, :, :r], 2, axis=(1, 2)).max()
    return float(np.sqrt(out / into)) if into > 0 and out > 0 else 1.0


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
        raise NumericalFailure("with the worst inputs the loop does not decay")

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
