"""A unit tried on a processor: the same samples there and here, bit by bit; what a step costs."""

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.code.block.block import render
from ambrose.code.c.compiled import COMPILERS, find_compiler
from ambrose.code.processor_build import (
    WATCHED,
    Footprint,
    Link,
    Processor,
    Program,
    Unit,
    build,
    host,
    version_of,
)
from ambrose.core.checks import InvalidInput
from ambrose.core.presentation import Presented

# What a unit is driven with where nothing was recorded: random samples that meet every branch.


SEED = 20240229  # any number; the run is the same everywhere
_CORNER = 0.02  # of the error's bandwidth: the share of a new value in every sample
# shares of the run in which something is wrong
_LIMITED = (0.2, 0.3)
_WILD = (0.4, 0.42)
_LOST = (0.45, 0.5)
_NONE = (0.55, 0.57)
_CONTACT = (0.6, 0.62)
_OFF = (0.7, 0.75)
_NO_PULSE = (0.8, 0.84)
_CONTACT_BIT, _OFF_BIT = 4, 64


def stimulus(unit: Unit, count: int, seed: int = SEED) -> np.ndarray:
    """Samples (count,) as ``Unit.given`` has them, the same for a seed everywhere.

    Coloured noise of a third of the limit; a stretch near it, in which currents are limited;
    readings beyond it, flagged as lost, and not a number; what the step is told passes through its
    range and beyond, is lost, jumps; pulses of a run-up, contact, and blocks switched off.
    """
    rng = np.random.default_rng(seed)
    base = unit.base
    m = len(base.inputs)
    share = np.arange(count) / count

    def within(window: tuple[float, float]) -> np.ndarray:
        return (share >= window[0]) & (share < window[1])

    # errors: first-order coloured noise, variance one
    noise = rng.normal(size=(count, m))
    wave = np.zeros(m)
    errors = np.zeros((count, m))
    for k in range(count):
        wave = (1 - _CORNER) * wave + np.sqrt(_CORNER * (2 - _CORNER)) * noise[k]
        errors[k] = wave / 3
    errors[within(_LIMITED)] = 0.97 * np.sign(errors[within(_LIMITED)])
    errors[within(_WILD), 0] = 2.5
    counted = unit.counts(errors * base.error_limit, unit.metre)
    if counted.dtype.kind == "f":
        counted[within(_NONE), -1] = np.nan
    valid = np.ones((count, m), np.uint8)
    valid[within(_LOST), -1] = 0
    rows = np.zeros(count, unit.given("="))
    rows["error"], rows["valid"] = counted, valid
    for name, values in {**_told(unit, share, rng), **_pulses(unit, count, share)}.items():
        rows[name] = values
    return rows


def _told(unit: Unit, share: np.ndarray, rng: np.random.Generator) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    watch = unit.base.watch
    for i, (one, axis, *_) in enumerate(unit.base.over):
        low, high = float(axis[0]), float(axis[-1])
        # two passes through the range, from a twentieth below it to a twentieth above
        turns = np.abs((share * (2 + i) * 2) % 2 - 1)
        value = low + (high - low) * (1.1 * turns - 0.05)
        if watch is not None:
            value += 0.01 * watch.noise * rng.normal(size=len(share))
            value[int(0.35 * len(share))] += 0.5 * (high - low)
        value[(share > 0.88) & (share < 0.9)] = np.nan
        columns[one.name] = value
    if watch is not None:
        pressure = next(iter(columns.values()))
        columns["estimate"] = pressure + 0.1 * watch.band
        known = (share > 0.36) & (share < 0.7)
        columns["half_width"] = np.where(known, 0.2 * watch.band, -1.0)
    return columns


def _pulses(unit: Unit, count: int, share: np.ndarray) -> dict[str, Any]:
    beside = unit.law.beside
    if beside is None:
        return {}
    first, dt = beside.blocks[0], beside.sample_time
    low, high = first.band
    # a run-up within the first block's band, no faster than the blocks believe
    start = low + first.hysteresis + 0.1 * (high - low)
    slope = min(0.2 * beside.fastest, 0.5 * (high - low) / (count * dt))
    speed = start + slope * dt * np.arange(count)
    turned = np.cumsum(speed) * dt / (2 * np.pi)
    passed = turned % 1.0
    came = passed * 2 * np.pi / speed
    quiet = (share >= _NO_PULSE[0]) & (share < _NO_PULSE[1])
    fresh = (came < dt) & ~quiet
    pulses = np.where(fresh, came, -1.0)
    if np.dtype(unit.given("=")["pulse"]).kind == "i":
        # whole numbers: the limit is one sample, as an error's limit is one
        one = np.rint(unit.base.error_limit[0] / unit.metre[0])
        pulses = np.where(fresh, np.floor(came / dt * one), -1.0)
    contact = (share >= _CONTACT[0]) & (share < _CONTACT[1])
    off = (share >= _OFF[0]) & (share < _OFF[1])
    return {"pulse": pulses, "flags": _CONTACT_BIT * contact + _OFF_BIT * off}


SAMPLES = 1200
_LOGGED = 24  # samples whose instructions an emulator's log counts


@dataclass(frozen=True, slots=True, eq=False, repr=False, kw_only=True)
class Trial(Presented):
    """What a unit did on a processor.

    equal: whether every current and status is that of this computer, to the last bit; apart (p,)
    [A]: the largest differences. contracted (p,) [A]: the same with contraction of multiply and add
    (None: not tried). instructions (k,): of the steps that were counted. written [bytes]: how deep
    the stack was written, which ``footprint.stack`` must cover; clock [Hz] (None: not told);
    sample_time [s]. found, meant: checksums of the tables.
    """

    unit: Unit
    processor: Processor
    versions: tuple[str, str, str]
    samples: int
    self_test: bool
    equal: bool
    apart: np.ndarray
    contracted: np.ndarray | None
    instructions: np.ndarray
    written: int
    footprint: Footprint
    found: int
    meant: int
    identity: str
    clock: float | None

    @property
    def load(self) -> float | None:
        """Share of the sample time that the longest step takes at one instruction per cycle."""
        if self.clock is None:
            return None
        return float(self.instructions.max() / (self.clock * self.unit.base.sample_time))

    @property
    def stack(self) -> int:
        """Bytes of stack that a step needs, as accounted for or found, whichever is more."""
        return max(self.footprint.stack, self.written)

    @property
    def problems(self) -> tuple[str, ...]:
        """What speaks against this code on this processor, one sentence each."""
        name = self.processor.name
        found = [] if self.self_test else [f"the self-test fails on {name}"]
        if self.found != self.meant:
            found.append(f"on {name} the tables have another checksum than was written")
        if not self.equal:
            found.append(
                f"{name} gives other currents than this computer, apart by up to "
                f"{self.apart.max():.3g} A"
            )
        if self.written > self.footprint.stack:
            found.append(
                f"on {name} a step wrote {self.written} bytes of stack, more than the "
                f"{self.footprint.stack} that the compiler accounts for"
            )
        if self.load is not None and self.load > 1:
            found.append(
                f"a step takes {100 * self.load:.0f} % of the sample time on {name} at "
                f"{(self.clock or 0) / 1e6:g} MHz and one instruction per cycle"
            )
        return tuple(found)

    @property
    def load_text(self) -> str:
        """The load in words."""
        period = 1e6 * self.unit.base.sample_time
        if self.load is None:
            least = self.instructions.max() / self.unit.base.sample_time / 1e6
            return f"{least:.3g} MHz at least, at one instruction per cycle in {period:g} us"
        return (
            f"uses {100 * self.load:.2g} % of {period:g} us at {(self.clock or 0) / 1e6:g} MHz and "
            "one instruction per cycle"
        )

    @property
    def text(self) -> str:
        """One line of it."""
        size = self.footprint
        return (
            f"currents {self.agreement}; {self.load_text}; {self.stack} bytes of stack, "
            f"{size.flash} of flash, {size.memory} of memory"
        )

    @property
    def agreement(self) -> str:
        """How the currents are beside this computer's, in words."""
        if self.equal:
            return "equal to the last bit"
        return f"apart by up to {self.apart.max():.3g} A"

    def facts(self) -> Mapping[str, Any]:
        """Processor, agreement, load, stack, flash and memory."""
        return {
            "processor": self.processor.name,
            "self_test": self.self_test,
            "currents": self.agreement,
            "instructions": int(self.instructions.max()),
            "load": self.load_text,
            "stack_bytes": self.stack,
            "flash_bytes": self.footprint.flash,
            "memory_bytes": self.footprint.memory,
        }

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data."""
        contracted = None if self.contracted is None else float(self.contracted.max())
        return {
            **self.facts(),
            "equal": self.equal,
            "largest_difference": float(self.apart.max(initial=0.0)),
            "contracted_difference": contracted,
            "identity": self.identity,
            "checksum": f"0x{self.found:08X}",
            "problems": list(self.problems),
        }

    def report(self) -> str:
        """The page of it in Markdown, for the delivery."""
        unit, processor = self.unit, self.processor
        print_ = self.footprint
        limit = float(unit.base.current_limit.max())
        contracted = None
        if self.contracted is not None:
            most = float(self.contracted.max())
            contracted = f"apart by up to {most:.2g} A, {most / limit:.1g} of the largest current"
        outside = f", without {', '.join(print_.outside)}" if print_.outside else ""
        bound = "least" if print_.outside else "most"
        below = "at least " if self.written >= WATCHED else ""
        frame = processor.exception_frame
        frame_text = f"; an interrupt adds {frame} bytes of its own" if frame else ""
        library = f", of it {print_.library} of the compiler's library" if print_.library else ""
        counter = {
            "cortex-m": "SysTick under -icount",
            "cortex-r": "cycle counter under -icount",
            "linux": "log of executed instructions",
        }
        facts = {
            "name": unit.base.name,
            "title": processor.title,
            "arithmetic": unit.arithmetic,
            "double": f"double precision {processor.double}",
            "compiler": self.versions[0],
            "emulator": self.versions[1],
            "host": self.versions[2],
            "self_test": self.self_test,
            "intact": self.found == self.meant,
            "identity": self.identity,
            "samples": self.samples,
            "agreement": self.agreement,
            "contracted": contracted,
            "mean": round(float(self.instructions.mean())),
            "most": int(self.instructions.max()),
            "load": self.load_text,
            "stack": f"{print_.stack} bytes at {bound}{outside}; {below}{self.written} bytes found "
            f"written{frame_text}",
            "flash": f"{print_.flash} bytes{library}",
            "memory": f"{print_.memory} bytes",
            "counted": counter[processor.kind],
            "counted_samples": len(self.instructions),
        }
        return render("trial.md.j2", facts)


def check_trial(processor: Processor, arithmetic: str) -> str:
    """The compiler of this computer, to compare with. Raises InvalidInput for what a trial lacks,
    before anything is computed.
    """
    processor.check(arithmetic)
    compiler = find_compiler()
    if compiler is None:
        raise InvalidInput(
            f"a trial compares with this computer, which has no C compiler {' or '.join(COMPILERS)}"
            "; install one, or leave try_on out"
        )
    return compiler


def check_room(
    unit: Unit, processor: Processor, flash: float | None = None, memory: float | None = None
) -> None:
    """Refuse code that is larger than flash or memory [bytes]. Raises InvalidInput."""
    if flash is None and memory is None:
        return
    with tempfile.TemporaryDirectory(prefix="ambrose-") as folder:
        needed = build(unit, processor, Path(folder)).footprint
    remedy = "reduce the controller's order, or choose float or fixed point"
    rooms = (("flash", needed.flash, flash), ("memory", needed.memory + needed.stack, memory))
    for what, size, room in rooms:
        if room is not None and size > room:
            raise InvalidInput(
                f"the code needs {size} bytes of {what} on {processor.name}, but only {room:.0f} "
                f"are there; {remedy}"
            )


def try_unit(
    unit: Unit,
    processor: Processor,
    *,
    clock: float | None = None,
    samples: np.ndarray | None = None,
    contraction: bool = True,
    progress: Callable[[str], None] = lambda stage: None,
) -> Trial:
    """Run a unit on a processor and on this computer, over the same samples.

    clock [Hz]: of the processor. samples: as ``Unit.given`` has them, recorded ones for instance
    (None: ``stimulus``). contraction: also with a compiler that may round a product and a sum at
    once. Raises InvalidInput.
    """
    compiler = check_trial(processor, unit.arithmetic)
    rows = stimulus(unit, SAMPLES) if samples is None else samples
    here = host(compiler)
    with tempfile.TemporaryDirectory(prefix="ambrose-") as folder:
        progress("compiling and running on this computer")
        own = build(unit, here, Path(folder, "host"))
        with Link(unit, here, own) as link:
            meant = link.steps(rows)
        progress(f"compiling for {processor.name} and running there")
        program = build(unit, processor, Path(folder, "target"))
        with Link(unit, processor, program) as link:
            passed = link.self_test()
            link.begin()
            found = link.steps(rows)
            sums = link.checksum()
        instructions = _instructions(unit, processor, program, rows, found)
        fused = None
        if contraction and unit.arithmetic in {"double", "float"}:
            other = build(unit, processor, Path(folder, "fused"), contraction=True)
            with Link(unit, processor, other) as link:
                fused = _apart(unit, link.steps(rows), meant)
    same = all(
        np.array_equal(found[name].astype(meant[name].dtype), meant[name])
        for name in ("current", "status", "faults")
    )
    return Trial(
        unit=unit,
        processor=processor,
        versions=(
            version_of(processor.compiler),
            version_of(processor.emulator[0]),
            version_of(compiler),
        ),
        samples=len(rows),
        self_test=passed,
        equal=same,
        apart=_apart(unit, found, meant),
        contracted=fused,
        instructions=instructions,
        written=int(found["stack"].max()),
        footprint=program.footprint,
        found=sums[0],
        meant=sums[1],
        identity=sums[2],
        clock=clock,
    )


def _apart(unit: Unit, found: np.ndarray, meant: np.ndarray) -> np.ndarray:
    """Largest differences of the currents (p,) [A]."""
    difference = np.abs(found["current"].astype(float) - meant["current"].astype(float))
    return (difference * unit.ampere).max(axis=0)


def _instructions(
    unit: Unit, processor: Processor, program: Program, rows: np.ndarray, found: np.ndarray
) -> np.ndarray:
    """Instructions of steps: of all, or by the emulator's log of a few, among them limited ones."""
    if processor.kind != "linux":
        return found["instructions"].astype(int)
    limited = np.flatnonzero(found["status"] & 4)
    first = int(limited[0]) if len(limited) else 0
    start = 0 if unit.law.beside else max(0, first - _LOGGED // 2)  # synchronous blocks need pulses
    with Link(unit, processor, program, counting=True) as link:
        link.steps(rows[start : first + _LOGGED // 2])
    return np.array(link.counted(), int)
