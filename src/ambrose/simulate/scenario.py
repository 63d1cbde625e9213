"""Scenario: what is done to a closed loop during a simulation; its TOML files, and the bundled ones.

Disturbances act on the loop's input signals by name: current excitation e_<axis> [A], output disturbance d_<axis> [m],
reference r_<axis> [m], force f_<port>_<direction> [N]. Unbalance acts at a port, in both of its directions.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib.resources import files
from pathlib import Path
from typing import Any

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.machine.record import signal_dimension
from ambrose.machine.units import DIMENSIONS, read_quantity
from ambrose.machine.wording import suggestion


@dataclass(frozen=True, slots=True)
class Pulse:
    """A rectangular disturbance: ``amplitude`` (SI unit of ``signal``) from ``start`` [s] for ``duration`` [s].

    Without a duration it is a step that lasts to the end. ``every`` [s] repeats it.
    """

    signal: str
    amplitude: float
    start: float = 0.0
    duration: float | None = None
    every: float | None = None


@dataclass(frozen=True, slots=True)
class Sine:
    """amplitude sin(frequency (t - start) + phase) from ``start`` [s] for ``duration`` [s] (None: to the end); [rad/s]."""

    signal: str
    amplitude: float
    frequency: float
    phase: float = 0.0
    start: float = 0.0
    duration: float | None = None


@dataclass(frozen=True, slots=True)
class Unbalance:
    """A mass off centre at ``port`` ("A", "center", ...), turning with the rotor; ``phase`` [rad] from the first direction.

    Either ``amount`` [kg m], or ``grade`` [m/s] at ``grade_speed`` [rad/s] (ISO 21940-11, G2.5: 2.5e-3 m/s), of which this
    port carries the fraction ``share``: amount = share grade mass / grade_speed with the rotor's mass.
    """

    port: str
    amount: float | None = None
    grade: float | None = None
    grade_speed: float | None = None
    share: float = 1.0
    phase: float = 0.0

    def __post_init__(self) -> None:
        graded = self.grade is not None and self.grade_speed is not None
        if graded == (self.amount is not None) or (self.grade is None) != (self.grade_speed is None):
            raise InvalidInput(
                f"the unbalance at {self.port} needs either amount, or grade and grade_speed; give one of the two"
            )

    def mass_times_radius(self, mass: float | None) -> float:
        """The amount [kg m]; ``mass`` of the rotor [kg] is needed for a grade. Raises InvalidInput."""
        if self.amount is not None:
            return self.amount
        if self.grade is None or self.grade_speed is None or mass is None:
            raise InvalidInput(f"the unbalance at {self.port} is a grade, which needs the rotor's mass; pass mass=... in kg")
        return self.share * self.grade * check_positive(mass, "mass", "give it in kg") / self.grade_speed


@dataclass(frozen=True, slots=True)
class Scenario:
    """All disturbances of one simulation, which starts at rest and lasts ``duration`` [s].

    speed [rad/s] (None: that of the loop) goes linearly to ``to_speed`` over ``ramp`` [s] (None: the whole duration) and
    stays there. sample_time [s]: None leaves it to the simulation. Raises InvalidInput.
    """

    name: str
    duration: float
    pulses: tuple[Pulse, ...] = ()
    sines: tuple[Sine, ...] = ()
    unbalances: tuple[Unbalance, ...] = ()
    speed: float | None = None
    to_speed: float | None = None
    ramp: float | None = None
    sample_time: float | None = None
    description: str = ""

    def __post_init__(self) -> None:
        check_positive(self.duration, "the scenario's duration", "give it in seconds")
        if self.sample_time is not None:
            check_positive(self.sample_time, "sample_time", "give it in seconds")
        windows: list[Pulse | Sine] = [*self.pulses, *self.sines]
        for item in windows:
            self._check_window(item)
        for pulse in self.pulses:
            if pulse.every is not None and (pulse.duration is None or not pulse.duration <= pulse.every):
                raise invalid(f"every of the pulse on {pulse.signal}", pulse.every, "at least its duration", "lengthen it")
        for sine in self.sines:
            check_positive(sine.frequency, f"the frequency of the sine on {sine.signal}", "give it in rad/s")
        if self.to_speed is not None and self.speed is None:
            raise InvalidInput("to_speed is given without speed; give the speed at the start")
        if self.ramp is not None and (self.to_speed is None or not 0 < self.ramp <= self.duration):
            raise invalid("ramp", self.ramp, "positive, within the duration, and with a to_speed", "correct the run-up")
        if self.unbalances and self.speed is None:
            raise InvalidInput("an unbalance is given without speed; give the speed at which the rotor turns")

    def _check_window(self, item: Pulse | Sine) -> None:
        if not math.isfinite(item.amplitude):
            raise invalid(f"the amplitude on {item.signal}", item.amplitude, "finite", "correct it")
        if not 0 <= item.start < self.duration:
            raise invalid(f"the start on {item.signal}", item.start, f"within 0 to {self.duration:g} s", "move it")
        if item.duration is not None:
            check_positive(item.duration, f"the duration on {item.signal}", "give it in seconds")

    @property
    def runs_up(self) -> bool:
        """Whether the speed changes."""
        return self.to_speed is not None and self.to_speed != self.speed

    def speed_at(self, time: float) -> float:
        """Rotor speed [rad/s] at a time [s]; raises InvalidInput where the scenario has none."""
        if self.speed is None:
            raise InvalidInput(f"scenario {self.name} has no speed; it runs at that of the loop")
        if self.to_speed is None:
            return self.speed
        return self.speed + (self.to_speed - self.speed) * min(time / (self.ramp or self.duration), 1.0)


_TABLES: dict[str, tuple[str, type[Any]]] = {
    "pulse": ("pulses", Pulse),
    "sine": ("sines", Sine),
    "unbalance": ("unbalances", Unbalance),
}
_KINDS = {
    **dict.fromkeys(("duration", "start", "every", "ramp", "sample_time"), "time"),
    **dict.fromkeys(("speed", "to_speed", "frequency", "grade_speed"), "angular rate"),
    "phase": "angle", "grade": "velocity", "share": "ratio",
}  # fmt: skip
_TEXTS = {"name", "description", "signal", "port"}
_AMOUNT = {"kg m": 1.0, "g mm": 1e-6, "g m": 1e-3, "kg mm": 1e-3}


def bundled_scenarios() -> dict[str, str]:
    """Names of the bundled scenarios, each with its description."""
    return {name: load_scenario(name).description for name in _bundled_names()}


def load_scenario(name: str | Path) -> Scenario:
    """The bundled scenario of that name, or the one in a TOML file.

    Quantities are SI numbers or strings with a unit ("10 ms", "0.05 A"). Raises InvalidInput naming file, table and key.
    """
    path = files("ambrose").joinpath("simulate", "scenarios", f"{name}.toml") if str(name) in _bundled_names() else Path(name)
    if not path.is_file():
        raise InvalidInput(f"{name} is neither a file nor a bundled scenario; {suggestion(str(name), _bundled_names())}")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
        return read_scenario(document)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError, InvalidInput) as error:
        raise InvalidInput(f"scenario {name}: {error}") from error


def read_scenario(document: Mapping[str, Any]) -> Scenario:
    """A Scenario from a parsed TOML document. Raises InvalidInput naming table and key."""
    parts: dict[str, Any] = {}
    plain = {key: value for key, value in document.items() if key not in _TABLES}
    for key, (attribute, kind) in _TABLES.items():
        tables = document.get(key, [])
        if not isinstance(tables, list) or not all(isinstance(table, dict) for table in tables):
            raise InvalidInput(f"{key} is not a list of tables; write [[{key}]]")
        parts[attribute] = tuple(_build(kind, table, f"[[{key}]] number {i + 1}: ") for i, table in enumerate(tables))
    return _build(Scenario, plain, "", parts)


def _bundled_names() -> list[str]:
    folder = files("ambrose").joinpath("simulate", "scenarios")
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def _build(kind: type[Any], table: Mapping[str, Any], where: str, parts: Mapping[str, Any] | None = None) -> Any:
    """An instance of a dataclass from one TOML table."""
    known = [item.name for item in fields(kind) if item.name not in (parts or {})]
    for key in table:
        if key not in known:
            raise InvalidInput(f"{where}unknown key {key!r}; {suggestion(key, known)}")
    required = [item.name for item in fields(kind) if item.name in known and item.default is item.default_factory]
    missing = [key for key in required if key not in table]
    if missing:
        raise InvalidInput(f"{where}{' and '.join(missing)} is missing; add it")
    try:
        return kind(**{key: _value(key, value, table) for key, value in table.items()}, **(parts or {}))
    except (ValueError, OverflowError) as error:
        raise InvalidInput(f"{where}{error}") from error


def _value(key: str, value: Any, table: Mapping[str, Any]) -> Any:
    if key in _TEXTS:
        if not isinstance(value, str):
            raise InvalidInput(f"{key} is {value!r}, but must be a text; write it in quotes")
        return value
    if key == "amount":
        return _amount(value)
    signal = str(table.get("signal", ""))
    dimension = signal_dimension(signal) if key == "amplitude" else DIMENSIONS[_KINDS[key]]
    try:
        return read_quantity(value, dimension)
    except ValueError as error:
        raise InvalidInput(f"{key} {error}") from error


def _amount(value: Any) -> float:
    """An unbalance [kg m]."""
    number, _, unit = value.strip().partition(" ") if isinstance(value, str) else (value, "", "kg m")
    try:
        factor, amount = _AMOUNT[unit.strip().replace("*", " ")], float(number)
    except (KeyError, TypeError, ValueError) as error:
        raise invalid("amount", repr(value), f"a number or a text with one of {', '.join(_AMOUNT)}", "correct it") from error
    if isinstance(value, bool) or not math.isfinite(amount):
        raise invalid("amount", repr(value), "finite", "correct it")
    return factor * amount
