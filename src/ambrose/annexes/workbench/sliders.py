"""The numbers of a [controller] as sliders, a decade to both sides of where they stand."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from ambrose.annexes.workbench.blocks import Block, field
from ambrose.annexes.workbench.given import number
from ambrose.machine.controller import PidSettings
from ambrose.machine.setting_numbers import Number, expression, numbers_of, with_number

_DECADES = 1.0
_SAME = 1e-9  # a slider that was not moved gives back its value to rounding
# unit and factor of a kind of number
_UNITS = {
    "gain": ("A/m", 1.0),
    "factor": ("×", 1.0),
    "time": ("s", 1.0),
    "share": ("%", 100.0),
    "frequency": ("Hz", 0.5 / math.pi),
    "angle": ("°", 180 / math.pi),
}


def fields_of(settings: PidSettings, axes: Sequence[str]) -> list[Block]:
    """A slider for every number."""
    found = []
    for item in numbers_of(settings):
        by_axis = item.place[0] == "gain" and len(settings.gain) == len(axes)
        label = f"gain {axes[int(item.place[1])]}" if by_axis else item.words
        unit, factor = _UNITS[item.kind]
        log = item.value > 0 and item.kind != "angle"
        low, high = -math.pi / 2, math.pi / 2
        if log:
            low, high = (math.log10(item.value) + side * _DECADES for side in (-1, 1))
        elif item.kind != "angle":
            low, high = min(2 * item.value, 0.0), max(2 * item.value, 1.0)
        more = {"low": low, "high": high, "unit": unit, "factor": factor, "log": log}
        found.append(field(item.name, label.capitalize(), item.value, "slider", **more))
    return found


def _moved(settings: PidSettings, given: Mapping[str, Any]) -> Iterator[tuple[Number, float]]:
    """What stands elsewhere than in the settings. Raises InvalidInput for what is no number."""
    for item in numbers_of(settings):
        new = number(given, item.name, item.value)
        if not math.isclose(new, item.value, rel_tol=_SAME):
            yield item, new


def settings_with(settings: PidSettings, given: Mapping[str, Any]) -> PidSettings:
    """The settings with what the sliders say. Raises InvalidInput."""
    for item, new in _moved(settings, given):
        settings = with_number(settings, item.place, new)
    return settings


def python_of(settings: PidSettings, given: Mapping[str, Any]) -> list[str]:
    """Lines of Python that make the same settings from those of the machine file."""
    lines = []
    for item, new in _moved(settings, given):
        lines.append(f"settings = {expression(settings, item.place, new, 'settings')}")
        settings = with_number(settings, item.place, new)
    return lines
