"""An example to start from: a law's code on a processor without an operating system, with timer,
two buffers and watchdog, and an emulated board that it runs on.
"""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, cast

import numpy as np

from ambrose.code.block.block import Block, ControlBlock, render
from ambrose.code.block.fixed_point import in_words
from ambrose.code.c.code import Arithmetic, integer_table, law_files, literal, real_table
from ambrose.code.interface import KINDS, TYPES, Interface, Law, interface_of
from ambrose.core.checks import InvalidInput, invalid

# The processors on which exported code can be tried: how each is compiled for, and what runs it.
#
# All of it is free-standing: no C library of the target is needed, only its compiler. QEMU
# interprets the instructions of the processor; its floating-point arithmetic is IEEE 754's, as the
# processors' is. It is no model of pipelines, caches and memories: it counts instructions, not
# cycles.


# nanoseconds of virtual time for an instruction, as a power of two: SysTick's 25 MHz resolve one
COUNT_SHIFT = 8
_PROBE_TIME = 20.0  # s
_CORTEX_M = ("qemu-system-arm", "-display", "none", "-monitor", "none", "-serial", "none")
_SEMIHOSTING = ("-semihosting-config", "enable=on,target=native")


@dataclass(frozen=True, slots=True, kw_only=True)
class Processor:
    """A processor that code can be tried on.

    title: what it is. compiler: command of the cross compiler, flags: what it is told of the
    processor, package: Debian's that holds it. emulator: its command, {program} for the program,
    emulator_package. kind: which start-up code it needs, "cortex-m", "cortex-r", "linux" or "host".
    order: byte order, "<" or ">". double: how it computes in double precision. exception_frame
    [bytes]: what an interrupt puts on the stack by itself. library: the compiler's
    own, as the linker is told.
    """

    name: str
    title: str
    compiler: str
    flags: tuple[str, ...]
    package: str
    emulator: tuple[str, ...]
    emulator_package: str
    kind: str
    order: str = "<"
    double: str = "in hardware"
    exception_frame: int = 0
    library: str = "-lgcc"

    def tool(self, name: str) -> str:
        """A program of the compiler's family, such as ``size``."""
        return self.compiler.removesuffix("gcc") + name

    def check(self, arithmetic: str) -> None:
        """Refuse what cannot be tried here, before anything is computed. Raises InvalidInput."""
        for program, package in (
            (self.compiler, self.package),
            (self.emulator[0] if self.emulator else "", self.emulator_package),
        ):
            if program and not shutil.which(program):
                raise InvalidInput(
                    f"{self.name} needs {program}, which is not on this computer; install it "
                    f"(Debian: apt install {package}), or leave try_on out"
                )
        bits = mantissa(self.compiler, self.flags, "DBL")
        if arithmetic == "double" and bits != 53:
            raise InvalidInput(
                f"{self.name} has no double precision: {self.compiler} gives double {bits} bits of "
                "mantissa; export in float or fixed point (arithmetic)"
            )


@cache
def mantissa(compiler: str, flags: tuple[str, ...], kind: str) -> int:
    """Bits of the mantissa of double ("DBL") or float ("FLT") as a compiler has them. Raises
    InvalidInput for a compiler that does not answer.
    """
    macros = _answer([compiler, *flags, "-dM", "-E", "-x", "c", "-"])
    bits = re.search(rf"#define __{kind}_MANT_DIG__ (\d+)", macros)
    return int(bits[1]) if bits else 0


def version_of(command: str) -> str:
    """The first line that a program says of its version. Raises InvalidInput for one that does not
    answer.
    """
    return (_answer([command, "--version"]).splitlines() or [command])[0].strip()


def _answer(command: Sequence[str]) -> str:
    """What a program says at once. Raises InvalidInput for one that does not answer."""
    try:
        return subprocess.run(
            command, input="", capture_output=True, text=True, timeout=_PROBE_TIME, check=True
        ).stdout
    except (OSError, subprocess.SubprocessError) as error:
        raise InvalidInput(f"{command[0]} does not answer ({error}); install it anew") from error


_LISTED = (
    Processor(
        name="cortex-m7",
        title="Arm Cortex-M7, floating-point unit for double and single precision",
        compiler="arm-none-eabi-gcc",
        flags=("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "-DCORTEX_M"),
        package="gcc-arm-none-eabi",
        emulator=(*_CORTEX_M, *_SEMIHOSTING, "-M", "mps2-an500", "-kernel", "{program}"),
        emulator_package="qemu-system-arm",
        kind="cortex-m",
        exception_frame=108,  # Armv7-M, B1.5.7: eight words, 16 + 1 floating-point registers, align
    ),
    Processor(
        name="cortex-m4",
        title="Arm Cortex-M4, floating-point unit for single precision",
        compiler="arm-none-eabi-gcc",
        flags=("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-DCORTEX_M"),
        package="gcc-arm-none-eabi",
        emulator=(*_CORTEX_M, *_SEMIHOSTING, "-M", "mps2-an386", "-kernel", "{program}"),
        emulator_package="qemu-system-arm",
        kind="cortex-m",
        double="in software",
        exception_frame=108,
    ),
    Processor(
        name="cortex-r5",
        title="Arm Cortex-R5F, floating-point unit for double and single precision",
        compiler="arm-none-eabi-gcc",
        flags=("-mcpu=cortex-r5", "-mthumb", "-mfpu=vfpv3-d16", "-mfloat-abi=hard"),
        package="gcc-arm-none-eabi",
        emulator=(
            *_CORTEX_M,
            *_SEMIHOSTING,
            *("-M", "none", "-cpu", "cortex-r5f", "-m", "16M"),
            *("-device", "loader,file={program},cpu-num=0"),
        ),
        emulator_package="qemu-system-arm",
        kind="cortex-r",
    ),
    Processor(
        name="cortex-r5-big-endian",
        title="Arm Cortex-R5F, most significant byte first",
        compiler="arm-none-eabi-gcc",
        flags=("-mcpu=cortex-r5", "-mthumb", "-mfpu=vfpv3-d16", "-mfloat-abi=hard", "-mbig-endian"),
        package="gcc-arm-none-eabi",
        emulator=("qemu-armeb", "-cpu", "cortex-r5f", "{program}"),
        emulator_package="qemu-user",
        kind="linux",
        order=">",
        library="",
    ),
    Processor(
        name="aarch64",
        title="Arm 64 bit, Cortex-A53",
        compiler="aarch64-linux-gnu-gcc",
        flags=("-mcpu=cortex-a53",),
        package="gcc-aarch64-linux-gnu",
        emulator=("qemu-aarch64", "{program}"),
        emulator_package="qemu-user",
        kind="linux",
    ),
    Processor(
        name="riscv64",
        title="RISC-V 64 bit, RV64GC",
        compiler="riscv64-linux-gnu-gcc",
        flags=("-march=rv64gc", "-mabi=lp64d", "-mno-relax"),
        package="gcc-riscv64-linux-gnu",
        emulator=("qemu-riscv64", "{program}"),
        emulator_package="qemu-user",
        kind="linux",
    ),
    Processor(
        name="ppc64",
        title="PowerPC 64 bit, most significant byte first",
        compiler="powerpc64-linux-gnu-gcc",
        flags=("-mcpu=power7", "-mno-vsx", "-mno-altivec", "-mabi=elfv2"),
        package="gcc-powerpc64-linux-gnu",
        emulator=("qemu-ppc64", "{program}"),
        emulator_package="qemu-user",
        kind="linux",
        order=">",
    ),
)
PROCESSORS = {item.name: item for item in _LISTED}


def processor_named(name: str) -> Processor:
    """The processor of a name. Raises InvalidInput."""
    if name not in PROCESSORS:
        raise invalid("try_on", repr(name), f"one of {', '.join(PROCESSORS)}", "choose one of them")
    return PROCESSORS[name]


def host(compiler: str) -> Processor:
    """This computer, with its own compiler."""
    return Processor(
        name="host",
        title="this computer",
        compiler=compiler,
        flags=(),
        package=compiler,
        emulator=(),
        emulator_package="",
        kind="host",
        double="in hardware",
    )


# What is tried: a block, or a block with synchronous blocks beside it, as its files, and what a
# sample of it is in bytes.


@dataclass(frozen=True, slots=True, eq=False)
class Unit:
    """The code of a law in one arithmetic.

    law: the block, or a ``RunUnit``; files: its texts by name; base: its controller block.
    metre (m,) [m], ampere (p,) [A]: one count of an error and of a current.
    """

    law: Law
    arithmetic: Arithmetic
    files: Mapping[str, str]
    metre: np.ndarray
    ampere: np.ndarray

    @property
    def base(self) -> Block:
        return self.law.base

    @property
    def interface(self) -> Interface:
        """The arguments of its step."""
        return interface_of(self.law, self.arithmetic)

    @property
    def self_test(self) -> str:
        return f"{self.interface.name}_test.c"

    @property
    def step(self) -> str:
        """The function that runs once a sample."""
        return f"{self.interface.name}_step"

    def given(self, order: str) -> np.dtype[Any]:
        """A sample as the processor takes it; order: of its bytes."""
        return np.dtype([one.field(order) for one in self.interface.arguments if one.given])

    def answered(self, order: str) -> np.dtype[Any]:
        """What it answers: currents, status, faults of the synchronous blocks, instructions of the
        step, and how deep the stack was written [bytes].
        """
        marks = [(name, f"{order}u4") for name in ("status", "faults", "instructions", "stack")]
        return np.dtype([self.interface.arguments[-1].field(order), *marks])

    def stored(self, order: str) -> np.dtype[Any]:
        """A state in memory."""
        return np.dtype(f"{order}{KINDS[TYPES[self.arithmetic][1]]}")

    def counts(self, values: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Values as numbers of the code, to the nearest and within the word, as a converter has
        them.
        """
        scaled = np.asarray(values, float) / unit
        kind = np.dtype(KINDS[TYPES[self.arithmetic][0]])
        if kind.kind == "f":
            return scaled.astype(kind)
        ends = np.iinfo(kind)
        return np.clip(np.rint(scaled), ends.min, ends.max).astype(kind)

    def driver_facts(self) -> dict[str, Any]:
        """What the driver's template says of it."""
        base, face = self.base, self.interface
        names = "".join(f", {one.name}" for one in face.arguments)
        return {
            "name": base.name,
            "prefix": base.name.upper(),
            "header": f"{face.name}.h",
            "unit": face.memory,
            "block": "running.base" if self.law.beside else "running",
            "beside": bool(self.law.beside),
            "told": base.told,
            "arguments": face.arguments,
            "ni": len(base.inputs),
            "no": len(base.outputs),
            "states": base.n_states,
            "low": base.padding[0],
            "init": f"{face.name}_init",
            "step": f"{self.step}(&running{names})",
        }


def unit_of(
    law: Law, arithmetic: Arithmetic = "double", files: Mapping[str, str] | None = None
) -> Unit:
    """The code of a law; files: its texts where they were written already. Raises InvalidInput, as
    ``generate`` does.
    """
    base, files = law.base, law_files(law, arithmetic) if files is None else dict(files)
    metre, ampere = np.ones(len(base.inputs)), np.ones(len(base.outputs))
    if arithmetic not in {"double", "float"}:
        fixed = in_words(cast(ControlBlock, base), int(arithmetic.removeprefix("fixed")))
        one = 2.0**fixed.signal_bits
        metre, ampere = base.error_limit / one, base.current_limit / one
    return Unit(law, arithmetic, files, metre, ampere)


# How deep a function of a program writes the stack, by its instructions: for what the compiler
# gives no account of, such as its own library of soft-float arithmetic, written in assembler.
#
# Arm's A32 and T32 (Arm Architecture Reference Manual, Armv7-M, DDI 0403, A7.7), as ``objdump``
# writes them. All paths from the first instruction are walked with what the stack pointer has been
# moved by; a conditional push counts as taken, a conditional pop as not.


_CONDITION = "eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le"
_LINE = re.compile(r"^[ \t]*([0-9a-f]+):[ \t]+(\S+)(?:[ \t]+([^;@\n]*))?", re.M)
_BRANCH = re.compile(rf"b({_CONDITION})?|(cbn?z)")
_CALL = re.compile(rf"blx?({_CONDITION})?")
_LEAVE = re.compile(rf"bx({_CONDITION})?")
_PUSHED = re.compile(rf"(v?push|v?stmdb|stmfd)({_CONDITION})?")
_POPPED = re.compile(rf"(v?pop|v?ldmia|ldmfd|v?ldm)({_CONDITION})?")
_SAVED = re.compile(rf"str[bhd]?({_CONDITION})?")
_LOADED = re.compile(rf"ldr[bhd]?({_CONDITION})?")
_MOVED = re.compile(rf"(add|sub)w?s?({_CONDITION})?")
_RANGE = re.compile(r"([rsd])(\d+)(?:-[rsd](\d+))?|ip|lr|pc|sp|fp|sl")
_TARGET = re.compile(r"([0-9a-f]+) <")
_DEEPEST = 65536  # bytes: beyond it the walk does not end


class Unwalked(Exception):
    """Instructions that move the stack pointer, or jump, in a way that is not followed."""


@dataclass(frozen=True, slots=True)
class _Step:
    """An instruction: bytes that it pushes; where it may go on, whom it calls, whether it ends."""

    pushed: int = 0
    to: int | None = None
    called: int | None = None
    ends: bool = False


def listed(text: str) -> dict[int, tuple[str, str]]:
    """Mnemonic and operands by address, from ``objdump -d --no-show-raw-insn``."""
    return {
        int(at, 16): (name.removesuffix(".w").removesuffix(".n"), rest.strip())
        for at, name, rest in _LINE.findall(text)
    }


def written_below(code: Mapping[int, tuple[str, str]], entry: int) -> int:
    """Bytes below the caller's stack pointer that a call of the function at entry may write.

    code: as ``listed``. Raises Unwalked where this cannot be told.
    """
    return _walk(dict(zip(code, [*list(code)[1:], -1], strict=True)), code, entry, {}, ())


def _walk(
    after: Mapping[int, int],
    code: Mapping[int, tuple[str, str]],
    entry: int,
    known: dict[int, int],
    above: tuple[int, ...],
) -> int:
    """As ``written_below``. after: address of the next instruction in memory; known: functions that
    were walked, above: those that are being walked.
    """
    if entry in known:
        return known[entry]
    if entry in above:
        raise Unwalked("a function that calls itself")
    reached: dict[int, int] = {}
    waiting = [(entry, 0)]
    most = 0
    while waiting:
        at, depth = waiting.pop()
        if reached.get(at, -1) >= depth:
            continue
        if at not in code or depth > _DEEPEST:
            raise Unwalked(f"the instructions from {at:x} on")
        reached[at] = depth
        step = _step(*code[at])
        # a callee works below what is pushed so far
        if step.called is not None:
            within = _walk(after, code, step.called, known, (*above, entry))
            most = max(most, depth + within)
        depth = max(0, depth + step.pushed)
        most = max(most, depth)
        if step.to is not None:
            waiting.append((step.to, depth))
        if not step.ends:
            waiting.append((after[at], depth))
    known[entry] = most
    return most


def _step(name: str, rest: str) -> _Step:
    """What an instruction, mnemonic and operands, does to stack and flow. Raises Unwalked."""
    step = _jumps(name, rest) or _moves(name, rest)
    if step is not None:
        return step
    # whatever else writes the stack pointer or the program counter is not followed
    first = rest.split(",", maxsplit=1)[0].strip().rstrip("!")
    writes = not name.startswith(("str", "cmp", "cmn", "tst", "teq", "vstr", "stm", "vstm"))
    if name in {"tbb", "tbh"} or (writes and first in {"sp", "pc"}):
        raise Unwalked(f"{name} {rest}")
    return _Step()


def _jumps(name: str, rest: str) -> _Step | None:
    """A branch, a call or a return; None for others. Conditional ones also go on behind them."""
    target = _TARGET.search(rest)
    to = int(target[1], 16) if target else None
    if match := _BRANCH.fullmatch(name):
        if to is None:
            raise Unwalked(f"{name} {rest}")
        return _Step(to=to, ends=not (match[1] or match[2]))
    if _CALL.fullmatch(name):
        if to is None:
            raise Unwalked(f"{name} {rest}")
        return _Step(called=to)
    if match := _LEAVE.fullmatch(name):
        if rest != "lr":
            raise Unwalked(f"{name} {rest}")
        return _Step(ends=not match[1])
    if name == "mov" and rest == "pc, lr":
        return _Step(ends=True)
    return None


def _moves(name: str, rest: str) -> _Step | None:
    """What moves the stack pointer by a number that stands in the instruction; None for others."""
    listing = rest.startswith(("{", "sp!"))
    if listing and _PUSHED.fullmatch(name):
        return _Step(pushed=_size(rest))
    if listing and (match := _POPPED.fullmatch(name)):
        back = bool(re.search(r"\bpc\b", rest))
        return _Step(pushed=0 if match[2] else -_size(rest), ends=back and not match[2])
    if _SAVED.fullmatch(name) and (moved := re.search(r"\[sp, #-(\d+)\]!", rest)):
        return _Step(pushed=int(moved[1]))
    if (match := _LOADED.fullmatch(name)) and (moved := re.search(r"\[sp\], #(\d+)", rest)):
        back = rest.startswith("pc,")
        return _Step(pushed=0 if match[1] else -int(moved[1]), ends=back and not match[1])
    if (match := _MOVED.fullmatch(name)) and (moved := re.fullmatch(r"sp, (?:sp, )?#(\d+)", rest)):
        taken = int(moved[1])
        if match[1] == "sub":
            return _Step(pushed=taken)
        return _Step(pushed=0 if match[2] else -taken)
    return None


def _size(listing: str) -> int:
    """Bytes of the registers of a list."""
    total = 0
    for match in _RANGE.finditer(listing.partition("{")[2]):
        count = int(match[3]) - int(match[2]) + 1 if match[3] else 1
        total += count * (8 if match[1] == "d" else 4)
    return total


# Code compiled for a processor: the program, and what it takes of flash, memory and stack.


WATCHED = 4096  # bytes of stack, as the driver watches them
_TIME_LIMIT = 120.0  # s
_BASE = ("-std=c99", "-O2", "-Wall", "-Wextra")
_FREE = ("-ffreestanding", "-fno-tree-loop-distribute-patterns", "-nostdlib", "-static")
_PLACES = {"cortex-m": ("0x00000000", "0x20000000"), "cortex-r": ("0x00000000", "0x00800000")}
_NODE = re.compile(r'node: \{ title: "([^"]+)" label: "([^"]*)"')
_EDGE = re.compile(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"')
_BYTES = re.compile(r"(\d+) bytes \((static|dynamic,bounded)\)")
_MAPPED = re.compile(r"^ \.(?:text|rodata)\S*\s+0x[0-9a-f]+\s+0x([0-9a-f]+)\s+(\S+)", re.M)


@dataclass(frozen=True, slots=True)
class Footprint:
    """What the code takes, without the driver.

    flash [bytes]: code, tables and what of the compiler's own library is linked for it; library
    [bytes]: of it the last. memory [bytes]: the block and all that is static. stack [bytes]: what
    the step may write below its caller's stack pointer, along its deepest path: the compiler's
    frames, and of its library the instructions; outside: the functions on a path of which neither
    is known, so that stack is no bound. Arguments that are passed on the stack are the caller's.
    """

    flash: int
    library: int
    memory: int
    stack: int
    outside: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Program:
    """A linked program in a folder, its footprint, and the addresses of its functions."""

    path: Path
    footprint: Footprint
    symbols: dict[str, int]


def build(unit: Unit, processor: Processor, folder: Path, contraction: bool = False) -> Program:
    """Compile a unit with the driver. contraction: whether the compiler may round a product and a
    sum at once (-ffp-contract). Raises InvalidInput with what the compiler said.
    """
    folder.mkdir(parents=True, exist_ok=True)
    places = dict(zip(("code", "data"), _PLACES.get(processor.kind, ("0", "0")), strict=True))
    facts = {**unit.driver_facts(), **places, "shift": COUNT_SHIFT, "watched": WATCHED}
    start = {"cortex-m": "semihosting.c", "cortex-r": "semihosting.c"}.get(
        processor.kind, f"{processor.kind}.c"
    )
    free = processor.kind != "host"
    driver = ["driver.c", start, *(["memory.c"] if free else [])]
    support = [*driver, "support.h", *(["stdio.h", "limits.h", "memory.ld"] if free else [])]
    for name, text in unit.files.items():
        (folder / name).write_text(text, encoding="utf-8")
    for name in support:
        (folder / name).write_text(render(f"target/{name}.j2", facts), encoding="utf-8")

    # every source by itself, with the compiler's account of frames and calls
    contract = f"-ffp-contract={'fast' if contraction else 'off'}"
    flags = [*processor.flags, *_BASE, contract, *(_FREE[:2] if free else ())]
    counted = ["-fstack-usage", "-fcallgraph-info=su"] if free else []
    objects = []
    for name in (*unit.interface.sources, unit.self_test, *driver):
        std = ["-std=gnu99"] if name in driver else []
        renamed = ["-Dmain=self_test"] if name == unit.self_test else []
        target = f"{name.removesuffix('.c')}.o"
        _run(
            [processor.compiler, *flags, *std, *renamed, *counted, "-I.", "-c", name, "-o", target],
            folder,
        )
        objects.append(target)
    link = [*_FREE[2:], "-Wl,-Map=program.map", "-Wl,--build-id=none"] if free else []
    link += ["-T", "memory.ld"] if processor.kind in _PLACES else []
    last = [processor.library] if free and processor.library else []
    _run([processor.compiler, *flags, *link, *objects, *last, "-o", "program"], folder)
    if not free:
        return Program(folder / "program", Footprint(0, 0, 0, 0, ()), {})
    symbols = _symbols(processor, folder)
    return Program(folder / "program", _footprint(unit, processor, folder, symbols), symbols)


def _footprint(
    unit: Unit, processor: Processor, folder: Path, symbols: Mapping[str, int]
) -> Footprint:
    """The footprint of a linked program, by the compiler's tools; symbols: addresses by name."""
    sizes = _run(
        [processor.tool("size"), *(f"{n.removesuffix('.c')}.o" for n in unit.interface.sources)],
        folder,
    )
    rows = [[int(v) for v in line.split()[:3]] for line in sizes.splitlines()[1:]]
    text, data, bss = (sum(row[i] for row in rows) for i in range(3))
    mapped = (folder / "program.map").read_text(encoding="utf-8", errors="replace")
    joined = re.sub(r"^( \.\S+)\n\s+", r"\1 ", mapped, flags=re.M)  # long names stand alone
    library = sum(int(size, 16) for size, source in _MAPPED.findall(joined) if "libgcc.a" in source)
    block = int(_symbol_size(processor, folder, "running"))
    stack, outside = _deepest(folder, unit, _library(processor, folder, symbols))
    return Footprint(text + data + library, library, data + bss + block, stack, outside)


def _symbols(processor: Processor, folder: Path) -> dict[str, int]:
    """The addresses of the program's functions and variables by name."""
    lines = (line.split() for line in _run([processor.tool("nm"), "program"], folder).splitlines())
    return {parts[2]: int(parts[0], 16) for parts in lines if len(parts) == 3}


def _symbol_size(processor: Processor, folder: Path, name: str) -> int:
    """The size [bytes] of a variable of the driver, 0 without it."""
    listed = _run([processor.tool("nm"), "-S", "driver.o"], folder)
    for parts in (line.split() for line in listed.splitlines()):
        if len(parts) == 4 and parts[3] == name:
            return int(parts[1], 16)
    return 0


def _graph(paths: Sequence[Path]) -> tuple[dict[str, int | None], dict[str, set[str]]]:
    """Frames [bytes] (None: unknown) and calls of all functions, by the compiler's call graphs."""
    frames: dict[str, int | None] = {}
    calls: dict[str, set[str]] = {}
    for path in paths:
        text = path.read_text(encoding="utf-8", errors="replace")
        for title, label in _NODE.findall(text):
            known = _BYTES.search(label)
            if known or title not in frames:
                frames[title] = int(known[1]) if known else None
        for source, target in _EDGE.findall(text):
            calls.setdefault(source, set()).add(target)
    return frames, calls


def _deepest(
    folder: Path, unit: Unit, library: Callable[[str], int | None]
) -> tuple[int, tuple[str, ...]]:
    """Of the step: the sum of frames along its deepest path, and what on any path is unknown.

    library: what a function of the compiler's own takes with all that it calls (None: unknown).
    """
    names = [*unit.interface.sources, "memory.c"]
    frames, calls = _graph([folder / f"{name.removesuffix('.c')}.ci" for name in names])
    outside: set[str] = set()

    def depth(name: str, above: tuple[str, ...]) -> int:
        frame = frames.get(name)
        if frame is None:
            frame = library(name)
        if frame is None or name in above:  # unknown, or as deep as it calls itself
            outside.add(name)
            return 0
        return frame + max((depth(one, (*above, name)) for one in calls.get(name, ())), default=0)

    return depth(unit.step, ()), tuple(sorted(outside))


def _library(
    processor: Processor, folder: Path, symbols: Mapping[str, int]
) -> Callable[[str], int | None]:
    """What a function of the compiler's library takes of stack [bytes], by its instructions."""
    if not processor.compiler.startswith("arm-none-eabi"):
        return lambda name: None

    @cache
    def instructions() -> dict[int, tuple[str, str]]:
        return listed(
            _run([processor.tool("objdump"), "-d", "--no-show-raw-insn", "program"], folder)
        )

    def below(name: str) -> int | None:
        if name not in symbols:
            return None
        try:
            return written_below(instructions(), symbols[name] & ~1)  # bit 0: Thumb
        except Unwalked:
            return None

    return below


def _run(command: Sequence[str], folder: Path) -> str:
    """What a tool prints. Raises InvalidInput with its message."""
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            timeout=_TIME_LIMIT,
            check=False,
            stdin=subprocess.DEVNULL,
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise InvalidInput(f"{command[0]} cannot be run here: {error}; install it again") from error
    if done.returncode:
        raise InvalidInput(
            f"{command[0]} refused the code: {done.stderr.strip()[:500]}; install another release"
        )
    return done.stdout


# A program on its processor, in an emulator, and the pipe that it takes samples from and gives
# currents to.


_PATIENCE = 60.0  # [s] for one answer, which takes a tenth of a second
_LOOK = 1.0  # [s] between two looks at it
_AT_ONCE = 64  # samples on the way: less than a pipe holds
_LEAVE_LINK, _INIT, _SELF_TEST, _STEPS, _STATES, _IDENTITY, _STEPS_ALONE = range(7)
_HELLO = (
    0x01020304  # first word of the program; every byte of it differs, so that a wrong order shows
)
_PC = re.compile(rb"Trace \d+: \S+ \[[0-9a-f]+/0*([0-9a-f]+)/")


class Link:
    """A running program. A context: the emulator ends with it, whatever happens."""

    def __init__(
        self, unit: Unit, processor: Processor, program: Program, *, counting: bool = False
    ) -> None:
        """counting: of a processor whose instructions the emulator's log counts, write that log
        (slow). Raises InvalidInput where the program does not answer.
        """
        self.unit = unit
        self.processor = processor
        self.given, self.answered = unit.given(processor.order), unit.answered(processor.order)
        self._word = np.dtype(f"{processor.order}u4")
        self._log: Path | None = None
        command = [
            part.replace("{program}", str(program.path))
            for part in processor.emulator or ("{program}",)
        ]
        if processor.kind in {"cortex-m", "cortex-r"}:
            shift = COUNT_SHIFT if processor.kind == "cortex-m" else 0
            command += ["-icount", f"shift={shift},sleep=off"]
        elif counting and processor.kind == "linux":
            self._log = program.path.with_name("instructions.log")
            logged = ["-singlestep", "-d", "exec,nochain", "-D", str(self._log)]
            command[1:1] = logged
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - closed with the link
        self._process = subprocess.Popen(
            command,
            cwd=program.path.parent,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            bufsize=0,
        )
        self._program = program
        # when an answer is due, by the clock that ``_watch`` looks at, and whether it was overdue
        self._due, self._late = math.inf, False
        self._over = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()
        try:
            if self._answer_word() != _HELLO:
                raise InvalidInput(
                    f"the program on {processor.name} does not answer in its byte order"
                )
            self.memory = self._answer_word()
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Link:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the program."""
        self._over.set()
        process = self._process
        if process.poll() is None:
            try:
                self._say(_LEAVE_LINK)
                process.wait(timeout=5)
            except (OSError, InvalidInput, subprocess.TimeoutExpired):
                process.kill()
                process.wait()
        for stream in (process.stdin, process.stdout, self._errors):
            if stream is not None:
                stream.close()

    def begin(self) -> None:
        """Everything as after the first call of init."""
        self._say(_INIT)

    def self_test(self) -> bool:
        """Whether the self-test that is delivered passes there."""
        self._say(_SELF_TEST)
        return self._answer_word() == 0

    def checksum(self) -> tuple[int, int, str]:
        """CRC of the tables as the program reads them, as it was written, and its identity."""
        self._say(_IDENTITY)
        computed, written = self._answer_word(), self._answer_word()
        text = b""
        while not text.endswith(b"\0"):
            text += self._read(1)
        return computed, written, text[:-1].decode("ascii", "replace")

    def steps(self, samples: np.ndarray, *, watching: bool = True) -> np.ndarray:
        """Answers (k,) to samples (k,), as ``Unit.given`` and ``answered`` have them; watching: how
        deep the stack is written (slow).
        """
        answers = []
        what = _STEPS if watching and self._log is None else _STEPS_ALONE
        for i in range(0, len(samples), _AT_ONCE):
            part = samples[i : i + _AT_ONCE].astype(self.given)
            self._say(what, len(part))
            self._write(part.tobytes())
            answers.append(self._read(len(part) * self.answered.itemsize))
        return np.frombuffer(b"".join(answers), self.answered)

    def set_states(self, states: np.ndarray) -> None:
        """The states (n,) as numbers of the code."""
        self._say(_STATES)
        self._write(states.astype(self.unit.stored(self.processor.order)).tobytes())

    def counted(self) -> list[int]:
        """Instructions of every step so far by the emulator's log; after ``close``."""
        if self._log is None:
            return []
        begin, end = (self._program.symbols[name] for name in ("counting", "counted"))
        counts = []
        count, within = 0, False
        for at in _traced(self._log):
            if at == begin:
                count, within = 0, True
            elif at == end and within:
                counts.append(count)
                within = False
            elif within:
                count += 1
        return counts

    def _say(self, *words: int) -> None:
        """A request: its number and what it takes, as words."""
        self._write(np.array(words, self._word).tobytes())

    def _answer_word(self) -> int:
        """The next word of an answer."""
        return int(np.frombuffer(self._read(4), self._word)[0])

    def _write(self, content: bytes) -> None:
        """All of it into the program's pipe. Raises InvalidInput where the program ended."""
        stream: Any = self._process.stdin
        self._due = time.monotonic() + _PATIENCE
        try:
            while content:
                content = content[stream.write(content) :]
            self._due = math.inf
        except OSError as error:
            raise InvalidInput(self._ended()) from error

    def _read(self, count: int) -> bytes:
        """So many bytes of its answer. Raises InvalidInput where the program ended."""
        stream: Any = self._process.stdout
        content = b""
        self._due = time.monotonic() + _PATIENCE
        while len(content) < count:
            part = stream.read(count - len(content))
            if not part:
                raise InvalidInput(self._ended())
            content += part
        self._due = math.inf
        return content

    def _watch(self) -> None:
        """Ends a program that owes an answer for too long: who waits for it reads its end."""
        while not self._over.wait(_LOOK):
            if time.monotonic() > self._due:
                self._late = True
                self._process.kill()
                return

    def _ended(self) -> str:
        """Why the program ended before it answered, in words."""
        runs = self.processor.emulator[0] if self.processor.emulator else "this computer"
        if self._late:
            return (
                f"the program on {self.processor.name} did not answer within {_PATIENCE:g} s and "
                f"was ended; see that {runs} runs here"
            )
        self._errors.seek(0)
        said = self._errors.read().decode("utf-8", "replace").strip()[-300:]
        return (
            f"the program on {self.processor.name} ended too soon ({said or 'without a word'}); "
            f"see that {runs} runs here"
        )


def _traced(path: Path) -> Iterator[int]:
    """The addresses of the instructions in an emulator's log, in their order."""
    with path.open("rb") as lines:
        for line in lines:
            match = _PC.match(line)
            if match:
                yield int(match[1], 16)


SAMPLES = 1000  # that the example runs on its emulated board
_PATIENCE_BARE_METAL = 20  # samples without one that was worked on, before the watchdog bites
_SHARE = 8 * 100  # a hundredth of an eighth of the limit
_DUE = ("as soon as they are known", "at the next sample")
_NAMES = ("board.h", "main.c", "board_mps2.c", "mps2.ld")


def bare_metal_files(law: Law, arithmetic: Arithmetic) -> dict[str, str]:
    """The example's files by name: <name>_main.c, which knows no hardware, <name>_board.h, which
    says what it needs of it, and <name>_board_mps2.c and <name>_mps2.ld, a board of QEMU's.
    """
    unit = unit_of(law, arithmetic, {})
    base = unit.base
    real = arithmetic in {"double", "float"}

    def number(value: float) -> str:
        return literal(value, arithmetic) if real else str(int(value))

    # on the emulated board: errors within an eighth of their limit, what is told in mid range
    amplitude = unit.counts(base.error_limit / _SHARE, unit.metre)
    means = [number(float(np.mean(axis))) for _, axis, *_ in base.over]
    means += [number(-1.0)] * (len(base.told) - len(means))  # no monitor beside it
    told = [{"name": name, "value": value} for name, value in zip(base.told, means, strict=True)]
    delay = base.delay
    arguments = "".join(f"from->{one.name}, " for one in unit.interface.arguments if one.given)
    call = f"{unit.step}(&controller, {arguments}current[k % SETS])"
    facts: dict[str, Any] = {
        **unit.driver_facts(),
        "step": call,
        "delay": delay,
        "delay_text": _DUE[delay] if delay < len(_DUE) else f"{delay} samples later",
        "samples": SAMPLES,
        "patience": _PATIENCE_BARE_METAL,
        "sources": " ".join(unit.interface.sources),
        "amplitude": real_table(arithmetic)(amplitude) if real else integer_table(amplitude),
        "minus_one": number(-1.0),
        "zero": number(0.0),
        "fixed": not real,
        "turn": _turn(unit),
    }
    files = {}
    for name in _NAMES:
        values = facts | {"told": told if name == "board_mps2.c" else [one["name"] for one in told]}
        files[f"{base.name}_{name}"] = render(f"bare_metal/{name}.j2", values)
    return files


def _turn(unit: Unit) -> int:
    """Samples of a turn in the middle of the first synchronous block's band; 0: there is none."""
    beside = unit.law.beside
    if beside is None:
        return 0
    low, high = beside.blocks[0].band
    return max(2, round(4 * math.pi / ((low + high) * beside.sample_time)))
