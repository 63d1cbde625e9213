"""Synchronous blocks beside any controller block as code: the unit and its twin in Python, C99 and
structured text; one function a sample, without heap, recursion or library.

Per sample, with the errors e as measured:

1. readings that are lost (not finite, beyond the limit, called invalid) are a fault of the blocks
   alone; the controller replaces them as it does without blocks;
2. the blocks see e and the currents of the sample before, and give c;
3. the controller sees e + c, within its own limit of what is plausible, so that no c makes it hold
   a reading.

A fault of the blocks never reaches the controller: c is bounded, held or faded, and with all blocks
off c = 0 exactly, so that the currents are those of the controller alone, bit by bit. While a
supervised controller is not in the hands of its schedule, for which T was proved, the blocks are
released. The blocks' own twin is ``law.synchronous_block``: the code takes the same steps in the
same order. The texts are in code/templates: synchronous.c.j2 and .h.j2, run.c.j2 and run.st.j2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from ambrose.annexes.synchronous.block_checks import block_loops, check_block
from ambrose.annexes.synchronous.block_loop import running_law, synchronous_loop
from ambrose.code.block.block import LIMITED, ControlBlock, as_comment, render
from ambrose.code.block.fixed_point import Words, in_words
from ambrose.code.block.run import hold_last, steps_of, told_of, usable
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.synchronous_twin import (
    ONE,
    PER_REST,
    PLACE,
    SIGNAL,
    SIXTH,
    BlockWords,
    SynchronousTwin,
    SynchronousWords,
    to_words,
)
from ambrose.code.c.code import (
    LARGEST,
    WORDS,
    Arithmetic,
    Precision,
    check_precision,
    code_types,
    generate,
    identity_facts,
    integer_table,
    law_files,
    literal,
    real_table,
    with_identity,
)
from ambrose.code.interface import TYPES, Base, interface_of
from ambrose.code.pipeline import diverging
from ambrose.code.structured_text import (
    check_names,
    generate_structured_text,
    literal as st_literal,
    table as st_table,
    text_facts,
    unit_structured_text,
    whole_numbers,
)
from ambrose.core.checks import InvalidInput, UnstableSystem, invalid
from ambrose.judge.checks import Checks
from ambrose.law.law import LawLike
from ambrose.law.synchronous_block import (
    DECAY,
    JUMP,
    LOST_TURNS,
    SECTORS,
    BlockLaw,
    SynchronousBlock,
    SynchronousLaw,
    circle,
)
from ambrose.machine.machine import Machine
from ambrose.machine.part import Synchronous

_TOUCH = 0.95  # of the smallest touchdown gap: an error beyond it counts as contact


def unit_beside(
    blocks: Sequence[Synchronous],
    machine: Machine,
    law: LawLike,
    block: Base,
    progress: Callable[[str], None],
    *,
    force: bool,
) -> tuple[RunUnit, tuple[Checks, ...]]:
    """The unit of a controller block and its synchronous blocks, and their checks with the law that
    runs. Raises UnstableSystem for blocks that diverge, unless forced.
    """
    rate, delay = 1 / block.sample_time, block.delay
    judged = tuple(
        check_block(item, progress) for item in block_loops(machine, law, blocks, rate, delay)
    )
    if not force and (found := diverging(judged)):
        raise UnstableSystem(f"{'; '.join(found)}; give another T, or force the export")
    running = running_law(blocks, synchronous_loop(machine, law, rate, delay))
    gaps = [bearing.touchdown_gap for bearing in machine.bearings if bearing.touchdown_gap]
    contact = np.full(len(block.inputs), _TOUCH * min(gaps, default=np.inf))
    return RunUnit(block, in_order(running, machine.axes, block), contact), judged


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


NEWTON = 12  # steps of the square root: enough for any amplitude up to 1e3 limits
FAR = 1e9  # turns beyond which the angle stands still: years without a pulse


def generate_synchronous(
    law: SynchronousLaw,
    name: str = "sync",
    arithmetic: str = "double",
    provenance: Sequence[str] = (),
) -> dict[str, str]:
    """The files of the blocks by name: <name>.h and .c.

    name: of files and functions; arithmetic: "double" or "float"; provenance: lines for the header.
    Raises InvalidInput.
    """
    if not (name.isidentifier() and name.isascii()):
        raise invalid(
            "the name of the synchronous code", repr(name), "a name in C", "letters, digits and _"
        )
    check_precision(arithmetic)
    table = real_table(arithmetic)
    n = law.channels
    dt = law.sample_time
    blocks = [_block(block, table, arithmetic, dt) for block in law.blocks]

    def number(value: float) -> str:
        return literal(value, arithmetic)

    columns = sum(block.drive.shape[2] for block in law.blocks)
    size = {"double": 8, "float": 4}[arithmetic]
    numbers = 2 * SECTORS + sum(
        2 * block.drive.size + len(block.speeds) + n for block in law.blocks
    )
    turning = sum(n * 8 * block.drive.shape[2] for block in law.blocks if block.per_turn)
    cost = {
        # at the end of a turn the table serves twice, for the mean's real and imaginary part
        "multiplications": 40 + n * (4 * columns + (14 + 2 * NEWTON) * len(law.blocks)) + turning,
        "additions": 40 + n * (6 * columns + (10 + NEWTON) * len(law.blocks)) + turning,
        "table_bytes": size * numbers,
    }
    facts: dict[str, Any] = {
        "name": name,
        "prefix": name.upper(),
        "n": n,
        "arithmetic": {"double": "double precision", "float": "single precision"}[arithmetic],
        "type": arithmetic,
        "sample_time": f"{dt:.9g}",
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "blocks": blocks,
        "cost": cost,
        "sectors": SECTORS,
        "circle": table(circle()),
        "newton": NEWTON,
        "dt": number(dt),
        "fastest": number(law.fastest),
        "jump": number(JUMP),
        "lost_turns": number(LOST_TURNS),
        "two_pi": number(2 * math.pi),
        "per_radian": number(SECTORS / (2 * math.pi)),
        "sector_angle": number(2 * math.pi / SECTORS),
        "half": number(0.5),
        "sixth": number(1 / 6),
        "zero": number(0.0),
        "one": number(1.0),
        "fixed": False,
        "largest": LARGEST[arithmetic],
        "far": number(FAR),
        "per_turn": any(block.per_turn for block in law.blocks),
    }
    source = render("synchronous.c.j2", facts)
    known = identity_facts(name, source, code_types(arithmetic))
    header = render("synchronous.h.j2", {**facts, **known})
    return {f"{name}.h": header, f"{name}.c": with_identity(source, known)}


def _block(block: BlockLaw, table: Any, arithmetic: str, dt: float) -> dict[str, Any]:
    def number(value: float) -> str:
        return literal(value, arithmetic)

    count, n, m = block.drive.shape
    drive = block.drive.reshape(count, n * m)
    return {
        "count": count,
        "m": m,
        "speeds": table(block.speeds),
        "re": table(drive.real),
        "im": table(drive.imag),
        "limit": table(block.limit),
        "low": number(block.band[0]),
        "high": number(block.band[1]),
        "hysteresis": number(block.hysteresis),
        "gain": number(block.gain),
        "leak": number(block.leak),
        "ramp": number(dt / block.ramp),
        "fade": number(1 - dt / block.release),
        "hold": round(block.hold / dt),
        "release": round(DECAY * block.release / dt),
        "harmonic": block.harmonic,
        "subtracts": int(block.subtracts),
        "currents": int(block.reads_currents),
        "per_turn": int(block.per_turn),
    }


# Synchronous blocks as C99 in whole numbers, and the report of their formats.
#
# The twin is ``ambrose.code.block.synchronous_twin``: equal to the last bit. The text is in
# templates/synchronous_fixed.c.j2.


_ANGLES = 10_000  # at which the table is measured
_SETTINGS = 21


def generate_words(
    words: SynchronousWords, word: int, name: str = "sync", provenance: Sequence[str] = ()
) -> dict[str, str]:
    """The files of the blocks by name: <name>.h, .c and _report.md.

    word: 32 or 16, of the signals in and out; name: of files and functions; provenance: lines for
    the header.
    """
    law, n = words.law, words.law.channels
    blocks = [_fixed_block(block) for block in words.blocks]
    columns = sum(block.drive.shape[2] for block in law.blocks)
    sizes = [block.re.size * 2 + 3 * len(block.speeds) + n + _SETTINGS for block in words.blocks]
    facts: dict[str, Any] = {
        "name": name,
        "prefix": name.upper(),
        "n": n,
        "fixed": True,
        "word": word,
        "arithmetic": f"fixed point, {word} bits",
        "type": f"int{word}_t",
        "one": 1 << (word - 2),
        "up": 1 << (SIGNAL + 2 - word),
        "down": SIGNAL + 2 - word,
        "largest_word": 2 ** (word - 1) - 1,
        "sample_time": f"{law.sample_time:.9g}",
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "blocks": blocks,
        "sectors": SECTORS,
        "circle": integer_table(words.table),
        "time_bits": words.time_bits,
        "slope_bits": words.slope_bits,
        "fastest": words.fastest,
        "per_rest": PER_REST,
        "third": SIXTH,
        "per_turn": any(block.per_turn for block in law.blocks),
        "cost": {
            # interpolated entries, their products, turning and moving, per block and channel
            "multiplications": 20 + n * (4 * columns + 20 * len(blocks)),
            "additions": 40 + n * (8 * columns + 30 * len(blocks)),
            "table_bytes": 4 * (2 * SECTORS + sum(sizes)),
        },
    }
    source = render("synchronous_fixed.c.j2", facts)
    known = identity_facts(name, source, {"int32_t": "i4"})
    return {
        f"{name}.h": render("synchronous.h.j2", {**facts, **known}),
        f"{name}.c": with_identity(source, known),
        f"{name}_report.md": render("sync_report.md.j2", {**facts, **_report(words, word)}),
    }


def _fixed_block(block: BlockWords) -> dict[str, Any]:
    """The tables of one block."""
    law = block.law
    count, n, m = block.re.shape
    gaps = max(count - 1, 1)  # of one speed: never read
    settings = [
        *(block.low, block.high, block.hysteresis, block.gain, block.gain_bits, block.leak),
        *(block.leak_bits, block.fade, block.fade_bits, block.ramp, block.drive_bits),
        *(block.headroom, block.amplitude_bits, block.hold, block.release, block.most, count),
        *(law.harmonic, law.subtracts, law.reads_currents, law.per_turn),
    ]
    return {
        "count": count,
        "m": m,
        "gaps": gaps,
        "settings": len(settings),
        "amplitude": block.amplitude_bits,
        "speeds": integer_table(block.speeds),
        "reciprocals": integer_table(np.resize(block.reciprocals, gaps)),
        "distances": integer_table(np.resize(block.reciprocal_bits, gaps)),
        "re": integer_table(block.re.reshape(count, n * m)),
        "im": integer_table(block.im.reshape(count, n * m)),
        "limit": integer_table(block.limit),
        "set": integer_table(np.array(settings, np.int64)),
    }


def table_found(words: SynchronousWords) -> float:
    """The largest error of cosine and sine over many angles."""
    twin, worst = SynchronousTwin(words), 0.0
    for theta in np.linspace(0, 2**32 - 1, _ANGLES).astype(np.int64).tolist():
        twin.angle.theta = theta
        cosine, sine = twin.turn(1)
        angle = 2 * math.pi * theta / 2**32
        worst = max(worst, abs(cosine / ONE - math.cos(angle)), abs(sine / ONE - math.sin(angle)))
    return worst


def _report(words: SynchronousWords, word: int) -> dict[str, Any]:
    dt = words.law.sample_time
    angle = words.angle_error
    return {
        "speed_lsb": f"{2 * math.pi / dt * 2.0**-PLACE:.2g}",
        "table_error": f"{words.table_error:.2g}",
        "table_found": f"{table_found(words):.2g}",
        "angle_error": f"{angle:.2g}",
        "c_error": f"{2.0 ** (1 - word):.2g}",
        "blocks": [
            {
                "drive_bits": block.drive_bits,
                "x_bits": SIGNAL - block.headroom,
                "amplitude": block.amplitude_bits,
                "relative": f"{block.relative:.2g}",
                "phase": f"{math.degrees(math.asin(min(block.relative, 1.0))):.2g}",
                "reading": f"{words.reading_error(block):.2g}",
                "gain": f"{block.gain * 2.0**-block.gain_bits / dt:.9g}",
                "leak": f"{block.leak * 2.0**-block.leak_bits / dt:.9g}",
                "fade": f"{dt / (block.fade * 2.0**-block.fade_bits):.9g}",
                "ramp": f"{dt * ONE / block.ramp:.9g}",
            }
            for block in words.blocks
        ],
    }


# A controller with synchronous blocks beside it as C99: the controller's files, the blocks' files,
# and one unit that runs both, with its own self-test.
#
# The twin is ``run_unit``; the texts are templates/run.h.j2, run.c.j2 and run_test.c.j2.


_FLOAT = 2e-2  # of the largest current: how far single precision may be


def generate_run(
    unit: RunUnit,
    arithmetic: Arithmetic = "double",
    provenance: Sequence[str] = (),
    along: Sequence[str] = (),
) -> dict[str, str]:
    """The files of a unit by name: the controller's (``code.c.code.generate``), <name>_sync.h and
    .c, <name>_run.h, .c and _run_test.c, of fixed point also <name>_sync_report.md. Raises
    InvalidInput, also for fixed point beside a schedule.
    """
    base, sync = unit.base, f"{unit.base.name}_sync"
    files = generate(base, arithmetic, provenance)
    if word := WORDS.get(arithmetic, 0):
        files |= generate_words(words_of(unit), word, sync, provenance)
    else:
        files |= generate_synchronous(unit.law, sync, arithmetic, provenance)
    if arithmetic == "float":
        unit = unit.single()
    facts = _facts(unit, arithmetic, provenance) | _self_test(unit, arithmetic)
    for end in ("_run.h", "_run.c", "_run_test.c"):
        files[f"{base.name}{end}"] = render(f"{end[1:]}.j2", facts)
    return files


def _facts(unit: RunUnit, arithmetic: str, provenance: Sequence[str]) -> dict[str, Any]:
    base, word = unit.base, WORDS.get(arithmetic, 0)
    table = integer_table if word else real_table(arithmetic)
    touches = bool(np.isfinite(unit.contact).all())
    contact = contact_counts(unit, 1 << (word - 2)) if word else unit.contact
    floating = {"double": "double precision", "float": "single precision"}
    n, real = len(base.inputs), TYPES[arithmetic][0]
    return {
        "name": base.name,
        "prefix": base.name.upper(),
        "sync": f"{base.name.upper()}_SYNC",
        "n": n,
        "fixed": bool(word),
        "type": real,
        "arithmetic": floating.get(arithmetic, f"fixed point, {word} bits"),
        "sample_time": f"{base.sample_time:.9g}",
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "supervised": base.watch is not None,
        "transfers": base.transfers,
        "touches": touches,
        "contact": table(contact) if touches else "",
        "error_limit": "" if word else table(base.error_limit),
        "zero": "0" if word else literal(0.0, arithmetic),
        "declared": interface_of(unit, arithmetic).declared(real, n, n, "valid"),
        "told": base.told,
        "told_parameters": "".join(f"{real} {one}, " for one in base.told),
    }


def _self_test(unit: RunUnit, arithmetic: str) -> dict[str, Any]:
    """Signals of whole numbers, as run_test.c.j2 makes them, and what the twin answers."""
    base, run_up = unit.base, run_up_of(unit)
    dt, n = base.sample_time, len(base.inputs)
    count, within = run_up.count, run_up.within()

    # the angle in 2^32 to a turn, and what it moves in a sample
    per_speed = dt / (2 * np.pi) * 2**32
    step, change = round(run_up.start * per_speed), round(run_up.slope * dt * per_speed)
    steps = step + change * np.arange(count)
    turn = np.concatenate([[0], np.cumsum(steps)[:-1]]) % 2**32
    pulses = np.where((turn < steps) & ~within["lost"], dt * (turn / steps), -1.0)

    # a triangle of each channel, |2^32 - at| - 2^30, at = turn + 1000000007 i
    at = (turn[:, None] + np.arange(n) * 1000000007) % 2**32
    wave = np.where(at < 2**31, at, 2**32 - at) - 2**30
    valid = np.ones((count, n), bool)
    valid[within["invalid"], 0] = False
    shown = slice(EVERY - 1, None, EVERY)
    facts: dict[str, Any] = {
        "rows": run_up.rows,
        "every": EVERY,
        "first": step,
        "change": change,
        "windows": {name: f"{a}, {b}" for name, (a, b) in run_up.windows.items()},
    }
    if word := WORDS.get(arithmetic, 0):
        # the same in counts: eight tenths or a tenth of the limit, and a word beyond it
        one = 1 << (word - 2)
        came = (turn < steps) & ~within["lost"]
        ages = np.where(came, turn * one // steps, -1)
        large = np.where(within["large"][:, None], 8 * wave, wave)
        counts = np.sign(large) * (np.abs(large) // (10 * (2**30 // one)))
        counts[within["none"], -1] = one // 2 * 3
        fixed = in_words(cast(ControlBlock, base), word)
        run = run_unit(
            unit, ages, counts, None, valid, within["contact"], ~within["off"], fixed=fixed
        )
        return facts | {
            "told_test": "",
            "currents": integer_table(run.currents[shown]),
            "faults": _whole(run.faults[shown]),
            "status": _whole(run.status[shown]),
            "tolerance": integer_table(np.zeros(n)),
        }
    scale = SHARE * base.error_limit / 2**30
    errors = wave * np.where(within["large"][:, None], 8.0 * scale, scale)
    errors[within["none"], -1] = np.nan

    # the schedule in the middle of its ranges
    middle = base.middle()
    told = np.full((count, len(middle)), middle)
    told = told[:, 0] if len(middle) == 1 else told
    texts = ["none" if math.isnan(value) else literal(value, arithmetic) for value in middle]
    run = run_unit(unit, pulses, errors, told, valid, within["contact"], ~within["off"])
    table, largest = real_table(arithmetic), np.abs(run.currents).max(axis=0)
    share = {"double": 1e-9, "float": _FLOAT}[arithmetic]
    return facts | {
        "sample_time_double": literal(dt, "double"),
        "told_test": "".join(f"{text}, " for text in texts),
        "scale": real_table("double")(scale),
        "currents": table(run.currents[shown]),
        "faults": _whole(run.faults[shown]),
        "status": _whole(run.status[shown]),
        "tolerance": table(np.maximum(share * largest, 1e-12)),
    }


def _whole(values: np.ndarray) -> str:
    lines = [", ".join(map(str, values[i : i + 24].tolist())) for i in range(0, len(values), 24)]
    return "{" + ",\n    ".join(lines) + "}"


law_files.register(RunUnit, generate_run)


# A controller block with synchronous blocks beside it as IEC 61131-3 structured text: a function
# block that calls the controller's, and a program that tests it.
#
# The twin is ``run_unit``; signs, order of the sums and state machine are those of the generated
# C. Besides the common part of the language it needs TRUNC and DINT_TO_LREAL, which the standard
# has.


FAULTS = (
    "lost",
    "jumped",
    "touched",
    "saturated",
    "at_limit",
    "outside",
    "off_told",
    "unusable",
)  # in the order of the bits of law.synchronous_block.BlockFault
_FLAGS = ("held", "fault", "limited")
_OWN_RUN = """
pulse contact off base pulses tau period middle omega slope now theta came turned length change span
turns sector angle p q mode clock ramp limits cosine sine re im samples sum_re sum_im v w error good
added given current s x y share eps leak any inside wanted k next i j circle touching error_limit
reset track held fault limited clamped behind u e turn part d row since expected check block shift
scale status faults tolerance currents sample wrong largest done
"""  # what the function block and its test declare besides signals
_TOLERANCE = {"double": 1e-9, "float": 2e-2}  # of the largest current


def generate_run_structured_text(
    unit: RunUnit, precision: Precision = "double", provenance: Sequence[str] = ()
) -> dict[str, str]:
    """The controller's files (``structured_text``), <name>_run.st (the function block that is
    called in its place) and <name>_run_test.st.

    Raises InvalidInput for fixed point, a supervised controller, or names that structured text
    reserves.
    """
    if precision not in get_args(Precision):
        raise invalid(
            "arithmetic with a synchronous block",
            repr(precision),
            "double or float",
            "structured text has no fixed point here; write C",
        )
    base = unit.base
    if base.watch:
        raise InvalidInput(
            "structured text has no supervision of a schedule by a fallback; write C, which has it"
        )
    own = frozenset(_OWN_RUN.split()) | {f"{name}_{k}" for k in range(16) for name in _OF_BLOCK}
    check_names(base, own)
    files = generate_structured_text(base, precision, provenance)
    unit = unit.single() if precision == "float" else unit
    facts = {**text_facts(unit.base, precision, provenance), **_text_facts(unit, precision)}
    facts |= _run_test(unit, precision)
    return {
        **files,
        f"{base.name}_run.st": render("run.st.j2", facts),
        f"{base.name}_run_test.st": render("run_test.st.j2", facts),
    }


_OF_BLOCK = ("speeds", "drive_re", "drive_im", "amplitude_limit")


def _text_facts(unit: RunUnit, precision: Precision) -> dict[str, Any]:
    base, law = unit.base, unit.law
    dt = law.sample_time

    def number(value: float) -> str:
        return st_literal(value, precision)

    arrays: dict[str, np.ndarray] = {"circle": circle(), "error_limit": base.error_limit}
    touches = bool(np.isfinite(unit.contact).all())
    if touches:
        arrays["touching"] = unit.contact
    for k, block in enumerate(law.blocks):
        tables = (block.speeds, block.drive.real, block.drive.imag, block.limit)
        arrays |= {f"{name}_{k}": x for name, x in zip(_OF_BLOCK, tables, strict=True)}
    flags = list(_FLAGS)
    if base.told:
        flags += ["clamped", f"{base.told[0]}_held", "behind"]
    return {
        "n": len(base.inputs),
        "count": len(law.blocks),
        "blocks": [_text_block(k, one, dt, precision) for k, one in enumerate(law.blocks)],
        "tables": [st_table(name, x, precision) for name, x in arrays.items()],
        "flags": flags,
        "faults": list(FAULTS),
        "touches": touches,
        "per_turn": any(block.per_turn for block in law.blocks),
        "newton": NEWTON,
        "sectors": SECTORS,
        "dt": number(dt),
        "fastest": number(law.fastest),
        "jump": number(JUMP),
        "lost_turns": number(LOST_TURNS),
        "far": number(FAR),
        "two_pi": number(2 * math.pi),
        "per_radian": number(SECTORS / (2 * math.pi)),
        "sector_angle": number(2 * math.pi / SECTORS),
        "sixth": number(1 / 6),
    }


def _text_block(at: int, block: BlockLaw, dt: float, precision: Precision) -> dict[str, Any]:
    low, high = block.band
    reals = {
        "low": low,
        "high": high,
        "hysteresis": block.hysteresis,
        "gain": block.gain,
        "leak": block.leak,
        "ramp": dt / block.ramp,
        "fade": 1 - dt / block.release,
        "harmonic": block.harmonic,
    }
    return {
        **{name: st_literal(float(value), precision) for name, value in reals.items()},
        "at": at,
        "m": block.drive.shape[2],
        "points": len(block.speeds),
        "hold": round(block.hold / dt),
        "release": round(DECAY * block.release / dt),
        "subtracts": block.subtracts,
        "currents": block.reads_currents,
        "per_turn": block.per_turn,
    }


def _run_test(unit: RunUnit, precision: Precision) -> dict[str, Any]:
    """The signals as run_test.st.j2 makes them, in the same numbers, and what the twin answers."""
    base, run_up = unit.base, run_up_of(unit)
    dt, n = base.sample_time, len(base.inputs)
    count, within = run_up.count, run_up.within()

    # the angle in turns and what it moves in a sample, summed up in the numbers of the code
    kind: Any = np.float32 if precision == "float" else np.float64
    turn, part = kind(0), kind(run_up.start * dt / (2 * np.pi))
    first_part, change = part, kind(run_up.slope * dt * dt / (2 * np.pi))
    angle, parts = np.zeros(count, kind), np.zeros(count, kind)
    for i in range(count):
        angle[i], parts[i] = turn, part
        turn = kind(turn + part)
        turn = kind(turn - kind(1)) if turn >= 1 else turn
        part = kind(part + change)

    pulses = np.where((angle < parts) & ~within["lost"], kind(dt) * (angle / parts), kind(-1))

    # a triangle of each channel
    shift = (np.arange(n) * 0.2328306 % 1).astype(kind)
    scale = (4 * SHARE * base.error_limit).astype(kind)
    d = angle[:, None] + shift
    d = np.where(d >= 1, d - kind(1), d)
    wave = (np.where(d >= 0.5, kind(1) - d, d) - kind(0.25)) * scale
    errors = np.where(within["large"][:, None], kind(8) * wave, wave)
    valid = np.ones((count, n), bool)
    valid[within["invalid"], 0] = False

    middle = sum(base.middle())  # of the one parameter; else of none
    told = np.full(count, middle) if base.told else None
    enabled = np.logical_not(within["off"])
    run = run_unit(unit, pulses, errors, told, valid, within["contact"], enabled)
    shown, largest = slice(EVERY - 1, None, EVERY), np.abs(run.currents).max(axis=0)
    tables = {
        "shift": shift,
        "scale": scale,
        "currents": run.currents[shown],
        "tolerance": np.maximum(_TOLERANCE[precision] * largest, 1e-12),
    }
    return {
        "rows": run_up.rows,
        "every": EVERY,
        "first": st_literal(float(first_part), precision),
        "change": st_literal(float(change), precision),
        "windows": run_up.windows,
        "told": st_literal(float(middle), precision),
        "test_tables": [st_table(name, x, precision) for name, x in tables.items()],
        "status": whole_numbers(run.status[shown]),
        "expected_faults": whole_numbers(run.faults[shown]),
    }


unit_structured_text.register(RunUnit, generate_run_structured_text)
