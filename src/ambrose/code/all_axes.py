"""The radial controller and the axial one as one C function of all axes.

The two are decoupled and judged apart, each on its own plant; they share the sample and the
processor. One unit holds both states, one step takes the errors of the radial axes, then the axial
one, and gives the currents in the same order. Each part keeps its own guards: a lost axial reading
is held by the axial part and never seen by the radial one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

from ambrose.code.block.block import ControlBlock, render
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.c.code import Arithmetic, generate, literal
from ambrose.code.c.compiled import CompiledLaw
from ambrose.code.c.synchronous import generate_run
from ambrose.code.interface import interface_of
from ambrose.code.synchronous import Law, RunUnit
from ambrose.core.checks import invalid
from ambrose.core.statespace import StateSpace, append
from ambrose.law.synchronous_block import SynchronousLaw

_ROWS = 500  # samples of the self-test
_SIDES = ("INPUTS", "OUTPUTS")


@dataclass(frozen=True, slots=True, eq=False)
class AllAxes:
    """What one unit of all axes runs: the radial law, and the block of the axis along the shaft,
    with the same sample time and delay.
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


AnyLaw = Law | AllAxes


def law_files(
    law: AnyLaw,
    arithmetic: Arithmetic,
    provenance: Sequence[str] = (),
    along: Sequence[str] = (),
) -> dict[str, str]:
    """The files of a unit by name, whatever it runs. along: the provenance of the part along the
    shaft. Raises InvalidInput.
    """
    if isinstance(law, AllAxes):
        return {
            **law_files(law.radial, arithmetic, provenance),
            **generate(law.axial, arithmetic, along),
            **all_axes_files(law.radial, law.axial, arithmetic),
        }
    write: Any = generate_run if isinstance(law, RunUnit) else generate
    return cast(dict[str, str], write(law, arithmetic, provenance))


def all_axes_files(radial: Law, axial: ControlBlock, arithmetic: str) -> dict[str, str]:
    """<name>_axes.h, .c and _axes_test.c, which stand on the files of both parts."""
    law, own = AllAxes(radial, axial), interface_of(radial, arithmetic)
    face, base = interface_of(law, arithmetic), radial.base
    fixed = arithmetic.startswith("fixed")
    zero, sizes = "0" if fixed else literal(0.0, arithmetic), f"{base.name.upper()}_AXES"
    # where nothing was told, no pulse came
    still = {"pulse": f"{zero} - 1", "flags": "0u"} | dict.fromkeys(base.told, zero)
    facts = {
        "name": base.name,
        "prefix": base.name.upper(),
        "header": f"{own.name}.h",
        "unit": own.memory,
        "init": f"{own.name}_init",
        "axial": axial.name,
        "axial_prefix": axial.name.upper(),
        "sample_time": f"{base.sample_time:.9g}",
        "inputs": [*base.inputs, *axial.inputs],
        "outputs": [*base.outputs, *axial.outputs],
        "declared": face.declared(f"{base.name}_real", *(f"{sizes}_{n}" for n in _SIDES)),
        "names": ", ".join(one.name for one in face.arguments),
        "called": ", ".join(still.get(one.name, one.name) for one in face.arguments[:-1]),
        "step_name": f"{own.name}_step",
        "sources": " ".join(face.sources),
        "rows": _ROWS,
        "fixed": fixed,
        "scales": _scales(base, axial, fixed=fixed),
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


class CompiledAxes(CompiledLaw[AllAxes]):
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
        law = AllAxes(radial, axial)
        super().__init__(law, law_files(law, arithmetic), arithmetic, compiler)

    @property
    def parts(self) -> tuple[StateSpace, StateSpace]:
        """The laws of the radial axes and of the one along the shaft, in the code's states."""
        radial, axial = self.blocks
        return radial.system, axial.system

    @property
    def system(self) -> StateSpace:
        """Both side by side."""
        return append(*self.parts)
