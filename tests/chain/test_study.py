"""What a study leaves in its folder: when it fails, beside an earlier one, beside another run,
without room at the end.

Designs and their evaluation have their own tests; here they are stubs.
"""

from __future__ import annotations

import json
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from ambrose import bundled_machines, load_machine
from ambrose.chain import study as workflow
from ambrose.chain.commissioning import Reference
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import static_gain
from ambrose.judge.checks import Checks
from ambrose.judge.controller_file import write_controller
from ambrose.judge.result import Synthesis
from ambrose.machine.ordinary_file import write_text
from ambrose.registry import register, unregister
from ambrose.rig.trial import Candidate, check_trials

LAW = Synthesis(static_gain([[1.0]], ["err_A"], ["u_A"]), "pid")


@pytest.fixture
def stubs(monkeypatch):
    plant = SimpleNamespace(machine=SimpleNamespace(name="rig"))

    def designed(plant, method, path, progress):
        write_controller(path, LAW)
        return LAW

    def refused(*rest):
        raise InvalidInput("commissioning has tests of its own")

    made = {
        "full_plants": lambda machine: (plant,),
        "reduce": lambda plant: plant,
        "study_methods": lambda plant: ("pid",),
        "resume_or_design": designed,
        "processors": lambda: 1,  # stubs are none in another process
        "check_trials": lambda machine: None,
        "evaluate": lambda name, law, plants, progress: Candidate(
            name, law, (Checks("p", True, ()),)
        ),
        "commission": refused,
        "reference": lambda plant, candidates, waiting=(): Reference(candidates[0]),
        "campbell_map": lambda *rest: (),
        "run_ups": lambda *rest: (),
        "write_report": lambda result, path: write_text(path, "report", "report"),
    }
    for name, stub in made.items():
        monkeypatch.setattr(workflow, name, stub)
    return monkeypatch


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def run(folder, progress=lambda stage: None):
    return workflow.study(load_machine("seal-rig"), folder, progress)


def test_a_study_that_fails_leaves_no_older_report_under_its_name(stubs, tmp_path):
    """The report of the first study stood beside the controllers of the second."""
    run(tmp_path)
    assert names(tmp_path) == ["checks.json", "controller-pid.json", "report.html"]
    (tmp_path / "commissioned" / "code").mkdir(parents=True)
    stubs.setattr(workflow, "evaluate", lambda *rest: 1 / 0)
    for _ in range(2):
        with pytest.raises(ZeroDivisionError):
            run(tmp_path)
    earlier = ["earlier-checks.json", "earlier-report.html"]
    assert names(tmp_path) == ["commissioned", "controller-pid.json", *earlier]
    assert names(tmp_path / "commissioned") == ["earlier-code"]


def test_what_an_annex_cannot_leave_is_said_beside_the_report(stubs, tmp_path):
    def refuse(machine, synthesis, directory, progress):
        assert synthesis is LAW
        raise InvalidInput("its table ends too early")

    register("study file", "extra", refuse)
    try:
        result = run(tmp_path)
    finally:
        unregister("study file", "extra")
    assert ("extra", "its table ends too early") in result.failed
    assert "report.html" in names(tmp_path)


def test_a_second_study_of_the_same_folder_is_refused(stubs, tmp_path):
    """Both ran, and the report was of one, the controllers of the other."""
    told = []

    def second(stage):
        if stage == "reducing it":
            with pytest.raises(InvalidInput, match="another run is writing"):
                run(tmp_path / "." / "study")
            told.append(stage)

    run(tmp_path / "study", second)
    assert told and names(tmp_path) == ["study"]


def test_what_cannot_be_written_at_the_end_is_told_beside_the_results(stubs, tmp_path):
    """All results were lost with the report."""

    def full(result, path):
        raise InvalidInput("cannot write the report: No space left on device")

    stubs.setattr(workflow, "write_report", full)
    result = run(tmp_path / "api")
    assert result.unwritten == ("cannot write the report: No space left on device",)
    assert json.loads((tmp_path / "api" / "checks.json").read_text())["best"] == "PID"
    done = CliRunner().invoke(main, ["study", "seal-rig", "-o", str(tmp_path / "cli"), "--json"])
    assert done.exit_code == 2
    assert json.loads(done.stdout)["best"] == "PID" and "No space left" in done.stderr


def test_an_unwritable_folder_is_refused_before_the_work(stubs, tmp_path):
    (tmp_path / "file").write_text("")
    for place in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(InvalidInput, match="cannot make the folder"):
            run(place, lambda stage: 1 / 0)


def test_what_a_trial_would_refuse_is_refused_before_the_first_computation(stubs, tmp_path):
    """A study ended after minutes of computing on what its scenarios asked of the machine."""

    def computed(machine):
        raise AssertionError("something was computed before")

    stubs.setattr(workflow, "full_plants", computed)
    stubs.setattr(workflow, "check_trials", check_trials)
    slow = replace(
        load_machine("seal-rig"),
        controller=replace(load_machine("seal-rig").controller, sample_time=7e-3),
    )
    with pytest.raises(InvalidInput, match=r"a multiple of 0\.007 s, to a tenth of it"):
        workflow.study(slow, tmp_path)
    for machine in bundled_machines():
        check_trials(load_machine(machine))


@pytest.mark.parametrize("stage", ["commission", "campbell_map", "run_ups"])
@pytest.mark.parametrize(
    "error", [InvalidInput("an edge lies between samples"), ValueError("a defect")]
)
def test_a_study_that_fails_in_a_late_stage_keeps_its_report(stubs, tmp_path, stage, error):
    """Everything that was computed before was lost with it."""

    def failing(*rest):
        raise error

    stubs.setattr(workflow, stage, failing)
    result = run(tmp_path)
    assert any(str(error) in why for _, why in result.failed)
    assert {"checks.json", "report.html"} <= set(names(tmp_path)) and result.best.name == "PID"


def test_a_study_that_commissions_nothing_says_so(stubs, tmp_path):
    """It ended with status 0 where a controller met every check."""
    why = "nothing to record: PID does not stabilise the machine; state [controller] sample_time"
    stubs.setattr(workflow, "reference", lambda *rest: Reference(None, why))
    assert run(tmp_path / "api").passed and "report.html" in names(tmp_path / "api")
    done = CliRunner().invoke(main, ["study", "seal-rig", "-o", str(tmp_path / "cli")])
    assert done.exit_code == 1
    assert f"Commissioning was not done: {why}" in " ".join(done.stdout.split())


def test_a_controller_that_cannot_be_judged_leaves_the_others_their_report(stubs, tmp_path):
    def judged(name, law, plants, progress):
        if name == "mu":
            raise InvalidInput("cannot be judged")
        return Candidate(name, law, (Checks("p", True, ()),))

    stubs.setattr(workflow, "study_methods", lambda plant: ("mu", "pid"))
    stubs.setattr(workflow, "evaluate", judged)
    result = run(tmp_path)
    assert ("mu", "cannot be judged") in result.failed and [c.name for c in result.candidates] == [
        "PID"
    ]


def test_methods_that_go_on_from_one_controller_are_designed_together():
    """Polished mu begins as mu: apart, mu was computed twice."""
    names = ("tuned", "pid", "mu", "polish")
    assert workflow._groups(names) == [("mu", "polish"), ("tuned",), ("pid",)]
    assert workflow._groups(("tuned", "polish")) == [("tuned",), ("polish",)]


def test_a_study_goes_on_alone_where_a_process_beside_it_died(stubs, tmp_path):
    def died(*rest):
        raise BrokenProcessPool("killed")

    stubs.setattr(workflow, "study_methods", lambda plant: ("tuned", "pid"))
    stubs.setattr(workflow, "processors", lambda: 2)
    stubs.setattr(workflow, "_side_by_side", died)
    told = []
    result = run(tmp_path, told.append)
    assert [candidate.name for candidate in result.candidates] == ["tuned", "PID"]
    assert any("died" in stage for stage in told)
