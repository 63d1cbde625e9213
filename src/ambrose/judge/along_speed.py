"""The poles of a loop followed over a range of speeds, so that the worst speed is looked at and not
the one that an even grid hits.

From speed to speed poles are paired by their shapes: with right eigenvectors v and left ones w,
w_i v_i = 1, pole i goes on as j where |(w_i v'_j)(w'_j v_i)| is near one. An interval is parted

1. where a pole may rise above the rightmost one known: above its highest value of three speeds, by
   ``_BEND`` times what it bends between them;
2. where the frequencies of two light poles cross that may rise so by coupling there, within a small
   part of it;
3. where the frequency of a light pole passes the speed itself, a critical speed, if those are
   asked for.

Nothing is proved between the speeds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from itertools import pairwise

import numpy as np

from ambrose.core.statespace import StateSpace, balance

_BEND = 3.0  # times what a pole bends, by which it may rise
_SAME = 1e-3  # of the largest real part: to what it is found
_NEAR = 0.3  # of a coupling: the distance of two frequencies that is near
_NARROW = 1e-4  # of the range: intervals below are not parted
_MOST = 80  # speeds in all, but for critical ones
_LIGHT = 0.15  # damping ratio below which a pole is a narrow one
_STEPS = 2  # with which a critical speed is approached


@dataclass(frozen=True, slots=True, eq=False)
class AlongSpeed:
    """speeds (s,) [rad/s], ascending; abscissa (s,) [rad/s]: the largest real part there; critical:
    (speed, damping) [rad/s] of every critical speed of a light pole.
    """

    speeds: np.ndarray
    abscissa: np.ndarray
    critical: tuple[tuple[float, float], ...]


def follow(
    loop_at: Callable[[float], StateSpace], speeds: np.ndarray, *, critical: bool = False
) -> AlongSpeed:
    """A closed loop, of the same states at any speed [rad/s], at every one of speeds (s,),
    ascending, and at those that are added. critical: whether critical speeds are looked for.
    """
    known: dict[float, _Modes] = {}

    def at(speed: float) -> _Modes:
        if speed not in known:
            known[speed] = _modes(loop_at(speed))
        return known[speed]

    highest = max(float(at(float(w)).poles.real.max()) for w in speeds)
    narrowest = _NARROW * float(speeds[-1] - speeds[0])
    # intervals to be parted, the one in which a pole may rise highest first
    waiting: list[tuple[float, float, float, float]] = []

    def judge_interval(low: float, high: float) -> None:
        nonlocal highest
        start, cross = at(low).poles, _crossing(at(low), _paired(at(low), at(high)), highest)
        share = 0.5 if cross is None else cross
        middle = low + share * (high - low)
        halfway = _paired(at(low), at(middle))
        centre, end = halfway.poles, _paired(halfway, at(high)).poles
        highest = max(highest, float(centre.real.max()))
        # off the chord from start to end, and no farther than a parabola or a corner rises
        bend = np.abs((centre - (1 - share) * start - share * end).real)
        top = np.maximum(np.maximum(start.real, end.real), centre.real)
        rise = np.inf if cross is not None else float((top + _BEND * bend).max())
        if high - low > narrowest:
            heappush(waiting, (-rise, low, middle, high))

    for low, high in pairwise(speeds.tolist()):
        judge_interval(low, high)
    while waiting and len(known) < _MOST:
        rise, low, middle, high = heappop(waiting)
        if -rise <= highest + _SAME * abs(highest):
            break
        judge_interval(low, middle)
        judge_interval(middle, high)

    found: list[tuple[float, float]] = []
    for low, high in pairwise(sorted(known)) if critical else ():
        start, end = at(low).poles, _paired(at(low), at(high)).poles
        light = np.minimum(-start.real, -end.real) < _LIGHT * high
        passes = (start.imag - low > 0) != (end.imag - high > 0)
        found += [
            _critical(at, (low, start[k]), (high, end[k])) for k in np.flatnonzero(light & passes)
        ]
    found_at = np.array(sorted(known))
    abscissa = np.array([known[w].poles.real.max() for w in found_at])
    return AlongSpeed(found_at, abscissa, tuple(sorted(found)))


@dataclass(frozen=True, slots=True, eq=False)
class _Modes:
    """Continuous poles (n,), of a sampled loop ln(z)/T; right vectors (n, n), and left ones, of
    A (n, n); rate (n,): of a pole per change of its eigenvalue.
    """

    poles: np.ndarray
    right: np.ndarray
    left: np.ndarray
    A: np.ndarray
    rate: np.ndarray

    def coupling(self, kept: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Between the poles kept (k,), (k, k) [rad/s], by a change of A."""
        moved = self.left[kept] @ change @ self.right[:, kept] * self.rate[kept]
        return np.asarray(np.sqrt(np.abs(moved * moved.T)))


def _modes(loop: StateSpace) -> _Modes:
    balanced, scale = balance(loop.A)
    values, right = np.linalg.eig(balanced)
    try:
        left = np.linalg.inv(right)
    except np.linalg.LinAlgError:  # of a defective pole, to the last digit
        left = np.linalg.pinv(right)
    rate = np.ones(len(values), complex)
    if loop.dt is not None:
        # a pole of a delay at z = 0 is as far to the left as any
        size = np.maximum(np.abs(values), 1e-12)
        rate = 1 / (size * np.exp(1j * np.angle(values)) * loop.dt)
        values = (np.log(size) + 1j * np.angle(values)) / loop.dt
    return _Modes(values, scale[:, None] * right, left / scale, loop.A, rate)


def _paired(first: _Modes, second: _Modes) -> _Modes:
    """The second ones in the order of the first."""
    from scipy.optimize import linear_sum_assignment

    alike = np.abs((first.left @ second.right) * (second.left @ first.right).T)
    distance = np.abs(first.poles[:, None] - second.poles[None, :])
    apart = distance / (np.abs(first.poles)[:, None] + distance + 1.0)
    _, order = linear_sum_assignment(apart - np.minimum(alike, 1.0))
    return replace(
        second,
        poles=second.poles[order],
        right=second.right[:, order],
        left=second.left[order],
        rate=second.rate[order],
    )


def _crossing(start: _Modes, end: _Modes, highest: float) -> float | None:
    """The share of an interval, the first, at which the frequencies of two light poles cross that
    may rise above the highest real part known by coupling there.
    """
    light = np.flatnonzero(
        (start.poles.imag > 0)
        & (end.poles.imag > 0)
        & (-start.poles.real < _LIGHT * start.poles.imag)
    )
    a, b = start.poles[light], end.poles[light]
    before = a.imag[:, None] - a.imag[None, :]
    after = b.imag[:, None] - b.imag[None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = before / (before - after)
    inside = (share > 0) & (share < 1)
    if not inside.any():
        return None
    # to first order two poles that meet part by the square root of m_ij m_ji, m = w (A' - A) v
    change = end.A - start.A
    coupling = np.maximum(
        share * start.coupling(light, change), (1 - share) * end.coupling(light, change)
    )
    top = np.maximum(a.real, b.real)
    inside &= np.maximum(top[:, None], top[None, :]) + _BEND * coupling > highest
    # at an end that near to it what bends there is seen
    inside &= np.minimum(np.abs(before), np.abs(after)) > _NEAR * coupling
    return float(share[inside].min()) if inside.any() else None


def _critical(
    at: Callable[[float], _Modes], low: tuple[float, complex], high: tuple[float, complex]
) -> tuple[float, float]:
    """Where the frequency of a pole is the speed, by regula falsi, and its damping, both
    [rad/s].
    """
    for _ in range(_STEPS):
        (a, p), (b, q) = low, high
        speed = float(a + (b - a) * (p.imag - a) / ((p.imag - a) - (q.imag - b)))
        guess = p + (q - p) * (speed - a) / (b - a) if b > a else p
        own = at(speed).poles
        pole = complex(own[np.argmin(np.abs(own - guess))])
        if (pole.imag - speed > 0) == (p.imag - a > 0):
            low = speed, pole
        else:
            high = speed, pole
    return float(pole.imag), max(abs(pole.real), 1e-6 * speed)
