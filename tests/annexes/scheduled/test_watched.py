"""A seal monitor beside the pressure's reading: what it holds against what, and what the
supervision makes of it on the rig.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ambrose.annexes.scheduled.seal_monitor import Estimate
from ambrose.annexes.scheduled.seal_watch import WatchedProgram, watched
from ambrose.code.block.block import build_block
from ambrose.code.block.scheduled import build_scheduled_block, supervise, supervised_twin
from ambrose.code.c.compiled import CompiledSchedule
from ambrose.code.pipeline import machine_limits
from ambrose.code.sampled import deploy, deploy_scheduled
from ambrose.core.checks import InvalidInput
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.law.pid import pid_controller
from ambrose.law.supervision import Fault, Limits, State, supervised
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Prbs, PressureSensor, Pulse, Scenario
from ambrose.rig.trial import simulate_scenario
from coarse import coarse
from needs import needs

RIG = coarse("seal-rig")
PID = pid_controller(RIG.reference, RIG)
LOUDER = StateSpace(PID.A, PID.B, 1.1 * PID.C, 1.1 * PID.D, PID.inputs, PID.outputs)
NOMINAL, DT = RIG.operation.nominal.seal_pressure, 1e-4
SCHEDULE = ScheduledSystem([0.0, 2 * NOMINAL], [PID, LOUDER], "pressure", "Pa")
LIMITS = Limits(
    0.0,
    2 * NOMINAL,
    0.05 * NOMINAL,
    rate=40 * NOMINAL,
    noise=1e3,
    band=0.2 * NOMINAL,
    dwell=0.05,
    fade=0.01,
)
SHAKEN = tuple(Prbs(f"e_{axis}", 0.02, 1e-3, 14, i % 2) for i, axis in enumerate(RIG.axes))


class Oracle:
    """A monitor that knows the truth: the mean of the true pressures with its fading weights,
    restarted like the real one.
    """

    block = 10
    waiting = 0
    window = 0.02
    model = SimpleNamespace(dt=DT, reference=np.array([NOMINAL]))

    def __init__(self, true):
        self.true, self.restarts = iter(true), 0
        self.sums = np.zeros(2)

    def restart(self):
        self.sums, self.restarts = np.zeros(2), self.restarts + 1

    def follow(self, y, v, e):
        mean = np.mean([next(self.true) for _ in range(self.block)])
        self.sums = math.exp(-self.block * DT / self.window) * self.sums + np.array([1.0, mean])
        half = np.array([0.01])
        return [
            Estimate(
                np.array([self.sums[1] / self.sums[0] / NOMINAL]), half, half, half, half, 0.01
            )
        ]


def followed(true, readings, alone=False):
    """The program's estimates and the supervisor's faults, sample by sample."""
    oracle = Oracle(true)
    inner = supervised(SCHEDULE, PID, RIG, DT, LIMITS)
    program = WatchedProgram(inner, lambda: oracle, np.ones((len(RIG.axes), 1)), LIMITS.band, alone)
    found = []
    for reading in readings:
        program.schedule(reading)
        program.step(np.zeros(len(RIG.axes)))
        found.append((*inner.estimate, inner.supervisor.fault, inner.supervisor.value))
    return oracle, found


def test_a_sensor_that_is_off_is_corrected_whatever_the_pressure_does():
    """Means with the same weights: rising by the whole range within the monitor's memory, the error
    is found exactly.
    """
    true = 0.2 * NOMINAL + 30 * NOMINAL * DT * np.arange(400)
    _, found = followed(true, true + 0.1 * NOMINAL)
    for k in range(20, 400):
        assert found[k][0] == pytest.approx(true[k], rel=1e-9) and found[k][2] is Fault.NONE
        assert found[k][3] == pytest.approx(true[k], rel=1e-9)


def test_a_jump_is_not_forgiven_by_what_was_seen_before_it():
    true = np.full(900, NOMINAL)
    readings = (
        true
        + np.where(np.arange(900) < 300, 0.0, 0.5 * NOMINAL)
        + np.where(np.arange(900) % 2, 100.0, 0.0)
    )
    oracle, found = followed(true, readings)
    assert found[300][2] is Fault.JUMP and oracle.restarts == 1
    # nothing is said until the reading was seen anew
    assert [fault for *_, fault, _ in found[301:310]] == [Fault.NONE] * 9
    assert (
        all(math.isinf(half) for _, half, *_ in found[311:320]) and found[330][2] is Fault.DIVERGED
    )
    small = (
        true
        + np.where(np.arange(900) < 300, 0.0, 0.1 * NOMINAL)
        + np.where(np.arange(900) % 2, 100.0, 0.0)
    )
    _, found = followed(true, small)
    assert found[300][2] is Fault.JUMP and found[-1][3] == pytest.approx(NOMINAL, rel=1e-3)


def test_alone_the_estimate_is_the_reading_and_without_one_it_is_lost():
    true = np.full(200, NOMINAL)
    _, found = followed(true, np.full(200, np.nan), alone=True)
    assert found[0][2] is Fault.LOST and found[-1][2:] == (Fault.NONE, pytest.approx(NOMINAL))


def events(duration, **parts):
    return Scenario("watched", duration, sequences=SHAKEN, sample_time=DT, **parts)


def test_on_the_rig_a_reading_that_is_off_is_trimmed_and_one_that_is_far_off_is_not_believed():
    for share, state in ((0.15, State.SCHEDULED), (0.6, State.FIXED)):
        scenario = events(0.62, pressure_sensors=(PressureSensor(offset=share * NOMINAL),))
        inner = supervised(SCHEDULE, PID, RIG, DT, LIMITS)
        program = watched(inner, RIG, scenario, PID, RIG.operation.nominal, "beside")
        assert virtual_rig.run(RIG, program, scenario).outcome == "completed"
        assert inner.supervisor.state is state
        sample, value, half = program.seen[-1]
        assert sample > 6000 and half < 0.1 * NOMINAL and abs(value - NOMINAL) < half
        if state is State.SCHEDULED:
            assert abs(inner.supervisor.value - NOMINAL) < half
        else:
            assert "reading and estimate differ" in program.words()


@pytest.mark.study
@needs("C compiler")
def test_the_code_with_a_monitor_beside_it_is_its_twin_with_one():
    scenario = events(0.55, pressure_sensors=(PressureSensor(offset=0.15 * NOMINAL),))
    limits = machine_limits(RIG)
    block = supervise(
        build_scheduled_block(deploy_scheduled(SCHEDULE, DT, DT, force=True), "rig", *limits),
        build_block(deploy(PID, DT, DT, force=True), "rig", *limits),
        LIMITS,
    )
    code, twin = CompiledSchedule(block), supervised_twin(block)
    made = watched(twin, RIG, scenario, PID, RIG.operation.nominal, "beside")
    a, b = (
        virtual_rig.run(RIG, law, scenario).record for law in (replace(made, program=code), made)
    )
    for name in (f"u_{axis}" for axis in RIG.axes):
        assert np.abs(a[name] - b[name]).max() < 1e-10 * np.abs(b[name]).max()
    assert abs(code.estimate[0] - NOMINAL) < 0.1 * NOMINAL


def test_without_an_excitation_it_says_so_and_trims_nothing():
    scenario = Scenario(
        "quiet", 0.5, sample_time=DT, pressure_sensors=(PressureSensor(offset=0.1 * NOMINAL),)
    )
    trace = simulate_scenario(
        RIG, SCHEDULE, scenario, fallback=PID, pressure_error=0.2 * NOMINAL, estimate="beside"
    )
    assert (
        "schedule throughout; the monitor saw no excitation and said nothing: add e_<axis>"
        in trace.text
    )


def test_refusals():
    given = {"fallback": PID, "estimate": "beside"}
    with pytest.raises(InvalidInput, match="pressure_error is 0 Pa, but must be above zero"):
        simulate_scenario(RIG, SCHEDULE, events(0.5), **given)
    given["pressure_error"] = 0.2 * NOMINAL
    with pytest.raises(InvalidInput, match="moves references"):
        simulate_scenario(RIG, SCHEDULE, events(0.5, pulses=(Pulse("r_A_zeta", 1e-6),)), **given)
    with pytest.raises(InvalidInput, match="at one speed"):
        simulate_scenario(RIG, SCHEDULE, events(0.5, speed=10.0, to_speed=100.0), **given)
    with pytest.raises(InvalidInput, match="one of beside, alone"):
        simulate_scenario(RIG, SCHEDULE, events(0.5), **{**given, "estimate": "instead"})
    with pytest.raises(InvalidInput, match="pressure_rate is not given"):
        simulate_scenario(RIG, SCHEDULE, events(0.5), **{**given, "estimate": "alone"})
    with pytest.raises(InvalidInput, match="a pressure that surges needs a sensor"):
        simulate_scenario(
            RIG, SCHEDULE, events(0.5), **{**given, "estimate": "alone"}, pressure_rate=20 * NOMINAL
        )
    with pytest.raises(InvalidInput, match="stuck_after"):
        simulate_scenario(
            RIG, SCHEDULE, events(0.5), **{**given, "estimate": "alone"}, stuck_after=0.01
        )
    with pytest.raises(InvalidInput, match="the number of seals is 2"):
        two = replace(RIG, seals=(RIG.seals[0], replace(RIG.seals[0], name="second")))
        simulate_scenario(two, SCHEDULE, events(0.5), **given)
    bent = replace(RIG, tolerances=(), seals=(replace(RIG.seals[0], scales_with_pressure=()),))
    with pytest.raises(InvalidInput, match="no monitor estimates the pressure"):
        simulate_scenario(bent, SCHEDULE, events(0.5), **given)
