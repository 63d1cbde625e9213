"""The loop at many frequencies: plant and controller are evaluated once, everything else is
small-matrix algebra. The axis along a shaft has the exact half-order lag of its solid cores here.

Signs and letters are those of the loop diagram in core/lft.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import check_shape, named_failure
from ambrose.core.frequency import SchurForm, check_nyquist, evaluate, largest_gain, schur_form
from ambrose.core.sampling import hold
from ambrose.core.statespace import StateSpace, select
from ambrose.law.law import LawLike
from ambrose.law.loop import match_controller
from ambrose.machine.axial import AxialMachine
from ambrose.model.axial.magnet import left_out, sides
from ambrose.model.plant import Plant

_LIGHTLY_DAMPED = 0.3  # damping ratio below which a pole has points of its own on a grid

Matrices = np.ndarray  # (w, p, m) complex: one matrix per frequency


@dataclass(frozen=True, slots=True, eq=False)
class LoopResponse:
    """Open-loop matrices (w, a, a) at omega (w,) [rad/s]; a control axes; forces f and
    displacements q at the bearings.

    G: u -> y [m/A], K: err -> u [A/m], G_yf: f -> y [m/N], G_qu: u -> q, G_qf: f -> q, G_iu: u ->
    i, G_if: f -> i.
    """

    omega: np.ndarray
    axes: tuple[str, ...]
    G: Matrices
    K: Matrices
    G_yf: Matrices
    G_qu: Matrices
    G_qf: Matrices
    G_iu: Matrices
    G_if: Matrices

    @named_failure("the output sensitivity")
    def output_sensitivity(self) -> Matrices:
        """S_o = (I + G K)^-1, d -> y."""
        return np.linalg.inv(np.eye(len(self.axes)) + self.G @ self.K)

    @named_failure("the input sensitivity")
    def input_sensitivity(self) -> Matrices:
        """S_i = (I + K G)^-1, e -> v."""
        return np.linalg.inv(np.eye(len(self.axes)) + self.K @ self.G)

    def complementary(self) -> Matrices:
        """T_o = G K S_o = I - S_o."""
        return self.G @ self.K @ self.output_sensitivity()

    def control_sensitivity(self) -> Matrices:
        """K S_o, r -> u [A/m]."""
        return self.K @ self.output_sensitivity()

    def compliance(self) -> Matrices:
        """f -> q at the bearings, loop closed [m/N]."""
        return self.G_qf - self.G_qu @ self.control_sensitivity() @ self.G_yf

    def current_per_force(self) -> Matrices:
        """f at the bearings -> coil current i, loop closed [A/N]."""
        return self.G_if - self.G_iu @ self.control_sensitivity() @ self.G_yf


Evaluator = Callable[[np.ndarray], LoopResponse]


def loop_evaluator(plant: Plant, controller: LawLike, exact: bool = True) -> Evaluator:
    """A function omega (w,) [rad/s] -> LoopResponse; the Schur forms of plant and controller are
    kept for all its calls.

    exact: with the half-order lags of solid cores themselves, not the plant's rational models.

    A sampled controller acts through the base band of its zero-order hold, K(exp(j w T)) (1 -
    exp(-j w T)) / (j w T): exact but for aliasing (Franklin, Powell & Workman 1998, sec. 5.2).
    Raises InvalidInput above its Nyquist frequency, at a pole of plant or controller, and when the
    controller's size does not match.
    """
    part, controller = _parts(plant, controller)
    plant_form, controller_form = _form(part), _form(controller)

    def at(omega: np.ndarray) -> LoopResponse:
        omega = check_shape(omega, "omega", "(w)").astype(float)
        K = _held(lambda s: evaluate(controller_form, s), omega, controller.dt)
        P = evaluate(plant_form, 1j * omega)
        return _parted(plant.axes, omega, _with_cores(plant, omega, P) if exact else P, K)

    return at


def _held(K: Callable[[np.ndarray], Matrices], omega: np.ndarray, dt: float | None) -> Matrices:
    """K(j w) of a continuous controller, K(exp(j w dt)) times its hold of a sampled one."""
    if dt is None:
        return K(1j * omega)
    check_nyquist(omega, dt)
    return K(np.exp(1j * omega * dt)) * hold(omega, dt)[:, None, None]


@named_failure("the response of the loop")
def loop_at(plant: Plant, controller: LawLike, omega: float) -> LoopResponse:
    """The loop at one frequency [rad/s], by one direct solution: cheaper than an evaluator that is
    used once.
    """
    part, controller = _parts(plant, controller)
    at = np.array([omega])
    K = _held(lambda s: _direct(controller, s[0])[None], at, controller.dt)
    P = _with_cores(plant, at, _direct(part, 1j * omega)[None])
    return _parted(plant.axes, at, P, K)


def solid_cores(plant: Plant) -> bool:
    """Whether it is the axis along a shaft, with eddy currents in a core."""
    machine = plant.machine
    return isinstance(machine, AxialMachine) and any(side.core for side in sides(machine.thrust))


def half_order_share(plant: Plant, controller: LawLike) -> tuple[float, str]:
    """By how much the peak of S_o is higher with the half-order lags of solid cores than with the
    plant's rational models, on a grid: a factor, at least 1, and in words.
    """
    if not solid_cores(plant):
        return 1.0, ""
    dt = match_controller(controller, plant).dt
    omega = np.geomspace(1.0, 2e5 if dt is None else 0.999 * np.pi / dt, 2000)
    with_cores, fitted = (
        largest_gain(loop_evaluator(plant, controller, exact)(omega).output_sensitivity())
        for exact in (True, False)
    )
    share = max(1.0, float(with_cores.max() / fitted.max()))
    return share, f"; {share - 1:.2%} of it for the cores' half order, at this point on a grid"


def _parts(plant: Plant, controller: LawLike) -> tuple[StateSpace, StateSpace]:
    """u, f at the bearings -> y, q at the bearings, i; and the controller with the loop's names."""
    part = select(
        plant.system,
        [*plant.named("u"), *plant.bearing_named("f")],
        [*plant.named("y"), *plant.bearing_named("q"), *plant.named("i")],
    )
    return part, match_controller(controller, plant)


def _with_cores(plant: Plant, omega: np.ndarray, P: Matrices) -> Matrices:
    """P with what the rational cores of an axis along the shaft leave out: one more force,
    f + g_i i + g_q q.
    """
    if not isinstance(plant.machine, AxialMachine) or not solid_cores(plant):
        return P
    # P: u, f -> y, q, i of the one axis
    per_current, per_place = left_out(plant.machine, plant.point, omega, plant.offsets)[
        :, :, None, None
    ]
    extra = per_current * P[:, 2:] + per_place * P[:, 1:2]
    return np.asarray(P + P[:, :, 1:] @ extra / (1 - extra[:, :, 1:]))


def _parted(axes: tuple[str, ...], omega: np.ndarray, P: Matrices, K: Matrices) -> LoopResponse:
    n = len(axes)
    u, f = slice(0, n), slice(n, None)
    y = slice(0, n)
    q = slice(n, 2 * n)
    i = slice(2 * n, None)
    return LoopResponse(
        omega, axes, P[:, y, u], K, P[:, y, f], P[:, q, u], P[:, q, f], P[:, i, u], P[:, i, f]
    )


def _direct(system: StateSpace, s: complex) -> np.ndarray:
    n = system.n_states
    return system.C @ np.linalg.solve(s * np.eye(n) - system.A, system.B.astype(complex)) + system.D


def _form(system: StateSpace) -> SchurForm:
    return schur_form(system.A, system.B, system.C, system.D, expand=True)


def frequency_grid(
    poles: np.ndarray,
    lowest: float,
    highest: float,
    per_decade: int = 150,
) -> np.ndarray:
    """A logarithmic grid over ``[lowest, highest]`` [rad/s] with points packed around lightly
    damped poles (n,).

    The packing reaches from a quarter to ten half-bandwidths on either side of each pole's
    resonance, so that a peak lies within a few per cent of a grid point whatever its damping.
    """
    count = max(2, int(np.ceil(np.log10(highest / lowest) * per_decade)))
    return add_poles(np.geomspace(lowest, highest, count), poles)


def add_poles(omega: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """omega (w,) with points packed around the lightly damped poles inside its range, sorted,
    without repeats.
    """
    modulus = np.abs(poles)
    with np.errstate(invalid="ignore", divide="ignore"):
        chosen = poles[(poles.imag > 0) & (np.abs(poles.real) < _LIGHTLY_DAMPED * modulus)]
    half_bandwidth = np.maximum(np.abs(chosen.real), 1e-9 * np.abs(chosen))
    resonance = np.sqrt(np.maximum(chosen.imag**2 - chosen.real**2, (0.1 * chosen.imag) ** 2))
    steps = np.array([0.25, 0.5, 0.75, 1.0, 1.5, 2.5, 5.0, 10.0])
    steps = np.concatenate([-steps[::-1], [0.0], steps])
    extra = (resonance[:, None] + half_bandwidth[:, None] * steps).ravel()
    return np.unique(np.concatenate([omega, extra[(extra > omega.min()) & (extra < omega.max())]]))
