"""Where forces enter and displacements leave: one port per attachment and direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from ambrose.machine.attachment import TILTED, Station, attached
from ambrose.machine.axial import AxialMachine
from ambrose.machine.machine import Machine
from ambrose.model.effects import sensor

QUARTER = np.pi / 2  # [rad] from zeta to eta


@dataclass(frozen=True, slots=True)
class Port:
    """name ("A_zeta", "center_x"), position [m] along the rotor, direction [rad] from the global
    x.
    """

    name: str
    position: float
    direction: float


def ports(machine: Machine) -> tuple[Port, ...]:
    """All ports: bearings (zeta, eta) first, in the order of the axes, then registered effects
    (such as couplings) in their own axes, seals and discs (x, y). Of the axis along the shaft its
    bearing alone.
    """
    if isinstance(machine, AxialMachine):
        return (Port(machine.axes[0], machine.thrust.position, 0.0),)
    stations = [Station(b.name, b.position, b.angle, TILTED) for b in machine.bearings]
    for effect, part in attached(machine):
        stations += effect.stations(part)
    stations += [Station(s.name, s.position) for s in machine.seals]
    stations += [Station(d.name, d.position) for d in machine.discs]
    return tuple(
        Port(f"{station.name}_{axis}", station.position, station.angle + turn)
        for station in stations
        for axis, turn in zip(station.axes, (0.0, QUARTER), strict=True)
    )


def supported_ports(machine: Machine) -> tuple[str, ...]:
    """The ports at which the stator is on a support or a casing that moves: forces of bearing and
    seal act on both.
    """
    moved = {name for support in machine.supports for name in (support.bearing, *support.seals)}
    moved |= {name for mode in machine.casing_modes for name in mode.at}
    return tuple(port.name for port in ports(machine) if port.name.rpartition("_")[0] in moved)


def sensor_ports(machine: Machine) -> tuple[Port, ...]:
    """The places of the single displacement sensors, in the order of
    ``model.effects.sensor.channels``.
    """
    return tuple(
        Port(name, pair.position, (pair.angle or 0.0) + way * QUARTER)
        for name, pair, way in sensor.channels(machine.sensor_pairs, machine.axes)
    )


def measured_ports(machine: Machine) -> tuple[Port, ...]:
    """Where and along what the measured signals y_<axis> read: the mean place of a bearing's
    sensors, the first one's angle.
    """
    ports = []
    for bearing in machine.bearings:
        pairs = [pair for pair in machine.sensor_pairs if pair.bearing == bearing.name]
        place, angle = sum(pair.weight * pair.position for pair in pairs), pairs[0].angle or 0.0
        ports += [
            Port(f"{bearing.name}_{axis}", place, angle + turn)
            for axis, turn in (("zeta", 0.0), ("eta", QUARTER))
        ]
    return tuple(ports)


def sensor_turn(machine: Machine) -> np.ndarray:
    """(axes, axes): displacements along the actuators' axes from the measured ones; the identity
    for sensors at their angle.
    """
    if isinstance(machine, AxialMachine):
        return np.eye(1)
    sensors = measured_ports(machine)[0::2]
    turned = [
        sensor.rotation(port.direction - b.angle)
        for port, b in zip(sensors, machine.bearings, strict=True)
    ]
    return np.asarray(block_diag(*turned))
