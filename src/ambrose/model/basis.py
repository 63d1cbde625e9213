"""The coordinates of the full model: the lowest modes of the free rotor, and what the rest of them
yields at the ports.

Kept are all bending modes up to 100 kHz, 24 to 64 per plane; of a mesh with few modes all. The
static displacements that forces at the ports and the gyroscopic moments of the lowest modes leave
in the rest of them (residual attachment modes: MacNeal 1971, Rubin 1975) are coordinates like the
others: made orthonormal in the mass, with the frequencies that they have among themselves. So the
compliance of all modes is in the model, and what is cut off begins with the square of the
frequency.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ambrose.machine.axial import AxialMachine
from ambrose.machine.limits import FINE_MESH_MODES, LEAST_MODES
from ambrose.machine.machine import Machine
from ambrose.model.effects.rotor import (
    FreeModes,
    Rotor,
    displacement_row,
    finite_element_rotor,
    free_modes,
    plane_rows,
    residual_modes,
    to_plane,
)
from ambrose.model.plant import Plant, highest_verified
from ambrose.model.ports import Port, ports, sensor_ports

_HIGHEST = 2e5 * np.pi  # [rad/s] up to which every bending mode is kept
_TURNING = 3  # bending modes, beside tilting, whose gyroscopic moments have residual modes
_SMALL_MESH = 40  # bending modes per plane up to which all are kept


def bending_modes_of(rotor: Rotor) -> int:
    """How many true bending modes per plane the full model has; the mesh has 2 N - 2."""
    available = 2 * rotor.n_nodes - 2
    if available <= _SMALL_MESH:
        return available
    below = free_modes(rotor, min(available, FINE_MESH_MODES)).frequencies[4::2] <= _HIGHEST
    return min(max(int(below.sum()), LEAST_MODES), len(below))


def judged_bending(machine: Machine) -> np.ndarray:
    """The bending frequencies (k,) [rad/s] at which the sensitivity is judged."""
    if isinstance(machine, AxialMachine):
        return np.zeros(0)  # rigid along its axis
    rotor = finite_element_rotor(machine)
    frequencies = free_modes(rotor, bending_modes_of(rotor)).frequencies[4::2]
    return frequencies[frequencies <= highest_verified(machine)]


def modes_judged(plant: Plant) -> int:
    """How many bending modes per plane a model needs for the sensitivity to be judged on it: all
    of ``judged_bending``, and one more.
    """
    available = bending_modes_of(plant.rotor_model)
    frequencies = free_modes(plant.rotor_model, available).frequencies[4::2]
    return min(int((frequencies <= highest_verified(plant.machine)).sum()) + 1, available)


def modes_of(machine: Machine, rotor: Rotor, bending_modes: int | None) -> FreeModes:
    """The lowest ``bending_modes`` per plane; None: the modes of the full model, true ones and then
    residual ones.
    """
    if bending_modes is not None:
        return free_modes(rotor, bending_modes)
    return _full_modes(rotor, port_positions(machine))


def port_positions(machine: Machine) -> tuple[float, ...]:
    """The axial places [m] of all ports and sensors, ascending, each once."""
    return tuple(sorted({port.position for port in (*ports(machine), *sensor_ports(machine))}))


@lru_cache(maxsize=16)
def _full_modes(rotor: Rotor, forces: tuple[float, ...]) -> FreeModes:
    """With forces at axial positions [m]. Computed once; the arrays are read-only."""
    kept = bending_modes_of(rotor)
    true = free_modes(rotor, kept)
    if kept == 2 * rotor.n_nodes - 2:
        return true
    # loads: a unit force at every place, gyroscopic moments of tilting and the first bending modes
    turning = in_plane(true)[:, 1 : 2 + _TURNING].T @ rotor.plane_gyroscopic
    frequencies, plane = residual_modes(
        rotor, kept, np.vstack([plane_rows(rotor, forces)[0], turning])
    )

    # columns in turn: a mode in x, the same in y
    both = np.stack([to_plane(plane, "x"), to_plane(plane, "y")], axis=2).reshape(
        2 * len(plane), -1
    )
    arrays = (
        np.hstack([true.shapes, both]),
        np.concatenate([true.frequencies, np.repeat(frequencies, 2)]),
    )
    for array in arrays:
        array.flags.writeable = False
    return FreeModes(*arrays)


@lru_cache(maxsize=64)
def rows_in(rotor: Rotor, modes: FreeModes, places: tuple[Port, ...]) -> np.ndarray:
    """The rows (p, k) that read the displacement at ports from mode coordinates; read-only."""
    whole = [displacement_row(rotor, p.position, p.direction) for p in places]
    rows = np.reshape(whole, (len(places), len(modes.shapes))) @ modes.shapes
    rows.flags.writeable = False
    return rows


@lru_cache(maxsize=16)
def gyroscopic_of(rotor: Rotor, modes: FreeModes) -> np.ndarray:
    """The gyroscopic matrix (k, k) in mode coordinates, which come in x/y pairs of equal shape;
    read-only.

    Both planes share one symmetric matrix g, and G = g (x) [[0, 1], [-1, 0]]: an eighth of the work
    of the whole product.
    """
    # g = Phi^T G Phi of one plane
    plane = in_plane(modes)
    whole = np.kron(plane.T @ rotor.plane_gyroscopic @ plane, np.array([[0.0, 1.0], [-1.0, 0.0]]))
    whole.flags.writeable = False
    return whole


def in_plane(modes: FreeModes) -> np.ndarray:
    """The shapes (2N, k / 2) of the x plane, in [w, theta] per node."""
    plane = np.empty((len(modes.shapes) // 2, modes.shapes.shape[1] // 2))
    # x and beta of the x modes
    plane[0::2], plane[1::2] = modes.shapes[0::4, 0::2], modes.shapes[3::4, 0::2]
    return plane
