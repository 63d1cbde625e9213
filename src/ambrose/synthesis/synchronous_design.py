"""Design of a synchronous block: T over speed, the bands in which it may be on, and its time
constant.

1. The loop as it runs has to be stable without the block, at every operating point and at every
   pressure of them over the whole band; nothing added to an unstable loop is a block against
   unbalance.
2. Bands in which the mode breaks its orbit, once converged, are found and left out (``bands``),
   with the tolerances at corners of their box as well.
3. T(W) = R(W)^-1 for all pressures at once (``core.synchronous.best_inverse``), scaled so that the
   slowest direction of the worst pressure converges with 2/eps; knots are added where T between two
   is not as good.
4. Herm(T S) > 0 is tried over every band that is left, between the speeds as well; the part in
   which it cannot be shown is left out, too, and named.
5. The ends of a band at which the sensitivity with the block on passes its limit at any eps are
   left out.
6. eps: a third of what the exact sampled poles allow, no more than a twentieth of the lowest speed,
   and as small as it takes for the sensitivity with the block on to keep its limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.presentation import Presented
from ambrose.core.statespace import select, spectral_abscissa
from ambrose.core.synchronous import best_inverse, convergence, largest_gain, sector_angle
from ambrose.judge.synchronous_bands import (
    Forbidden,
    converged_at,
    forbidden_bands,
    orbit_limit,
    unbalance_of,
    worst_orbits,
)
from ambrose.judge.synchronous_sensitivity import sensitivity_peak
from ambrose.law.law import LawLike
from ambrose.law.synchronous import (
    MODES,
    Condition,
    SynchronousLoop,
    conditions,
    extreme_conditions,
    synchronous_loop,
)
from ambrose.law.synchronous_pencils import loop_pencils, prove_interval
from ambrose.law.synchronous_table import BlockTable, block_of
from ambrose.machine.criteria import TWO_PI, demand
from ambrose.machine.machine import Machine
from ambrose.machine.synchronous import Synchronous
from ambrose.model.plant import top_speed

Progress = Callable[[str], None]
_LOWEST = 0.1  # of the top speed: where the band begins by default
_CLEAR = 0.9  # of the orbit's limit, which a design keeps
_KNOTS, _MOST_KNOTS = 17, 97
_ANGLE = np.radians(15.0)  # below which no T is offered
_LOSS = np.radians(5.0)  # by which T between two knots may be worse than at them
_SHARE = 1 / 3  # of the largest stable eps
_TURNS = 1 / 20  # eps over the lowest speed of a band, at most
_GAIN_SPEEDS = 3  # of each band, at which eps is bounded
_NARROW = 0.02  # of the whole band: a part that is narrower is left out
_BISECTIONS = 5  # of eps, and of a band's end, for the sensitivity
_TINY = 1e-5  # of the speed: an eps as small as any


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SynchronousDesign(Presented):
    """blocks: one for each band in which the mode may be on, in the form of a machine file.
    forbidden: the bands left out, each with its reason. angle [rad]: the smallest one proved over
    the bands, all pressures; gain [1/s]: eps; gain_limit: the largest eps that the exact poles
    allow, at the speeds looked at; notes.
    """

    machine: Machine
    mode: str
    blocks: tuple[Synchronous, ...]
    forbidden: tuple[Forbidden, ...]
    angle: float
    gain: float
    gain_limit: float
    notes: tuple[str, ...] = ()

    def facts(self) -> Mapping[str, Any]:
        """Mode, bands, margin and time constant."""
        return {
            "mode": self.mode,
            "bands": [
                f"{low:.4g} to {high:.4g} rad/s"
                for low, high in (block.band for block in self.blocks)
            ],
            "left_out": [str(item) for item in self.forbidden],
            "proved_angle": f"{np.degrees(self.angle):.1f} deg",
            "time_constant": f"{2 / self.gain:.3g} s" if self.gain else "none",
            **({"notes": self.notes} if self.notes else {}),
        }

    def to_dict(self) -> dict[str, Any]:
        """The blocks as they stand in a file, the bands left out and the figures of the design,
        ready for JSON.
        """
        return {
            "mode": self.mode,
            "blocks": [block.to_dict() for block in self.blocks],
            "left_out": [str(item) for item in self.forbidden],
            "proved_angle_deg": float(np.degrees(self.angle)),
            "time_constant_s": 2 / self.gain if self.gain else None,
            "gain_limit_1_s": self.gain_limit,
            "notes": list(self.notes),
        }


def design_synchronous(
    machine: Machine,
    controller: LawLike,
    mode: str = "current-free",
    *,
    band: tuple[float, float] | None = None,
    time_constant: float | None = None,
    rate: float | None = None,
    delay_samples: int | None = None,
    progress: Progress = lambda text: None,
) -> SynchronousDesign:
    """The synchronous blocks of a machine for a controller that holds it.

    controller: a Synthesis or a law, fixed over the speed. mode: "current-free", "force-free" or
    "vibration-free"; "damping" is chosen by the design where those are forbidden. band [rad/s]:
    None: from a tenth of the top speed to it. time_constant [s]: 2/eps; None: as small as the loop
    allows. rate [Hz], delay_samples: as for ``verify``. Raises InvalidInput where the loop is
    unstable without the block, for a time constant below what the poles allow, or where no band is
    left.
    """
    if mode not in MODES or mode == "damping":
        known = ", ".join(MODES[:3])
        raise invalid(
            "the mode of the synchronous block", repr(mode), f"one of {known}", "choose one of them"
        )
    if time_constant is not None:
        check_positive(time_constant, "time_constant", "give 2/eps in seconds")
    top = top_speed(machine)
    if not top:
        raise InvalidInput("the machine does not turn; give its [operation] a speed_range")
    low, high = (_LOWEST * top, top) if band is None else band
    if not 0 < low < high:
        raise invalid(
            "the band",
            f"{low:g} to {high:g} rad/s",
            "ascending, above 0",
            "give lowest and highest speed",
        )
    loop, at = synchronous_loop(machine, controller, rate, delay_samples), conditions(machine)
    progress("judging the loop without the block")
    check_base_loop(loop, at, low, high)
    progress(f"looking for bands in which {mode} breaks its orbit")
    corners = [corner for condition in at for corner in extreme_conditions(loop, condition, high)]
    left_out = list(forbidden_bands(loop, mode, (low, high), (*at, *corners), share=_CLEAR))
    notes: list[str] = []
    tables: list[tuple[tuple[float, float], BlockTable]] = []
    angle = np.pi / 2
    for part in _parts(low, high, left_out):
        progress(f"T from {part[0]:.4g} to {part[1]:.4g} rad/s")
        for inner, table, refused in _usable(loop, mode, part, at):
            if refused is not None:
                left_out.append(refused)
                continue
            progress(f"proving it from {inner[0]:.4g} to {inner[1]:.4g} rad/s")
            shown, proved, rest = _provable(loop, mode, inner, table, at, (high - low) * _NARROW)
            left_out += rest
            tables += [(where, table) for where in proved]
            angle = min(angle, shown) if proved else angle
    left_out = [_replaced(loop, item) for item in sorted(left_out, key=lambda item: item.low)]
    if not tables:
        why = "; ".join(str(item) for item in left_out)
        raise InvalidInput(
            f"no band is left in which {mode} may be on: {why}; choose another mode or band"
        )
    progress("the sensitivity beside the speed")
    tables, trimmed = _within_sensitivity(loop, mode, tables, at)
    left_out = sorted([*left_out, *trimmed], key=lambda item: item.low)
    if not tables:
        why = "; ".join(str(item) for item in left_out)
        raise InvalidInput(
            f"no band is left in which {mode} may be on: {why}; lower the sensitivity without a "
            "block first, or choose another band"
        )
    progress("the largest eps")
    limit = min(_gain_limit(loop, mode, where, table, at) for where, table in tables)
    gain = min(_SHARE * limit, _TURNS * min(where[0] for where, _ in tables))
    if time_constant is not None:
        if 2 / time_constant > limit:
            least = f"at least {2 / limit:.3g} s, where the exact poles become unstable"
            raise invalid(
                "time_constant", f"{time_constant:g} s", least, "give a longer one, or leave it out"
            )
        gain = 2 / time_constant
    else:
        gain, note = _sensitive_gain(loop, mode, tables, at, gain)
        notes += note
    blocks = tuple(block_of(mode, where, 2 / gain, table) for where, table in tables)
    return SynchronousDesign(
        machine,
        mode,
        blocks,
        tuple(left_out),
        float(angle),
        float(gain),
        float(limit),
        tuple(notes),
    )


def check_base_loop(
    loop: SynchronousLoop, at: Sequence[Condition], low: float, high: float
) -> None:
    """Raises InvalidInput where the sampled loop is unstable without a block, at an operating point
    or along the band.
    """
    machine = loop.machine
    places = [(point.speed, Condition(point.seal_pressure)) for point in machine.operation.envelope]
    places += [(float(w), condition) for condition in at for w in np.linspace(low, high, 3)]
    for speed, condition in dict.fromkeys(places):
        abscissa = spectral_abscissa(loop.sampled(speed, condition))
        if not abscissa < 0:
            raise invalid(
                f"the slowest pole without a synchronous block at {speed:.4g} rad/s, "
                f"{condition.label}",
                f"{abscissa:+.4g} rad/s, {loop.timing}",
                "negative",
                "design a controller that holds the machine there first (ambrose synthesize)",
            )


def _parts(low: float, high: float, left_out: Sequence[Forbidden]) -> list[tuple[float, float]]:
    """What is left of a band without the bands that were left out."""
    parts, start = [], low
    for item in sorted(left_out, key=lambda item: item.low):
        if item.low > start:
            parts.append((start, item.low))
        start = max(start, item.high)
    if start < high:
        parts.append((start, high))
    least = _NARROW * (high - low)
    return [part for part in parts if part[1] - part[0] > least]


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


def _usable(
    loop: SynchronousLoop, mode: str, band: tuple[float, float], at: Sequence[Condition]
) -> list[tuple[tuple[float, float], BlockTable, Forbidden | None]]:
    """The parts of a band in which one T converges at all conditions with ``_ANGLE`` to spare, with
    their tables; and those in which none was found.
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
    k = 0
    while k < len(speeds):
        end = k
        while end + 1 < len(speeds) and good[end + 1] == good[k]:
            end += 1
        if good[k]:
            if end > k:
                chosen = speeds[k : end + 1]
                table = BlockTable(np.array(chosen), np.array([known[w][0] for w in chosen]))
                parts.append(((chosen[0], chosen[-1]), table, None))
        else:
            ends = speeds[max(k - 1, 0)], speeds[min(end + 1, len(speeds) - 1)]
            worst = min(speeds[k : end + 1], key=lambda w: known[w][1])
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
        k = end + 1
    return parts


def _provable(
    loop: SynchronousLoop,
    mode: str,
    band: tuple[float, float],
    table: BlockTable,
    at: Sequence[Condition],
    narrow: float,
) -> tuple[float, list[tuple[float, float]], list[Forbidden]]:
    """The smallest angle proved, the parts of a band in which Herm(T S) > 0 is proved at all
    conditions, and the rest.

    Modes other than current-free are judged at their knots and between them alone (no interval
    proof).
    """
    if mode != "current-free":
        angles = [
            sector_angle(table.at(w) @ loop.response(mode, w, condition))
            for condition in at
            for w in np.linspace(*band, 2 * len(table.speeds) + 1)
        ]
        return min(angles), [band], []
    waiting = [band]
    proved = []
    rest = []
    angle = np.pi / 2
    pencils = [loop_pencils(loop, condition, *band) for condition in at]
    while waiting:
        low, high = waiting.pop()
        if high - low < narrow:
            continue
        failed, smallest = None, np.pi / 2
        for item in pencils:
            shown = prove_interval(item, table.at, [float(w) for w in table.speeds], low, high)
            if not shown.proved:
                failed = shown.failed
                break
            smallest = min(smallest, shown.angle)
        if failed is None:
            proved.append((low, high))
            angle = min(angle, smallest)
            continue
        gap = 0.01 * (band[1] - band[0])
        ends = max(low, failed - gap), min(high, failed + gap)
        limit = orbit_limit(loop.machine, failed)
        reason = "Herm(T S) > 0 is not proved there"
        rest.append(
            Forbidden(
                *ends, failed, np.nan, np.nan, limit, "with the T of the design", reason=reason
            )
        )
        waiting += [(low, ends[0]), (ends[1], high)]
    return angle, sorted(proved), rest


def _gain_limit(
    loop: SynchronousLoop,
    mode: str,
    band: tuple[float, float],
    table: BlockTable,
    at: Sequence[Condition],
) -> float:
    """The largest eps [1/s] with stable exact poles at a few speeds of a band, all conditions."""
    limit = np.inf
    for speed in np.linspace(*band, _GAIN_SPEEDS):
        for condition in at:
            closed = select(loop.sampled(speed, condition), None, loop.reads(mode))
            T = table.at(speed) @ loop.weights(mode, speed, condition)
            limit = min(
                limit, largest_gain(closed, T, loop.harmonic * speed, min(limit, speed), 0.05)
            )
    return float(limit)


def _allowed(loop: SynchronousLoop, mode: str, speed: float, condition: Condition) -> float:
    """The sensitivity of an axis that a block has to keep: its limit, or what it is without, and
    5 %.
    """
    limit = demand("sensitivity of an axis", loop.machine.requirements).limit or 3.0
    return max(limit, 1.05 * sensitivity_peak(loop, mode, speed, condition, None, 0.0)[0])


def _within_sensitivity(
    loop: SynchronousLoop,
    mode: str,
    tables: Sequence[tuple[tuple[float, float], BlockTable]],
    at: Sequence[Condition],
) -> tuple[list[tuple[tuple[float, float], BlockTable]], list[Forbidden]]:
    """The bands without the ends at which the sensitivity beside the speed passes its limit at any
    eps, and those ends.

    |S| beside the speed grows by 1/sin(angle), however small eps is: judged with an eps of 1e-5 of
    the speed at the ends and in the middle; an end that fails is moved inwards by bisection.
    """

    def holds(speed: float, table: BlockTable) -> bool:
        return all(
            sensitivity_peak(loop, mode, speed, condition, table.at(speed), _TINY * speed)[0]
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


def _sensitive_gain(
    loop: SynchronousLoop,
    mode: str,
    tables: Sequence[tuple[tuple[float, float], BlockTable]],
    at: Sequence[Condition],
    gain: float,
) -> tuple[float, list[str]]:
    """eps lowered until the sensitivity at the ends of the bands keeps its limit, or what it is
    without, and 5 %.
    """
    places = [(w, table, condition) for where, table in tables for w in where for condition in at]
    allowed = {(w, condition): _allowed(loop, mode, w, condition) for w, _, condition in places}

    def holds(trial: float) -> bool:
        return all(
            sensitivity_peak(loop, mode, w, condition, table.at(w), trial)[0]
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


def _replaced(loop: SynchronousLoop, item: Forbidden) -> Forbidden:
    """A band left out with what to do there: off where the loop by itself keeps the limit."""
    force = float(unbalance_of(loop.machine).force(item.worst))
    alone = max(
        worst_orbits(converged_at(loop, None, item.worst, condition).q, force)
        for condition in conditions(loop.machine)
    )
    return replace(item, without=alone, replacement="off" if alone <= item.limit else "")


def in_words(item: Forbidden) -> str:
    """A band left out, with its replacement, as a sentence's part."""
    instead = {"off": "off there", "damping": "damping there"}.get(
        item.replacement, "nothing keeps the limit there"
    )
    return f"{item}; {instead} ({item.low / TWO_PI:.4g} to {item.high / TWO_PI:.4g} Hz)"


def check_request(
    synchronous: str | None, method: str, given: Mapping[str, Any], name: str = "synchronous"
) -> None:
    """What can be refused of a block that is asked for beside a design. given: the other options
    by name, None where left out; name: what the block's own option is called. Raises InvalidInput.
    """
    for option, value in given.items():
        if value is not None and synchronous is None:
            raise invalid(option, "given", f"given with {name}", f"add {name} current-free")
    if synchronous is None:
        return
    if method == "lpv":
        raise invalid(
            name,
            synchronous,
            "left out with the method lpv",
            "give a controller fixed over speed",
        )
    if synchronous not in MODES[:3]:
        raise invalid(
            name, repr(synchronous), f"one of {', '.join(MODES[:3])}", "choose one of them"
        )
    for option, value in given.items():
        if option.endswith("time") and value is not None:
            check_positive(value, option, "give 2/eps in seconds")
