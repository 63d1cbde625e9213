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

from ambrose.core.checks import NumericalFailure
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.response import SystemDerivative, held_derivative
from ambrose.core.statespace import StateSpace, index_of
from ambrose.machine.description import Tolerance
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import channels, uncertain


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
