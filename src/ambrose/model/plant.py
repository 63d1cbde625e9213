"""The plant: one linear model of the whole machine at an operating point, full or reduced, always
the same type.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ambrose.core.checks import check_types
from ambrose.core.presentation import Presented
from ambrose.core.statespace import StateSpace
from ambrose.machine.criteria import SENSITIVITY_RANGE, SPEED_RANGE_FACTOR
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.effects import sensor
from ambrose.model.effects.rotor import Rotor, finite_element_rotor

# Where forces enter and displacements leave: one port per attachment and direction.


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
    return tuple(
        Port(f"{station.name}_{axis}", station.position, station.angle + number * QUARTER)
        for station in machine.stations
        for number, axis in enumerate(station.axes)
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
    sensors = measured_ports(machine)[0::2]
    turned = [
        sensor.rotation(port.direction - b.angle)
        for port, b in zip(sensors, machine.bearings, strict=True)
    ]
    return np.asarray(block_diag(*turned)) if turned else np.eye(len(machine.axes))


def at_bearings(machine: Machine) -> np.ndarray:
    """(a, a) real: displacements at the bearings of a stiff rotor from those measured, both along
    the axes.

    Between and beyond the sensors by a straight line; with one bearing, or sensors in one plane, as
    measured.
    """
    turned = sensor_turn(machine)
    place = np.array([port.position for port in measured_ports(machine)[0::2]])
    target = np.array([bearing.position for bearing in machine.bearings])
    angle = np.array([bearing.angle for bearing in machine.bearings])
    if len(place) < 2 or np.ptp(place) == 0:
        return turned
    # least-squares line through the sensors, read at the bearings, in the common directions x, y
    line = np.column_stack([target, np.ones_like(target)]) @ np.linalg.pinv(
        np.column_stack([place, np.ones_like(place)])
    )
    result = np.zeros((2 * len(place), 2 * len(place)))

    # pair s, along the axes of bearing s, into the axes of bearing b: turned by their difference
    for b in range(len(target)):
        for s in range(len(place)):
            c, d = np.cos(angle[s] - angle[b]), np.sin(angle[s] - angle[b])
            result[2 * b : 2 * b + 2, 2 * s : 2 * s + 2] = line[b, s] * np.array([[c, -d], [d, c]])
    return result @ turned


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Plant(Presented):
    """Amplifiers, rotor, attachments and sensors at ``point``.

    ``system`` has the inputs
        u_<axis> [A]      current command into the amplifier, axis in machine.axes order
        f_<port> [N]      external force at a bearing or coupling (zeta, eta), seal or disc (x, y)
    and the outputs
        y_<axis> [m]      measured displacement, along the sensors (``ports.measured_ports``)
        i_<axis> [A]      control current in the coil
        q_<port> [m], qdot_<port> [m/s]   displacement and velocity at the ports of the forces.
    ``rotor`` is its mechanical part alone (bearing stiffness, seals and couplings closed), from
    forces f_<port> to q_<port>, qdot_<port> and the displacements s_<channel> [m] at the sensors
    (``ports.sensor_ports``). ``bending_modes`` is None for the full finite-element model, else the
    number of bending modes kept (per plane). ``offsets``: tolerances and where within them (-1..1)
    the parameters of ``system`` stand, see ``model.uncertainty.perturbed``; ``machine`` and
    ``rotor`` are the nominal ones.
    """

    machine: Machine
    point: OperatingPoint
    system: StateSpace
    rotor: StateSpace
    ports: tuple[str, ...]
    bending_modes: int | None = None
    offsets: tuple[tuple[Tolerance, float], ...] = ()

    def __post_init__(self) -> None:
        check_types(type(self).__post_init__, (self,), {})

    @property
    def rotor_model(self) -> Rotor:
        """The free finite-element rotor of the machine; assembled once."""
        return finite_element_rotor(self.machine)

    @property
    def axes(self) -> tuple[str, ...]:
        """The control axes in the machine's order."""
        return self.machine.axes

    def named(self, prefix: str) -> tuple[str, ...]:
        """Signal names of one kind: "u", "y", "i" over the control axes; "f", "q", "qdot" over the
        ports.
        """
        return tuple(
            f"{prefix}_{name}" for name in (self.axes if prefix in {"u", "y", "i"} else self.ports)
        )

    def bearing_named(self, prefix: str) -> tuple[str, ...]:
        """The "f", "q" or "qdot" signals at the bearings, in the order of the axes."""
        return tuple(f"{prefix}_{axis}" for axis in self.axes)

    def facts(self) -> Mapping[str, Any]:
        """Machine and operating point, the size of the model, and the parameters that are moved."""
        point = self.point
        at = point.label or f"{point.speed:.4g} rad/s, {point.seal_pressure:.4g} Pa"
        size = (
            "full"
            if self.bending_modes is None
            else f"{self.bending_modes} bending modes per plane"
        )
        moved = {tolerance.parameter: f"{delta:+.3g}" for tolerance, delta in self.offsets}
        return {
            "machine": self.machine.name,
            "point": at,
            "model": size,
            "states": self.system.n_states,
            **({"offsets": [f"{path} {delta}" for path, delta in moved.items()]} if moved else {}),
            "axes": self.axes,
            "ports": self.ports,
        }

    def to_dict(self) -> dict[str, Any]:
        """Operating point, offsets and the state space with its signal names, ready for JSON."""
        return {
            "machine": self.machine.name,
            "point": asdict(self.point),
            "bending_modes": self.bending_modes,
            "offsets": {tolerance.parameter: delta for tolerance, delta in self.offsets},
            "system": self.system.to_dict(),
        }


def highest_verified(machine: Machine) -> float:
    """The frequency [rad/s] up to which ISO 14839-3 has the sensitivity judged."""
    return max(SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * top_speed(machine))


def holds_only(machine: Machine) -> str:
    """Of a measured rotor the speed at which it holds, in words; "" of one with a drawing."""
    rotor = machine.measured_rotor
    if rotor is None:
        return ""
    return f"the rotor is as measured at {rotor.speed * 30 / np.pi:,.6g} rpm and holds there alone"


def beyond_top_speed(machine: Machine, speed: float) -> str:
    """How far a speed [rad/s] is above the machine's own, in words; "" where it is not, or where
    the machine states none.

    Its own is the upper end of speed_range, else the highest of its operating points and ranges.
    """
    operation = machine.operation
    stated = operation.speed_range[1] > 0
    top = operation.speed_range[1] if stated else top_speed(machine)
    if not 0 < top * (1 + 1e-9) < speed:
        return ""
    rpm = 30 / np.pi
    what = "of speed_range" if stated else "of the fastest operating point"
    return f"{speed * rpm:,.6g} rpm is {100 * speed / top:.4g} % of the {top * rpm:,.6g} rpm {what}"


def top_speed(machine: Machine) -> float:
    """The highest speed the machine is meant for [rad/s]: of its speed range and its operating
    points; 0 at standstill.
    """
    return max(
        machine.operation.speed_range[1], *(point.speed for point in machine.operation.envelope)
    )
