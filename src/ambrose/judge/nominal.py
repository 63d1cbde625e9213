"""Verification of one closed loop: everything that holds without uncertainty, on the plant given.

Give it the full plant: a controller designed on a reduced one can destabilise a bending mode. The
checks are listed in the tables of rotor_modes.py, campbell.py, sensitivity.py, margins.py,
unbalance.py and transient.py; limits come from criteria.py, overridden by the requirements. The
loop diagram is in core/lft.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_shape, invalid, named_failure
from ambrose.judge.along_speed import follow
from ambrose.judge.campbell import speed_stability_check
from ambrose.judge.checks import Check, Checks, Curve
from ambrose.judge.loop_response import (
    Evaluator,
    LoopResponse,
    add_poles,
    frequency_grid,
    loop_evaluator,
    solid_cores,
)
from ambrose.judge.margins import margin_checks
from ambrose.judge.rotor_modes import modes, pole_checks, pole_curve
from ambrose.judge.sensitivity import sensitivity_checks
from ambrose.judge.thrust import thrust_checks
from ambrose.judge.transient import pulse_checks, pulse_response
from ambrose.judge.unbalance import assembled_check, unbalance_checks, unbalance_curve
from ambrose.law.law import LawLike
from ambrose.law.loop import closed_loop, match_controller
from ambrose.machine.axial import AxialMachine
from ambrose.machine.criteria import SENSITIVITY_RANGE, SPEED_RANGE_FACTOR, TWO_PI
from ambrose.machine.description import Requirements
from ambrose.model.effect import speed_knots
from ambrose.model.plant import Plant, top_speed
from ambrose.model.unbalance import Unbalance, residual_unbalance

_LOWEST = 0.5 * TWO_PI  # rad/s, start of the default grid
# speeds at which the rotor is assembled anew for unbalance, and for stability, to begin with
_SPEEDS, _STABILITY_SPEEDS = 40, 11
_BEYOND = 5.0  # the default grid reaches this many times past the standard's range

Progress = Callable[[str, float], None]


@named_failure("the nominal checks")
def check(
    plant: Plant,
    controller: LawLike,
    requirements: Requirements | None = None,
    omega: ArrayLike | None = None,
    progress: Progress | None = None,
    plant_at: Callable[[float], Plant] | None = None,
) -> Checks:
    """The verdict on ``controller`` (err -> u, continuous or sampled) around ``plant``.

    requirements: default those of the plant's machine. omega (w,) [rad/s]: ascending, positive;
    points around lightly damped closed-loop poles are added (default: 0.5 Hz to five times the
    range of ISO 14839-3). progress(stage, fraction) is called between stages. plant_at(speed
    [rad/s]) -> Plant: with it stability and unbalance are checked along the machine's speed range
    with the rotor assembled anew at every speed. An unstable loop yields stable=False, the check
    "stability.abscissa" that names its poles, and the pole curve. Raises InvalidInput for a
    controller of the wrong size or a grid that does not ascend from a positive frequency.
    """
    tell = progress or (lambda stage, fraction: None)
    requirements = plant.machine.requirements if requirements is None else requirements
    controller = match_controller(controller, plant)
    tell("closed-loop poles", 0.0)
    closed = closed_loop(plant, controller)
    eigenmodes = modes(closed, plant.ports, plant.system)
    speed = max(top_speed(plant.machine), plant.point.speed)
    checks: list[Check] = pole_checks(eigenmodes, requirements, speed)
    curves: list[Curve] = [pole_curve(eigenmodes)]
    label = plant.point.label or f"{plant.point.speed / TWO_PI:.4g} Hz"
    notes = _notes(plant, controller.dt)
    if eigenmodes.poles.real.max() >= 0:
        return Checks(label, False, tuple(checks[:1]), tuple(curves), notes)

    highest = _sensitivity_range(speed, controller.dt)
    grid = _grid(eigenmodes.poles, omega, highest, controller.dt)
    tell("frequency response", 0.15)
    evaluator = loop_evaluator(plant, controller)
    response = evaluator(grid)
    tell("sensitivity and compliance", 0.35)
    within = (float(grid[0]), min(highest, float(grid[-1])))
    _extend(checks, curves, _sensitivities(plant, response, evaluator, within, requirements))
    tell("margins", 0.55)
    _extend(checks, curves, margin_checks(response, evaluator, requirements))
    tell("unbalance", 0.7)
    residual = residual_unbalance(plant.machine, requirements)
    if isinstance(plant.machine, AxialMachine):
        notes += ("No unbalance response: unbalance does not act along the shaft.",)
        _extend(checks, curves, thrust_checks(closed, plant))
    elif residual is None:
        notes += (
            "No unbalance response: no balancing speed is known; set requirements.balance_speed "
            "or a speed range.",
        )
    else:
        _extend(
            checks, curves, unbalance_checks(plant, response, evaluator, requirements, residual)
        )
    if plant_at is not None and plant.machine.operation.speed_range[1] > 0:
        _extend(checks, curves, _assembled(plant_at, plant, controller, requirements, residual))
    tell("time response", 0.85)
    _extend(checks, curves, pulse_checks(pulse_response(closed, plant), plant, requirements))
    tell("done", 1.0)
    return Checks(label, True, tuple(checks), tuple(curves), notes)


@named_failure("the sensitivity")
def check_sensitivity(plant: Plant, controller: LawLike) -> Checks:
    """Poles and sensitivities of ``check`` alone, the same to the last digit: what is cheap enough
    for every operating point. Raises InvalidInput for a controller of the wrong size.
    """
    requirements = plant.machine.requirements
    controller = match_controller(controller, plant)
    eigenmodes = modes(closed_loop(plant, controller), plant.ports)
    speed = max(top_speed(plant.machine), plant.point.speed)
    checks: list[Check] = pole_checks(eigenmodes, requirements, speed)
    label = plant.point.label or f"{plant.point.speed / TWO_PI:.4g} Hz"
    if eigenmodes.poles.real.max() >= 0:
        return Checks(label, False, tuple(checks[:1]), ())
    highest = _sensitivity_range(speed, controller.dt)
    grid = _grid(eigenmodes.poles, None, highest, controller.dt)
    evaluator = loop_evaluator(plant, controller)
    within = (float(grid[0]), min(highest, float(grid[-1])))
    found, _ = _sensitivities(plant, evaluator(grid), evaluator, within, requirements)
    return Checks(label, True, (*checks, *found), ())


def _sensitivities(
    plant: Plant,
    response: LoopResponse,
    evaluator: Evaluator,
    within: tuple[float, float],
    requirements: Requirements,
) -> tuple[list[Check], list[Curve]]:
    """``sensitivity_checks``, which say where solid cores count with their half order itself."""
    checks, curves = sensitivity_checks(response, evaluator, requirements, within)
    if solid_cores(plant):
        words = ", with the cores' exact half order"
        checks = [replace(check, detail=check.detail + words) for check in checks]
    return checks, curves


def _sensitivity_range(speed: float, dt: float | None) -> float:
    """Up to where ISO 14839-3 evaluates the sensitivity [rad/s], within what a sampled law has."""
    highest = max(SENSITIVITY_RANGE.limits[0].value, SPEED_RANGE_FACTOR * speed)
    return highest if dt is None else min(highest, np.pi / dt)


def _extend(
    checks: list[Check], curves: list[Curve], extra: tuple[list[Check], list[Curve]]
) -> None:
    checks += extra[0]
    curves += extra[1]


def _grid(
    poles: np.ndarray, omega: ArrayLike | None, highest: float, dt: float | None
) -> np.ndarray:
    top = np.inf if dt is None else np.pi / dt
    if omega is None:
        return frequency_grid(poles, _LOWEST, min(_BEYOND * highest, top))
    frequencies = check_shape(omega, "omega", "(w)").astype(float)
    if frequencies.size < 2 or frequencies[0] <= 0 or (np.diff(frequencies) <= 0).any():
        raise invalid(
            "omega",
            "not an ascending grid of positive frequencies",
            "ascending, from above 0 rad/s",
            "sort it",
        )
    return add_poles(frequencies, poles)


def _notes(plant: Plant, dt: float | None) -> tuple[str, ...]:
    notes: tuple[str, ...] = ()
    if plant.bending_modes is not None:
        notes += (
            f"The plant is reduced to {plant.bending_modes} bending modes per plane: spillover "
            "into others is not seen.",
        )
    if dt is not None:
        notes += (
            f"Sampled controller (dt = {dt:g} s): poles and time responses of the plant sampled "
            "with a zero-order hold, its free modes above half the rate at their own frequency; "
            "frequency curves use the base band of the hold, so aliasing near the Nyquist "
            "frequency is not in them.",
        )
    return notes


def _assembled(
    plant_at: Callable[[float], Plant],
    plant: Plant,
    controller: LawLike,
    requirements: Requirements,
    residual: Unbalance | None,
) -> tuple[list[Check], list[Curve]]:
    """Stability and the unbalance curve along the speed range, with the rotor assembled anew at
    every speed.
    """
    low, high = plant.machine.operation.speed_range
    even = np.linspace(low, high, _STABILITY_SPEEDS)
    knots = speed_knots(plant.machine, low, high)
    along = follow(
        lambda w: closed_loop(plant_at(w), controller),
        np.unique([*even, *knots]),
        critical=residual is not None,
    )
    stability = speed_stability_check(along)
    if residual is None or not stability.passed:
        return [stability], []
    low = max(low, 0.02 * high)
    speeds = np.unique([*np.linspace(low, high, _SPEEDS), *speed_knots(plant.machine, low, high)])
    if requirements.unbalance_to is not None and speeds[0] < requirements.unbalance_to < high:
        speeds = np.unique(np.append(speeds, requirements.unbalance_to))
    curve = replace(
        unbalance_curve(plant_at, speeds, controller, residual, along.critical),
        name="unbalance.assembled_0p",
    )
    return [stability, assembled_check(curve, requirements)], [curve]
