"""Scenario: what is done to a closed loop during a simulation; its TOML files, and the bundled
ones.

Its parts are in disturbances.py. Disturbances act on the loop's input signals by name: current
excitation e_<axis> [A], output disturbance d_<axis> [m], reference r_<axis> [m], force
f_<port>_<direction> [N]; unbalance acts at a port, in both directions.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.arguments import names_wrong_types
from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.presentation import Presented
from ambrose.machine.axial import AxialMachine
from ambrose.machine.file.toml import read_toml
from ambrose.machine.machine import Machine
from ambrose.machine.messages import suggestion
from ambrose.machine.units import DIMENSIONS, read_quantity
from ambrose.record.record import signal_dimension
from ambrose.rig.disturbances import (
    Chirp,
    Disturbance,
    Failure,
    Prbs,
    PressureChange,
    PressureSensor,
    Pulse,
    Sine,
    SpeedChange,
    SteppedSine,
    Unbalance,
    check_disturbance,
)
from ambrose.rig.machine_terms import (
    along_shaft,
    at_bearings,
    names_thrust,
    on_thrust,
    read_share,
    relative_values,
    with_quantities,
)

LEVITATED = "levitated"
INITIAL_STATES = (LEVITATED, "resting")


@dataclass(frozen=True, slots=True, repr=False)
class Scenario(Presented):
    """All disturbances of one simulation, which lasts ``duration`` [s].

    speed [rad/s] (None: that of the loop) goes linearly to ``to_speed`` over ``ramp`` [s] (None:
    the whole duration) and stays there, or follows the changes of speed. sample_time [s]: None
    leaves it to the simulation. For the virtual rig alone: ``initial`` state, "levitated" in
    equilibrium or "resting" in the touchdown bearings; changes of pressure while the speed changes,
    too, and of what its sensor tells a controller that is scheduled over it; failures; switch_at
    [s], where a second controller takes over. Bearings may be called "first", "last" and "every",
    and quantities be shares of the machine's (machine_terms.py), until a simulation calls
    ``on(machine)``. Raises InvalidInput.
    """

    name: str
    duration: float
    pulses: tuple[Pulse, ...] = ()
    sines: tuple[Sine, ...] = ()
    stepped_sines: tuple[SteppedSine, ...] = ()
    chirps: tuple[Chirp, ...] = ()
    sequences: tuple[Prbs, ...] = ()
    unbalances: tuple[Unbalance, ...] = ()
    pressures: tuple[PressureChange, ...] = ()
    failures: tuple[Failure, ...] = ()
    speed_changes: tuple[SpeedChange, ...] = ()
    pressure_sensors: tuple[PressureSensor, ...] = ()
    speed: float | None = None
    to_speed: float | None = None
    ramp: float | None = None
    sample_time: float | None = None
    initial: str = LEVITATED
    switch_at: float | None = None
    description: str = ""

    @names_wrong_types
    def __post_init__(self) -> None:
        check_positive(self.duration, "the scenario's duration", "give it in seconds")
        if self.sample_time is not None:
            check_positive(self.sample_time, "sample_time", "give it in seconds")
        for item in self.all_windows:
            check_disturbance(item, self.duration)
        starts = [("the time of a change of pressure", item.time) for item in self.pressures]
        starts += [("the time of a failure", item.time) for item in self.failures]
        starts += [
            ("until of a failure", item.until) for item in self.failures if item.until is not None
        ]
        starts += [("the time of a change of speed", item.time) for item in self.speed_changes]
        starts += [("the time of a pressure sensor", item.time) for item in self.pressure_sensors]
        if self.switch_at is not None:
            starts.append(("switch_at", self.switch_at))
        for what, start in starts:
            if not 0 <= start < self.duration:
                raise invalid(what, start, f"within 0 to {self.duration:g} s", "move it")
        if self.initial not in INITIAL_STATES:
            raise invalid("initial", repr(self.initial), " or ".join(INITIAL_STATES), "correct it")
        of_pressure: Sequence[PressureChange | SpeedChange] = self.pressures
        of_speed: Sequence[PressureChange | SpeedChange] = self.speed_changes
        for what, changes in (("pressure", of_pressure), ("speed", of_speed)):
            for earlier, later in pairwise(changes):
                if later.time < earlier.time + earlier.ramp:
                    requirement = (
                        f"after the one before is over, at {earlier.time + earlier.ramp:g} s"
                    )
                    raise invalid(
                        f"the time of a change of {what}", later.time, requirement, "move it"
                    )
        if any(later.time <= earlier.time for earlier, later in pairwise(self.pressure_sensors)):
            raise InvalidInput(
                "the pressure sensors are not in the order of their times; give each its own, "
                "ascending"
            )
        for name in ("speed", "to_speed"):
            if (value := getattr(self, name)) is not None:
                check_positive(value, name, "a rotor turns one way, from x to y", zero_allowed=True)
        if self.to_speed is not None and self.speed_changes:
            raise InvalidInput("to_speed and changes of speed are both given; keep one of the two")
        if (self.to_speed is not None or self.speed_changes) and self.speed is None:
            raise InvalidInput(
                "a change of speed is given without speed; give the speed at the start"
            )
        if self.ramp is not None and (self.to_speed is None or not 0 < self.ramp <= self.duration):
            raise invalid(
                "ramp",
                self.ramp,
                "positive, within the duration, and with a to_speed",
                "correct the run-up",
            )
        if self.unbalances and self.speed is None:
            raise InvalidInput(
                "an unbalance is given without speed; give the speed at which the rotor turns"
            )

    @property
    def all_sines(self) -> tuple[Sine, ...]:
        """The sines and the steps of the stepped sines that begin within the duration."""
        steps = [
            sine for item in self.stepped_sines for sine in item.sines if sine.start < self.duration
        ]
        return (*self.sines, *steps)

    @property
    def all_windows(self) -> tuple[Disturbance, ...]:
        """Everything that acts on one signal for a time."""
        return (*self.pulses, *self.all_sines, *self.chirps, *self.sequences)

    @property
    def fastest(self) -> float:
        """The highest frequency [rad/s] of a sine, chirp or unbalance; 0 without any."""
        frequencies = [sine.frequency for sine in self.all_sines]
        frequencies += [
            frequency for item in self.chirps for frequency in (item.frequency, item.to_frequency)
        ]
        if self.unbalances:
            frequencies += [abs(speed) for speed in self.speed_knots[1]]
        return max(frequencies, default=0.0)

    @property
    def quiet(self) -> Scenario:
        """The same without anything that disturbs: its speeds and pressures."""
        nothing: dict[str, Any] = dict.fromkeys(
            (
                "pulses",
                "sines",
                "stepped_sines",
                "chirps",
                "sequences",
                "unbalances",
                "failures",
                "pressure_sensors",
            ),
            (),
        )
        return replace(self, **nothing)

    @property
    def only_for_the_rig(self) -> tuple[str, ...]:
        """What of this scenario a linear model at one operating point cannot follow, in words."""
        parts = ["the start from rest"] if self.initial != LEVITATED else []
        parts += ["changes of pressure"] if self.pressures else []
        parts += ["several changes of speed"] if self.speed_changes else []
        parts += ["failures"] if self.failures else []
        parts += ["a pressure sensor"] if self.pressure_sensors else []
        return (*parts, *(["the switch of controllers"] if self.switch_at is not None else []))

    @property
    def runs_up(self) -> bool:
        """Whether the speed changes."""
        return len(set(self.speed_knots[1])) > 1

    def pressure_knots(self, start: float, dt: float) -> tuple[list[float], list[float]]:
        """Times [s] and pressures [Pa], ``start`` at first, between which the pressure is linear; a
        change without ramp takes dt [s].
        """
        times, values = [0.0], [start]
        for change in self.pressures:
            times += [max(change.time, times[-1]), change.time + max(change.ramp, dt)]
            values += [values[-1], change.pressure]
        return times, values

    @property
    def speed_knots(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Times [s] and speeds [rad/s] between which the speed is linear, and after which it stays;
        empty without a speed.
        """
        if self.speed is None:
            return (), ()
        changes = list(self.speed_changes)
        if self.to_speed is not None:
            changes = [SpeedChange(0.0, self.to_speed, self.ramp or self.duration)]
        times, speeds = [0.0], [self.speed]
        for change in changes:
            if change.time > times[-1]:
                times, speeds = [*times, change.time], [*speeds, speeds[-1]]
            times, speeds = [*times, change.time + change.ramp], [*speeds, change.speed]
        return tuple(times), tuple(speeds)

    def on(self, machine: Machine) -> Scenario:
        """The same with the machine's bearings and numbers. Raises InvalidInput where it lacks one
        that is asked for.
        """
        if self.names_thrust and not isinstance(machine, AxialMachine):
            remedy = "give its axial controller, too (--axial), or take file.toml#axial"
            if not machine.has_axis:
                remedy = f"{machine.name} has no [[thrust_bearing]]; take another scenario"
            raise InvalidInput(f"scenario {self.name} acts along the shaft; {remedy}")
        names = dict.fromkeys(bearing.name for bearing in machine.axis_bearings)
        found = self.at_bearings(list(names), machine)
        if not isinstance(machine, AxialMachine):
            return found
        (axis,) = machine.axes
        chosen = on_thrust if self.names_thrust else along_shaft
        along = {name: chosen(getattr(found, name), axis) for name, _ in _TABLES.values()}
        still: dict[str, Any] = dict.fromkeys(_ACROSS, ())
        still |= dict.fromkeys(("speed", "to_speed", "ramp"))
        left = replace(found, **{**along, **still})
        if not left.acts and self.disturbs:
            acting = [name for name in _bundled_names() if load_scenario(name).acts_along]
            raise InvalidInput(
                f"scenario {self.name} does nothing along the shaft of {machine.name}: unbalance, "
                "speed, seal pressure and what is along a bearing's second direction are across "
                f"it; take one that acts, such as {', '.join(acting)}"
            )
        return left

    @property
    def names_thrust(self) -> bool:
        """Whether something of it is along the shaft by its name: it then acts there alone."""
        return any(names_thrust(item) for item in (*self.all_windows, *self.failures))

    def parted(self, machine: Machine) -> tuple[Scenario, Scenario]:
        """What of it is for the radial axes and what for the one along the shaft, of a machine that
        has both; a failure without an axis is of both. Raises InvalidInput as ``on``.
        """
        kinds = [name for name, _ in _TABLES.values()]
        across: dict[str, Any] = {}
        along: dict[str, Any] = {}
        for name in kinds:
            items = getattr(self, name)
            across[name] = tuple(item for item in items if not names_thrust(item))
            along[name] = tuple(item for item in items if names_thrust(item))
        along["failures"] += tuple(item for item in self.failures if item.axis is None)
        for name in _ACROSS:
            along[name] = ()
        still: dict[str, Any] = dict.fromkeys(("speed", "to_speed", "ramp"))
        axial = replace(self, **{**along, **still}).on(machine.axial)
        return replace(self, **across).on(machine), axial

    @property
    def acts(self) -> bool:
        """Whether something pushes, fails, or is lifted."""
        return bool(self.all_windows or self.failures) or self.initial != LEVITATED

    @property
    def disturbs(self) -> bool:
        """Whether something happens, on whatever axes."""
        changes = any(getattr(self, name) for name in _ACROSS)
        return self.acts or changes or self.to_speed is not None

    @property
    def acts_along(self) -> bool:
        """Whether something of it acts on the axis along the shaft, too."""
        pushing = any(not item.signal.endswith("_eta") for item in self.all_windows)
        failing = any(not (item.axis or "").endswith("_eta") for item in self.failures)
        return pushing or failing or self.initial != LEVITATED

    @property
    def across(self) -> tuple[str, ...]:
        """What of it is across the shaft, and left out along it, in words."""
        parts = ["unbalance"] if self.unbalances else []
        parts += ["speed"] if self.speed is not None else []
        return (*parts, *(["seal pressure"] if self.pressures else []))

    def at_bearings(self, bearings: Sequence[str], machine: Machine | None = None) -> Scenario:
        """The same with these bearings, and with the machine's numbers. Raises InvalidInput where
        no machine has them.
        """
        if machine is None and (share := next(relative_values(self), None)) is not None:
            raise InvalidInput(
                f"scenario {self.name} asks for {share!r}; give the machine: scenario.on(machine)"
            )
        numbers = self if machine is None else with_quantities(self, machine)
        named = {
            name: at_bearings(getattr(numbers, name), bearings) for name, _ in _TABLES.values()
        }
        return replace(numbers, **named)

    def speed_at(self, time: float) -> float:
        """Rotor speed [rad/s] at a time [s]; raises InvalidInput where the scenario has none."""
        if self.speed is None:
            raise InvalidInput(f"scenario {self.name} has no speed; it runs at that of the loop")
        return float(np.interp(time, *self.speed_knots))


_ACROSS = ("unbalances", "pressures", "pressure_sensors", "speed_changes")  # the shaft
_TABLES: dict[str, tuple[str, type[Any]]] = {
    "pulse": ("pulses", Pulse),
    "sine": ("sines", Sine),
    "stepped_sine": ("stepped_sines", SteppedSine),
    "chirp": ("chirps", Chirp),
    "prbs": ("sequences", Prbs),
    "unbalance": ("unbalances", Unbalance),
    "pressure": ("pressures", PressureChange),
    "failure": ("failures", Failure),
    "speed_change": ("speed_changes", SpeedChange),
    "pressure_sensor": ("pressure_sensors", PressureSensor),
}
_KINDS = {
    **dict.fromkeys(
        (
            "duration",
            "start",
            "every",
            "ramp",
            "sample_time",
            "dwell",
            "bit_time",
            "time",
            "until",
            "switch_at",
        ),
        "time",
    ),
    **dict.fromkeys(
        ("speed", "to_speed", "frequency", "to_frequency", "frequencies", "grade_speed"),
        "angular rate",
    ),
    "phase": "angle",
    "grade": "velocity",
    "share": "ratio",
    "gain": "ratio",
    "lag": "time",
    **dict.fromkeys(("pressure", "offset", "noise"), "pressure"),
}
_TEXTS = {"name", "description", "signal", "port", "initial", "spacing", "axis", "fault"}
_COUNTS = {"order", "seed"}
_AMOUNT = {"kg m": 1.0, "g mm": 1e-6, "g m": 1e-3, "kg mm": 1e-3}


def bundled_scenarios() -> dict[str, str]:
    """Names of the bundled scenarios, each with its description."""
    return {name: load_scenario(name).description for name in _bundled_names()}


def scenario_text(name: str) -> str:
    """The file of a bundled scenario. Raises InvalidInput for another name."""
    if name not in _bundled_names():
        raise InvalidInput(f"{name} is no bundled scenario; {suggestion(name, _bundled_names())}")
    return (
        files("ambrose")
        .joinpath("rig", "scenarios", f"{name}.toml")
        .read_text(encoding="utf-8")
        .rstrip()
    )


def load_scenario(name: str | Path) -> Scenario:
    """The bundled scenario of that name, or the one in a TOML file.

    Quantities are SI numbers or strings with a unit ("10 ms", "0.05 A"). Raises InvalidInput naming
    file, table and key.
    """
    bundled = files("ambrose").joinpath("rig", "scenarios", f"{name}.toml")
    try:
        document = read_toml(str(bundled) if str(name) in _bundled_names() else name, "scenario")
    except InvalidInput as error:
        if not isinstance(error.__cause__, FileNotFoundError):
            raise
        known = suggestion(str(name), _bundled_names())
        raise InvalidInput(f"{name} is neither a file nor a bundled scenario; {known}") from None
    try:
        return read_scenario(document)
    except InvalidInput as error:
        raise InvalidInput(f"scenario {name}: {error}") from error


def read_scenario(document: Mapping[str, Any]) -> Scenario:
    """A Scenario from a parsed TOML document. Raises InvalidInput naming table and key."""
    parts: dict[str, Any] = {}
    plain = {key: value for key, value in document.items() if key not in _TABLES}
    for key, (attribute, kind) in _TABLES.items():
        tables = document.get(key, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise InvalidInput(f"{key} is not a list of tables; write [[{key}]]")
        parts[attribute] = tuple(
            _build(kind, table, f"[[{key}]] number {i + 1}: ") for i, table in enumerate(tables)
        )
    return _build(Scenario, plain, "", parts)


def _bundled_names() -> list[str]:
    folder = files("ambrose").joinpath("rig", "scenarios")
    return sorted(
        entry.name.removesuffix(".toml")
        for entry in folder.iterdir()
        if entry.name.endswith(".toml")
    )


def _build(
    kind: type[Any], table: Mapping[str, Any], where: str, parts: Mapping[str, Any] | None = None
) -> Any:
    """An instance of a dataclass from one TOML table."""
    known = [item.name for item in fields(kind) if item.name not in (parts or {})]
    for key in table:
        if key not in known:
            tables = [*_TABLES] if kind is Scenario else []
            raise InvalidInput(f"{where}unknown key {key!r}; {suggestion(key, [*known, *tables])}")
    required = [
        item.name
        for item in fields(kind)
        if item.name in known and item.default is item.default_factory
    ]
    missing = [key for key in required if key not in table]
    if missing:
        raise InvalidInput(f"{where}{' and '.join(missing)} is missing; add it")
    try:
        return kind(
            **{key: _value(key, value, table) for key, value in table.items()}, **(parts or {})
        )
    except (ValueError, OverflowError) as error:
        raise InvalidInput(f"{where}{error}") from error


def _value(key: str, value: Any, table: Mapping[str, Any]) -> Any:
    if key in _TEXTS:
        if not isinstance(value, str):
            raise InvalidInput(f"{key} is {value!r}, but must be a text; write it in quotes")
        return value
    if key == "amount":
        return _amount(value)
    if key in _COUNTS:
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            raise invalid(key, repr(value), "a whole number, not negative", "correct it")
        return value
    signal = str(table.get("signal", ""))
    dimension = signal_dimension(signal) if key == "amplitude" else DIMENSIONS[_KINDS[key]]
    try:
        if key == "frequencies":
            if not isinstance(value, list):
                raise invalid(
                    key, repr(value), "a list of frequencies", "write it in square brackets"
                )
            return tuple(read_quantity(item, dimension) for item in value)
        share = read_share(value, dimension)
        return read_quantity(value, dimension) if share is None else share
    except InvalidInput:
        raise
    except ValueError as error:
        raise InvalidInput(f"{key} {error}") from error


def _amount(value: Any) -> float:
    """An unbalance [kg m]."""
    number, _, unit = (
        value.strip().partition(" ") if isinstance(value, str) else (value, "", "kg m")
    )
    try:
        factor, amount = _AMOUNT[unit.strip().replace("*", " ")], float(number)
    except (KeyError, TypeError, ValueError) as error:
        raise invalid(
            "amount",
            repr(value),
            f"a number or a text with one of {', '.join(_AMOUNT)}",
            "correct it",
        ) from error
    if isinstance(value, bool) or not math.isfinite(amount):
        raise invalid("amount", repr(value), "finite", "correct it")
    return factor * amount
