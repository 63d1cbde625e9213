"""A rig that is advanced a frame at a time is the same rig: its frames are a whole run's samples."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.workbench.rig import LiveRig
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Failure, PressureChange, Pulse, Scenario, SpeedChange

RIG = amb.load_machine("seal-rig")
PID = amb.design(RIG, "pid")
TURNING = amb.OperatingPoint(speed=600.0, label="turning")
UNEVEN = (1, 333, 7, 334, 1000, 325)  # frames [samples] as a clock would ask for them


def frames(live, count, sizes=UNEVEN):
    """The log of ``count`` samples in frames of uneven sizes."""
    logs, i = [], 0
    while count and not live.ended:
        size = min(sizes[i % len(sizes)], count)
        logs.append(live.advance(size).log)
        i, count = i + 1, count - size
    return np.concatenate(logs)


def whole(live, scenario=None, **options):
    """The same columns of a whole run of what was done, or of a scenario."""
    trace = virtual_rig.run(RIG, live.law, scenario or live.scenario, **options)
    names = [f"{kind}_{a}" for kind in ("y", "u", "i", "f_magnet") for a in live.axes]
    return np.array([trace.record[n] for n in (*names, *(f"q_{p}" for p in live.ports))]).T


def close(one, other, tolerance=1e-12):
    """Within ``tolerance`` of the largest value of each column."""
    assert one.shape == other.shape
    size = np.abs(other).max(axis=0)
    assert (np.abs(one - other).max(axis=0) <= tolerance * np.where(size > 0, size, 1.0)).all()


MOVING = Scenario(
    "moving",
    0.6,
    pulses=(Pulse("f_A_zeta", 5.0, 0.01, 0.001),),
    pressures=(PressureChange(0.05, 2e5, 0.3),),
    failures=(Failure(0.5, "A_zeta"),),
    speed=100.0,
    speed_changes=(SpeedChange(0.02, 120.0, 0.1), SpeedChange(0.45, 90.0, 0.1)),
)


@pytest.mark.parametrize("scenario", ["unbalance", MOVING, "levitation"])
def test_frames_of_a_scenario_are_its_run(scenario):
    if isinstance(scenario, str):
        scenario = replace(amb.load_scenario(scenario), duration=0.6)
    live = LiveRig(RIG, PID, scenario)
    close(frames(live, 6001), whole(live, scenario))


def test_what_is_done_to_it_is_a_scenario_that_runs_the_same():
    live = LiveRig(RIG, PID, point=TURNING)
    live.set_unbalance("A", 2e-6)
    logs = [frames(live, 500)]
    live.knock("A", 0.01, -0.02)
    logs.append(frames(live, 800))
    live.fail_amplifier("A_zeta")
    logs.append(frames(live, 300))
    live.drop()
    logs.append(frames(live, 900))
    assert live.told
    log = np.concatenate(logs)
    assert np.hypot(*log[-200:, -4:-2].T).max() > 0  # it moved
    close(log, whole(live, point=TURNING)[: len(log)])


def test_speed_and_pressure_move_as_in_a_whole_run():
    """The changes are known to the whole run beforehand, which so linearises elsewhere."""
    live = LiveRig(RIG, PID, point=TURNING)
    live.set_unbalance("A", 2e-6)
    logs = [frames(live, 700)]
    live.set_speed(live.advance(0).speed + 30.0, 300.0)
    live.set_pressure(1e5, 5e5)
    logs.append(frames(live, 3000))
    live.set_speed(600.0, 300.0)  # after the first change
    frame = live.advance(1)
    logs.append(frame.log)
    assert frame.pressure == pytest.approx(1e5)
    log = np.concatenate(logs)
    close(log, whole(live, point=TURNING)[: len(log)], 1e-6)


def test_a_target_that_is_replaced_goes_on_from_where_it_is():
    live = LiveRig(RIG, PID)
    start = live.advance(0).speed
    live.set_speed(start + 100.0, 100.0)
    live.advance(5000)  # half a second: half of the way
    live.set_speed(start, 100.0)
    assert live.advance(0).speed == pytest.approx(start + 50.0)
    assert live.advance(2500).speed == pytest.approx(start + 25.0)
    assert live.advance(5000).speed == pytest.approx(start)


def test_a_knock_pushes_where_it_points():
    """Along y, although the bearing's axes are tilted by 45 degrees."""
    live = LiveRig(RIG, PID)
    calm = live.advance(100).log[-1]
    live.knock("A", 0.0, 0.004)
    moved = live.advance(12).log
    before = live.ports.index("A_zeta")
    c, s = live.direction[0]
    a = 4 * len(live.axes) + before
    zeta, eta = (moved[-1, a + i] - calm[a + i] for i in (0, 1))
    x, y = c * zeta - s * eta, s * zeta + c * eta
    assert y > 0
    assert abs(x) < 0.2 * y


def test_another_controller_takes_over_without_a_bump():
    live = LiveRig(RIG, PID, point=TURNING)
    live.set_unbalance("A", 2e-6)
    live.advance(3000)
    settled = live.advance(2000).log[:, 4:8]
    live.switch(amb.design(RIG, "pid"))
    after = live.advance(2000).log[:, 4:8]
    # the same law goes on as if nothing had been
    assert np.abs(np.diff(after, axis=0)).max() < 1.05 * np.abs(np.diff(settled, axis=0)).max()
    assert not live.told


def test_a_rotor_that_fell_is_lifted_again():
    live = LiveRig(RIG, PID)
    live.drop()
    assert any(live.advance(2000).contact)
    live.lift()
    live.advance(5000)
    assert not any(live.advance(100).contact)


def test_a_dead_sensor_tells_zero_and_may_be_repaired():
    live = LiveRig(RIG, PID)
    live.fail_sensor("A_zeta")
    log = live.advance(300).log
    assert np.abs(log[50:, 0]).max() < 1e-7
    assert np.abs(log[50:, 2]).max() > 0
    live.lift()
    live.advance(4000)
    assert not any(live.advance(100).contact)


def test_after_many_events_it_goes_on_from_the_same_state():
    """Two rigs, one of which forgets its past events: no difference between them."""
    short, long = LiveRig(RIG, PID, point=TURNING), LiveRig(RIG, PID, point=TURNING)
    for live in (short, long):
        live.set_unbalance("A", 2e-6)
    for i in range(40):
        for live in (short, long):
            live.knock("B", 1e-4 * (-1) ** i, 0.0)
            if live is long:
                live._do = lambda live=live, **changes: setattr(
                    live,
                    "_task",
                    replace(live._task, scenario=replace(live._task.scenario, **changes)),
                )
            last = live.advance(50)
    assert len(short.scenario.pulses) < len(long.scenario.pulses)
    close(short.advance(200).log, long.advance(200).log, 1e-9)
    assert last.time == pytest.approx(39 * 50 * short.dt)


def test_divergence_ends_it():
    live = LiveRig(RIG, PID)
    live.set_gain(0.05)
    live.knock("A", 0.2, 0.0)
    frame = live.advance(2000)
    assert any(frame.contact)
    live.knock("A", 1e4, 0.0)
    ended = live.advance(2000)
    assert "bearing A" in ended.ended
    assert np.isfinite(ended.log).all()
    assert len(live.advance(10).log) == 0


def test_a_record_goes_to_identification(tmp_path):
    live = LiveRig(RIG, PID)
    live.advance(100)
    live.excite(0.1)
    live.record(tmp_path / "live.h5")
    log = live.advance(1000).log
    assert live.recorded == pytest.approx(0.1)
    path = live.stop_recording()
    record = amb.read_record(path)
    assert record["y_A_zeta"] == pytest.approx(log[:, 0], abs=0)
    assert set(np.unique(np.abs(record["e_A_zeta"]))) == {0.1}
    assert record.point.speed == RIG.operation.nominal.speed
    assert live.stop_recording() is None


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda live: live.knock("C", 1, 0), "no station 'C'"),
        (lambda live: live.knock("A", np.nan, 0), "impulse"),
        (lambda live: live.fail_sensor("Z"), "no axis 'Z'"),
        (lambda live: live.fail_amplifier("Z"), "no axis 'Z'"),
        (lambda live: live.set_speed(-1.0), "speed"),
        (lambda live: live.set_gain(0.0), "gain"),
        (lambda live: live.set_pressure(np.inf), "pressure"),
    ],
)
def test_refused_in_words_and_nothing_changed(call, match):
    live = LiveRig(RIG, PID)
    before = live.scenario
    with pytest.raises(amb.InvalidInput, match=match):
        call(live)
    assert live.scenario == before
