"""What `simulate` does with synchronous blocks of a controller: it runs them, or refuses."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.judge.result import Synthesis
from ambrose.law.pid import pid_controller
from ambrose.machine.synchronous import Synchronous
from ambrose.rig.disturbances import Unbalance
from ambrose.rig.scenario import Scenario

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


@pytest.mark.campaign
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


@pytest.mark.campaign
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
