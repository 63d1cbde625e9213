"""A controller for a machine that has none: one that the judge says holds it as the rig starts."""

from dataclasses import replace

import pytest

from ambrose.annexes.workbench.live import at_the_start, first_controller, why_lost
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import DEFAULT
from ambrose.machine.file.toml import load_machine
from ambrose.model.assemble import assemble
from ambrose.synthesis.design import design


@pytest.fixture(scope="module")
def machine():
    return load_machine("seal-rig")


def test_a_pid_that_holds_the_machine_is_the_first(machine):
    made = first_controller(machine)
    assert made.method == "pid"
    held = at_the_start(machine, made)
    assert held.stable and held.timing == str(DEFAULT)
    assert why_lost("pid.json", machine, made) == ""


def test_where_the_pid_is_lost_one_is_tuned_for_the_rate_of_the_rig(machine, monkeypatch):
    weak = replace(machine.reference, gain=tuple(0.2 * g for g in machine.reference.gain))
    lost = pid_synthesis(assemble(machine), weak)
    asked = []

    def designed(plant, method, **options):
        asked.append((method, options))
        return lost if method == "pid" else design(plant, "pid")  # which is quicker than tuned

    monkeypatch.setattr("ambrose.annexes.workbench.live.design", designed)
    made = first_controller(machine)
    assert at_the_start(machine, made).stable
    rate = {"rate": DEFAULT.rate, "delay_samples": DEFAULT.delay_samples}
    assert asked == [("pid", {}), ("tuned", rate)]
    words = why_lost("weak.json", machine, lost)
    assert words.startswith("weak.json is unstable on this machine at nominal pressure, ")
    assert words.endswith("choose another one")
