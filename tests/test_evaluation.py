"""Verification and simulation of one controller as the front door and the command line call
them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.chain.study import Study
from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d, delayed
from ambrose.core.scheduled import ScheduledSystem
from ambrose.judge import nominal
from ambrose.judge.checks import Check, Checks
from ambrose.judge.result import Synthesis, pid_synthesis
from ambrose.judge.verdict import verify_controller
from ambrose.law.pid import pid_controller
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import reduce
from ambrose.report.comparison_tables import decision
from ambrose.rig.scenario import load_scenario
from ambrose.rig.trial import Candidate, evaluate, simulate_linear, simulate_scenario
from coarse import coarse

LOW, HIGH = 2 * np.pi * 20.0, 2 * np.pi * 140.0


@pytest.fixture(scope="module")
def small() -> Plant:
    """The seal rig at its nominal pressure, one bending mode per plane."""
    return reduce(assemble(load_machine("seal-rig")), 1)


@pytest.fixture(scope="module")
def made(small: Plant) -> Synthesis:
    return pid_synthesis(small)


@pytest.fixture(scope="module", name="coarse")
def turboexpander():
    return coarse("turboexpander")


@pytest.fixture(scope="module")
def schedule(coarse) -> ScheduledSystem:
    controller = pid_controller(coarse.controller, coarse)
    return ScheduledSystem([LOW, HIGH], [controller, controller])


def test_points_beyond_a_schedule_are_named_and_nothing_is_passed(coarse, schedule):
    labels = ["140 Hz (P3)", "300 Hz (P3)", "standstill"]
    verification = verify_controller(coarse, schedule, labels, tolerances=False)
    assert [checks.label for checks in verification.points] == ["140 Hz (P3)"]
    assert verification.left_out == ("300 Hz (P3)", "standstill")
    assert not verification.passed
    # the one point meets everything
    met = tuple(replace(checks, checks=()) for checks in verification.points)
    assert (
        replace(verification, points=met, left_out=()).passed
        and not replace(verification, points=met).passed
    )
    with pytest.raises(InvalidInput, match="scheduled range"):
        verify_controller(coarse, schedule, ["standstill"])


def test_a_fixed_controller_leaves_nothing_out(small, made):
    verification = verify_controller(small, made, tolerances=False)
    assert verification.left_out == () and verification.tolerances is None
    assert verification.points[0].to_dict() == nominal.check(small, made.controller).to_dict()


def test_a_rate_verifies_the_controller_as_it_runs(small, made):
    verification = verify_controller(small, made.controller, tolerances=False, rate=8000.0)
    late = delayed(c2d(made.controller, 1 / 8000, "tustin"), 1)
    assert verification.points[0].to_dict() == nominal.check(small, late).to_dict()
    one = replace(small.machine, tolerances=small.machine.tolerances[:1])
    box = verify_controller(replace(small, machine=one), made.controller, rate=8000.0).tolerances
    # nothing was said of the tolerances before
    assert box is not None and box["sampled.stability.box"].value >= 0
    # a sampled law is known to run at its own rate, and late as any other
    own = c2d(made.controller, 1 / 8000, "tustin")
    for law, samples in ((own, None), (late, 0)):
        same = verify_controller(small, law, tolerances=False, delay_samples=samples)
        assert same.points[0].to_dict() == nominal.check(small, late).to_dict()
    with pytest.raises(InvalidInput, match=r"sample time is 0\.000125 s, but must be 0\.00025 s"):
        verify_controller(small, own, rate=4000.0)
    with pytest.raises(InvalidInput, match="rate"):
        verify_controller(small, made, rate=0.0)


def test_points_are_chosen_by_label(made):
    machine = load_machine("seal-rig")
    for points, words in ((["no such point"], "no such point"), ([], "no operating point")):
        with pytest.raises(InvalidInput, match=words):
            verify_controller(machine, made, points)


def test_simulations_take_labels_scenarios_and_syntheses(small, made):
    trace = simulate_scenario(small, made, "impulse-parallel", linear=True)
    own = simulate_linear(small, made.controller, load_scenario("impulse-parallel"))
    np.testing.assert_array_equal(trace.record.values, own.record.values)
    assert trace.record.point == small.point
    with pytest.raises(InvalidInput, match="second is given, but must be left out with linear"):
        simulate_scenario(small, made, "impulse-parallel", linear=True, second=made)


def test_the_linear_plant_turns_as_fast_as_the_scenario_says(coarse):
    """It stood still while its unbalance turned: no gyroscopic moments."""
    law = pid_controller(coarse.controller, coarse)
    events = replace(load_scenario("unbalance"), speed=HIGH, duration=0.05)
    points = [replace(coarse.operation.points[0], speed=speed) for speed in (0.0, HIGH)]
    still, turning = (
        simulate_linear(assemble(coarse, point), law, events).record for point in points
    )
    np.testing.assert_allclose(still.values, turning.values, rtol=0, atol=1e-12)


def test_evaluation_keeps_what_a_schedule_leaves_out(coarse, schedule, made, monkeypatch):
    monkeypatch.setattr(
        "ambrose.rig.trial.run_on_rig", lambda plant, program, scenario, timing: None
    )
    monkeypatch.setattr("ambrose.rig.trial.SCENARIOS", ("impulse-parallel",))
    monkeypatch.setattr(
        "ambrose.rig.trial.simulate_linear", lambda plant, law, scenario, timing: None
    )
    bare = replace(coarse, tolerances=())
    labels = ("standstill", "140 Hz (P3)")
    plants = [
        reduce(assemble(bare, point), 1) for point in bare.operation.points if point.label in labels
    ]
    candidate = evaluate("LPV", replace(made, scheduled=schedule), plants)
    assert candidate.left_out == ("standstill",)
    # on the linear loop and on the rig
    assert [label for label, _ in candidate.traces] == ["140 Hz (P3)"] * 2


def candidate(
    name: str, made: Synthesis, passed: bool, left_out: tuple[str, ...] = ()
) -> Candidate:
    check = Check("sensitivity.output.max", "Peak", 2.0, "-", 3.0 if passed else 1.0, "<=", passed)
    return Candidate(name, made, (Checks("nominal pressure", True, (check,)),), left_out=left_out)


def test_a_candidate_that_leaves_a_point_out_does_not_pass(made):
    """It said "LPV passes every check" of a schedule that covers three of six points."""
    partial = candidate("LPV", made, True, ("standstill",))
    assert not partial.passed
    assert decision([partial]).passed is False
    assert "LPV, not evaluated at standstill, outside its schedule" in decision([partial]).text


@pytest.fixture(scope="module")
def study(small, made):
    candidates = (candidate("PID", made, False), candidate("LPV", made, True, ("standstill",)))
    return Study(small.machine, (small,), small, candidates)


def test_a_study_shows_itself(study):
    assert study.best.name == "PID" and not study.passed  # one check against a whole point
    assert repr(study) == "Study(machine=seal-rig, passed=False, best=PID, controllers=[PID, LPV])"
    assert "<td>PID</td>" in study._repr_html_()
    assert study.to_dict()["controllers"]["LPV"]["left_out"] == ["standstill"]


def test_a_study_is_a_table_of_checks(study):
    pytest.importorskip("pandas")
    frame = study.to_frame()
    assert list(frame["controller"]) == ["PID", "LPV"] and list(frame["passed"]) == [False, True]
