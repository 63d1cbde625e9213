"""The radial controller and the axial one as one C function of all axes.

The two are decoupled and judged apart, each on its own plant; they share the sample and the
processor. One unit holds both states, one step takes the errors of the radial axes, then the axial
one, and gives the currents in the same order. Each part keeps its own guards: a lost axial reading
is held by the axial part and never seen by the radial one.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from ambrose.code.block.block import ControlBlock, render
from ambrose.code.block.run import padding_of
from ambrose.code.c.code import Arithmetic, generate, literal
from ambrose.code.c.compiled import Words, load_block
from ambrose.code.processor_build import Law, unit_of
from ambrose.core.checks import invalid
from ambrose.core.statespace import StateSpace, append

_ROWS = 500  # samples of the self-test


@dataclass(frozen=True, slots=True, eq=False)
class AllAxes:
    """What one unit of all axes runs: the radial law, and the block of the axis along the shaft,
    with the same sample time and delay.
    """

    radial: Law
    axial: ControlBlock


def all_axes_files(radial: Law, axial: ControlBlock, arithmetic: str) -> dict[str, str]:
    """<name>_axes.h, .c and _axes_test.c, which stand on the files of both parts."""
    unit = unit_of(radial, arithmetic, {})  # type: ignore[arg-type]
    base, zero = unit.base, literal(0.0, arithmetic) if arithmetic in {"double", "float"} else "0"
    told = [f"{base.name}_real {one}" for one in unit.told]
    facts = {
        **unit.driver_facts(),
        "axial": axial.name,
        "axial_prefix": axial.name.upper(),
        "sample_time": f"{base.sample_time:.9g}",
        "n": len(base.inputs),
        "p": len(base.outputs),
        "inputs": [*base.inputs, *axial.inputs],
        "outputs": [*base.outputs, *axial.outputs],
        "told_parameters": "".join(f"{one}, " for one in told),
        "told_names": "".join(f"{one}, " for one in unit.told),
        "step_name": unit.step,
        "sources": " ".join((*unit.sources, f"{axial.name}.c", f"{base.name}_axes.c")),
        "zero": zero,
        "zeros": "".join(f"{zero}, " for _ in unit.told),
        "rows": _ROWS,
        "fixed": arithmetic.startswith("fixed"),
        "scales": _scales(unit.base, axial, fixed=arithmetic.startswith("fixed")),
    }
    ends = ("axes.h", "axes.c", "axes_test.c")
    return {f"{base.name}_{end}": render(f"{end}.j2", facts) for end in ends}


def _scales(radial: object, axial: ControlBlock, *, fixed: bool) -> str:
    """An eighth of every error's limit, the self-test's amplitude: in counts, or in metres."""
    limits = [*radial.error_limit.tolist(), *axial.error_limit.tolist()]  # type: ignore[attr-defined]
    values = ["0.125" if fixed else literal(value / 8, "double") for value in limits]
    return "{" + ", ".join(values) + "}"


# The one C function of all axes, compiled and running here: software in the loop of the rig with
# five axes.


_CALL = """#include <math.h>
#include <stddef.h>
#include "{name}_axes.h"
typedef struct {{ {name}_axes *axes; int status; }} {name}_running;
size_t {name}_axes_size(void);
size_t {name}_axes_axial(void);
int {name}_axes_call(void *running, const double *errors, const double *told, double *currents);
size_t {name}_axes_size(void) {{ return sizeof({name}_axes); }}
size_t {name}_axes_axial(void) {{ return offsetof({name}_axes, axial); }}
int {name}_axes_call(void *running, const double *errors, const double *told, double *currents)
{{
    static const double metre[] = {{{error}}}, ampere[] = {{{current}}};
    {name}_running *self = ({name}_running *)running;
    {word} in[{m}], out[{p}];
    int i;
    (void)told;
    for (i = 0; i < {m}; i++) in[i] = ({word}){counted};
    self->status = (int){name}_axes_step(self->axes, in, NULL, out);
    for (i = 0; i < {p}; i++) currents[i] = (double)out[i] * ampere[i];
    return 0;
}}
"""


class _Running(ctypes.Structure):
    """What the C function gets first: its memory, and where it leaves the radial part's status."""

    _fields_ = (("axes", ctypes.c_void_p), ("status", ctypes.c_int))


class CompiledAxes:
    """A radial and an axial block as one compiled function, a ``law.law.AllAxesProgram``: what
    ``export --axial`` writes, in place of a controller on the rig.
    """

    def __init__(
        self,
        radial: ControlBlock,
        axial: ControlBlock,
        arithmetic: Arithmetic = "double",
        compiler: str | None = None,
    ) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, where it fails, or
        the two have not one clock and two names.
        """
        given: tuple[Any, ...] = (radial, axial)
        for block in given:
            if not isinstance(block, ControlBlock):
                kind = type(block).__name__
                remedy = "give the blocks of an export: done.block, done.axial.block"
                raise invalid("a block", f"of type {kind}", "a fixed controller block", remedy)
        if (radial.sample_time, radial.delay) != (axial.sample_time, axial.delay):
            clock = f"{axial.sample_time:g} s, {axial.delay} late"
            asked = f"that of the radial one, {radial.sample_time:g} s, {radial.delay} late"
            raise invalid("the axial block's clock", clock, asked, "export both together")
        if radial.name == axial.name:
            raise invalid("the axial block's name", axial.name, "its own", "export both together")
        self.blocks = (radial, axial)
        self.arithmetic = arithmetic
        self._words = tuple(Words.of(block, arithmetic) for block in self.blocks)
        files = {
            **generate(radial, arithmetic),
            **generate(axial, arithmetic),
            **all_axes_files(radial, axial, arithmetic),
            "call.c": self._call_file(),
        }
        name = radial.name
        sources = [f"{name}.c", f"{axial.name}.c", f"{name}_axes.c", "call.c"]
        self._library = load_block(files, sources, compiler)
        sizes = [self._library[f"{name}_axes_{what}"] for what in ("size", "axial")]
        for function in sizes:
            function.restype = ctypes.c_size_t
        size, self._second = (function() for function in sizes)
        self._memory = ctypes.create_string_buffer(size)
        self._running = _Running(ctypes.addressof(self._memory), 0)
        self._step = self._library[f"{name}_axes_call"]
        self._step.argtypes = (ctypes.c_void_p,) * 4
        self._library[f"{name}_axes_init"](self._memory)

    def _call_file(self) -> str:
        radial, axial = self.blocks
        first, second = self._words
        error, current = (
            ", ".join(repr(float(value)) for value in np.concatenate(pair))
            for pair in ((first.error, second.error), (first.current, second.current))
        )
        return _CALL.format(
            name=radial.name,
            error=error,
            current=current,
            word=first.word,
            counted=first.counted,
            m=len(radial.inputs) + len(axial.inputs),
            p=len(radial.outputs) + len(axial.outputs),
        )

    @property
    def sample_time(self) -> float:
        return self.blocks[0].sample_time

    @property
    def delay(self) -> int:
        return self.blocks[0].delay

    @property
    def parts(self) -> tuple[StateSpace, StateSpace]:
        """The laws of the radial axes and of the one along the shaft, in the code's states."""
        radial, axial = self.blocks
        return radial.system, axial.system

    @property
    def system(self) -> StateSpace:
        """Both side by side."""
        return append(*self.parts)

    @property
    def status(self) -> int:
        """The bits of the radial part's last step."""
        return self._running.status

    @property
    def entry(self) -> tuple[int, int]:
        """As the rig asks of a native program."""
        address = cast(int, ctypes.cast(self._step, ctypes.c_void_p).value)
        return address, ctypes.addressof(self._running)

    def begin(self, states: np.ndarray) -> None:
        """Everything as after its first call, then the states (n,) of both."""
        self._library[f"{self.blocks[0].name}_axes_init"](self._memory)
        first = self.blocks[0].n_states
        parts = (states[:first], states[first:])
        starts = (0, self._second)
        for block, words, values, start in zip(
            self.blocks, self._words, parts, starts, strict=True
        ):
            kind = np.dtype(words.stored)
            at = start + padding_of(block)[0] * kind.itemsize
            memory: Any = np.frombuffer(memoryview(self._memory), kind, block.n_states, at)
            memory[:] = words.counts(values, words.state)

    def step(self, errors: np.ndarray) -> np.ndarray:
        """One sample: currents (p,) [A] from errors (m,) [m]."""
        inputs = np.array(errors, float)
        currents = np.empty(sum(len(block.outputs) for block in self.blocks))
        self._step(ctypes.addressof(self._running), inputs.ctypes.data, None, currents.ctypes.data)
        return currents
