"""The plant of the axis along the shaft:

    m x'' + d x' + k x = F + h_left v_left + h_right v_right,    v = k_i i + k_s x of each side,

rotor mass, coupling to ground, external force, and both magnets' forces after their solid cores
(none: at once). The signals are those of any plant (``model.plant``), its one port and axis called
<thrust bearing>_z. left_<axis> and right_<axis> [N] are the forces before the cores.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg as sla

from ambrose.core.statespace import StateSpace, static_gain
from ambrose.machine.axial import AxialMachine
from ambrose.machine.description import OperatingPoint
from ambrose.model.axial.magnet import at_point, closed_lags, core_lags
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties

SIDES = ("left", "right")
_SCALE = 300.0  # [rad/s] of the velocity's state, as of the rigid modes of the radial plant
_SAME = 1e-12  # relative: cores that lag alike are one


def rotor_mass(machine: AxialMachine) -> float:
    """The mass that moves along the axis [kg]: the whole rotor's."""
    return float(mass_properties(finite_element_rotor(machine)).mass)


def rotor_statespace(machine: AxialMachine, point: OperatingPoint) -> StateSpace:
    """Inputs f_<axis>, left_<axis>, right_<axis> [N]; outputs q_<axis>, s_<axis> [m] and
    qdot_<axis> [m/s], and core_left_<axis> [N], what the eddy currents take of the left magnet's
    force, or of both where these are alike, else core_right_<axis> as well; the negative stiffness
    closed.

    States: x [m], x'/300 [m], then those of the cores [N]. Raises InvalidInput where the magnets
    cannot carry the point's load.
    """
    (axis,), part = machine.axes, machine.thrust
    mass, at = rotor_mass(machine), at_point(machine, point)
    models = core_lags(part)

    # banks: the lags of the left and of the right side, one where they are alike
    sizes: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    into: list[list[float]] = []
    direct = [0.0, 0.0]
    for number, (model, item) in enumerate(zip(models, (at.left, at.right), strict=True)):
        if model is None:
            direct[number] = 1.0
        elif sizes and _alike(sizes[0], closed_lags(model, item.ratio)):
            into[0][number] = 1.0
        else:
            sizes.append(closed_lags(model, item.ratio))
            into.append([float(number == k) for k in range(2)])

    # x' = _SCALE z, z' = (F + sum C z_k + direct v - k x - d _SCALE z)/(m _SCALE),
    # z_k' = A z_k + B v
    k_s = np.array([at.left.stiffness, at.right.stiffness])
    lags = sla.block_diag(*[A for A, *_ in sizes]) if sizes else np.zeros((0, 0))
    n = len(lags)
    drive = np.vstack(
        [np.outer(B, row) for (_, B, _), row in zip(sizes, into, strict=True)] or [np.zeros((0, 2))]
    )
    out = np.concatenate([C for *_, C in sizes]) if sizes else np.zeros(0)
    A = np.zeros((2 + n, 2 + n))
    A[0, 1] = _SCALE
    A[1, 0] = (np.dot(direct, k_s) - part.coupling_stiffness) / (mass * _SCALE)
    A[1, 1] = -part.coupling_damping / mass
    A[1, 2:] = out / (mass * _SCALE)
    A[2:, 0] = drive @ k_s
    A[2:, 2:] = lags
    B = np.zeros((2 + n, 3))
    B[1] = np.array([1.0, *direct]) / (mass * _SCALE)
    B[2:, 1:] = drive
    C, D = np.zeros((3 + len(sizes), 2 + n)), np.zeros((3 + len(sizes), 3))
    C[0, 0] = C[1, 0] = 1.0
    C[2, 1] = _SCALE

    # what the eddy currents of every bank take: v - C z, the force without them less that with them
    cores, at_state = [], 2
    for number, ((_, _, part_out), row) in enumerate(zip(sizes, into, strict=True)):
        C[3 + number, 0] = np.dot(row, k_s)
        C[3 + number, at_state : at_state + len(part_out)] = -part_out
        D[3 + number, 1:] = row
        at_state += len(part_out)
        cores.append(f"core_{SIDES[row.index(1.0)]}_{axis}")
    return StateSpace(
        A,
        B,
        C,
        D,
        [f"f_{axis}", *(f"{side}_{axis}" for side in SIDES)],
        [f"q_{axis}", f"s_{axis}", f"qdot_{axis}", *cores],
    )


def _alike(one: tuple[np.ndarray, ...], other: tuple[np.ndarray, ...]) -> bool:
    return all(
        a.shape == b.shape and np.allclose(a, b, rtol=_SAME, atol=0.0)
        for a, b in zip(one, other, strict=True)
    )


def rotor_inputs(machine: AxialMachine) -> list[str]:
    """The rotor's inputs within the plant."""
    (axis,) = machine.axes
    return [f"F_{axis}", *(f"{side}_{axis}" for side in SIDES)]


def force_sums(machine: AxialMachine) -> dict[str, list[str]]:
    """The external force on the rotor, and each magnet's current force before its core."""
    (axis,) = machine.axes
    return {
        f"F_{axis}": [f"f_{axis}"],
        **{f"{side}_{axis}": [f"m_{side}_{axis}"] for side in SIDES},
    }


def magnets(machine: AxialMachine, point: OperatingPoint) -> StateSpace:
    """i_<axis> [A] -> m_left_<axis>, m_right_<axis> [N]: k_i i of each side, before its core."""
    (axis,), at = machine.axes, at_point(machine, point)
    gains = [[at.left.force_per_current], [at.right.force_per_current]]
    return static_gain(gains, [f"i_{axis}"], [f"m_{side}_{axis}" for side in SIDES])
