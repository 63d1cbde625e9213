"""P5's mu controller as C code on the rig: designed for its sampled loop, at zero, nominal and
twice nominal seal pressure.

P5 tries its controllers under an impulse at these pressures (section 5.5). Here what runs is the
generated C, compiled, in place of the controller, with its sampling, one sample of computing delay,
limits and rounding.
"""

from __future__ import annotations

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.code.block.block import build_block
from ambrose.code.c.compiled import CompiledBlock, read_law
from ambrose.code.pipeline import machine_limits
from ambrose.code.sampled import deploy, unmet_limits
from ambrose.core.sampling import c2d, delayed
from ambrose.judge import nominal
from ambrose.judge.result import pid_synthesis
from ambrose.judge.sampled import check_over_box
from ambrose.law.design_problem import apply_delay, design_plant, design_tolerances, open_model
from ambrose.law.loop import Timing
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import load_scenario
from ambrose.synthesis.design import design
from ambrose.synthesis.fixed_order.polish import polish_synthesis
from ambrose.synthesis.order_selection import find_lowest_order, sampled_sensitivity
from needs import needs

pytestmark = [
    pytest.mark.literature,
    pytest.mark.study,
    needs("C compiler"),
]
SAMPLE = 1e-4
RIG = load_machine("seal-rig-k-only")  # P5 section 4.1: over k +-100 %
POINTS = {point.label: point for point in RIG.operation.points}
# the one that tolerances refer to is first
PRESSURES = ("nominal pressure", "zero pressure", "twice nominal pressure")


@pytest.fixture(scope="module")
def plants():
    return {label: assemble(RIG, POINTS[label]) for label in PRESSURES}


@pytest.fixture(scope="module")
def synthesis(plants):
    return design(plants["nominal pressure"], "mu", rate=1 / SAMPLE)


@pytest.fixture(scope="module")
def deployment(plants, synthesis):
    """Verified as it will run at the three pressures, over k +-100 % at the corners."""
    return deploy(synthesis, SAMPLE, SAMPLE, plants=[plants[label] for label in PRESSURES])


@pytest.fixture(scope="module")
def mu(deployment):
    return CompiledBlock(build_block(deployment, "mu", *machine_limits(RIG)))


@pytest.fixture(scope="module")
def reference(plants):
    """P5's PID as C code; its loop is unstable at twice nominal pressure, so it is deployed all the
    same.
    """
    deployment = deploy(
        pid_synthesis(plants["nominal pressure"]), SAMPLE, SAMPLE, plants=[], force=True
    )
    return CompiledBlock(build_block(deployment, "pid", *machine_limits(RIG)))


@pytest.fixture(scope="module")
def problem(plants, synthesis):
    weights = synthesis.weights
    model = open_model(reduce(plants["nominal pressure"]), design_tolerances(RIG), True)
    return design_plant(apply_delay(model, Timing(SAMPLE).lag), weights)


def on_the_rig(program, label):
    return virtual_rig.run(RIG, program, load_scenario("impulse-parallel"), point=POINTS[label])


def measured(trace):
    return trace.record.select([f"y_{axis}" for axis in RIG.axes]).values


def test_the_sampled_loop_is_stable_over_the_whole_tolerance(deployment):
    assert deployment.problems == ()
    assert [checks.stable for checks in deployment.checks] == [True, True, True]
    assert deployment.box[0].checks[0].value == 0  # on the full plant with its bending modes


@pytest.mark.parametrize("label", PRESSURES)
def test_mu_from_c_holds_the_rig_at_every_pressure(mu, deployment, label):
    code, design_law = on_the_rig(mu, label), on_the_rig(deployment.controller, label)
    assert (code.outcome, code.stable, code.touchdown_at) == ("completed", True, None)
    y = measured(code)
    # settled within the 0.25 s after the pulse
    assert np.abs(y[:, -300:]).max() < 0.25 * np.abs(y).max() < 5e-6
    # found 1e-17 m of 3e-6 m
    assert np.abs(y - measured(design_law)).max() < 1e-10 * np.abs(y).max()


def test_pid_from_c_touches_down_at_twice_nominal_pressure(reference):
    """P5.5, beside the mu controller under the same pulse."""
    found = {label: on_the_rig(reference, label) for label in PRESSURES}
    assert [found[label].outcome for label in PRESSURES] == ["completed", "completed", "touchdown"]
    last = found["twice nominal pressure"]
    assert not last.stable and 0.06 < last.touchdown_at < 0.2
    assert np.abs(measured(last)).max() > 50 * max(
        np.abs(measured(found[label])).max() for label in PRESSURES[:2]
    )


@pytest.mark.parametrize("label", PRESSURES)
def test_the_running_code_has_the_verification_of_the_design(mu, deployment, plants, label):
    """Every quantity, from the law that is read back out of the compiled code and from the one that
    was designed.
    """
    code = nominal.check(plants[label], delayed(read_law(mu), mu.delay))
    meant = deployment.checks[PRESSURES.index(label)]
    assert [check.name for check in code.checks] == [check.name for check in meant.checks]
    assert [check.passed for check in code.checks] == [check.passed for check in meant.checks]
    values = np.array(
        [
            [found.value, wanted.value]
            for found, wanted in zip(code.checks, meant.checks, strict=True)
        ]
    )
    np.testing.assert_allclose(values[:, 0], values[:, 1], rtol=1e-9)


def test_half_the_states_suffice_at_a_loss_of_five_per_cent(plants, synthesis, problem):
    """By reduction in the closed loop alone; judged in the sampled loop on a plant that bends."""
    measure = sampled_sensitivity(reduce(plants["nominal pressure"], 1), Timing(SAMPLE))
    found = find_lowest_order(problem, synthesis.controller, measure, 0.05, polishing=False)
    assert (synthesis.controller.n_states, found.controller.n_states) == (28, 14)
    assert found.measure <= 1.05 * found.reference
    full = check_over_box(
        plants["nominal pressure"], delayed(c2d(found.controller, SAMPLE, "tustin"), 1)
    )
    assert full.checks[0].value == 0
    assert full["sampled.sensitivity.box"].value == pytest.approx(found.measure, rel=0.005)


def test_ten_states_polished_meet_every_requirement_that_28_miss(
    plants, synthesis, deployment, problem
):
    """sigma_max(S_o) below 3 in the sampled loop: polishing knows that the parameter is real, D-K
    iteration does not.
    """
    assert unmet_limits(deployment)  # 3.32 at zero pressure
    lowest = polish_synthesis(problem, synthesis.controller, order=10, rounds=1).controller
    found = deploy(lowest, SAMPLE, SAMPLE, plants=[plants[label] for label in PRESSURES])
    assert lowest.n_states == 10
    assert unmet_limits(found) == () and found.problems == ()
    assert found.box[0]["sampled.sensitivity.box"].value < 3.0
    code = CompiledBlock(build_block(found, "lowest", *machine_limits(RIG)))
    for label in PRESSURES:
        assert on_the_rig(code, label).outcome == "completed"
