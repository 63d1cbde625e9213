"""Power that comes back: a rotor that never falls, one that gets free, one that does not."""

import math

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.touchdown.analysis import held_states, sampled_law, slow_first, with_magnets
from ambrose.annexes.touchdown.drop import Drop, build, case_of, fallen_rotor, run
from ambrose.core.statespace import StateSpace
from coarse import coarse


@pytest.fixture(scope="module")
def spindle():
    machine = coarse("high-speed-spindle")
    point = max(machine.operation.envelope, key=lambda item: item.speed)
    return machine, point, amb.design(machine, "pid"), fallen_rotor(machine, point, 2)


def powered(spindle, law, start, duration, held=True):
    machine, point, _, fallen = spindle
    rig, dt = build(machine, fallen)
    arrays, dt = sampled_law(machine, law, point, dt)
    drop = Drop(point.speed, (0.0, 0.0), (0.0, 0.0))
    case, state = case_of(fallen, rig, drop, 0.0)
    states = held_states(machine, fallen, arrays, point) if held else None
    rig = with_magnets(machine, fallen, rig, point)
    return run(rig, case, state, duration, dt, law=arrays, held=states, start=start)


def test_power_that_was_never_lost(spindle):
    """The integrators carry the weight from the first sample on: the rotor stays where it is."""
    fall = powered(spindle, spindle[2], 0.0, 0.05)
    gap = spindle[0].bearings[0].touchdown_gap
    assert fall.figures[:, 0].max() < 0  # no contact
    assert fall.figures[:, 5].max() < 0.02 * gap
    # without what they held it sags first
    assert powered(spindle, spindle[2], 0.0, 0.05, held=False).figures[:, 5].max() > 0.05 * gap


def test_it_gets_free_or_not(spindle):
    machine, point, law, _ = spindle
    result = amb.landing(machine, point, law=law, power_back=0.02, duration=0.1)
    assert 0 <= result.recovery.time < 0.05
    nothing = StateSpace(
        np.zeros((0, 0)),
        np.zeros((0, 4)),
        np.zeros((4, 0)),
        np.zeros((4, 4)),
        law.controller.inputs,
        law.controller.outputs,
    )
    lost = amb.landing(machine, point, law=nothing, power_back=0.02, duration=0.1)
    assert math.isinf(lost.recovery.time)
    assert lost.passed is False


def test_slow_states_apart():
    """The same transfer function, poles above exp(-2 pi T) first and on their own."""
    generator = np.random.default_rng(5)
    turn = np.linalg.qr(generator.normal(size=(5, 5)))[0]
    poles = np.diag([0.3, 1.0, 0.7, 0.99999, -0.4])
    poles[0, 2] = 0.5
    system = StateSpace(
        turn @ poles @ turn.T,
        generator.normal(size=(5, 2)),
        generator.normal(size=(2, 5)),
        np.zeros((2, 2)),
        dt=1e-4,
    )
    (A, B, C, D), slow = slow_first(system, 1e-4)
    assert slow == 2
    assert np.abs(A[:2, 2:]).max() == np.abs(A[2:, :2]).max() == 0
    z = np.exp(0.3j)
    mine = C @ np.linalg.solve(z * np.eye(5) - A, B) + D
    theirs = system.C @ np.linalg.solve(z * np.eye(5) - system.A, system.B)
    assert mine == pytest.approx(theirs, rel=1e-9)
