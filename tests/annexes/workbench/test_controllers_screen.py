"""The controller bench: sliders are the file's numbers, what they show is what is saved."""

import json
import math
from dataclasses import replace

import pytest

pytest.importorskip("starlette", reason="no starlette: install the extra workbench")

from ambrose.annexes.workbench import blocks as sliders
from ambrose.annexes.workbench.blocks import Refusal, lines_of, with_numbers
from ambrose.annexes.workbench.project import Project, begin
from ambrose.annexes.workbench.screens import answer
from ambrose.core.checks import InvalidInput
from ambrose.judge.campbell import ONCE
from ambrose.judge.controller_file import read_controller
from ambrose.machine.file.toml import bundled_machines, load_machine
from ambrose.machine.part import Channel, Notch, PidSettings, Section


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    made = Project(tmp_path_factory.mktemp("project"))
    begin(made, "seal-rig")
    return made


def ask(project, action="", **given):
    told = answer(project, "controllers", action, {"width": 900, **given})
    return told, {block["key"]: block for block in told["blocks"]}


def test_what_is_shown_at_first_is_the_machine_file(project):
    _, blocks = ask(project)
    fields = {f["name"]: f for f in blocks["sliders"]["fields"]}
    assert fields["gain.0"]["value"] == 18250.0
    assert fields["integral_time"]["value"] == 0.2
    low, high = fields["gain.0"]["low"], fields["gain.0"]["high"]
    assert (10**low, 10**high) == pytest.approx((1825.0, 182500.0))
    (row,) = blocks["peaks"]["rows"]
    # the thesis' PID does not hold twice the pressure
    assert row[3]["text"].startswith("✗ unstable")
    assert {"sensitivity", "loci", "pulse"} <= set(blocks)


def test_a_slider_moves_the_curves_and_says_so_in_python(project):
    before, after = (ask(project, "look", **{"gain.0": k})[1] for k in (18250.0, 25000.0))
    assert before["sensitivity"]["svg"] != after["sensitivity"]["svg"]
    assert "gain=(25000.0,)" in after["same"]["lines"]["Python"]
    assert "replace(settings" not in before["same"]["lines"]["Python"]
    # those lines give the controller that is saved
    lines = after["same"]["lines"]["Python"].replace("machine.toml", str(project.machine))
    names = {}
    exec(lines, names)
    told, _ = ask(project, "save", **{"gain.0": 25000.0, "name": "mine"})
    assert told["told"].startswith("controllers/mine.json is written")
    saved = read_controller(project.path("controllers", "mine.json"))
    assert saved.filters.gain == (25000.0,)
    assert (saved.controller.D == names["controller"].controller.D).all()
    assert saved.status == names["controller"].status
    with pytest.raises(Refusal, match="exists already"):
        ask(project, "save", name="mine")
    with pytest.raises(Refusal) as refused:
        ask(project, "save", name="../mine")
    assert "name" in refused.value.content["fields"]


def test_what_is_saved_is_judged_as_a_designed_one_is(tmp_path):
    """At every operating point, and at the rate that others assume where nobody states one."""
    made = Project(tmp_path)
    begin(made, "turboexpander")
    told, _ = ask(made, "save", name="mine")
    assert "at all 6 operating points, but only as a continuous loop" in told["told"]
    saved = read_controller(made.path("controllers", "mine.json"))
    assert saved.missed and len(saved.certificate.envelope) == 6


def test_controllers_are_compared_at_every_point(project):
    for name in ("one", "two", "three", "four"):
        ask(project, "save", name=name)
    _, blocks = ask(project, "look", **{"with.one.json": True, "with.two.json": True})
    assert [row[0]["text"] for row in blocks["peaks"]["rows"]] == [
        "the sliders",
        "one.json",
        "two.json",
    ]
    chosen = {f"with.{name}.json": True for name in ("one", "two", "three", "four")}
    with pytest.raises(InvalidInput, match="4 controllers at most"):
        ask(project, "look", **chosen)
    assert json.dumps(blocks)


def test_the_verdict_of_other_values_does_not_stay(project):
    told, blocks = ask(project, "judge", **{"gain.0": 25000.0})
    assert "verdict-0" in blocks
    assert not told["whole"]
    assert "verdict-0" in ask(project, "look", **{"gain.0": 26000.0})[0]["gone"]


def test_a_machine_that_turns_has_its_campbell_diagram(tmp_path):
    turning = Project(tmp_path)
    begin(turning, "flywheel")
    buttons = [b["action"] for b in ask(turning)[1]["sliders"]["buttons"]]
    assert "campbell" in buttons
    assert ONCE in ask(turning, "campbell")[1]["campbell"]["svg"]


@pytest.mark.parametrize("value", [math.nan, math.inf, "x", True, None, 1e300])
def test_what_is_no_number_is_refused(project, value):
    with pytest.raises(InvalidInput):
        ask(project, "look", **{"gain.0": value})


def test_every_number_of_every_file_is_put_where_it_came_from():
    for name in bundled_machines():
        machine = load_machine(name)
        settings = machine.reference
        if settings is None:
            continue
        fields = sliders.fields_of(settings, machine.axes)
        assert fields
        for field in fields:
            same = with_numbers(settings, {field["name"]: field["value"] * (1 + 1e-13)})
            assert same is settings
            other = with_numbers(settings, {field["name"]: field["value"] * 1.5})
            values = {f["name"]: f["value"] for f in sliders.fields_of(other, machine.axes)}
            before = {f["name"]: f["value"] for f in fields}
            assert values == {**before, field["name"]: field["value"] * 1.5}


def test_notches_and_chains_have_sliders_too():
    bump = Section("phase-bump", frequency=500.0, phase=-0.3, damping=0.2)
    chain = Channel(("A_zeta",), 2e4, (bump,))
    settings = PidSettings((1e4,), notches=(Notch(900.0, 0.5, 0.05),), channels=(chain,))
    fields = {f["name"]: f for f in sliders.fields_of(settings, ("A_zeta", "A_eta"))}
    assert fields["notches.0.frequency"]["label"] == "Notch 1 frequency"
    assert not fields["channels.0.sections.0.phase"]["log"]
    new = with_numbers(settings, {"channels.0.sections.0.phase": 0.1})
    assert new.channels[0].sections[0].phase == 0.1
    (line,) = lines_of(settings, {"channels.0.sections.0.phase": 0.1})
    names = {"settings": settings, "replace": replace}
    exec(line, names)
    assert names["settings"] == new
