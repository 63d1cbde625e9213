"""LPV control of a machine over its speed or seal pressure: the family of design problems, the synthesis, the full plant at
every point of the schedule."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.scheduled import check_grid
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.plant.model import Plant
from ambrose.plant.reduce import free_mode_reduction
from ambrose.plant.scheduling import SPEED, Scheduling
from ambrose.synthesis.certificate import certify_on_full_plant
from ambrose.synthesis.lpv.synthesis import lpv_synthesis
from ambrose.synthesis.problem import apply_delay, design_plant, open_model
from ambrose.synthesis.result import Synthesis
from ambrose.synthesis.weights import machine_weights

POINTS = 8  # of a grid that is not given


def schedule_grid(machine: Machine, point: OperatingPoint, along: Scheduling = SPEED, count: int = POINTS) -> np.ndarray:
    """``count`` values (count,) of speed or pressure, evenly from the lowest to the highest of the machine's operating points.

    Points count that are those of ``point`` in everything else; over speed, only those that turn. Raises InvalidInput where
    they leave no range.
    """
    alike = [p for p in machine.operation.envelope if replace(along.moved(p, along.of(point)), label=point.label) == point]
    values = sorted({value for p in (*alike, point) if (value := along.of(p)) > 0 or along is not SPEED})
    if len(values) < 2:
        other = "seal pressure" if along is SPEED else "speed"
        option = "--speeds-hz" if along is SPEED else "--pressures-bar"
        raise InvalidInput(
            f"machine {machine.name!r} has no range of {along.name}s at the {other} of {point.label or 'this point'}; give the "
            f"{along.name}s ({option}), or add operating points at the lowest and the highest"
        )
    return np.linspace(values[0], values[-1], count)


def plants_along(
    plant: Plant, along: Scheduling = SPEED, bending_modes: int = 0, lag: float = 0.0
) -> Callable[[float], GeneralizedPlant]:
    """The nominal design problem at a speed or pressure, all else as at the plant's operating point, in common states.

    lag [s]: by which the currents act late.
    """

    def at(value: float) -> GeneralizedPlant:
        small = free_mode_reduction(replace(plant, point=along.moved(plant.point, value)), bending_modes)
        model = apply_delay(open_model(small, None, uncertain=False), lag)
        return design_plant(model, machine_weights(plant.machine), uncertain=False)

    return at


def design_schedule(
    plant: Plant,
    grid: Sequence[float] | np.ndarray | None = None,
    along: Scheduling = SPEED,
    *,
    bending_modes: int = 0,
    rate: float | None = None,
    lag: float = 0.0,
    progress: Callable[[str], None] | None = None,
) -> Synthesis:
    """A controller scheduled over speed or pressure for a full plant, and verified on it at every point of its schedule.

    grid (k,) [rad/s] or [Pa]: None: ``schedule_grid``; it holds the plant's own value in its range. rate [of its unit per s]:
    the fastest change (None: any); bending_modes: per plane, lag [s]: of the currents, in the design model. ``controller`` is
    the frozen form at the plant's own. margins gain those of ``certificate.full_plant_margins``; a controller that does not
    hold the full plant at every point has the status "unstable". Raises InvalidInput and NumericalFailure as ``lpv_synthesis``.
    """
    machine, point = plant.machine, plant.point
    weights = machine_weights(machine)
    values = schedule_grid(machine, point, along) if grid is None else check_grid(grid, along.name)
    own = along.of(point)
    if not values[0] <= own <= values[-1]:
        what = f"between {values[0]:g} and {values[-1]:g} {along.unit}"
        remedy = f"widen the {along.name}s or assemble it within them"
        raise invalid(f"the plant's {along.name}", f"{own:g} {along.unit}", what, remedy)
    if along is not SPEED and not machine.seals:
        raise InvalidInput(
            f"machine {machine.name!r} has no seal, and nothing changes with the {along.name}; use another method"
        )
    result = lpv_synthesis(
        plants_along(plant, along, bending_modes, lag), values, rate=rate, backoff=1.1, nominal=own, parameter=along.name,
        unit=along.unit, progress=progress,
    )  # fmt: skip
    return certify_on_full_plant(plant, replace(result, weights=weights))
