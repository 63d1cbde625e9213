"""The reduced plant with some parameters moved."""

from __future__ import annotations

from collections.abc import Mapping

from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import TIMING
from ambrose.plant.assemble import assemble
from ambrose.plant.model import Plant
from ambrose.plant.reduce import free_mode_reduction
from ambrose.plant.uncertainty import channels, perturbed


def plant_at(machine: Machine, point: OperatingPoint, values: Mapping[str, float], bending_modes: int = 1) -> Plant:
    """The reduced plant at an operating point with these values, SI, at these paths but those of delays.

    Raises InvalidInput.
    """
    plant = free_mode_reduction(assemble(machine, point), bending_modes)
    moves = {path: value - channels(plant, path)[0].nominal for path, value in values.items() if path not in TIMING}
    moves = {path: move for path, move in moves.items() if move}
    if not moves:
        return plant
    tolerances = [Tolerance(path, absolute=abs(move)) for path, move in moves.items()]
    return perturbed(plant, {path: 1.0 if move > 0 else -1.0 for path, move in moves.items()}, tolerances)
