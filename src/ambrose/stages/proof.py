"""Stage: what verification says about a controller on the full model, point by point and over all tolerances."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ambrose.core.scheduled import ScheduledSystem
from ambrose.machine.description import Tolerance
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.stages.plants import plants_along_speed
from ambrose.synthesis.controller_file import match_controller
from ambrose.synthesis.weights import machine_weights
from ambrose.verification import campbell, nominal, robust
from ambrose.verification.checks import Checks, Curve

Progress = Callable[[str], None]
_CAMPBELL_SPEEDS, _CAMPBELL_MODES = 15, 10


def verification(plants: tuple[Plant, ...], controller: Any, progress: Progress) -> tuple[Checks, ...]:
    """The checks on every full plant. Raises InvalidInput where the controller is not one for this machine."""
    results = []
    for plant in plants:
        progress(f"verifying at {plant.point.label}")
        fixed = not isinstance(controller, ScheduledSystem)  # a scheduled one has its own verdict over speed
        turning = fixed and plant.machine.operation.speed_range[1] > 0 and plant is plants[0]
        along = plants_along_speed(plant) if turning else None
        results.append(nominal.check(plant, match_controller(controller, plant), plant_at=along))
    return tuple(results)


def over_tolerances(
    plant: Plant, controller: Any, stable: bool, progress: Progress, tolerances: Sequence[Tolerance] | None = None
) -> Checks | None:
    """The checks over the machine's tolerances; None without tolerances, for an unstable loop or a sampled controller.

    tolerances: None: all. Otherwise those, and of all together only the number of unstable corners and samples.

    Worst cases are searched on the full model; stability is proved on the reduced one, with one bending mode per plane.
    """
    if not plant.machine.tolerances or not stable or controller.dt is not None:
        return None
    progress("verifying over all tolerances")
    weights = machine_weights(plant.machine) if plant.machine.weights is not None else None
    found = robust.check(plant, controller, tolerances, weights)
    proof = [
        replace(check, detail=f"{check.detail}; on the reduced model with one bending mode per plane")
        for check in robust.check(reduce(plant, 1), controller, tolerances).checks
        if check.name == "robust.stability.proved"
    ]
    every = [] if tolerances is None else [robust.stability(plant, controller)]
    return replace(found, checks=(*found.checks, *proof, *every))


def campbell_map(plant: Plant, controller: Any, progress: Progress) -> tuple[Curve, ...]:
    """Closed-loop natural frequencies and damping over the machine's speed range; empty for one that does not turn."""
    low, high = plant.machine.operation.speed_range
    if high <= low:
        return ()
    progress("following the modes over speed")
    along = campbell.campbell(plants_along_speed(plant), np.linspace(low, high, _CAMPBELL_SPEEDS), _CAMPBELL_MODES, controller)
    return tuple(campbell.campbell_curves(along))
