"""Every verb on the axis along the shaft: an answer that makes sense for one axis, or a refusal in
a sentence; never a traceback.
"""

from __future__ import annotations

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from jsonschema import Draft202012Validator

import ambrose as amb
from ambrose.chain.study import Study
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.judge.checks import OVER_TOLERANCES, Check, Checks, Verification
from ambrose.judge.controller_file import controller_schema, read_controller, write_controller
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import Timing, running_law
from ambrose.machine.file.toml import dumps_machine
from ambrose.record.files import read_record, write_record
from ambrose.record.response import Path as Quotient, Response
from ambrose.report.figures.motion import stations
from ambrose.report.record import record_page
from ambrose.report.tables import deciding_verdict, unchecked
from ambrose.rig.scenario import Scenario, bundled_scenarios, load_scenario
from ambrose.rig.trial import Candidate, simulate_scenario

sys.path.insert(0, str(Path(__file__).parent))
from rotor import machine

PLAN = """
[campaign]
task = "screen"
machine = "five.toml#axial"
[vary]
controller = ["pid"]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """five.toml, pid.json and step.h5, from the linear loop."""
    folder = tmp_path_factory.mktemp("axial")
    axial = machine().axial
    law = pid_synthesis(amb.assemble(axial, "rest"))
    (folder / "five.toml").write_text(dumps_machine(machine()))
    write_controller(folder / "pid.json", law, axial)
    trace = simulate_scenario(axial, law, "thrust-step", linear=True, point="rated")
    write_record(trace.record, folder / "step.h5")
    (folder / "plan.toml").write_text(PLAN)
    (folder / "now.csv").write_text("speed_rpm,axis,amplitude_um_0p,angle_deg\n9000,T_z,12,38\n")
    return folder


NO_PID = {
    '[thrust_bearing.controller]\ngain = "22 A/mm"\nintegral_time = "60 ms"\n'
    'derivative_time = "4 ms"\nderivative_filter = 0.05\n': ""
}


def checks_of(verification):
    """{label: its checks as plain data}."""
    return {label: checks.to_dict()["checks"] for label, checks in verification.labelled}


def test_all_five_axes_are_judged_as_each_is_alone(folder):
    """Also over the tolerances; without a controller of the thrust axis five axes are not
    passed.
    """
    whole, options = machine(), {"rate": 2e4}
    radial = pid_synthesis(amb.assemble(whole, "rest"))
    axial = pid_synthesis(amb.assemble(whole.axial, "rest"))
    alone = amb.verify(whole, radial, axes="radial", **options)
    thrust = amb.verify(whole.axial, axial, **options)
    both = amb.verify(whole, radial, axial=axial, **options)
    expected = checks_of(alone)
    for label, checks in checks_of(thrust).items():
        point = label.removeprefix(OVER_TOLERANCES + " around ")
        expected[label.replace(point, f"thrust: {point}")] = checks
    assert checks_of(both) == expected
    # the file's own PID; of one file; over the tolerances it is then the same law
    points = {label: checks for label, checks in expected.items() if OVER_TOLERANCES not in label}
    assert points.keys() < expected.keys()
    for law in (radial, replace(radial, thrust=axial)):
        assert checks_of(amb.verify(whole, law, **options, tolerances=False)) == points
    assert both.passed == (alone.passed and thrust.passed)
    assert "(radial axes, 2 oper" in deciding_verdict(alone) and not unchecked(alone)
    unknown = amb.verify(machine(NO_PID), radial, tolerances=False, **options)
    assert unknown.not_judged == ("thrust axis",) and not unknown.passed
    held = replace(unknown, points=(Checks("rated", True, ()),))
    assert deciding_verdict(held).startswith("FAILED: the thrust axis has no controller (radial")
    assert replace(held, not_judged=()).passed
    assert "Not checked: the thrust axis. Give its controller" in unchecked(unknown)[0]
    states, boxes = len(thrust.points), len(thrust.boxes)
    own = f", tolerances at {boxes} of them" * bool(boxes)
    words = f"thrust axis ({states} states{own}), {len(alone.points)} oper"
    assert words in deciding_verdict(both)
    # of two groups each has its own tolerances
    box = replace(both.points[0], label="over all tolerances around thrust: rated")
    words = deciding_verdict(replace(both, boxes=(box,), ranges=()))
    assert "tolerances at 1 of them), " in words and words.count("tolerances") == 1
    lost = replace(axial, controller=replace(axial.controller, C=-axial.controller.C))
    assert not amb.verify(whole, radial, axial=lost, **options).passed
    with pytest.raises(InvalidInput, match="no thrust bearing; leave it out"):
        amb.verify("seal-rig", radial, axial=axial)


def swept(law, dt=5e-5):
    """T of the thrust axis at rest, on the model itself."""
    plant = amb.assemble(machine().axial, "rest")
    held = c2d(select(plant.system, plant.named("u"), plant.named("y")), dt)
    omega = 2 * np.pi * np.geomspace(1, 4000, 400)
    G = frequency_response(held, omega).values[:, 0, 0]
    K = frequency_response(running_law(law, plant, Timing(dt, 1)), omega).values[:, 0, 0]
    path = Quotient("T", "T_z", "T_z", G * K / (1 + G * K))
    return Response(plant.machine.name, omega, (path,), plant.point, sample_rate_hz=1 / dt)


def test_responses_decide_on_the_axes_that_they_name():
    """Those of the thrust axis were refused with five axes, after its model had been judged for a
    minute; a file of both groups as the running controller was taken for its radial axes.
    """
    whole = machine()
    axial = pid_synthesis(amb.assemble(whole.axial, "rest"))
    both = replace(pid_synthesis(amb.assemble(whole, "rest")), thrust=axial)
    seen = []
    options = {"measured": swept(axial), "running": both, "points": ["rest"], "tolerances": False}
    joint = amb.verify(whole, both, **options)
    alone = amb.verify(whole, both, axes="thrust", **options)
    assert [checks.label for checks in joint.points] == ["rest", "thrust: rest, measured"]
    assert checks_of(alone)["rest, measured"] == checks_of(joint)["thrust: rest, measured"]
    names = {check.name for check in joint.points[1].checks}
    assert {"stability.measured", "axial.capacity", "impulse.settling"} <= names
    for axes, given in (("radial", swept(axial)), (None, replace(swept(axial), machine="other"))):
        with pytest.raises(InvalidInput, match="the machine of responses 1 is"):
            options |= {"measured": given, "progress": seen.append}
            amb.verify(whole, both, axes=axes, **options)
        assert not seen
    law = replace(both, thrust=None)
    with pytest.raises(InvalidInput, match=r"of the radial axes .*without"):
        amb.simulate(whole.axial, law, "surge", progress=seen.append)
    assert not seen


@pytest.mark.parametrize("kind", ["moving", "synchronous"])
def test_what_is_found_of_the_thrust_axis_in_motion_counts(kind):
    def verdict(*checks):
        points = (Checks("rated", True, ()),)
        return Verification(points, **{kind: (Checks("while it changes", True, checks),)})

    lost = Check("moving.gain", "gain", 2.0, "-", 1.0, passed=False)
    radial, thrust = verdict(), verdict(lost)
    both = radial.with_thrust(thrust)
    assert radial.passed and not both.passed and not thrust.passed
    assert both["thrust: while it changes"].failed == (lost,)
    assert both["while it changes"].passed


def test_controllers_that_are_exchanged_or_given_twice_are_told_what_to_do():
    whole = machine()
    radial, axial = (pid_synthesis(amb.assemble(part, "rest")) for part in (whole, whole.axial))
    for laws, words in (
        ((axial, radial), "are exchanged; swap them"),
        ((axial, axial), "the one given as axial is; give that of the radial axes A_zeta"),
        ((radial, radial), "axial is a controller of the radial axes; give that of T_z"),
        ((replace(radial, thrust=axial), axial), "two controllers, .* leave it out"),
    ):
        with pytest.raises(InvalidInput, match=words):
            amb.verify(whole, laws[0], axial=laws[1])
    with pytest.raises(InvalidInput, match=r"has no PID of its own; .* add a \[thrust_bearing"):
        amb.verify(machine(NO_PID), axes="thrust")


def test_one_file_holds_both_groups_and_each_command_takes_what_it_is_for(folder):
    whole = machine()
    radial, axial = (pid_synthesis(amb.assemble(part, "rest")) for part in (whole, whole.axial))
    path = write_controller(folder / "both.json", replace(radial, thrust=axial), whole)
    read = read_controller(path)
    assert read.thrust == axial and replace(read, thrust=None) == radial
    assert read.digest == read.provenance.digest
    written = json.loads(path.read_text())
    Draft202012Validator(controller_schema()).validate(written)
    one = json.loads((folder / "pid.json").read_text())
    for part in (one, written["thrust"]):
        part["provenance"] = {**part["provenance"], "date": "", "digest": None}
    assert {"format": "ambrose-controller", "version": 3, **written["thrust"]} == one
    # which group is judged does not depend on tolerances: they are in the first two alone
    text = re.sub(r"\[\[thrust_bearing.tolerance\]\]\n(.+\n)*", "", dumps_machine(whole))
    (folder / "plain.toml").write_text(text)
    of_both = run(folder, "verify five.toml --controller both.json --json")
    own = run(folder, "verify five.toml --json")
    assert of_both.exit_code == own.exit_code
    two, file_s = (json.loads(done.stdout) for done in (of_both, own))
    assert two["points"] == file_s["points"] and two["tolerances"] == file_s["tolerances"]
    assert [item["label"] for item in two["points"] if "thrust" in item["label"]]
    assert two["axes"] == ["radial", "thrust"]
    short, long, part = (
        json.loads(run(folder, f"verify {words} --json").stdout)
        for words in (
            "plain.toml#axial --controller pid.json",
            "plain.toml --axes thrust --controller pid.json",
            "plain.toml --axes thrust --controller both.json",
        )
    )
    assert short == long
    assert short["points"] == part["points"]
    radial_alone = json.loads(run(folder, "verify five.toml --axes radial --json").stdout)
    assert radial_alone["axes"] == ["radial"] and not radial_alone["not_judged"]
    assert radial_alone["points"] == two["points"][:2]


def test_both_groups_are_designed_into_one_file(folder):
    """Each as by itself; what one group cannot have is told before the other is designed."""
    line = "synthesize five.toml --method pid -o one.json"
    done = run(folder, f"{line} --json")
    assert done.exit_code in {0, 1}, done.output
    summary, both = json.loads(done.stdout), read_controller(folder / "one.json")
    assert both == amb.design(machine(), "pid")
    axial = read_controller(folder / "pid.json")
    assert both.thrust.outputs == ("u_T_z",)
    assert np.array_equal(both.thrust.controller.A, axial.controller.A)
    for group in ("radial", "thrust"):
        alone = run(
            folder, f"synthesize five.toml --axes {group} --method pid -o {group}.json --json"
        )
        told, found = json.loads(alone.stdout), read_controller(folder / f"{group}.json")
        expected = summary["thrust"] if group == "thrust" else {**summary, "thrust": None}
        assert {**told, "controller": None, "thrust": None} == {
            **expected,
            "controller": None,
            "thrust": None,
        }
        assert found == (both.thrust if group == "thrust" else replace(both, thrust=None))
    assert "thrust axis, pid controller" in run(folder, line).stdout
    refused = run(folder, "synthesize five.toml --method lpv")
    assert refused.exit_code == 2 and "or leave it out: --axes radial" in refused.stderr
    refused = run(
        folder, "synthesize five.toml --axes thrust --structure pid --machine-file new.toml"
    )
    assert refused.exit_code == 2 and "left out for the thrust axis" in refused.stderr


def test_a_check_shows_both_groups_and_narrows(folder):
    whole, along, short, radial = (
        json.loads(run(folder, f"check {words} --json").stdout)
        for words in (
            "five.toml",
            "five.toml --axes thrust",
            "five.toml#axial",
            "five.toml --axes radial",
        )
    )
    assert along == short
    thrust = whole.pop("thrust")
    assert whole == radial
    assert thrust == {name: along[name] for name in along if name not in {"doubts", "remarks"}}
    assert "thrust axis: static capacity" in run(folder, "check five.toml --details").stdout
    refused = run(folder, "check five.toml#axial --axes radial")
    assert refused.exit_code == 2 and "is the thrust axis alone" in refused.stderr


def test_a_study_writes_the_best_of_both_groups_and_narrows(folder, monkeypatch):
    """With stages that take no time."""

    def stages(part, directory, progress):
        law = pid_synthesis(amb.assemble(part, "rest"))
        passed = part.group == "radial"
        worse = Check("sensitivity", "S", 9.0, "-", 3.0, passed=passed)
        held = Candidate("PID", law, (Checks("rest", True, (worse,)),))
        return Study(part, (), amb.assemble(part, "rest"), (held,))

    monkeypatch.setattr("ambrose.chain.study._study", stages)
    whole = machine()
    done = amb.study(whole, folder / "study")
    assert done.axial.machine.group == "thrust" and not done.passed
    both = read_controller(folder / "study" / "controller.json")
    assert both.outputs == ("u_A_zeta", "u_A_eta", "u_B_zeta", "u_B_eta")
    assert both.thrust.outputs == ("u_T_z",)
    radial, thrust = (amb.study(whole, folder / axes, axes=axes) for axes in ("radial", "thrust"))
    assert radial.passed and radial.axial is None and thrust.machine.group == "thrust"
    assert not (folder / "radial" / "controller.json").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"thrust": {"inputs": []}}, r"thrust\.inputs"),
        ({"thrust": {"thrust": {}}}, "thrust has the unknown key 'thrust'"),
        ({"thrust": {"A": [[1.0]]}}, "thrust: the length of row|thrust: the number of rows"),
    ],
)
def test_a_wrong_thrust_table_is_refused_by_its_place(folder, change, words):
    whole = machine()
    radial, axial = (pid_synthesis(amb.assemble(part, "rest")) for part in (whole, whole.axial))
    path = write_controller(folder / "wrong.json", replace(radial, thrust=axial), whole)
    content = json.loads(path.read_text())
    content["thrust"] |= change["thrust"]
    path.write_text(json.dumps(content))
    with pytest.raises(InvalidInput, match=words):
        read_controller(path)


def run(folder, line):
    """``ambrose`` in that folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return CliRunner().invoke(main, re.split(r" (?! )", line))


@pytest.mark.parametrize(
    "line",
    [
        "size five.toml#axial",
        "size five.toml#axial --least bias",
        "size five.toml#axial --least area",
        "magnet five.toml#axial -o p.html",
        "lateral five.toml#axial --controller pid.json",
        "balance five.toml#axial step.h5 --plane T=9cm --controller pid.json",
        "balance five.toml#axial --plane T=9cm --amplitudes now.csv",
        "bias five.toml#axial step.h5",
        "calibrate five.toml#axial --circle step.h5",
        "calibrate five.toml#axial --levitated step.h5",
        "calibrate five.toml#axial --slow-roll step.h5",
        "monitor five.toml#axial pid.json step.h5",
        "seal five.toml#axial step.h5",
        "verify five.toml#axial --controller pid.json --speed-rate 10",
        "map five.toml#axial --controller pid.json --what campbell",
        "map five.toml#axial --controller pid.json --what unbalance",
        "map five.toml#axial --controller pid.json --speed-rpm 0 1000",
        "trade-off five.toml#axial --over unbalance_orbit --values 10um,20um",
        "synthesize five.toml#axial --method pid --synchronous current-free",
        "synthesize five.toml#axial --method lpv",
    ],
)
def test_what_is_of_the_radial_axes_is_refused_in_a_sentence(folder, line):
    done = run(folder, line)
    assert done.exit_code == 2
    assert re.search("#axial is the axis along the shaft, (but|which) ", done.stderr)
    assert "Traceback" not in done.output


@pytest.mark.parametrize(
    "line",
    [
        "export pid.json --machine five.toml --to c -o code",
        "export pid.json --machine five.toml --to mat -o code",
        "verify five.toml --controller pid.json",
        "simulate five.toml --controller pid.json --scenario force-step --linear",
        "map five.toml --controller pid.json",
    ],
)
def test_its_controller_on_the_radial_axes_is_told_the_address(folder, line):
    done = run(folder, line)
    assert done.exit_code == 2
    assert 'of T_z, the axis along the shaft; add "#axial" to the machine' in done.stderr


def test_a_radial_controller_along_the_shaft_is_told_the_address(folder):
    radial = amb.design(amb.assemble(machine(), "rest"), "pid")
    with pytest.raises(InvalidInput, match='take the machine without "#axial", expander'):
        amb.verify(machine().axial, radial)
    with pytest.raises(InvalidInput, match='take the machine without "#axial", expander'):
        amb.export(radial, folder / "code", to="c", machine=machine().axial)


@pytest.mark.parametrize("method", ["hinf", "mu"])
def test_missing_weights_are_named_where_the_axis_has_them(folder, method):
    done = run(folder, f"synthesize five.toml#axial --method {method}")
    assert done.exit_code == 2
    assert "add a [thrust_bearing.weights] table" in done.stderr


def test_a_campaign_varies_the_axis(folder):
    """Its file's keys and tolerances, the peak of each case as verify has it."""
    vary = '[vary]\n"tolerance.thrust_bearing.T.force_per_current" = [0.0, 1.0]\n'
    (folder / "axis.toml").write_text(PLAN.replace("[vary]\n", vary))
    done = run(folder, "campaign axis.toml -o axis --workers 1 --pages 0")
    assert done.exit_code in {0, 1}, done.output
    text = (folder / "axis" / "rows.jsonl").read_text()
    rows = [json.loads(line) for line in text.splitlines()]
    peaks = [row["values"]["sensitivity.output.max"] for row in rows]
    assert len(peaks) == 2 and peaks[0] != peaks[1]
    axial = machine().axial
    law = pid_synthesis(amb.assemble(axial, axial.operation.design))
    checks = amb.verify(axial, law, tolerances=False).points[0]
    assert checks["sensitivity.output.max"].value == pytest.approx(peaks[0], rel=2e-3)


def test_a_map_of_the_axis_is_its_pulses(folder):
    from ambrose.judge.exploration import explore

    axial = machine().axial
    found = explore(axial, pid_synthesis(amb.assemble(axial, "rest")).law, rate=2e4)
    assert found.pulses is not None
    assert (found.maps, found.campbell, found.unbalance) == ((), (), None)


@pytest.mark.parametrize("name", bundled_scenarios())
def test_a_scenario_acts_along_the_shaft_or_is_refused(name):
    scenario, axial = load_scenario(name), machine().axial
    if scenario.acts_along:
        assert scenario.on(axial).acts
        assert not (scenario.on(axial).unbalances or scenario.on(axial).pressures)
        return
    assert name in {"unbalance", "run-up"}
    with pytest.raises(InvalidInput, match=rf"scenario {name} does nothing along .*surge"):
        scenario.on(axial)


def test_what_turns_is_left_out_with_a_word(folder):
    axial = machine().axial
    law = pid_synthesis(amb.assemble(axial, "rest"))
    push = replace(load_scenario("thrust-step"), name="push", duration=0.2, speed=300.0)
    trace = simulate_scenario(axial, law, push, linear=True, point="rated")
    assert "along the shaft, without the scenario's speed" in trace.text
    quiet = Scenario("turning", 0.1, speed=300.0)
    assert not quiet.on(axial).acts  # nothing was asked to act


@pytest.mark.parametrize("kept", ["q", "y"])
def test_the_page_of_a_record_has_both_stops_and_no_orbits(folder, kept):
    """A collar at -30 um beyond a left stop of 25 um, by which alone the page fails."""
    stops = {'touchdown_gap = "0.25 mm"': 'touchdown_gap = ["0.025 mm", "0.25 mm"]'}
    axial = machine({**stops, '["-20 um", "40 um"]': '["-20 um", "10 um"]'}).axial
    record = read_record(folder / "step.h5").select([f"{kept}_T_z", "u_T_z"])
    values = record.values.copy()
    values[0] = np.linspace(0.0, -30e-6, values.shape[1])
    moved = replace(record, values=values)
    left, right = stations(moved, axial)
    assert (left.gap, right.gap) == (25e-6, 250e-6)
    assert left.radius.max() == pytest.approx(30e-6)
    assert right.radius.max() == 0.0
    page = record_page(moved, axial)
    titles = [figure.title for section in page.sections for figure in section.figures]
    assert "Distance from the middle of the bearing" in titles
    assert not {"Orbits", "The rotor in motion"} & set(titles)
    (touch,) = (verdict for verdict in page.verdicts if verdict.label == "Touchdown")
    assert touch.passed is False
    assert "T to the left" in touch.text


def test_a_simulation_of_the_axis_writes_its_page(folder):
    line = "simulate five.toml#axial --controller pid.json --scenario thrust-step --linear"
    done = run(folder, f"{line} --point rated --report step.html")
    assert done.exit_code == 0, done.output
    narrow = line.replace("#axial --controller pid.json", " --axes thrust")
    own = run(folder, f"{narrow} --point rated -o own.h5")
    assert own.exit_code == 0 and "Controller: pid of the machine file" in own.stdout
    again = read_record(folder / "own.h5")
    assert np.array_equal(again.values, read_record(folder / "record.h5").values)
    assert "Distance from the middle of the bearing" in (folder / "step.html").read_text()
