"""An estimate against what another identification wrote into its machine file: do two methods
agree?
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.identification.parameters import COVERAGE, Estimate, half_width, nominal_values
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING, parse_parameter
from ambrose.model.assemble import assemble


@dataclass(frozen=True, slots=True)
class Agreement:
    """A parameter found twice, SI: value with the half-width of its 95 % interval, and the other's
    (0: it states none).
    """

    path: str
    value: float
    half_width: float
    other: float
    other_half_width: float

    @property
    def difference(self) -> float:
        """Of the value from the other [%]; NaN where that is zero."""
        return 100 * (self.value / self.other - 1) if self.other else float("nan")

    @property
    def difference_half_width(self) -> float:
        """By how much the difference may be noise alone [%], 95 %."""
        if not (self.other and self.value):
            return float("nan")
        relative = np.hypot(self.half_width / self.value, self.other_half_width / self.other)
        return float(100 * abs(self.value / self.other) * relative)

    @property
    def agree(self) -> bool:
        """Whether noise alone may make the difference."""
        return bool(abs(self.difference) <= self.difference_half_width)

    def to_dict(self) -> dict[str, float | str | bool | None]:
        """JSON-ready data, SI and percent."""
        return {
            "path": self.path,
            "value": self.value,
            "other": self.other,
            "other_half_width_95": self.other_half_width,
            "difference_percent": self.difference if self.other else None,
            "agree": self.agree,
        }


def compare(result: Estimate, other: Machine) -> tuple[Agreement, ...]:
    """Every estimated parameter, at its operating point, with its value and tolerance in another
    machine file.

    Raises InvalidInput for another machine's file.
    """
    check_comparable(result.machine, other)
    plant = assemble(other, result.point)
    rows = []
    for path, value, deviation in zip(
        result.paths, result.values.tolist(), result.standard_deviations.tolist(), strict=True
    ):
        if path not in TIMING:
            in_plant = float(nominal_values(plant, [path])[0])
            rows.append(
                Agreement(
                    path, value, COVERAGE * deviation, in_plant, _half_width(other, path, in_plant)
                )
            )
    if not rows:
        raise InvalidInput(
            "only delays were identified; a machine file holds nothing to compare them with"
        )
    return tuple(rows)


def check_comparable(name: str, other: Machine) -> None:
    """Raises InvalidInput for another machine's file than the one of a name."""
    if other.name != name:
        remedy = "give the file that another method wrote for the same machine"
        raise invalid("the machine to compare with", repr(other.name), repr(name), remedy)


def _half_width(machine: Machine, path: str, value: float) -> float:
    parameter = parse_parameter(path)
    widths = [
        half_width(item, value)
        for item in machine.tolerances
        if parse_parameter(item.parameter).overlaps(parameter)
    ]
    return widths[0] if widths else 0.0
