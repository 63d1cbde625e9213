"""LPV on a machine: grid of speeds, common states of the family, what is refused. The synthesis
itself: tests/literature.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.annexes.scheduled.lpv.machine import design_schedule, plants_along, schedule_grid
from ambrose.core.checks import InvalidInput
from ambrose.core.norms import hinf_norm
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import feedback, is_stable, select, series, static_gain
from ambrose.judge.result import sampled_margins
from ambrose.judge.verdict import verify_controller
from ambrose.law.design_problem import design_plant
from ambrose.law.law import PRESSURE
from ambrose.law.loop import Timing
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.synthesis.design import design, methods_for
from ambrose.synthesis.hinf import hinf_synthesis
from ambrose.synthesis.methods import methods
from coarse import coarse

HZ = 2 * np.pi


@pytest.fixture(scope="module")
def plant():
    machine = coarse("turboexpander")
    return assemble(
        machine, next(p for p in machine.operation.points if p.label.startswith("140 Hz"))
    )


def test_speeds_are_those_of_the_operating_points_with_the_same_pressure(plant):
    speeds = schedule_grid(plant.machine, plant.point, count=5)
    np.testing.assert_allclose(speeds, np.linspace(20 * HZ, 31500 / 60 * HZ, 5))


def test_a_machine_without_a_range_of_speeds_is_told_so():
    machine = load_machine("seal-rig")  # a rig that hardly turns
    with pytest.raises(InvalidInput, match=r"no range of speeds .*give the speeds"):
        schedule_grid(machine, machine.operation.nominal)


def test_family_has_one_state_basis(plant):
    """Everything but the seal's and gyroscopic entries of A is the same at all speeds: inputs,
    outputs and weights.
    """
    at = plants_along(plant)
    slow, fast = at(20 * HZ).system, at(300 * HZ).system
    assert (slow.inputs, slow.outputs) == (fast.inputs, fast.outputs)
    for x in "BCD":
        np.testing.assert_allclose(getattr(slow, x), getattr(fast, x), rtol=1e-12)
    moved = np.abs(slow.A - fast.A).max(axis=1) > 1e-9 * np.abs(slow.A).max(axis=1)
    assert 0 < moved.sum() <= 4  # the four accelerations of the rigid rotor


def test_family_holds_the_same_plant_as_the_modal_reduction(plant):
    """Galerkin and modal reduction differ by the bending modes they leave out: H-infinity values
    within 1 %.
    """
    here = hinf_synthesis(plants_along(plant)(plant.point.speed), tolerance=1e-5)
    modal = hinf_synthesis(design_plant(reduce(plant), uncertain=False), tolerance=1e-5)
    values = [r.certificate.margins["gamma_optimal"] for r in (here, modal)]
    assert values[0] == pytest.approx(values[1], rel=1e-2)


def test_lpv_is_a_method_that_is_asked_for_by_name(plant):
    assert "lpv" in methods()
    assert "lpv" not in methods_for(plant)


def test_speed_of_the_plant_outside_the_grid_is_refused(plant):
    with pytest.raises(InvalidInput, match=r"plant's speed is .* rad/s, but must be between"):
        design_schedule(plant, [150 * HZ, 300 * HZ])


@pytest.mark.parametrize("speeds", [[140 * HZ], [300 * HZ, 20 * HZ], [20 * HZ, np.nan]])
def test_bad_grids_are_refused(plant, speeds):
    with pytest.raises(InvalidInput, match="grid"):
        design_schedule(plant, speeds)


def test_machine_without_weights_is_told_what_is_missing(plant):
    bare = replace(plant, machine=replace(plant.machine, weights=None))
    with pytest.raises(InvalidInput, match="weights"):
        design_schedule(bare, [20 * HZ, 300 * HZ])


@pytest.fixture(scope="module")
def rig():
    return assemble(coarse("seal-rig"))


@pytest.fixture(scope="module")
def made(rig):
    return design(rig, "lpv", pressures=(0.0, 4.08e5))


def test_pressures_are_those_of_the_operating_points_of_the_same_speed(rig):
    np.testing.assert_allclose(
        schedule_grid(rig.machine, rig.point, PRESSURE, 3), [0.0, 2.04e5, 4.08e5]
    )


def test_the_seals_forces_alone_change_with_the_pressure(rig):
    at = plants_along(rig, PRESSURE)
    none, twice = at(0.0).system, at(4.08e5).system
    for x in "BCD":
        np.testing.assert_array_equal(getattr(none, x), getattr(twice, x))
    middle = at(2.04e5).system.A
    np.testing.assert_allclose((none.A + twice.A) / 2, middle, atol=1e-12 * np.abs(middle).max())
    assert 0 < (np.abs(twice.A - none.A).max(axis=1) > 1e-9 * np.abs(none.A).max(axis=1)).sum() <= 4


def test_the_certificate_is_the_worst_of_the_full_plant_at_every_pressure(rig, made):
    """Recomputed at twice as many pressures, from plants assembled anew; what is between the grid
    is not far off.
    """
    law, margins = made.scheduled, made.certificate.margins
    assert (made.status, law.parameter, law.unit, law.range) == (
        "verified",
        "pressure",
        "Pa",
        (0.0, 4.08e5),
    )
    peaks = {}
    for pressure in np.linspace(0.0, 4.08e5, 15):
        full = assemble(rig.machine, replace(rig.point, seal_pressure=float(pressure)))
        G = select(full.system, full.named("u"), full.named("y"))
        S = feedback(static_gain(np.eye(4)), series(law.at(pressure), G))
        assert is_stable(S)
        peaks[pressure] = hinf_norm(S).value
    at_grid = {p: peak for p, peak in peaks.items() if np.isclose(law.grid, p, atol=1.0).any()}
    assert margins["full_sensitivity_peak"] == pytest.approx(max(at_grid.values()), rel=1e-4)
    assert margins["worst_pressure"] == pytest.approx(max(at_grid, key=lambda p: at_grid[p]))
    assert max(peaks.values()) < 1.03 * max(at_grid.values())
    assert set(made.certificate.envelope) == {
        "nominal pressure",
        "zero pressure",
        "twice nominal pressure",
    }


@pytest.mark.study
def test_nearer_to_the_optimum_the_sensitivity_falls_and_poles_are_faster(rig, made):
    near = design(rig, "lpv", pressures=(0.0, 4.08e5), backoff=1.04)
    margins = [result.certificate.margins for result in (near, made)]
    assert margins[0]["gamma_designed"] == pytest.approx(
        1.04 * margins[0]["gamma_optimal"], rel=1e-6
    )
    assert margins[0]["full_sensitivity_peak"] < 0.97 * margins[1]["full_sensitivity_peak"]
    fastest = [max(abs(np.linalg.eigvals(result.controller.A))) for result in (near, made)]
    assert near.status == "verified" and fastest[0] > fastest[1]


def test_points_beyond_its_pressures_are_left_out_of_a_verification(rig, made):
    narrow = ScheduledSystem(
        [0.0, 2.04e5], [made.scheduled.at(0.0), made.scheduled.at(2.04e5)], "pressure", "Pa"
    )
    verification = verify_controller(rig.machine, narrow, tolerances=False)
    assert verification.left_out == ("twice nominal pressure",) and not verification.passed
    assert [checks.label for checks in verification.points] == ["nominal pressure", "zero pressure"]


@pytest.mark.study
def test_a_bounded_rate_is_told(rig):
    grid = [0.0, 2.04e5, 4.08e5]
    bounded = design_schedule(rig, grid, PRESSURE, rate=20e5)
    assert any("up to 2e+06 Pa/s either way" in note for note in bounded.notes)
    assert (
        bounded.certificate.margins["gamma_optimal"]
        <= 1.4
        < design_schedule(rig, grid, PRESSURE).gamma
    )


def test_a_machine_of_one_pressure_is_told_so(rig):
    one = replace(
        rig.machine,
        operation=replace(rig.machine.operation, points=rig.machine.operation.points[:1]),
    )
    with pytest.raises(
        InvalidInput, match=r"no range of pressures at the speed of .*--pressures-bar"
    ):
        schedule_grid(one, one.operation.nominal, PRESSURE)


def test_a_rate_puts_the_sampled_loops_delay_into_the_model(rig):
    """The loop as it runs at 10 kHz gains by it, and the design has a state more for each axis."""
    grid = [0.0, 2.04e5, 4.08e5]
    timing = Timing(1e-4, 1)
    plain, late = (design_schedule(rig, grid, PRESSURE, lag=lag) for lag in (0.0, timing.lag))
    assert late.scheduled.n_states == plain.scheduled.n_states + 4
    peaks = [
        sampled_margins(rig, made.scheduled, timing)["sampled_sensitivity_peak"]
        for made in (plain, late)
    ]
    assert peaks[1] < 0.95 * peaks[0]
