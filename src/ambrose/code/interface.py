"""The arguments of a unit's step as data, and where its memory keeps what one asks for: what loads
compiled code, drives it or describes it reads them here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ambrose.code.block.block import Block, ControlBlock
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.core.checks import invalid
from ambrose.law.synchronous_block import SynchronousLaw

# C's name of a number, and numpy's
KINDS = {
    "double": "f8",
    "float": "f4",
    "int16_t": "i2",
    "int32_t": "i4",
    "int64_t": "i8",
    "int": "i4",
    "unsigned": "u4",
    "unsigned char": "u1",
}
# of an arithmetic: its signals, its states
TYPES = {
    "double": ("double", "double"),
    "float": ("float", "float"),
    "fixed32": ("int32_t", "int64_t"),
    "fixed16": ("int16_t", "int32_t"),
}


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument of a step: its type in C, its numbers (0: one, by value), whether it is given
    or, at the end, answered.
    """

    name: str
    word: str
    count: int = 0
    given: bool = True

    @property
    def kind(self) -> np.dtype[Any]:
        return np.dtype(KINDS[self.word])

    def field(self, order: str) -> tuple[str, np.dtype[Any], tuple[int, ...]]:
        """As a field of a sample in bytes of that order."""
        return (
            self.name,
            np.dtype(f"{order}{KINDS[self.word]}"),
            (self.count,) if self.count else (),
        )


@dataclass(frozen=True, slots=True)
class Interface:
    """The functions <name>_<verb>, whose first argument is the memory; arguments: of the step after
    it; sources: the files that hold it; places: by name where the memory keeps something, its type
    and its numbers.
    """

    name: str
    memory: str
    sources: tuple[str, ...]
    arguments: tuple[Argument, ...]
    places: Mapping[str, tuple[str, str, int]] = field(default_factory=dict)
    begin: str = "init"

    def declared(
        self, real: str, inputs: object, outputs: object, after: str = "error"
    ) -> dict[str, str]:
        """What stands in C after the memory, of the step and of the transfer "track". real: the
        name of a number there; inputs, outputs: how many; after: where a line ends.
        """
        given = []
        for one in self.arguments[:-1]:
            word = one.word if one.word.startswith("unsigned") else real
            text = f"const {word} {one.name}[{inputs}]," if one.count else f"{word} {one.name},"
            given.append(text + ("\n    " if one.name == after else " "))
        last, led = f"{real} current[{outputs}]", "".join(given).replace("unsigned flags, ", "")
        return {"step": "".join(given) + last, "track": f"{led}const {last}"}


Base = ControlBlock | ScheduledBlock


class Law(Protocol):
    """What a unit runs: a block, blocks beside it, a block of the axis along the shaft."""

    @property
    def base(self) -> Block: ...
    @property
    def beside(self) -> SynchronousLaw | None: ...
    @property
    def axial(self) -> ControlBlock | None: ...
    def single(self) -> Law:
        """With its tables in single precision."""


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
    def base(self) -> Block:
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


def parts_of(law: Law) -> tuple[Block, ...]:
    """The blocks whose errors and currents are the unit's, in their order."""
    return (law.base,) if law.axial is None else (law.base, law.axial)


def interface_of(law: Law, arithmetic: str) -> Interface:
    """Of a law's unit in an arithmetic."""
    base, axial = law.base, law.axial
    name, beside = base.name, law.beside
    real, stored = TYPES[arithmetic]
    parts = parts_of(law)
    sources, places = [f"{name}.c"], {}
    unit, path = f"{name}_block", ""
    if beside is not None:
        sources += [f"{name}_sync.c", f"{name}_run.c"]
        unit, path = f"{name}_run", "base."
        places = {
            "c": ("c", real, beside.channels),
            "faults": ("faults", "unsigned", 1),
            **amplitudes_at(beside, "sync.", amplitude_type(arithmetic)),
        }
    if axial is not None:
        sources += [f"{axial.name}.c", f"{name}_axes.c"]
        unit, path = f"{name}_axes", f"radial.{path}"
    for part, before in zip(parts, (path, "axial."), strict=False):
        if part.n_states:
            low = part.padding[0]
            places[f"states of {part.name}"] = (f"{before}state[{low}]", stored, part.n_states)
    m, p = (sum(len(getattr(part, side)) for part in parts) for side in ("inputs", "outputs"))
    around = beside is not None
    arguments = (
        *([Argument("pulse", real)] if around else []),
        Argument("error", real, m),
        Argument("valid", "unsigned char", m),
        *(Argument(one, real) for one in base.told),
        *([Argument("flags", "unsigned")] if around else []),
        Argument("current", real, p, given=False),
    )
    return Interface(unit.removesuffix("_block"), unit, tuple(sources), arguments, places)


def amplitude_type(arithmetic: str) -> str:
    """The type of the blocks' amplitudes: of whole numbers the same for both words."""
    return "int64_t" if arithmetic.startswith("fixed") else arithmetic


def amplitudes_at(law: SynchronousLaw, before: str, real: str) -> dict[str, tuple[str, str, int]]:
    """State, fault and amplitude of every block."""
    kinds = {"state": ("int", 1), "fault": ("unsigned", 1)}
    kinds |= {"re": (real, law.channels), "im": (real, law.channels)}
    return {
        f"{what} {b}": (f"{before}block[{b}].{what}", *kind)
        for b in range(len(law.blocks))
        for what, kind in kinds.items()
    }
