"""The sampled loop with delays that are no whole number of samples and may be unknown, and its
exact derivatives.

The command computed from the sample k acts from t_k + tau_u on, the excitation recorded at k from
t_k + tau_e on, each held for one sample. Within a sample the plant so sees the older value first
and the newer one for the rest, h = tau - d dt into it:

    x+ = Phi(dt) x + [Gamma(dt) - Gamma(dt - h)] v(k-d-1) + Gamma(dt - h) v(k-d),
    Gamma(t) = integral of exp(A s) B over 0..t

(Franklin, Powell & Workman 1998, sec. 4.3.4), and dx+/dh = Phi(dt - h) B (v(k-d-1) - v(k-d)). Older
values are states, as many as the longest delay needs, so that the loop keeps its size while a delay
moves from one sample to the next.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import invalid
from ambrose.core.response import SystemDerivative, held_derivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error.loop_model import LoopModel
from ambrose.machine.parameters import CONTROLLER_DELAY, EXCITATION_DELAY, TIMING

AHEAD = 2  # samples by which an excitation may have been recorded late: its delay is then negative
# of Gamma, by which the older and the newer value act; None: not at all
Parts = tuple[np.ndarray | None, np.ndarray | None]
_STILL: Parts = (None, None)
_ROOM = 2  # samples by which a delay may grow beyond where it began, at least


@dataclass(frozen=True, slots=True, eq=False)
class TimedLoop:
    """``inner``, whose controller has no delay, with the delays tau (2,) [s] of command and
    excitation.

    unknown: which of the two are the last parameters of theta, after those of ``inner``. longest:
    whole samples that fit. With an unknown delay of the excitation its signals are to be given
    AHEAD samples early (``aligned``).
    """

    inner: LoopModel
    tau: np.ndarray
    unknown: tuple[str, ...]
    longest: tuple[int, int]

    @property
    def excitations(self) -> tuple[str, ...]:
        return self.inner.excitations

    @property
    def signals(self) -> tuple[str, ...]:
        return self.inner.signals

    @property
    def old_commands(self) -> int:
        """How many states hold commands that were computed earlier."""
        return self.longest[0] * len(self.inner.controller.outputs)

    @property
    def skipped(self) -> int:
        """How many samples at the record's beginning are not fitted."""
        return self.longest[1] - AHEAD if self.longest[1] else 0

    def aligned(
        self, waves: Sequence[np.ndarray], measured: Sequence[np.ndarray]
    ) -> tuple[list[np.ndarray], list[np.ndarray], np.ndarray]:
        """Excitations and measured signals (k,) as this loop takes them, and its last states, which
        hold excitations of earlier samples: with an unknown delay the first samples serve for that
        and the excitation is given AHEAD early.
        """
        late = self.longest[1]
        if not late:
            return list(waves), list(measured), np.zeros(0)

        # e(k-1), e(k-2), ... before the first sample that is fitted
        tail = np.concatenate([[wave[late - i] for wave in waves] for i in range(1, late + 1)])
        stop = len(measured[0]) - AHEAD
        return [wave[late:] for wave in waves], [y[self.skipped : stop] for y in measured], tail

    def delays(self, theta: np.ndarray) -> np.ndarray:
        """tau (2,) [s] at theta (q,)."""
        tau = self.tau.copy()
        for i, name in enumerate(self.unknown, len(theta) - len(self.unknown)):
            tau[TIMING.index(name)] = theta[i]
        return tau

    def admits(self, theta: np.ndarray) -> bool:
        """Whether the delays at theta (q,) are within what the loop can hold."""
        return all(
            0 <= d < max(room, 1)
            for (d, _), room in zip(self._split(theta), self.longest, strict=True)
        )

    def _split(self, theta: np.ndarray) -> list[tuple[int, float]]:
        """(whole samples, rest [s]) of both delays, the excitation's counted from the signals as
        given.
        """
        dt = self.inner.controller.dt or 0.0
        parts = []
        for tau, ahead in zip(
            self.delays(theta), (0, AHEAD if EXCITATION_DELAY in self.unknown else 0), strict=True
        ):
            whole = int(np.floor(tau / dt + 1e-9))
            parts.append((whole + ahead, max(tau - whole * dt, 0.0)))
        return parts

    def loop(self, theta: np.ndarray) -> tuple[StateSpace, list[SystemDerivative]]:
        """The sampled loop at theta (q,), and its derivative for each parameter."""
        (d_u, h_u), (d_e, h_e) = self._split(theta)
        inner = self.inner
        K = self.inner.controller
        physical = theta[: len(theta) - len(self.unknown)]
        dt = K.dt or 0.0
        A, B, dA, dB = inner.plant(physical)

        # States (x, z of the controller, u(k-1), u(k-2), ..., e(k-1), e(k-2), ...).
        a = len(K.outputs)
        n = len(A)
        nk = K.n_states
        m = B.shape[1] - a
        old_u, old_e = self.longest[0] * a, self.longest[1] * m
        size = n + nk + old_u + old_e
        state = np.eye(size)
        x, z = state[:n], state[n : n + nk]

        # u(k) = C_K z - D_K y: the controller has err = -y
        u_now = K.C @ z - K.D @ inner.C[:a] @ x

        # rows on the state of u(k), u(k-1), ...; and of e(k-1), ..., where e(k) is the loop's input
        commands = [u_now, *state[n + nk : n + nk + old_u].reshape(-1, a, size)]
        waves = [np.zeros((m, size)), *state[n + nk + old_u :].reshape(-1, m, size)]
        Phi, Gamma, dPhi, dGamma = held_derivative(A, B, dA, dB, dt)

        # what acts for the rest dt - h of the sample: Gamma(dt - h), and Phi(dt - h) B
        new_u, dnew_u, edge_u = _newer(A, B[:, :a], dA, dB[:, :, :a], dt - h_u)
        new_e, dnew_e, edge_e = _newer(A, B[:, a:], dA, dB[:, :, a:], dt - h_e)
        split_inputs = Gamma[:, :a], Gamma[:, a:]

        zero = np.zeros((n, n))

        # Phi x + [Gamma(dt) - Gamma(dt - h)] v(k-d-1) + Gamma(dt - h) v(k-d), u and e alike
        def step(of_x: np.ndarray, u: Parts, e: Parts) -> np.ndarray:
            rows = of_x @ x
            for (early, late), d, values in ((u, d_u, commands), (e, d_e, waves)):
                rows = rows if late is None else rows + late @ values[d]
                rows = rows if early is None else rows + early @ values[d + 1]
            return rows

        # h = 0: one value for the whole sample, and no older state is needed
        def parts(whole: np.ndarray, late: np.ndarray, h: float) -> Parts:
            return (whole - late, late) if h > 0 else (None, whole)

        closed = np.zeros((size, size))
        closed[:n] = step(
            Phi, parts(split_inputs[0], new_u, h_u), parts(split_inputs[1], new_e, h_e)
        )

        # z+ = A_K z - B_K y
        closed[n : n + nk] = K.A @ z - K.B @ inner.C[:a] @ x

        # the old values move on by one sample
        for i in range(self.longest[0]):
            closed[n + nk + i * a : n + nk + (i + 1) * a] = commands[i]
        for i in range(1, self.longest[1]):
            closed[n + nk + old_u + i * m : n + nk + old_u + (i + 1) * m] = waves[i]
        driven = np.zeros((size, m))

        # e(k) acts at once only with d_e = 0; it becomes the newest of the old values
        driven[:n] = new_e if d_e == 0 else 0.0
        driven[n + nk + old_u : n + nk + old_u + m] = np.eye(m) if self.longest[1] else 0.0
        C = np.vstack([inner.row(name, a) for name in self.signals])
        C = np.hstack([C, np.zeros((len(C), old_u + old_e))])
        D = np.zeros((len(C), m))
        nothing = np.zeros((n, m))

        # d/d theta_j: Phi and Gamma move, the old values' shifts do not
        changes = [
            (step(p, parts(g[:, :a], u, h_u), parts(g[:, a:], e, h_e)), e if d_e == 0 else nothing)
            for p, g, u, e in zip(dPhi, dGamma, dnew_u, dnew_e, strict=True)
        ]

        # dx+/dtau = dx+/dh = Phi(dt - h) B (v(k-d-1) - v(k-d)); Phi itself stays
        for name in self.unknown:
            u_moves = name == CONTROLLER_DELAY
            moved = step(
                zero,
                (edge_u, -edge_u) if u_moves else _STILL,
                _STILL if u_moves else (edge_e, -edge_e),
            )
            changes.append((moved, nothing if u_moves or d_e > 0 else -edge_e))
        directions = []
        for rows, pushed in changes:
            change, push = np.zeros((size, size)), np.zeros((size, m))
            change[:n], push[:n] = rows, pushed
            directions.append(SystemDerivative(change, push, np.zeros_like(C), D))
        return StateSpace(closed, driven, C, D, self.excitations, self.signals, dt), directions


def _newer(
    A: np.ndarray, B: np.ndarray, dA: np.ndarray, dB: np.ndarray, rest: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gamma(rest), its derivatives (q, n, m), and Phi(rest) B, its derivative over ``rest``."""
    Phi, Gamma, _, dGamma = held_derivative(A, B, dA, dB, rest)
    return Gamma, dGamma, Phi @ B


def timed(inner: LoopModel, computing_delay: float, unknown: Sequence[str]) -> TimedLoop:
    """The loop with a command that acts ``computing_delay`` samples late, any number, and the
    ``unknown`` of TIMING.

    Raises InvalidInput where a controller's output is to be fitted whose instant is unknown.
    """
    dt = inner.controller.dt or 0.0
    commands = [name for name in inner.signals if name.startswith("u_")]
    if commands:
        raise invalid(
            f"the fitted signal {commands[0]}",
            "a controller output whose instant is not a whole sample",
            "y_ or i_<axis>",
            "leave it out of signals, or give a whole computing_delay and do not ask for the delay",
        )
    room = int(np.floor(computing_delay)) + 1 + (_ROOM if CONTROLLER_DELAY in unknown else 0)
    late = AHEAD + 1 + _ROOM if EXCITATION_DELAY in unknown else 0
    return TimedLoop(inner, np.array([computing_delay * dt, 0.0]), tuple(unknown), (room, late))
