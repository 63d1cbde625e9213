"""Stage: the plants of a machine, and what they tell about it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.chain.check import insight
from ambrose.chain.check_axial import along_doubts, axial_facts
from ambrose.chain.check_entries import entry_doubts, without_coefficients
from ambrose.core.checks import AmbroseError, named_failure
from ambrose.core.statespace import poles
from ambrose.machine.axial import AxialMachine
from ambrose.machine.machine import Machine
from ambrose.machine.messages import listed
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    mass_properties,
)
from ambrose.model.reduce import reduce_from


def facts(machine: Machine, file: str | None = None) -> dict[str, Any]:
    """What `ambrose check` tells about a machine, SI units: mass properties, bending frequencies,
    open-loop poles, sizes.

    file: what a failure is named after; default: the machine. Raises InvalidInput where a point has
    no model, NumericalFailure where numbers are too far apart, with every part without coefficients
    at an operating point, and every entry that is implausible, its probable cause.
    """
    try:
        # what overflows on the way is no figure
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            return _facts(machine)
    except AmbroseError as error:
        raise type(error)(listed(file or machine.name, _reasons(machine, str(error)))) from error


def _reasons(machine: Machine, failure: str) -> list[str]:
    """The failure, or all that are like it, and what may be its cause."""
    if isinstance(machine, AxialMachine):
        return [failure]
    found = [*without_coefficients(machine)]
    found = found if failure in found else [failure, *found]
    return [*found, *(line for line in entry_doubts(machine) if line not in "".join(found))]


@named_failure("the model of the machine")
def _facts(machine: Machine) -> dict[str, Any]:
    if isinstance(machine, AxialMachine):
        return axial_facts(machine)
    rotor = finite_element_rotor(machine)
    properties = mass_properties(rotor)
    plant = assemble(machine)
    reduced = reduce_from(plant, 0)
    values = poles(plant.rotor)
    known = {
        "machine": machine.name,
        "description": machine.description,
        "mass_kg": properties.mass,
        "centre_m": properties.centre,
        "diametral_inertia_kg_m2": properties.diametral_inertia,
        "polar_inertia_kg_m2": properties.polar_inertia,
        "unstable_poles_rad_s": [[float(p.real), float(p.imag)] for p in values if p.real > 0],
        "rotor_states": plant.rotor.n_states,
        "plant_states": plant.system.n_states,
        "reduced_rotor_states": reduced.rotor.n_states,
        "reduced_plant_states": reduced.system.n_states,
        "operating_points": [point.label for point in machine.operation.envelope],
        "tolerances": [tolerance.parameter for tolerance in machine.tolerances],
        "assumed": len(machine.assumed),
        **insight(
            plant
            if machine.operation.design is plant.point
            else assemble(machine, machine.operation.design)
        ),
    }
    known["doubts"] = [*known["doubts"], *along_doubts(machine)]
    return known
