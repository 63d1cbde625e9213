"""The numbers of a [controller] as sliders: every gain, time, frequency and damping that the file
has there, also those of notches and of channels with a chain of their own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

from ambrose.annexes.workbench.blocks import Block, field
from ambrose.annexes.workbench.given import number
from ambrose.machine.controller import PidSettings

_DECADES = 1.0  # of a slider to both sides of where it stands
_SAME = 1e-9  # a slider that was not moved gives back its value to rounding
_TURN = 2 * math.pi
# unit and factor by the end of a name; what is not here is no slider
_UNITS: Mapping[str, tuple[str, float]] = {
    "gain": ("A/m", 1.0),
    "tilt_gain": ("×", 1.0),
    "integral_time": ("s", 1.0),
    "derivative_time": ("s", 1.0),
    "derivative_filter": ("%", 100.0),
    "frequency": ("Hz", 1 / _TURN),
    "zero_frequency": ("Hz", 1 / _TURN),
    "pole_frequency": ("Hz", 1 / _TURN),
    "low_pass": ("Hz", 1 / _TURN),
    "lead": ("Hz", 1 / _TURN),
    "low_pass_damping": ("%", 100.0),
    "damping": ("%", 100.0),
    "zero_damping": ("%", 100.0),
    "pole_damping": ("%", 100.0),
    "phase": ("°", 360 / _TURN),
}
Place = tuple[str | int, ...]


def _numbers(part: Any, place: Place, words: str) -> Iterator[tuple[Place, str, str, float]]:
    """Place, words, key and value of every number that has a slider."""
    for item in fields(part):
        value = getattr(part, item.name)
        key = str(item.metadata.get("key", item.name))
        here = (*place, item.name)
        said = f"{words} {key.replace('_', ' ')}".strip()
        if isinstance(value, tuple) and value and is_dataclass(value[0]):
            for i, entry in enumerate(value):
                called = getattr(entry, "names", None) or (getattr(entry, "kind", ""), str(i + 1))
                heading = " ".join(part for part in (said, *called) if part)
                yield from _numbers(entry, (*here, i), heading)
        elif key in _UNITS and isinstance(value, tuple):
            for i, entry in enumerate(value):
                many = f" {i + 1}" if len(value) > 1 else ""
                yield (*here, i), said + many, key, float(entry)
        elif key in _UNITS and isinstance(value, float):
            yield here, said, key, value


def fields_of(settings: PidSettings, axes: Sequence[str]) -> list[Block]:
    """A slider for every number, around where it stands."""
    found = []
    for place, words, key, value in _numbers(settings, (), ""):
        if place[0] in _idle(settings):
            continue
        by_axis = place[0] == "gain" and len(settings.gain) == len(axes)
        label = f"gain {axes[int(place[1])]}" if by_axis else words
        unit, factor = _UNITS[key]
        log = value > 0 and key != "phase"
        low, high = (
            (math.log10(value) - _DECADES, math.log10(value) + _DECADES)
            if log
            else _span(value, key)
        )
        more = {"low": low, "high": high, "unit": unit, "factor": factor, "log": log}
        name = ".".join(map(str, place))
        found.append(field(name, label.capitalize(), value, "slider", **more))
    return found


def _idle(settings: PidSettings) -> set[str]:
    """What does nothing beside the other settings, and the blocks at the speed."""
    idle = {"synchronous"}
    if settings.low_pass is None:
        idle.add("low_pass_damping")
    if settings.coordinates == "axes":
        idle.add("tilt_gain")
    if settings.derivative_time is None:
        idle.add("derivative_filter")
    return idle


def _span(value: float, key: str) -> tuple[float, float]:
    """Of a slider that is not logarithmic."""
    if key == "phase":
        return -math.pi / 2, math.pi / 2
    return min(2 * value, 0.0), max(2 * value, 1.0)


def settings_with(settings: PidSettings, given: Mapping[str, Any]) -> PidSettings:
    """The settings with what the sliders say. Raises InvalidInput for what is no number."""
    for place, _, _, value in list(_numbers(settings, (), "")):
        name = ".".join(map(str, place))
        if name in given:
            new = number(given, name)
            if not math.isclose(new, value, rel_tol=_SAME):
                settings = _put(settings, place, new)
    return settings


def _put(part: Any, place: Place, value: float) -> Any:
    """A part with another number at a place."""
    if not place:
        return value
    head, rest = place[0], place[1:]
    if isinstance(part, tuple):
        i = int(head)
        return (*part[:i], _put(part[i], rest, value), *part[i + 1 :])
    return replace(part, **{str(head): _put(getattr(part, str(head)), rest, value)})


def python_of(settings: PidSettings, given: Mapping[str, Any]) -> list[str]:
    """Lines of Python that make the same settings from those of the machine file."""
    moved = []
    for place, _, _, value in _numbers(settings, (), ""):
        new = given.get(".".join(map(str, place)))
        if isinstance(new, int | float) and not math.isclose(new, value, rel_tol=_SAME):
            moved.append((place, float(new)))
    lines = []
    for place, new in moved:
        lines.append(f"settings = {_replaced(settings, place, new, 'settings')}")
        settings = _put(settings, place, new)
    return lines


def _replaced(part: Any, place: Place, value: float, words: str) -> str:
    """An expression of Python for a part with another number at a place."""
    if not place:
        return repr(value)
    head, rest = place[0], place[1:]
    if isinstance(part, tuple):
        i = int(head)
        new = _replaced(part[i], rest, value, f"{words}[{i}]")
        before, after = f"*{words}[:{i}], " if i else "", f"*{words}[{i + 1}:]"
        return f"({before}{new}, {after})" if i + 1 < len(part) else f"({before}{new},)"
    inner = _replaced(getattr(part, str(head)), rest, value, f"{words}.{head}")
    return f"replace({words}, {head}={inner})"
