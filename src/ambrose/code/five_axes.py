"""How the axial controller is written beside the radial one, and what comes of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ambrose.code.block.fixed import ControlBlock
from ambrose.code.sampled import Deployment
from ambrose.core.checks import InvalidInput, invalid, same_clock
from ambrose.law.timing import Timing
from ambrose.machine.machine import Machine

if TYPE_CHECKING:
    from ambrose.code.targets import C, Fmu, Target

_AXIAL = "_axial"  # what the axial part's name adds


@dataclass(frozen=True, slots=True, eq=False)
class AxialPart:
    """The axial controller beside a radial one: its verification as it runs, and its block."""

    deployment: Deployment
    block: ControlBlock


def axial_target(target: Target, machine: Machine | None, timing: Timing | None) -> C | Fmu:
    """How the axial part is written: as the radial one, under its own name.

    timing: the axial controller's own, None where it states none. Raises InvalidInput for another
    target than C and FMU, a machine without a thrust bearing, and what is tried part by part.
    """
    from ambrose.code.targets import C, Fmu

    if not isinstance(target, C | Fmu):
        raise invalid(
            "an axial controller beside the radial one",
            f"given for the target {target.to!r}",
            "left out",
            "write C or an FMU, or write each controller by itself",
        )
    if isinstance(target, C) and (target.try_on is not None or target.bare_metal):
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
    part = replace(target, name=f"{target.name}{_AXIAL}", error_limit=None, current_limit=None)
    # its sections are its own file's
    return replace(part, form="modal") if isinstance(part, C) else part
