"""Where a record knows the rotor's motion: places along the shaft with their orbits in the global
x, y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.machine import Machine
from ambrose.model.ports import Port, measured_ports, ports
from ambrose.record.record import Record
from ambrose.report import theme, units
from ambrose.rig.scenario import Scenario

_FEWEST = 32  # samples in a window
_PERIODS = 3.0
NEAR = 2.2  # a touchdown circle up to this many times the largest orbit is drawn


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """name of the bearing, seal, disc or coupling; position [m] along the rotor; x, y (k,) [m];
    angle [rad] of its own axes.

    gap [m]: radius of the touchdown bearing there. at_sensor: measured at the bearing's sensor, not
    in the bearing.
    """

    name: str
    position: float
    x: np.ndarray
    y: np.ndarray
    angle: float = 0.0
    gap: float | None = None
    bearing: bool = False
    at_sensor: bool = False

    @property
    def title(self) -> str:
        """The name as it stands above a picture: "bearing A", "sensor B", a disc's own; for
        plotly.
        """
        where = "sensor" if self.at_sensor else "bearing" if self.bearing else ""
        return theme.plain(" ".join(filter(None, (where, units.axis_name(self.name)))))

    @property
    def radius(self) -> np.ndarray:
        """Distance from the centre (k,) [m]."""
        return np.hypot(self.x, self.y)


def stations(record: Record, machine: Machine) -> tuple[Station, ...]:
    """The stations whose two directions the record holds, bearings first: rotor displacements q_,
    else the sensors' y_.

    Raises InvalidInput where the record has neither.
    """
    gaps = {bearing.name: bearing.touchdown_gap for bearing in machine.bearings}
    places = [(pair, "q", False) for pair in _pairs(ports(machine))]
    if not any(
        f"q_{port.name}" in record.signals for (port, _), _, _ in places if _name(port) in gaps
    ):
        places = [(pair, "y", True) for pair in _pairs(measured_ports(machine))] + places
    result = []
    for (first, second), kind, sensor in places:
        names = (f"{kind}_{first.name}", f"{kind}_{second.name}")
        if not all(name in record.signals for name in names):
            continue
        u, v = record[names[0]], record[names[1]]
        c, s = np.cos(first.direction), np.sin(first.direction)
        name = _name(first)
        result.append(
            Station(
                name,
                first.position,
                c * u - s * v,
                s * u + c * v,
                first.direction,
                gaps.get(name),
                name in gaps,
                sensor,
            )
        )
    if not result:
        wanted = f"y_{machine.axes[0]} and y_{machine.axes[1]}"
        raise InvalidInput(
            f"the record of {record.machine} holds no displacements in two directions; it needs "
            f"{wanted}"
        )
    return tuple(result)


def rotor_speed(record: Record, scenario: Scenario | None = None) -> np.ndarray:
    """Rotor speed at every sample (k,) [rad/s]: from a signal "speed...", else the scenario, else
    the operating point.
    """
    names = [name for name in record.signals if name.partition("_")[0] == "speed"]
    if names:
        return record[names[0]]
    if scenario is not None and scenario.speed is not None:
        return np.array([scenario.speed_at(t) for t in record.time])
    return np.full(record.values.shape[1], record.point.speed)


def window(record: Record, places: tuple[Station, ...], speed: np.ndarray, centre: int) -> slice:
    """The samples of three revolutions (at standstill: of three periods of the strongest motion)
    around a sample.
    """
    k = len(speed)
    frequency = abs(float(speed[centre])) / (2 * np.pi)
    if frequency <= 0:
        frequency = _strongest(record, places, centre)
    length = int(
        np.clip(_PERIODS * record.sample_rate_hz / max(frequency, 1e-9), min(_FEWEST, k), k)
    )
    start = int(np.clip(centre - length // 2, 0, k - length))
    return slice(start, start + length)


def largest(places: tuple[Station, ...]) -> tuple[Station, int]:
    """The station and the sample of the largest displacement in a bearing (anywhere, where no
    bearing is known).
    """
    known = [station for station in places if station.bearing] or list(places)
    station = max(known, key=lambda item: float(item.radius.max()))
    return station, int(station.radius.argmax())


def _strongest(record: Record, places: tuple[Station, ...], centre: int) -> float:
    """Frequency [Hz] of the strongest motion around a sample."""
    station = largest(places)[0]
    half = min(2048, len(station.x) // 2)
    if half < _FEWEST // 2:
        return 0.0
    start = int(np.clip(centre - half, 0, len(station.x) - 2 * half))
    z = (station.x + 1j * station.y)[start : start + 2 * half]
    size = np.abs(np.fft.fft((z - z.mean()) * np.hanning(2 * half)))
    frequencies = np.abs(np.fft.fftfreq(2 * half, record.dt))
    size[frequencies < 2 * record.sample_rate_hz / (2 * half)] = 0.0  # drift is no vibration
    return float(frequencies[size.argmax()])


def _pairs(flat: tuple[Port, ...]) -> list[tuple[Port, Port]]:
    return list(zip(flat[0::2], flat[1::2], strict=True))


def _name(port: Port) -> str:
    return port.name.rpartition("_")[0]
