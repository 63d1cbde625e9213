"""The force of every component on the rotor that moves as x e^{s t}: magnets, seals, stages,
bearings and couplings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ambrose.annexes.rotordynamics.loop import ShaftLoop
from ambrose.model.assemble import constant_coefficients, seal_model
from ambrose.model.effect import reactions
from ambrose.model.effects import seal as seals
from ambrose.model.effects import seal_rational
from ambrose.model.static_load import magnet_coefficients


@dataclass(frozen=True, slots=True, eq=False)
class ComponentForce:
    """Force [N] and motion [m] (p,) of a component at its p ports, complex amplitudes; station:
    where it stands.
    """

    name: str
    station: str
    motion: np.ndarray
    force: np.ndarray


def forces_of_components(loop: ShaftLoop, s: complex, x: np.ndarray) -> Iterator[ComponentForce]:
    """The force of every component for states x (n,) at s; components without one are left out."""
    plant = loop.plant
    machine, point = plant.machine, plant.point

    def motion(names: list[str]) -> np.ndarray:
        rows = [plant.system.outputs.index(f"q_{name}") for name in names]
        return np.asarray(plant.system.C[rows] @ x)

    # magnets: k_i i + k_s q along each axis
    if machine.bearings:
        k_i, k_s = magnet_coefficients(machine, point)
        at = motion(list(plant.axes))
        current = loop.currents(s, x) if loop.law is not None else np.zeros(len(at))
        force = k_i * current + k_s * at
        for k, bearing in enumerate(machine.bearings):
            axes = slice(2 * k, 2 * k + 2)
            yield ComponentForce(f"magnet {bearing.name}", bearing.name, at[axes], force[axes])

    # registered effects: -(K + s D + s^2 M) q + H (s I - A)^-1 B q
    for names, reaction in reactions(machine, point):
        at = motion(list(names))
        dynamic = reaction.stiffness + s * reaction.damping + s**2 * reaction.mass
        force = -dynamic @ at
        if reaction.n_states:
            inner = np.linalg.solve(s * np.eye(reaction.n_states) - reaction.A, reaction.B @ at)
            force = force + reaction.H @ inner
        matrices = (reaction.stiffness, reaction.damping, reaction.mass)
        if reaction.n_states or any(matrix.any() for matrix in matrices):
            station = names[0].rpartition("_")[0]
            yield ComponentForce(station, station, at, force)

    # seals: -(K + s C + s^2 M) q, and the states of those that depend on the frequency
    for item in machine.seals:
        at = motion([f"{item.name}_x", f"{item.name}_y"])
        rational = seal_rational.has_states(item)
        stiff, damping, mass = seals.matrices(constant_coefficients(machine, item, point))
        force = -(stiff + s * damping + s**2 * mass) @ at
        if rational and point.seal_pressure > 0:
            system = seal_rational.system(seal_model(machine, item, point), item.name)
            given = [system.inputs.index(f"q_{item.name}_{axis}") for axis in "xy"]
            taken = [system.outputs.index(f"h_{item.name}_{axis}") for axis in "xy"]
            inner = np.linalg.solve(s * np.eye(system.n_states) - system.A, system.B[:, given] @ at)
            force = force + system.C[taken] @ inner + system.D[np.ix_(taken, given)] @ at
        yield ComponentForce(f"seal {item.name}", item.name, at, force)
