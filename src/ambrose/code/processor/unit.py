"""What is tried: a block, or a block with synchronous blocks beside it, as its files, and what a
sample of it is in bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from ambrose.code.block.cost import padding_of
from ambrose.code.block.fixed import ControlBlock
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.block.supervised import SupervisedBlock
from ambrose.code.c.code import Arithmetic, generate, in_words
from ambrose.code.c.run import generate_run
from ambrose.code.synchronous import RunUnit

_WORDS = {"double": "f8", "float": "f4", "fixed32": "i4", "fixed16": "i2"}
_STORED = {"double": "f8", "float": "f4", "fixed32": "i8", "fixed16": "i4"}
Law = ControlBlock | ScheduledBlock | RunUnit


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
    def base(self) -> ControlBlock | ScheduledBlock:
        return self.law.base if isinstance(self.law, RunUnit) else self.law

    @property
    def beside(self) -> bool:
        """Whether synchronous blocks run beside the controller."""
        return isinstance(self.law, RunUnit)

    @property
    def told(self) -> tuple[str, ...]:
        """What a step is told besides the errors."""
        base = self.base
        if not isinstance(base, ScheduledBlock):
            return ()
        names = tuple(one.name for one in base.along.each)
        return (*names, "estimate", "half_width") if isinstance(base, SupervisedBlock) else names

    @property
    def sources(self) -> tuple[str, ...]:
        """The files that a machine runs."""
        name = self.base.name
        return (f"{name}.c", f"{name}_sync.c", f"{name}_run.c") if self.beside else (f"{name}.c",)

    @property
    def self_test(self) -> str:
        return f"{self.base.name}{'_run' if self.beside else ''}_test.c"

    @property
    def step(self) -> str:
        """The function that runs once a sample."""
        return f"{self.base.name}{'_run' if self.beside else ''}_step"

    def given(self, order: str) -> np.dtype[Any]:
        """A sample as the processor takes it; order: of its bytes."""
        word = f"{order}{_WORDS[self.arithmetic]}"
        fields: list[Any] = [("error", word, (len(self.base.inputs),))]
        fields += [(name, word) for name in self.told]
        if self.beside:
            fields += [("pulse", word), ("flags", f"{order}u4")]
        return np.dtype([*fields, ("valid", "u1", (len(self.base.inputs),))])

    def answered(self, order: str) -> np.dtype[Any]:
        """What it answers: currents, status, faults of the synchronous blocks, instructions of the
        step, and how deep the stack was written [bytes].
        """
        word = f"{order}{_WORDS[self.arithmetic]}"
        marks = [(name, f"{order}u4") for name in ("status", "faults", "instructions", "stack")]
        return np.dtype([("current", word, (len(self.base.outputs),)), *marks])

    def stored(self, order: str) -> np.dtype[Any]:
        """A state in memory."""
        return np.dtype(f"{order}{_STORED[self.arithmetic]}")

    def counts(self, values: np.ndarray, unit: np.ndarray) -> np.ndarray:
        """Values as numbers of the code, to the nearest and within the word, as a converter has
        them.
        """
        scaled = np.asarray(values, float) / unit
        kind = np.dtype(_WORDS[self.arithmetic])
        if kind.kind == "f":
            return scaled.astype(kind)
        ends = np.iinfo(kind)
        return np.clip(np.rint(scaled), ends.min, ends.max).astype(kind)

    def driver_facts(self) -> dict[str, Any]:
        """What the driver's template says of it."""
        base, name = self.base, self.base.name
        ending = "_run" if self.beside else ""
        told = "".join(f"{one}, " for one in self.told)
        if self.beside:
            call = f"{self.step}(&running, pulse, error, valid, {told}flags, current)"
        else:
            call = f"{self.step}(&running, error, valid, {told}current)"
        return {
            "name": name,
            "prefix": name.upper(),
            "header": f"{name}{ending}.h",
            "unit": f"{name}_run" if self.beside else f"{name}_block",
            "block": "running.base" if self.beside else "running",
            "beside": self.beside,
            "told": self.told,
            "ni": len(base.inputs),
            "no": len(base.outputs),
            "states": base.n_states,
            "low": padding_of(base)[0],
            "init": f"{name}{ending}_init",
            "step": call,
        }


def unit_of(
    law: Law, arithmetic: Arithmetic = "double", files: Mapping[str, str] | None = None
) -> Unit:
    """The code of a law; files: its texts where they were written already. Raises InvalidInput, as
    ``generate`` does.
    """
    base = law.base if isinstance(law, RunUnit) else law
    if files is not None:
        files = dict(files)
    elif isinstance(law, RunUnit):
        files = generate_run(law, arithmetic)
    else:
        files = generate(law, arithmetic)
    metre, ampere = np.ones(len(base.inputs)), np.ones(len(base.outputs))
    if arithmetic not in {"double", "float"}:
        fixed = in_words(cast(ControlBlock, base), int(arithmetic.removeprefix("fixed")))
        one = 2.0**fixed.signal_bits
        metre, ampere = base.error_limit / one, base.current_limit / one
    return Unit(law, arithmetic, files, metre, ampere)
