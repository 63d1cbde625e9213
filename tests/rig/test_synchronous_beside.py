"""What `simulate` does with synchronous blocks of a controller: it runs them, or refuses."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.synchronous.running import beside_law
from ambrose.core.checks import InvalidInput
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.judge.result import Synthesis
from ambrose.law.law import law_of
from ambrose.law.loop import Timing
from ambrose.law.pid import pid_controller
from ambrose.machine.part import Synchronous
from ambrose.rig.scenario import Scenario, Unbalance

HOLD = Scenario("hold", 0.6, unbalances=(Unbalance("upper", 40e-6),), speed=800.0)


@pytest.fixture(scope="module")
def controlled():
    machine = amb.load_machine("flywheel")
    block = Synchronous("current-free", (700.0, 900.0), 0.04)
    return machine, Synthesis(pid_controller(machine.reference, machine), synchronous=(block,))


def tone(trace, start, end):
    """The 1x amplitude of a control current over whole turns."""
    turn, time = 2 * np.pi / 800, trace.record.time
    end = start + turn * int((end - start) / turn)
    inside = (time >= start) & (time < end)
    wave = np.exp(-800j * time[inside])
    return abs(2 * np.mean(trace.record["u_upper_zeta"][inside] * wave))


def test_the_blocks_of_a_controller_run_with_it(controlled):
    machine, controller = controlled
    trace = amb.simulate(machine, controller, HOLD)
    alone = amb.simulate(machine, replace(controller, synchronous=()), HOLD)
    assert "synchronous blocks on for" in trace.text
    assert "synchronous" not in alone.text
    assert tone(trace, 0.5, 0.6) < 0.3 * tone(alone, 0.5, 0.6)


def test_what_cannot_run_them_is_refused(controlled):
    machine, controller = controlled
    with pytest.raises(InvalidInput, match="synchronous blocks is linear"):
        amb.simulate(machine, controller, HOLD, linear=True)


def test_a_block_is_asked_for_in_python_as_on_the_command_line(controlled):
    machine, _ = controlled
    with pytest.raises(InvalidInput, match="synchronous_band is given"):
        amb.design(machine, "pid", synchronous_band=(600.0, 640.0))
    with pytest.raises(InvalidInput, match="one of current-free"):
        amb.design(machine, "pid", synchronous="loud")
    law = pid_controller(machine.reference, machine)
    wanted = {"synchronous_band": (600.0, 640.0), "synchronous_time": 0.4}
    made = amb.design(machine, synchronous="current-free", base=law, **wanted)
    (block,) = made.synchronous
    assert block.band == (600.0, 640.0)
    assert block.time_constant == pytest.approx(0.4)


def test_a_block_that_moves_once_a_turn_converges_on_the_rig_like_the_other(controlled):
    """Convergent control: 1x of the current falls as far as with a block that moves every
    sample.
    """
    machine, _ = controlled
    law = pid_controller(machine.reference, machine)
    left = {}
    for update in ("sample", "turn"):
        made = amb.design(
            machine,
            synchronous="current-free",
            base=law,
            synchronous_band=(760.0, 840.0),
            synchronous_update=update,
        )
        assert made.synchronous[0].update == update
        left[update] = tone(amb.simulate(machine, made, HOLD), 0.5, 0.6)
    assert left["turn"] < 1.3 * left["sample"]


def scheduled(controller, *laws):
    speeds = (300.0, 700.0, 1000.0)[: len(laws)]
    return replace(controller, scheduled=ScheduledSystem(speeds, laws))


def test_beside_a_schedule_that_changes_nothing_blocks_do_what_they_do_beside_the_law(controlled):
    machine, controller = controlled
    run_up = replace(HOLD, duration=0.2, speed=780.0, to_speed=800.0, ramp=0.2)
    law = controller.controller
    alone = amb.simulate(machine, controller, run_up).record
    beside = amb.simulate(machine, scheduled(controller, law, law, law), run_up).record
    for name in ("u_upper_zeta", "q_upper_zeta"):
        assert np.abs(beside[name] - alone[name]).max() < 1e-9 * np.abs(alone[name]).max()


def test_a_schedule_with_blocks_that_are_off_is_the_schedule(controlled):
    """Against the rig's own way with a schedule, which reads it anew every 50 samples."""
    machine, controller = controlled
    law = controller.controller
    softer = StateSpace(law.A, law.B, 0.7 * law.C, 0.7 * law.D, law.inputs, law.outputs)
    both = scheduled(controller, softer, law, softer)
    run_up = Scenario("up", 0.2, unbalances=HOLD.unbalances, speed=400.0, to_speed=650.0, ramp=0.2)
    beside = amb.simulate(machine, both, run_up)  # below the block's band
    plain = amb.simulate(machine, replace(both, synchronous=()), run_up)
    fixed = amb.simulate(machine, replace(controller, synchronous=()), run_up)
    assert "on for 0%" in beside.text
    q, same, other = (one.record["q_upper_zeta"] for one in (beside, plain, fixed))
    assert np.abs(q - same).max() < 2e-3 * np.abs(same).max()
    assert np.abs(q - other).max() > 0.05 * np.abs(same).max()


def test_what_a_schedule_is_told_may_be_lost_or_beyond_its_range(controlled):
    machine, controller = controlled
    law = controller.controller
    softer = StateSpace(law.A, law.B, 0.7 * law.C, 0.7 * law.D, law.inputs, law.outputs)
    both = law_of(scheduled(controller, softer, law))
    start, timing = replace(machine.operation.design, speed=400.0), Timing(1e-4, 1)
    program = beside_law(machine, both, both.synchronous, HOLD, start, timing)
    assert program.range == (300.0, 700.0)
    program.schedule(500.0)
    kept = program.system
    program.schedule(np.nan)
    assert program.system is kept
    assert np.allclose(kept.D, 0.85 * program(5000.0).D)
    with pytest.raises(InvalidInput, match="not with a program"):
        beside_law(machine, law_of(program), both.synchronous, HOLD, start, timing)
