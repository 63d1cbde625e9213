"""A controller scheduled over speed and pressure on the virtual rig and on the linear loop, while
one or both change.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.scheduled import ScheduledSystem
from ambrose.law.law import BOTH, PRESSURE, SPEED, law_of
from ambrose.law.loop import match_controller
from ambrose.model.assemble import assemble
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import PressureChange, PressureSensor, Pulse, SpeedChange
from ambrose.rig.trial import simulate_linear
from rig.test_pressure_schedule import PID, RIG, SCHEDULE, SURGE, ZERO, Y, stiffer

KNOCK = Pulse("f_center_x", 20.0, 0.06, 0.003)  # when speed and pressure have changed
TURNING = replace(
    SURGE,
    pulses=(KNOCK,),
    speed=20.0,
    speed_changes=(SpeedChange(0.002, 100.0, 0.05),),
    pressures=(PressureChange(0.01, 2e5, 0.045),),
)
WEIGHTLESS = replace(RIG, gravity_direction=None)
OVER_SPEED = ScheduledSystem([0.0, 100.0], [PID, stiffer(1.4)])


def product(speed_matters: bool, pressure_matters: bool) -> ScheduledSystem:
    factors = [
        (1 + 0.4 * s * speed_matters) * (1 + 0.5 * p * pressure_matters)
        for s in (0, 1)
        for p in (0, 1)
    ]
    systems = [stiffer(factor) for factor in factors]
    return ScheduledSystem(([0.0, 100.0], [0.0, 4.08e5]), systems, BOTH.name, BOTH.unit)


def ran(law, scenario, machine=WEIGHTLESS):
    return virtual_rig.run(machine, law, scenario, point=ZERO).record


def apart(first, second):
    """The largest difference, of the largest motion."""
    size = max(np.ptp(first[name]) for name in Y)
    return max(np.abs(first[name] - second[name]).max() for name in Y) / size


def test_it_says_what_it_follows():
    law = product(True, True)
    assert (
        law_of(law).scheduled_over is BOTH
        and law_of(law).follows(SPEED)
        and law_of(law).follows(PRESSURE)
    )
    assert not law_of(SCHEDULE).follows(SPEED) and not law_of(PID).follows(PRESSURE)
    point = replace(ZERO, speed=50.0, seal_pressure=1.02e5)
    np.testing.assert_allclose(law_of(law).at(point).C, stiffer(1.2 * 1.125).C, rtol=1e-12)
    assert BOTH.moved(ZERO, (50.0, 1.02e5)) == point and BOTH.of(point) == (50.0, 1.02e5)
    assert BOTH.words((100 * np.pi, 2e5)) == "50 Hz, 2 bar"


@pytest.mark.parametrize(
    ("point", "inside"), [((100.0, 4.08e5), True), ((101.0, 0.0), False), ((0.0, 5e5), False)]
)
def test_it_covers_what_lies_within_both_ranges(point, inside):
    plant = assemble(RIG, BOTH.moved(ZERO, point))
    assert law_of(product(True, True)).covers(plant) is inside


def test_a_parameter_that_changes_nothing_is_the_schedule_over_the_other():
    for law, alone in ((product(False, True), SCHEDULE), (product(True, False), OVER_SPEED)):
        # laws are read every 10 or 50 samples
        assert apart(ran(alone, TURNING), ran(law, TURNING)) < 0.003


def test_both_act_together():
    """Neither of the schedules over one does what the schedule over both does."""
    both = ran(product(True, True), TURNING)
    assert min(apart(ran(alone, TURNING), both) for alone in (SCHEDULE, OVER_SPEED, PID)) > 0.02


def test_a_sensor_that_errs_is_clamped_and_a_pressure_beyond_is_refused():
    law = product(True, True)
    errs = ran(law, replace(TURNING, pressure_sensors=(PressureSensor(offset=9e5),)))
    frozen = ScheduledSystem([0.0, 100.0], [law.at((0.0, 4.08e5)), law.at((100.0, 4.08e5))])
    assert apart(ran(frozen, TURNING), errs) < 0.003
    beyond = replace(TURNING, speed_changes=(SpeedChange(0.01, 160.0, 0.05),))
    with pytest.raises(
        InvalidInput, match=r"the speed is .* rad/s, but must be between 0 and 100 rad/s"
    ):
        ran(law, beyond)


def test_the_linear_loop_follows_whichever_changes():
    """At a pressure that is held, the schedule over both is that over speed at this pressure, and
    the other way round.
    """
    law, plant = product(True, True), assemble(WEIGHTLESS, replace(ZERO, seal_pressure=1e5))
    turning = replace(SURGE, pressures=(), speed=20.0, to_speed=100.0)
    edge = ScheduledSystem([0.0, 100.0], [law.at((speed, 1e5)) for speed in (0.0, 100.0)])
    assert (
        apart(
            simulate_linear(plant, edge, turning).record,
            simulate_linear(plant, law, turning).record,
        )
        < 1e-9
    )
    edge = ScheduledSystem(
        [0.0, 4.08e5], [law.at((0.0, p)) for p in (0.0, 4.08e5)], "pressure", "Pa"
    )
    still = assemble(WEIGHTLESS, ZERO)
    assert (
        apart(simulate_linear(still, edge, SURGE).record, simulate_linear(still, law, SURGE).record)
        < 1e-9
    )
    assert match_controller(law, plant).n_states == PID.n_states
