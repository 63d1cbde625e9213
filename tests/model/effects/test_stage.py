"""Aerodynamic cross-coupling of stages: the printed formula, the affinity law, its uncertainty."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.machine.description import Tolerance
from ambrose.model.effect import ports_of
from ambrose.model.effects.stations import STAGE, Stage, cross_coupling, rated_cross_coupling
from ambrose.model.uncertainty import perturbed

RADIAL = Stage("wheel", 0.2, 300e3, 1000.0, 0.4, 0.02, 1.5)


@pytest.mark.parametrize(("kind", "factor", "density"), [("radial", 3.0, 1.5), ("axial", 1.5, 1.0)])
def test_the_printed_formula(kind, factor, density):
    """q [kN/mm] = P [W] B 9.55 (rho_d/rho_s)/(D [mm] H [mm] N [rpm])."""
    rpm = 1000.0 * 30 / np.pi
    printed = 300e3 * factor * 9.55 * density / (400 * 20 * rpm) * 1e6
    assert rated_cross_coupling(replace(RADIAL, kind=kind)) == pytest.approx(printed, rel=1e-4)


def test_it_goes_with_the_square_of_the_speed_and_drives_forward_whirl():
    rated = rated_cross_coupling(RADIAL)
    assert cross_coupling(RADIAL, 500.0) == pytest.approx(rated / 4)
    assert cross_coupling(RADIAL, 0.0) == 0.0
    reaction = STAGE.reaction(RADIAL, amb.OperatingPoint(speed=1000.0))
    # on a forward circle (cos, sin) the force -K q points along the velocity (-sin, cos)
    force = -reaction.stiffness @ np.array([1.0, 0.0])
    assert force[1] > 0
    np.testing.assert_allclose(reaction.stiffness, rated * np.array([[0, 1], [-1, 0]]))
    assert ports_of(STAGE, RADIAL) == ("wheel_x", "wheel_y")


def test_a_tolerance_moves_the_plant_as_another_power_does():
    machine = amb.load_machine("turboexpander")
    tolerance = Tolerance("stage.wheel.cross_coupling", relative=0.3)
    machine = replace(machine, effects=(RADIAL,), tolerances=(tolerance,))
    moved = perturbed(amb.assemble(machine), {"stage.wheel.cross_coupling": 1.0})
    other = amb.assemble(replace(machine, effects=(replace(RADIAL, power=1.3 * 300e3),)))
    np.testing.assert_allclose(
        moved.system.A, other.system.A, atol=1e-9 * abs(other.system.A).max()
    )
