"""The linear filters of the seal monitor: an observer of the machine without the watched seal, and
what the seal adds to it.

Sampled, the machine with the parameters theta (what the seal is; zero: no seal) is

    x+ = (A + sum theta_g D_g + sum theta_g theta_h D_gh) x
         + (B + sum theta_g N_g + sum theta_g theta_h N_gh) v,
    y = C x,

the squares being what sampling bends. The observer x^+ = A x^ + B v + L e, e = y - C x^, of the
machine without it errs by x - x^ = sum theta_g phi_g + sum theta_g theta_h phi_gh + ..., each part
of the error in A - L C,

    phi_g driven by D_g x^ + N_g v,    phi_gh by D_g phi_h + D_gh x^ + N_gh v,
    e = sum theta_g C phi_g + ... + noise,

and no filter knows theta. On the seal rig the squares are 3 % at nominal pressure, and the third
power, left out, changes theta by 6e-4 there. Adaptive observers: Zhang, IEEE Trans. Automatic
Control 47 (2002) 525; as a prediction error: Ljung & Soderstrom (1983), sec. 3.8.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.response import held_derivative
from ambrose.core.statespace import StateSpace, index_of
from ambrose.identification.output_error.loop_model import directions_of
from ambrose.identification.output_error.problem import deployed_controller
from ambrose.identification.parameters import nominal_values, reduced_plant
from ambrose.law.law import LawLike
from ambrose.machine.description import AMPLIFIER_PARAMETERS, OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import find_uncertain
from ambrose.model.effects.rotor import mass_properties
from ambrose.model.uncertainty import uncertain

_NOISE = 1e-7  # [m] of a sensor of which the machine file says nothing, per sample
_FORCE = 0.005  # disturbing force at seals and bearings, held over a sample, of the rotor's weight
# half widths of what the observer takes as known
DOUBTS = {"force_per_current": 0.03, "amplifier": 0.05}


@dataclass(frozen=True, slots=True, eq=False)
class Direction:
    """What one parameter changes in the sampled machine, per unit of it: D (n, n) and N (n, m)."""

    D: np.ndarray
    N: np.ndarray


@dataclass(frozen=True, slots=True, eq=False)
class SealModel:
    """Matrices of the monitor at one operating point, sampled every dt [s].

    A (n, n), B (n, m), C (p, n): the machine without the watched seal; L (n, p): the observer's
    gain; W (p, p): makes the prediction error white and of unit size for the noise assumed.
    unknown: per parameter, each in units of ``reference`` (q,), SI; squares: per two of them, half
    the second derivative. doubts: per parameter taken as known, in units of its half width; kinds:
    those of one kind err together. law: the controller as it runs, sampled, from errors to
    currents; loop: A and B of the simulated loop, from e to the states of machine and law.
    """

    paths: tuple[str, ...]
    reference: np.ndarray
    dt: float
    axes: tuple[str, ...]
    point: OperatingPoint
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    L: np.ndarray
    W: np.ndarray
    loop: tuple[np.ndarray, np.ndarray]
    unknown: tuple[Direction, ...]
    squares: tuple[Direction, ...]
    doubts: tuple[Direction, ...]
    kinds: tuple[str, ...]
    law: StateSpace

    @property
    def observer(self) -> np.ndarray:
        """A - L C (n, n), which all filters share."""
        return self.A - self.L @ self.C


def seal_model(
    machine: Machine,
    controller: LawLike,
    point: OperatingPoint,
    paths: Sequence[str],
    dt: float,
    *,
    bending_modes: int = 3,
    computing_delay: int = 1,
    doubts: Mapping[str, float] | None = None,
) -> SealModel:
    """The monitor's matrices for a machine at an operating point.

    paths: seal.<name>.pressure, k, C ... of one seal, or several. doubts: quantity -> relative half
    width (None: ``DOUBTS``). Raises InvalidInput for a path that is no seal's, whose value is zero
    at every operating point, or that the point forbids.
    """
    for path in paths:
        if find_uncertain(machine, path).table != "seal":
            raise InvalidInput(
                f'parameter "{path}" is no seal\'s; the monitor watches paths such as '
                "seal.<name>.pressure"
            )
    plant = reduced_plant(machine, point, bending_modes)
    reference = _reference(machine, paths)
    doubted = _doubted(machine, DOUBTS if doubts is None else doubts)

    # parameters of the model: the q that are watched, by one reference each, then the doubted
    every = [Tolerance(path, absolute=value) for path, value in zip(paths, reference, strict=True)]
    every += [Tolerance(path, relative=width) for path, width, _ in doubted]
    general = uncertain(plant, every)

    u, y = (
        index_of([f"{kind}_{axis}" for axis in plant.axes], names, kind)
        for kind, names in (("u", general.system.inputs), ("y", general.system.outputs))
    )
    dA, dB = directions_of(general, u)
    q = len(paths)

    # the machine without the watched seal: A - sum here_g dA_g, B likewise
    here = nominal_values(plant, paths) / reference
    A = general.system.A
    B = general.system.B[:, u]
    C = general.system.C[y]
    A, B = A - np.tensordot(here, dA[:q], 1), B - np.tensordot(here, dB[:q], 1)

    # D_g, N_g: derivatives of the sampled matrices where theta = 0
    _, _, D, N = held_derivative(A, B, dA, dB, dt)

    # D_gh, N_gh: half the second derivative, by the difference over one reference of theta_h
    squares = []
    for h in range(q):
        _, _, moved, into = held_derivative(A + dA[h], B + dB[h], dA[:q], dB[:q], dt)
        squares.append([Direction((moved[g] - D[g]) / 2, (into[g] - N[g]) / 2) for g in range(q)])

    # process noise: forces at seals and bearings, held over a sample
    forces = index_of(
        [name for name in general.system.inputs if name in plant.named("f")],
        general.system.inputs,
        "f",
    )
    inputs = np.hstack([B, general.system.B[:, forces]])
    Ad, Bd, _, _ = held_derivative(
        A, inputs, np.zeros((0, *A.shape)), np.zeros((0, *inputs.shape)), dt
    )

    # sensors' noise, of both axes of a pair
    noise = np.array([sensor.noise or _NOISE for sensor in machine.sensor_pairs]).repeat(2)
    Q = _FORCE * 9.81 * mass_properties(plant.rotor_model).mass * Bd[:, len(u) :]
    L, W = _kalman(Ad, C, Q @ Q.T, noise)

    directions = tuple(Direction(*pair) for pair in zip(D, N, strict=True))
    law = deployed_controller(plant, controller, dt, computing_delay)

    # instruments: the loop simulated with the seal at its nominal value
    pairs = list(zip(D[:q], N[:q], strict=True))
    loop = _stable_loop(
        law,
        Ad,
        Bd[:, : len(u)],
        C,
        [(here * d, here * n) for here, (d, n) in zip(here, pairs, strict=True)],
    )
    return SealModel(
        tuple(paths),
        reference,
        dt,
        plant.axes,
        plant.point,
        Ad,
        Bd[:, : len(u)],
        C,
        L,
        W,
        loop,
        directions[:q],
        tuple(squares[h][g] for g in range(q) for h in range(q)),
        directions[q:],
        tuple(kind for _, _, kind in doubted),
        law,
    )


def _reference(machine: Machine, paths: Sequence[str]) -> np.ndarray:
    """The unit (q,) of every parameter: its value at the first operating point of the file where it
    is not zero, SI.
    """
    points = (machine.operation.design, *machine.operation.envelope)
    coefficients = []
    for path in paths:
        values = (nominal_values(reduced_plant(machine, point, 0), [path])[0] for point in points)
        value = next((abs(float(value)) for value in values if value), 0.0)
        if value == 0:
            raise invalid(
                f'parameter "{path}"',
                "zero at every operating point",
                "non-zero at one",
                "give it a value to watch",
            )
        coefficients.append(value)
    return np.array(coefficients)


def _stable_loop(
    law: StateSpace,
    A: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    seal: Sequence[tuple[np.ndarray, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """The simulated loop, with as much of the seal's forces at the point as leaves it stable:
    instruments need not be exact.

    Raises InvalidInput where it is unstable without any.
    """
    for share in (1.0, 0.75, 0.5, 0.25, 0.0):
        a, b = A + share * sum(d for d, _ in seal), B + share * sum(n for _, n in seal)
        # u = C_k x_k - D_k y: states (machine, law)
        closed = np.block([[a - b @ law.D @ C, b @ law.C], [-law.B @ C, law.A]])
        if np.abs(np.linalg.eigvals(closed)).max() < 1:
            return closed, np.vstack([b, np.zeros((len(law.A), b.shape[1]))])
    raise InvalidInput(
        "controller and machine without the seal's forces are unstable together, as modelled; "
        "check that the controller is the "
        "one that ran, its delay (--delay-samples) and its sign"
    )


def _doubted(machine: Machine, widths: Mapping[str, float]) -> list[tuple[str, float, str]]:
    """Path, relative half width and kind of what is taken as known."""
    doubted = []
    for quantity, width in widths.items():
        if quantity == "amplifier":
            doubted += [
                (f"amplifier.{name}", width, quantity)
                for name in AMPLIFIER_PARAMETERS[machine.amplifier.order]
                if name.endswith(("bandwidth", "frequency"))
            ]
        else:
            doubted += [
                (f"bearing.{item.name}.{quantity}.{axis}", width, quantity)
                for item in machine.bearings
                for axis in ("zeta", "eta")
            ]
    return [item for item in doubted if item[1] > 0]


def _kalman(
    A: np.ndarray, C: np.ndarray, Q: np.ndarray, noise: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The predictor's gain L (n, p) for process noise Q (n, n) and sensors' noise (p,), and W =
    S^-1/2 of its innovation.
    """
    size = np.sqrt(np.maximum(np.diag(Q), 1e-30 * np.diag(Q).max()))  # states of one size
    # x = size x~, y = noise y~: both noises of unit size
    a = A * size / size[:, None]
    c = C * size / noise[:, None]
    r = np.eye(len(noise))

    # P~ of the prediction error, S~ = c P~ c' + I of the innovation
    P = sla.solve_discrete_are(a.T, c.T, Q / size / size[:, None], r)
    S = c @ P @ c.T + r

    # L = size L~ / noise;   W S W' = I by the Cholesky factor of S~
    return size[:, None] * (a @ P @ c.T @ np.linalg.inv(S)) / noise, np.linalg.inv(
        np.linalg.cholesky(S)
    ) / noise
