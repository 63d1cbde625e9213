"""Run-ups: interpolated plants against plants assembled at every speed, and how steps are
measured.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, select
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record
from ambrose.rig.scenario import Pulse, Scenario
from ambrose.rig.trace import Trace
from ambrose.rig.trial import loops_along, spin_up, steps
from coarse import coarse

RUN_UP = Scenario(
    name="short",
    duration=0.2,
    speed=400.0,
    to_speed=900.0,
    pulses=(Pulse("f_A_zeta", amplitude=50.0, duration=0.05, every=0.1),),
)


@pytest.fixture(scope="module")
def plant():
    machine = coarse("turboexpander")
    point = next(p for p in machine.operation.points if p.label.startswith("140 Hz"))
    return assemble(machine, point)


@pytest.fixture(scope="module")
def controller(plant):
    return pid_synthesis(plant).controller


def test_between_its_points_the_loop_is_that_of_the_plant_assembled_there(plant, controller):
    """The oracle interpolates nothing; 9 points over this range are enough for 1 % of the largest
    response.
    """
    loop_at = loops_along(plant, controller, 400.0, 900.0, bending_modes=1, points=9)
    omega = np.geomspace(10, 5000, 60)
    for speed in (430.0, 655.0, 880.0):
        here = replace(plant, point=replace(plant.point, speed=speed))
        systems = loop_at(speed), closed_loop(free_mode_reduction(here, 1), controller)
        found, wanted = (
            frequency_response(select(s, ["f_A_zeta"], ["y_A_zeta", "u_B_eta"]), omega).values
            for s in systems
        )
        assert (np.abs(found - wanted).max(axis=0) < 0.01 * np.abs(wanted).max(axis=0)).all()


def test_states_mean_the_same_at_all_speeds(plant, controller):
    """Frozen at one speed, the interpolated loop is that of the plant there; A moves smoothly, not
    by its own scaling.
    """
    loop_at = loops_along(plant, controller, 400.0, 900.0, bending_modes=1, points=3)
    here = replace(plant, point=replace(plant.point, speed=650.0))
    direct = closed_loop(free_mode_reduction(here, 1), controller)
    np.testing.assert_allclose(
        loop_at(650.0).A, direct.A, rtol=1e-9, atol=1e-9 * np.abs(direct.A).max()
    )
    np.testing.assert_allclose(loop_at(450.0).C, loop_at(850.0).C, rtol=1e-13)


def test_a_scheduled_controller_is_taken_at_the_speed_of_the_moment(plant, controller):
    """A schedule of equal members is the fixed controller; one that is only wrong where the run
    never goes does no harm.
    """
    broken = StateSpace(
        controller.A,
        controller.B,
        -controller.C,
        -controller.D,
        controller.inputs,
        controller.outputs,
    )
    schedule = ScheduledSystem([300.0, 1000.0, 1100.0], [controller, controller, broken])
    fixed, moving = (
        spin_up(plant, K, RUN_UP, bending_modes=0, points=5) for K in (controller, schedule)
    )
    np.testing.assert_allclose(moving.record.values, fixed.record.values, rtol=1e-9, atol=1e-15)
    with pytest.raises(InvalidInput, match=r"the speed is .* but must be between 300 and 500"):
        spin_up(
            plant,
            ScheduledSystem([300.0, 500.0], [controller] * 2),
            RUN_UP,
            bending_modes=0,
            points=5,
        )


def _trace(y: np.ndarray, rate: float) -> Trace:
    record = Record("test", rate, ("y_A_zeta",), ("m",), y[None], OperatingPoint())
    return Trace(record, "test", True, "completed", "")


def test_settling_and_crossings_of_known_signals():
    """First window a decay exp(-t/5 ms), settled to 5 % after 5 ms ln 20; second a damped cosine
    with known zeros.
    """
    t = np.arange(0, 0.05, 1e-5)
    first = 1e-6 * np.exp(-t / 5e-3)
    second = 2e-6 * np.exp(-t / 1e-2) * np.cos(2 * np.pi * 100 * t)
    scenario = Scenario(name="test", duration=0.1, speed=100.0, to_speed=300.0)
    found = steps(_trace(np.concatenate([first, second, [0.0]]), 1e5), scenario, ["y_A_zeta"])
    assert len(found) == 2
    assert found[0].settling == pytest.approx(5e-3 * np.log(20), rel=1e-3)
    assert (found[0].crossings, found[0].speed, found[1].speed) == (0, 100.0, pytest.approx(200.0))
    assert (found[0].peak, found[1].peak) == (pytest.approx(1e-6), pytest.approx(2e-6))
    extremes = np.exp(-np.arange(12) * 5e-3 / 1e-2)  # of the cosine, one between two zeros
    assert (
        found[1].crossings == (extremes > 0.05).sum() - 1
        or found[1].crossings == (extremes > 0.05).sum()
    )


def test_a_signal_that_does_not_settle_says_so():
    t = np.arange(0, 0.05, 1e-4)
    scenario = Scenario(name="test", duration=0.05, speed=100.0, to_speed=300.0)
    found = steps(_trace(np.append(np.cos(600 * t), 0.9), 1e4), scenario, ["y_A_zeta"])
    assert found[0].settling == np.inf


def test_constant_speed_is_refused(plant, controller):
    with pytest.raises(InvalidInput, match="one whose speed or pressure changes"):
        spin_up(plant, controller, Scenario(name="still", duration=0.1, speed=100.0))


def test_speeds_the_wrong_way_round_are_refused(plant, controller):
    with pytest.raises(InvalidInput, match="a range that ascends"):
        loops_along(plant, controller, 900.0, 400.0)
