"""The full plants at the operating points of a machine."""

from __future__ import annotations

from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import with_offsets_of


def envelope_of(plant: Plant) -> list[Plant]:
    """The full plants at all operating points of the machine, and the given one if it is at
    another.
    """
    points = plant.machine.operation.envelope
    plants = [
        plant if point == plant.point else with_offsets_of(assemble(plant.machine, point), plant)
        for point in points
    ]
    return plants if any(item is plant for item in plants) else [*plants, plant]
