"""Code compiled for a processor: the program, and what it takes of flash, memory and stack."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from ambrose.code.processor.machines import COUNT_SHIFT, Processor
from ambrose.code.processor.unit import Unit
from ambrose.code.processor.unwound import Unwalked, listed, written_below
from ambrose.code.rendering import render
from ambrose.core.checks import InvalidInput

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
    own = ["driver.c", start, *(["memory.c"] if free else [])]
    support = [*own, "support.h", *(["stdio.h", "limits.h", "memory.ld"] if free else [])]
    for name, text in unit.files.items():
        (folder / name).write_text(text, encoding="utf-8")
    for name in support:
        (folder / name).write_text(render(f"target/{name}.j2", facts), encoding="utf-8")

    # every source by itself, with the compiler's account of frames and calls
    contract = f"-ffp-contract={'fast' if contraction else 'off'}"
    flags = [*processor.flags, *_BASE, contract, *(_FREE[:2] if free else ())]
    counted = ["-fstack-usage", "-fcallgraph-info=su"] if free else []
    objects = []
    for name in (*unit.sources, unit.self_test, *own):
        std = ["-std=gnu99"] if name in own else []
        renamed = ["-Dmain=self_test"] if name == unit.self_test else []
        made = f"{name.removesuffix('.c')}.o"
        _run(
            [processor.compiler, *flags, *std, *renamed, *counted, "-I.", "-c", name, "-o", made],
            folder,
        )
        objects.append(made)
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
    sizes = _run(
        [processor.tool("size"), *(f"{n.removesuffix('.c')}.o" for n in unit.sources)], folder
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
    lines = (line.split() for line in _run([processor.tool("nm"), "program"], folder).splitlines())
    return {parts[2]: int(parts[0], 16) for parts in lines if len(parts) == 3}


def _symbol_size(processor: Processor, folder: Path, name: str) -> int:
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
    names = [*unit.sources, "memory.c"]
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
