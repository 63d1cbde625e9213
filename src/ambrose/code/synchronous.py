"""What a unit runs: a controller block, synchronous blocks beside it, an axial block; the first two
as one twin in Python, sample by sample.

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

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ambrose.code.block.block import LIMITED, ControlBlock
from ambrose.code.block.fixed_point import Words
from ambrose.code.block.run import hold_last, steps_of, told_of, usable
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.synchronous_twin import (
    SIGNAL,
    SynchronousTwin,
    SynchronousWords,
    to_words,
)
from ambrose.core.checks import invalid
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
class AllAxes:
    """What one unit of all axes runs: the radial law, and the block of the axis along the shaft,
    with the same sample time and delay, under its own name. Raises InvalidInput for others.

    The two are decoupled and judged apart, each on its own plant; they share the sample and the
    processor. One step takes the errors of the radial axes, then the axial one, and gives the
    currents in the same order. Each part keeps its own guards: a lost axial reading is held by the
    axial part and never seen by the radial one.
    """

    radial: Law
    axial: ControlBlock

    @property
    def base(self) -> ControlBlock | ScheduledBlock:
        return self.radial.base

    @property
    def beside(self) -> SynchronousLaw | None:
        return self.radial.beside

    def single(self) -> AllAxes:
        """With the tables of both parts in single precision."""
        return AllAxes(self.radial.single(), self.axial.single())

    def __post_init__(self) -> None:
        base, axial = self.radial.base, self.axial
        if (base.sample_time, base.delay) != (axial.sample_time, axial.delay):
            clock = f"{axial.sample_time:g} s, {axial.delay} late"
            asked = f"that of the radial one, {base.sample_time:g} s, {base.delay} late"
            raise invalid("the axial block's clock", clock, asked, "export both together")
        if base.name == axial.name:
            raise invalid("the axial block's name", axial.name, "its own", "export both together")


AnyLaw = Law | AllAxes


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
    fixed: Words | None = None,
) -> UnitRun:
    """Over a record, in double precision, or bit by bit in the words ``fixed`` of the unit's
    controller: currents and c in counts then, amplitudes in metres.

    pulses (k,) [s]: as ``law.synchronous_block.key_phasor`` (in counts: as ``SynchronousTwin.step``
    has them); errors (k, m) [m], valid (k, m), told: as ``run_of``; contact, enabled (k,):
    of the machine, and the switch. Raises InvalidInput.
    """
    law: ControlBlock | ScheduledBlock | Words = unit.base
    blocks: SynchronousBlock | SynchronousTwin = SynchronousBlock(unit.law)
    touch: np.ndarray = unit.contact
    if fixed is not None:
        law, touch = fixed, contact_counts(unit, fixed.edge)
        blocks = SynchronousTwin(words_of(unit), SIGNAL - fixed.signal_bits)
    e, good = usable(law, errors, valid)
    count, n = e.shape
    marks = np.zeros(count, bool) if contact is None else np.asarray(contact, bool)
    on = np.ones(count, bool) if enabled is None else np.asarray(enabled, bool)
    steps = steps_of(law, told_of(unit.base, told, count))
    status = hold_last(e, good, unit.base.hold_samples)[1] | steps.known
    currents, c = np.zeros((count, n), law.number), np.zeros((count, n), law.number)
    faults, states = np.zeros(count, int), np.zeros((count, len(unit.law.blocks)), int)
    amplitudes = np.zeros((count, len(unit.law.blocks), n), complex)
    seen, last = np.zeros(n, law.number), np.zeros(n, law.number)
    now = 0
    for k, pulse in enumerate(np.asarray(pulses, law.number).tolist()):
        usable_now = good[k]
        read = np.where(usable_now, e[k], 0)
        c[k] = blocks.step(
            pulse,
            read,
            last,
            bool(marks[k] or (np.abs(read) > touch).any()),
            bool(now & LIMITED),
            bool(on[k]) and unit.base.in_charge(now),
            not usable_now.all(),
        )
        # e + c within what the controller takes for plausible; a lost reading stays the last one
        given = np.minimum(np.maximum(read + c[k], -law.edge), law.edge)
        seen = np.where(usable_now, given, seen)
        last = steps.step(seen)
        status[k] |= steps.bits
        now = int(status[k])
        currents[k] = last
        faults[k] = int(np.bitwise_or.reduce([int(run.fault) for run in blocks.running]))
        states[k] = blocks.states
        amplitudes[k] = blocks.amplitudes()
    return UnitRun(currents, status, faults, states, c, amplitudes)


def words_of(unit: RunUnit) -> SynchronousWords:
    """The unit's blocks in whole numbers. Raises InvalidInput."""
    return to_words(unit.law, unit.base.error_limit, unit.base.current_limit)


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
