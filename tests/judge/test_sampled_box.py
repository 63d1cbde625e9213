"""The sampled loop over its tolerances, on the full plant: what the box says is never below a
member of it.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.judge.result import certify
from ambrose.judge.sampled import check_over_box, sampled_box
from ambrose.law.loop import Timing, match_controller
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Tolerance
from ambrose.machine.file.toml import load_machine
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import perturbed, tolerances_around

TIMING = Timing(5e-5)
DAMPING = Tolerance("rotor.bending_5.damping", 0.6)  # of a mode that a reduced plant had cut


def machine(*more):
    rig = load_machine("two-disc-rotor")
    return replace(rig, tolerances=(*rig.tolerances, *more))


@pytest.fixture(scope="module")
def loop():
    described = machine(DAMPING)
    plant = assemble(described)
    law = match_controller(pid_controller(described.reference, described), plant)
    return plant, TIMING.in_loop(law), tolerances_around(plant)


def test_aliases_give_the_plant_behind_its_hold(loop):
    """Against the matrix exponential, nominal and at a corner."""
    plant, controller, held = loop
    box = sampled_box(plant, controller, held)
    omega = np.geomspace(1.0, box.nyquist, 60)
    corner = np.array([1.0, -1.0, 1.0])[: len(held)]
    for delta in (np.zeros(len(held)), corner):
        member = perturbed(plant, box.named(delta), held)
        exact = c2d(select(member.system, member.named("u"), member.named("y")), 5e-5)
        wanted = frequency_response(exact, omega).values
        found = box.plant_response(omega, delta[None])[0]
        error = np.abs(found - wanted).max(axis=(1, 2)) / np.abs(wanted).max(axis=(1, 2))
        assert error.max() < 1e-4
        assert error[omega < 0.1 * box.nyquist].max() < 1e-7


def test_the_box_is_not_below_its_nominal_point_nor_any_member(loop):
    plant, controller, held = loop
    box = check_over_box(plant, controller, held)
    value = box["sampled.sensitivity.box"].value
    nominal = certify(plant, controller, margins=False).closed_loop_norm
    assert value >= nominal * (1 - 1e-6)
    found = sampled_box(plant, controller, held)
    rng = np.random.default_rng(11)
    members = rng.uniform(-1, 1, (200, len(held)))
    members[::2] = np.sign(members[::2])
    resonances = found.beside(found.closed_loop_poles(members[0]))
    grid = np.union1d(found.base_grid(), resonances)
    assert value >= found.gains(grid, members).max() * (1 - 1e-6)


def test_the_worst_member_is_confirmed_by_its_own_norm(loop):
    """The member that the box names, assembled and sampled by itself."""
    plant, controller, held = loop
    box = sampled_box(plant, controller, held)
    check = check_over_box(plant, controller, held)["sampled.sensitivity.box"]
    worst = 0.0
    for corner in np.array(np.meshgrid(*[(-1.0, 1.0)] * len(held))).reshape(len(held), -1).T:
        member = perturbed(plant, box.named(corner), held)
        worst = max(worst, certify(member, controller, margins=False).closed_loop_norm)
    assert check.value == pytest.approx(worst, rel=1e-4)
