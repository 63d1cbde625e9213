"""What a result does not cover is said beside it: speeds beyond the machine's own, and bending modes
that are judged but not in the model.
"""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.chain.check import facts
from ambrose.machine.description import OperatingPoint, Operation
from ambrose.model.assemble import assemble, judged_bending
from ambrose.model.effects.rotor import finite_element_rotor, free_bending_frequencies
from ambrose.model.plant import beyond_top_speed
from ambrose.rig.scenario import Scenario
from ambrose.synthesis.design import explained
from coarse import coarse

MACHINE = coarse("two-disc-rotor")
TOP = MACHINE.operation.speed_range[1]
HERTZ = 2 * np.pi


@pytest.fixture(scope="module")
def pid():
    return amb.design(MACHINE, "pid")


def test_a_speed_beyond_the_machine_s_own_is_said():
    assert beyond_top_speed(MACHINE, TOP) == ""
    assert beyond_top_speed(MACHINE, 1.4 * TOP).startswith(
        f"{1.4 * TOP * 30 / np.pi:,.6g} rpm is 140 % of the {TOP * 30 / np.pi:,.6g} rpm"
    )
    # without a range of speeds its points say it; a machine that stands says nothing
    points = replace(MACHINE, operation=Operation((OperatingPoint(100.0, label="run"),)))
    assert "fastest operating point" in beyond_top_speed(points, 101.0)
    assert beyond_top_speed(replace(MACHINE, operation=Operation()), 500.0) == ""


@pytest.mark.parametrize("share", [0.9, 1.4])
def test_a_scenario_and_a_verification_beyond_it_say_so(pid, share):
    run = amb.simulate(MACHINE, pid, Scenario("run", 0.01, speed=share * TOP), linear=True)
    assert ("140 % of" in run.text) is (share > 1)
    point = OperatingPoint(share * TOP, label="over")
    found = amb.verify(MACHINE, pid, points=[point], tolerances=False)
    assert len(found.over_speed) == (share > 1) == len(found.to_dict()["over_speed"])


def test_the_rig_names_the_judged_mode_that_it_lacks(pid):
    judged = judged_bending(MACHINE)
    assert len(judged) == 7
    # ISO 14839-3: up to 2 kHz, or three times the speed
    every = free_bending_frequencies(finite_element_rotor(MACHINE), 12)
    assert len(judged) == (every <= max(2000 * HERTZ, 3 * TOP)).sum()
    run = amb.simulate(MACHINE, pid, Scenario("rest", 0.01))
    assert f"bending mode 4 ({judged[3] / HERTZ:.4g} Hz) is checked but not on the rig" in run.text
    assert (
        "bending mode" not in amb.simulate(MACHINE, pid, Scenario("rest", 0.01), linear=True).text
    )


def test_a_design_names_the_judged_modes_that_its_model_lacks(pid):
    plant = assemble(MACHINE, MACHINE.operation.design)
    told = replace(pid, method="hinf", notes=())
    few, all_of_them = (explained(plant, told, None, count).notes for count in (2, 7))
    assert any("bending mode 3 to 7" in note and "--bending-modes 7" in note for note in few)
    assert not any("design model" in note for note in all_of_them)


def test_check_lists_every_judged_mode():
    assert facts(MACHINE)["bending_rad_s"] == pytest.approx(judged_bending(MACHINE))
