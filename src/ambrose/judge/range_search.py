"""A range of speeds and seal pressures, gridded as finely as the loop changes.

The grid is a product of speeds and pressures. It begins with ends and middles; the interval over
which the figure changes most is halved until no neighbours differ by more than a few per cent, or
the number of points is used up. What is found is found on that grid: nothing is proved between its
points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ambrose.judge.certificate import certify
from ambrose.law.law import LawLike
from ambrose.law.loop import running_law
from ambrose.law.timing import Timing
from ambrose.machine.description import OperatingPoint, OperatingRange
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.reduce import default_bending_modes, reduce

_CHANGE = 0.05  # relative, of the figure between neighbours
_MOST = 32  # points of the grid


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """speeds (s,) [rad/s], pressures (p,) [Pa], peak (s, p): sigma_max(S_o), inf where the loop is
    unstable; abscissa (s, p) [rad/s]; change: the largest relative change of the peak between
    neighbours.
    """

    speeds: np.ndarray
    pressures: np.ndarray
    peak: np.ndarray
    abscissa: np.ndarray

    @property
    def change(self) -> float:
        return max(
            (float(_changes(self.peak, axis).max(initial=0.0)) for axis in (0, 1)), default=0.0
        )

    def worst(self, area: OperatingRange) -> OperatingPoint:
        """Where the peak is largest; where loops are unstable, the most unstable one."""
        value = self.abscissa if np.isinf(self.peak).any() else self.peak
        i, j = np.unravel_index(int(value.argmax()), value.shape)
        return area.at(float(self.speeds[i]), float(self.pressures[j]))


def search(
    machine: Machine, area: OperatingRange, law: LawLike, timing: Timing | None = None
) -> Found:
    """The peak of sigma_max(S_o) of the nominal loop, and its outermost pole, over a range, on
    plants with all bending modes that matter (``default_bending_modes``).

    law: a continuous controller or a schedule; timing: the loop as it runs (None: continuous).
    """
    known: dict[tuple[float, float], tuple[float, float]] = {}
    modes = default_bending_modes(assemble(machine, area.corners[0]))

    def judged(speed: float, pressure: float) -> tuple[float, float]:
        if (speed, pressure) not in known:
            plant = reduce(assemble(machine, area.at(speed, pressure)), modes)
            certificate = certify(plant, running_law(law, plant, timing), margins=False)
            known[speed, pressure] = certificate.closed_loop_norm, certificate.spectral_abscissa
        return known[speed, pressure]

    grids = [
        np.linspace(*pair, 3) if pair[1] > pair[0] else np.array(pair[:1])
        for pair in (area.speed, area.seal_pressure)
    ]
    while True:
        values = np.array([[judged(float(v), float(p)) for p in grids[1]] for v in grids[0]])
        result = Found(grids[0], grids[1], values[..., 0], values[..., 1])
        changes = [_changes(result.peak, axis).max(axis=1 - axis, initial=0.0) for axis in (0, 1)]
        axis = int(np.argmax([part.max(initial=0.0) for part in changes]))
        added = len(grids[1 - axis])
        if changes[axis].max(initial=0.0) <= _CHANGE or result.peak.size + added > _MOST:
            return result
        k = int(changes[axis].argmax())
        grids[axis] = np.insert(grids[axis], k + 1, grids[axis][k : k + 2].mean())


def _changes(peak: np.ndarray, axis: int) -> np.ndarray:
    """Relative changes between neighbours along an axis; 0 between two unstable ones, inf between a
    stable and an unstable.
    """
    low, high = (np.take(peak, range(i, peak.shape[axis] - 1 + i), axis) for i in (0, 1))
    both = np.isinf(low) & np.isinf(high)
    with np.errstate(invalid="ignore"):
        change = np.abs(high - low) / np.minimum(low, high)
    return np.where(both, 0.0, change)
