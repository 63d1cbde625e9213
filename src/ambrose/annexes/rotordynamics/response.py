"""The whole shaft's response to sets of unbalance, with the rotor assembled anew at every speed.

Between the speeds that were computed amplitudes are read from cubic splines through the complex
values; speeds are added until these agree with what is computed between them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.annexes.rotordynamics.placement import UnbalanceCase
from ambrose.annexes.rotordynamics.stations import Layout, Reading
from ambrose.judge.unbalance import orbit

_FIRST = 51  # speeds to begin with
_MOST = 400  # speeds in all
_AGREES = 0.01  # of the largest amplitude of a case: how well a midpoint must be met
_NARROW = 2e-4  # of the top speed: intervals below are not halved
_ROUNDING = 1e-6  # of the top speed: nearer ones are one
FINE = 4001  # points on which peaks are looked for


@dataclass(frozen=True, slots=True, eq=False)
class Response:
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

    def upto(self, speed: float) -> Response:
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
) -> Response:
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
    return Response(layout, tuple(cases), grid, motion, current, widest)


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
