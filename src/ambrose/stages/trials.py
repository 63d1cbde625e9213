"""Stage: a controller tried in time, on the linear loop and on the nonlinear virtual rig."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from ambrose.core.scheduled import ScheduledSystem
from ambrose.physics.rotor import finite_element_rotor, mass_properties
from ambrose.plant.loop import closed_loop
from ambrose.plant.model import Plant
from ambrose.simulation import linear, virtual_rig
from ambrose.simulation.run_up import spin_up
from ambrose.simulation.scenario import load_scenario
from ambrose.simulation.trace import Trace
from ambrose.synthesis.controller_file import match_controller

Progress = Callable[[str], None]
SCENARIOS = ("impulse-orthogonal", "impulse-parallel")  # the two disturbance patterns of P5


def simulations(plants: tuple[Plant, ...], controller: Any, progress: Progress) -> tuple[tuple[str, Trace], ...]:
    """Impulse responses at every operating point: both patterns of P5 on the linear loop, one also on the nonlinear rig."""
    traces = []
    for plant in plants:
        label = plant.point.label
        progress(f"simulating at {label}")
        traces += [(label, simulation(plant, controller, name)) for name in SCENARIOS]
        progress(f"virtual rig at {label}")
        traces.append((label, experiment(plant, controller, SCENARIOS[-1])))
    return tuple(traces)


def experiment(plant: Plant, controller: Any, scenario: str) -> Trace:
    """One scenario on the nonlinear virtual rig with the controller as it would be deployed; touchdown is an outcome.

    Only the measured displacements are kept: the currents carry the rotor's weight and hide the response beside it.
    """
    trace = virtual_rig.run(plant.machine, controller, load_scenario(scenario), point=plant.point)
    measured = trace.record.select(plant.named("y"))
    return replace(trace, record=measured, scenario=f"{scenario} on the virtual rig")


def simulation(plant: Plant, controller: Any, scenario: str) -> Trace:
    """One scenario on the linear closed loop; stops where the rotor would touch down.

    Where the scenario changes the speed, the plant changes with it (``simulate.spin_up``).
    """
    events = load_scenario(scenario)
    if events.runs_up:
        scheduled = isinstance(controller, ScheduledSystem)
        return spin_up(plant, controller if scheduled else match_controller(controller, plant), events)
    gaps = [b.touchdown_gap for b in plant.machine.bearings if b.touchdown_gap is not None]
    return linear.run(
        closed_loop(plant, match_controller(controller, plant)),
        events,
        machine=plant.machine.name,
        point=plant.point,
        mass=mass_properties(finite_element_rotor(plant.machine)).mass,
        displacement_limit=min(gaps, default=None),
    )
