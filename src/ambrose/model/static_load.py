"""The rotor under its weight, held where its sensors read zero: what each magnet carries, how far
it hangs through there, and what that makes of the magnets' coefficients.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_finite, invalid, named_failure
from ambrose.machine.criteria import BALANCE_GRADE
from ambrose.machine.description import BiasPoint, MagneticBearing, OperatingPoint, Requirements
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import FINE_MESH_MODES
from ambrose.model.axial import at_point
from ambrose.model.effects.magnet import LoadedMagnet, MagnetCoefficients, carrying
from ambrose.model.effects.rotor import (
    Rotor,
    displacement_row,
    finite_element_rotor,
    free_modes,
    gravity_load,
    mass_properties,
)
from ambrose.model.plant import measured_ports, top_speed


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
    modes = free_modes(rotor, min(rotor.most_bending, FINE_MESH_MODES))
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
    k_i, k_s = each_magnet(machine, point).sum(axis=2)
    return k_i, k_s


def each_magnet(machine: Machine, point: OperatingPoint) -> np.ndarray:
    """k_i [N/A] and k_s [N/m] (2, a, p) of the p magnets of every axis (``machine.magnets``)."""
    if machine.lateral:
        pairs = [item.coefficients for item in operating_magnets(machine, point.bias_current)]
        rows = [(item.force_per_current, item.negative_stiffness) for item in pairs]
        return np.array(rows).reshape(-1, 2, 2).swapaxes(0, 1).reshape(2, -1, 1)
    at = at_point(machine, point)
    return np.array([(one.force_per_current, one.stiffness) for one in (at.left, at.right)]).T[
        :, None
    ]


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


# What balancing leaves: the unbalance of a balance grade, and the force it makes.
#
# A rotor of mass m balanced to grade G [m/s] at W_b keeps the unbalance U = m G / W_b [kg m]; at W
# it pulls with F = U W^2 (ISO 21940-11).


@dataclass(frozen=True, slots=True)
class Unbalance:
    """moment U [kg m]; mass [kg]; grade [m/s]; speed W_b [rad/s] of balancing; share (bearings,) of
    U per bearing plane.
    """

    moment: float
    mass: float
    grade: float
    speed: float
    share: tuple[float, ...]

    def force(self, speed: ArrayLike) -> np.ndarray:
        """F = U W^2 [N] at speeds W (w,) [rad/s]."""
        return self.moment * np.asarray(speed) ** 2


def residual_unbalance(
    machine: Machine, requirements: Requirements | None = None
) -> Unbalance | None:
    """The unbalance that the grade leaves (default G2.5) at the balancing speed (default: the
    machine's highest speed).

    None when no such speed is known. Raises InvalidInput for a grade or speed that is not positive.
    """
    requirements = machine.requirements if requirements is None else requirements
    if not machine.lateral:
        return None  # it turns in the radial planes
    speed = requirements.balance_speed or top_speed(machine)
    if not speed:
        return None
    grade = (
        BALANCE_GRADE.limits[0].value
        if requirements.balance_grade is None
        else requirements.balance_grade
    )
    properties = mass_properties(finite_element_rotor(machine))
    return unbalance(properties.mass, grade, speed, _shares(machine, properties.centre))


def unbalance(
    mass: float, grade: float, speed: float, share: Sequence[float] = (0.5, 0.5)
) -> Unbalance:
    """The residual unbalance of a mass [kg] at a grade [m/s] and speed [rad/s]. Raises InvalidInput
    unless all are positive.
    """
    for name, value in (
        ("the rotor's mass [kg]", mass),
        ("balance_grade", grade),
        ("balance_speed", speed),
    ):
        if not float(check_finite(value, name)) > 0:
            raise invalid(name, value, "positive", "G2.5 is 2.5e-3 m/s; speeds are in rad/s")
    return Unbalance(mass * grade / speed, mass, grade, speed, tuple(share))


def _shares(machine: Machine, centre: float) -> tuple[float, ...]:
    """Lever rule for two bearings on either side of the centre of mass; equal shares otherwise."""
    position = [bearing.position for bearing in machine.bearings]
    if len(position) == 2 and min(position) < centre < max(position):
        a = (position[1] - centre) / (position[1] - position[0])
        return (a, 1 - a)
    return tuple(1 / len(position) for _ in position)


# How far a critical speed stays from the running speeds, after API 617 (as public code cites its
# 7th to 9th edition).
#
# A critical speed with the amplification factor AF >= 2.5 needs the separation margin
#
#     SM = min(16 %, 17 % (1 - 1/(AF - 1.5)))            of the lowest running speed, below it,
#     SM = min(26 %, 10 % + 17 % (1 - 1/(AF - 1.5)))     of the highest, above it,
#
# and none of them may lie between the two. Read the other way round, each place allows an
# amplification factor.


LEAST_AMPLIFICATION = 2.5  # below it a peak is critically damped: no critical speed
_OFFSET, _SPAN = 1.5, 0.17  # of SM = 17 % (1 - 1/(AF - 1.5))
# margin from which more than 2.5 is allowed, and from which anything is
_BELOW, _ABOVE = (0.0, 0.16), (0.10, 0.26)


def running_range(
    stated: tuple[float, float] | None, speeds: Iterable[float]
) -> tuple[float, float] | None:
    """Between which speeds [rad/s] a machine runs: as stated, else from the slowest to the fastest
    of its turning operating points' ``speeds``; None: none turns.
    """
    turning = [speed for speed in speeds if speed > 0]
    return stated or ((min(turning), max(turning)) if turning else None)


def runs_within(speed: float, running: tuple[float, float]) -> bool:
    """Whether an operating point's speed lies within the running speeds, all [rad/s]."""
    return running[0] * (1 - 1e-9) <= speed <= running[1] * (1 + 1e-9)


def allowed_amplification(
    omega: np.ndarray, running: tuple[float, float], capped: bool = True
) -> np.ndarray:
    """The largest amplification factor allowed of a critical speed at omega (n,) [rad/s]; inf far
    from ``running`` [rad/s].

    capped: with the standard's jump to "anything" at 16 and 26 %; without, where the formula's own
    pole lies, at 17 and 27 %.
    """
    omega = np.asarray(omega, float)
    low, high = running
    below = omega < low
    margin = np.where(below, (low - omega) / low, np.maximum(omega - high, 0.0) / high)
    free, cap = (np.where(below, _BELOW[k], _ABOVE[k]) for k in (0, 1))
    share = np.clip((margin - free) / _SPAN, 0.0, 1.0)
    with np.errstate(divide="ignore"):
        allowed = _OFFSET + 1 / (1 - share)
    return np.where(capped & (margin >= cap), np.inf, allowed)


def needed_damping(
    omega: np.ndarray, running: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """The damping ratio 1/(2 AF) that the place omega [rad/s] of every mode asks for, and its
    derivative [s/rad].

    Continuous over omega: 0.2 between the running speeds, 0 beyond 17 and 27 % of them.
    """
    low, high = running
    below = omega < low
    margin = np.where(below, (low - omega) / low, np.maximum(omega - high, 0.0) / high)
    slope = np.where(below, -1 / low, np.where(omega > high, 1 / high, 0.0))
    free = np.where(below, _BELOW[0], _ABOVE[0])
    # 1 where 2.5 is allowed, 0 where anything is
    left = np.clip(1 - (margin - free) / _SPAN, 0.0, 1.0)
    within = (left > 0) & (left < 1)
    size = _OFFSET * left + 1
    return left / (2 * size), np.where(within, -slope / _SPAN / (2 * size**2), 0.0)
