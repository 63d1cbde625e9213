"""LPV on a machine: grid of speeds, common states of the family, what is refused. The synthesis itself: tests/literature."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.plant.assemble import assemble
from ambrose.plant.reduce import reduce
from ambrose.synthesis.design import METHODS, methods_for
from ambrose.synthesis.hinf.synthesis import hinf_synthesis
from ambrose.synthesis.lpv.machine import design_over_speed, plants_over_speed, speed_grid
from ambrose.synthesis.problem import design_plant

pytestmark = pytest.mark.campaign  # minutes

HZ = 2 * np.pi


@pytest.fixture(scope="module")
def plant():
    machine = load_machine("turboexpander")
    return assemble(machine, next(p for p in machine.operation.points if p.label.startswith("140 Hz")))


def test_speeds_are_those_of_the_operating_points_with_the_same_pressure(plant):
    speeds = speed_grid(plant.machine, plant.point, 5)
    np.testing.assert_allclose(speeds, np.linspace(20 * HZ, 31500 / 60 * HZ, 5))


def test_a_machine_without_a_range_of_speeds_is_told_so():
    machine = load_machine("seal-rig")  # a rig that hardly turns
    with pytest.raises(InvalidInput, match=r"no range of speeds .*give the speeds"):
        speed_grid(machine, machine.operation.nominal)


def test_family_has_one_state_basis(plant):
    """Everything but the seal's and gyroscopic entries of A is the same at all speeds: inputs, outputs and weights."""
    at = plants_over_speed(plant)
    slow, fast = at(20 * HZ).system, at(300 * HZ).system
    assert (slow.inputs, slow.outputs) == (fast.inputs, fast.outputs)
    for x in "BCD":
        np.testing.assert_allclose(getattr(slow, x), getattr(fast, x), rtol=1e-12)
    moved = np.abs(slow.A - fast.A).max(axis=1) > 1e-9 * np.abs(slow.A).max(axis=1)
    assert 0 < moved.sum() <= 4  # the four accelerations of the rigid rotor


def test_family_holds_the_same_plant_as_the_modal_reduction(plant):
    """Galerkin and modal reduction differ by the bending modes they leave out: H-infinity values within 1 %."""
    here = hinf_synthesis(plants_over_speed(plant)(plant.point.speed), tolerance=1e-5)
    modal = hinf_synthesis(design_plant(reduce(plant), uncertain=False), tolerance=1e-5)
    values = [r.certificate.margins["gamma_optimal"] for r in (here, modal)]
    assert values[0] == pytest.approx(values[1], rel=1e-2)


def test_lpv_is_a_method_that_is_asked_for_by_name(plant):
    assert "lpv" in METHODS
    assert "lpv" not in methods_for(plant)


def test_speed_of_the_plant_outside_the_grid_is_refused(plant):
    with pytest.raises(InvalidInput, match=r"plant's speed is .* rad/s, but must be between"):
        design_over_speed(plant, [150 * HZ, 300 * HZ])


@pytest.mark.parametrize("speeds", [[140 * HZ], [300 * HZ, 20 * HZ], [20 * HZ, np.nan]])
def test_bad_grids_are_refused(plant, speeds):
    with pytest.raises(InvalidInput, match="grid"):
        design_over_speed(plant, speeds)


def test_machine_without_weights_is_told_what_is_missing(plant):
    bare = replace(plant, machine=replace(plant.machine, weights=None))
    with pytest.raises(InvalidInput, match="weights"):
        design_over_speed(bare, [20 * HZ, 300 * HZ])
