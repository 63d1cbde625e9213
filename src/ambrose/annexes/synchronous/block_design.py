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
5. Parts in which the loop with the block is unstable or nearly so at any speed, with eps a
   twentieth of the lowest speed, are left out: near transmission zeros of what the block reads.
   The ends of a band at which the sensitivity with the block on passes its limit at any eps are
   left out.
6. eps, band by band: a third of what the exact sampled poles allow, no more than a twentieth of
   the lowest speed; T is made smaller over speed where the sensitivity with the block on would pass
   its limit, and proved again. Parts that are unstable at corners of the tolerances are left out.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ambrose.annexes.synchronous.block_checks import (
    Forbidden,
    converged_at,
    forbidden_bands,
    orbit_limit,
    unbalance_of,
    worst_orbits,
)
from ambrose.annexes.synchronous.block_gain import (
    MODE as DAMPING,
    SHARE,
    TURNS,
    clear_parts,
    damping_blocks,
    gain_limit,
    sensitive_gain,
    sensitive_table,
    usable_tables,
    within_sensitivity,
)
from ambrose.annexes.synchronous.block_loop import (
    MODES,
    BlockTable,
    Condition,
    SynchronousLoop,
    block_of,
    block_table,
    conditions,
    extreme_conditions,
    loop_pencils,
    prove_interval,
    running_table,
    synchronous_loop,
)
from ambrose.core.checks import InvalidInput, check_positive, invalid
from ambrose.core.presentation import Presented
from ambrose.core.statespace import spectral_abscissa
from ambrose.core.synchronous import sector_angle
from ambrose.law.law import LawLike
from ambrose.machine.criteria import TWO_PI
from ambrose.machine.machine import Machine
from ambrose.machine.part import SYNCHRONOUS_UPDATES, Synchronous
from ambrose.model.plant import top_speed
from ambrose.options import Rejecting

Progress = Callable[[str], None]
_LOWEST = 0.1  # of the top speed: where the band begins by default
_CLEAR = 0.9  # of the orbit's limit, which a design keeps
_EDGE = 10.0  # rad/s by which damping begins before it is needed: twice a block's hysteresis
_NARROW = 0.02  # of the whole band: a part that is narrower is left out
_SWITCHED = 12.0  # rad/s, the same: a block is switched on and off by 5 rad/s within its band
_SHARES = 1.0, 1 / 4, 1 / 16  # of a twentieth of the lowest speed, tried for eps
_LOST = 0.1  # of a band, beyond which the next one is tried


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class SynchronousDesign(Presented):
    """blocks: one for each band in which the mode may be on, in the form of a machine file.
    forbidden: the bands left out, each with its reason. angle [rad]: the smallest one proved over
    the bands, all pressures; gain [1/s]: eps, of the slowest block; gain_limit: the largest eps
    that the exact poles allow, at the speeds looked at; notes.
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
            self._angle_name: f"{np.degrees(self.angle):.1f} deg",
            "time_constant": f"{2 / self.gain:.3g} s" if self.gain else "none",
            **({"notes": self.notes} if self.notes else {}),
        }

    @property
    def left_out(self) -> tuple[str, ...]:
        """The bands left out, each with its replacement, as a sentence's part."""
        instead = {"off": "off there", "damping": "damping there"}
        return tuple(
            f"{item}; {instead.get(item.replacement, 'nothing keeps the limit there')} "
            f"({item.low / TWO_PI:.4g} to {item.high / TWO_PI:.4g} Hz)"
            for item in self.forbidden
        )

    @property
    def _angle_name(self) -> str:
        """Of mode damping nothing is proved here: its leak holds what T would not."""
        return "angle_at_knots" if self.mode == DAMPING else "proved_angle"

    def to_dict(self) -> dict[str, Any]:
        """The blocks as they stand in a file, the bands left out and the figures of the design,
        ready for JSON.
        """
        return {
            "mode": self.mode,
            "blocks": [block.to_dict() for block in self.blocks],
            "left_out": [str(item) for item in self.forbidden],
            f"{self._angle_name}_deg": float(np.degrees(self.angle)),
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
    update: str = "sample",
    rate: float | None = None,
    delay_samples: int | None = None,
    progress: Progress = lambda text: None,
) -> SynchronousDesign:
    """The synchronous blocks of a machine for a controller that holds it.

    controller: a Synthesis or a law, fixed over the speed. mode: "current-free", "force-free" or
    "vibration-free"; "damping" around a critical speed, which the design also takes by itself where
    the others are forbidden and the loop alone breaks the orbit's limit. band [rad/s]: None (not
    with damping): from a tenth of the top speed to it. time_constant [s]: 2/eps; None: as small as
    the loop allows. update: "sample", or "turn" for amplitudes that move once a turn by its mean
    (convergent control). rate [Hz], delay_samples: as for ``verify``. Raises InvalidInput where the
    loop is unstable without the block, for a time constant below what the poles allow, or where no
    band is left.
    """
    if mode not in MODES:
        raise invalid(
            "the mode of the synchronous block",
            repr(mode),
            f"one of {', '.join(MODES)}",
            "choose one of them",
        )
    if update not in SYNCHRONOUS_UPDATES:
        known = ", ".join(SYNCHRONOUS_UPDATES)
        raise invalid("update", repr(update), f"one of {known}", "choose one of them")
    if mode == DAMPING and band is None:
        raise InvalidInput(
            "damping is for the speeds around a critical speed; give them as its band"
        )
    if time_constant is not None:
        check_positive(time_constant, "time_constant", "give 2/eps in seconds")
    low, high = band_of(machine, band)
    loop, at = synchronous_loop(machine, controller, rate, delay_samples), conditions(machine)
    progress("judging the loop without the block")
    check_base_loop(loop, at, low, high)
    corners = [corner for condition in at for corner in extreme_conditions(loop, condition, high)]
    if mode == DAMPING:
        damped, g = damping_blocks(
            loop, (low, high), at, corners, _CLEAR, time_constant, update, progress
        )
        return _damping_design(loop, damped, g)
    progress(f"looking for bands in which {mode} breaks its orbit")
    left_out = list(forbidden_bands(loop, mode, (low, high), (*at, *corners), share=_CLEAR))
    notes: list[str] = []
    tables: list[tuple[tuple[float, float], BlockTable]] = []
    angle = np.pi / 2
    for part in _parts(low, high, left_out):
        progress(f"T from {part[0]:.4g} to {part[1]:.4g} rad/s")
        for inner, table, refused in usable_tables(loop, mode, part, at):
            if refused is not None:
                left_out.append(refused)
                continue
            progress(f"proving it from {inner[0]:.4g} to {inner[1]:.4g} rad/s")
            shown, proved, rest = _provable(loop, mode, inner, table, at, (high - low) * _NARROW)
            left_out += rest
            tables += [(where, table) for where in proved]
            angle = min(angle, shown) if proved else angle
    left_out.sort(key=lambda item: item.low)
    _check_left(tables, left_out, mode, "choose another mode or band")
    progress("the speeds at which the loop is nearest to instability")
    narrow = max((high - low) * _NARROW, _SWITCHED)
    clear: list[tuple[tuple[float, float], BlockTable]] = []
    most: dict[tuple[float, float], float] = {}
    for where, table in tables:
        for share in _SHARES if time_constant is None else (1.0,):
            eps = share * (TURNS * where[0] if time_constant is None else 2 / time_constant)
            parts, rest = clear_parts(loop, mode, where, table, at, eps, narrow, update)
            # a smaller eps comes nearer to what it is kept clear of
            if sum(item.high - item.low for item in rest) <= _LOST * (where[1] - where[0]):
                break
        clear += [(part, table) for part in parts]
        most |= {part: eps for part in parts}
        left_out += rest
    tables = clear
    _check_left(tables, left_out, mode, "choose another mode or band")
    progress("the sensitivity beside the speed")
    tables, trimmed = within_sensitivity(loop, mode, tables, at)
    left_out = sorted([*left_out, *trimmed], key=lambda item: item.low)
    remedy = "lower the sensitivity without a block first, or choose another band"
    _check_left(tables, left_out, mode, remedy)
    progress("the largest eps")
    limits = [gain_limit(loop, mode, where, table, at, update) for where, table in tables]
    limit = min(limits)
    sized: list[tuple[tuple[float, float], float, BlockTable]] = []
    if time_constant is not None:
        if 2 / time_constant > limit:
            least = f"at least {2 / limit:.3g} s, where the exact poles become unstable"
            raise invalid(
                "time_constant", f"{time_constant:g} s", least, "give a longer one, or leave it out"
            )
        sized = [(where, 2 / time_constant, table) for where, table in tables]
    else:
        for (where, table), own in zip(tables, limits, strict=True):
            middle = (where[0] + where[1]) / 2
            cleared = (eps for (a, b), eps in most.items() if a <= middle <= b)
            largest = min(SHARE * own, TURNS * where[0], *cleared)
            best, smaller, words = sensitive_table(loop, mode, where, table, at, largest)
            shown, proved, _ = _provable(loop, mode, where, smaller, at, narrow)
            if len(proved) == 1 and proved[0] == where:
                angle = min(angle, shown)
                notes += [words] if words else []
                sized.append((where, best, smaller))
            else:
                # what a size that changes between two T turned is not proved: one size
                small, note = sensitive_gain(loop, mode, [(where, table)], at, largest)
                notes += note
                sized.append((where, small, table))
    progress("the same over the tolerances")
    checked: list[tuple[tuple[float, float], float, BlockTable]] = []
    for where, eps, table in sized if corners else []:
        parts, rest = clear_parts(
            loop, mode, where, table, corners, eps, narrow, update, members=True
        )
        checked += [(part, eps, table) for part in parts]
        left_out += rest
    sized = checked if corners else sized
    left_out.sort(key=lambda item: item.low)
    _check_left(sized, left_out, mode, "choose another mode or band")
    gain = min(eps for _, eps, _ in sized)
    blocks = tuple(
        block_of(mode, where, 2 / eps, table, update=update) for where, eps, table in sized
    )

    # where neither the block nor the loop alone keeps the orbit: damping, if it can
    pieces: list[Forbidden] = []
    for whole in left_out:
        for item in _off_or_nothing(loop, whole, at):
            pieces.append(item)
            if item.replacement:
                continue
            # from before it is needed, within the band that the other blocks leave
            wide = max(whole.low, item.low - _EDGE), min(whole.high, item.high + _EDGE)
            try:
                damped, g = damping_blocks(
                    loop, wide, at, corners, _CLEAR, time_constant, update, progress
                )
            except InvalidInput as reason:
                notes.append(f"{item.low:.4g} to {item.high:.4g} rad/s: {reason}")
                continue
            pieces[-1] = replace(item, replacement=DAMPING)
            blocks = tuple(sorted((*blocks, *damped), key=lambda block: block.band))
            notes.append(_damping_in_words(machine, *wide, g))
    return SynchronousDesign(
        machine,
        mode,
        blocks,
        tuple(pieces),
        float(angle),
        float(gain),
        float(limit),
        tuple(notes),
    )


def _check_left(left: Sequence[Any], left_out: Sequence[Forbidden], mode: str, remedy: str) -> None:
    """Raises InvalidInput where no band is left."""
    if not left:
        why = "; ".join(str(item) for item in left_out)
        raise InvalidInput(f"no band is left in which {mode} may be on: {why}; {remedy}")


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
                "first design a controller that stabilises the machine there (ambrose synthesize)",
            )


def band_of(machine: Machine, band: tuple[float, float] | None) -> tuple[float, float]:
    """The band of a block [rad/s]: as given, else from a tenth of the top speed to it. Raises
    InvalidInput for one that the machine never turns in.
    """
    machine.across_the_shaft("a synchronous block is for what turns with the rotor")
    top = top_speed(machine)
    if not top:
        raise InvalidInput("the machine does not turn; give its [operation] a speed_range")
    low, high = (_LOWEST * top, top) if band is None else band
    if not 0 < low < high <= top * (1 + 1e-9):
        raise invalid(
            "the band of the synchronous block",
            f"{low:g} to {high:g} rad/s",
            f"ascending, above 0, and at most the top speed of {top:.6g} rad/s",
            "correct it, or the speed_range of [operation]",
        )
    return low, high


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
    """
    waiting = [band]
    proved = []
    rest = []
    angle = np.pi / 2
    pencils = [loop_pencils(loop, condition, *band, mode=mode) for condition in at]
    drive = running_table(table, loop, mode)
    while waiting:
        low, high = waiting.pop()
        if high - low < narrow:
            continue
        failed, smallest = None, np.pi / 2
        for item in pencils:
            shown = prove_interval(item, drive.at, [float(w) for w in table.speeds], low, high)
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
        reason = "Herm(T S) > 0 is not proved at this speed"
        rest.append(
            Forbidden(
                *ends, failed, np.nan, np.nan, limit, "with the T of the design", reason=reason
            )
        )
        waiting += [(low, ends[0]), (ends[1], high)]
    return angle, sorted(proved), rest


def _damping_design(
    loop: SynchronousLoop, blocks: tuple[Synchronous, ...], g: float
) -> SynchronousDesign:
    """Blocks of mode damping by themselves, with the smallest sector angle at their knots."""
    at = conditions(loop.machine)
    angle = min(
        sector_angle(T @ loop.response(DAMPING, float(w), condition))
        for block in blocks
        for w, T in zip(*block.table(len(loop.axes)), strict=True)
        for condition in at
    )
    low, high = blocks[0].band[0], blocks[-1].band[1]
    limit = min(
        gain_limit(loop, DAMPING, block.band, block_table(block, loop.machine), at, block.update)
        for block in blocks
    )
    return SynchronousDesign(
        loop.machine,
        DAMPING,
        blocks,
        (),
        float(angle),
        blocks[0].gain,
        float(limit),
        (_damping_in_words(loop.machine, low, high, g),),
    )


def _damping_in_words(machine: Machine, low: float, high: float, g: float) -> str:
    where = ", at the pressure that T fits best" if machine.seals else ""
    return (
        f"damping from {low:.4g} to {high:.4g} rad/s: 1x falls to {1 / (1 + g):.0%} of what it is "
        f"without{where}"
    )


def _off_or_nothing(
    loop: SynchronousLoop, item: Forbidden, at: Sequence[Condition]
) -> list[Forbidden]:
    """A band left out, cut where the loop by itself begins to break the orbit's limit: "off" where
    it keeps it, nothing where it does not.
    """
    residual = unbalance_of(loop.machine)
    broken = forbidden_bands(loop, None, (item.low, item.high), at)
    edges = sorted({item.low, item.high, *(edge for b in broken for edge in (b.low, b.high))})
    pieces = []
    for low, high in itertools.pairwise(edges):
        own = [b for b in broken if b.low <= (low + high) / 2 <= b.high]
        # the loop's own orbit where it is worst in the piece, as far as it is known
        speed = own[0].worst if own else min(max(item.worst, low), high)
        alone = max(
            worst_orbits(converged_at(loop, None, speed, condition).q, float(residual.force(speed)))
            for condition in at
        )
        pieces.append(
            replace(item, low=low, high=high, without=alone, replacement="" if own else "off")
        )
    return pieces


def check_request(asked: Rejecting, method: str, machine: Machine) -> None:
    """What can be refused of a block that is asked for beside a design, before that. Raises
    InvalidInput.
    """
    if method == "lpv":
        raise invalid(
            "synchronous",
            asked.synchronous,
            "left out with the method lpv",
            "give a controller fixed over speed",
        )
    if asked.synchronous == DAMPING and asked.synchronous_band is None:
        raise InvalidInput(
            "synchronous damping is for the speeds around a critical speed; give them with "
            "synchronous_band (--synchronous-band)"
        )
    band_of(machine, asked.synchronous_band)
