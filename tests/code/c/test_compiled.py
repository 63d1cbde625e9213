"""Software in the loop: the compiled C code runs the virtual rig, and its law is read back out of
it.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.code.block.block import build_block
from ambrose.code.block.run import run_of
from ambrose.code.c.compiled import CompiledBlock, read_law
from ambrose.code.pipeline import machine_limits, unverified_block
from ambrose.code.sampled import deploy
from ambrose.code.targets import C
from ambrose.core.checks import InvalidInput
from ambrose.judge import nominal
from ambrose.judge.result import pid_synthesis
from ambrose.law.law import NativeProgram
from ambrose.law.pid import pid_controller
from ambrose.model.assemble import assemble
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Failure, load_scenario
from needs import needs

pytestmark = needs("cc")
SAMPLE = 1e-4


@pytest.fixture(scope="module")
def rig():
    """Machine, full plant at zero pressure, and the PID as a block."""
    machine = load_machine("seal-rig")
    zero = next(point for point in machine.operation.points if point.seal_pressure == 0)
    plant = assemble(machine, zero)
    deployment = deploy(pid_synthesis(plant), SAMPLE, SAMPLE, plants=[], force=True)
    errors, currents = machine_limits(machine)
    return machine, plant, build_block(deployment, "pid", errors, currents)


WORDS = {"double": 1e-15, "float": 1e-6, "fixed32": 1e-6}


@pytest.mark.parametrize("arithmetic", WORDS)
def test_the_law_is_read_back_out_of_the_running_code(rig, arithmetic):
    block = rig[2]
    found = read_law(CompiledBlock(block, arithmetic))
    for letter in "ABCD":
        meant = getattr(block.system, letter)
        assert (
            np.abs(getattr(found, letter) - meant).max() <= WORDS[arithmetic] * np.abs(meant).max()
        )


@pytest.mark.parametrize(
    ("arithmetic", "apart"), [("double", 1e-12), ("float", 1e-4), ("fixed32", 1e-3)]
)
def test_the_rig_cannot_tell_the_code_from_the_design(rig, arithmetic, apart):
    machine, plant, block = rig
    scenario = replace(load_scenario("impulse-parallel"), duration=0.1)
    code = virtual_rig.run(machine, CompiledBlock(block, arithmetic), scenario, point=plant.point)
    design = virtual_rig.run(machine, block.system, scenario, point=plant.point)
    assert code.outcome == design.outcome == "completed"
    names = plant.named("y")
    size = max(np.ptp(design.record[name]) for name in names)
    assert (
        max(np.abs(code.record[name] - design.record[name]).max() for name in names) <= apart * size
    )
    assert code.pole == pytest.approx(design.pole)


class Relay:
    """A program in Python around another one: the rig calls it back."""

    def __init__(self, code, last=10_000):
        self.code, self.steps, self.last = code, 0, last
        self.sample_time, self.delay, self.system, self.begin = (
            code.sample_time,
            code.delay,
            code.system,
            code.begin,
        )

    def step(self, errors):
        self.steps += 1
        if self.steps > self.last:
            raise RuntimeError("no more")
        return self.code.step(errors)


@pytest.mark.parametrize("arithmetic", WORDS)
def test_code_called_by_its_address_and_through_python_log_the_same(rig, arithmetic):
    machine, plant, block = rig
    scenario = replace(load_scenario("impulse-parallel"), duration=0.1)
    code = CompiledBlock(block, arithmetic)
    assert isinstance(code, NativeProgram) and not isinstance(Relay(code), NativeProgram)
    native, relayed = (
        virtual_rig.run(machine, c, scenario, point=plant.point).record for c in (code, Relay(code))
    )
    for name in plant.named("y") + plant.named("u"):
        np.testing.assert_array_equal(native[name], relayed[name])
    # what a program raises comes out of the compiled rig
    with pytest.raises(RuntimeError, match="no more"):
        virtual_rig.run(machine, Relay(code, 300), scenario, point=plant.point)


def test_words_end_where_a_converter_ends(rig):
    """An error beyond the word's range is its largest count, not another number after an
    overflow.
    """
    code = CompiledBlock(rig[2], "fixed32")
    currents = []
    for size in (3.0, 1e9):
        code.begin(np.zeros(rig[2].n_states))
        currents.append(code.step(size * rig[2].error_limit))
    np.testing.assert_array_equal(*currents)


def test_the_same_verification_comes_out_of_the_code(rig):
    _, plant, block = rig
    code, design = (
        nominal.check(plant, system) for system in (read_law(CompiledBlock(block)), block.system)
    )
    assert code.stable
    for name in ("sensitivity.output.max", "compliance.max"):
        assert code[name].value == pytest.approx(design[name].value, rel=1e-9)


def test_limited_currents_and_recovery_are_those_of_the_block(rig):
    tight = replace(rig[2], current_limit=np.full(4, 0.4))
    code = CompiledBlock(tight)
    errors = 4e-5 * np.sin(0.05 * np.arange(600))[:, None] * np.ones(4)
    errors[300:] = 0.0
    meant = run_of(tight, errors)
    assert (meant.status & 4).sum() > 50
    found = code.run(errors)
    assert np.abs(found - meant.currents).max() <= 1e-12 * np.abs(meant.currents).max()
    np.testing.assert_allclose(code.states(), meant.states, rtol=1e-9, atol=1e-15)


def test_refusals(rig):
    machine, plant, block = rig
    with pytest.raises(InvalidInput, match="no C compiler nonesuch"):
        CompiledBlock(block, compiler="nonesuch")
    code = CompiledBlock(block)
    scenario = load_scenario("impulse-parallel")
    with pytest.raises(InvalidInput, match="delay"):
        virtual_rig.run(machine, code, scenario, point=plant.point, computing_delay=0)
    with pytest.raises(InvalidInput, match="the sample time"):
        virtual_rig.run(machine, code, replace(scenario, sample_time=2e-4), point=plant.point)


def test_anti_windup_frees_a_rotor_that_the_bare_law_holds_against_its_stop():
    """Power away for 0.1 s: the law's integrators wind up while the rotor lies, the code's do not.
    Measured: free 0.3 ms after the power is back, and 20 ms.
    """
    machine = load_machine("turbomolecular-pump")
    law = pid_controller(machine.controller, machine)
    code = CompiledBlock(unverified_block(law, machine, C()), "double")
    free = []
    away = Failure(0.01, until=0.11)
    dip = replace(load_scenario("power-dip"), duration=0.18, failures=(away,))
    for controller in (law, code):
        text = virtual_rig.run(machine, controller, dip).text
        after = text.partition("free again since t = ")[2].split()
        free.append(float(after[0]) if after else math.inf)  # not within the run
    assert free[1] < 0.112 and free[0] > 0.125
