"""Critical speeds in a response curve: amplification factor and separation margin, by
interpolation.

N_c is where the amplitude peaks, N_1 and N_2 where it is 0.707 of the peak:
AF = N_c/(N_2 - N_1). A peak with one flank inside the curve has twice that flank as its band, or
less where the neighbour or the curve's end on the other side is nearer. One without a flank stays
above 0.707 of itself between its neighbours, or the curve's ends, a and b: AF <= N_c/(b - a).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from ambrose.annexes.rotordynamics import standard


@dataclass(frozen=True, slots=True)
class Critical:
    """A peak: speed [rad/s], amplitude zero to peak [m], amplification factor (nan: no flank falls
    to half power inside the curve), both flanks inside or one; most: what the factor is at most.
    """

    speed: float
    amplitude: float
    amplification: float
    both_flanks: bool
    most: float = math.inf

    @property
    def known(self) -> bool:
        """Whether the curve shows an amplification factor."""
        return math.isfinite(self.amplification)

    @property
    def damped(self) -> bool:
        """Critically damped: no margin is asked for."""
        return self.factor < standard.CRITICALLY_DAMPED

    @property
    def factor(self) -> float:
        """The amplification factor, or what it is at most."""
        return self.amplification if self.known else self.most


def criticals(speeds: np.ndarray, amplitude: np.ndarray) -> tuple[Critical, ...]:
    """The peaks of amplitudes (w,) [m] over ascending speeds (w,) [rad/s]."""
    curve = CubicSpline(speeds, amplitude)
    slope = curve.derivative()
    tops = [
        float(w)
        for w in slope.roots(extrapolate=False)
        if curve(w, 2) < 0 and speeds[0] < w < speeds[-1]
    ]
    found = []
    for k, top in enumerate(tops):
        left = speeds[0] if k == 0 else tops[k - 1]
        right = speeds[-1] if k == len(tops) - 1 else tops[k + 1]
        peak = float(curve(top))
        if peak < 1e-3 * float(amplitude.max()):
            continue
        sides = (float(left), float(right))
        flanks = [_flank(curve, peak, top, end) for end in sides]
        known = [flank for flank in flanks if flank is not None]
        # a flank that is not reached is as wide as the other, but ends with the curve
        band = (
            sum(
                min(known[0], abs(end - top)) if flank is None else flank
                for flank, end in zip(flanks, sides, strict=True)
            )
            if known
            else math.nan
        )
        factor = top / band if known else math.nan
        most = factor if known else top / float(right - left)
        found.append(Critical(top, peak, factor, len(known) == 2, most))
    return tuple(found)


def _flank(curve: CubicSpline, peak: float, top: float, end: float) -> float | None:
    """From the peak to half power towards ``end`` [rad/s]; None where it is not reached."""
    half = peak / math.sqrt(2)
    places = np.linspace(top, end, 400)
    below = np.flatnonzero(curve(places) < half)
    if not below.size:
        return None
    k = int(below[0])
    crossing = brentq(lambda w: float(curve(w)) - half, places[k - 1], places[k])
    return abs(crossing - top)


@dataclass(frozen=True, slots=True)
class Separation:
    """How far a critical speed lies from the running speeds: margin and what is required [%]; of an
    unknown amplification factor what the largest possible one requires.
    """

    critical: Critical
    margin: float
    required: float

    @property
    def passed(self) -> bool:
        return self.critical.damped or self.margin >= self.required


def separation(critical: Critical, lowest: float, highest: float) -> Separation:
    """Of a critical speed from the running range [rad/s]; inside of it the margin is 0 and what is
    asked for that below the range.
    """
    factor = critical.factor
    below, above = standard.margin_below(factor), standard.margin_above(factor)
    if critical.speed < lowest:
        return Separation(critical, 100 * (lowest - critical.speed) / lowest, below)
    if critical.speed > highest:
        return Separation(critical, 100 * (critical.speed - highest) / highest, above)
    return Separation(critical, 0.0, max(below, above))
