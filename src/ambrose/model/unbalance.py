"""What balancing leaves: the unbalance of a balance grade, and the force it makes.

A rotor of mass m balanced to grade G [m/s] at W_b keeps the unbalance U = m G / W_b [kg m]; at W it
pulls with F = U W^2 (ISO 21940-11).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_finite, invalid
from ambrose.machine.axial import AxialMachine
from ambrose.machine.criteria import BALANCE_GRADE
from ambrose.machine.description import Requirements
from ambrose.machine.machine import Machine
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.plant import top_speed


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
    if isinstance(machine, AxialMachine):
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
