"""Records, identification, envelope, acceptance, deploy: what they show, what they write."""

import json
import os
import tomllib
import zipfile

import numpy as np
import pytest

from needs import needs

pytest.importorskip("starlette", reason="no starlette: install the extra workbench")

import ambrose as amb
from ambrose.annexes.workbench.blocks import Refusal
from ambrose.annexes.workbench.project import Project, begin
from ambrose.annexes.workbench.screens import OWN, TITLES, answer
from ambrose.annexes.workbench.screens.machine import run_fields
from ambrose.machine.description import OperatingPoint
from ambrose.record.files import read_record, write_record
from ambrose.record.record import Record


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    made = Project(tmp_path_factory.mktemp("project"))
    begin(made, "two-disc-rotor")
    return made


@pytest.fixture(scope="module")
def axes(project):
    return amb.load_machine(project.machine).axes


def ask(project, screen, action="", **given):
    told = answer(project, screen, action, {"width": 700, **given})
    return told, {block["key"]: block for block in told["blocks"]}


@pytest.mark.parametrize("screen", [name for name in TITLES if name not in OWN])
def test_every_screen_shows_what_does_the_same(tmp_path, screen):
    folder = Project(tmp_path)
    begin(folder, "two-disc-rotor")
    told, _ = ask(folder, screen)
    assert json.loads(json.dumps(told)) == told
    same = [block for block in told["blocks"] if block["kind"] == "same"]
    if screen != "records":  # which has nothing to show yet
        ((lines),) = [block["lines"] for block in same]
        assert lines["Command line"].startswith("ambrose ")
        compile(lines["Python"], screen, "exec")


def test_a_record_is_seen_and_judged(project, axes):
    time = np.arange(2000) / 10e3
    y = [30e-6 * np.sin(300 * time + k) for k in range(len(axes))]
    names = tuple(f"y_{axis}" for axis in axes)
    units = ("m",) * len(axes)
    point = OperatingPoint(0.0, 0.0, label="rest")
    record = Record("two-disc-rotor", 10e3, names, units, np.array(y), point)
    write_record(record, project.path("records", "run.h5"))
    _, blocks = ask(project, "records")
    words = " ".join(cell["text"] for row in blocks["verdicts"]["rows"] for cell in row)
    # sin^2(a) + sin^2(a + 1) is 1 + cos(1) at most
    assert f"{30 * np.sqrt(1 + np.cos(1)):.1f}" in words
    assert any(block["kind"] == "picture" for block in blocks.values())
    project.path("records", "broken.csv").write_text("<b>no record</b>")
    _, blocks = ask(project, "records", "look", file="broken.csv")
    assert "refused" in blocks


def test_columns_of_a_foreign_file_are_mapped(project, axes):
    time = np.arange(400) / 5e3
    probe = np.sin(700 * time)
    rows = "\n".join(f"{t:.6f} {v:.9f} {-v:.9f}" for t, v in zip(time, probe, strict=True))
    project.path("records", "logger.txt").write_text(f"t one two\n{rows}\n")
    _, blocks = ask(project, "records", "look", file="logger.txt")
    # the reader names what there is
    assert "one" in blocks["mapping"]["hint"]
    given = {"source": "logger.txt", "time": "t", "time.unit": "s"}
    given |= {"speed": "0 rpm", "pressure": "0 bar"}
    given |= {f"from.y_{axes[0]}": "one", f"unit.y_{axes[0]}": "um"}
    given |= {f"from.y_{axes[1]}": "-2 * two", f"unit.y_{axes[1]}": "um"}
    told, _ = ask(project, "records", "map", **given)
    assert "records/logger.h5" in told["told"]
    record = read_record(project.path("records", "logger.h5"))
    np.testing.assert_allclose(record[f"y_{axes[0]}"], 1e-6 * probe, atol=1e-14)
    np.testing.assert_allclose(record[f"y_{axes[1]}"], 2e-6 * probe, atol=1e-14)
    assert record.sample_rate_hz == pytest.approx(5e3)
    columns = tomllib.loads((project.root / "records" / "logger-columns.toml").read_text())
    assert columns["signal"][1]["scale"] == -2.0
    with pytest.raises(Refusal, match="three"):
        ask(project, "records", "map", **{**given, f"from.y_{axes[0]}": "three"})
    with pytest.raises(Refusal, match="is no number"):
        ask(project, "records", "map", **{**given, f"from.y_{axes[0]}": "x * one"})


def test_an_identified_machine_is_written_back_and_the_old_one_kept(project):
    before = project.machine.read_text("utf-8")
    with pytest.raises(Refusal, match="identify first"):
        ask(project, "identification", "back")
    new = "# identified\n" + before
    project.path("machines", "identified.toml").write_text(new)
    told, _ = ask(project, "identification", "back")
    assert project.machine.read_text("utf-8") == new
    assert project.path("machines", "before.toml").read_text("utf-8") == before
    assert "machines/before.toml" in told["told"]
    project.path("machines", "identified.toml").write_text("[machine]\n")
    with pytest.raises(Refusal):
        ask(project, "identification", "back")
    assert project.machine.read_text("utf-8") == new


@needs("cc")
def test_code_is_tested_and_packed(project):
    folder = project.folder("code") / "c-double"
    folder.mkdir()
    (folder / "x.h").write_text("int one(void);\n")
    (folder / "x.c").write_text('#include "x.h"\nint one(void) { return 1; }\n')
    test = '#include <stdio.h>\n#include "x.h"\nint main(void) { puts("%s"); return one() - %d; }\n'
    (folder / "x_test.c").write_text(test % ("ran <b>", 1))
    (folder / "secret").symlink_to(project.machine)
    _, blocks = ask(project, "deploy", "test", code="c-double")
    ran = blocks["test-c-double"]
    assert ran["tone"] == "good"
    assert ran["log"] == "ran <b>"
    (folder / "x_test.c").write_text(test % ("ran", 2))
    assert ask(project, "deploy", "test", code="c-double")[1]["test-c-double"]["tone"] == "bad"
    _, blocks = ask(project, "deploy", "pack", code="c-double")
    assert blocks["zip-c-double"]["href"] == "/files/code/c-double.zip"
    with zipfile.ZipFile(project.path("code", "c-double.zip")) as archive:
        names = archive.namelist()
    assert names == [f"c-double/{name}" for name in ("x.c", "x.h", "x_test.c")]
    for name in ("../records", "absent", "c-double/..", 3):
        with pytest.raises((Refusal, amb.InvalidInput)):
            ask(project, "deploy", "test", code=name)


def test_a_plan_is_written_as_the_command_reads_it(project):
    from ambrose.annexes.campaigns.plan import read_plan

    project.path("controllers", "mine.json").write_text("{}")
    _, blocks = ask(project, "studies")
    fields = {field["name"]: field["value"] for field in blocks["plan"]["fields"]}
    told, blocks = ask(project, "studies", "plan", **fields)
    assert "plan.toml is written" in told["told"]
    plan = read_plan(project.path("plans", "plan.toml"))
    assert plan.place(plan.machine).samefile(project.machine)
    assert plan.place(plan.controller).name == "mine.json"
    assert plan.size >= 7
    assert blocks["do-campaign"]["fields"][0]["value"] == "plan.toml"
    # another one of that name stands beside it
    told, blocks = ask(project, "studies", "plan", **{**fields, "controller": "every controller"})
    every = read_plan(project.path("plans", "plan-2.toml"))
    assert every.named("controller") == ("../controllers/mine.json",)


@pytest.mark.parametrize(
    "given, field",
    [
        ({"name": "../x"}, "name"),
        ({"vary": "controller.gain = ["}, "vary"),
        ({"vary": 'machine = ["/etc/passwd"]'}, "vary"),
        ({"vary": 'controller = ["../../secret.json"]'}, "vary"),
    ],
)
def test_a_plan_that_cannot_be_is_refused_beside_its_field(project, given, field):
    before = project.names("plans")
    with pytest.raises(Refusal) as caught:
        ask(project, "studies", "plan", **{"task": "screen", "name": "bad", "vary": "", **given})
    assert caught.value.content["fields"][field] == caught.value.content["error"]
    assert project.names("plans") == before


def test_the_controller_of_a_retuning_joins_the_others(project):
    with pytest.raises(Refusal, match="retune first"):
        ask(project, "retuning", "take")
    project.path("retuning", "controller.json").write_text('{"new": 1}')
    project.path("retuning", "retuning.html").write_text("<p>")
    _, blocks = ask(project, "retuning")
    address = blocks["page"]["src"]
    assert address.startswith("/files/retuning/retuning.html?")
    # another address once it is written anew, so that the page shows what stands there
    os.utime(project.path("retuning", "retuning.html"), (1, 1))
    assert ask(project, "retuning")[1]["page"]["src"] != address
    told, _ = ask(project, "retuning", "take")
    assert told["told"] == "controllers/retuned.json is written."
    assert project.path("controllers", "retuned.json").read_text() == '{"new": 1}'


def test_the_controller_that_ran_is_found_whatever_its_form(tmp_path):
    """A table of filters ran as vendor.csv, and pid.json was proposed."""
    folder = Project(tmp_path)
    begin(folder, "two-disc-rotor")
    for name in ("pid.json", "vendor.csv"):
        folder.path("controllers", name).write_text("{}")
    folder.path("records", "live-vendor-20260101-120000.h5").write_bytes(b"")
    record, controller = run_fields(folder)
    assert record["value"] == "live-vendor-20260101-120000.h5"
    assert controller["value"] == "vendor.csv"
