"""Supervision of a schedule: what is believed, who is in charge, and that a change does not
push.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.law.pid import pid_controller
from ambrose.law.supervision import (
    Fault,
    Limits,
    State,
    Supervisor,
    supervised,
    supervision_limits,
    tracking_gain,
)
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import PressureChange, PressureSensor, Pulse, Scenario
from ambrose.rig.trial import simulate_scenario
from coarse import coarse

RIG = coarse("seal-rig")
ZERO = next(point for point in RIG.operation.points if point.seal_pressure == 0)
PID = pid_controller(RIG.reference, RIG)
TOP, DT = 4.08e5, 1e-4
SCHEDULE = ScheduledSystem(
    [0.0, TOP],
    [PID, StateSpace(PID.A, PID.B, 1.5 * PID.C, 1.5 * PID.D, PID.inputs, PID.outputs)],
    "pressure",
    "Pa",
)
LIMITS = Limits(
    0.0, TOP, 0.05 * TOP, rate=80e5, noise=0.01 * TOP, band=0.1 * TOP, dwell=0.01, fade=0.002
)
SURGE = Scenario(
    "surge",
    0.08,
    pulses=(Pulse("f_center_x", 20.0, 0.005, 0.003),),
    pressures=(PressureChange(0.01, 1e5, 0.05),),
)


def followed(readings, limits=LIMITS, estimate=(math.nan, math.inf)):
    supervisor = Supervisor(limits, DT)
    return supervisor, [(supervisor.follow(told, *estimate), supervisor.fault) for told in readings]


@pytest.mark.parametrize(
    ("bad", "fault"),
    [
        (math.nan, Fault.LOST),
        (-math.inf, Fault.LOST),
        (5e5, Fault.RANGE),
        (-1e5, Fault.RANGE),
        (3e5, Fault.JUMP),
    ],
)
def test_every_bad_reading_puts_the_fixed_controller_in_charge_at_once(bad, fault):
    supervisor, seen = followed([1e5, 1e5, bad])
    assert (
        seen[1][0] is State.SCHEDULED
        and seen[2] == (State.FALLING_BACK, fault)
        and supervisor.value == 1e5
    )


def test_a_lost_reading_comes_back_after_the_dwell_time_and_a_fault_in_it_begins_it_anew():
    _, seen = followed([1e5] * 5 + [math.nan] * 3 + [1e5] * 60 + [math.nan] + [1e5] * 200)
    states = [state for state, _ in seen]
    assert states[5] is State.FALLING_BACK and states[5 + 20] is State.FIXED  # fade: 20 samples
    again = states.index(State.RETURNING)
    # dwell: 100 good samples
    assert again == 69 + 100 - 1 and states[again + 20] is State.SCHEDULED


def test_what_a_pressure_may_do_while_its_reading_is_lost_is_no_jump():
    for told, back in ((1e5 + 80e5 * 100 * DT, State.SCHEDULED), (3e5, State.FIXED)):
        assert followed([1e5] * 5 + [math.nan] * 100 + [told] * 300)[1][-1][0] is back


def test_an_offset_that_stays_is_not_forgiven_without_an_estimate_that_agrees():
    readings = [1e5] * 5 + [2e5] * 500
    assert followed(readings)[1][-1] == (State.FIXED, Fault.NONE)
    supervisor, _ = followed(readings)
    for _ in range(200):
        supervisor.follow(2e5, 2.1e5, 0.05 * TOP)
    assert supervisor.state is State.SCHEDULED and supervisor.value == pytest.approx(2.1e5)


def test_an_estimate_trims_within_the_band_only_and_beyond_it_the_fixed_one_takes_over():
    supervisor, seen = followed([1e5] * 3, estimate=(1e5 + 0.12 * TOP, 0.05 * TOP))
    assert seen[-1][0] is State.SCHEDULED and supervisor.value == pytest.approx(1e5 + 0.1 * TOP)
    assert followed([1e5] * 3, estimate=(1e5 + 0.2 * TOP, 0.05 * TOP))[1][0] == (
        State.FALLING_BACK,
        Fault.DIVERGED,
    )
    # says little: neither trims nor accuses
    supervisor, seen = followed([1e5] * 3, estimate=(1e5 + 0.2 * TOP, 0.5 * TOP))
    assert seen[-1][0] is State.SCHEDULED and supervisor.value == 1e5


def test_a_stuck_reading_is_found_after_its_time_and_a_ramp_at_its_rate_is_none():
    _, seen = followed([1e5] * 102, replace(LIMITS, stuck=0.01))
    assert [fault for _, fault in seen].index(Fault.STUCK) == 100
    assert followed(np.arange(0.0, TOP, 0.9 * 80e5 * DT))[1][-1][0] is State.SCHEDULED


def test_who_waits_follows_the_currents_that_act():
    law = c2d(PID, DT, method="tustin")
    closed = law.A - tracking_gain(law.A, law.B, law.C) @ law.C
    assert np.abs(np.linalg.eigvals(closed)).max() < 1
    rng, x = np.random.default_rng(0), np.ones(law.n_states)
    L, other = tracking_gain(law.A, law.B, law.C), np.zeros(law.n_states)
    for _ in range(20000):
        e = 1e-6 * rng.standard_normal(law.D.shape[1])
        gap = law.C @ (x - other)
        other, x = law.A @ other + law.B @ e + L @ gap, law.A @ x + law.B @ e
    assert np.abs(law.C @ (x - other)).max() < 1e-6 * np.abs(law.C).sum()


def test_with_a_good_reading_the_program_is_the_schedule_and_a_lost_one_does_not_lose_the_rotor():
    weightless = replace(RIG, gravity_direction=None)
    program = supervised(
        SCHEDULE, PID, weightless, DT, supervision_limits(SCHEDULE, weightless, 80e5)
    )
    told = simulate_scenario(
        weightless, SCHEDULE, SURGE, point=ZERO, rate=1 / DT, fallback=PID, pressure_rate=80e5
    )
    alone = virtual_rig.run(weightless, SCHEDULE, replace(SURGE, sample_time=DT), point=ZERO)
    for axis in RIG.axes:  # the schedule alone is read every ten samples
        peak = np.abs(alone.record[f"y_{axis}"]).max()
        np.testing.assert_allclose(
            told.record[f"y_{axis}"], alone.record[f"y_{axis}"], atol=0.01 * peak + 1e-12
        )
    assert told.outcome == "completed" and "schedule throughout" in told.text
    lost = replace(SURGE, pressure_sensors=(PressureSensor(0.03, fault="lost"),), sample_time=DT)
    trace = virtual_rig.run(weightless, program, lost, point=ZERO)
    assert trace.outcome == "completed" and [item[1] for item in program.changes] == [
        State.FALLING_BACK,
        State.FIXED,
    ]
    assert (
        program.changes[0][0] == 300
        and program.words() == "fixed from 0.03 s (the reading is lost)"
    )


def test_currents_do_not_jump_at_the_change_with_the_rotors_weight_on_them():
    """A hard switch to a controller that did not follow has no current for the weight."""
    steps = {}
    scenario = Scenario(
        "lost", 0.06, pressure_sensors=(PressureSensor(0.03, fault="lost"),), sample_time=DT
    )
    for name, limits, tracking in (
        ("hard", replace(LIMITS, fade=0.0), False),
        ("bumpless", LIMITS, True),
    ):
        program = supervised(SCHEDULE, PID, RIG, DT, limits, tracking=tracking)
        trace = virtual_rig.run(RIG, program, scenario, point=ZERO)
        u = np.array([trace.record[f"u_{axis}"] for axis in RIG.axes])
        steps[name] = np.abs(np.diff(u[:, 250:350])).max()
    assert steps["bumpless"] < 0.1 * steps["hard"]


def test_a_reading_that_is_lost_from_the_start_moves_no_levitated_rotor_far():
    scenario = Scenario(
        "lost", 0.05, pressure_sensors=(PressureSensor(0.0, fault="lost"),), sample_time=DT
    )
    program = supervised(SCHEDULE, PID, RIG, DT)
    trace = virtual_rig.run(RIG, program, scenario, point=ZERO)
    assert program.changes[0][:2] == (0, State.FALLING_BACK)
    assert max(np.abs(trace.record[f"y_{axis}"]).max() for axis in RIG.axes) < 5e-6


def test_refusals():
    with pytest.raises(InvalidInput, match="--pressures-bar"):
        supervised(PID, PID, RIG, DT)
    with pytest.raises(InvalidInput, match="scheduled itself"):
        supervised(SCHEDULE, SCHEDULE, RIG, DT)
    with pytest.raises(InvalidInput, match="dwell"):
        replace(LIMITS, dwell=0.0)
    with pytest.raises(InvalidInput, match="rate"):
        replace(LIMITS, rate=0.0)
    with pytest.raises(InvalidInput, match="fallback is given, but must be left out with linear"):
        simulate_scenario(RIG, SCHEDULE, SURGE, linear=True, fallback=PID)
