"""Where forces enter and displacements leave: one port per attachment and direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.machine.machine import Machine

QUARTER = np.pi / 2


@dataclass(frozen=True, slots=True)
class Port:
    """name ("A_zeta", "center_x"), position [m] along the rotor, direction [rad] from the global x."""

    name: str
    position: float
    direction: float


def ports(machine: Machine) -> tuple[Port, ...]:
    """All ports: bearings (zeta, eta) first, in the order of the axes, then couplings (zeta, eta), seals and discs (x, y)."""
    tilted = [(b.name, b.position, b.angle) for b in machine.bearings] + [
        (c.name, c.position, c.angle) for c in machine.couplings
    ]
    upright = [(s.name, s.position, 0.0) for s in machine.seals] + [(d.name, d.position, 0.0) for d in machine.discs]
    return tuple(
        Port(f"{name}_{axis}", position, angle + turn)
        for group, axes in ((tilted, ("zeta", "eta")), (upright, ("x", "y")))
        for name, position, angle in group
        for axis, turn in zip(axes, (0.0, QUARTER), strict=True)
    )


def sensor_ports(machine: Machine) -> tuple[Port, ...]:
    """The places of the displacement sensors, one per control axis, in the order of the axes."""
    sensors = {sensor.bearing: sensor for sensor in machine.sensors}
    return tuple(
        Port(f"{bearing.name}_{axis}", sensors[bearing.name].position, bearing.angle + turn)
        for bearing in machine.bearings
        for axis, turn in (("zeta", 0.0), ("eta", QUARTER))
    )
