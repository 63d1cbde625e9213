"""A page that is signed names what it was made of: the machine's hash and the controller's."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.statespace import static_gain
from ambrose.judge.checks import Verification
from ambrose.judge.result import Synthesis
from ambrose.judge.verdict import verify_controller
from ambrose.law.law import law_of
from ambrose.machine.file.toml import load_machine, machine_hash
from ambrose.report import record, verification, verification as synchronous
from ambrose.report.page import page_of
from ambrose.rig.scenario import Scenario
from ambrose.rig.trial import simulate_scenario

MACHINE = load_machine("flywheel")


@pytest.fixture(scope="module")
def law():
    axes = MACHINE.axes
    named = [f"err_{axis}" for axis in axes], [f"u_{axis}" for axis in axes]
    return Synthesis(replace(static_gain(np.eye(len(axes))), inputs=named[0], outputs=named[1]))


@pytest.fixture(autouse=True)
def undrawn(monkeypatch):
    """The heads are looked at, not the pictures."""
    monkeypatch.setattr(verification, "machine_drawing", lambda *given: None)
    for name in ("orbit_figure", "waterfall_figure", "rotor_animation", "figure"):
        monkeypatch.setattr(record, name, lambda *given, **more: None)


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
