"""A page that is signed names what it was made of: the machine's hash and the controller's."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose.cli import main
from ambrose.core.statespace import static_gain
from ambrose.judge.checks import Verification
from ambrose.judge.controller_file import read_controller
from ambrose.judge.result import Synthesis
from ambrose.judge.verdict import verify_controller
from ambrose.law.law import law_of
from ambrose.machine.file.toml import load_machine, machine_hash
from ambrose.report import record, verification, verification as synchronous
from ambrose.report.page import page_of
from ambrose.rig.scenario import Scenario
from ambrose.rig.trial import simulate_scenario

MACHINE = load_machine("flywheel")
FILES = Path(__file__).parents[2] / "benchmarks" / "snapshot_files"


@pytest.fixture(scope="module")
def law():
    axes = MACHINE.axes
    named = [f"err_{axis}" for axis in axes], [f"u_{axis}" for axis in axes]
    return Synthesis(replace(static_gain(np.eye(len(axes))), inputs=named[0], outputs=named[1]))


@pytest.fixture
def undrawn(monkeypatch):
    """The heads are looked at, not the pictures."""
    monkeypatch.setattr(verification, "machine_drawing", lambda *given: None)
    for name in ("orbit_figure", "waterfall_figure", "rotor_animation", "figure"):
        monkeypatch.setattr(record, name, lambda *given, **more: None)


@pytest.mark.usefixtures("undrawn")
def test_every_page_of_a_controller_names_it(law):
    found = verify_controller(MACHINE, law, points=["rest"], tolerances=False)
    assert found.controller == f"{law.method}, SHA-256 {law.digest}"
    assert found.to_dict()["controller"] == found.controller
    scenario = Scenario("still", 0.01)
    trace = simulate_scenario(MACHINE, law, scenario, linear=True, rate=1e4)
    pages = (
        page_of(found, MACHINE),
        synchronous.synchronous_page(MACHINE, [], controller=found.controller),
        page_of(trace, MACHINE),
    )
    for page in pages:
        facts = dict(page.head)
        assert law.digest in facts["Controller"]
        assert machine_hash(MACHINE) in facts["Machine"]


def test_what_is_no_file_says_so(law):
    assert law_of(law.controller).named == "not from a controller file"
    assert Verification(()).controller == ""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A small rig, its PID in a file, a record of it."""
    made = tmp_path_factory.mktemp("origin")
    for name in ("small-rig.toml", "sequence.toml"):
        (made / name).write_text((FILES / name).read_text("utf-8"), "utf-8")
    for machine, place in (("small-rig.toml", "pid.json"), ("flywheel", "turning.json")):
        said(made, "synthesize", machine, "--method", "pid", "-o", place)
    ran = ("--controller", "pid.json", "--scenario", "sequence.toml", "-o", "run.h5")
    said(made, "simulate", "small-rig.toml", *ran, "--linear")
    return made


def said(folder, *words):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        run = CliRunner().invoke(main, [*words, "--json"])
    assert run.exit_code in (0, 1), run.output
    return run


RECORDED = ["small-rig.toml", "run.h5", "--controller", "pid.json"]
HEADS = {
    "verify": ["small-rig.toml", "--controller", "pid.json", "--report"],
    "map": ["small-rig.toml", "--controller", "pid.json", "--what", "poles", "-o"],
    "identify": [*RECORDED, "--bending-modes", "1", "-o", "identified.toml", "--report"],
    "frf": [*RECORDED, "-o"],
    "monitor": ["small-rig.toml", "pid.json", "run.h5", "--bending-modes", "1", "-o"],
    "lateral": ["flywheel", "--controller", "turning.json", "-o"],
    "landing": ["flywheel", "--controller", "turning.json", "--duration", "0.02", "-o"],
}


@pytest.mark.parametrize("command", HEADS)
def test_one_name_and_one_hash_of_a_controller_on_every_page(command, folder):
    """Pages of map, identify, frf, monitor and landing named none, that of lateral another hash."""
    said(folder, command, *HEADS[command], f"{command}.html")
    text = (folder / f"{command}.html").read_text("utf-8")
    head = dict(re.findall("<dt>(.*?)</dt><dd>(.*?)</dd>", text))
    machine = MACHINE if "flywheel" in HEADS[command] else load_machine(folder / "small-rig.toml")
    name = "turning.json" if machine is MACHINE else "pid.json"
    digest = read_controller(folder / name).digest
    assert head["Controller"].startswith(f"{name}, pid, SHA-256 {digest}")
    assert machine_hash(machine) in head["Machine"]
