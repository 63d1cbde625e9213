"""Since when a rotor is levitated: within half of its gaps, not just off its touchdown bearings."""

import numpy as np
import pytest

from ambrose.machine.file.toml import load_machine
from ambrose.rig.engine.record import Lift, Watch, classify_outcome
from ambrose.rig.engine.state import build
from ambrose.rig.scenario import Scenario

STEP = 1e-4
TIME = np.arange(5000) * STEP


def brute_force(share):
    """The first sample from which 50 ms are within half, one sample after the other."""
    for k in range(len(share)):
        stay = share[k : k + 501]
        if len(stay) == 501 and (stay <= 0.5).all():
            return TIME[k]
    return None


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("length", [5000, 700, 37])
def test_stretches_of_any_length_tell_the_same(seed, length):
    rng = np.random.default_rng(seed)
    share = 0.3 + 0.15 * np.sin(2 * np.pi * rng.uniform(1, 9) * TIME + seed)
    share[: rng.integers(0, 3000)] += 0.6
    share[rng.integers(0, 5000, rng.integers(0, 4))] = 0.9
    lift, found = Lift(), None
    for a in range(0, 5000, length):
        if found is None:
            found = lift.follow(TIME[a : a + length], share[a : a + length])
    expected = brute_force(share)
    assert (found is None) == (expected is None)
    if found is not None:
        assert found == pytest.approx(expected, abs=STEP / 2)


@pytest.mark.parametrize(("share", "levitated"), [(0.9, False), (0.52, False), (0.48, True)])
def test_a_rotor_that_hangs_near_its_touchdown_bearing_is_not_levitated(share, levitated):
    """350 of 390 um, 1.3 ms after the start, was "levitated since t = 0.0013 s"."""
    machine = load_machine("seal-rig")
    rig = build(machine, machine.operation.nominal, 0)
    monitor = Watch(rig, None)
    gap, a = machine.bearings[0].touchdown_gap, len(machine.axes)
    log = np.zeros((2000, 4 * a + len(rig.port_names)))
    log[:13, 4 * a] = 1.001 * gap
    log[13:, 4 * a] = share * gap

    class Task:
        dt = STEP

    monitor.follow(Task, 0, log)
    outcome, text = classify_outcome(monitor, Scenario("x", 0.2, initial="resting"), None, None)
    assert outcome == ("completed" if levitated else "not levitated")
    assert ("levitated since t = 0.0013 s" in text) == levitated
    assert ("at the end at" in text) != levitated
