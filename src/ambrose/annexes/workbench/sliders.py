"""The numbers of a [controller] as sliders, a decade to both sides of where they stand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ambrose.annexes.workbench.blocks import Block, field
from ambrose.annexes.workbench.given import number
from ambrose.machine.controller import PidSettings
from ambrose.machine.setting_numbers import UNITS, numbers_of

_DECADES = 1.0  # a slider's reach on either side of the value


def fields_of(settings: PidSettings, axes: Sequence[str]) -> list[Block]:
    """A slider for every number."""
    found = []
    for item in numbers_of(settings):
        by_axis = item.place[0] == "gain" and len(settings.gain) == len(axes)
        label = f"gain {axes[int(item.place[1])]}" if by_axis else item.words
        unit, factor = UNITS[item.kind]
        log = item.value > 0 and item.kind != "angle"
        low, high = -math.pi / 2, math.pi / 2
        if log:
            low, high = (math.log10(item.value) + side * _DECADES for side in (-1, 1))
        elif item.kind != "angle":
            low, high = min(2 * item.value, 0.0), max(2 * item.value, 1.0)
        more = {"low": low, "high": high, "unit": unit, "factor": factor, "log": log}
        found.append(field(item.name, label.capitalize(), item.value, "slider", **more))
    return found


def values_of(settings: PidSettings, given: Mapping[str, Any]) -> dict[str, float]:
    """Where the sliders stand. Raises InvalidInput for what is no number."""
    return {item.name: number(given, item.name, item.value) for item in numbers_of(settings)}
