"""How far the unbalance response goes, and where it is computed first.

A critical speed needs a margin of 26 % above the maximum continuous speed at most, so that the
response must go to ``standard.MARGIN_TO`` times that speed, or to trip; it goes on to
``standard.CURVES_TO`` where it can, for the upper half-power points. It ends where a table of the
machine or the controller does, and where the loop becomes unstable: nothing is steady beyond.

Critical speeds are looked for by the poles s at every speed W of the first grid: those with
|Im s - W| below a step of it are added with their half-power points, so that no peak is too sharp
to be met.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.response import first_speeds
from ambrose.core.checks import InvalidInput

_TIGHT = 1e-4  # of the trip speed: how well the end is found


@dataclass(frozen=True, slots=True)
class Reach:
    """asked [rad/s]: up to where the response must go; end: up to where it goes; why: what ends it
    below asked, "" for nothing. through: speeds [rad/s] at which it is to be computed. unstable:
    the first speed from the lowest running speed to trip at which a pole has a real part
    [1/s], with it; None: there is none.
    """

    asked: float
    end: float
    why: str
    through: tuple[float, ...]
    unstable: tuple[float, float] | None


def reach(
    loop_at: Callable[[float], ShaftLoop],
    slowest: float,
    running: tuple[float, float],
    trip: float,
) -> Reach:
    """From the slowest speed of the curves [rad/s]; the loop is covered up to trip."""
    lowest, highest = running
    asked = max(trip, standard.MARGIN_TO * highest)
    end, why = asked, ""
    for wanted in (asked, max(trip, standard.CURVES_TO * highest)):
        if error := _refusal(loop_at, wanted):
            if wanted == asked:
                why = f"{error}; extend the table"
                end = _last(lambda speed: not _refusal(loop_at, speed), trip, asked)
            break
        end = wanted

    speeds = np.union1d(first_speeds(slowest, end), [trip])
    step = float(np.diff(speeds).max())
    through = {trip, lowest, highest, min(asked, end)}
    unstable = None
    stable = trip
    for speed in map(float, speeds):
        poles = loop_at(speed).all_modes()
        abscissa = float(poles.real.max())
        if abscissa >= 0 and lowest <= speed <= trip:
            unstable = unstable or (speed, abscissa)
        elif abscissa >= 0 and speed > trip:
            end = _last(lambda w: loop_at(w).all_modes().real.max() < 0, stable, speed)
            if end < asked:
                why = f"the loop is unstable above {standard.rpm(end)} rpm"
            break
        stable = max(stable, speed)
        for pole in poles[np.abs(poles.imag - speed) <= step]:
            # the peak and its half-power points; wider ones are met by the grid
            size, half = abs(pole), abs(float(pole.real))
            if half < step:
                through |= {size - half, size, size + half}
    return Reach(asked, end, why, tuple(w for w in through if slowest < w < end), unstable)


def _refusal(loop_at: Callable[[float], ShaftLoop], speed: float) -> str:
    """What the machine file or the controller does not cover at a speed; "": nothing."""
    try:
        loop_at(speed)
    except InvalidInput as error:
        return str(error)
    return ""


def _last(holds: Callable[[float], bool], low: float, high: float) -> float:
    """The last speed [rad/s] at which something holds, between one where it does and one where it
    does not.
    """
    width = _TIGHT * low
    while high - low > width:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low
