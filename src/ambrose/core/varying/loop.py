"""A loop with real parameters that move: each delta(t) anywhere in -1 .. 1 and, where a bound is
known, |delta'| <= rate.

The parameters are pulled out of a stable system: w = delta z, channel by channel. For a bounded
rate the loop carries filters xi' = F xi + H z and eta' = F eta + H w, which change nothing about
it. As (delta xi)' = F delta xi + H w + delta' xi, delta xi = eta + zeta with zeta' = F zeta +
delta' xi: the pairs (z, w) and (xi, eta + zeta) both belong to delta, and xi with the input delta'
xi belongs to its rate (swapping lemma; Jonsson & Rantzer 1996, Int. J. Robust Nonlinear Control 6).
A rate of zero is a parameter that is not known but stays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import invalid
from ambrose.core.frequency import SchurForm, evaluate, schur_form
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace

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
