"""The block of a scheduled controller in Python: its law, its bounds, its answers to speeds good
and bad.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.signal

import code_driver as driver
import schedule_driver as schedules
from ambrose import StateSpace
from ambrose.code.block.block import build_block
from ambrose.code.block.run import (
    BEHIND,
    CLAMPED,
    FAULT,
    HELD,
    LIMITED,
    TOLD,
    follow_told,
    run_of,
    vectors_of,
)
from ambrose.code.block.scheduled import bound_motion
from ambrose.code.sampled import deploy, deploy_scheduled
from ambrose.core.checks import InvalidInput, NumericalFailure, UnstableSystem
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from schedule_driver import (
    CURRENT,
    DT,
    ERROR,
    GRID,
    block_of,
    gain_schedule,
    small_schedule,
    two_states,
)


@pytest.fixture(scope="module")
def block():
    return block_of(small_schedule())


def quiet(block, count=1500, seed=1):
    """Errors that limit nothing."""
    share = 0.9 * (block.current_limit / block.raw_limit).min()
    return (
        share
        * block.error_limit
        * np.random.default_rng(seed).uniform(-1, 1, (count, len(block.inputs)))
    )


def apart(found, expected):
    return np.abs(found - expected).max() / np.abs(expected).max()


@pytest.mark.parametrize("speed", GRID)
def test_at_a_grid_point_it_is_the_fixed_block_of_that_point(block, speed):
    fixed = build_block(deploy(small_schedule().at(speed), DT, DT, force=True), "k", ERROR, CURRENT)
    e = quiet(block)
    run = run_of(block, e, np.full(len(e), speed))
    assert not run.status.any()
    assert apart(run.currents, run_of(fixed, e).currents) < 1e-11
    K = c2d(small_schedule().at(speed), DT, "tustin")
    _, dense, _ = scipy.signal.dlsim((K.A, K.B, K.C, K.D, DT), e)
    assert apart(run.currents, dense) < 1e-11


@pytest.mark.parametrize("speed", [101.0, 175.0, 299.0, 450.0, 599.9])
def test_between_it_is_the_sampled_matrices_in_between(block, speed):
    sampled = deploy_scheduled(small_schedule(), DT, DT, force=True).sampled
    fixed = build_block(deploy(sampled.at(speed), DT, DT, force=True), "k", ERROR, CURRENT)
    e = quiet(block)
    run = run_of(block, e, np.full(len(e), speed))
    assert apart(run.currents, run_of(fixed, e).currents) < 1e-10


def test_along_a_sweep_it_is_the_time_varying_system(block):
    """Against the plain recursion with the frozen system of every sample."""
    e = quiet(block)
    v = np.linspace(GRID[0], GRID[-1], len(e))
    run = run_of(block, e, v)
    x, expected = np.zeros(3), []
    for row, speed in zip(e, v, strict=True):
        K = block.at(speed)
        expected.append(K.C @ x + K.D @ row)
        x = K.A @ x + K.B @ row
    assert not run.status.any()
    assert apart(run.currents, np.array(expected)) < 1e-11
    assert (run.schedule == v).all()


def test_it_is_continuous_at_the_grid_points(block):
    e = quiet(block, 400)
    for speed in GRID[1:-1]:
        below, at, above = (
            run_of(block, e, np.full(400, v)).currents
            for v in (np.nextafter(speed, 0), speed, np.nextafter(speed, 1e4))
        )
        assert apart(below, at) < 1e-12
        assert apart(above, at) < 1e-12


def test_how_far_it_is_from_the_sampled_interpolation():
    """Second order in the spacing: half the spacing, a quarter of the distance."""
    wide = deploy_scheduled(small_schedule(), DT, force=True)
    fine = ScheduledSystem(
        middles := np.sort([*GRID, *np.add(GRID[1:], GRID[:-1]) / 2]),
        [small_schedule().at(v) for v in middles],
    )
    narrow = deploy_scheduled(fine, DT, force=True)
    assert 1e-3 < wide.deviation < 0.1
    assert narrow.deviation == pytest.approx(wide.deviation / 4, rel=0.15)
    assert GRID[0] < wide.deviation_at < GRID[-1]


def test_outside_the_range_it_is_the_end_of_it(block):
    e = quiet(block, 300)
    for beyond, end in ((99.0, 100.0), (-50.0, 100.0), (601.0, 600.0), (1200.0, 600.0)):
        run = run_of(block, e, np.full(300, beyond))
        assert (run.status == CLAMPED).all()
        assert (run.currents == run_of(block, e, np.full(300, end)).currents).all()


def test_a_missing_speed_is_held_then_a_fault():
    block = block_of(small_schedule(), hold_samples=3)
    e = quiet(block, 12)
    v = np.full(12, 400.0)
    v[4:10] = [np.nan, np.inf, 1201.0, np.nan, -np.inf, 1e300]
    run = run_of(block, e, v)
    assert run.status.tolist() == [0] * 4 + [HELD | TOLD] * 3 + [HELD | TOLD | FAULT] * 3 + [0] * 2
    assert (run.currents == run_of(block, e, np.full(12, 400.0)).currents).all()
    blind = run_of(block, e, np.full(12, np.nan))
    assert (blind.schedule == GRID[0]).all()
    assert blind.status[-1] == HELD | TOLD | FAULT


def test_the_schedule_follows_no_faster_than_it_may():
    block = block_of(small_schedule(), rate_limit=1e5)  # 10 rad/s a sample
    place, status = follow_told(
        block, np.array([np.nan, 300.0, 325.0, 325.0, 325.0, 325.0, 50.0, 50.0, np.nan])
    )
    assert place == pytest.approx([100.0, 300.0, 310.0, 320.0, 325.0, 325.0, 315.0, 305.0, 295.0])
    assert [(s & BEHIND) > 0 for s in status] == [
        False,
        False,
        True,
        True,
        False,
        False,
        True,
        True,
        True,
    ]
    assert [(s & CLAMPED) > 0 for s in status] == [False] * 6 + [True] * 3


def test_states_stay_within_one_at_frozen_speeds(block):
    worst = 0.0
    for speed in (*GRID, 130.0, 270.0, 500.0):
        frozen = build_block(deploy(block.at(speed), DT, DT, force=True), "k", ERROR, CURRENT)
        e, valid = driver.adversarial(frozen, 2000, seed=int(speed))
        run = run_of(block, e, np.full(len(e), speed), valid)
        worst = max(worst, run.largest.max())
    assert 0.1 < worst <= 1


def test_states_stay_within_their_proved_bound_while_the_speed_jumps(block):
    assert block.motion.proved
    rng = np.random.default_rng(4)
    e = block.error_limit * rng.choice([-1.0, 1.0], (200, 2))
    run = run_of(block, np.repeat(e, 50, axis=0), rng.choice(GRID, 10_000))
    assert ((run.status & LIMITED) > 0).mean() > 0.3
    assert (run.largest <= block.motion.states).all()


def switching(A, count=2):
    """bound_motion() of matrices without inputs to speak of."""
    zero = np.zeros((count, 2, 1))
    return bound_motion(
        np.array(A) - np.eye(2),
        zero + 1,
        np.zeros((count, 1, 2)),
        np.zeros((count, 1, 1)),
        zero,
        np.ones(2),
        [(0, 1)],
    )


def test_no_bound_is_claimed_where_motion_can_destabilise():
    """Each is stable; switched every sample, their product has a pole at 3.6."""
    A = [[[0.5, 1.8], [0.0, 0.5]], [[0.5, 0.0], [1.8, 0.5]]]
    assert np.abs(np.linalg.eigvals(np.array(A[0]) @ A[1])).max() > 3
    found = switching(A)
    assert not found.proved
    assert np.isinf(found.states).all()


def test_a_common_function_that_no_single_point_gives_is_found():
    """Lyapunov's solution of the first matrix grows by 1.57 in a sample of the second one; matrix
    inequalities find another.
    """
    A = [[[0.9, 0.35], [0.0, 0.2]], [[0.9, -0.35], [0.0, 0.2]]]
    found = switching(A)
    assert found.proved
    rng = np.random.default_rng(0)
    x = np.zeros(2)
    largest = np.zeros(2)
    for pick in rng.integers(0, 2, 5000):
        x = np.array(A[pick]) @ x + rng.choice([-1.0, 1.0]) * np.ones(2)
        largest = np.maximum(largest, np.abs(x))
    assert (largest <= found.states).all()
    assert (largest > found.states / 50).all()


def test_the_integrator_does_not_wind_up():
    block = block_of(two_states())
    e = np.concatenate([np.full((6000, 1), ERROR), np.full((1000, 1), -1e-5)])
    v = np.linspace(GRID[0], GRID[-1], len(e))
    limited = (run_of(block, e, v).status & LIMITED) > 0
    naive = (run_of(replace(block, unwind=0 * block.unwind), e, v).status & LIMITED) > 0
    assert limited[2000:6000].all()
    assert not limited[6000 + 100 :].any()
    assert naive[6000:].all()


def test_transfer_is_planned_where_it_converges(block):
    assert block.transfers
    assert block_of(two_states()).transfers
    assert not block_of(gain_schedule()).transfers


def test_vectors_meet_every_branch(block):
    status = np.bitwise_or.reduce(vectors_of(block_of(small_schedule(), rate_limit=1e4)).status)
    assert status == HELD | FAULT | LIMITED | CLAMPED | TOLD | BEHIND


def test_states_decay_to_zero(block):
    e = np.zeros((12_000, 2))
    e[0] = ERROR
    fast = replace(block, increment=block.increment - 0.05 * np.eye(3))
    assert (run_of(fast, e, np.full(len(e), 200.0)).states == 0).all()


def test_an_unstable_point_is_refused():
    middle = StateSpace([[5.0]], [[1.0]], [[1.0]], [[0.0]], ["err_x"], ["u_x"])
    ends = StateSpace([[-50.0]], [[1.0]], [[1.0]], [[0.0]], ["err_x"], ["u_x"])
    schedule = ScheduledSystem([1.0, 2.0, 3.0], [ends, middle, ends])
    with pytest.raises(UnstableSystem, match="unstable at 2 rad/s"):
        deploy_scheduled(schedule, DT)
    blind = StateSpace([[0.0]], [[1.0]], [[0.0]], [[1.0]], ["err_x"], ["u_x"])
    with pytest.raises(
        NumericalFailure,
        match=r"no anti-windup gain was found at 1 rad/s .*: an integrator that no output sees",
    ):
        block_of(ScheduledSystem([1.0, 2.0], [blind, blind]))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"rate_limit": 0.0}, "speed_rate is 0.0, but must be positive"),
        ({"rate_limit": np.nan}, "speed_rate"),
        ({"told_limit": 599.0}, "speed_limit is 599 rad/s, but must be at least 600 rad/s"),
        ({"told_limit": np.nan}, "speed_limit"),
        ({"hold_samples": -1}, "hold_samples is -1"),
        ({"windup_time": 0.0}, "windup_time"),
        ({"name": "a b"}, "must be a C identifier"),
    ],
)
def test_settings_that_mean_nothing(settings, message):
    with pytest.raises(InvalidInput, match=message):
        block_of(small_schedule(), **settings)


def test_shapes_are_checked(block):
    with pytest.raises(InvalidInput, match="shape of errors"):
        run_of(block, np.zeros((3, 1)), np.zeros(3))
    with pytest.raises(InvalidInput, match=r"shape of the measured parameters \(speed\)"):
        run_of(block, np.zeros((3, 2)), np.zeros(4))


def test_grid_points_that_single_precision_cannot_tell_apart():
    systems = [small_schedule().at(v) for v in (100.0, 300.0)]
    block = block_of(ScheduledSystem([300.0, 300.0 + 1e-6], systems))
    with pytest.raises(InvalidInput, match="apart in single precision"):
        block.single()


def test_only_speed_and_pressure_can_be_scheduled_over():
    schedule = replace(small_schedule(), parameter="bias", unit="A")
    with pytest.raises(
        InvalidInput,
        match=r"the scheduling parameter is bias \[A\], but must be speed \[rad/s\] or pressure",
    ):
        deploy_scheduled(schedule, DT)
    with pytest.raises(InvalidInput, match="no schedule"):
        deploy_scheduled(small_schedule().at(100.0), DT)


def test_a_sampled_schedule_is_taken_as_it_is():
    sampled = deploy_scheduled(small_schedule(), DT, force=True).sampled
    again = deploy_scheduled(sampled, DT, force=True)
    assert again.deviation == 0
    assert schedules.apart_in_gain(again.sampled, small_schedule(), DT) < 1e-10
    with pytest.raises(InvalidInput, match="it is sampled already"):
        deploy_scheduled(sampled, 2 * DT, force=True)
    with pytest.raises(InvalidInput, match="the sample rate"):
        deploy_scheduled(small_schedule(), 5e-3, force=True)
