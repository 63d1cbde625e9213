"""The sampled closed loop as a function of the unknown parameters, and its exact derivatives.

The plant is affine in its parameters, A(theta) = A0 + sum (theta_j - theta0_j) A_j and B likewise:
a changed parameter is a feedback through the block that model/uncertainty.py gives it. A bending
mode enters by w^2 and 2 zeta w. The loop is the one of core/lft.py, as it runs: plant held between
the samples, sampled controller, computing delay. So the derivative of the loop is exact through
that of the matrix exponential (core/response.py: held_derivative), and that of the outputs through
the sampled sensitivity equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ambrose.core.checks import NumericalFailure, invalid
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.response import SystemDerivative, held_derivative
from ambrose.core.statespace import StateSpace, index_of
from ambrose.machine.description import Tolerance
from ambrose.machine.parameters import CONTROLLER_DELAY, EXCITATION_DELAY, TIMING
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import channels, uncertain

# The sampled loop with delays that are no whole number of samples and may be unknown, and its exact
# derivatives.
#
# The command computed from the sample k acts from t_k + tau_u on, the excitation recorded at k from
# t_k + tau_e on, each held for one sample. Within a sample the plant so sees the older value first
# and the newer one for the rest, h = tau - d dt into it:
#
#     x+ = Phi(dt) x + [Gamma(dt) - Gamma(dt - h)] v(k-d-1) + Gamma(dt - h) v(k-d),
#     Gamma(t) = integral of exp(A s) B over 0..t
#
# (Franklin, Powell & Workman 1998, sec. 4.3.4), and dx+/dh = Phi(dt - h) B (v(k-d-1) - v(k-d)).
# Older values are states, as many as the longest delay needs, so that the loop keeps its size while
# a delay moves from one sample to the next.


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
        rests = {dt, dt - h_u, dt - h_e}  # mostly one
        held = {rest: held_derivative(A, B, dA, dB, rest) for rest in rests}
        Phi, Gamma, dPhi, dGamma = held[dt]

        # what acts for the rest dt - h of the sample: Gamma(dt - h), and Phi(dt - h) B
        of_u, of_e = held[dt - h_u], held[dt - h_e]
        new_u, new_e = of_u[1][:, :a], of_e[1][:, a:]
        dnew_u, dnew_e = of_u[3][:, :, :a], of_e[3][:, :, a:]
        edge_u, edge_e = of_u[0] @ B[:, :a], of_e[0] @ B[:, a:]
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
            "leave it out of signals, or give a whole computing_delay and do not fit the delay",
        )
    room = int(np.floor(computing_delay)) + 1 + (_ROOM if CONTROLLER_DELAY in unknown else 0)
    late = AHEAD + 1 + _ROOM if EXCITATION_DELAY in unknown else 0
    return TimedLoop(inner, np.array([computing_delay * dt, 0.0]), tuple(unknown), (room, late))


class ParametricModel(Protocol):
    """What least squares needs: a sampled system from ``excitations`` to ``signals`` at theta (q,),
    and its derivatives; its C does not depend on theta, and it has no feedthrough.
    """

    @property
    def excitations(self) -> tuple[str, ...]: ...

    @property
    def signals(self) -> tuple[str, ...]: ...

    def loop(self, theta: np.ndarray) -> tuple[StateSpace, list[SystemDerivative]]: ...


@dataclass(frozen=True, slots=True, eq=False)
class BendingTerm:
    """A bending mode of frequency w0 [rad/s] and damping ratio zeta0; w, zeta: their places in
    theta (None: known there).

    by_stiffness, by_damping (n, n): what A gains with w^2 and with 2 zeta w.
    """

    w: int | None
    zeta: int | None
    w0: float
    zeta0: float
    by_stiffness: np.ndarray
    by_damping: np.ndarray

    def add(self, theta: np.ndarray, A: np.ndarray, A_theta: np.ndarray) -> None:
        """Add its part at theta (q,) to A (n, n) and to the derivatives A_theta (q, n, n)."""
        w = self.w0 if self.w is None else float(theta[self.w])
        zeta = self.zeta0 if self.zeta is None else float(theta[self.zeta])

        # A gains (w^2 - w0^2) by_stiffness + 2 (zeta w - zeta0 w0) by_damping; then dA/dw, dA/dzeta
        A += (w**2 - self.w0**2) * self.by_stiffness + 2 * (
            zeta * w - self.zeta0 * self.w0
        ) * self.by_damping
        if self.w is not None:
            A_theta[self.w] = 2 * w * self.by_stiffness + 2 * zeta * self.by_damping
        if self.zeta is not None:
            A_theta[self.zeta] = 2 * w * self.by_damping


@dataclass(frozen=True, slots=True, eq=False)
class LoopModel:
    """A (n, n), B (n, a + m), C (p, n) of the continuous plant at theta0 (q,), with directions
    A_theta (q, n, n), B_theta (q, n, a + m).

    Inputs: the ``a`` commands u_<axis>, then the ``m`` excitations; outputs: y_<axis> (a), then the
    plant's part of ``signals`` (i_, y_). ``controller``: sampled, delay included, from err_<axis>
    to u_<axis>. factor (q,): theta is given for a reference point; at this one the parameters are
    factor * theta, and so they are in theta0. bending: the modes whose frequency or damping is
    unknown; A_theta is zero for these.
    """

    theta0: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    A_theta: np.ndarray
    B_theta: np.ndarray
    controller: StateSpace
    excitations: tuple[str, ...]
    signals: tuple[str, ...]
    factor: np.ndarray
    bending: tuple[BendingTerm, ...] = ()

    def plant(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """A, B of the continuous plant at theta (q,), and their derivatives (q, n, n), (q, n, a +
        m).
        """
        step, scaled = self.factor * theta - self.theta0, self.factor[:, None, None]
        A, B = (
            self.A + np.tensordot(step, self.A_theta, 1),
            self.B + np.tensordot(step, self.B_theta, 1),
        )
        dA = scaled * self.A_theta
        for mode in self.bending:
            mode.add(theta, A, dA)
        return A, B, dA, scaled * self.B_theta

    def loop(self, theta: np.ndarray) -> tuple[StateSpace, list[SystemDerivative]]:
        """The sampled loop from ``excitations`` to ``signals`` at theta (q,), and its derivative
        for each parameter.
        """
        A, B, dA_theta, dB_theta = self.plant(theta)
        K = self.controller
        assert K.dt is not None
        Ad, Bd, dAd, dBd = held_derivative(A, B, dA_theta, dB_theta, K.dt)
        n = len(A)
        nk = K.n_states
        a = len(K.outputs)
        y = self.C[:a]

        # States (x, z): x+ = Ad x + Bu u + Be e,  z+ = A_K z - B_K y,  u = C_K z - D_K y
        closed = np.block([[Ad - Bd[:, :a] @ K.D @ y, Bd[:, :a] @ K.C], [-K.B @ y, K.A]])
        driven = np.vstack([Bd[:, a:], np.zeros((nk, len(self.excitations)))])
        C = np.vstack([self.row(name, a) for name in self.signals])
        D = np.zeros((len(C), driven.shape[1]))

        # only the plant's rows depend on theta
        directions = []
        for dA, dB in zip(dAd, dBd, strict=True):
            changed = np.zeros_like(closed)
            changed[:n] = np.hstack([dA - dB[:, :a] @ K.D @ y, dB[:, :a] @ K.C])
            pushed = np.vstack([dB[:, a:], np.zeros((nk, driven.shape[1]))])
            directions.append(SystemDerivative(changed, pushed, np.zeros_like(C), D))
        return StateSpace(closed, driven, C, D, self.excitations, self.signals, K.dt), directions

    def row(self, name: str, a: int) -> np.ndarray:
        """The row (1, n + nk) of an output signal on the loop's state."""
        K = self.controller
        if name.startswith("u_"):
            i = K.outputs.index(name)
            return np.hstack([-K.D[i : i + 1] @ self.C[:a], K.C[i : i + 1]])
        i = a + [other for other in self.signals if not other.startswith("u_")].index(name)
        return np.hstack([self.C[i : i + 1], np.zeros((1, K.n_states))])


def over_weights(
    model: ParametricModel, theta: np.ndarray, sizes: np.ndarray
) -> tuple[StateSpace, list[SystemDerivative]]:
    """The loop of a model at theta (q,) and its derivatives, with the outputs over their weights
    ``sizes`` (p,).
    """
    loop, directions = model.loop(theta)
    return StateSpace(
        loop.A, loop.B, loop.C / sizes[:, None], loop.D, loop.inputs, loop.outputs, loop.dt
    ), directions


def loop_model(
    plant: Plant,
    controller: StateSpace,
    paths: Sequence[str],
    theta0: np.ndarray,
    excitations: Sequence[str],
    signals: Sequence[str],
    factor: np.ndarray | None = None,
) -> LoopModel:
    """The loop of a plant and a sampled controller (signals err_<axis>, u_<axis>) in the parameters
    at ``paths``.

    theta0 (q,): their values in the plant, SI. excitations: e_<axis> or f_<port>; signals: y_, u_,
    i_<axis>. factor (q,): see LoopModel (None: one). Raises InvalidInput for a path or a signal
    that is not there.
    """
    modes = dict.fromkeys(path.rpartition(".")[0] for path in paths if path.startswith("rotor."))
    # the damping 2 zeta w follows the frequency
    parameters = list(dict.fromkeys([*paths, *(f"{mode}.damping" for mode in modes)]))
    general = (
        uncertain(plant, [Tolerance(path, absolute=1.0) for path in parameters])
        if parameters
        else None
    )
    system, axes = plant.system if general is None else general.system, plant.axes
    u = index_of([f"u_{axis}" for axis in axes], system.inputs, "input")
    m = index_of(
        [f"u_{name[2:]}" if name.startswith("e_") else name for name in excitations],
        system.inputs,
        "input",
    )
    outputs = [f"y_{axis}" for axis in axes] + [
        name for name in signals if not name.startswith("u_")
    ]
    rows = index_of(outputs, system.outputs, "output")
    B, C = system.B[:, [*u, *m]], system.C[rows]
    n, inputs = system.n_states, [*u, *m]
    dA = np.zeros((0, n, n))
    dB = np.zeros((0, n, len(inputs)))
    count = 0
    inside = np.zeros((0, 0))
    if general is not None:
        dA, dB = directions_of(general, inputs)
        count, inside = (
            general.n_w_blocks,
            system.D[: general.n_z_blocks, : general.n_w_blocks].copy(),
        )
        first = 0
        for block in general.blocks:  # a frequency enters by its square, which BendingTerm has
            if block.name.startswith("rotor."):
                inside[first : first + block.n_z, first : first + block.n_w] = 0.0
            first += block.n_w
    if inside.any() or system.D[np.ix_(rows, [*range(count), *inputs])].any():
        raise NumericalFailure(
            "the plant has feedthrough at its ports; take one reduced without static correction"
        )
    bending = tuple(_bending(plant, mode, paths, parameters, dA) for mode in modes)
    affine = np.array([not path.startswith("rotor.") for path in paths], dtype=float)[:, None, None]
    dA, dB = affine * dA[: len(paths)], affine * dB[: len(paths)]
    factor = np.ones(len(paths)) if factor is None else factor
    names = tuple(excitations), tuple(signals)
    return LoopModel(theta0, system.A, B, C, dA, dB, controller, *names, factor, bending)


def _bending(
    plant: Plant, mode: str, paths: Sequence[str], parameters: Sequence[str], dA: np.ndarray
) -> BendingTerm:
    """The term of the mode "rotor.bending_<k>" from the directions dA (., n, n) of the paths
    ``parameters``.
    """
    frequency, damping = f"{mode}.frequency", f"{mode}.damping"
    zeta0, w0 = channels(plant, damping)[0].nominal, channels(plant, frequency)[0].nominal
    w, zeta = (paths.index(path) if path in paths else None for path in (frequency, damping))

    # at w0: dA/dw = 2 w0 by_stiffness, dA/dzeta = 2 w0 by_damping
    by_stiffness = np.zeros_like(dA[0]) if w is None else dA[w] / (2 * w0)
    return BendingTerm(w, zeta, w0, zeta0, by_stiffness, dA[parameters.index(damping)] / (2 * w0))


def directions_of(
    general: GeneralizedPlant, inputs: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """A_theta (q, n, n) and B_theta (q, n, inputs): one per block, for a change of the parameter by
    one SI unit.
    """
    system, first = general.system, 0
    dA, dB = [], []
    for block in general.blocks:
        w = index_of(general.w[first : first + block.n_w], system.inputs, "input")
        z = index_of(general.z[first : first + block.n_z], system.outputs, "output")
        first += block.n_w

        # w = delta z: A + B_w delta C_z, B + B_w delta D_zu, without D_zw
        dA.append(system.B[:, w] @ system.C[z])
        dB.append(system.B[:, w] @ system.D[np.ix_(z, inputs)])
    return np.stack(dA), np.stack(dB)
