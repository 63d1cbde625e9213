"""Scenario: what is done to a closed loop during a simulation; its TOML files, and the bundled
ones.

Its parts are in scenario.py. Disturbances act on the loop's input signals by name: current
excitation e_<axis> [A], output disturbance d_<axis> [m], reference r_<axis> [m], force
f_<port>_<direction> [N]; unbalance acts at a port, in both directions.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.core.checks import (
    InvalidInput,
    check_finite,
    check_positive,
    invalid,
    names_wrong_types,
)
from ambrose.core.presentation import Presented
from ambrose.machine.description import BEARING_TERMS
from ambrose.machine.file.toml import read_toml
from ambrose.machine.machine import AXIS, Machine
from ambrose.machine.units import DIMENSIONS, Dimension, read_quantity, suggestion
from ambrose.model.plant import top_speed
from ambrose.record.record import signal_dimension

# What a scenario is made of: one small class per table of its file, all quantities in SI and rad/s.
#
# A ``signal`` is an input of the loop: current excitation e_<axis> [A], output disturbance d_<axis>
# [m], reference r_<axis> [m], force f_<port>_<direction> [N].


SPACINGS = ("linear", "logarithmic")
SENSOR_FAULTS = ("", "stuck", "lost")
_ORDERS = (2, 20)  # bits of a shift register


@dataclass(frozen=True, slots=True)
class Pulse:
    """A rectangular disturbance: ``amplitude`` (SI unit of ``signal``) from ``start`` [s] for
    ``duration`` [s].

    Without a duration it is a step that lasts to the end. ``every`` [s] repeats it.
    """

    signal: str
    amplitude: float
    start: float = 0.0
    duration: float | None = None
    every: float | None = None


@dataclass(frozen=True, slots=True)
class Sine:
    """amplitude sin(frequency (t - start) + phase) from ``start`` [s] for ``duration`` [s] (None:
    to the end); [rad/s].
    """

    signal: str
    amplitude: float
    frequency: float
    phase: float = 0.0
    start: float = 0.0
    duration: float | None = None


@dataclass(frozen=True, slots=True)
class SteppedSine:
    """A sine of one frequency [rad/s] after the other, each for ``dwell`` [s] and beginning at
    angle zero.
    """

    signal: str
    amplitude: float
    frequencies: tuple[float, ...]
    dwell: float
    start: float = 0.0

    def __post_init__(self) -> None:
        check_positive(self.dwell, f"the dwell on {self.signal}", "give it in seconds")
        if not self.frequencies:
            raise InvalidInput(
                f"the stepped sine on {self.signal} has no frequencies; list at least one"
            )

    @property
    def sines(self) -> tuple[Sine, ...]:
        """The same as single sines."""
        return tuple(
            Sine(
                self.signal, self.amplitude, frequency, 0.0, self.start + i * self.dwell, self.dwell
            )
            for i, frequency in enumerate(self.frequencies)
        )


@dataclass(frozen=True, slots=True)
class Chirp:
    """A sine whose frequency goes from ``frequency`` to ``to_frequency`` [rad/s] within
    ``duration`` [s] (None: to the end).

    spacing "linear" passes equal frequency ranges in equal times, "logarithmic" equal ratios.
    """

    signal: str
    amplitude: float
    frequency: float
    to_frequency: float
    start: float = 0.0
    duration: float | None = None
    spacing: str = "linear"

    def __post_init__(self) -> None:
        for frequency in (self.frequency, self.to_frequency):
            check_positive(
                frequency, f"a frequency of the chirp on {self.signal}", "give it in rad/s"
            )
        if self.spacing not in SPACINGS:
            raise invalid(
                f"the spacing of the chirp on {self.signal}",
                repr(self.spacing),
                " or ".join(SPACINGS),
                "correct it",
            )


@dataclass(frozen=True, slots=True)
class Prbs:
    """A pseudo-random binary sequence of +-amplitude: a maximum-length sequence of 2^order - 1
    bits, each ``bit_time`` [s].

    It repeats to the end of ``duration`` [s] (None: of the scenario). Sequences with different
    ``seed`` are the same shifted far apart, and so nearly uncorrelated.
    """

    signal: str
    amplitude: float
    bit_time: float
    order: int = 10
    seed: int = 0
    start: float = 0.0
    duration: float | None = None

    def __post_init__(self) -> None:
        check_positive(self.bit_time, f"the bit_time on {self.signal}", "give it in seconds")
        if not _ORDERS[0] <= self.order <= _ORDERS[1]:
            requirement = f"from {_ORDERS[0]} to {_ORDERS[1]}"
            raise invalid(
                f"the order of the sequence on {self.signal}",
                self.order,
                requirement,
                "10 repeats after 1023 bits",
            )

    @property
    def shift(self) -> int:
        """Bits by which the sequence is shifted: multiples of the golden section of its length."""
        length = 2**self.order - 1
        return round(self.seed * 0.6180339887498949 * length) % length

    def among(self, number: int, count: int) -> Prbs:
        """The one at a bearing, of so many."""
        return replace(self, seed=self.seed + _SEEDS * number)


@dataclass(frozen=True, slots=True)
class Unbalance:
    """A mass off centre at ``port`` ("A", "center", ...), turning with the rotor; ``phase`` [rad]
    from the first direction.

    Either ``amount`` [kg m], or ``grade`` [m/s] at ``grade_speed`` [rad/s] (ISO 21940-11, G2.5:
    2.5e-3 m/s), of which this port carries the fraction ``share``: amount = share grade mass /
    grade_speed with the rotor's mass.
    """

    port: str
    amount: float | None = None
    grade: float | None = None
    grade_speed: float | None = None
    share: float = 1.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        graded = self.grade is not None and self.grade_speed is not None
        if graded == (self.amount is not None) or (self.grade is None) != (
            self.grade_speed is None
        ):
            raise InvalidInput(
                f"the unbalance at {self.port} needs either amount, or grade and grade_speed; "
                "give one of the two"
            )

    def among(self, number: int, count: int) -> Unbalance:
        """The part at a bearing, of so many."""
        if self.amount is not None:
            return replace(self, amount=self.amount / count)
        return replace(self, share=self.share / count)

    def mass_times_radius(self, mass: float | None) -> float:
        """The amount [kg m]; ``mass`` of the rotor [kg] is needed for a grade. Raises
        InvalidInput.
        """
        if self.amount is not None:
            return self.amount
        if self.grade is None or self.grade_speed is None or mass is None:
            raise InvalidInput(
                f"the unbalance at {self.port} is a grade, which needs the rotor's mass; pass "
                "mass=... in kg"
            )
        return (
            self.share
            * self.grade
            * check_positive(mass, "mass", "give it in kg")
            / self.grade_speed
        )


@dataclass(frozen=True, slots=True)
class PressureChange:
    """The differential pressure of every seal goes to ``pressure`` [Pa] at ``time`` [s], linearly
    within ``ramp`` [s].
    """

    time: float
    pressure: float
    ramp: float = 0.0

    def __post_init__(self) -> None:
        for name in ("time", "pressure", "ramp"):
            check_positive(
                getattr(self, name),
                f"{name} of the change of pressure",
                "correct it",
                zero_allowed=True,
            )


@dataclass(frozen=True, slots=True)
class PressureSensor:
    """From ``time`` [s] on the sensor of the seal pressure tells gain p + offset [Pa] through a
    first-order lag [s], with white noise of so many Pa (rms) at every sample; "stuck" it keeps what
    it told last, "lost" it tells nothing.
    """

    time: float = 0.0
    gain: float = 1.0
    offset: float = 0.0
    lag: float = 0.0
    noise: float = 0.0
    fault: str = ""

    def __post_init__(self) -> None:
        for name in ("time", "lag", "noise"):
            check_positive(
                getattr(self, name),
                f"{name} of the pressure sensor",
                "correct it",
                zero_allowed=True,
            )
        for name in ("gain", "offset"):
            check_finite(getattr(self, name), f"{name} of the pressure sensor")
        if self.fault not in SENSOR_FAULTS:
            raise invalid(
                "fault of the pressure sensor",
                repr(self.fault),
                '"stuck", "lost" or left out',
                "correct it",
            )


_EXACT = PressureSensor()


def sensed(
    time: np.ndarray,
    sensors: Sequence[PressureSensor],
    knots: Sequence[float],
    values: Sequence[float],
) -> np.ndarray:
    """What the sensors, one from its time on and each to the next one's, tell (n,) [Pa] at times
    (n,) [s] without their noise.

    knots, values: times [s] and pressures [Pa], linear between. Stuck or lost: the last one. Exact:
    g + s t - s T + (l - g + s T) exp(-t/T) within a segment from g with slope s, for a lag T that
    tells l at its start.
    """
    edges = np.unique([0.0, *knots, *(item.time for item in sensors)])
    at = np.searchsorted(edges, time, side="right") - 1
    result, last = np.empty(len(time)), float(np.interp(0.0, knots, values))
    for i, start in enumerate(edges.tolist()):
        item = next((sensor for sensor in reversed(sensors) if sensor.time <= start), _EXACT)
        # constant after the last knot
        end = float(edges[i + 1]) if i + 1 < len(edges) else start + 1.0
        # gain p + offset at both ends: g and s
        begin, then = (
            item.gain * float(np.interp(t, knots, values)) + item.offset for t in (start, end)
        )
        # a fault holds what was told last; without a lag the sensor tells g at once
        slope = 0.0 if item.fault else (then - begin) / (end - start)
        begin, behind = last if item.fault else begin, slope * item.lag
        last = begin if item.lag == 0 else last
        # g + s t - s T + (l - g + s T) e^(-t/T); the last entry is the next segment's l
        since = np.append(time[at == i], end) - start
        left = np.exp(-since / item.lag) if item.lag > 0 else np.zeros(len(since))
        reading = begin + slope * since - behind + (last - begin + behind) * left
        result[at == i], last = reading[:-1], float(reading[-1])
    return result


@dataclass(frozen=True, slots=True)
class SpeedChange:
    """The rotor's speed goes to ``speed`` [rad/s] from ``time`` [s] on, linearly within ``ramp``
    [s].
    """

    time: float
    speed: float
    ramp: float

    def __post_init__(self) -> None:
        check_positive(self.time, "time of the change of speed", "correct it", zero_allowed=True)
        check_positive(
            self.ramp,
            "ramp of the change of speed",
            "give it in seconds; no rotor changes its speed at once",
        )
        check_positive(
            self.speed, "the speed of a change of speed", "a rotor turns one way", zero_allowed=True
        )


@dataclass(frozen=True, slots=True)
class Failure:
    """From ``time`` [s] on the amplifier of ``axis`` ("A_zeta") has no power; without an axis, none
    has. ``until`` [s] it returns (without one it does not); the controller has run on.
    """

    time: float
    axis: str | None = None
    until: float | None = None

    def __post_init__(self) -> None:
        check_positive(
            self.time, "the time of the failure", "give it in seconds", zero_allowed=True
        )
        if self.until is not None and not self.time < self.until < math.inf:
            raise invalid(
                "until of a failure",
                self.until,
                f"after its time, {self.time:g} s",
                "correct it, or leave it out if the power stays away",
            )


Disturbance = Pulse | Sine | Chirp | Prbs


def check_disturbance(item: Disturbance, end: float) -> None:
    """Refuse what cannot act in a scenario that lasts until ``end`` [s]. Raises InvalidInput."""
    if not math.isfinite(item.amplitude):
        raise invalid(f"the amplitude on {item.signal}", item.amplitude, "finite", "correct it")
    if not 0 <= item.start < end:
        raise invalid(
            f"the start on {item.signal}", item.start, f"within 0 to {end:g} s", "move it"
        )
    if item.duration is not None:
        check_positive(item.duration, f"the duration on {item.signal}", "give it in seconds")


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
    and quantities be shares of the machine's (scenario.py), until a simulation calls
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
        for pulse in self.pulses:
            every, duration = pulse.every, pulse.duration
            if every is not None and (duration is None or not duration <= every):
                what = f"every of the pulse on {pulse.signal}"
                raise invalid(what, every, "at least its duration", "lengthen it")
        for sine in self.all_sines:
            what = f"the frequency of the sine on {sine.signal}"
            check_positive(sine.frequency, what, "give it in rad/s")
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
        if self.names_thrust and machine.lateral:
            remedy = "give its axial controller, too (--axial), or take --axes thrust"
            if len(machine.groups) < 2:
                remedy = f"{machine.name} has no [[thrust_bearing]]; take another scenario"
            raise InvalidInput(f"scenario {self.name} acts along the shaft; {remedy}")
        names = dict.fromkeys(bearing.name for bearing in machine.axis_bearings)
        found = self.at_bearings(list(names), machine)
        if machine.lateral:
            return found
        (axis,) = machine.axes
        chosen = on_thrust if self.names_thrust else along_shaft
        along = {name: chosen(getattr(found, name), axis) for name, _ in _TABLES.values()}
        left = replace(found, **{**along, **_STILL})
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
        across: dict[str, Any] = {}
        along: dict[str, Any] = {}
        for name, _ in _TABLES.values():
            items = getattr(self, name)
            across[name] = tuple(item for item in items if not names_thrust(item))
            along[name] = tuple(item for item in items if names_thrust(item))
        along["failures"] += tuple(item for item in self.failures if item.axis is None)
        axial = replace(self, **{**along, **_STILL}).on(machine.axial)
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
# what a scenario has of them for the axis along it
_STILL: dict[str, Any] = dict.fromkeys(_ACROSS, ()) | dict.fromkeys(("speed", "to_speed", "ramp"))
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
        raise InvalidInput(
            f"{name} is not a bundled scenario; {suggestion(name, _bundled_names())}"
        )
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


_MOST = 1e60  # as of a machine's numbers: what is larger overflows in its powers


def _value(key: str, given: Any, table: Mapping[str, Any]) -> Any:
    """What stands under a key, in SI; a number beyond all that a calculation bears is refused."""
    value = _read(key, given, table)
    for number in value if isinstance(value, tuple) else (value,):
        if isinstance(number, float) and abs(number) > _MOST:
            wanted = f"at most {_MOST:g} in SI units"
            raise invalid(key, repr(given), wanted, "look for a wrong exponent or unit")
    return value


def _read(key: str, value: Any, table: Mapping[str, Any]) -> Any:
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


# A scenario in terms of the machine: its "first", "last" and "every" bearing, and shares of its top
# speed or pressure.
#
# A scenario file may say ``signal = "e_first_zeta"``, ``port = "every"`` or ``to_speed = "80 % of
# top speed"``; what that is, the machine says. Of "every" bearing a grade of unbalance is parted
# among them, and each has a binary sequence of its own.


_SEEDS = 2  # axes of a bearing: two sequences at one bearing have neighbouring seeds
_THRUST = f"thrust{AXIS}"  # the axis along the shaft, whatever its bearing's name
_PHRASE = re.compile(r"(.+?)\s+of\s+(?:the\s+)?([a-z]+ [a-z]+)")


class Share(float):
    """A share of a quantity of the machine, until a machine is known; ``of`` is its name."""

    of: str

    def __new__(cls, share: float, of: str) -> Share:
        value = super().__new__(cls, share)
        value.of = of
        return value

    def __repr__(self) -> str:
        return f"{100 * self:g} % of {self.of}"


def _top_pressure(machine: Machine) -> float | None:
    return max(point.seal_pressure for point in machine.operation.envelope)


def _least(name: str) -> Callable[[Machine], float | None]:
    """Of the bearings; of an axial one's pair the lesser."""
    return lambda machine: min(
        (
            min(v) if isinstance(v, tuple) else v
            for b in machine.axis_bearings
            if (v := getattr(b, name)) is not None
        ),
        default=None,
    )


def _thrusts(machine: Machine) -> list[float]:
    """The process thrust [N] at every operating point of the axis along the shaft."""
    return [item.load for item in machine.conditions] or [0.0]


_QUANTITIES: dict[str, tuple[str, Callable[[Machine], float | None], str]] = {
    "top speed": ("angular rate", top_speed, "[operation] speed_range"),
    "balance speed": (
        "angular rate",
        lambda m: m.requirements.balance_speed or top_speed(m) or None,
        "[operation] speed_range",
    ),
    "top pressure": ("pressure", _top_pressure, "an [[operation.point]] with seal_pressure"),
    "max current": ("current", _least("max_current"), "max_current of a [[bearing]]"),
    "largest thrust": (
        "force",
        lambda machine: max(_thrusts(machine), key=abs) or None,
        "a [[thrust_bearing.load]], and take file.toml#axial",
    ),
    "thrust range": (
        "force",
        lambda machine: max(_thrusts(machine)) - min(_thrusts(machine)) or None,
        "[[thrust_bearing.load]] of two points, and take file.toml#axial",
    ),
    "touchdown gap": ("length", _least("touchdown_gap"), "touchdown_gap of a [[bearing]]"),
}


def read_share(value: Any, dimension: Dimension) -> Share | None:
    """The share that a text such as "80 % of top speed" says; None for anything else. Raises
    InvalidInput, ValueError.
    """
    match = _PHRASE.fullmatch(value.strip()) if isinstance(value, str) else None
    if not match:
        return None
    names = [name for name, (kind, *_) in _QUANTITIES.items() if DIMENSIONS[kind] is dimension]
    if match[2] not in names:
        raise ValueError(
            f"is {value!r}, but may be a share of {' or '.join(names) or 'nothing'} only; correct "
            "it"
        )
    return Share(read_quantity(match[1], DIMENSIONS["ratio"]), match[2])


def relative_values(item: Any) -> Iterator[Share]:
    """All shares in a dataclass, the tuples in it and their items."""
    if isinstance(item, Share):
        yield item
    elif isinstance(item, tuple):
        for part in item:
            yield from relative_values(part)
    elif is_dataclass(item):
        for field in fields(item):
            yield from relative_values(getattr(item, field.name))


def with_quantities(item: Any, machine: Machine) -> Any:
    """The same with the machine's numbers in place of shares. Raises InvalidInput where the machine
    does not state one.
    """
    if isinstance(item, Share):
        _, value_of, key = _QUANTITIES[item.of]
        value = value_of(machine)
        if value is None:
            raise InvalidInput(
                f"the scenario needs the {item.of} of machine {machine.name!r}, which states "
                f"none; add {key}"
            )
        return float(item) * value
    if isinstance(item, tuple):
        return tuple(with_quantities(part, machine) for part in item)
    if is_dataclass(item) and not isinstance(item, type) and any(relative_values(item)):
        return replace(
            item,
            **{
                f.name: with_quantities(getattr(item, f.name), machine)
                for f in fields(item)
                if f.init
            },
        )
    return item


def at_bearings(items: Sequence[Any], bearings: Sequence[str]) -> tuple[Any, ...]:
    """Disturbances, unbalances or failures with the names of these bearings in place of "first",
    "last" and "every".
    """
    return tuple(made for item in items for made in _at(item, bearings))


def _at(item: Any, bearings: Sequence[str]) -> Iterator[Any]:
    key = next((name for name in ("signal", "port", "axis") if hasattr(item, name)), "")
    text = getattr(item, key, None) or ""
    before, word, after = _parted(text)
    if word not in BEARING_TERMS:
        yield item
        return
    chosen = {"first": bearings[:1], "last": bearings[-1:], "every": bearings}[word]
    among = getattr(item, "among", lambda number, count: item)
    for number, name in enumerate(chosen):
        yield replace(among(number, len(chosen)), **{key: f"{before}{name}{after}"})


def along_shaft(items: Sequence[Any], axis: str) -> tuple[Any, ...]:
    """The same on the one axis along the shaft: what is along a bearing's first direction acts
    on it, what is along its second one on nothing.
    """
    name, found = axis.removesuffix(AXIS), []
    for item in items:
        key = next((key for key in ("signal", "axis") if getattr(item, key, None)), "")
        text = getattr(item, key, "") if key else ""
        if text.endswith(f"{name}_zeta"):
            found.append(replace(item, **{key: f"{text.removesuffix('_zeta')}{AXIS}"}))
        elif not text.endswith(f"{name}_eta"):
            found.append(item)
    return tuple(found)


def names_thrust(item: Any) -> bool:
    """Whether a disturbance or failure is along the shaft by its name: e_thrust_z, f_T_z, T_z."""
    text = getattr(item, "signal", None) or getattr(item, "axis", None) or ""
    return bool(text.endswith(AXIS))


def on_thrust(items: Sequence[Any], axis: str) -> tuple[Any, ...]:
    """What is along the shaft by its name, with the axis in place of "thrust_z", and what is of all
    axes (a failure of no axis by itself).
    """
    chosen = []
    for item in items:
        if getattr(item, "axis", "") is None:
            chosen.append(item)
        elif names_thrust(item):
            key = "signal" if getattr(item, "signal", None) else "axis"
            text = getattr(item, key)
            ending = _THRUST if text.endswith(_THRUST) else axis
            chosen.append(replace(item, **{key: f"{text.removesuffix(ending)}{axis}"}))
    return tuple(chosen)


def _parted(text: str) -> tuple[str, str, str]:
    """ "e_first_zeta" -> "e_", "first", "_zeta"; "first_zeta" and "first" likewise."""
    match = re.fullmatch(rf"([edrf]_)?({'|'.join(BEARING_TERMS)})(_zeta|_eta)?", text)
    return (match[1] or "", match[2], match[3] or "") if match else ("", text, "")
