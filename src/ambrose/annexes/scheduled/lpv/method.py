"""Method "lpv": one controller over a range of speeds, of seal pressures, or of both."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ambrose.annexes.scheduled.lpv.machine import (
    POINTS,
    POINTS_OF_TWO,
    design_schedule,
    schedule_grid,
)
from ambrose.core.checks import InvalidInput
from ambrose.judge.result import Synthesis
from ambrose.law.scheduling import BOTH, PRESSURE, SPEED, Scheduling
from ambrose.model.plant import Plant
from ambrose.synthesis.options import DesignOptions

TITLE = "LPV"
Progress = Callable[[str], None]


def suits(plant: Plant) -> bool:
    """Whether the operating points around the plant's give a range of speeds to schedule over."""
    try:
        schedule_grid(plant.machine, plant.point)
    except InvalidInput:
        return False
    return plant.machine.weights is not None


def design(plant: Plant, options: DesignOptions, progress: Progress) -> Synthesis:
    """A controller scheduled over what the options ask for; else over what varies around the
    plant's operating point. Raises InvalidInput where nothing does.
    """
    asked = options.schedules or ((_varied(plant), None, None),)
    along, count = (asked[0][0], POINTS) if len(asked) == 1 else (BOTH, POINTS_OF_TWO)
    grid = tuple(np.linspace(*ends, count) for _, ends, _ in asked if ends is not None)
    timing = options.timing()
    return design_schedule(
        plant,
        grid or None,
        along,
        bending_modes=options.bending_modes or 0,
        rate=tuple(rate for _, _, rate in asked),
        lag=0.0 if timing is None else timing.lag,
        tolerances=options.tolerances,
        backoff=options.backoff,
        progress=progress,
    )


def _varied(plant: Plant) -> Scheduling:
    """The pressure where the operating points around the plant's have several and one speed, else
    the speed.
    """
    pressures = {
        p.seal_pressure for p in plant.machine.operation.envelope if p.speed == plant.point.speed
    }
    try:
        schedule_grid(plant.machine, plant.point)
    except InvalidInput:
        return PRESSURE if len(pressures) > 1 else SPEED
    return SPEED
