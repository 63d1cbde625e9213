"""What the magnets can carry over the frequency, beside everything that the rotor asks of them.

Capacity and margin are those of ``judge.unbalance``. Drawn in: weight, what the seals push with at
the place where the rotor hangs, lasting loads (all static); unbalance as the analysis places it,
where its current and its voltage are largest and at trip; impulses and surges of the machine file;
and, within what unbalance takes, the forces of seals and stages at trip, which a lever carries to
the magnets.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ambrose.annexes.rotordynamics.loop import ShaftLoop, forces_of_components, shaft_loop
from ambrose.annexes.rotordynamics.placement import ShaftMode
from ambrose.annexes.rotordynamics.response import UnbalanceResponse
from ambrose.annexes.rotordynamics.stations import lay_out
from ambrose.core.checks import NumericalFailure
from ambrose.judge.unbalance import (
    AxisLimits,
    Demand,
    Margin,
    axis_limits,
    drive_of,
    load_demands,
    on_axes,
    static_forces,
    together,
)
from ambrose.law.law import LawLike
from ambrose.law.loop import Timing
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import seal_coefficients
from ambrose.model.effects import seal as seals
from ambrose.model.effects.stations import Stage
from ambrose.model.static_load import magnet_coefficients, sag_line, static_sag

# What the amplifier as a circuit would change: a first-order lag leaves out the current that the
# rotor's motion induces in the coils (``model.effects.amplifier``), and the negative stiffness acts
# at once. Every mode is followed into the loop with the circuit.
#
# The inductance is the file's, else k_i^2/(2 k_s), the coil without leakage; R = L/30 ms (assumed),
# which only says how slowly a coil forgets.


FLAG = 0.1  # of a mode's damping ratio: from here on the circuit matters
_TIME = 0.03  # [s] L/R, assumed
_FOLLOWED = 0.2  # of |s|: a root further away is another mode


@dataclass(frozen=True, slots=True)
class CircuitChange:
    """The mode whose damping ratio the circuit moves most: its frequency [rad/s], the ratio
    without and with the circuit; inductance [H], and whether the file states it.
    """

    frequency: float
    before: float
    after: float
    inductance: float
    stated: bool

    @property
    def change(self) -> float:
        """Of the damping ratio."""
        return self.after / self.before - 1


def circuit_change(
    machine: Machine,
    point: OperatingPoint,
    law: LawLike | None,
    timing: Timing | None,
    modes: Sequence[ShaftMode],
) -> CircuitChange | None:
    """The largest change over the modes; None without magnets, for an amplifier that is no
    first-order lag, and where no mode can be followed.
    """
    drive = machine.amplifier
    if law is None or not machine.bearings or drive.order != "first":
        return None
    k_i, k_s = magnet_coefficients(machine, point)
    inductance = drive.inductance or float(np.median(k_i**2 / (2 * k_s)))
    circuit = replace(
        drive,
        order="current-loop",
        max_voltage=None,
        inductance=inductance,
        resistance=inductance / _TIME,
    )
    loop = shaft_loop(lay_out(replace(machine, amplifier=circuit)), point, law, timing)
    found: list[CircuitChange] = []
    for mode in modes:
        s = mode.pole
        try:
            pole, _ = loop.mode_near(s, turn=-1j if mode.forward else 1j)
        except NumericalFailure:
            continue
        if abs(pole - s) <= _FOLLOWED * abs(s):
            ratios = -s.real / abs(s), -pole.real / abs(pole)
            stated = drive.inductance is not None
            found.append(CircuitChange(abs(s.imag), *ratios, inductance, stated))
    return max(found, key=lambda item: abs(item.change), default=None)


_POINTS = 200  # frequencies of the curves, 0.02 to 10 times the trip speed
_SAME = 0.03  # of a speed: the largest voltage nearer to the largest current is not told apart
UNBALANCE, PART = "unbalance", "part of unbalance"
SEALS = "seals"


@dataclass(frozen=True, slots=True, eq=False)
class AxisCapacity:
    """One control axis.

    omega (w,) [rad/s]; force, other (w,) [N] zero to peak that are left on the side of the bias
    that carries the static load and on the other, and what limits the first there. static: (name,
    force [N]) of what lasts, along the axis; the seals' push counts where it adds. demands of all
    loads. margins: capacity over demand, the least first; a load counts on top of unbalance at
    trip.
    """

    axis: str
    bearing: str
    limits: AxisLimits
    omega: np.ndarray
    force: np.ndarray
    other: np.ndarray
    limited_by: tuple[str, ...]
    static: tuple[tuple[str, float], ...]
    demands: tuple[Demand, ...]
    margins: tuple[Margin, ...]

    @property
    def static_force(self) -> float:
        """Size of all that lasts [N]."""
        return abs(self.limits.static) * self.limits.force_per_current

    @property
    def margin(self) -> float:
        """The least of all; inf where nothing is asked."""
        return self.margins[0].value if self.margins else float("inf")

    @property
    def worst(self) -> str:
        """What has the least margin, where, and what limits it."""
        return binding(self.margins[0]) if self.margins else ""

    def least(self, kind: str) -> Margin | None:
        """The least margin of the demands of a kind; None: there are none."""
        rows = (row for row in self.margins if row.demands[0].kind == kind)
        return next(rows, None)


_LIMITS = {  # in words
    "bias current": "bias current",
    "current": "maximum current",
    "force": "maximum force",
    "voltage": "slew rate at the amplifier voltage",
}


def binding(margin: Margin) -> str:
    """Which load, at which frequency, what it takes and what the limit that binds leaves."""
    load, *steady = margin.demands
    own = f'load "{load.name}"' if load.kind != UNBALANCE else f"unbalance ({load.name})"
    beside = "".join(f" beside unbalance ({item.name})" for item in steady)
    return (
        f"{own} at {load.frequency / (2 * np.pi):.4g} Hz{beside}: demand {margin.taken:.4g} "
        f"{margin.unit} 0-p, available {margin.able:.4g} {margin.unit} 0-p, limited by "
        f"{_LIMITS[margin.limited_by]}"
    )


def capacities(
    loop: ShaftLoop,
    loop_at: Callable[[float], ShaftLoop],
    given: LawLike,
    timing: Timing | None,
    response: UnbalanceResponse,
    trip: float,
) -> tuple[AxisCapacity, ...]:
    """Capacity and demand of every axis; loop: at the operating point, loop_at: at another speed
    [rad/s]; response: to the analysis' unbalance up to trip.
    """
    machine = loop.plant.machine
    static, free, limits = _limits(loop)
    loads = load_demands(loop.plant, given, timing)
    at_trip = loop_at(trip)
    parts = _components_at(at_trip, response)
    omega = np.geomspace(max(0.02 * trip, 1.0), 10 * trip, _POINTS)
    found = []
    for a, axis in enumerate(machine.axes):
        unbalance = list(unbalance_demands(loop, response, a))
        steady = max(
            (item for item in unbalance if item.frequency == response.fine[-1]),
            key=lambda item: -limits[a].margin(item).value,
        )
        margins = [together(limits[a], item, ())[0] for item in unbalance]
        margins += together(limits[a], steady, loads[a])[1:]
        side, why = limits[a].over(omega)
        other, _ = limits[a].over(omega, -1)
        k_i = limits[a].force_per_current
        lasting = [(name, float(along[a])) for name, along in static]
        if free[a]:
            lasting.append(("loads of any direction", float(free[a])))
        demands = (*unbalance, *loads[a], *parts[a])
        found.append(
            AxisCapacity(
                axis,
                machine.axis_bearings[a].name,
                limits[a],
                omega,
                k_i * side,
                k_i * other,
                why,
                tuple(lasting),
                demands,
                tuple(sorted(margins, key=lambda item: (item.value, item.of))),
            )
        )
    return tuple(found)


def unbalance_limits(loop: ShaftLoop) -> Sequence[AxisLimits]:
    """What every axis has beside all that lasts."""
    return _limits(loop)[2]


def _limits(
    loop: ShaftLoop,
) -> tuple[list[tuple[str, np.ndarray]], np.ndarray, Sequence[AxisLimits]]:
    """What lasts by its name, the loads of any direction (a,) [N], what is left of every axis."""
    static = _static(loop)
    # with the seals' push and, at rest, without it: the larger of both
    total = np.maximum(
        np.abs(sum(along for _, along in static)),
        np.abs(sum(along for name, along in static if name != SEALS)),
    )
    free = static_forces(loop.plant.machine)[1]
    return static, free, axis_limits(loop.plant, total + free)


def _static(loop: ShaftLoop) -> list[tuple[str, np.ndarray]]:
    """(name, force along every axis (a,) [N]) of what lasts: weight, seals, loads."""
    machine, point = loop.plant.machine, loop.plant.point
    rows = [("weight", static_sag(machine)[1].ravel())]
    if machine.gravity_direction is not None and machine.seals:
        down = np.array([np.cos(machine.gravity_direction), np.sin(machine.gravity_direction)])
        pushes = np.zeros(len(machine.axes))
        for item in machine.seals:
            # -K x of a rotor that hangs through by x from the sensors' zero, the seal's centre
            stiffness = seals.matrices(seal_coefficients(item, point))[0]
            sag = float(sag_line(machine, (item.position,))[0])
            pushes += on_axes(machine, item.position, -stiffness @ (sag * down))
        rows.append((SEALS, pushes))
    lasting, _ = static_forces(machine)
    if lasting.any():
        rows.append(("static loads", lasting))
    return rows


def unbalance_demands(
    loop: ShaftLoop, response: UnbalanceResponse, axis: int, end: str = "at trip"
) -> Iterator[Demand]:
    """What every placement takes of an axis, where current and voltage are largest and at the end
    of the response, called ``end``.
    """
    plant = loop.plant
    bearing = plant.machine.axis_bearings[axis]
    drive = drive_of(plant)
    angle = bearing.angle + (np.pi / 2 if axis % 2 else 0.0)
    along = np.array([np.cos(angle), np.sin(angle)])
    station = response.layout.nearest(bearing.position)
    speeds = response.fine
    for k, case in enumerate(response.cases):
        current = response.at(response.current[:, axis, k], speeds)
        motion = response.at(response.motion[:, station, :, k], speeds) @ along
        s = 1j * speeds
        # (R + s L) i + s k_u q
        voltage = (drive.resistance + s * drive.inductance) * current
        voltage = np.abs(voltage + s * drive.back_emf[axis] * motion)
        current = np.abs(current)
        last = len(speeds) - 1
        places = {int(np.argmax(current)): "largest"}
        slews = int(np.argmax(voltage))
        beside = np.abs(speeds[[*places, last]] - speeds[slews])
        if drive.inductance and (beside > _SAME * speeds[slews]).all():
            places[slews] = "largest voltage"
        for place, word in (places | {last: end}).items():
            i = float(current[place])
            yield Demand(
                f"{case.name}, {word}",
                UNBALANCE,
                float(speeds[place]),
                i,
                float(voltage[place]),
                float(drive.force_per_current[axis]) * i,
            )


def _components_at(loop: ShaftLoop, response: UnbalanceResponse) -> list[list[Demand]]:
    """What seals and stages push with at trip under the unbalance that moves them most, carried to
    every axis by a lever: part of what unbalance takes.
    """
    machine, w = loop.plant.machine, loop.point.speed
    stages = {stage.name: stage.position for stage in machine.parts(Stage)}
    places = {item.name: item.position for item in machine.seals} | stages
    stations = len(response.layout.positions)
    largest: dict[str, np.ndarray] = {}
    for case in response.cases:
        x = loop.states(1j * w, case.forces(stations) * w**2)
        for component in forces_of_components(loop, 1j * w, x):
            if component.station in places:
                size = np.abs(on_axes(machine, places[component.station], component.force))
                name = f"stage {component.name}" if component.name in stages else component.name
                largest[name] = np.maximum(largest.get(name, 0 * size), size)
    drive = drive_of(loop.plant)
    rows: list[list[Demand]] = [[] for _ in machine.axes]
    for name, size in largest.items():
        for a, force in enumerate(size):
            i = float(force / drive.force_per_current[a])
            v = float(np.hypot(drive.resistance, w * drive.inductance)) * i
            rows[a].append(Demand(f"{name}, at trip", PART, w, i, v, float(force)))
    return rows
