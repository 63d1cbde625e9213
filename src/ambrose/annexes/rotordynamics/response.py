"""The whole shaft's response to sets of unbalance, with the rotor assembled anew at every speed.

Between the speeds that were computed amplitudes are read from cubic splines through the complex
values; speeds are added until these agree with what is computed between them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.placement import UnbalanceCase
from ambrose.annexes.rotordynamics.stations import Layout, Reading
from ambrose.core.checks import InvalidInput
from ambrose.judge.campbell import Modes
from ambrose.judge.unbalance import orbit

# How far the unbalance response goes, and where it is computed first.
#
# A critical speed needs a margin of 26 % above the maximum continuous speed at most, so that the
# response must go to ``standard.MARGIN_TO`` times that speed, or to trip; it goes on to
# ``standard.CURVES_TO`` where it can, for the upper half-power points. It ends where a table of the
# machine or the controller does, and where the loop becomes unstable: nothing is steady beyond.
#
# Critical speeds are looked for by the poles s at every speed W of the first grid: those with |Im s
# - W| below a step of it are added with their half-power points, so that no peak is too sharp to be
# met.


_TIGHT = 1e-4  # of the trip speed: how well the end is found


@dataclass(frozen=True, slots=True)
class Reach:
    """asked [rad/s]: up to where the response must go; end: up to where it goes; why: what ends it
    below asked, "" for nothing. through: speeds [rad/s] at which it is to be computed. unstable:
    the first speed up to trip at which a pole has a real part
    [1/s], with it; None: there is none. along: speeds [rad/s] with the modes there.
    """

    asked: float
    end: float
    why: str
    through: tuple[float, ...]
    unstable: tuple[float, float] | None
    along: tuple[tuple[float, Modes], ...] = ()


def reach(
    loop_at: Callable[[float], ShaftLoop],
    slowest: float,
    running: tuple[float, float],
    trip: float,
    knots: Iterable[float] = (),
) -> Reach:
    """From the slowest speed of the curves [rad/s]; the loop is covered up to trip. knots [rad/s]:
    where tables bend.
    """
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

    bends = [speed for speed in (*running, *knots) if slowest < speed < end]
    speeds = np.union1d(first_speeds(slowest, end), [trip, *bends])
    step = float(np.diff(speeds).max())
    through = {trip, lowest, highest, min(asked, end)}
    unstable = None
    along: list[tuple[float, Modes]] = []
    stable = trip
    for speed in map(float, speeds):
        along.append((speed, loop_at(speed).all_modes()))
        poles = along[-1][1].poles
        abscissa = float(poles.real.max())
        # a run-up passes all speeds below the running ones
        if abscissa >= 0 and speed <= trip:
            unstable = unstable or (speed, abscissa)
        elif abscissa >= 0 and speed > trip:
            end = _last(lambda w: loop_at(w).all_modes().poles.real.max() < 0, stable, speed)
            if end < asked:
                why = f"the loop is unstable above {standard.rpm(end)} rpm"
            break
        stable = max(stable, speed)
        for pole in poles[np.abs(poles.imag - speed) <= step]:
            # the peak and its half-power points; wider ones are met by the grid
            size, half = abs(pole), abs(float(pole.real))
            if half < step:
                through |= {size - half, size, size + half}
    inside = tuple(w for w in through if slowest < w < end)
    return Reach(asked, end, why, inside, unstable, tuple(along))


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


_FIRST = 51  # speeds to begin with
_MOST = 400  # speeds in all
_AGREES = 0.01  # of the largest amplitude of a case: how well a midpoint must be met
_NARROW = 2e-4  # of the top speed: intervals below are not halved
_ROUNDING = 1e-6  # of the top speed: nearer ones are one
FINE = 4001  # points on which peaks are looked for


@dataclass(frozen=True, slots=True, eq=False)
class UnbalanceResponse:
    """Complex amplitudes, zero to peak, over the speed.

    speeds (w,) [rad/s]; motion (w, s, 2, k) [m] of the stations in x and y for k sets of
    unbalance; current (w, a, k) [A] in the coils. widest: the largest disagreement found between a
    spline and a computed midpoint, over the case's largest amplitude.
    """

    layout: Layout
    cases: tuple[UnbalanceCase, ...]
    speeds: np.ndarray
    motion: np.ndarray
    current: np.ndarray
    widest: float
    fine: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        even = np.linspace(self.speeds[0], self.speeds[-1], FINE)
        object.__setattr__(self, "fine", _apart(np.union1d(even, self.speeds)))

    def upto(self, speed: float) -> UnbalanceResponse:
        """What was computed up to a speed [rad/s], one of ``speeds``."""
        kept = self.speeds <= (1 + 2 * _ROUNDING) * speed
        return replace(
            self, speeds=self.speeds[kept], motion=self.motion[kept], current=self.current[kept]
        )

    def prominence(self, speed: float, amplification: float, case: int) -> float:
        """Of a peak at a speed [rad/s]: the amplitude [m] that it alone gives the shaft, wherever
        that moves most; from what the major axes lose at its half-power points.
        """
        half = speed / (2 * amplification)
        speeds = np.clip([speed - half, speed, speed + half], self.speeds[0], self.speeds[-1])
        xy = self.at(self.motion[..., case], speeds)
        below, top, above = orbit(xy[..., 0], xy[..., 1])
        # a peak by itself loses 1 - 1/sqrt(2) there
        return float((top - np.maximum(below, above)).max()) / (1 - np.sqrt(0.5))

    def at(self, values: np.ndarray, speeds: np.ndarray) -> np.ndarray:
        """Complex values (w, ...) by cubic splines at other speeds (v,), (v, ...)."""
        from scipy.interpolate import CubicSpline

        return np.asarray(CubicSpline(self.speeds, values)(speeds))

    def major_axis(self, station: int, case: int, speeds: np.ndarray | None = None) -> np.ndarray:
        """Semi-major axis of the orbit at a station (v,) [m]."""
        speeds = self.fine if speeds is None else speeds
        xy = self.at(self.motion[:, station, :, case], speeds)
        return np.asarray(orbit(xy[:, 0], xy[:, 1]))

    def phase_lag(
        self, reading: Reading, case: int, speeds: np.ndarray | None = None
    ) -> np.ndarray:
        """By how much a reading lags the key phasor (v,) [rad], without jumps of a whole turn.

        The mark on the shaft stands where the first unbalance does and passes a probe at angle
        theta when W t = theta. What it reads, Re(R e^{j W t}), is largest at W t = -arg R:

            lag = -arg R - theta,    0 of a stiff rotor, 90 degrees at resonance, 180 beyond it.

        Without a direction R is the forward part of the orbit, (X + j Y)/2, and theta = 0.
        """
        speeds = self.fine if speeds is None else speeds
        # turns are counted on the fine grid, however coarse the speeds are
        grid = np.union1d(self.fine, speeds)
        xy = self.at(self.motion[:, self.layout.nearest(reading.position), :, case], grid)
        if reading.direction is None:
            turned = xy[:, 0] + 1j * xy[:, 1]
        else:
            theta = reading.direction
            along = np.array([np.cos(theta), np.sin(theta)])
            turned = xy @ along * np.exp(1j * theta)
        lag = np.unwrap(-np.angle(turned))
        # at the slowest speed from -90 to 270 degrees: lead is small where there is any
        lag -= 2 * np.pi * np.floor((lag[0] + 0.5 * np.pi) / (2 * np.pi))
        return np.asarray(lag[np.searchsorted(grid, speeds)])

    def read(self, reading: Reading, case: int, speeds: np.ndarray | None = None) -> np.ndarray:
        """What a probe reads, zero to peak (v,) [m]: along its direction, or the major axis."""
        station = self.layout.nearest(reading.position)
        if reading.direction is None:
            return self.major_axis(station, case, speeds)
        speeds = self.fine if speeds is None else speeds
        xy = self.at(self.motion[:, station, :, case], speeds)
        along = np.array([np.cos(reading.direction), np.sin(reading.direction)])
        return np.asarray(np.abs(xy @ along))

    @property
    def all_readings(self) -> tuple[Reading, ...]:
        """Every probe, and the major axis at each directed probe's plane, or at the journals of a
        rotor without probes.
        """
        layout = self.layout
        # a probe without a direction reads the major axis itself
        places = {r.position: r.name for r in layout.readings if r.direction is not None}
        if not layout.readings:
            places = {j.position: f"journal {j.name}" for j in layout.journals}
        axes = (Reading(f"major axis at {name}", at, None) for at, name in places.items())
        return (*layout.readings, *axes)

    def curves(self, case: int, speeds: np.ndarray | None = None) -> list[tuple[str, np.ndarray]]:
        """(name, amplitude zero to peak (v,) [m]) of ``all_readings``."""
        return [(item.name, self.read(item, case, speeds)) for item in self.all_readings]

    def currents(self, case: int, speeds: np.ndarray | None = None) -> np.ndarray:
        """Coil currents, zero to peak (v, a) [A]."""
        speeds = self.fine if speeds is None else speeds
        return np.asarray(np.abs(self.at(self.current[:, :, case], speeds)))


def _apart(speeds: np.ndarray) -> np.ndarray:
    """Ascending speeds (w,) without those so near to the one before that rounding is all that lies
    between; the last is kept.
    """
    far = np.diff(speeds) > _ROUNDING * speeds[-1]
    return np.asarray(speeds[np.append(far, True)])


# the loop at a speed and forces (2 s, k) [N] at its stations -> states (n, k), currents (a, k) [A]
Solve = Callable[[ShaftLoop, np.ndarray], tuple[np.ndarray, np.ndarray]]


def without_block(loop: ShaftLoop, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The controller alone."""
    s = 1j * loop.point.speed
    x = loop.states(s, forces)
    return x, loop.currents(s, x) if loop.law is not None else x[:0]


def first_speeds(lowest: float, highest: float) -> np.ndarray:
    """Where a response is computed before anything is refined (w,) [rad/s]."""
    return np.linspace(lowest, highest, _FIRST)


def respond(
    layout: Layout,
    loop_at: Callable[[float], ShaftLoop],
    cases: Sequence[UnbalanceCase],
    lowest: float,
    highest: float,
    progress: Callable[[str], None] = lambda text: None,
    *,
    through: Sequence[float] = (),
    solve: Solve = without_block,
) -> UnbalanceResponse:
    """The response from one speed to another [rad/s], each of whose loops is stable.

    loop_at: speed -> loop; through: further speeds [rad/s] between them that are computed; solve:
    the states and currents under forces. The first grid is halved where the linear interpolation
    between two speeds misses what is computed between them by more than 1 % of the case's largest
    amplitude.
    """
    stations = len(layout.positions)
    forces = np.column_stack([case.forces(stations) for case in cases])
    known: dict[float, tuple[np.ndarray, np.ndarray]] = {}

    def compute(speed: float) -> np.ndarray:
        if speed not in known:
            loop = loop_at(speed)
            x, currents = solve(loop, forces * speed**2)
            known[speed] = ((loop.read @ x).reshape(stations, 2, -1), currents)
            if len(known) % 50 == 0:
                progress(f"unbalance response, {len(known)} speeds")
        return known[speed][0]

    inside = [speed for speed in through if lowest < speed < highest]
    speeds = _apart(np.union1d(first_speeds(lowest, highest), inside))
    scale = np.max([np.abs(compute(w)).max(axis=(0, 1)) for w in speeds], axis=0)
    pending = list(pairwise(speeds))
    while pending and len(known) < _MOST:
        low, high = pending.pop(0)
        middle = 0.5 * (low + high)
        straight = 0.5 * (compute(low) + compute(high))
        between = compute(middle)
        scale = np.maximum(scale, np.abs(between).max(axis=(0, 1)))
        off = (np.abs(between - straight).max(axis=(0, 1)) / scale).max()
        if off > _AGREES and middle - low > _NARROW * highest:
            pending += [(low, middle), (middle, high)]

    grid = np.array(sorted(known))
    motion = np.array([known[w][0] for w in grid])
    current = np.array([known[w][1] for w in grid])
    widest = _spline_error(grid, motion, scale)
    return UnbalanceResponse(layout, tuple(cases), grid, motion, current, widest)


def _spline_error(grid: np.ndarray, motion: np.ndarray, scale: np.ndarray) -> float:
    """How far a spline through every second speed misses the others, over each case's largest
    amplitude: an upper estimate for that through all of them.
    """
    from scipy.interpolate import CubicSpline

    if len(grid) < 9:
        return float("nan")
    kept = np.arange(0, len(grid), 2)
    rest = np.arange(1, kept[-1], 2)
    guessed = CubicSpline(grid[kept], motion[kept])(grid[rest])
    return float((np.abs(guessed - motion[rest]) / scale).max())


# Critical speeds in a response curve: amplification factor and separation margin, by interpolation.
#
# N_c is where the amplitude peaks, N_1 and N_2 where it is 0.707 of the peak: AF = N_c/(N_2 - N_1).
# A peak with one flank inside the curve has twice that flank as its band, or less where the
# neighbour or the curve's end on the other side is nearer. One without a flank stays above 0.707 of
# itself between its neighbours, or the curve's ends, a and b: AF <= N_c/(b - a). Behind the curve's
# end it may fall at once: on that side it has no more than the flank of that width.


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
        widths = float(top - left), float(right - top)
        cut = [width for width, last in zip(widths, (k == 0, top == tops[-1]), strict=True) if last]
        bands = [width + min(widths) for width in cut] or [sum(widths)]
        most = factor if known else top / min(bands)
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
