"""A table of 1x amplitudes: what converged synchronous blocks hold, or vectors read off a monitor.

One line per axis and speed, with this head:

    speed_rpm,axis,amplitude_um_0p,angle_deg
    7640,upper_zeta,12.1,38.2

The amplitude is zero to peak; a column amplitude_um_pp, as monitors have it, is peak to peak. Its
angle is that of y(t) = Re(a exp(j theta)), theta the angle of
the key mark from x in the direction of spin: the angle of the block's own a. (A monitor's phase
lag is minus it.) Several lines of one axis and speed are readings of the same vector.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.messages import suggestion
from ambrose.machine.ordinary_file import read_text

COLUMNS = ("speed_rpm", "axis", "amplitude_um_0p", "angle_deg")
_PEAK_TO_PEAK = "amplitude_um_pp"  # in place of the third
_RPM = 2 * math.pi / 60  # rad/s per rpm
_SAME_SPEED = 0.01  # relative difference below which lines are of one speed
_MOST = 100_000  # lines


@dataclass(frozen=True, slots=True, eq=False)
class AmplitudeTable:
    """speeds (s,) [rad/s]; values (s, a) complex [m], the mean of the readings; noise (s, a) [m2],
    the variance of that mean (0 where one reading is all).
    """

    speeds: np.ndarray
    values: np.ndarray
    noise: np.ndarray

    def since(self, before: AmplitudeTable) -> AmplitudeTable:
        """What has come since an earlier table, a - a_before at the speeds that both have. Run-out,
        which both hold, drops out. Raises InvalidInput where no speed is in both.
        """
        pairs = [
            (k, int(np.argmin(np.abs(before.speeds - speed))))
            for k, speed in enumerate(self.speeds)
        ]
        same = [
            (k, j) for k, j in pairs if abs(before.speeds[j] / self.speeds[k] - 1) < _SAME_SPEED
        ]
        if not same:
            raise InvalidInput(
                "no speed of the table is in the earlier one; read both at the same speeds"
            )
        now, then = [k for k, _ in same], [j for _, j in same]
        return AmplitudeTable(
            self.speeds[now],
            self.values[now] - before.values[then],
            self.noise[now] + before.noise[then],
        )


def read_amplitudes(path: str | Path, axes: Sequence[str]) -> AmplitudeTable:
    """The table of a file, in the order of a machine's axes. Raises InvalidInput for a file that is
    none, another head, an axis that the machine does not have or that a speed lacks.
    """
    name = Path(path).name
    text = read_text(path, "table of amplitudes")
    try:
        lines = list(csv.DictReader(x for x in text.splitlines() if not x.startswith("#")))
    except csv.Error as error:
        raise InvalidInput(
            f"the amplitudes {name} cannot be read ({error}); give a text file with the columns "
            f"{', '.join(COLUMNS)}"
        ) from None
    for line in lines:
        if _PEAK_TO_PEAK in line and COLUMNS[2] not in line:
            line[COLUMNS[2]] = _half(line[_PEAK_TO_PEAK])
    if not lines or any(column not in lines[0] for column in COLUMNS):
        found = "no line" if not lines else ", ".join(str(key) for key in lines[0])
        raise invalid(
            f"the head of {name}",
            found,
            f"{', '.join(COLUMNS)} (or {_PEAK_TO_PEAK})",
            "name the columns so, in these units",
        )
    if len(lines) > _MOST:
        raise invalid(f"the lines of {name}", len(lines), f"at most {_MOST}", "thin them out")

    # readings by speed, then by axis
    speeds: list[float] = []
    readings: list[dict[str, list[complex]]] = []
    for number, line in enumerate(lines, start=2):
        speed, value = _reading(line, name, number)
        axis = (line["axis"] or "").strip()
        if axis not in axes:
            raise InvalidInput(
                f"line {number} of {name}: the machine has no axis {axis!r}; "
                f"{suggestion(axis, axes)}"
            )
        near = [k for k, known in enumerate(speeds) if abs(known / speed - 1) < _SAME_SPEED]
        if not near:
            speeds.append(speed)
            readings.append({})
        at = near[0] if near else len(speeds) - 1
        readings[at].setdefault(axis, []).append(value)

    for speed, by_axis in zip(speeds, readings, strict=True):
        missing = [axis for axis in axes if axis not in by_axis]
        if missing:
            raise InvalidInput(
                f"{name} has no line of {', '.join(missing)} at {speed / _RPM:.5g} rpm; give every "
                "axis at every speed"
            )

    order = np.argsort(speeds)
    means = [[complex(np.mean(by_axis[axis])) for axis in axes] for by_axis in readings]
    noise = [[_variance(by_axis[axis]) for axis in axes] for by_axis in readings]
    return AmplitudeTable(np.array(speeds)[order], np.array(means)[order], np.array(noise)[order])


def _half(text: str | None) -> str | None:
    """Zero to peak of a number peak to peak; what is none stays as it is, for the message."""
    try:
        return repr(float(text or "") / 2)
    except ValueError:
        return text


def _reading(line: dict[str, str | None], name: str, number: int) -> tuple[float, complex]:
    """Speed [rad/s] and a [m] of a line."""
    figures = []
    for column in ("speed_rpm", COLUMNS[2], "angle_deg"):
        try:
            figures.append(float(line[column] or ""))
        except ValueError:
            figures.append(math.nan)
        if not math.isfinite(figures[-1]):
            raise InvalidInput(
                f"line {number} of {name}: {column} is {line[column]!r}, no finite number; write "
                "it with a point and without its unit"
            )
    rpm, amplitude, angle = figures
    if rpm <= 0 or amplitude < 0:
        raise InvalidInput(
            f"line {number} of {name}: {rpm:g} rpm and {amplitude:g} um; a speed is above zero and "
            "an amplitude not below, turn the angle by 180 degrees instead"
        )
    # a = |a| exp(j angle)
    turned = complex(math.cos(math.radians(angle)), math.sin(math.radians(angle)))
    return rpm * _RPM, 1e-6 * amplitude * turned


def _variance(values: Sequence[complex]) -> float:
    """Of the mean of readings, sum |a - mean|^2 / (n (n - 1)); zero of a single one."""
    n = len(values)
    if n < 2:
        return 0.0
    return float(np.sum(np.abs(np.array(values) - np.mean(values)) ** 2) / (n * (n - 1)))
