"""What a controller can be scheduled over: quantities of the operating point, by the names that the
schedule states.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from ambrose.core.checks import invalid
from ambrose.core.scheduled import AND
from ambrose.machine.description import OperatingPoint


@dataclass(frozen=True, slots=True)
class Scheduling:
    """name and SI unit in a schedule, field of an OperatingPoint, unit in which people are told of
    it and its size.

    parts: of several at once, each by itself; a value is then a tuple, in their order.
    """

    name: str
    unit: str
    field: str = ""
    people: str = ""
    size: float = math.nan
    parts: tuple[Scheduling, ...] = ()

    @property
    def each(self) -> tuple[Scheduling, ...]:
        """Its parts, or itself alone."""
        return self.parts or (self,)

    def of(self, point: OperatingPoint) -> Any:
        """Its value [unit] at an operating point."""
        return (
            tuple(part.of(point) for part in self.parts)
            if self.parts
            else float(getattr(point, self.field))
        )

    def moved(self, point: OperatingPoint, value: Any) -> OperatingPoint:
        """The operating point with another value [unit] of it."""
        if self.parts:
            speed, pressure = value
            return replace(point, speed=speed, seal_pressure=pressure)
        return (
            replace(point, speed=value)
            if self.field == "speed"
            else replace(point, seal_pressure=value)
        )

    def words(self, value: Any) -> str:
        """A value [unit] for people: "140 Hz", "2.04 bar"."""
        if self.parts:
            return ", ".join(part.words(item) for part, item in zip(self.parts, value, strict=True))
        return f"{value / self.size:.6g} {self.people}"

    def number(self, value: Any) -> str:
        """A value with its SI unit: "880 rad/s"."""
        items = value if self.parts else (value,)
        return ", ".join(
            f"{item:.6g} {part.unit}" for part, item in zip(self.each, items, strict=True)
        )

    @property
    def plural(self) -> str:
        return AND.join(f"{part.name}s" for part in self.each)

    @property
    def rate_unit(self) -> str:
        return f"{self.unit}^2" if self.unit.endswith("/s") else f"{self.unit}/s"


SPEED = Scheduling("speed", "rad/s", "speed", "Hz", 2 * math.pi)
PRESSURE = Scheduling("pressure", "Pa", "seal_pressure", "bar", 1e5)
BOTH = Scheduling(
    AND.join((SPEED.name, PRESSURE.name)),
    AND.join((SPEED.unit, PRESSURE.unit)),
    parts=(SPEED, PRESSURE),
)
SCHEDULINGS = {item.name: item for item in (SPEED, PRESSURE, BOTH)}


def scheduling_named(name: str, unit: str | None = None, words: str = "") -> Scheduling:
    """The scheduling by its name; unit: that which is stated (None: none is); words: the same for
    people. Raises InvalidInput for anything that is no quantity of the operating point.
    """
    if name not in SCHEDULINGS or unit not in (None, SCHEDULINGS[name].unit):
        known = " or ".join(f"{item.name} [{item.unit}]" for item in SCHEDULINGS.values())
        raise invalid(
            "the scheduling parameter",
            words or (name if unit is None else f"{name} [{unit}]"),
            known,
            "make the schedule over one of them",
        )
    return SCHEDULINGS[name]
