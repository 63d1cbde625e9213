"""The radial controller and the axial one as one C function of all axes.

The two are decoupled and judged apart, each on its own plant; they share the sample and the
processor. One unit holds both states, one step takes the errors of the radial axes, then the axial
one, and gives the currents in the same order. Each part keeps its own guards: a lost axial reading
is held by the axial part and never seen by the radial one.
"""

from __future__ import annotations

from dataclasses import dataclass

from ambrose.code.block.fixed import ControlBlock
from ambrose.code.c.literals import literal
from ambrose.code.processor.unit import Law, unit_of
from ambrose.code.rendering import render

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
