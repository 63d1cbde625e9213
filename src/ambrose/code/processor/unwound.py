"""How deep a function of a program writes the stack, by its instructions: for what the compiler
gives no account of, such as its own library of soft-float arithmetic, written in assembler.

Arm's A32 and T32 (Arm Architecture Reference Manual, Armv7-M, DDI 0403, A7.7), as ``objdump``
writes them. All paths from the first instruction are walked with what the stack pointer has been
moved by; a conditional push counts as taken, a conditional pop as not.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

_CONDITION = "eq|ne|cs|hs|cc|lo|mi|pl|vs|vc|hi|ls|ge|lt|gt|le"
_LINE = re.compile(r"^[ \t]*([0-9a-f]+):[ \t]+(\S+)(?:[ \t]+([^;@\n]*))?", re.M)
_BRANCH = re.compile(rf"b({_CONDITION})?|(cbn?z)")
_CALL = re.compile(rf"blx?({_CONDITION})?")
_LEAVE = re.compile(rf"bx({_CONDITION})?")
_PUSHED = re.compile(rf"(v?push|v?stmdb|stmfd)({_CONDITION})?")
_POPPED = re.compile(rf"(v?pop|v?ldmia|ldmfd|v?ldm)({_CONDITION})?")
_STORED = re.compile(rf"str[bhd]?({_CONDITION})?")
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
    found = _jumps(name, rest) or _moves(name, rest)
    if found is not None:
        return found
    # whatever else writes the stack pointer or the program counter is not followed
    first = rest.split(",", maxsplit=1)[0].strip().rstrip("!")
    writes = not name.startswith(("str", "cmp", "cmn", "tst", "teq", "vstr", "stm", "vstm"))
    if name in {"tbb", "tbh"} or (writes and first in {"sp", "pc"}):
        raise Unwalked(f"{name} {rest}")
    return _Step()


def _jumps(name: str, rest: str) -> _Step | None:
    target = _TARGET.search(rest)
    to = int(target[1], 16) if target else None
    if found := _BRANCH.fullmatch(name):
        if to is None:
            raise Unwalked(f"{name} {rest}")
        return _Step(to=to, ends=not (found[1] or found[2]))
    if _CALL.fullmatch(name):
        if to is None:
            raise Unwalked(f"{name} {rest}")
        return _Step(called=to)
    if found := _LEAVE.fullmatch(name):
        if rest != "lr":
            raise Unwalked(f"{name} {rest}")
        return _Step(ends=not found[1])
    if name == "mov" and rest == "pc, lr":
        return _Step(ends=True)
    return None


def _moves(name: str, rest: str) -> _Step | None:
    """What moves the stack pointer by a number that stands in the instruction."""
    listing = rest.startswith(("{", "sp!"))
    if listing and _PUSHED.fullmatch(name):
        return _Step(pushed=_size(rest))
    if listing and (found := _POPPED.fullmatch(name)):
        back = bool(re.search(r"\bpc\b", rest))
        return _Step(pushed=0 if found[2] else -_size(rest), ends=back and not found[2])
    if _STORED.fullmatch(name) and (moved := re.search(r"\[sp, #-(\d+)\]!", rest)):
        return _Step(pushed=int(moved[1]))
    if (found := _LOADED.fullmatch(name)) and (moved := re.search(r"\[sp\], #(\d+)", rest)):
        back = rest.startswith("pc,")
        return _Step(pushed=0 if found[1] else -int(moved[1]), ends=back and not found[1])
    if (found := _MOVED.fullmatch(name)) and (moved := re.fullmatch(r"sp, (?:sp, )?#(\d+)", rest)):
        taken = int(moved[1])
        if found[1] == "sub":
            return _Step(pushed=taken)
        return _Step(pushed=0 if found[2] else -taken)
    return None


def _size(listing: str) -> int:
    """Bytes of the registers of a list."""
    total = 0
    for found in _RANGE.finditer(listing.partition("{")[2]):
        count = int(found[3]) - int(found[2]) + 1 if found[3] else 1
        total += count * (8 if found[1] == "d" else 4)
    return total
