"""Whether magnets of a size carry residual unbalance, impulses, surges and lasting loads of the
machine file, under the controller that was tuned for them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ambrose.core.statespace import StateSpace
from ambrose.judge.capacity import (
    axis_limits,
    load_demands,
    residual_demands,
    static_forces,
    together,
)
from ambrose.law.timing import Timing
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.static_load import static_sag


def capacity_margin(
    machine: Machine, controller: StateSpace, timing: Timing | None
) -> tuple[float, str]:
    """The least margin over all axes at the fastest operating point, and of what; inf where
    nothing is asked. machine: as ``resized`` gives it, whose largest control current is what the
    weight leaves.
    """
    point = max(machine.operation.envelope, key=lambda item: item.speed)
    plant = assemble(machine, point)
    weight = static_sag(machine)[1].ravel()
    signed, free = static_forces(machine)
    rows = [(float("inf"), "", "")]
    for axis, limits, steady, loads, held in zip(
        plant.axes,
        axis_limits(plant, np.abs(weight + signed) + free),
        residual_demands(plant, controller, timing),
        load_demands(plant, controller, timing),
        np.abs(weight),
        strict=True,
    ):
        # the weight is off the largest current already
        if limits.largest is not None:
            whole = replace(limits, largest=limits.largest + held / limits.force_per_current)
        else:
            whole = limits
        rows += [
            (item.value, f"{item.of}, axis {axis}", item.limited_by)
            for item in together(whole, steady, loads)
        ]
    margin, what, why = min(rows)
    return margin, f"{what}, by {why}" if what else ""
