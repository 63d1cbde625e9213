"""Machine and operating point -> Plant, in three steps: the rotor with its attachments, its state space, the wiring."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg as sla

from ambrose.core.mechanical import SecondOrder, to_statespace
from ambrose.core.statespace import StateSpace, connect, rename, static_gain
from ambrose.machine.description import Machine, OperatingPoint
from ambrose.physics import amplifier, coupling, magnet, seal, sensor
from ambrose.physics.rotor import Rotor, displacement_row, finite_element_rotor, free_modes
from ambrose.plant.model import Plant
from ambrose.plant.ports import ports, sensor_ports

_DAMPED_MODES = 30  # bending modes that get exactly the stated damping ratio; above, the ratio grows with frequency


def assemble(machine: Machine, point: OperatingPoint | None = None) -> Plant:
    """The full finite-element plant (4 DOF per node) at an operating point (default: the machine's nominal one).

    Raises InvalidInput where the point lies outside a seal's table or a bearing's measured bias currents.
    """
    point = machine.operation.nominal if point is None else point
    rotor = to_statespace(attached_rotor(machine, point, finite_element_rotor(machine)), point.speed)
    return wire(machine, point, rotor)


def attached_rotor(machine: Machine, point: OperatingPoint, rotor: Rotor) -> SecondOrder:
    """The free rotor plus bearing stiffness, seals, couplings and modal damping, as a second-order system with all ports.

    Inputs f_<port> [N]; outputs q_<port> and s_<axis> [m]; velocity outputs qdot_<port> [m/s].
    """
    places = ports(machine)
    N = np.array([displacement_row(rotor, p.position, p.direction) for p in places])
    S = np.array([displacement_row(rotor, p.position, p.direction) for p in sensor_ports(machine)])
    rows = {p.name: row for p, row in zip(places, N, strict=True)}
    mass, damping, stiffness = rotor.mass.copy(), modal_damping(machine, rotor), rotor.stiffness.copy()
    for bearing in machine.bearings:
        pair = np.array([rows[f"{bearing.name}_zeta"], rows[f"{bearing.name}_eta"]])
        stiffness -= pair.T @ np.diag(magnet.linearised(bearing, point.bias_current).negative_stiffness) @ pair
    for item in machine.couplings:
        pair = np.array([rows[f"{item.name}_zeta"], rows[f"{item.name}_eta"]])
        k, d = coupling.matrices(item)
        stiffness += pair.T @ k @ pair
        damping += pair.T @ d @ pair
    for item in machine.seals:
        pair = np.array([rows[f"{item.name}_x"], rows[f"{item.name}_y"]])
        k, d, m = seal.matrices(seal_coefficients(item, point))
        stiffness += pair.T @ k @ pair
        damping += pair.T @ d @ pair
        mass += pair.T @ m @ pair
    names = [p.name for p in places]
    return SecondOrder(
        mass,
        damping,
        rotor.gyroscopic,
        stiffness,
        N.T,
        np.vstack([N, S]),
        N,
        tuple(f"f_{name}" for name in names),
        tuple(f"q_{name}" for name in names) + tuple(f"s_{axis}" for axis in machine.axes),
        tuple(f"qdot_{name}" for name in names),
    )


def seal_coefficients(item: seal.Seal, point: OperatingPoint) -> seal.SealCoefficients:
    """The seal's coefficients at the point; frequency-dependent tables are read at its whirl frequency."""
    frequency = point.speed if point.whirl_frequency is None else point.whirl_frequency
    return seal.coefficients(item, point.seal_pressure, point.speed, frequency)


def modal_damping(machine: Machine, rotor: Rotor) -> np.ndarray:
    """Damping matrix (n, n) [N s/m] that gives the lowest bending modes of the free rotor the stated ratio, rigid modes none.

    D = M Phi diag(2 zeta w - beta w^2) Phi' M + beta K with beta = 2 zeta / w_k: ratio zeta up to mode k, growing above.
    """
    zeta = machine.modal_damping
    count = min(_DAMPED_MODES, len(rotor.positions) - 2)
    modes = free_modes(rotor, count)
    bending, w = modes.shapes[:, 4:], modes.frequencies[4:]
    beta = 2 * zeta / w.max()
    P = rotor.mass @ bending
    return (P * (2 * zeta * w - beta * w**2)) @ P.T + beta * rotor.stiffness


def wire(
    machine: Machine,
    point: OperatingPoint,
    rotor: StateSpace,
    bending_modes: int | None = None,
) -> Plant:
    """Amplifiers and sensors around a rotor state space (full or reduced)."""
    names = tuple(p.name for p in ports(machine))
    system = connect(
        [
            rename(rotor, [f"F_{name}" for name in names]),
            amplifier.linearised(machine.amplifier, machine.axes),
            magnets(machine, point),
            sensor.linearised(machine.sensors, machine.axes),
        ],
        inputs=plant_inputs(machine.axes, names),
        outputs=plant_outputs(machine.axes, names),
        sums=force_sums(machine.axes, names),
    )
    return Plant(machine, point, system, rotor, names, bending_modes)


def plant_inputs(axes: Sequence[str], names: Sequence[str]) -> list[str]:
    """The plant's input names: currents, then forces."""
    return [f"u_{a}" for a in axes] + [f"f_{n}" for n in names]


def plant_outputs(axes: Sequence[str], names: Sequence[str]) -> list[str]:
    """The plant's output names: measurements, coil currents, displacements, velocities."""
    return [f"{kind}_{a}" for kind in "yi" for a in axes] + [f"{kind}_{n}" for kind in ("q", "qdot") for n in names]


def force_sums(axes: Sequence[str], names: Sequence[str]) -> dict[str, list[str]]:
    """The rotor's force F_<port> is the external force, at a bearing plus the magnet's current force m_<axis>."""
    return {f"F_{name}": [f"f_{name}", f"m_{name}"] if name in axes else [f"f_{name}"] for name in names}


def magnets(machine: Machine, point: OperatingPoint) -> StateSpace:
    """The current force of every axis, i_<axis> [A] -> m_<axis> [N]; the displacement force is part of the rotor."""
    k_i = np.concatenate([magnet.linearised(b, point.bias_current).force_per_current for b in machine.bearings])
    return static_gain(np.diag(k_i), [f"i_{a}" for a in machine.axes], [f"m_{a}" for a in machine.axes])


def static_response(system: SecondOrder) -> np.ndarray:
    """Displacement outputs per static force, C K^-1 B, (p, m) [m/N]."""
    return system.C @ sla.solve(system.stiffness, system.B)
