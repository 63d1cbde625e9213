"""LPV control of a machine over its speed, its seal pressure or both: the family of design
problems, the synthesis, the full plant at every point of the schedule.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ambrose.annexes.scheduled.lpv.synthesis import PlantAt, lpv_synthesis
from ambrose.annexes.scheduled.lpv.tolerances import tolerant_lpv, worst_corners
from ambrose.core.checks import InvalidInput, invalid
from ambrose.core.lft import GeneralizedPlant
from ambrose.core.scheduled import check_axes, grid_points
from ambrose.judge.certificate import certify_on_full_plant
from ambrose.judge.result import Synthesis
from ambrose.law.design_problem import (
    apply_delay,
    design_plant,
    design_tolerances,
    open_model,
    unit_problem,
)
from ambrose.law.scheduling import SPEED, Scheduling
from ambrose.law.weights import Weights, machine_weights, scale_control
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.model.plant import Plant
from ambrose.model.reduce import free_mode_reduction

POINTS, POINTS_OF_TWO = 8, 3  # of a grid that is not given, along each of its parameters
_BACKOFF = 1.1  # gamma of the law over the least that exists, where none is stated
# factors of the control weight, tried until the tolerances are held
_CONTROL = (1.0, 0.7, 0.5, 0.35)
_MODES = 3  # bending modes per plane besides those of the design, on which corners are judged
_FAR = 20  # times the highest of the operating points
_PADE = 2  # order of the delay's approximation
_PEAK = 3.0  # where no sensitivity is required: border of zone A of ISO 14839-3


def schedule_grid(
    machine: Machine, point: OperatingPoint, along: Scheduling = SPEED, count: int = POINTS
) -> np.ndarray:
    """``count`` values (count,) of speed or pressure, evenly from the lowest to the highest of the
    machine's operating points.

    Points count that are those of ``point`` in everything else; over speed, only those that turn.
    Raises InvalidInput where they leave no range.
    """
    alike = [
        p
        for p in machine.operation.envelope
        if replace(along.moved(p, along.of(point)), label=point.label) == point
    ]
    values = sorted(
        {value for p in (*alike, point) if (value := along.of(p)) > 0 or along is not SPEED}
    )
    if len(values) < 2:
        other = "seal pressure" if along is SPEED else "speed"
        option = "--speeds-hz" if along is SPEED else "--pressures-bar"
        raise InvalidInput(
            f"machine {machine.name!r} has no range of {along.name}s at the {other} of "
            f"{point.label or 'this point'}; give the "
            f"{along.name}s ({option}), or add operating points at the lowest and the highest"
        )
    return np.linspace(values[0], values[-1], count)


def plants_along(
    plant: Plant,
    along: Scheduling = SPEED,
    bending_modes: int = 0,
    lag: float = 0.0,
    weights: Weights | None = None,
    tolerances: Sequence[Tolerance] | None = None,
) -> Callable[[Any], GeneralizedPlant]:
    """The design problem at a speed or pressure (or both), all else as at the plant's operating
    point, in common states.

    lag [s]: by which the currents act late. weights: None: the machine's; tolerances: None: none.
    """
    chosen, uncertain = weights or machine_weights(plant.machine), tolerances is not None

    def at(value: Any) -> GeneralizedPlant:
        small = free_mode_reduction(
            replace(plant, point=along.moved(plant.point, value)), bending_modes
        )
        return design_plant(
            apply_delay(open_model(small, tolerances, uncertain), lag), chosen, uncertain=uncertain
        )

    return at


def design_schedule(
    plant: Plant,
    grid: Sequence[Any] | np.ndarray | None = None,
    along: Scheduling = SPEED,
    *,
    bending_modes: int = 0,
    rate: float | tuple[float | None, ...] | None = None,
    lag: float = 0.0,
    tolerances: bool = False,
    backoff: float | None = None,
    progress: Callable[[str], None] | None = None,
) -> Synthesis:
    """A controller scheduled over speed, pressure or both for a full plant, verified on it at every
    point of its schedule.

    grid (k,) [rad/s] or [Pa], of both one for each: None: ``schedule_grid``; it holds the plant's
    own value in its range. rate [of its unit per s], of both one for each: the fastest change
    (None: any); bending_modes: per plane, lag [s]: of the currents, in the design model.
    tolerances: it is designed over the machine's, without the lag, with a control weight as small
    as the output sensitivity required at their corners, judged with the lag, needs
    (``tolerant_lpv``). backoff: how far above the smallest gamma it stays (None: 1.1, and 1.2 over
    tolerances). ``controller`` is the frozen form at the plant's own. margins gain those of
    ``certificate.full_plant_margins``; a controller that does not hold the full plant at every
    point has the status "unstable". Raises InvalidInput and NumericalFailure as ``lpv_synthesis``.
    """
    machine, point = plant.machine, plant.point
    weights = machine_weights(machine)
    if grid is None:
        grid = tuple(
            schedule_grid(machine, point, one, POINTS_OF_TWO if along.parts else POINTS)
            for one in along.each
        )
    axes, design_value = check_axes(grid, along.name), along.of(point)
    for one, axis in zip(along.each, axes, strict=True):
        value, (low, high) = one.of(point), axis[[0, -1]]
        if not low <= value <= high:
            remedy = f"widen the {one.name}s or assemble it within them"
            raise invalid(
                f"the plant's {one.name}",
                one.number(value),
                f"between {low:g} and {one.number(high)}",
                remedy,
            )
        usual = max(one.of(p) for p in machine.operation.envelope)
        if high > _FAR * usual > 0:
            remedy = (
                f"the highest of its operating points is {one.number(usual)}; is it in another "
                "unit?"
            )
            raise invalid(
                f"the highest {one.name} of the schedule",
                one.number(high),
                f"at most {_FAR} times the machine's",
                remedy,
            )
    if along is not SPEED and not machine.seals:
        raise InvalidInput(
            f"machine {machine.name!r} has no seal, and nothing changes with the {along.name}; "
            "use another method"
        )
    say = progress or (lambda _: None)

    def scheduled(plants: PlantAt, usual: float = _BACKOFF) -> Synthesis:
        above = usual if backoff is None else backoff
        return lpv_synthesis(
            plants,
            axes,
            rate=rate,
            backoff=above,
            nominal=design_value,
            parameter=along.name,
            unit=along.unit,
            progress=say,
        )

    if tolerances:
        result = _over_tolerances(plant, axes, along, bending_modes, lag, say, scheduled)
    else:
        result = scheduled(plants_along(plant, along, bending_modes, lag))
        result = replace(result, weights=weights)
    return certify_on_full_plant(plant, result)


def _over_tolerances(
    plant: Plant,
    axes: tuple[np.ndarray, ...],
    along: Scheduling,
    modes: int,
    lag: float,
    say: Callable[[str], None],
    scheduled: Callable[[PlantAt, float], Synthesis],
) -> Synthesis:
    machine, weights = plant.machine, machine_weights(plant.machine)
    if not machine.tolerances:
        raise InvalidInput(
            f"machine {machine.name!r} has no tolerances; add [[tolerance]] tables, or design "
            "without them"
        )
    wide, points = design_tolerances(machine), grid_points(axes)
    judged = sorted({points[len(points) // 2], *grid_points([axis[[0, -1]] for axis in axes])})
    tried = [scale_control(weights, factor) for factor in _CONTROL]
    units = {}
    for value in judged:
        small = free_mode_reduction(
            replace(plant, point=along.moved(plant.point, value)), modes + _MODES
        )
        units[value] = unit_problem(
            apply_delay(open_model(small, machine.tolerances, True), lag, _PADE)
        )
    limit = machine.requirements.sensitivity_peak or _PEAK
    # the delay is judged, not designed for: with Pade's states the second pass of a scaled problem
    # needs 1.4 times the optimum
    plants = [plants_along(plant, along, modes, 0.0, item, wide) for item in tried]
    result, worst, place, scaled = tolerant_lpv(
        plants, axes, scheduled, partial(worst_corners, units), limit, say
    )
    where = f"{'; ' if along.parts else ', '}".join(along.words(value) for value in judged)
    factor = f", control weight times {_CONTROL[place]:g}" if place else ""
    what = (
        f"holds for {1 / result.gamma:.0%} of them, however they move"
        if scaled
        else "is without deviations: they were held all the same"
    )
    words = f"none is unstable and sigma_max(S_o) is at most {worst.sensitivity:.3f}"
    notes = (
        f"designed over {len(wide)} tolerances{factor}: gamma {result.gamma:.3g} {what}",
        f"of {worst.members} corners of all tolerances at {where}, "
        f"{f'{worst.unstable} are unstable' if worst.unstable else words} on the model with "
        f"{modes + _MODES} bending modes",
    )
    # D bends the scaled one
    kept = [note for note in result.notes if not note.startswith("for a plant that is linear")]
    margins = {
        **result.certificate.margins,
        "corner_sensitivity": worst.sensitivity,
        "corner_sensitivity_limit": limit,
    }
    margins["unstable_corners"] = float(worst.unstable)
    certificate = replace(result.certificate, margins=margins)
    return replace(result, weights=tried[place], certificate=certificate, notes=(*notes, *kept))
