"""What a controller can be scheduled over: a quantity of the operating point, by the name that the schedule states."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from ambrose.core.checks import invalid
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import is_system
from ambrose.machine.description import OperatingPoint


@dataclass(frozen=True, slots=True)
class Scheduling:
    """name and SI unit in a schedule, field of an OperatingPoint, unit in which people are told of it and its size."""

    name: str
    unit: str
    field: str
    people: str
    size: float

    def of(self, point: OperatingPoint) -> float:
        """Its value [unit] at an operating point."""
        return float(getattr(point, self.field))

    def moved(self, point: OperatingPoint, value: float) -> OperatingPoint:
        """The operating point with another value [unit] of it."""
        return replace(point, speed=value) if self.field == "speed" else replace(point, seal_pressure=value)

    def words(self, value: float) -> str:
        """A value [unit] for people: "140 Hz", "2.04 bar"."""
        return f"{value / self.size:.6g} {self.people}"

    @property
    def rate_unit(self) -> str:
        return f"{self.unit}^2" if self.unit.endswith("/s") else f"{self.unit}/s"


SPEED = Scheduling("speed", "rad/s", "speed", "Hz", 2 * math.pi)
PRESSURE = Scheduling("pressure", "Pa", "seal_pressure", "bar", 1e5)
SCHEDULINGS = {item.name: item for item in (SPEED, PRESSURE)}


def scheduling_of(law: Any) -> Scheduling | None:
    """What a law changes with: of a schedule or a scheduled program as it says, of another function the speed; None: nothing.

    Raises InvalidInput for a schedule over anything else.
    """
    if is_system(law) or not callable(law):
        return None
    name, unit = getattr(law, "parameter", SPEED.name), getattr(law, "unit", None)
    if name not in SCHEDULINGS or unit not in (None, SCHEDULINGS[name].unit):
        known = " or ".join(f"{item.name} [{item.unit}]" for item in SCHEDULINGS.values())
        given = f"{name} [{unit}]" if isinstance(law, ScheduledSystem) else repr(name)
        raise invalid("the scheduling parameter", given, known, "make the schedule over one of them; two at once cannot be had")
    return SCHEDULINGS[name]
