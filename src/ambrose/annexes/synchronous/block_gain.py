"""eps of a synchronous block: what the exact poles and the sensitivity beside the speed allow."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import groupby

import numpy as np

from ambrose.annexes.synchronous.block_checks import (
    Forbidden,
    converged_at,
    forbidden_bands,
    orbit_limit,
    unbalance_of,
    worst_signal,
)
from ambrose.annexes.synchronous.block_loop import (
    BlockTable,
    Condition,
    SynchronousLoop,
    block_of,
    running_table,
)
from ambrose.annexes.synchronous.speeds import (
    MINUTE,
    SETTLED,
    Look,
    Resonator,
    bad_parts,
    frozen,
    growth_by_gain,
    resonator,
    sensitivity_peak,
    survey,
    zeros,
)
from ambrose.core.checks import InvalidInput
from ambrose.core.synchronous import best_inverse, convergence, largest_stable, sector_angle
from ambrose.machine.criteria import demand
from ambrose.machine.part import Synchronous

# A synchronous block that damps: through a resonance in which no signal may be driven to zero.
#
# The block reads y, c = D y once it has settled, D = g T with T(W) = R(W)^-1 and R from c to -y:
#
#     y = y_0 - R c    =>    (I + g R T) y = y_0,    y = y_0/(1 + g)                          (1)
#
# Near a critical speed P^-1 is c_d j W there (stiffness and inertia cancel), so that the force
# which (1) adds opposes the velocity: it raises the damping of the mode by g. Far from it the same
# D pushes against stiffness or inertia, which costs current; hence the band stays narrow, and g as
# small as the orbit's limit allows. The leak of the amplitude sets g = eps/(2 leak): it is
# convergent control with leakage (Knospe et al., Mechatronics 5 (1995) 385).


MODE = "damping"
_SHARES = 0.25 * np.sqrt(2.0) ** np.arange(13)  # g that are tried, 0.25 to 16
_CURRENT = 0.5  # of the smallest limit of a coil's current, for the 1x current
_POINTS = 9  # of a band, at which the current is looked at


def damping_blocks(
    loop: SynchronousLoop,
    band: tuple[float, float],
    at: Sequence[Condition],
    corners: Sequence[Condition],
    clear: float,
    time_constant: float | None = None,
    update: str = "sample",
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[tuple[Synchronous, ...], float]:
    """Blocks of mode "damping" that keep the orbit within ``clear`` of its limit all over the band
    [rad/s], at the conditions ``at`` and the corners of their tolerances; and g [-], by which they
    divide 1x, less one.

    time_constant [s]: 2/eps; None: as short as poles and sensitivity allow. update: "sample" or
    "turn". Raises InvalidInput
    where no g up to 16 keeps the orbit within its limit and the current within half of the coils',
    or where no T converges, poles or sensitivity are lost.
    """
    progress(f"damping from {band[0]:.4g} to {band[1]:.4g} rad/s")
    tables: list[tuple[tuple[float, float], BlockTable]] = []
    for where, table, refused in usable_tables(loop, MODE, band, at):
        if refused is not None:
            raise InvalidInput(f"damping is not possible there: {refused}")
        tables.append((where, table))

    g = _least_share(loop, tables, at, corners, clear)

    # leak = eps/(2 g):   c = eps/(2 leak) T y = g T y
    leak_per_gain = 1 / (2 * g)
    kept, lost = within_sensitivity(loop, MODE, tables, at, leak_per_gain)
    if lost:
        raise InvalidInput(f"damping is not possible there: {lost[0]}")
    limit = min(gain_limit(loop, MODE, where, table, at, update) for where, table in kept)
    gain = min(SHARE * limit, TURNS * band[0])
    if time_constant is not None:
        gain = min(gain, 2 / time_constant)
    gain, _ = sensitive_gain(loop, MODE, kept, at, gain, leak_per_gain)
    blocks = tuple(
        block_of(MODE, where, 2 / gain, table, leak=gain * leak_per_gain, update=update)
        for where, table in kept
    )
    return blocks, g


def _least_share(
    loop: SynchronousLoop,
    tables: Sequence[tuple[tuple[float, float], BlockTable]],
    at: Sequence[Condition],
    corners: Sequence[Condition],
    clear: float,
) -> float:
    """The smallest g of ``_SHARES`` that keeps orbit and current. Raises InvalidInput."""
    available = _available_current(loop)
    why = "no g was tried"
    for g in _SHARES:
        trial = float(g)
        why = ""
        for where, table in tables:

            def drive(speed: float, table: BlockTable = table, trial: float = trial) -> np.ndarray:
                return trial * table.at(speed)

            broken = forbidden_bands(loop, MODE, where, (*at, *corners), drive, share=clear)
            if broken:
                why = str(broken[0])
                break
            current = _largest_current(loop, where, at, drive)
            if current > available:
                # more g takes more current
                raise InvalidInput(
                    f"damping by {trial:.3g} takes {current:.3g} A at 1x, more than half of a "
                    f"coil's limit, {available:.3g} A; balance the rotor better"
                )
        if not why:
            return trial
    raise InvalidInput(f"damping by up to {_SHARES[-1]:.3g} does not keep the orbit: {why}")


def _available_current(loop: SynchronousLoop) -> float:
    """What 1x may take of a coil's current [A]; inf where no limit is known."""
    limits = [b.max_current for b in loop.machine.bearings if b.max_current is not None]
    return _CURRENT * min(limits, default=np.inf)


def _largest_current(
    loop: SynchronousLoop,
    band: tuple[float, float],
    at: Sequence[Condition],
    drive: Callable[[float], np.ndarray],
) -> float:
    """The largest 1x control current [A] over a band under the residual unbalance."""
    residual = unbalance_of(loop.machine)
    return max(
        worst_signal(
            converged_at(loop, MODE, float(w), condition, drive).u, float(residual.force(w))
        )
        for condition in at
        for w in np.linspace(*band, _POINTS)
    )


# T of a synchronous block over a band: the inverse of what the block sees, for all pressures.


# knots of a table over a band as wide as its middle speed, to begin with; of any table, at most;
# assumed
_KNOTS, _MOST_KNOTS = 17, 97
_ANGLE = np.radians(15.0)  # below which no T is offered
_LOSS = np.radians(5.0)  # by which T between two knots may be worse than at them


def usable_tables(
    loop: SynchronousLoop, mode: str, band: tuple[float, float], at: Sequence[Condition]
) -> list[tuple[tuple[float, float], BlockTable, Forbidden | None]]:
    """The parts of a band [rad/s] in which one T converges at all conditions with ``_ANGLE`` to
    spare, with their tables; and those in which none was found, with an empty table.
    """
    count = max(5, int(np.ceil(_KNOTS * (band[1] - band[0]) / (0.5 * (band[0] + band[1])))))
    known = {
        float(w): _inverse(loop, mode, float(w), at) for w in np.linspace(*band, min(count, 33))
    }
    pending = list(zip(sorted(known)[:-1], sorted(known)[1:], strict=True))
    while pending and len(known) < _MOST_KNOTS:
        a, b = pending.pop()
        if min(known[a][1], known[b][1]) < _ANGLE:
            continue
        middle, mean = (a + b) / 2, (known[a][0] + known[b][0]) / 2
        between = min(
            sector_angle(mean @ loop.response(mode, middle, condition)) for condition in at
        )
        if between < min(known[a][1], known[b][1]) - _LOSS and b - a > 1e-3 * b:
            known[middle] = _inverse(loop, mode, middle, at)
            pending += [(a, middle), (middle, b)]
    speeds = sorted(known)
    good = [known[w][1] >= _ANGLE for w in speeds]
    parts: list[tuple[tuple[float, float], BlockTable, Forbidden | None]] = []
    for is_good, alike in groupby(range(len(speeds)), good.__getitem__):
        numbers = [*alike]
        chosen = [speeds[k] for k in numbers]
        if is_good:
            if len(chosen) > 1:
                table = BlockTable(np.array(chosen), np.array([known[w][0] for w in chosen]))
                parts.append(((chosen[0], chosen[-1]), table, None))
        else:
            ends = speeds[max(numbers[0] - 1, 0)], speeds[min(numbers[-1] + 1, len(speeds) - 1)]
            worst = min(chosen, key=lambda w: known[w][1])
            reason = f"no T converges at all pressures with {np.degrees(_ANGLE):.0f} deg to spare"
            limit = orbit_limit(loop.machine, worst)
            parts.append(
                (
                    ends,
                    BlockTable(np.array([]), np.array([])),
                    Forbidden(
                        *ends, worst, np.nan, np.nan, limit, f"{len(at)} pressures", reason=reason
                    ),
                )
            )
    return parts


def _inverse(
    loop: SynchronousLoop, mode: str, speed: float, at: Sequence[Condition]
) -> tuple[np.ndarray, float]:
    """T (a, a) at a speed for all conditions, scaled to the slowest direction, and its sector angle
    [rad].
    """
    responses = np.array([loop.response(mode, speed, condition) for condition in at])
    T = best_inverse(responses)
    slowest = float(convergence(T, responses).min())
    angle = min(sector_angle(T @ R) for R in responses)
    return (T / slowest if slowest > 0 else T), float(angle)


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
