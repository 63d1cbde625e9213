"""Stage: the plants of a machine, and what they tell about it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import poles, select
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import operating_point
from ambrose.physics.rotor import finite_element_rotor, free_bending_frequencies, mass_properties
from ambrose.plant.assemble import assemble
from ambrose.plant.model import Plant
from ambrose.plant.reduce import reduce
from ambrose.synthesis.lpv.machine import speed_grid
from ambrose.verification.checks import Curve


def full_plants(machine: Machine) -> tuple[Plant, ...]:
    """The full finite-element plant at every operating point of the machine; the first is the one designs are made for."""
    first = machine.operation.design
    others = [point for point in machine.operation.points if point is not first]
    return tuple(assemble(machine, point) for point in (first, *others))


def plant_at(machine: Machine, label: str | None) -> Plant:
    """The full plant at the operating point of that label, or of which it is the beginning (None: the design point).

    Raises InvalidInput.
    """
    return assemble(machine, machine.operation.design if label is None else operating_point(machine, label))


def schedulable(plant: Plant) -> bool:
    """Whether the operating points around the plant's give a range of speeds to schedule over."""
    try:
        speed_grid(plant.machine, plant.point)
    except InvalidInput:
        return False
    return plant.machine.weights is not None


def covers(law: Any, plant: Plant) -> bool:
    """Whether a law is meant for the plant's speed and seal pressure: a schedule has a range, and a pressure it was made at."""
    if not isinstance(law, ScheduledSystem):
        return True
    low, high = law.range
    design = plant.machine.operation.design
    slack = 1e-9 * high
    return low - slack <= plant.point.speed <= high + slack and plant.point.seal_pressure == design.seal_pressure


def plants_along_speed(plant: Plant) -> Callable[[float], Plant]:
    return lambda speed: assemble(plant.machine, replace(plant.point, speed=speed))


def facts(machine: Machine) -> dict[str, Any]:
    """What `ambrose check` tells about a machine, SI units: mass properties, bending frequencies, open-loop poles, sizes."""
    rotor = finite_element_rotor(machine)
    properties = mass_properties(rotor)
    plant = assemble(machine)
    reduced = reduce(plant)
    values = poles(plant.rotor)
    return {
        "machine": machine.name,
        "description": machine.description,
        "mass_kg": properties.mass,
        "centre_m": properties.centre,
        "diametral_inertia_kg_m2": properties.diametral_inertia,
        "polar_inertia_kg_m2": properties.polar_inertia,
        "bending_rad_s": free_bending_frequencies(rotor, 3).tolist(),
        "unstable_poles_rad_s": [[float(p.real), float(p.imag)] for p in values if p.real > 0],
        "rotor_states": plant.rotor.n_states,
        "plant_states": plant.system.n_states,
        "reduced_rotor_states": reduced.rotor.n_states,
        "reduced_plant_states": reduced.system.n_states,
        "operating_points": [point.label for point in machine.operation.points],
        "tolerances": [tolerance.parameter for tolerance in machine.tolerances],
        "assumed": len(machine.assumed),
    }


def model_comparison(plant: Plant, reduced: Plant) -> list[tuple[str, Curve]]:
    """Largest singular value of currents -> sensors, full and reduced model, 1 Hz to 5 kHz."""
    omega = np.geomspace(2 * np.pi, 2 * np.pi * 5000, 600)
    pairs = []
    for label, model in (
        (f"full, {plant.rotor.n_states} states", plant),
        (f"reduced, {reduced.rotor.n_states} states", reduced),
    ):
        response = frequency_response(select(model.system, model.named("u"), model.named("y")), omega)
        gain = response.max_singular_value()[None]
        name = "plant gain, currents to sensors"
        pairs.append((label, Curve("plant.gain", name, "frequency", omega, gain, ("max singular value",), "rad/s", "m/A")))
    return pairs
