"""The block's behaviour in Python, sample by sample: the generated code is compared with it, test
vectors come from it.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import Block, ControlBlock
from ambrose.code.block.cascade import CascadeBlock, FixedCascade
from ambrose.code.block.fixed_point import FixedBlock
from ambrose.code.block.scheduled import ScheduledBlock, SupervisedBlock, supervised_twin
from ambrose.core.checks import InvalidInput, check_shape
from ambrose.core.scheduled import corners
from ambrose.law.supervision import SupervisedProgram

# status bits, as in the header
HELD = 1
FAULT = 2
LIMITED = 4
# of a scheduled block besides
CLAMPED = 8
TOLD = 16
BEHIND = 32
TOLD_SECOND = 64
# of a supervised block besides: who is in charge, why, and that it stays so
STATE_AT = 4
REASON_AT = 6
LATCHED = 512
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


def run_block(
    block: ControlBlock,
    errors: ArrayLike,
    valid: ArrayLike | None = None,
    start: ArrayLike | None = None,
) -> BlockRun:
    """Double precision. errors (k, m) [m]: NaN and infinity allowed; valid (k, m): the channels'
    flags (None: all true); start (n,): the states before the first sample (None: zero). Raises
    InvalidInput.
    """
    e, status = plausible_errors(block, errors, valid)
    steps, currents = FixedSteps(block, start), np.empty((len(e), len(block.outputs)))
    largest = np.abs(steps.x)
    for k in range(len(e)):
        currents[k] = steps.step(e[k])
        status[k] |= LIMITED * steps.limited
        largest = np.maximum(largest, np.abs(steps.x))
    return BlockRun(currents, status, steps.x, largest)


class FixedSteps:
    """A fixed block sample by sample, of errors that are plausible. x (n,): its states; limited:
    whether the last step cut a current.
    """

    def __init__(self, block: ControlBlock, start: ArrayLike | None = None) -> None:
        self.block, self.limited = block, False
        self.x = np.zeros(block.n_states) if start is None else np.array(start, dtype=float)
        self._carry = np.zeros(block.winding)

    def step(self, e: np.ndarray) -> np.ndarray:
        """Currents (p,) [A] from errors (m,) [m]."""
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


def run_scheduled(
    block: ScheduledBlock,
    errors: ArrayLike,
    told: ArrayLike,
    valid: ArrayLike | None = None,
    start: ArrayLike | None = None,
    single: bool = False,
) -> BlockRun:
    """errors (k, m) [m] and told (k,), speeds [rad/s] or pressures [Pa], or both (k, 2): NaN and
    infinity allowed; valid (k, m): the errors' flags (None: all true); start (n,): the states
    before the first sample (None: zero). single: computed in single precision. Raises InvalidInput.
    """
    e, status = plausible_errors(block, errors, valid)
    v, d = np.asarray(told, dtype=float), len(block.axes)
    if v.shape != ((len(e),) if d == 1 else (len(e), d)):
        size = f"({len(e)},)" if d == 1 else f"({len(e)}, {d})"
        raise InvalidInput(
            f"the shape of {block.along.plural} is {v.shape}, but must be {size}, one for every "
            "sample"
        )

    schedule, told_status = follow_told(block, v)
    status |= told_status
    steps = ScheduledSteps(block, schedule, start, single)
    currents = np.empty((len(e), len(block.outputs)), steps.x.dtype)
    largest = np.abs(steps.x)
    with _single_flags(single):
        for k in range(len(e)):
            currents[k] = steps.step(e[k])
            status[k] |= LIMITED * steps.limited
            largest = np.maximum(largest, np.abs(steps.x))
    return BlockRun(
        currents.astype(float), status, steps.x.astype(float), largest.astype(float), schedule
    )


def _single_flags(single: bool) -> np.errstate:
    """Products in single precision may raise the flag for an invalid value in lanes of a vector
    register that hold no number of theirs: seen once, of laws without such a value. A real one is
    a NaN among the currents.
    """
    return np.errstate(invalid="ignore" if single else "warn")


class ScheduledSteps:
    """A scheduled block sample by sample, of errors that are plausible. schedule (k,) or (k, 2):
    where the law of every sample is taken; x, limited: as of ``FixedSteps``.
    """

    def __init__(
        self,
        block: ScheduledBlock,
        schedule: np.ndarray,
        start: ArrayLike | None = None,
        single: bool = False,
    ) -> None:
        kind: Any = np.float32 if single else np.float64
        self.limited, self._k = False, 0
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
        """Currents (p,) [A] from errors (m,) [m]."""
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


def run_supervised(
    block: SupervisedBlock,
    errors: ArrayLike,
    told: ArrayLike,
    valid: ArrayLike | None = None,
    single: bool = False,
) -> BlockRun:
    """errors (k, m) [m]; told (k, 3) [Pa]: readings, estimates, their half widths, NaN and infinity
    allowed; valid (k, m): the errors' flags (None: all true). From the start of the code, without
    states that the caller set. Raises InvalidInput.
    """
    e, status = plausible_errors(block, errors, valid)
    readings = np.asarray(told, dtype=float)
    if readings.shape != (len(e), 3):
        what = f"({len(e)}, 3), a reading, an estimate and its half width for every sample"
        raise InvalidInput(f"the shape of the readings is {readings.shape}, but must be {what}")
    twin = supervised_twin(block, np.float32 if single else np.float64)
    e = e.astype(twin.laws.limit.dtype)
    currents, schedule = np.empty((len(e), len(block.outputs))), np.empty(len(e))
    with _single_flags(single):
        for k, (value, *estimate) in enumerate(readings.tolist()):
            twin.estimate = estimate[0], estimate[1]
            twin.schedule(value)
            currents[k] = twin.step(e[k])
            status[k] |= supervised_bits(twin)
        schedule[k] = twin.supervisor.value
    states = twin.states.astype(float)
    return BlockRun(currents, status, states, np.abs(states), schedule)


def supervised_bits(twin: SupervisedProgram) -> int:
    """The status of the last step of a supervised block, without that of its errors."""
    found = twin.supervisor
    return (
        LIMITED * int(twin.limited)
        | found.state << STATE_AT
        | found.fault << REASON_AT
        | LATCHED * int(found.latched)
    )


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


def run_fixed(fixed: FixedBlock, errors: ArrayLike, valid: ArrayLike | None = None) -> BlockRun:
    """Fixed point, bit by bit. errors (k, m): whole numbers of 2^-signal_bits error_limit; currents
    likewise.
    """
    return _run_words(WordSteps(fixed), errors, valid)


def run_fixed_cascade(
    fixed: FixedCascade, errors: ArrayLike, valid: ArrayLike | None = None
) -> BlockRun:
    """Fixed point of a cascade, bit by bit: as ``run_fixed``."""
    return _run_words(CascadeSteps(fixed), errors, valid)


def _run_words(
    steps: WordSteps | CascadeSteps, errors: ArrayLike, valid: ArrayLike | None
) -> BlockRun:
    e, good = usable_words(steps.fixed, errors, valid)
    e, status = hold_last(e, good, steps.fixed.block.hold_samples)
    currents = np.empty((len(e), len(steps.fixed.block.outputs)), np.int64)
    largest = np.zeros(steps.fixed.block.n_states, np.int64)
    for k in range(len(e)):
        currents[k] = steps.step(e[k])
        status[k] |= LIMITED * steps.limited
        largest = np.maximum(largest, np.abs(steps.x))
    return BlockRun(currents, status, steps.x, largest)


def usable_words(
    fixed: FixedBlock | FixedCascade, errors: ArrayLike, valid: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray]:
    """The errors (k, m) as whole numbers, and which of them (k, m) are used."""
    given, good = _inputs(fixed.block, errors, valid)
    e = given.astype(np.int64)
    one = 1 << fixed.signal_bits
    return e, good & (e >= -one) & (e <= one)


class WordSteps:
    """A fixed block in whole numbers, sample by sample, of errors that are plausible. x (n,): its
    states; limited: whether the last step cut a current.
    """

    def __init__(self, fixed: FixedBlock) -> None:
        n, s = fixed.block.n_states, fixed.signal_bits
        self.fixed, self.limited = fixed, False
        self.x = np.zeros(n, np.int64)
        self._one, self._edge = 1 << s, 1 << fixed.state_bits
        self._A, self._B = fixed.update[:, :n], fixed.update[:, n:]
        self._C, self._D = fixed.output[:, :n], fixed.output[:, n:]

        # shifts with half a unit for rounding: state to word, sums to outputs and to states
        self._to_signal = _half(fixed.state_bits - s, n)
        self._to_output, self._to_cut = _half(fixed.output_bits), _half(fixed.cut_bits)
        self._to_state, self._to_unwinding = (
            _half(bits + s - fixed.state_bits) for bits in (fixed.update_bits, fixed.unwind_bits)
        )

    def step(self, e: np.ndarray) -> np.ndarray:
        """Currents (p,) from errors (m,)."""
        # currents: C x + D e, then the limit
        x = _shift(self.x, *self._to_signal)
        u = _shift(self._D @ e + self._C @ x, *self._to_output)
        given = np.minimum(np.maximum(u, -self._one), self._one)

        # states: increment and, where limited, the unwinding; both have state_bits
        step = _shift(self._B @ e + self._A @ x, *self._to_state)
        self.limited = bool((given != u).any())
        if self.limited:
            cut = _shift(given - u, *self._to_cut)
            step = step + _shift(self.fixed.unwind @ cut, *self._to_unwinding)
        self.x = np.minimum(np.maximum(self.x + step, -self._edge), self._edge)
        return given


class CascadeSteps:
    """A cascade in whole numbers, sample by sample: as ``WordSteps``."""

    def __init__(self, fixed: FixedCascade) -> None:
        n, s = fixed.block.n_states, fixed.signal_bits
        self.fixed, self.limited = fixed, False
        self.x = np.zeros(n, np.int64)
        self._one, self._edge = 1 << s, 1 << fixed.state_bits
        # what shifts cut off channels' inputs (c,) and increments (n,), for the next sample
        self._kept, self._rest = np.zeros(len(fixed.block.into), np.int64), np.zeros(n, np.int64)
        self._to_signal = _half(fixed.state_bits - s, n)
        self._to_output, self._to_cut = _half(fixed.output_bits), _half(fixed.cut_bits)
        self._to_input, self._to_section = _half(fixed.into_bits), _half(fixed.section_bits)
        self._to_state = _half(fixed.update_shift)
        self._to_unwinding = _half(fixed.unwind_bits + s - fixed.state_bits)

    def step(self, e: np.ndarray) -> np.ndarray:
        """Currents (p,) from errors (m,)."""
        fixed, one = self.fixed, self._one
        at, sums = self._sections(self._mixed(e))

        # currents and their limit
        u = _shift(fixed.output @ at, *self._to_output)
        given = np.minimum(np.maximum(u, -one), one)

        # increments with the fraction saved, then the unwinding
        sums += self._rest
        step = _shift(sums, *self._to_state)
        self._rest = sums - (step << fixed.update_shift)
        self.limited = bool((given != u).any())
        if self.limited:
            cut = _shift(given - u, *self._to_cut)
            step = step + _shift(fixed.unwind @ cut, *self._to_unwinding)
        self.x = np.minimum(np.maximum(self.x + step, -self._edge), self._edge)
        return given

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


def plausible_errors(
    block: Block, errors: ArrayLike, valid: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray]:
    """The errors (k, m) [m] that are used, and the status (k,) so far."""
    e, good = usable_errors(block, errors, valid)
    return hold_last(e, good, block.hold_samples)


def usable_errors(
    block: Block, errors: ArrayLike, valid: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray]:
    """The errors (k, m) [m] as measured, and which of them (k, m) are used."""
    e, good = _inputs(block, np.asarray(errors, dtype=float), valid)
    with np.errstate(invalid="ignore"):
        return e, good & (np.abs(e) <= block.error_limit)


def _inputs(
    block: Block, errors: ArrayLike, valid: ArrayLike | None
) -> tuple[np.ndarray, np.ndarray]:
    e = np.asarray(errors)
    if e.ndim != 2 or e.shape[1] != len(block.inputs):
        raise InvalidInput(
            f"the shape of errors is {e.shape}, but must be (k, {len(block.inputs)}); give one "
            "column per axis"
        )
    if valid is None:
        return e, np.ones(e.shape, bool)
    return e, check_shape(valid, "valid", "(k, m)", k=len(e), m=e.shape[1]) != 0


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


# Operations and memory of one step of the generated code.


# of a signal, of a state
_BYTES = {"double": (8, 8), "float": (4, 4), "fixed32": (4, 8), "fixed16": (2, 4)}


@dataclass(frozen=True, slots=True)
class Cost:
    """Multiplications and additions of a step, ``limited`` more of each while a current is cut;
    bytes of state and tables.
    """

    multiplications: int
    additions: int
    limited: int
    state_bytes: int
    table_bytes: int


def diagonals_of(x: np.ndarray) -> list[int]:
    """The offsets (positive above) of the diagonals of x (n, n) that are not zero."""
    return [k for k in range(1 - len(x), len(x)) if np.diagonal(x, k).any()]


def padding_of(block: Block) -> tuple[int, int]:
    """How many places before and after the states the diagonals of A - I reach; a cascade has
    none.
    """
    offsets = [] if isinstance(block, CascadeBlock) else diagonals_of(increment_of(block))
    return max(0, -min(offsets, default=0)), max(0, max(offsets, default=0))


def increment_of(block: Block) -> np.ndarray:
    """A - I (n, n), of a schedule what is the same at every point."""
    if isinstance(block, ScheduledBlock):
        return block.changes.fixed[: block.n_states, : block.n_states]
    return block.increment


def step_cost(block: ControlBlock, arithmetic: str) -> Cost:
    """Counted as the code does it: whole diagonals of A - I, dense B, C and (where not zero) D; of
    a cascade its sections.
    """
    n = block.n_states
    m = len(block.inputs)
    p = len(block.outputs)
    w = block.winding

    # products: diagonals of A - I, B, C and D
    direct = m * p if block.D.any() else 0
    products = len(diagonals_of(block.increment)) * n + n * m + n * p + direct
    signal, state = _BYTES[arithmetic]
    floating = arithmetic in {"double", "float"}
    if isinstance(block, CascadeBlock):
        # a cascade: per state a and b, in whole numbers the factor between ranges as well; d of
        # each section; out, and into where channels are mixed
        per_state = 2 if floating else 3  # and a feedthrough of every section
        products = per_state * n + len(block.stages) + m * p + (m * m if block.mixes else 0)

    # kept between samples: what compensated sums lost, or the fractions saved
    carry = (
        w * signal
        if floating
        else (n + m * block.mixes) * state
        if isinstance(block, CascadeBlock)
        else 0
    )

    # coefficients with the unwinding, limits and transfer, then the shifts of the rows, a byte each
    tables = products + w * p + (m + p if floating else 0) + (n * (m + p) if block.transfers else 0)
    shifts = 0 if floating else n + 2 * p + (n if block.transfers else 0)
    return Cost(
        multiplications=products,
        additions=products + n + (3 * w if floating else 0),
        limited=w * p,
        state_bytes=(n + sum(padding_of(block))) * state + carry + m * (signal + 2),
        table_bytes=tables * signal + shifts,
    )


def scheduled_cost(block: ScheduledBlock, arithmetic: str) -> Cost:
    """Counted as the code does it: whole diagonals of the fixed A - I, dense B, C and D, and few
    signals for what changes.
    """
    n = block.n_states
    m = len(block.inputs)
    p = len(block.outputs)
    k = len(block.B)
    (r, q), size = block.changes.ranks, _BYTES[arithmetic][0]
    d, places = len(block.axes), sum(len(axis) for axis in block.axes)
    points = 2**d  # around a value
    fixed = len(diagonals_of(increment_of(block))) * n + n * m + n * p + m * p

    # left (n + p, r) and right (q, n + m); core (r, q) at every corner of the cell
    around = r * (n + p) + q * (n + m)
    transfer = k * n * (m + p) if block.transfers else 0
    cost = Cost(
        multiplications=fixed + around + points * q * (r + 1) + 4 * (d - 1),
        additions=fixed + around + points * q * r + 3 * n + 4 * d,
        limited=points * p * (n + 1),
        state_bytes=(2 * n + sum(padding_of(block)) + m + 2 * d) * size + 2 * (m + 3 * d),
        table_bytes=(fixed + around + k * (r * q + n * p) + places + transfer + m + p + 2 * d)
        * size,
    )
    return _with_fallback(cost, block, size) if isinstance(block, SupervisedBlock) else cost


def _with_fallback(cost: Cost, block: SupervisedBlock, size: int) -> Cost:
    """The fixed law besides, whichever of the two is led because it waits, and what is left of the
    difference.
    """
    fixed = block.fallback
    p = len(block.outputs)
    m = len(block.inputs)
    n = block.fallback.n_states
    products = len(diagonals_of(fixed.increment)) * n + n * (m + p) + m * p
    led, numbers = max(fixed.winding * p, 2 * p * (block.n_states + 1)), 12
    transfer = n * (m + p) if block.transfers else 0
    return Cost(
        multiplications=cost.multiplications + products + led + 2 * p + 2,
        additions=cost.additions + products + 3 * n + led + 6 * p + 12,
        limited=cost.limited,
        state_bytes=cost.state_bytes + (2 * n + sum(padding_of(fixed)) + p + 2) * size + 26,
        table_bytes=cost.table_bytes + (products + fixed.winding * p + transfer + numbers) * size,
    )


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


def make_vectors(
    block: ControlBlock, fixed: FixedBlock | FixedCascade | None = None, single: bool = False
) -> Vectors:
    """Small and large errors, limiting, flags, values out of range, silence. fixed: the answer in
    whole numbers; single: errors that single precision holds.
    """
    e, valid = _errors(len(block.inputs), _SAMPLES)

    # long limiting, an implausible value, a flag that outlasts the hold
    e[40:60] = 1.0
    e[70] = 3.0  # implausible
    valid[64:82, -1] = 0
    if fixed is not None:
        words = np.clip(
            np.round(e * (1 << fixed.signal_bits)),
            1 - 2 ** (fixed.word - 1),
            2 ** (fixed.word - 1) - 1,
        )
        e = words.astype(np.int64)
        run = (
            run_fixed_cascade(fixed, e, valid)
            if isinstance(fixed, FixedCascade)
            else run_fixed(fixed, e, valid)
        )
    else:
        e = _held_exactly(e * block.error_limit, single)
        run = run_block(block, e, valid)
    return Vectors(e, valid, run.currents, run.status)


def make_scheduled_vectors(block: ScheduledBlock, single: bool = False) -> Vectors:
    """The same with speeds or pressures: sweeps beyond both ends, limiting everywhere, grid points,
    none; of a supervised block readings of every kind.
    """
    if isinstance(block, SupervisedBlock):
        return _supervised_vectors(block, single)

    # rows: a sweep beyond both ends, limiting over the range, every grid point, silence
    k = max(len(axis) for axis in block.axes)
    limited = max(24, 2 * k)
    e, valid = _errors(len(block.inputs), _SWEEP + limited + k + _TAIL)
    e[30] = 3.0  # implausible
    e[_SWEEP : _SWEEP + limited] = 1.0
    valid[40:58, -1] = 0
    columns = []
    for i, (axis, limit) in enumerate(zip(block.axes, block.told_limits, strict=True)):
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
    e, told = _held_exactly(e * block.error_limit, single), _held_exactly(told, single)
    run = run_scheduled(block, e, told, valid)

    # what single precision makes of the same run
    rounding = np.abs(
        run_scheduled(block, e, told, valid, single=True).currents - run.currents
    ).max(axis=0)
    return Vectors(
        e,
        valid,
        run.currents,
        run.status,
        told,
        tuple(one.name for one in block.along.each),
        rounding,
    )


def _supervised_vectors(block: SupervisedBlock, single: bool) -> Vectors:
    """Every doubt and every change of who is in charge; long waits are one row each, in silence."""
    watch, (low, high) = block.watch, block.range
    band, wide = watch.band, high - low

    # waits [samples], cut to a row's longest; move is within the step that is allowed between
    # samples, below within the margin of the range
    fade, dwell, crossing = (
        min(block.samples(t) or 0, _LONGEST) for t in (watch.fade, watch.dwell, wide / watch.rate)
    )
    move = min(1e-4 * wide, 0.5 * (watch.noise or watch.rate * block.sample_time))
    stuck, below = min(block.samples(watch.stuck) or 8, _LONGEST), min(0.5 * watch.margin, move)
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
    e, valid = _errors(len(block.inputs), len(told))
    e *= 0.05  # so that most currents are within their limits
    e[kind == "most"], e[kind == "none"] = 1.0, 0.0
    flagged = np.flatnonzero(kind == "flags")
    e[flagged[0]], valid[flagged[1:], -1] = 3.0, 0
    e, told, moves = (_held_exactly(x, single) for x in (e * block.error_limit, told, moves))

    # every second sample of a row has its move added; a row's last sample is compared
    odd = np.concatenate([np.arange(n) % 2 for n in times])
    readings = np.repeat(told, times, axis=0)
    readings[:, 0] += odd * np.repeat(moves, times)
    inputs, last = (
        (np.repeat(e, times, axis=0), readings, np.repeat(valid, times, axis=0)),
        np.cumsum(times) - 1,
    )
    run = run_supervised(block, *inputs)
    rounding = np.abs(run_supervised(block, *inputs, single=True).currents - run.currents)[
        last
    ].max(axis=0)
    names = ("pressure", "estimate", "half_width")
    told[~np.isfinite(told)] = np.nan
    return Vectors(
        e, valid, run.currents[last], run.status[last], told, names, rounding, times, moves
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
