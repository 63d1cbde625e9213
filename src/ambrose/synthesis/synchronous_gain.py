"""eps of a synchronous block: what the exact poles and the sensitivity beside the speed allow."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.synchronous import largest_stable
from ambrose.judge.synchronous_bands import Forbidden, orbit_limit
from ambrose.judge.synchronous_sensitivity import (
    Look,
    Resonator,
    frozen,
    growth_by_gain,
    resonator,
    sensitivity_peak,
)
from ambrose.judge.synchronous_speeds import MINUTE, SETTLED, bad_parts, survey, zeros
from ambrose.law.synchronous import Condition, SynchronousLoop
from ambrose.law.synchronous_table import BlockTable, running_table
from ambrose.machine.criteria import demand

SHARE = 1 / 3  # of the largest stable eps, which a design takes
TURNS = 1 / 20  # eps over the lowest speed of a band, at most
_LOWERED = 4  # times that eps is lowered until the loop is stable everywhere
_PASSES = 4  # times that bands are parted
_CLEAR = 2.5  # of (1 - Q M)^-1 with the block, which a design keeps: 1.67 in gain at least
_MORE = 1.06  # times the sensitivity without a block, where that is above its limit
_ZEROS = {  # of what a mode reads: what it is, and which mode goes there
    "vibration-free": ("antiresonance at the sensors", "current-free"),
    "current-free": ("resonance of the rotor without control current", "vibration-free"),
}
_BISECTIONS = 5  # of eps, and of a band's end, for the sensitivity
_PLACES = 7  # speeds of a band at which an eps is looked for
_TINY = 1e-5  # of the speed: an eps as small as any


def _blocks(
    loop: SynchronousLoop, mode: str, table: BlockTable, gain: float, update: str
) -> Callable[[float], tuple[Resonator, ...]]:
    """The block of a table at a speed."""
    drive = running_table(table, loop, mode)
    return lambda speed: (resonator(loop, mode, drive.at(speed), speed, gain, 0.0, update),)


def gain_limit(
    loop: SynchronousLoop,
    mode: str,
    band: tuple[float, float],
    table: BlockTable,
    at: Sequence[Condition],
    update: str = "sample",
) -> float:
    """The largest eps [1/s] with stable exact poles (of an update "turn": multipliers over a turn)
    where they are nearest to instability in a band, all conditions; at most the speed there.
    """
    limit, gain = band[0], TURNS * band[0]
    for _ in range(_LOWERED):
        blocks = _blocks(loop, mode, table, gain, update)
        place = survey(loop, band, table.speeds.tolist(), blocks, at).least_stable
        speed = place.look.speed
        system = loop.sampled(speed, place.condition)
        grows = growth_by_gain(system, blocks(speed))

        def stable(trial: float, grows: Callable[[float], float] = grows) -> bool:
            return grows(trial) < 0

        limit = largest_stable(stable, min(limit, speed), 0.05)
        if place.stable:
            return limit
        gain = min(gain / 4, SHARE * limit)
    return 0.0


def clear_parts(
    loop: SynchronousLoop,
    mode: str,
    band: tuple[float, float],
    table: BlockTable,
    at: Sequence[Condition],
    gain: float,
    narrow: float,
    update: str = "sample",
    members: bool = False,
) -> tuple[list[tuple[float, float]], list[Forbidden]]:
    """The parts of a band in which a block with eps ``gain`` [1/s] is stable and keeps clear of
    instability by ``_CLEAR`` (members: at corners of tolerances is stable, settles and keeps the
    sensitivity), and those left out. narrow [rad/s]: a part that is narrower is left out, too.

    Near a transmission zero of what the block reads, T = R^-1 grows without bound and turns its
    sign at the zero: within a bandwidth of the block no T is stable on both sides.
    """
    waiting, kept = [band], []
    left_out: list[Forbidden] = []
    blocks = _blocks(loop, mode, table, gain, update)
    limit = demand("sensitivity of an axis", loop.machine.requirements).limit or 3.0

    def bad(one: Look) -> bool:
        if members:
            # slower than the judge asks of a block: made small for the sensitivity's sake
            slow = gain / 2 * one.convergence < SETTLED / MINUTE
            return one.unstable > 0 or slow or one.sensitivity > max(limit, _MORE * one.alone)
        return one.unstable > 0 or one.nearness > _CLEAR

    for _ in range(_PASSES):
        trying, waiting = waiting, []
        for low, high in trying:
            if high - low < narrow:
                continue
            knots = table.speeds.tolist()
            found = survey(loop, (low, high), knots, blocks, at, members, bad)
            parts = bad_parts(found, (low, high), bad)
            place = found.least_stable
            if not parts and not place.stable:
                reach = 4 * gain + 0.01 * (high - low)
                w = place.look.speed
                parts = [(max(low, w - reach), min(high, w + reach), w)]
            if not parts:
                kept.append((low, high))
                continue
            for start, end, worst in parts:
                left_out.append(_too_near(loop, mode, start, end, worst, gain, table, at))
            edges = [low, *(w for start, end, _ in parts for w in (start, end)), high]
            waiting += [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b > a]
    # what was never shown to be clear
    left_out += [_too_near(loop, mode, a, b, (a + b) / 2, gain, table, at) for a, b in waiting]
    return sorted(kept), _joined(left_out)


def _joined(left_out: Sequence[Forbidden]) -> list[Forbidden]:
    """Bands that touch as one."""
    joined: list[Forbidden] = []
    for item in sorted(left_out, key=lambda item: item.low):
        if joined and item.low <= joined[-1].high * (1 + 1e-9):
            joined[-1] = replace(joined[-1], high=max(item.high, joined[-1].high))
        else:
            joined.append(item)
    return joined


def _too_near(
    loop: SynchronousLoop,
    mode: str,
    low: float,
    high: float,
    worst: float,
    gain: float,
    table: BlockTable,
    at: Sequence[Condition],
) -> Forbidden:
    """A band left out for the finite eps, with cause and remedy."""
    (block,) = _blocks(loop, mode, table, gain, "sample")(worst)
    here = frozen(loop, worst, at[0])
    span = loop.harmonic * low * 0.98, loop.harmonic * high * 1.02
    at_zero = zeros(here, block, *span)
    where = f"with eps {gain:.3g} 1/s"
    kind = _ZEROS.get(mode)
    if kind and at_zero:
        nearest = min(at_zero, key=lambda w: abs(w - loop.harmonic * worst))
        reason = (
            f"{kind[0]} at {nearest:.4g} rad/s, near which the block is unstable or too near to "
            f"instability; use {kind[1]} there, or no block"
        )
    else:
        reason = (
            "the loop is too near to instability with the block, too sensitive or too slow; give "
            "another time constant, or use another mode there"
        )
    limit = orbit_limit(loop.machine, worst)
    return Forbidden(low, high, worst, np.nan, np.nan, limit, where, reason=reason)


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
