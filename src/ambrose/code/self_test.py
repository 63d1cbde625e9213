"""The run-up of the self-test of a controller with synchronous blocks: alike in C and in structured
text, so that both are tried on the same faults.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.code.synchronous import RunUnit

EVERY = 61  # samples between two rows of the self-test
SHARE = 0.1  # of the largest plausible error: the self-test's signals
_TURNS = 11  # of the self-test
_LEAST, _MOST = 2500, 20000  # samples of it
_WINDOWS = {  # shares of the self-test in which something is wrong
    "lost": (0.30, 0.50),
    "contact": (0.55, 0.56),
    "invalid": (0.60, 0.605),
    "off": (0.65, 0.70),
    "none": (0.75, 0.755),
    "large": (0.85, 0.86),
}


@dataclass(frozen=True, slots=True)
class RunUp:
    """A run-up from ``start`` [rad/s] at ``slope`` [rad/s^2] over ``count`` samples, of which
    every ``EVERY``-th is a row; windows: first sample, and the one after the last, of each fault.
    """

    start: float
    slope: float
    rows: int
    windows: dict[str, list[int]]

    @property
    def count(self) -> int:
        return self.rows * EVERY

    def within(self) -> dict[str, np.ndarray]:
        """Per fault whether a sample (count,) is in its window."""
        k = np.arange(self.count)
        return {name: (k >= a) & (k < b) for name, (a, b) in self.windows.items()}


def run_up_of(unit: RunUnit) -> RunUp:
    """From near the lower end of the first block's band to about its middle."""
    first, dt = unit.law.blocks[0], unit.base.sample_time
    low, high = first.band
    start = low + first.hysteresis + 0.05 * (high - low)

    # whole rows
    wanted = int(np.clip(_TURNS * 2 * np.pi / (start * dt), _LEAST, _MOST))
    rows = -(-wanted // EVERY)
    count = rows * EVERY
    slope = min(0.25 * unit.law.fastest, 0.45 * (high - low) / (count * dt))
    windows = {name: [round(a * count), round(b * count)] for name, (a, b) in _WINDOWS.items()}
    return RunUp(start, slope, rows, windows)
