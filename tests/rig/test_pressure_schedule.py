"""A controller scheduled over pressure on the virtual rig: what the sensor tells, and what becomes
of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d, delayed
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, spectral_abscissa
from ambrose.law.loop import Timing, closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.file.toml import load_machine
from ambrose.model.assemble import assemble
from ambrose.rig import virtual_rig
from ambrose.rig.engine.inputs import plan, stretch
from ambrose.rig.engine.state import build
from ambrose.rig.scenario import (
    PressureChange,
    PressureSensor,
    Pulse,
    Scenario,
    SpeedChange,
    read_scenario,
    sensed,
)
from ambrose.rig.trial import simulate_linear, spin_up
from coarse import coarse

RIG = coarse("seal-rig")
ZERO = next(point for point in RIG.operation.points if point.seal_pressure == 0)
PID = pid_controller(RIG.reference, RIG)
SURGE = Scenario(
    "surge",
    0.08,
    pulses=(Pulse("f_center_x", 20.0, 0.005, 0.003),),
    pressures=(PressureChange(0.01, 1e5, 0.05),),
)
DT = 1e-4


def stiffer(factor: float) -> StateSpace:
    return StateSpace(PID.A, PID.B, factor * PID.C, factor * PID.D, PID.inputs, PID.outputs)


SCHEDULE = ScheduledSystem([0.0, 4.08e5], [PID, stiffer(1.5)], "pressure", "Pa")
Y = [f"y_{axis}" for axis in RIG.axes]


def told(scenario: Scenario) -> np.ndarray:
    return virtual_rig.run(RIG, SCHEDULE, scenario, point=ZERO).record["p_measured"]


def test_a_sensors_lag_is_that_of_its_equation():
    """T l' = p - l by the trapezoidal rule in steps of T/2000, which knows nothing of
    exponentials.
    """
    time = np.linspace(0.0, 0.3, 30001)
    knots, values = [0.0, 0.05, 0.15, 0.15, 0.2], [1e5, 1e5, 4e5, 4e5, 0.0]
    found = sensed(
        time,
        [PressureSensor(lag=0.02), PressureSensor(0.12, gain=1.1, offset=5e3, lag=0.05)],
        knots,
        values,
    )
    p, expected = np.interp(time, knots, values), np.empty(len(time))
    expected[0] = p[0]
    for k in range(1, len(time)):
        late = time[k - 1] >= 0.12 - 1e-9
        (gain, offset, T), h = ((1.1, 5e3, 0.05) if late else (1.0, 0.0, 0.02)), 1e-5
        drive = gain * (p[k] + p[k - 1]) / 2 + offset
        expected[k] = ((1 - h / 2 / T) * expected[k - 1] + h / T * drive) / (1 + h / 2 / T)
    # 20 Pa from the steps at the knots; of 4e5
    np.testing.assert_allclose(found, expected, atol=30.0)


def test_a_sensor_tells_gain_and_offset_then_sticks():
    time = np.array([0.0, 0.01, 0.0299, 0.03, 0.05, 9.0])
    sensors = [PressureSensor(0.01, gain=2.0, offset=1e3), PressureSensor(0.03, fault="stuck")]
    found = sensed(time, sensors, [0.0, 0.04], [0.0, 4e5])
    np.testing.assert_allclose(found, [0.0, 2.01e5, 5.99e5, 6.01e5, 6.01e5, 6.01e5], rtol=1e-12)


def test_the_rig_reads_the_law_at_the_measured_pressure():
    """A program that is told the pressure of every sample, against the law for ten samples each,
    and the law at rest.
    """
    program = Telling()
    ran = virtual_rig.run(RIG, program, SURGE, point=ZERO).record
    held = virtual_rig.run(RIG, SCHEDULE, SURGE, point=ZERO).record
    rest = virtual_rig.run(RIG, PID, SURGE, point=ZERO).record
    assert program.told == pytest.approx(ran["p_seal"], rel=1e-12, abs=1e-9)
    size = max(np.ptp(ran[name]) for name in Y)
    assert max(np.abs(ran[name] - held[name]).max() for name in Y) < 0.02 * size
    assert max(np.abs(ran[name] - rest[name]).max() for name in Y) > 0.1 * size


def test_members_that_are_equal_are_the_fixed_controller():
    same = ScheduledSystem([0.0, 4.08e5], [PID, PID], "pressure", "Pa")
    ran, fixed = (virtual_rig.run(RIG, law, SURGE, point=ZERO).record for law in (same, PID))
    np.testing.assert_allclose(
        ran.values, fixed.values, rtol=0, atol=1e-12 * np.abs(fixed.values).max()
    )


def test_without_a_sensor_in_the_scenario_a_pressure_beyond_the_schedule_is_refused():
    beyond = replace(SURGE, pressures=(PressureChange(0.01, 5e5, 0.05),))
    with pytest.raises(
        InvalidInput, match="the pressure is 500000 Pa, but must be between 0 and 408000 Pa"
    ):
        virtual_rig.run(RIG, SCHEDULE, beyond, point=ZERO)


@pytest.mark.parametrize(
    ("sensor", "as_if"),
    [(PressureSensor(offset=9e5), 4.08e5), (PressureSensor(offset=-9e5), 0.0)],
    ids=["above", "below"],
)
def test_a_sensor_that_errs_beyond_the_schedule_is_clamped(sensor, as_if):
    weightless = replace(RIG, gravity_direction=None)  # or its first current would be another
    ran = virtual_rig.run(
        weightless, SCHEDULE, replace(SURGE, pressure_sensors=(sensor,)), point=ZERO
    ).record
    fixed = virtual_rig.run(weightless, SCHEDULE.at(as_if), SURGE, point=ZERO).record
    size = max(np.ptp(fixed[name]) for name in Y)
    assert max(np.abs(ran[name] - fixed[name]).max() for name in Y) < 1e-9 * size
    assert ran["p_measured"] == pytest.approx(ran["p_seal"] + sensor.offset, rel=1e-12)


def test_what_is_lost_is_told_as_no_number_and_held_for_a_law():
    lost = replace(SURGE, pressure_sensors=(PressureSensor(0.03, fault="lost"),))
    program = Telling()
    ran = virtual_rig.run(RIG, program, lost, point=ZERO).record
    at = round(0.03 / DT)
    assert np.isnan(program.told[at:]).all() and not np.isnan(program.told[:at]).any()
    held = virtual_rig.run(RIG, SCHEDULE, lost, point=ZERO).record
    assert np.ptp(held["p_measured"][at:]) == 0 and held["p_measured"][-1] == pytest.approx(4e4)
    assert ran["p_seal"][-1] == pytest.approx(1e5)
    size = max(np.ptp(ran[name]) for name in Y)
    # the program holds the last as well
    assert max(np.abs(ran[name] - held[name]).max() for name in Y) < 0.02 * size


def test_noise_is_as_large_as_stated_and_the_same_for_every_stretch():
    noisy = replace(SURGE, pressure_sensors=(PressureSensor(noise=5e3),))
    first, again = told(noisy), told(noisy)
    np.testing.assert_array_equal(first, again)
    error = first - virtual_rig.run(RIG, PID, noisy, point=ZERO).record["p_seal"]
    assert np.std(error) == pytest.approx(5e3, rel=0.1)
    # a fixed law runs in one stretch
    whole = virtual_rig.run(RIG, PID, noisy, point=ZERO).record["p_measured"]
    np.testing.assert_array_equal(first, whole)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"fault": "broken"},
            'fault of the pressure sensor is \'broken\', but must be "stuck", "lost" or left out',
        ),
        ({"lag": "-1 ms"}, "lag of the pressure sensor"),
        ({"offset": "nan bar"}, "offset"),
        ({"noise": -1.0}, "noise of the pressure sensor"),
        ({"time": "3 s"}, "the time of a pressure sensor is 3"),
        ({"gain": "2 mm"}, "gain"),
    ],
)
def test_sensors_that_cannot_be_are_refused(table, message):
    with pytest.raises(InvalidInput, match=message):
        read_scenario({"name": "x", "duration": 1.0, "pressure_sensor": [table]})


def test_sensors_out_of_order_are_refused():
    with pytest.raises(InvalidInput, match="not in the order of their times"):
        Scenario("x", 1.0, pressure_sensors=(PressureSensor(0.5), PressureSensor(0.2)))


def test_a_file_may_speak_in_bar_and_of_the_machine():
    table = {
        "time": "20 ms",
        "offset": "10 % of top pressure",
        "noise": "5 mbar",
        "lag": "2 ms",
        "gain": 1.02,
    }
    (sensor,) = (
        read_scenario({"name": "x", "duration": 1.0, "pressure_sensor": [table]})
        .on(RIG)
        .pressure_sensors
    )
    assert sensor == PressureSensor(0.02, 1.02, 4.08e4, 0.002, 500.0)


def test_a_schedule_over_pressure_does_not_care_for_the_speed():
    turning = Scenario("x", 0.03, speed=10.0, speed_changes=(SpeedChange(0.0, 60.0, 0.02),))
    ran, fixed = (virtual_rig.run(RIG, law, turning, point=ZERO).record for law in (SCHEDULE, PID))
    np.testing.assert_array_equal(ran.values, fixed.values)


def test_the_linear_loop_follows_the_pressure_as_the_rig_does():
    """Without weight and for small motion; the sampled law with its delay in both."""
    strong = replace(SURGE, pressures=(PressureChange(0.005, 4e5, 0.02),))
    weightless = replace(RIG, gravity_direction=None)
    members = [delayed(c2d(system, DT, "tustin"), 1) for system in SCHEDULE.systems]
    sampled = ScheduledSystem(SCHEDULE.grid, members, "pressure", "Pa")
    linear = spin_up(assemble(weightless, ZERO), sampled, strong, bending_modes=3)
    rig = virtual_rig.run(weightless, SCHEDULE, strong, point=ZERO).record
    still = simulate_linear(
        assemble(weightless, ZERO), PID, replace(strong, pressures=()), Timing(DT, 1)
    ).record
    size = max(np.ptp(rig[name]) for name in Y)
    assert linear.outcome == "completed" and linear.speed_error < 2e-3
    assert max(np.abs(linear.record[name] - rig[name]).max() for name in Y) < 0.01 * size
    assert max(np.abs(still[name] - rig[name]).max() for name in Y) > 0.1 * size
    np.testing.assert_allclose(linear.record["p_seal"], rig["p_seal"], atol=1e-6)


def test_a_fixed_controller_meets_a_changing_pressure_in_the_linear_loop_too():
    """The pole that is told is the rightmost of all pressures met: at twice the nominal one the PID
    does not hold.
    """
    up = replace(SURGE, pressures=(PressureChange(0.01, 4.08e5, 0.05),))
    trace = simulate_linear(assemble(RIG, ZERO), PID, up)
    assert trace.pole.real > 0 and "at 408000 Pa" in trace.text
    assert spectral_abscissa(
        closed_loop(assemble(RIG, replace(ZERO, seal_pressure=4.08e5)), PID)
    ) == pytest.approx(trace.pole.real, rel=1e-2)


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        (
            replace(SURGE, speed=10.0, to_speed=60.0),
            "changes of pressure, which a linear model does not have",
        ),
        (
            replace(SURGE, pressure_sensors=(PressureSensor(lag=0.1),)),
            "a pressure sensor, which a linear model does not have",
        ),
    ],
)
def test_what_the_linear_loop_cannot_follow(scenario, message):
    with pytest.raises(InvalidInput, match=message):
        simulate_linear(assemble(RIG, ZERO), SCHEDULE, scenario)


def test_the_seals_are_read_alike_whatever_the_stretch():
    """A gas seal by bulk flow while the pressure bends within a stretch; and no more solutions of
    it for shorter ones.
    """
    machine = load_machine("turboexpander")
    scenario = Scenario(
        "x", 0.02, pressures=(PressureChange(0.0, 1e6, 0.004), PressureChange(0.0123, 2e6, 0.005))
    )
    task = plan(build(machine, machine.operation.nominal, 1), scenario, DT, 0)
    whole = stretch(task, 0, 200).seal
    parts = np.concatenate(
        [
            np.broadcast_to(stretch(task, k, 10).seal, (11, *whole.shape[1:]))[:10]
            for k in range(0, 200, 10)
        ]
    )
    np.testing.assert_allclose(parts, whole[:200], rtol=1e-12)


class Telling:
    """A program in Python: the schedule sampled member by member, linear between, at what it was
    told last.
    """

    sample_time = DT
    delay = 1
    parameter = "pressure"

    def __init__(self) -> None:
        members = [c2d(system, DT, "tustin") for system in SCHEDULE.systems]
        self.law, self.value = ScheduledSystem(SCHEDULE.grid, members, "pressure", "Pa"), 0.0
        self.told: list[float] = []
        self.x = np.zeros(0)

    @property
    def system(self) -> StateSpace:
        return self.law.at(self.value)

    def __call__(self, value: float) -> StateSpace:
        return self.law.at(value)

    def schedule(self, value: float) -> None:
        self.told.append(value)
        self.value = self.value if np.isnan(value) else value

    def begin(self, states: np.ndarray) -> None:
        self.x = states

    def step(self, errors: np.ndarray) -> np.ndarray:
        K = self.system
        u = K.C @ self.x + K.D @ errors
        self.x = K.A @ self.x + K.B @ errors
        return u


def test_the_machine_of_many_bearings_runs_such_a_schedule():
    train = load_machine("three-bearing-train")
    law = pid_controller(train.reference, train)
    double = ScheduledSystem([0.0, 2e6], [law, law], "pressure", "Pa")
    still = next(point for point in train.operation.points if point.label == "rest")
    scenario = Scenario("x", 0.004, pressures=(PressureChange(0.001, 1e6, 0.002),))
    ran, fixed = (
        virtual_rig.run(train, item, scenario, point=still).record for item in (double, law)
    )
    np.testing.assert_allclose(
        ran.values, fixed.values, rtol=0, atol=1e-12 * np.abs(fixed.values).max()
    )
