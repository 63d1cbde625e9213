"""The rotor under its weight, held where its sensors read zero: what each magnet carries, how far
it hangs through there, and what that makes of the magnets' coefficients.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from ambrose.core.checks import named_failure
from ambrose.machine.axial import AxialMachine
from ambrose.machine.description import BiasPoint, MagneticBearing, OperatingPoint
from ambrose.machine.limits import FINE_MESH_MODES
from ambrose.machine.machine import Machine
from ambrose.model.axial.magnet import at_point
from ambrose.model.effects.loaded_magnet import LoadedMagnet, carrying
from ambrose.model.effects.magnet import MagnetCoefficients
from ambrose.model.effects.rotor import (
    Rotor,
    displacement_row,
    finite_element_rotor,
    free_modes,
    gravity_load,
)
from ambrose.model.ports import measured_ports


def static_sag(machine: Machine) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (b, 2) [m] at the magnets and weight (b, 2) [N] on them, along each bearing's
    axes; zero without weight.

    The shaft alone: K w = W + B^T f with S w = 0 at the sensors; couplings, seals and supports are
    left out. A slender rotor hangs tens of micrometres through between sensor and magnet, where the
    negative stiffness is then another.
    """
    b = len(machine.bearings)
    if machine.gravity_direction is None or not b:
        return np.zeros((b, 2)), np.zeros((b, 2))
    magnets = tuple(bearing.position for bearing in machine.bearings)
    read = tuple(port.position for port in measured_ports(machine)[::2])
    place, weight = weight_in_plane(finite_element_rotor(machine), magnets, read, magnets)
    angle = np.array([machine.gravity_direction - bearing.angle for bearing in machine.bearings])
    along = np.column_stack([np.cos(angle), np.sin(angle)])
    return place[:, None] * along, weight[:, None] * along


def sag_line(machine: Machine, positions: tuple[float, ...]) -> np.ndarray:
    """How far the shaft hangs through (p,) [m] at axial positions [m], downwards from the sensors'
    zero; zero without weight or without magnets (an oil film's rest position is not known).
    """
    if machine.gravity_direction is None or not machine.bearings or not positions:
        return np.zeros(len(positions))
    magnets = tuple(bearing.position for bearing in machine.bearings)
    read = tuple(port.position for port in measured_ports(machine)[::2])
    return weight_in_plane(finite_element_rotor(machine), magnets, read, positions)[0]


@lru_cache(maxsize=16)
@named_failure("the static deflection of the rotor")
def weight_in_plane(
    rotor: Rotor,
    magnets: tuple[float, ...],
    sensors: tuple[float, ...],
    places: tuple[float, ...],
) -> tuple[np.ndarray, np.ndarray]:
    """Displacement (p,) [m] at ``places`` and weight (b,) [N] on the magnets, both downwards, in
    modes of the free rotor.
    """
    modes = free_modes(rotor, min(2 * rotor.n_nodes - 2, FINE_MESH_MODES))
    w = modes.frequencies[0::2]
    shapes = modes.shapes[:, 0::2]
    b = len(magnets)
    at, at_sensors, at_places = (
        np.array([displacement_row(rotor, x, 0.0) for x in where]) @ shapes
        for where in (magnets, sensors, places)
    )

    # Unknowns: modal displacements q and the magnets' forces f; w^2 q - at^T f = W, read q = 0.
    # size of the coordinates: all have the stiffness of the first bending mode
    size = np.maximum(w, w[2] if len(w) > 2 else 1.0)
    whole = np.block(
        [[np.diag((w / size) ** 2), -(at / size).T], [at_sensors / size, np.zeros((b, b))]]
    )
    right = np.concatenate([shapes.T @ gravity_load(rotor, 0.0) / size, np.zeros(b)])
    # a single magnet carries the whole, however the rotor hangs
    solution = np.linalg.lstsq(whole, right, rcond=1e-13)[0]
    return at_places @ (solution[: len(w)] / size), -solution[len(w) :]


def operating_magnets(
    machine: Machine, bias_current: float | None = None
) -> tuple[LoadedMagnet, ...]:
    """Every bearing's magnets as they work: while they carry the rotor at the sensors' zero, at a
    bias current [A] (None: each bearing's own). Raises InvalidInput as ``magnet.linearised`` does.
    """
    loads = zip(machine.bearings, *static_sag(machine), strict=True)
    return tuple(
        _carrying(bearing, _pair(weight), _pair(place), bias_current)
        for bearing, place, weight in loads
    )


def magnet_coefficients(machine: Machine, point: OperatingPoint) -> tuple[np.ndarray, np.ndarray]:
    """k_i (a,) [N/A] and k_s (a,) [N/m] of the control axes at an operating point, see
    ``operating_magnets``; of the axis along the shaft at rest, before the core's lag.
    """
    if isinstance(machine, AxialMachine):
        at = at_point(machine, point)
        return np.array([at.force_per_current]), np.array([at.stiffness])
    coefficients = [
        magnet.coefficients for magnet in operating_magnets(machine, point.bias_current)
    ]
    k_i = np.array([value for item in coefficients for value in item.force_per_current])
    return k_i, np.array([value for item in coefficients for value in item.negative_stiffness])


def stated_at_load(machine: Machine, bearing: MagneticBearing) -> MagneticBearing:
    """The same magnets with coefficients and measured rows as they are under the machine's static
    load; as they stand where there is none, or they are so already.
    """
    if machine.gravity_direction is None or bearing.coefficients_at == "static-load":
        return bearing
    at = machine.bearings.index(bearing)

    def here(bias: float) -> MagnetCoefficients:
        return operating_magnets(machine, bias)[at].coefficients

    at_rest, rows = here(bearing.bias_current), []
    for row in bearing.measured:
        at_bias = here(row.bias_current)
        rows.append(
            BiasPoint(row.bias_current, at_bias.force_per_current, at_bias.negative_stiffness)
        )
    return replace(
        bearing,
        coefficients_at="static-load",
        force_per_current=at_rest.force_per_current,
        negative_stiffness=at_rest.negative_stiffness,
        measured=tuple(rows),
    )


@lru_cache(maxsize=256)
def _carrying(
    bearing: MagneticBearing,
    weight: tuple[float, float],
    place: tuple[float, float],
    bias: float | None,
) -> LoadedMagnet:
    return carrying(bearing, weight, place, bias)


def _pair(values: np.ndarray) -> tuple[float, float]:
    return float(values[0]), float(values[1])
