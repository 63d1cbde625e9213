"""A controller block with synchronous blocks beside it, as one unit: its twin in Python, sample by
sample.

Per sample, with the errors e as measured:

1. readings that are lost (not finite, beyond the limit, called invalid) are a fault of the blocks
   alone; the controller replaces them as it does without blocks;
2. the blocks see e and the currents of the sample before, and give c;
3. the controller sees e + c, within its own limit of what is plausible, so that no c makes it hold
   a reading.

A fault of the blocks never reaches the controller: c is bounded, held or faded, and with all blocks
off c = 0 exactly, so that the currents are those of the controller alone, bit by bit. While a
supervised controller is not in the hands of its schedule, for which T was proved, the blocks are
released.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import ControlBlock
from ambrose.code.block.cascade import FixedCascade
from ambrose.code.block.fixed_point import FixedBlock
from ambrose.code.block.run import (
    LIMITED,
    STATE_AT,
    CascadeSteps,
    FixedSteps,
    ScheduledSteps,
    WordSteps,
    follow_told,
    hold_last,
    supervised_bits,
    usable_errors,
    usable_words,
)
from ambrose.code.block.scheduled import ScheduledBlock, SupervisedBlock, supervised_twin
from ambrose.code.block.synchronous_twin import (
    SIGNAL,
    SynchronousTwin,
    SynchronousWords,
    limited,
    shifted,
    to_words,
)
from ambrose.core.checks import invalid
from ambrose.law.supervision import State
from ambrose.law.synchronous_block import SynchronousBlock, SynchronousLaw

# The run-up of the self-test of a controller with synchronous blocks: alike in C and in structured
# text, so that both are tried on the same faults.


EVERY = 61  # samples between two rows of the self-test
SHARE = 0.1  # of the largest plausible error: the self-test's signals
_TURNS = 11  # of the self-test
_LEAST, _MOST = 2500, 20000  # samples of it
_WINDOWS = {  # shares of the self-test in which something is wrong
    "lost": (0.30, 0.50),
    "contact": (0.55, 0.56),
    "invalid": (0.60, 0.605),
    "off": (0.65, 0.70),
    "none": (0.75, 0.755),
    "large": (0.85, 0.86),
}


@dataclass(frozen=True, slots=True)
class RunUp:
    """A run-up from ``start`` [rad/s] at ``slope`` [rad/s^2] over ``count`` samples, of which
    every ``EVERY``-th is a row; windows: first sample, and the one after the last, of each fault.
    """

    start: float
    slope: float
    rows: int
    windows: dict[str, list[int]]

    @property
    def count(self) -> int:
        return self.rows * EVERY

    def within(self) -> dict[str, np.ndarray]:
        """Per fault whether a sample (count,) is in its window."""
        k = np.arange(self.count)
        return {name: (k >= a) & (k < b) for name, (a, b) in self.windows.items()}


def run_up_of(unit: RunUnit) -> RunUp:
    """From near the lower end of the first block's band to about its middle."""
    first, dt = unit.law.blocks[0], unit.base.sample_time
    low, high = first.band
    start = low + first.hysteresis + 0.05 * (high - low)

    # whole rows
    wanted = int(np.clip(_TURNS * 2 * np.pi / (start * dt), _LEAST, _MOST))
    rows = -(-wanted // EVERY)
    count = rows * EVERY
    slope = min(0.25 * unit.law.fastest, 0.45 * (high - low) / (count * dt))
    windows = {name: [round(a * count), round(b * count)] for name, (a, b) in _WINDOWS.items()}
    return RunUp(start, slope, rows, windows)


Base = ControlBlock | ScheduledBlock


@dataclass(frozen=True, slots=True, eq=False)
class RunUnit:
    """A controller block and the synchronous blocks beside it, channels in the block's order.

    contact (m,) [m]: an error beyond it counts as contact (infinite: the caller alone tells).
    Raises InvalidInput for blocks with another number of channels or sample time.
    """

    base: Base
    law: SynchronousLaw
    contact: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def beside(self) -> SynchronousLaw:
        return self.law

    def single(self) -> RunUnit:
        """With the controller's tables in single precision."""
        return replace(self, base=self.base.single())

    @property
    def axial(self) -> ControlBlock | None:
        return None

    def __post_init__(self) -> None:
        n = len(self.base.inputs)
        if not len(self.contact):
            object.__setattr__(self, "contact", np.full(n, np.inf))
        if np.shape(self.contact) != (n,):
            raise invalid("contact", np.shape(self.contact), f"({n},)", "give one per channel")
        if (self.law.channels, len(self.base.outputs)) != (n, n):
            raise invalid(
                "the channels of the synchronous blocks",
                self.law.channels,
                f"those of the controller, {n} errors and {len(self.base.outputs)} currents",
                "design the blocks for this controller",
            )
        if abs(self.law.sample_time - self.base.sample_time) > 1e-9 * self.base.sample_time:
            raise invalid(
                "the sample time of the synchronous blocks",
                f"{self.law.sample_time:g} s",
                f"the controller's, {self.base.sample_time:g} s",
                "design the blocks for this controller",
            )


Law = Base | RunUnit


@dataclass(frozen=True, slots=True, eq=False)
class UnitRun:
    """currents (k, p) [A], status (k,) of the controller, faults (k,) of the blocks together,
    states (k, blocks), c (k, m) [m] and the amplitudes (k, blocks, m) [m] after every sample.
    """

    currents: np.ndarray
    status: np.ndarray
    faults: np.ndarray
    states: np.ndarray
    c: np.ndarray
    amplitudes: np.ndarray


def run_unit(
    unit: RunUnit,
    pulses: ArrayLike,
    errors: ArrayLike,
    told: ArrayLike | None = None,
    valid: ArrayLike | None = None,
    contact: ArrayLike | None = None,
    enabled: ArrayLike | None = None,
) -> UnitRun:
    """Double precision, over a record. pulses (k,) [s]: as ``law.synchronous_block.key_phasor``;
    errors (k, m) [m], valid (k, m); told: as the block's ``run_scheduled`` or ``run_supervised``;
    contact, enabled (k,): of the machine, and the switch. Raises InvalidInput.
    """
    base, blocks = unit.base, SynchronousBlock(unit.law)
    e, good = usable_errors(base, errors, valid)
    count, n = e.shape
    marks = np.zeros(count, bool) if contact is None else np.asarray(contact, bool)
    on = np.ones(count, bool) if enabled is None else np.asarray(enabled, bool)
    step, status = _stepping(base, told, hold_last(e, good, base.hold_samples)[1])
    currents, c = np.zeros((count, n)), np.zeros((count, n))
    faults, states = np.zeros(count, int), np.zeros((count, len(unit.law.blocks)), int)
    amplitudes = np.zeros((count, len(unit.law.blocks), n), complex)
    seen, last = np.zeros(n), np.zeros(n)
    now = 0
    for k, pulse in enumerate(np.asarray(pulses, float).tolist()):
        usable = good[k]
        read = np.where(usable, e[k], 0.0)
        c[k] = blocks.step(
            pulse,
            read,
            last,
            bool(marks[k] or (np.abs(read) > unit.contact).any()),
            bool(now & LIMITED),
            bool(on[k]) and _in_charge(base, now),
            not usable.all(),
        )
        # e + c within what the controller takes for plausible; a lost reading stays the last one
        given = np.minimum(np.maximum(read + c[k], -base.error_limit), base.error_limit)
        seen = np.where(usable, given, seen)
        last, added = step(k, seen)
        status[k] |= added
        now = int(status[k])
        currents[k] = last
        faults[k] = int(np.bitwise_or.reduce([int(run.fault) for run in blocks.running]))
        states[k] = blocks.states
        amplitudes[k] = blocks.amplitudes()
    return UnitRun(currents, status, faults, states, c, amplitudes)


def words_of(unit: RunUnit) -> SynchronousWords:
    """The unit's blocks in whole numbers. Raises InvalidInput."""
    return to_words(unit.law, unit.base.error_limit, unit.base.current_limit)


def run_unit_words(
    unit: RunUnit,
    fixed: FixedBlock | FixedCascade,
    pulses: ArrayLike,
    errors: ArrayLike,
    valid: ArrayLike | None = None,
    contact: ArrayLike | None = None,
    enabled: ArrayLike | None = None,
) -> UnitRun:
    """In whole numbers, bit by bit, over a record: currents and c in counts, amplitudes in metres.

    fixed: the unit's controller in words; pulses (k,): as ``SynchronousTwin.step`` in counts of the
    word, errors (k, m) likewise; the rest as ``run_unit``. Raises InvalidInput.
    """
    e, good = usable_words(fixed, errors, valid)
    count, n = e.shape
    marks = np.zeros(count, bool) if contact is None else np.asarray(contact, bool)
    on = np.ones(count, bool) if enabled is None else np.asarray(enabled, bool)
    steps = CascadeSteps(fixed) if isinstance(fixed, FixedCascade) else WordSteps(fixed)
    twin, status = SynchronousTwin(words_of(unit)), hold_last(e, good, fixed.block.hold_samples)[1]
    one, up = 1 << fixed.signal_bits, SIGNAL - fixed.signal_bits
    touch = contact_counts(unit, one)
    currents, c = np.zeros((count, n), np.int64), np.zeros((count, n), np.int64)
    faults, states = np.zeros(count, int), np.zeros((count, len(unit.law.blocks)), int)
    amplitudes = np.zeros((count, len(unit.law.blocks), n), complex)
    seen, last = np.zeros(n, np.int64), np.zeros(n, np.int64)
    now = 0
    for k, pulse in enumerate(np.asarray(pulses, np.int64).tolist()):
        usable = good[k]
        read = np.where(usable, e[k], 0)
        added = twin.step(
            pulse << up,
            (read << up).tolist(),
            (last << up).tolist(),
            bool(marks[k] or (np.abs(read) > touch).any()),
            bool(now & LIMITED),
            bool(on[k]),
            not usable.all(),
        )
        c[k] = [limited(shifted(value, up), 2 * one - 1) for value in added]
        seen = np.where(usable, np.clip(read + c[k], -one, one), seen)
        last = steps.step(seen)
        status[k] |= LIMITED * steps.limited
        now = int(status[k])
        currents[k] = last
        faults[k] = int(np.bitwise_or.reduce([int(run.fault) for run in twin.running]))
        states[k] = twin.states
        amplitudes[k] = twin.amplitudes()
    return UnitRun(currents, status, faults, states, c, amplitudes)


def contact_counts(unit: RunUnit, one: int) -> np.ndarray:
    """Counts (m,) beyond which an error counts as contact; more than any where it never does."""
    share = np.minimum(unit.contact / unit.base.error_limit, 2.0)
    return np.asarray(np.rint(share * one).astype(np.int64))


def in_order(law: SynchronousLaw, axes: tuple[str, ...], base: Base) -> SynchronousLaw:
    """The blocks with their channels, in the order of ``axes``, in that of a controller's errors
    (columns of currents in that of its currents).
    """
    rows = [axes.index(name.removeprefix("err_")) for name in base.inputs]
    after = [len(axes) + axes.index(name.removeprefix("u_")) for name in base.outputs]
    blocks = []
    for block in law.blocks:
        columns = rows + (after if block.reads_currents else [])
        drive = block.drive[:, rows][:, :, columns]
        blocks.append(replace(block, drive=drive, limit=block.limit[rows]))
    return replace(law, blocks=tuple(blocks))


def _in_charge(base: Base, status: int) -> bool:
    return not isinstance(base, SupervisedBlock) or status >> STATE_AT & 3 == State.SCHEDULED


def _stepping(
    base: Base, told: ArrayLike | None, status: np.ndarray
) -> tuple[Callable[[int, np.ndarray], tuple[np.ndarray, int]], np.ndarray]:
    """One sample of a controller: its currents and the bits of its status that this adds; and the
    status (k,) from what is known before.
    """
    if isinstance(base, SupervisedBlock):
        twin, readings = supervised_twin(base), np.asarray(told, float)

        def supervised(k: int, e: np.ndarray) -> tuple[np.ndarray, int]:
            twin.estimate = float(readings[k, 1]), float(readings[k, 2])
            twin.schedule(float(readings[k, 0]))
            return twin.step(e), supervised_bits(twin)

        return supervised, status
    if isinstance(base, ScheduledBlock):
        schedule, more = follow_told(base, np.asarray(told, float))
        steps: FixedSteps | ScheduledSteps = ScheduledSteps(base, schedule)
        status = status | more
    else:
        steps = FixedSteps(base)

    def step(k: int, e: np.ndarray) -> tuple[np.ndarray, int]:
        return steps.step(e), LIMITED * steps.limited

    return step, status
