"""The block's behaviour in Python, sample by sample: the generated code is compared with it, test
vectors come from it.
"""

import csv
import io
from dataclasses import dataclass, field
from functools import singledispatch
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import (
    BEHIND,
    CLAMPED,
    FAULT,
    HELD,
    LATCHED,
    LIMITED,
    REASON_AT,
    STATE_AT,
    TOLD,
    TOLD_SECOND,
    Block,
    ControlBlock,
)
from ambrose.code.block.cascade import FixedCascade
from ambrose.code.block.fixed_point import FixedBlock, Words
from ambrose.code.block.scheduled import ScheduledBlock, SupervisedBlock, supervised_twin
from ambrose.core.checks import InvalidInput, check_shape
from ambrose.core.scheduled import corners

FLOOR = {"double": 1e-200, "float": 1e-30}  # a state below it is zero: no denormal numbers linger


@dataclass(frozen=True, slots=True, eq=False)
class BlockRun:
    """currents (k, p) [A] (whole numbers for fixed point), status (k,), the states after the last
    sample (n,) and the largest magnitude of each on the way (n,); schedule (k,), of two parameters
    (k, 2): where a scheduled law was taken (fixed: None).
    """

    currents: np.ndarray
    status: np.ndarray
    states: np.ndarray
    largest: np.ndarray
    schedule: np.ndarray | None = None


class Steps:
    """A law sample by sample, of errors that are plausible. x (n,): its states; limited: whether
    the last step cut a current; known: of the status (k,), what is known before from what it is
    told; schedule (k,) or (k, 2): where a scheduled law is taken.
    """

    x: np.ndarray
    limited = False
    known: np.ndarray | int = 0
    schedule: np.ndarray | None = None

    @property
    def bits(self) -> int:
        """What the last step adds to the status."""
        return LIMITED * self.limited

    def step(self, e: np.ndarray) -> np.ndarray:
        """Currents (p,) [A] from errors (m,) [m]; of whole numbers both in counts."""
        raise NotImplementedError


def run_of(
    law: Block | Words,
    errors: ArrayLike,
    told: ArrayLike | None = None,
    valid: ArrayLike | None = None,
    start: ArrayLike | None = None,
    single: bool = False,
) -> BlockRun:
    """A block in double precision, or in words bit by bit, from the start of the code.

    errors (k, m) [m], NaN and infinity allowed, of words whole numbers of 2^-signal_bits
    error_limit (the currents likewise); told: of a scheduled block speeds [rad/s] or pressures [Pa]
    (k,) or both (k, 2), of a supervised one (k, 3) [Pa], readings, estimates, their half widths,
    NaN and infinity allowed; valid (k, m): the channels' flags (None: all true); start (n,): the
    states before the first sample (None: zero; neither of words nor of a supervised block). single:
    of a scheduled block, computed in single precision. Raises InvalidInput.
    """
    e, good = usable(law, errors, valid)
    e, status = hold_last(e, good, law.base.hold_samples)
    steps = steps_of(law, told_of(law.base, told, len(e)), start, single)
    status = status | steps.known
    currents, largest = np.empty((len(e), len(law.base.outputs)), law.number), np.abs(steps.x)
    # products in single precision may raise the flag for an invalid value in lanes of a vector
    # register that hold no number of theirs: seen once, of laws without such a value; a real one is
    # a NaN among the currents
    with np.errstate(invalid="ignore" if single else "warn"):
        for k in range(len(e)):
            currents[k] = steps.step(e[k])
            status[k] |= steps.bits
            largest = np.maximum(largest, np.abs(steps.x))
    states, largest = steps.x.astype(law.number), largest.astype(law.number)
    return BlockRun(currents, status, states, largest, steps.schedule)


def told_of(block: Block, told: ArrayLike | None, count: int) -> np.ndarray | None:
    """What a block is told as an array of its shape. Raises InvalidInput."""
    if not block.told:
        return None
    found, size = np.asarray(told, float), (count, len(block.told))[: len(block.told)]
    if found.shape != size:
        raise InvalidInput(
            f"the shape of the measured parameters ({', '.join(block.told)}) is {found.shape}, "
            f"but must be {size}, one for every sample"
        )
    return found


@singledispatch
def steps_of(
    law: Block | Words,
    told: np.ndarray | None = None,
    start: ArrayLike | None = None,
    single: bool = False,
) -> Steps:
    """A law at its first sample; arguments as of ``run_of``."""
    raise NotImplementedError


@steps_of.register(ControlBlock)
class FixedSteps(Steps):
    """A fixed block."""

    def __init__(
        self,
        block: ControlBlock,
        told: None = None,
        start: ArrayLike | None = None,
        single: bool = False,
    ) -> None:
        self.block = block
        self.x = np.zeros(block.n_states) if start is None else np.array(start, dtype=float)
        self._carry = np.zeros(block.winding)

    def step(self, e: np.ndarray) -> np.ndarray:
        u, step = self.block.respond(e, self.x)
        given = np.minimum(np.maximum(u, -self.block.current_limit), self.block.current_limit)

        # anti-windup: unwind (us - u), on the first states alone
        cut = given - u
        self.limited = bool(cut.any())
        if self.limited:
            w = len(self._carry)
            step[:w] += self.block.unwind[:w] @ cut
        self.x = _add_compensated(self.x, step, self._carry, FLOOR["double"])
        return given


@steps_of.register(ScheduledBlock)
class ScheduledSteps(Steps):
    """A scheduled block."""

    def __init__(
        self,
        block: ScheduledBlock,
        told: np.ndarray,
        start: ArrayLike | None = None,
        single: bool = False,
    ) -> None:
        kind: Any = np.float32 if single else np.float64
        schedule, self.known = follow_told(block, told)
        self.schedule, self._k = schedule, 0
        self.x = np.zeros(block.n_states, kind) if start is None else np.array(start, dtype=kind)
        self._carry, self._floor = np.zeros_like(self.x), FLOOR["float" if single else "double"]

        # grid points of the cell and their shares, sample by sample
        index, share = corners(block.axes, schedule.reshape(len(schedule), len(block.axes)))
        self._index, self._share = index, share.astype(kind)

        # [A - I, B] and [C, D] act on z = (x, e), interpolated: sum of share_i M_i z
        self._to_state = np.concatenate([block.increment, block.B], axis=2).astype(kind)
        self._to_current = np.concatenate([block.C, block.D], axis=2).astype(kind)
        self._unwind, self._limit = block.unwind.astype(kind), block.current_limit.astype(kind)

    def step(self, e: np.ndarray) -> np.ndarray:
        k, self._k = self._k, self._k + 1
        z = np.concatenate([self.x, e.astype(self.x.dtype)])
        at = list(zip(self._index[k], self._share[k], strict=True))
        u = sum(self._to_current[i] @ (part * z) for i, part in at)
        given = np.minimum(np.maximum(u, -self._limit), self._limit)

        # step, and anti-windup where a current is limited
        cut = given - u
        step = sum(self._to_state[i] @ (part * z) for i, part in at)
        self.limited = bool(cut.any())
        if self.limited:
            step = step + sum(self._unwind[i] @ (part * cut) for i, part in at)
        self.x = _add_compensated(self.x, step, self._carry, self._floor)
        return np.asarray(given)


@steps_of.register(SupervisedBlock)
class SupervisedSteps(Steps):
    """A schedule and the fixed controller that takes over, whoever is in charge. x (n,): the
    states of the schedule.
    """

    def __init__(
        self,
        block: SupervisedBlock,
        told: np.ndarray,
        start: ArrayLike | None = None,
        single: bool = False,
    ) -> None:
        self.twin = supervised_twin(block, np.float32 if single else np.float64)
        self.x, self._told = self.twin.states, iter(told.tolist())

    @property
    def bits(self) -> int:
        found = self.twin.supervisor
        return (
            LIMITED * int(self.twin.limited)
            | found.state << STATE_AT
            | found.fault << REASON_AT
            | LATCHED * int(found.latched)
        )

    def step(self, e: np.ndarray) -> np.ndarray:
        value, *estimate = next(self._told)
        self.twin.estimate = estimate[0], estimate[1]
        self.twin.schedule(value)
        given = self.twin.step(e.astype(self.twin.laws.limit.dtype))
        self.x = self.twin.states
        return given


def _add_compensated(
    x: np.ndarray, step: np.ndarray, carry: np.ndarray, floor: float
) -> np.ndarray:
    """x + step (n,); ``carry`` keeps what the sums of the first states lost (Kahan 1965) for the
    next sample.
    """
    w = len(carry)

    # what the last sums lost is added first; what this one loses is step - (total - x)
    step[:w] += carry
    total = x + step
    carry[:] = step[:w] - (total[:w] - x[:w])

    # a state that decays would end in denormal numbers: zero below the floor
    total[np.abs(total) < floor] = 0.0
    return total


def follow_told(block: ScheduledBlock, told: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the schedule stands for values (k,) as measured, or (k, 2) of both, and the status (k,)
    of them alone.
    """
    columns = told.reshape(len(told), -1).T
    each = zip(
        block.axes, columns, block.told_limits, block.told_steps, (TOLD, TOLD_SECOND), strict=False
    )
    found = [_follow_one(*item, block.hold_samples) for item in each]
    places, status = (np.array(part) for part in zip(*found, strict=True))
    return places.T.reshape(told.shape), np.bitwise_or.reduce(status)


def _follow_one(
    axis: np.ndarray, told: np.ndarray, limit: float, step: float, bit: int, hold: int
) -> tuple[np.ndarray, np.ndarray]:
    low, high = float(axis[0]), float(axis[-1])
    with np.errstate(invalid="ignore"):
        good = np.abs(told) <= limit
    known, status = hold_last(told[:, None], good[:, None], hold)
    status = np.where(good, 0, status | bit)
    first = int(np.argmax(good)) if good.any() else len(good)
    known = known[:, 0].astype(float)
    known[:first] = low  # nothing is known yet
    target = np.clip(known, low, high)
    status |= np.where(known != target, CLAMPED, 0)
    if not np.isfinite(step):
        return target, status

    # it moves by at most step a sample; the first known value is taken at once
    place, at = np.empty(len(target)), low
    for k, wanted in enumerate(target.tolist()):
        if k > first and abs(wanted - at) > step:
            at += step if wanted > at else -step
            status[k] |= BEHIND
        else:
            at = wanted
        place[k] = at
    return place, status


class _Whole(Steps):
    """A block in whole numbers. Shifts come with half a unit for rounding: of a state to a word, of
    sums to outputs and to states.
    """

    def __init__(self, fixed: Words) -> None:
        n, s = fixed.block.n_states, fixed.signal_bits
        self.words, self.x = fixed, np.zeros(n, np.int64)
        self._one, self._most = 1 << s, 1 << fixed.state_bits
        self._to_signal, self._to_state = _half(fixed.state_bits - s, n), _half(fixed.update_shift)
        self._to_output, self._to_cut = _half(fixed.output_bits), _half(fixed.cut_bits)
        self._to_unwinding = _half(fixed.unwind_bits + s - fixed.state_bits)

    def step(self, e: np.ndarray) -> np.ndarray:
        # currents and their limit
        signals, step = self._follow(e)
        u = _shift(self.words.output @ signals, *self._to_output)
        given = np.minimum(np.maximum(u, -self._one), self._one)

        # states: increment and, where limited, the unwinding; both have state_bits
        self.limited = bool((given != u).any())
        if self.limited:
            cut = _shift(given - u, *self._to_cut)
            step = step + _shift(self.words.unwind @ cut, *self._to_unwinding)
        self.x = np.minimum(np.maximum(self.x + step, -self._most), self._most)
        return given

    def _follow(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The signals that the currents are sums of, and the states' increments (n,)."""
        raise NotImplementedError


@steps_of.register(FixedBlock)
class WordSteps(_Whole):
    """A block in modal form."""

    def __init__(self, fixed: FixedBlock, *rest: object) -> None:
        super().__init__(fixed)
        self._update = fixed.update

    def _follow(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        z = np.concatenate([_shift(self.x, *self._to_signal), e])
        return z, _shift(self._update @ z, *self._to_state)


@steps_of.register(FixedCascade)
class CascadeSteps(_Whole):
    """A cascade."""

    def __init__(self, fixed: FixedCascade, *rest: object) -> None:
        super().__init__(fixed)
        self.fixed = fixed
        # what shifts cut off channels' inputs (c,) and increments (n,), for the next sample
        self._kept, self._rest = np.zeros(len(fixed.block.into), np.int64), 0 * self.x
        self._to_input, self._to_section = _half(fixed.into_bits), _half(fixed.section_bits)

    def _follow(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # increments with the fraction saved
        at, sums = self._sections(self._mixed(e))
        sums += self._rest
        step = _shift(sums, *self._to_state)
        self._rest = sums - (step << self.fixed.update_shift)
        return at, step

    def _mixed(self, e: np.ndarray) -> np.ndarray:
        """v = into e, with the fraction saved."""
        fixed, one = self.fixed, self._one
        if not fixed.block.mixes:
            return e
        total = fixed.into @ e + self._kept
        v = _shift(total, *self._to_input)
        # without states nothing is kept
        self._kept = (total - (v << fixed.into_bits)) * (fixed.block.n_states > 0)
        return np.clip(v, -one, one)

    def _sections(self, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Section by section (y, x1 step, x2 step) from (v, x1, x2), y saturated."""
        x, at = _shift(self.x, *self._to_signal), v.copy()
        i = 0
        sums = np.empty(len(self.x), np.int64)
        for j, stage in enumerate(self.fixed.block.stages):
            local = np.array(
                [at[stage.channel], *x[i : i + stage.order], *[0] * (2 - stage.order)], np.int64
            )
            y, *added = self.fixed.sections[j] @ local
            sums[i : i + stage.order] = added[: stage.order]
            y = _shift(np.array([y]), self._to_section[0][j, :1], self._to_section[1][j, :1])[0]
            at[stage.channel] = min(max(y, -self._one), self._one)
            i += stage.order
        return at, sums


def _half(bits: int | np.ndarray, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Shifts as an array, and half a unit of each."""
    shifts = np.full(count, bits, np.int64) if count is not None else np.asarray(bits, np.int64)
    return shifts, np.where(shifts > 0, np.int64(1) << np.maximum(shifts - 1, 0), 0)


def _shift(value: np.ndarray, bits: np.ndarray, half: np.ndarray) -> np.ndarray:
    """value / 2^bits, rounded to nearest, halves away from zero."""
    return np.sign(value) * ((np.abs(value) + half) >> bits)


def usable(
    law: Block | Words, errors: ArrayLike, valid: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray]:
    """The errors (k, m) as measured, and which of them (k, m) are used. Raises InvalidInput."""
    e = np.asarray(errors, law.number)
    if e.ndim != 2 or e.shape[1] != len(law.base.inputs):
        raise InvalidInput(
            f"the shape of errors is {e.shape}, but must be (k, {len(law.base.inputs)}); give one "
            "column per axis"
        )
    good = np.ones(e.shape, bool)
    if valid is not None:
        good = check_shape(valid, "valid", "(k, m)", k=len(e), m=e.shape[1]) != 0
    with np.errstate(invalid="ignore"):
        return e, good & (np.abs(e) <= law.edge)


def hold_last(e: np.ndarray, good: np.ndarray, hold: int) -> tuple[np.ndarray, np.ndarray]:
    """Bad samples replaced by the channel's last good one (zero before the first), and the status
    (k,) without limiting.
    """
    row = np.arange(len(e))[:, None]

    # row of the last good sample, -1 before the first
    last = np.maximum.accumulate(np.where(good, row, -1), axis=0)
    filled = np.where(last >= 0, np.take_along_axis(e, np.maximum(last, 0), axis=0), 0)
    missing = row - last  # before the first good sample counted from the start
    status = np.where((~good).any(axis=1), HELD, 0) | np.where(
        (missing > hold).any(axis=1), FAULT, 0
    )
    return filled, status


# Test vectors: a short run of a block that meets every branch, with what the block in Python
# answers.


_SAMPLES = 96  # of a fixed block: its test vectors
# samples of a scheduled run in which what it is told passes through the range and beyond
_SWEEP = 64
_LONGEST = 20_000  # samples of one row of a supervised run
_TAIL = 24  # samples without a value, at the end


@dataclass(frozen=True, slots=True, eq=False)
class Vectors:
    """errors (k, m) [m] and currents (k, p) [A], or counts of fixed point; valid (k, m) and status
    (k,): whole numbers. Of a scheduled block besides what it is told (k,), or (k, 2), NaN for none,
    by the names of the parameters, and rounding (p,) [A]: the largest difference between single and
    double precision. times (k,): how many samples each row stands for, of which the last is
    compared; moves (k,) [Pa]: what every second of them is told besides (None: each is one sample).
    """

    errors: np.ndarray
    valid: np.ndarray
    currents: np.ndarray
    status: np.ndarray
    told: np.ndarray | None = None
    parameters: tuple[str, ...] = ()
    rounding: np.ndarray = field(default_factory=lambda: np.zeros(0))
    times: np.ndarray | None = None
    moves: np.ndarray | None = None


@singledispatch
def vectors_of(law: Block | Words, single: bool = False) -> Vectors:
    """Small and large errors, limiting, flags, values out of range, silence; of a scheduled block
    with speeds or pressures, sweeps beyond both ends, limiting everywhere, grid points, none; of a
    supervised block readings of every kind. single: errors that single precision holds; of words
    the answer in whole numbers.
    """
    raise NotImplementedError


@vectors_of.register
def _(law: ControlBlock, single: bool = False) -> Vectors:
    e, valid = _branches(len(law.inputs))
    return _answered(law, _held_exactly(e * law.error_limit, single), valid)


@vectors_of.register
def _(law: Words, single: bool = False) -> Vectors:
    e, valid = _branches(len(law.block.inputs))
    most = 2 ** (law.word - 1) - 1
    return _answered(law, np.clip(np.round(e * law.edge), -most, most).astype(np.int64), valid)


def _branches(m: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors (k, m) in parts of their limits, and flags, that meet every branch of a fixed
    block.
    """
    e, valid = _errors(m, _SAMPLES)

    # long limiting, an implausible value, a flag that outlasts the hold
    e[40:60] = 1.0
    e[70] = 3.0  # implausible
    valid[64:82, -1] = 0
    return e, valid


def _answered(law: Block | Words, e: np.ndarray, valid: np.ndarray) -> Vectors:
    found = run_of(law, e, valid=valid)
    return Vectors(e, valid, found.currents, found.status)


@vectors_of.register
def _(law: ScheduledBlock, single: bool = False) -> Vectors:
    # rows: a sweep beyond both ends, limiting over the range, every grid point, silence
    k = max(len(axis) for axis in law.axes)
    limited = max(24, 2 * k)
    e, valid = _errors(len(law.inputs), _SWEEP + limited + k + _TAIL)
    e[30] = 3.0  # implausible
    e[_SWEEP : _SWEEP + limited] = 1.0
    valid[40:58, -1] = 0
    columns = []
    for i, (axis, limit) in enumerate(zip(law.axes, law.told_limits, strict=True)):
        low, high = float(axis[0]), float(axis[-1])
        wide = np.linspace(low - 0.1 * (high - low), high + 0.1 * (high - low), _SWEEP)
        points = axis[np.minimum(np.arange(k), len(axis) - 1)]
        column = np.concatenate(
            [
                wide[:: -1 if i else 1],
                np.linspace(high, low, limited),
                points,
                np.full(_TAIL, np.nan),
            ]
        )

        # none at the start; at the end one implausible value and jumps from end to end
        column[:2], column[-4:] = np.nan, [2 * limit, low, high, low]
        columns.append(np.roll(column, 5 * i))  # so that one is told while the other is not
    told = columns[0] if len(columns) == 1 else np.stack(columns, axis=1)
    e, told = _held_exactly(e * law.error_limit, single), _held_exactly(told, single)
    found = run_of(law, e, told, valid)

    # what single precision makes of the same run
    rounding = np.abs(run_of(law, e, told, valid, single=True).currents - found.currents).max(
        axis=0
    )
    names = tuple(one.name for one in law.along.each)
    return Vectors(e, valid, found.currents, found.status, told, names, rounding)


@vectors_of.register
def _(law: SupervisedBlock, single: bool = False) -> Vectors:
    # every doubt and every change of who is in charge; long waits are one row each, in silence
    watch, (low, high) = law.watch, law.range
    band, wide = watch.band, high - low

    # waits [samples], cut to a row's longest; move is within the step that is allowed between
    # samples, below within the margin of the range
    fade, dwell, crossing = (
        min(law.samples(t) or 0, _LONGEST) for t in (watch.fade, watch.dwell, wide / watch.rate)
    )
    move = min(1e-4 * wide, 0.5 * (watch.noise or watch.rate * law.sample_time))
    stuck, below = min(law.samples(watch.stuck) or 8, _LONGEST), min(0.5 * watch.margin, move)
    other, none = low + 0.7 * wide, np.nan
    rows = [  # reading, estimate, half width, samples each, how many, kind of error, moves
        (low, none, none, 1, 16, "all", 0.0),
        (low, none, none, 1, 8, "most", 0.0),
        (low, none, none, 1, 14, "flags", 0.0),
        (low + move, low + 0.4 * band, 0.5 * band, 1, 6, "all", 0.0),
        (low - below, none, none, 1, 3, "all", 0.0),
        (none, none, none, 1, 10, "all", 0.0),
        (none, none, none, fade + crossing + 2, 1, "none", 0.0),
        (none, none, none, 1, 10, "most", 0.0),
        (other, none, none, dwell, 1, "none", move),
        (other, none, none, 1, 10, "all", 0.0),
        (other, none, none, fade + 1, 1, "none", move),
        (other, none, none, 1, 6, "all", 0.0),
        (other, none, none, stuck + 2, 1, "none", 0.0),
        (other, none, none, fade + dwell + 2, 1, "none", move),
        (high + 3 * watch.margin + move, none, none, 1, 3, "all", 0.0),
        (np.inf, none, none, fade + crossing + 2, 1, "none", 0.0),
        (other, none, none, fade + dwell + 2, 1, "none", move),
        (other, none, none, fade + 2, 1, "none", move),
        (other, other + 3 * band + 0.1 * wide, band, 1, 3, "all", 0.0),
        (other, none, none, fade + dwell + 2, 1, "none", move),
        (other, other + 0.5 * band, band, fade + dwell + 2, 1, "none", move),
        (other, none, none, 1, 6, "all", 0.0),
        (low, none, none, 1, 12, "all", 0.0),
        (low, none, none, fade + dwell + 2, 1, "none", move),
    ]

    # rows spread out: readings, samples each stands for, moves
    counts = np.array([row[4] for row in rows])
    told = np.repeat([row[:3] for row in rows], counts, axis=0)
    times, moves = (
        np.repeat([row[3] for row in rows], counts),
        np.repeat([row[6] for row in rows], counts),
    )
    kind = np.repeat([row[5] for row in rows], counts)
    e, valid = _errors(len(law.inputs), len(told))
    e *= 0.05  # so that most currents are within their limits
    e[kind == "most"], e[kind == "none"] = 1.0, 0.0
    flagged = np.flatnonzero(kind == "flags")
    e[flagged[0]], valid[flagged[1:], -1] = 3.0, 0
    e, told, moves = (_held_exactly(x, single) for x in (e * law.error_limit, told, moves))

    # every second sample of a row has its move added; a row's last sample is compared
    odd = np.concatenate([np.arange(n) % 2 for n in times])
    readings = np.repeat(told, times, axis=0)
    readings[:, 0] += odd * np.repeat(moves, times)
    inputs, last = (
        (np.repeat(e, times, axis=0), readings, np.repeat(valid, times, axis=0)),
        np.cumsum(times) - 1,
    )
    found, single_run = run_of(law, *inputs), run_of(law, *inputs, single=True)
    rounding = np.abs(single_run.currents - found.currents)[last].max(axis=0)
    told[~np.isfinite(told)] = np.nan
    return Vectors(
        e,
        valid,
        found.currents[last],
        found.status[last],
        told,
        law.told,
        rounding,
        times,
        moves,
    )


def _errors(m: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors (count, m) of all sizes as parts of their limit, after a pulse into silence, and flags
    (count, m), all good.
    """
    rng = np.random.default_rng(7)
    e = rng.uniform(-1, 1, (count, m)) * np.exp2(-rng.integers(0, 16, (count, m)))
    e[:8] = 0.0
    e[0, 0] = 1.0
    return e, np.ones((count, m), np.int64)


def _held_exactly(x: np.ndarray, single: bool) -> np.ndarray:
    """x, rounded to what single precision holds."""
    return x.astype(np.float32).astype(float) if single else x


def as_csv(block: Block, run: Vectors) -> str:
    """The vectors as CSV: errors, flags, [speed or pressure,] currents, status with all their
    digits, below a line of names.
    """
    titles = [
        *block.inputs,
        *(f"valid_{name}" for name in block.inputs),
        *run.parameters,
        *block.outputs,
        "status",
    ]
    told = [] if run.told is None else [run.told.reshape(len(run.told), -1)]
    if run.times is not None and run.moves is not None:
        titles[len(titles) - len(block.outputs) - 1 : -len(block.outputs) - 1] = ["move", "samples"]
        told += [run.moves[:, None], run.times[:, None]]
    columns = [run.errors, run.valid, *told, run.currents, run.status[:, None]]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(titles)
    for k in range(len(run.errors)):
        writer.writerow(
            [
                f"{v:.17g}" if isinstance(v, float) else int(v)
                for part in columns
                for v in part[k].tolist()
            ]
        )
    return stream.getvalue()
