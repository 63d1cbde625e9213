"""The numbers of a [controller] that one turns: gains, times, frequencies, damping, angles, each
with its place, also those of notches and of channels with a chain of their own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

from ambrose.machine.controller import PidSettings

# keys of numbers that are turned, and their kinds
KINDS = {
    **dict.fromkeys(("gain",), "gain"),
    **dict.fromkeys(("integral_time", "derivative_time"), "time"),
    **dict.fromkeys(("frequency", "zero_frequency", "pole_frequency"), "frequency"),
    **dict.fromkeys(("low_pass", "lead"), "frequency"),
    **dict.fromkeys(("damping", "zero_damping", "pole_damping", "low_pass_damping"), "share"),
    **dict.fromkeys(("derivative_filter",), "share"),
    "tilt_gain": "factor",
    "phase": "angle",
}
# the unit in which a hand turns a kind of number, and how many of it are one in SI
UNITS = {
    "gain": ("A/m", 1.0),
    "factor": ("×", 1.0),
    "time": ("s", 1.0),
    "share": ("%", 100.0),
    "frequency": ("Hz", 0.5 / math.pi),
    "angle": ("°", 180 / math.pi),
}
Place = tuple[str | int, ...]
_SAME = 1e-9  # a number that was turned and turned back is its old one to rounding


@dataclass(frozen=True, slots=True)
class Number:
    """A number and where it stands: ("notches", 0, "frequency"); words: for people; kind: one of
    KINDS; value in SI.
    """

    place: Place
    words: str
    kind: str
    value: float

    @property
    def name(self) -> str:
        """Its place as one word, "notches.0.frequency"."""
        return ".".join(map(str, self.place))


def numbers_of(settings: PidSettings) -> list[Number]:
    """All that do something beside the other settings; no blocks at the speed."""
    idle = {"synchronous"}
    if settings.low_pass is None:
        idle.add("low_pass_damping")
    if settings.coordinates == "axes":
        idle.add("tilt_gain")
    if settings.derivative_time is None:
        idle.add("derivative_filter")
    return [number for number in _numbers(settings, (), "") if number.place[0] not in idle]


def _numbers(part: Any, place: Place, words: str) -> Iterator[Number]:
    for item in fields(part):
        value = getattr(part, item.name)
        key = str(item.metadata.get("key", item.name))
        kind = KINDS.get(key, "")
        here = (*place, item.name)
        said = f"{words} {key.replace('_', ' ')}".strip()
        if isinstance(value, tuple) and value and is_dataclass(value[0]):
            for i, entry in enumerate(value):
                called = getattr(entry, "names", None) or (getattr(entry, "kind", ""), str(i + 1))
                heading = " ".join(part for part in (said, *called) if part)
                yield from _numbers(entry, (*here, i), heading)
        elif kind and isinstance(value, tuple):
            for i, entry in enumerate(value):
                many = f" {i + 1}" if len(value) > 1 else ""
                yield Number((*here, i), said + many, kind, float(entry))
        elif kind and isinstance(value, float):
            yield Number(here, said, kind, value)


def with_number(part: Any, place: Place, value: float) -> Any:
    """Settings (or a part of them) with another number at a place."""
    if not place:
        return value
    head, rest = place[0], place[1:]
    if isinstance(part, tuple):
        i = int(head)
        return (*part[:i], with_number(part[i], rest, value), *part[i + 1 :])
    return replace(part, **{str(head): with_number(getattr(part, str(head)), rest, value)})


def expression(part: Any, place: Place, value: float, words: str) -> str:
    """Python that gives ``with_number`` of what ``words`` calls, with dataclasses.replace."""
    if not place:
        return repr(value)
    head, rest = place[0], place[1:]
    if isinstance(part, tuple):
        i = int(head)
        new = expression(part[i], rest, value, f"{words}[{i}]")
        before, after = f"*{words}[:{i}], " if i else "", f"*{words}[{i + 1}:]"
        return f"({before}{new}, {after})" if i + 1 < len(part) else f"({before}{new},)"
    inner = expression(getattr(part, str(head)), rest, value, f"{words}.{head}")
    return f"replace({words}, {head}={inner})"


def _moved(settings: PidSettings, values: Mapping[str, float]) -> Iterator[tuple[Number, float]]:
    """What stands elsewhere than in the settings."""
    for item in numbers_of(settings):
        new = values.get(item.name, item.value)
        if not math.isclose(new, item.value, rel_tol=_SAME):
            yield item, new


def with_numbers(settings: PidSettings, values: Mapping[str, float]) -> PidSettings:
    """The settings with other numbers by their names."""
    for item, new in _moved(settings, values):
        settings = with_number(settings, item.place, new)
    return settings


def lines_of(settings: PidSettings, values: Mapping[str, float]) -> list[str]:
    """Lines of Python that make of ``settings`` those with other numbers."""
    lines = []
    for item, new in _moved(settings, values):
        lines.append(f"settings = {expression(settings, item.place, new, 'settings')}")
        settings = with_number(settings, item.place, new)
    return lines
