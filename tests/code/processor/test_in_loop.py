"""The target's binary in the loop with the virtual rig: the record beside this computer's."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.code.in_loop import simulate_on_target, target_program
from ambrose.code.processor_build import PROCESSORS, unit_of
from ambrose.code.targets import C
from ambrose.core.checks import InvalidInput
from ambrose.judge.controller_file import write_controller
from ambrose.record.files import read_record
from ambrose.rig.scenario import load_scenario
from example_blocks import small_block

sys.path.append(str(Path(__file__).parent))
from test_trial import BIG, M7

from needs import needs

RIG = amb.load_machine("seal-rig")


@cache
def pid():
    return amb.design(RIG, "pid").controller


def short(name, duration):
    return replace(load_scenario(name), duration=duration)


@pytest.mark.parametrize(
    ("scenario", "duration", "processor", "arithmetic"),
    [
        pytest.param("levitation", 0.2, M7, "double", marks=needs(M7)),
        pytest.param("levitation", 0.2, BIG, "float", marks=needs(BIG)),
        pytest.param("power-loss", 0.2, M7, "float", marks=[needs(M7), pytest.mark.study]),
        pytest.param("power-loss", 0.2, M7, "fixed32", marks=needs(M7)),
    ],
)
def test_the_record_with_the_target_s_binary_is_this_computer_s_to_the_last_bit(
    scenario, duration, processor, arithmetic
):
    code = C(try_on=processor, arithmetic=arithmetic)
    looped = simulate_on_target(RIG, pid(), short(scenario, duration), code)
    assert looped.equal, looped.text
    assert looped.bound == 0
    # it lifts off, it falls
    lifted, fell = looped.trace.outcome == "completed", looped.trace.touchdown_at is not None
    assert (lifted, fell) == ((True, False) if scenario == "levitation" else (False, True))


@pytest.mark.study
@needs(M7, BIG)
@pytest.mark.parametrize("processor", [M7, BIG])
def test_the_operating_cycle_with_its_trip_is_this_computer_s_to_the_last_bit(processor):
    code = C(try_on=processor, arithmetic="float")
    looped = simulate_on_target(RIG, pid(), "operating-cycle", code)
    assert looped.equal, looped.text
    assert looped.trace.record.values.shape[1] == 50_001


@needs(M7)
def test_contraction_is_seen_and_stays_small():
    """The comparison can fail: one rounding less in every product and sum, and the loop settles."""
    code = C(try_on=M7, arithmetic="float")
    events = short("impulse-parallel", 0.1)
    looped = simulate_on_target(RIG, pid(), events, code, contraction=True)
    assert not looped.equal
    assert looped.bound is None
    size = max(np.ptp(looped.host.record[f"y_{axis}"]) for axis in RIG.axes)
    # float keeps 6e-8 of a number; the loop's noise gain from one rounding is some thousand at most
    assert 0 < looped.apart["m"] < 1e-4 * size
    assert "apart from this computer's record by up to" in looped.text


@needs(M7)
def test_a_program_goes_on_from_the_states_that_it_is_given():
    block = small_block()
    with target_program(unit_of(block, "double"), PROCESSORS[M7]) as program:
        states = 0.01 * np.arange(1, block.n_states + 1) * block.state_range
        program.begin(states)
        current = program.step(np.zeros(2))
        assert current == pytest.approx(block.system.C @ states, rel=1e-9)
        assert program.instructions > 100
        program.begin(np.zeros(block.n_states))
        assert program.step(np.zeros(2)) == 0


@needs(M7)
def test_the_command_writes_the_record_of_the_target(tmp_path):
    path = write_controller(tmp_path / "pid.json", pid())
    words = ["simulate", "seal-rig", "--controller", path, "--scenario", "impulse-parallel"]
    words += ["-o", tmp_path / "r.h5", "--json"]
    found = {}
    for label, more in (("target", ["--on-target", M7]), ("here", [])):
        result = CliRunner().invoke(main, [str(word) for word in [*words, *more]])
        found[label] = json.loads(result.stdout), read_record(tmp_path / "r.h5").values
    told = found["target"][0]["on_target"]
    assert told["equal"] and told["bound"] == 0 and told["processor"] == M7
    assert told["instructions"] > 300
    assert "on_target" not in found["here"][0]
    # within its limits the code is the design, in other states
    (there, here), size = (found[label][1] for label in found), np.ptp(found["here"][1], axis=1)
    assert (np.abs(there - here).max(axis=1) <= 1e-9 * size).all()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--arithmetic", "float"], "--arithmetic is float, but must be given with --on-target"),
        (["--on-target", "ppc64", "--linear"], "must be left out with --linear"),
        (["--on-target", "ppc64", "--fallback", "x.json"], "must be left out with --on-target"),
    ],
)
def test_what_does_not_go_together_is_refused(more, said):
    words = ["simulate", "seal-rig", "--controller", "none.json", "--scenario", "levitation"]
    result = CliRunner().invoke(main, [*words, *more])
    assert result.exit_code == 2
    assert said in result.stderr


def test_a_target_without_a_processor_is_refused():
    with pytest.raises(InvalidInput, match="try_on"):
        simulate_on_target(RIG, pid(), "levitation", C())
