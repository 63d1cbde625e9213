"""eps of a synchronous block: what the exact poles and the sensitivity beside the speed allow."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.core.per_turn import largest_block_gain
from ambrose.core.statespace import select
from ambrose.judge.synchronous_bands import Forbidden, orbit_limit
from ambrose.judge.synchronous_sensitivity import sensitivity_peak
from ambrose.law.synchronous import Condition, SynchronousLoop
from ambrose.law.synchronous_table import BlockTable, running_table
from ambrose.machine.criteria import demand

SHARE = 1 / 3  # of the largest stable eps, which a design takes
TURNS = 1 / 20  # eps over the lowest speed of a band, at most
_GAIN_SPEEDS = 3  # of each band, at which eps is bounded
_BISECTIONS = 5  # of eps, and of a band's end, for the sensitivity
_PLACES = 7  # speeds of a band at which an eps is looked for
_TINY = 1e-5  # of the speed: an eps as small as any


def gain_limit(
    loop: SynchronousLoop,
    mode: str,
    band: tuple[float, float],
    table: BlockTable,
    at: Sequence[Condition],
    update: str = "sample",
) -> float:
    """The largest eps [1/s] with stable exact poles (of an update "turn": multipliers over a turn)
    at a few speeds of a band, all conditions.
    """
    limit, drive = np.inf, running_table(table, loop, mode)
    for speed in np.linspace(*band, _GAIN_SPEEDS):
        for condition in at:
            closed = select(loop.sampled(speed, condition), None, loop.reads(mode))
            D = drive.at(speed)
            limit = largest_block_gain(closed, D, speed, loop.harmonic, update, min(limit, speed))
    return float(limit)


def within_sensitivity(
    loop: SynchronousLoop,
    mode: str,
    tables: Sequence[tuple[tuple[float, float], BlockTable]],
    at: Sequence[Condition],
    leak_per_gain: float = 0.0,
) -> tuple[list[tuple[tuple[float, float], BlockTable]], list[Forbidden]]:
    """The bands without the ends at which the sensitivity beside the speed passes its limit at any
    eps, and those ends. leak_per_gain [-]: leak over eps.

    |S| beside the speed grows by 1/sin(angle), however small eps is: judged with an eps of 1e-5 of
    the speed at the ends and in the middle; an end that fails is moved inwards by bisection.
    """

    def holds(speed: float, table: BlockTable) -> bool:
        T, eps = table.at(speed), _TINY * speed
        return all(
            sensitivity_peak(loop, mode, speed, condition, T, eps, leak_per_gain * eps)[0]
            <= _allowed(loop, mode, speed, condition)
            for condition in at
        )

    kept: list[tuple[tuple[float, float], BlockTable]] = []
    left_out: list[Forbidden] = []

    def leave_out(low: float, high: float, worst: float) -> None:
        limit = orbit_limit(loop.machine, worst)
        reason = "the sensitivity beside the speed passes its limit at any eps"
        where = "with the T of the design"
        left_out.append(Forbidden(low, high, worst, np.nan, np.nan, limit, where, reason=reason))

    for (low, high), table in tables:
        middle = (low + high) / 2
        if not holds(middle, table):
            leave_out(low, high, middle)
            continue
        ends = []
        for end in (low, high):
            good, bad = middle, end
            if holds(end, table):
                good = end
            else:
                for _ in range(_BISECTIONS):
                    trial = (good + bad) / 2
                    if holds(trial, table):
                        good = trial
                    else:
                        bad = trial
                leave_out(min(end, good), max(end, good), end)
            ends.append(good)
        kept.append(((ends[0], ends[1]), table))
    return kept, left_out


def sensitive_gain(
    loop: SynchronousLoop,
    mode: str,
    tables: Sequence[tuple[tuple[float, float], BlockTable]],
    at: Sequence[Condition],
    gain: float,
    leak_per_gain: float = 0.0,
) -> tuple[float, list[str]]:
    """eps lowered until the sensitivity at the ends of the bands keeps its limit, or what it is
    without, and 5 %. leak_per_gain [-]: leak over eps.
    """
    places = [(w, table, condition) for where, table in tables for w in where for condition in at]
    allowed = {(w, condition): _allowed(loop, mode, w, condition) for w, _, condition in places}

    def holds(trial: float) -> bool:
        return all(
            sensitivity_peak(loop, mode, w, condition, table.at(w), trial, leak_per_gain * trial)[0]
            <= allowed[w, condition]
            for w, table, condition in places
        )

    if holds(gain):
        return gain, []
    low, high = 0.0, gain
    trial = gain / 4
    for _ in range(_BISECTIONS):
        if holds(trial):
            low = trial
        else:
            high = trial
        trial = (low + high) / 2 if low else trial / 4
    if not low:
        low = gain * 1e-3
    return low, [
        f"eps is lowered from {gain:.3g} to {low:.3g} 1/s by the sensitivity beside the speed"
    ]


def sensitive_table(
    loop: SynchronousLoop,
    mode: str,
    where: tuple[float, float],
    table: BlockTable,
    at: Sequence[Condition],
    gain: float,
) -> tuple[float, BlockTable, str]:
    """eps of a band, at most ``gain`` [1/s], and its T made smaller where the sensitivity beside
    the speed asks for a smaller eps; a word of it (empty: nothing is made smaller).

    What acts is eps T(W): one eps for a whole band is that of its most sensitive end. T times a
    positive number has the directions, and the proof, of T.
    """
    places = np.linspace(*where, _PLACES)
    allowed = np.array([_sensitive(loop, mode, float(w), table, at, gain) for w in places])
    most = float(allowed.max())
    if allowed.min() >= gain:
        return gain, table, ""
    inside = [w for w in table.speeds if where[0] < w < where[1]]
    knots = np.unique(np.concatenate([places, inside]))
    sizes = np.interp(knots, places, allowed / most)
    T = np.array([size * table.at(float(w)) for w, size in zip(knots, sizes, strict=True)])
    words = (
        f"{where[0]:.4g} to {where[1]:.4g} rad/s: eps |T| from {allowed.min():.3g} to {most:.3g} "
        f"1/s over the speed, {gain:.3g} but for the sensitivity beside it"
    )
    return most, BlockTable(knots, T), words


def _sensitive(
    loop: SynchronousLoop,
    mode: str,
    speed: float,
    table: BlockTable,
    at: Sequence[Condition],
    gain: float,
) -> float:
    """The eps up to ``gain`` [1/s] that keeps the sensitivity at a speed; a thousandth of it where
    none larger does.
    """
    T = table.at(speed)

    def holds(trial: float) -> bool:
        return all(
            sensitivity_peak(loop, mode, speed, condition, T, trial, 0.0)[0]
            <= _allowed(loop, mode, speed, condition)
            for condition in at
        )

    low, high = gain, gain
    while not holds(low):
        low, high = low / 4, low
        if low < 1e-3 * gain:
            return 1e-3 * gain
    for _ in range(2 if low < high else 0):
        middle = float(np.sqrt(low * high))
        if holds(middle):
            low = middle
        else:
            high = middle
    return low


def _allowed(loop: SynchronousLoop, mode: str, speed: float, condition: Condition) -> float:
    """The sensitivity of an axis that a block has to keep: its limit, or what it is without, and
    5 %.
    """
    limit = demand("sensitivity of an axis", loop.machine.requirements).limit or 3.0
    return max(limit, 1.05 * sensitivity_peak(loop, mode, speed, condition, None, 0.0)[0])
