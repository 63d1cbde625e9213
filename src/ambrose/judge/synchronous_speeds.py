"""The speeds of a block's band at which a loop with it is worst: least far from instability, and
most sensitive.

A few speeds show neither: near a transmission zero of what the block reads, and near a lightly
damped mode, the loop changes within a few bandwidths eps |D R| of the block. Therefore

1. the plant is taken at some speeds of the band (``_BASES``), and around each the blocks'
   frequency alone is moved, which is cheap: over an even grid, every speed of the table of T and
   between them, and packed around every pole of the loop and every minimum of |R| (a zero, where T
   is largest);
2. the worst are looked at again with the plant at that very speed, twice, each time nearer;
3. there the poles are computed exactly.

Blocks of other harmonics that are on at the same speed are on here, too.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ambrose.judge.synchronous_sensitivity import (
    FrozenLoop,
    Look,
    Resonator,
    frozen,
    growth,
    look,
)
from ambrose.law.synchronous import Condition, SynchronousLoop

SETTLED = 3.0  # time constants in which a block has to settle: 95 %
MINUTE = 60.0  # s, for a run-up through the band where none is known
_BASES = 7  # speeds of a band at which the plant is taken
_FEWER = 3  # with tolerances, three of those
_EVEN = 7  # speeds around each of them, evenly
# beside a pole or zero, of its damping and of the block's eps
_AROUND = np.array([-8.0, -2.5, -0.8, -0.25, 0.0, 0.25, 0.8, 2.5, 8.0])
_LIGHT = 0.15  # damping ratio below which a pole is a narrow one
_WORST = 2  # candidates of either kind that are refined
_LEAST = 6  # minima of ``least`` that are refined
_DOUBTED = 40  # looks that are repeated, about
_WIDTHS = 1 / 4, 1 / 32  # of a base's share of the band: what a refinement looks at

Blocks = Callable[[float], tuple[Resonator, ...]]


@dataclass(frozen=True, slots=True)
class Found:
    """A speed at which a loop was looked at with its own plant. growth [rad/s]: its outermost exact
    pole.
    """

    look: Look
    condition: Condition
    growth: float

    @property
    def stable(self) -> bool:
        return self.growth < 0


@dataclass(frozen=True, slots=True)
class Least:
    """The smallest of a quantity and where it was found; count: of how many speeds."""

    value: float
    speed: float
    condition: Condition
    count: int


@dataclass(frozen=True, slots=True)
class Survey:
    """What was looked at. places: the worst ones, refined; looks: ascending in speed, the most
    sensitive of all conditions at each; slowest: the smallest real part of D R; count: how many
    looks.
    """

    places: tuple[Found, ...]
    looks: tuple[Look, ...]
    slowest: Least
    count: int

    @property
    def least_stable(self) -> Found:
        """An unstable place, else the one nearest to instability."""
        return max(self.places, key=lambda item: (not item.stable, item.look.nearness))

    @property
    def most_sensitive(self) -> Found:
        return max(self.places, key=lambda item: item.look.sensitivity)


def bad_parts(
    found: Survey, band: tuple[float, float], bad: Callable[[Look], bool]
) -> list[tuple[float, float, float]]:
    """The parts (low, high, worst) of a band [rad/s] between good looks in which a look is bad."""
    speeds = [one.speed for one in found.looks]
    wrong = [bad(one) for one in found.looks]
    parts: list[tuple[float, float, float]] = []
    k = 0
    while k < len(speeds):
        end = k
        while end + 1 < len(speeds) and wrong[end + 1] == wrong[k]:
            end += 1
        if wrong[k]:
            low = speeds[k - 1] if k else band[0]
            high = speeds[end + 1] if end + 1 < len(speeds) else band[1]
            worst = max(found.looks[k : end + 1], key=_stability)
            parts.append((low, high, worst.speed))
        k = end + 1
    return parts


def bases(band: tuple[float, float], count: int = _BASES) -> np.ndarray:
    """The speeds [rad/s] of a band at which the plant is taken, its ends among them."""
    return np.linspace(*band, count)


def unstable(one: Look) -> bool:
    return one.unstable > 0


def survey(
    loop: SynchronousLoop,
    band: tuple[float, float],
    knots: Sequence[float],
    blocks: Blocks,
    conditions: Sequence[Condition],
    members: bool = False,
    doubt: Callable[[Look], bool] = unstable,
) -> Survey:
    """The worst speeds of a band [rad/s] over conditions. knots: speeds of the table; blocks: those
    that are on at a speed; members: the conditions are corners of tolerances, at fewer plants;
    doubt: looks that are repeated with the plant of their own speed.
    """
    every: list[tuple[Look, Condition]] = []
    count = _FEWER if members else _BASES
    half = (band[1] - band[0]) / (count - 1) / 2
    for condition in conditions:
        for base in bases(band, count):
            here = frozen(loop, float(base), condition)
            # half a part further on either side: a mode moves with the speed
            low, high = max(band[0], base - 2 * half), min(band[1], base + 2 * half)
            even = np.linspace(max(band[0], base - half), min(band[1], base + half), _EVEN)
            for w in _grid(here, low, high, even, knots, blocks):
                every.append((look(here, float(w), blocks(float(w)), zoom=False), condition))

    def refined(kind: Callable[[Look], float]) -> list[Found]:
        return [
            _refined(loop, band, knots, blocks, condition, found, kind, 2 * half)
            for found, condition in _worst(every, kind, half)
        ]

    # a plant of another speed may call what is stable unstable: asked again, and no worse than so;
    # where the worst is exactly unstable, only if somebody asks for more than that
    places = refined(_stability)
    doubted = [i for i, (one, _) in enumerate(every) if doubt(one)]
    if doubted and (doubt is not unstable or all(place.stable for place in places)):
        for i in doubted[:: max(1, len(doubted) // _DOUBTED)]:
            one, condition = every[i]
            own = frozen(loop, one.speed, condition)
            every[i] = look(own, one.speed, blocks(one.speed), zoom=False), condition
        places = refined(_stability)
    places += refined(_sensitivity)
    drawn: dict[float, Look] = {}
    for one in (*(one for one, _ in every), *(place.look for place in places)):
        known = drawn.get(one.speed)
        if known is None or one.sensitivity > known.sensitivity:
            drawn[one.speed] = one
    slowest = least(loop, band, knots, blocks, conditions, _slowest, count)
    return Survey(tuple(places), tuple(drawn[w] for w in sorted(drawn)), slowest, len(every))


def least(
    loop: SynchronousLoop,
    band: tuple[float, float],
    knots: Sequence[float],
    blocks: Blocks,
    conditions: Sequence[Condition],
    value: Callable[[np.ndarray], np.ndarray],
    count: int = _FEWER,
) -> Least:
    """The smallest value of D R (w, a, a) of the first block over a band [rad/s] and conditions:
    the plant at ``count`` speeds of it, its frequency around each; the worst again, each time
    nearer, with the plant of their own speed.
    """
    looked = 0
    cells = list(itertools.pairwise(bases(band, count).tolist()))
    found: list[Least] = []

    def smallest(
        plants: Sequence[tuple[float, FrozenLoop]], condition: Condition, low: float, high: float
    ) -> list[Least]:
        """All minima, with the response linear between those of two plants, or of one."""
        nonlocal looked
        even = np.linspace(low, high, _EVEN)
        grids = [_grid(here, low, high, even, knots, blocks) for _, here in plants]
        speeds = np.unique(np.concatenate(grids))
        on = [blocks(float(w))[0] for w in speeds]
        frequencies = np.array([block.frequency for block in on])
        (first, here), (last, other) = plants[0], plants[-1]
        R = here.at(frequencies)
        if last > first:
            share = ((speeds - first) / (last - first))[:, None, None]
            R = (1 - share) * R + share * other.at(frequencies)
        values = value(np.array([block.drive for block in on]) @ -R)
        looked += len(speeds)
        around = np.pad(values, 1, constant_values=np.inf)
        lowest = np.flatnonzero((values <= around[:-2]) & (values <= around[2:]))
        return [Least(float(values[k]), float(speeds[k]), condition, looked) for k in lowest]

    exact: list[Least] = []
    for condition in conditions:
        plants = [(w, frozen(loop, w, condition)) for w in bases(band, count).tolist()]
        for plant in plants:
            exact += smallest([plant], condition, plant[0], plant[0])
        for k, (low, high) in enumerate(cells):
            found += smallest(plants[k : k + 2], condition, low, high)
    part = (band[1] - band[0]) / (count - 1)
    waiting = sorted(found, key=lambda item: item.value)
    for _ in range(_LEAST):
        if not waiting:
            break
        place = waiting[0]
        # of one minimum one
        waiting = [
            item
            for item in waiting
            if item.condition != place.condition or abs(item.speed - place.speed) > part / 8
        ]
        worst = place
        for width in (*_WIDTHS, 0.0):
            reach, speed = width * part, worst.speed
            ends = max(band[0], speed - reach), min(band[1], speed + reach)
            own = [(speed, frozen(loop, speed, worst.condition))]
            worst = min(smallest(own, worst.condition, *ends), key=lambda item: item.value)
        exact.append(worst)
    worst = min(exact, key=lambda item: item.value)
    return Least(worst.value, worst.speed, worst.condition, looked)


def _slowest(DR: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.eigvals(DR).real.min(axis=-1))


def _stability(one: Look) -> float:
    return one.nearness * (1e6 if one.unstable else 1.0)


def _sensitivity(one: Look) -> float:
    return one.sensitivity


def _worst(
    every: Sequence[tuple[Look, Condition]], kind: Callable[[Look], float], apart: float
) -> list[tuple[Look, Condition]]:
    """The worst of all looks, ``apart`` [rad/s] from each other."""
    chosen: list[tuple[Look, Condition]] = []
    for one, condition in sorted(every, key=lambda item: -kind(item[0])):
        if all(abs(one.speed - other.speed) > apart for other, _ in chosen):
            chosen.append((one, condition))
        if len(chosen) == _WORST:
            break
    return chosen


def _refined(
    loop: SynchronousLoop,
    band: tuple[float, float],
    knots: Sequence[float],
    blocks: Blocks,
    condition: Condition,
    found: Look,
    kind: Callable[[Look], float],
    part: float,
) -> Found:
    """The worst near a look, with the plant of its own speed, and the exact poles there."""
    for width in _WIDTHS:
        here = frozen(loop, found.speed, condition)
        low, high = (
            max(band[0], found.speed - width * part),
            min(band[1], found.speed + width * part),
        )
        even = np.append(np.linspace(low, high, _EVEN), found.speed)
        looks = [
            look(here, float(w), blocks(float(w)), zoom=False)
            for w in _grid(here, low, high, even, knots, blocks)
        ]
        found = max(looks, key=kind)
    speed = found.speed
    here = frozen(loop, speed, condition)
    found = look(here, speed, blocks(speed))
    return Found(found, condition, growth(here.system, blocks(speed)))


def _grid(
    here: FrozenLoop,
    low: float,
    high: float,
    even: np.ndarray,
    knots: Sequence[float],
    blocks: Blocks,
) -> np.ndarray:
    """Speeds from low to high [rad/s]: even ones, the table's and between them, and around every
    light pole and zero.
    """
    inside = [low, *(w for w in knots if low < w < high), high]
    between = [(a + b) / 2 for a, b in itertools.pairwise(inside)]
    speeds = [*even, *inside, *between]
    for block in blocks((low + high) / 2):
        multiple = block.frequency / ((low + high) / 2)
        own = here.poles[(here.poles.imag > 0) & (-here.poles.real < _LIGHT * here.poles.imag)]
        places = [(float(p.imag), abs(float(p.real))) for p in own]
        places += [(w, 0.0) for w in zeros(here, block, multiple * low, multiple * high)]
        for frequency, damping in places:
            if low <= frequency / multiple <= high:
                for width in {max(damping, 1e-6 * frequency), block.gain}:
                    speeds += list((frequency + width * _AROUND) / multiple)
    every = np.unique(np.array(speeds))
    return np.asarray(every[(every >= low) & (every <= high)])


def zeros(here: FrozenLoop, block: Resonator, low: float, high: float) -> list[float]:
    """Frequencies [rad/s] where what a block drives to zero has a transmission zero near the axis:
    minima of its smallest singular value, each refined.
    """
    # D = T Z: whatever T is, an orthonormal basis of its rows is one of those of Z
    basis = np.linalg.qr(block.drive.conj().T)[0].conj().T
    grid = np.unique(
        np.concatenate(
            [
                np.linspace(low, high, 40),
                here.omega[(here.omega > low) & (here.omega < high)],
            ]
        )
    )

    def smallest(omega: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.svd(basis @ here.at(omega), compute_uv=False)[:, -1])

    values = smallest(grid)
    found = []
    for k in range(1, len(grid) - 1):
        if values[k] <= min(values[k - 1], values[k + 1]):
            a, b = grid[k - 1], grid[k + 1]
            for _ in range(4):
                around = np.linspace(a, b, 12)
                m = int(np.argmin(smallest(around)))
                a, b = around[max(m - 1, 0)], around[min(m + 1, 11)]
            found.append(float((a + b) / 2))
    return found
