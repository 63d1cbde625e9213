"""The plant: one linear model of the whole machine at an operating point, full or reduced, always the same type."""

from __future__ import annotations

from dataclasses import dataclass

from ambrose.core.statespace import StateSpace
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """Amplifiers, rotor, attachments and sensors at ``point``.

    ``system`` has the inputs
        u_<axis> [A]      current command into the amplifier, axis in machine.axes order (A_zeta, A_eta, B_zeta, B_eta)
        f_<port> [N]      external force on the rotor at a bearing or coupling (zeta, eta), seal or disc (x, y)
    and the outputs
        y_<axis> [m]      measured displacement
        i_<axis> [A]      control current in the coil
        q_<port> [m], qdot_<port> [m/s]   rotor displacement and velocity at the same ports as the forces.
    ``rotor`` is its mechanical part alone (bearing stiffness, seals and couplings closed), from forces f_<port> to q_<port>,
    qdot_<port> and the displacements s_<axis> [m] at the sensors. ``bending_modes`` is None for the full finite-element
    model, else the number of bending modes kept (per plane).
    """

    machine: Machine
    point: OperatingPoint
    system: StateSpace
    rotor: StateSpace
    ports: tuple[str, ...]
    bending_modes: int | None = None

    @property
    def axes(self) -> tuple[str, ...]:
        return self.machine.axes

    def named(self, prefix: str) -> tuple[str, ...]:
        """Signal names of one kind: "u", "y", "i" over the control axes; "f", "q", "qdot" over the ports."""
        return tuple(f"{prefix}_{name}" for name in (self.axes if prefix in {"u", "y", "i"} else self.ports))

    def bearing_named(self, prefix: str) -> tuple[str, ...]:
        """The "f", "q" or "qdot" signals at the bearings, in the order of the axes."""
        return tuple(f"{prefix}_{axis}" for axis in self.axes)
