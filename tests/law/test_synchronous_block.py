"""law/synchronous_block.py: the angle through run-ups, the states, what a fault may do."""

import numpy as np
import pytest

from ambrose.core.synchronous import largest_step
from ambrose.law.synchronous_block import (
    BlockFault,
    BlockLaw,
    BlockState,
    SynchronousBlock,
    SynchronousLaw,
    key_phasor,
)

DT = 1e-4


def law(**changes):
    given = {
        "speeds": np.array([100.0, 400.0]),
        "drive": np.array([np.eye(2), np.eye(2)], complex),
        "band": (200.0, 400.0),
        "gain": 20.0,
        "limit": np.full(2, 1e-3),
        "hysteresis": 5.0,
        "hold": 0.05,
        "release": 0.02,
        "ramp": 0.05,
    }
    return SynchronousLaw((BlockLaw(**(given | changes)),), DT, 500.0)


def turned(times, speeds, duration, **changes):
    """A block fed with the 1x signal of a rotor, y = 1e-5 (cos, sin) theta: c, angle errors, states
    per sample.
    """
    n = int(duration / DT)
    t = np.arange(n) * DT
    w = np.interp(t, times, speeds)
    theta = np.concatenate([[0], np.cumsum((w[1:] + w[:-1]) / 2 * DT)])
    pulses = key_phasor(times, speeds, DT, n)
    for start, end in changes.pop("lost", ()):
        pulses[(t >= start) & (t < end)] = -1
    contact = changes.pop("contact", (9, 9))
    off = changes.pop("off", (9, 9))
    block = SynchronousBlock(law(**changes))
    c = np.empty((n, 2))
    error = np.empty(n)
    states = []
    y = 1e-5 * np.column_stack([np.cos(theta), np.sin(theta)])
    for k in range(n):
        c[k] = block.step(
            pulses[k],
            -y[k],
            contact=contact[0] <= t[k] < contact[1],
            enabled=not off[0] <= t[k] < off[1],
        )
        error[k] = (block.angle.theta - theta[k] + np.pi) % (2 * np.pi) - np.pi
        states.append(block.states[0])
    return t, y, c, error, states, block


def test_the_angle_follows_a_run_up_from_one_pulse_a_turn():
    _, _, _, error, _, _ = turned([0, 1], [150.0, 350.0], 1.0)
    assert np.abs(error[2000:]).max() < 2e-3  # rad, with 200 rad/s^2
    still = turned([0, 1], [250.0, 250.0], 0.5)[3]
    assert np.abs(still[1000:]).max() < 1e-6


def test_cosine_and_sine_of_the_table_are_exact_to_1e9():
    block = SynchronousBlock(law())
    for theta in np.linspace(0, 2 * np.pi, 1001):
        block.angle.theta = theta
        for n in (1, 2, 3):
            assert block.turn(n) == pytest.approx((np.cos(n * theta), np.sin(n * theta)), abs=1e-9)


def test_an_open_block_takes_the_whole_signal_with_its_time_constant():
    """e = y - c with no loop around it: a' = eps/2 (A - a) for the forward amplitude, both
    directions alike.
    """
    t, y, c, _, states, _ = turned([0, 1], [300.0, 300.0], 1.0)
    left = np.abs(y - c).max(axis=1)
    assert states[-1] is BlockState.ON
    assert left[-500:].max() < 1e-3 * 1e-5
    begun = t[states.index(BlockState.ON)] + 0.05  # when the ramp is over
    first, later = (left[(t >= begun + x) & (t < begun + x + 0.02)].max() for x in (0.0, 0.1))
    assert np.log(first / later) / 0.1 == pytest.approx(20 / 2, rel=0.1)


def test_states_on_hold_release_and_back():
    t, _, c, _, states, block = turned([0, 2], [300.0, 300.0], 2.0, lost=[(0.8, 1.2)], hold=0.1)
    at = lambda x: states[int(x / DT)]  # noqa: E731
    assert at(0.0) is BlockState.OFF
    assert at(0.7) is BlockState.ON
    assert at(0.85) is BlockState.HOLD
    assert at(1.0) is BlockState.RELEASE
    assert at(1.9) is BlockState.ON
    held = np.abs(c[(t > 0.83) & (t < 0.9)]).max(axis=0)
    assert held == pytest.approx([1e-5, 1e-5], rel=0.05)  # keeps feeding forward
    assert np.abs(c[(t > 1.15) & (t < 1.2)]).max() < 1e-7  # decayed, never reset
    assert block.running[0].fault == BlockFault.NONE


@pytest.mark.parametrize(
    "change", [{"contact": (0.6, 0.62)}, {"off": (0.6, 0.62)}, {"lost": [(0.6, 0.75)]}]
)
def test_no_sample_steps_farther_than_the_bound(change):
    """|dc| <= eps Ts |T| |e| + |a| W Ts, through faults, release and return."""
    times, speeds = [0, 1.5], [250.0, 350.0]
    _, y, c, _, _, _ = turned(times, speeds, 1.5, **change)
    step = np.abs(np.diff(c, axis=0)).max(axis=1)
    error = np.abs(y - c).max(axis=1)[:-1]
    size = np.abs(c).max() * 1.02
    # the angle's correction at a pulse, and a release, turn c as well
    slack = np.abs(c).max() * (2e-3 + DT / 0.02)
    bound = np.array([largest_step(20.0, DT, 1.0, np.sqrt(2) * e, size, 350.0) for e in error])
    assert (step <= bound + slack).all()


def test_the_band_has_a_hysteresis_and_the_table_no_bump():
    drive = np.array([np.eye(2), 2j * np.eye(2)], complex)
    t, _, _, _, states, _ = turned([0, 1, 2], [150.0, 300.0, 150.0], 2.0, drive=drive, gain=2.0)
    on = [x for x, s in zip(t, states, strict=True) if s is BlockState.ON]
    speed = np.interp([on[0], on[-1]], [0, 1, 2], [150.0, 300.0, 150.0])
    assert speed[0] == pytest.approx(205.0, abs=3)
    assert speed[1] == pytest.approx(200.0, abs=3)


def test_an_amplitude_at_its_limit_is_projected_and_let_go():
    _, _, c, _, states, _ = turned([0, 1], [300.0, 300.0], 1.0, limit=np.full(2, 4e-6))
    assert np.abs(c).max() <= 4e-6 * (1 + 1e-9)
    assert {BlockState.HOLD, BlockState.RELEASE} <= set(states)


def test_a_period_that_no_run_up_explains_is_a_fault():
    block = SynchronousBlock(law())
    seen = BlockFault.NONE
    for k in range(6000):
        pulse = 0.0 if (k % 209 == 0 and k < 4000) or (k >= 4000 and k % 120 == 0) else -1.0
        block.step(pulse, np.zeros(2))
        seen |= block.running[0].fault
    assert seen & BlockFault.JUMP


def test_two_harmonics_take_their_own_parts():
    n, w = 20000, 300.0
    t = np.arange(n) * DT
    pulses = key_phasor([0, 9], [w, w], DT, n)
    one, two = law().blocks[0], law(harmonic=2, gain=15.0).blocks[0]
    block = SynchronousBlock(SynchronousLaw((one, two), DT, 500.0))
    y = 1e-5 * np.column_stack([np.cos(w * t), np.sin(w * t)]) + 4e-6 * np.column_stack(
        [np.cos(2 * w * t), np.cos(2 * w * t)]
    )
    left = np.array([y[k] - block.step(pulses[k], -y[k]) for k in range(n)])
    assert np.abs(block.amplitudes()[0]) == pytest.approx([1e-5, 1e-5], rel=0.01)
    assert np.abs(block.amplitudes()[1]) == pytest.approx([4e-6, 4e-6], rel=0.01)
    assert np.abs(left[-2000:]).max() < 1e-8
