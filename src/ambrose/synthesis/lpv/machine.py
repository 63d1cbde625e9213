"""LPV control of a machine over its speed: the family of design problems, the synthesis, and the full plant at every speed."""

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
from ambrose.synthesis.certificate import certify_on_full_plant
from ambrose.synthesis.lpv.synthesis import lpv_synthesis
from ambrose.synthesis.problem import design_plant
from ambrose.synthesis.result import Synthesis
from ambrose.synthesis.weights import machine_weights

POINTS = 8  # of a grid that is not given


def speed_grid(machine: Machine, point: OperatingPoint, count: int = POINTS) -> np.ndarray:
    """``count`` speeds (count,) [rad/s], evenly from the lowest to the highest of the machine's operating points.

    Points count that have the seal pressure and the bias currents of ``point`` and turn. Raises InvalidInput where they leave
    no range.
    """
    alike = [p for p in machine.operation.envelope if replace(p, speed=point.speed, label=point.label) == point]
    speeds = sorted({p.speed for p in alike if p.speed > 0} | ({point.speed} if point.speed > 0 else set()))
    if len(speeds) < 2:
        raise InvalidInput(
            f"machine {machine.name!r} has no range of speeds at the seal pressure of {point.label or 'this point'}; give the "
            "speeds (--speeds-hz), or add operating points at the lowest and the highest"
        )
    return np.linspace(speeds[0], speeds[-1], count)


def plants_over_speed(plant: Plant, bending_modes: int = 0) -> Callable[[float], GeneralizedPlant]:
    """The nominal design problem at a speed [rad/s], everything else as at the plant's operating point, in common states."""

    def at(speed: float) -> GeneralizedPlant:
        small = free_mode_reduction(replace(plant, point=replace(plant.point, speed=speed)), bending_modes)
        return design_plant(small, uncertain=False)

    return at


def design_over_speed(
    plant: Plant,
    speeds: Sequence[float] | np.ndarray | None = None,
    *,
    bending_modes: int = 0,
    rate: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> Synthesis:
    """A controller scheduled over speed for a full plant, verified on the full plant at every speed of its schedule.

    speeds (k,) [rad/s]: the grid (None: ``speed_grid``), which holds the plant's own speed in its range; rate [rad/s^2]: the
    fastest run-up (None: any); bending_modes: per plane in the design model. ``controller`` is the frozen form at the plant's
    speed. margins gain full_spectral_abscissa and full_sensitivity_peak, the worst over these speeds, and worst_speed [rad/s]
    of the peak; a controller that does not hold the full plant at every one has the status "unstable". Raises InvalidInput and
    NumericalFailure as ``lpv_synthesis``.
    """
    machine, point = plant.machine, plant.point
    weights = machine_weights(machine)
    grid = speed_grid(machine, point) if speeds is None else check_grid(speeds, "speed")
    if not grid[0] <= point.speed <= grid[-1]:
        what = f"between {grid[0]:g} and {grid[-1]:g} rad/s"
        raise invalid("the plant's speed", f"{point.speed:g} rad/s", what, "widen the speeds or assemble it within them")
    result = lpv_synthesis(
        plants_over_speed(plant, bending_modes), grid, rate=rate, backoff=1.1, nominal=point.speed, progress=progress
    )
    return certify_on_full_plant(plant, replace(result, weights=weights))
