"""The radial controller and the axial one as one C function of all axes.

The two are decoupled and judged apart, each on its own plant; they share the sample and the
processor. One unit holds both states, one step takes the errors of the radial axes, then the axial
one, and gives the currents in the same order. Each part keeps its own guards: a lost axial reading
is held by the axial part and never seen by the radial one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ambrose.code.block.fixed import ControlBlock
from ambrose.code.c.literals import literal
from ambrose.code.processor.unit import Law, unit_of
from ambrose.code.rendering import render
from ambrose.code.sampled import Deployment
from ambrose.core.checks import InvalidInput, invalid, same_clock
from ambrose.law.timing import Timing
from ambrose.machine.machine import Machine

if TYPE_CHECKING:
    from ambrose.code.targets import C, Target

_AXIAL = "_axial"  # what the axial part's name adds
_ROWS = 500  # samples of the self-test


@dataclass(frozen=True, slots=True, eq=False)
class AxialPart:
    """The axial controller beside a radial one: its verification as it runs, and its block."""

    deployment: Deployment
    block: ControlBlock


def axial_target(target: Target, machine: Machine | None, timing: Timing | None) -> C:
    """How the axial part is written: as the radial one, under its own name.

    timing: the axial controller's own, None where it states none. Raises InvalidInput for another
    target than C, a machine without a thrust bearing, and what is tried part by part.
    """
    from ambrose.code.targets import C

    if not isinstance(target, C):
        raise invalid(
            "an axial controller beside the radial one",
            f"given for the target {target.to!r}",
            "left out",
            "write C, or write each controller by itself",
        )
    if target.try_on is not None or target.bare_metal:
        raise InvalidInput(
            "a unit of all axes is not tried on a processor as a whole; export each controller by "
            "itself with --try-on or --bare-metal, then both together without"
        )
    if machine is None or not machine.has_axis:
        raise InvalidInput(
            "the machine has no thrust bearing; name its file with --machine, without #axial, or "
            "leave the axial controller out"
        )
    rate = target.rate
    if timing is not None and rate is not None and not same_clock(1 / rate, timing.sample_time):
        raise invalid(
            "the axial controller",
            str(timing),
            f"sampled at the radial one's {rate:g} Hz",
            f"design it with --rate-hz {rate:g}: one processor runs both",
        )
    form = "modal"  # its sections are its own file's
    return replace(
        target, name=f"{target.name}{_AXIAL}", form=form, error_limit=None, current_limit=None
    )


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
