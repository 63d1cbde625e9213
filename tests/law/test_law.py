"""Everything that controls is a law, and is asked the same way."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine, verify
from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.judge.checks import moving_proofs
from ambrose.judge.result import Provenance, Synthesis, synthesis_of
from ambrose.law.law import PRESSURE, SPEED, law_of
from ambrose.law.pid import pid_controller
from ambrose.model.assemble import assemble
from ambrose.options import Verifying

RIG = load_machine("seal-rig")
POINT = RIG.operation.nominal
PID = pid_controller(RIG.controller, RIG)
GRID = (0.0, 4e5)


def stiffer(factor):
    return replace(PID, C=factor * PID.C, D=factor * PID.D)


SCHEDULE = ScheduledSystem(GRID, [PID, stiffer(1.5)], "pressure", "Pa")


class Program:
    """A program that follows the pressure and was made for a range of it."""

    sample_time = 1e-4
    delay = 1
    parameter = "pressure"
    range = GRID
    system = c2d(PID, 1e-4, "tustin")

    def begin(self, states):
        """Nothing is kept."""

    def schedule(self, value):
        """Nothing is kept."""

    def step(self, errors):
        return np.zeros(len(errors))

    def __call__(self, value):
        return self.system


class Over:
    """A function of the pressure."""

    parameter = "pressure"

    def __call__(self, value):
        return SCHEDULE.at(value)


def test_a_fixed_law():
    law = law_of(PID)
    assert law_of(law) is law and law.at(POINT) is PID and law.fixed is PID
    assert law.scheduled_over is None and law.schedule is None and law.program is None
    assert law.covers(assemble(RIG, POINT)) and law.points(POINT) == (POINT,)
    assert law_of(c2d(PID, 1e-4, "tustin")).sample_time == 1e-4 and law.sample_time is None


def test_a_schedule_and_the_synthesis_that_holds_it():
    point = replace(POINT, seal_pressure=1e5)
    for law in (law_of(SCHEDULE), Synthesis(PID, scheduled=SCHEDULE)):
        assert law.scheduled_over is PRESSURE and law.schedule is SCHEDULE and law.fixed is None
        np.testing.assert_array_equal(law.at(point).C, SCHEDULE.at(1e5).C)
        assert law.follows(PRESSURE) and not law.follows(SPEED)
        assert [p.seal_pressure for p in law.points(POINT)] == list(GRID)
        assert law.clamped(replace(POINT, seal_pressure=9e5)).seal_pressure == GRID[1]
        assert not law.covers(assemble(RIG, replace(POINT, seal_pressure=9e5)))


def test_a_program_and_a_function():
    program, function = law_of(Program()), law_of(Over())
    assert program.program is not None and program.scheduled_over is PRESSURE
    assert program.range == GRID and program.sample_time == 1e-4
    assert function.scheduled_over is PRESSURE and function.program is None
    np.testing.assert_array_equal(function.at(POINT).C, SCHEDULE.at(POINT.seal_pressure).C)
    for law in (program, function):
        assert law.fixed is None and law.schedule is None
        with pytest.raises(InvalidInput, match="a program or a function"):
            synthesis_of(law)


def test_a_synthesis_says_what_it_was_designed_for():
    law = Synthesis(PID, provenance=Provenance(settings={"rate": 8e3, "delay_samples": 2}))
    assert (law.rate, law.delay_samples) == (8e3, 2) and synthesis_of(law) is law
    assert law.nominal is PID and law.digest and not law_of(PID).digest


@pytest.mark.parametrize("given", ["pid.json", {"A": 1}, lambda speed: PID])
def test_the_front_door_refuses_what_is_no_law(given):
    with pytest.raises(InvalidInput):
        verify(RIG, given, tolerances=False)


def test_what_follows_the_pressure_by_itself_is_not_proved_as_if_it_stood_still():
    """A program and a function have no grid of matrices: proved was the law of the middle pressure
    alone.
    """
    (proof,) = moving_proofs()
    motion = Verifying(pressure_rate=1e4, tolerances=False)
    for law in (law_of(Program()), law_of(Over())):
        found = proof.prove(RIG, law, (), None, motion, lambda stage: None)
        assert found == ()
    with pytest.raises(InvalidInput, match="function of the speed is not proved"):
        proof.refuse(RIG, law_of(lambda speed: PID), Verifying(speed_rate=10.0))


def test_a_foreign_system_becomes_a_law_once():
    class Foreign:
        A, B, C, D, dt = PID.A, PID.B, PID.C, PID.D, None

    assert isinstance(law_of(Foreign()).fixed, StateSpace)
