"""The rotor under its weight, held where its sensors read zero: what each magnet carries, how far it hangs through there."""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import named_failure
from ambrose.machine.machine import Machine
from ambrose.physics.rotor import STANDARD_GRAVITY, finite_element_rotor, plane_rows
from ambrose.plant.ports import measured_ports


@named_failure("the static deflection of the rotor")
def static_sag(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (b, 2) [m] at the magnets and weight (b, 2) [N] on them, along each bearing's axes; zero without weight.

    The shaft alone: K w = W + B^T f with S w = 0 at the sensors; couplings, seals and supports are left out. A slender rotor
    hangs tens of micrometres through between sensor and magnet, where the negative stiffness is then another.
    """
    b = len(machine.bearings)
    if machine.gravity_direction is None:
        return np.zeros((b, 2)), np.zeros((b, 2))
    rotor = finite_element_rotor(machine)
    K, n = rotor.plane_stiffness, len(rotor.plane_stiffness)
    at, _ = plane_rows(rotor, [bearing.position for bearing in machine.bearings])
    read, _ = plane_rows(rotor, [port.position for port in measured_ports(machine)[0::2]])
    size = float(np.abs(K).max())
    translation = np.tile([1.0, 0.0], n // 2)
    whole = np.block([[K / size, -at.T], [read, np.zeros((b, b))]])
    w = np.linalg.solve(whole, np.concatenate([STANDARD_GRAVITY * rotor.plane_mass @ translation / size, np.zeros(b)]))
    angle = np.array([machine.gravity_direction - bearing.angle for bearing in machine.bearings])
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    return (at @ w[:n])[:, None] * along, -(w[n:] * size)[:, None] * along
