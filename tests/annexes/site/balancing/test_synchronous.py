"""Unbalance from a converged block: exact on the model, with run-out, and in one hold on the
virtual rig.
"""

import numpy as np
import pytest

from ambrose.annexes.site.balancing.synchronous import unbalance_from_amplitudes
from ambrose.code.c.compiler import has_compiler
from ambrose.core.checks import InvalidInput
from ambrose.law.pid import pid_controller
from ambrose.law.synchronous import Condition, forward_patterns, synchronous_loop
from ambrose.machine.file.toml import load_machine

REST = Condition(0.0)
TRUE = np.array([40e-6, 28e-6 * np.exp(1.0j)])


@pytest.fixture(scope="module")
def loop():
    machine = load_machine("flywheel")
    return synchronous_loop(machine, pid_controller(machine.reference, machine))


def amplitudes(loop, speeds):
    """What a current-free block holds, from the closed loop's own algebra."""
    return np.array(
        [
            loop.converged("current-free", w, REST, forward_patterns(loop.machine)).c
            @ (TRUE * w**2)
            for w in speeds
        ]
    )


def test_the_amplitude_is_the_unbalance_response(loop):
    found = unbalance_from_amplitudes(loop, REST, [700.0], amplitudes(loop, [700.0]))
    assert found.moments == pytest.approx(TRUE, rel=1e-8)
    assert found.residual < 1e-9
    (mass, angle), _ = found.corrections([0.1, 0.1])
    assert (mass, angle) == pytest.approx((0.4, 180.0))


def test_run_out_is_told_from_unbalance_by_several_speeds(loop):
    speeds = [500.0, 700.0, 900.0]
    runout = np.array([2e-6, 2e-6j, -1e-6, 1e-6])
    a = amplitudes(loop, speeds) + runout
    found = unbalance_from_amplitudes(loop, REST, speeds, a, runout=True)
    assert found.moments == pytest.approx(TRUE, rel=1e-6)
    assert found.runout == pytest.approx(runout, rel=1e-6)
    blind = unbalance_from_amplitudes(loop, REST, speeds, a)
    assert (
        blind.residual > 0.05
    )  # current-free by itself cannot tell; the fit says that something is left


def test_a_plane_that_is_none_and_too_few_speeds_are_refused(loop):
    with pytest.raises(InvalidInput, match="a balancing plane is 'nowhere'"):
        unbalance_from_amplitudes(loop, REST, [700.0], amplitudes(loop, [700.0]), ["nowhere"])
    with pytest.raises(InvalidInput, match="unknowns"):
        unbalance_from_amplitudes(loop, REST, [700.0], amplitudes(loop, [700.0]), runout=True)


@pytest.mark.campaign
@pytest.mark.skipif(not has_compiler(), reason="no C compiler")
def test_one_hold_on_the_rig_falls_by_30_db_and_tells_93_percent_of_the_unbalance():
    """Nonlinear rig with noise, C block, key phasor: 1x current by 30 dB, and what balancing
    leaves.
    """
    from ambrose.code.c.synchronous import CompiledSynchronous
    from ambrose.law.synchronous_table import running_law
    from ambrose.rig.disturbances import Unbalance
    from ambrose.rig.scenario import Scenario
    from ambrose.rig.synchronous import synchronous_program
    from ambrose.rig.virtual_rig import run
    from ambrose.synthesis.synchronous_design import design_synchronous

    machine = load_machine("flywheel")
    law = pid_controller(machine.reference, machine)
    rig_loop = synchronous_loop(machine, law)
    design = design_synchronous(machine, law, band=(700.0, 900.0))
    blocks = running_law(design.blocks, rig_loop)
    sampled = rig_loop.controller(rig_loop.plant(800.0, REST))
    weights = (Unbalance("upper", 40e-6), Unbalance("lower", 28e-6, phase=1.0))
    scenario = Scenario("hold", 3.5, unbalances=weights, speed=800.0)
    program = synchronous_program(
        machine, sampled, blocks, scenario, block=CompiledSynchronous(blocks)
    )
    trace = run(machine, program, scenario, every=10)
    assert trace.outcome == "completed"

    def tone(signal, start, end):
        time, turns = trace.record.time, round((end - start) * 800 / (2 * np.pi))
        inside = (time >= start) & (time < start + turns * 2 * np.pi / 800)
        x = trace.record[signal][inside]
        return abs(2 * np.mean(x * np.exp(-800j * time[inside])))

    before, after = tone("i_upper_zeta", 0.02, 0.1), tone("i_upper_zeta", 2.5, 3.4)
    assert 20 * np.log10(after / before) < -30
    late = np.mean([a[0] for k, _, a, _ in program.history if k * sampled.dt > 2.5], axis=0)
    found = unbalance_from_amplitudes(rig_loop, REST, [800.0], late[None])
    left = np.linalg.norm(found.moments - TRUE) / np.linalg.norm(TRUE)
    assert left < 0.07
