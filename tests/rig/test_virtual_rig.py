"""The virtual rig: what its runs show, how they end, what is refused. Its accuracy is in
test_virtual_rig_accuracy.py.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import StateSpace, load_machine
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, Touchdown
from ambrose.machine.ordinary_file import LARGEST_SAMPLE
from ambrose.machine.part import Runout
from ambrose.record.files import read_record
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Failure, PressureChange, Pulse, Scenario, load_scenario
from run_ups import RUN_UP

RIG = load_machine("seal-rig")
WEIGHTLESS = replace(RIG, gravity_direction=None)
PID = pid_controller(RIG.controller, RIG)
PUMP = load_machine("turbomolecular-pump")
PUMP_PID = pid_controller(PUMP.controller, PUMP)
POINTS = {point.label: point for point in RIG.operation.points}


def sensors(machine, **changes):
    return replace(machine, sensors=tuple(replace(sensor, **changes) for sensor in machine.sensors))


@pytest.mark.literature
@pytest.mark.parametrize("pattern", ["impulse-orthogonal", "impulse-parallel"])
@pytest.mark.parametrize("label", ["zero pressure", "nominal pressure"])
def test_p5_pid_is_stable_up_to_nominal_pressure(label, pattern):
    """P5, Figs. 15 and 16: the PID settles within the 0.25 s after the pulse."""
    trace = virtual_rig.run(RIG, PID, load_scenario(pattern), point=POINTS[label])
    assert trace.outcome == "completed" and trace.stable and trace.touchdown_at is None
    y = trace.record.select([f"y_{a}" for a in RIG.axes]).values
    assert np.abs(y[:, -300:]).max() < 0.25 * np.abs(y).max() < 5e-6


@pytest.mark.literature
def test_p5_pid_grows_into_the_touchdown_bearings_at_twice_nominal_pressure():
    """P5, section 5.5: growing oscillation; its rate is that of the linear loop's pole until the
    currents are limited.
    """
    trace = virtual_rig.run(
        RIG, PID, load_scenario("impulse-orthogonal"), point=POINTS["twice nominal pressure"]
    )
    assert trace.outcome == "touchdown" and not trace.stable
    assert "unstable" in trace.text and 0.06 < trace.touchdown_at < 0.2
    y = trace.record["y_A_zeta"]
    gap = RIG.bearings[0].touchdown_gap
    assert np.abs(trace.record["q_A_zeta"]).max() < 1.3 * gap  # the bearing holds it
    time = trace.record.time
    growing = (
        (time > 0.065)
        & (np.abs(trace.record["u_A_zeta"]) < 0.5 * RIG.bearings[0].max_current)
        & (time < 0.1)
    )
    peaks = [
        i for i in np.flatnonzero(growing)[1:-1] if abs(y[i]) > max(abs(y[i - 1]), abs(y[i + 1]))
    ]
    rate = np.polyfit(time[peaks], np.log(np.abs(y[peaks])), 1)[0]
    assert rate == pytest.approx(trace.pole.real, rel=0.05)


def test_levitation_from_rest_lifts_and_centres_the_rotor():
    trace = virtual_rig.run(RIG, PID, load_scenario("levitation"))
    record, gap = trace.record, RIG.bearings[0].touchdown_gap
    assert trace.outcome == "completed" and "levitated since" in trace.text
    start = [record[f"q_{axis}"][0] for axis in ("A_zeta", "A_eta")]
    # lies at the bottom, between the tilted axes
    assert np.hypot(*start) == pytest.approx(gap, rel=0.02) and max(start) < 0
    assert np.abs(record.between(1.8, 2.0).select([f"y_{a}" for a in RIG.axes]).values).max() < 1e-6
    lift = sum(np.cos(np.pi / 4) * record[f"f_magnet_{axis}"][-1] for axis in RIG.axes)
    assert lift == pytest.approx(68.976 * 9.80665, rel=2e-3)


def test_levitated_start_is_an_equilibrium():
    trace = virtual_rig.run(RIG, PID, Scenario("still", 1.0))
    for kind in ("y", "u", "i", "q", "f"):
        values = trace.record.select(
            [name for name in trace.record.signals if name.startswith(f"{kind}_")]
        ).values
        assert np.ptp(values, axis=1).max() <= 1e-9 * np.abs(values).max() + 1e-15


@pytest.mark.parametrize("name", ["power-loss", "amplifier-failure"])
def test_failures_end_in_the_touchdown_bearings(name):
    trace = virtual_rig.run(RIG, PID, replace(load_scenario(name), duration=0.4))
    assert (
        trace.outcome == "touchdown" and "failed" in trace.text and 0.1 < trace.touchdown_at < 0.13
    )
    assert np.isfinite(trace.record.values).all() and trace.record.values.shape[1] == 4001
    dead = RIG.axes if name == "power-loss" else ["A_zeta"]
    for axis in RIG.axes:
        current = trace.record.between(0.2, 0.4)[f"f_magnet_{axis}"]
        assert (np.abs(current).max() < 1e-6) == (axis in dead)
    fall = trace.record.between(0.09, 0.1)["q_A_zeta"]
    assert np.abs(fall).max() < 1e-5


def test_power_loss_rotor_comes_to_rest_at_the_bottom():
    scenario = Scenario("off", 0.45, failures=(Failure(0.01),))
    # under pressure the seal keeps it whirling
    trace = virtual_rig.run(RIG, PID, scenario, point=POINTS["zero pressure"])
    end = trace.record.between(0.4, 0.45)
    down = -(end["q_A_zeta"] + end["q_A_eta"]) / np.sqrt(2)
    assert down.mean() == pytest.approx(RIG.bearings[0].touchdown_gap, rel=0.05)


def test_power_returns_within_the_fall():
    """Away for 2 ms, the rotor falls by less than g t^2/2 = 20 um and is caught again."""
    dip = Scenario("dip", 0.4, failures=(Failure(0.05, until=0.052),))
    trace = virtual_rig.run(RIG, PID, dip, point=POINTS["zero pressure"])
    assert trace.outcome == "completed"
    before, back = trace.record.between(0.03, 0.0499), trace.record.between(0.35, 0.4)
    at_once = trace.record.between(0.0515, 0.0519)
    for axis in RIG.axes:
        weight = before[f"i_{axis}"].mean()
        assert abs(at_once[f"i_{axis}"]).max() < 0.2 * abs(weight)
        assert back[f"i_{axis}"].mean() == pytest.approx(weight, rel=0.02)
    assert np.abs(back["y_A_zeta"]).max() < 1e-6


def test_free_again_is_told_where_the_power_returns():
    fall = Scenario("fall", 0.25, failures=(Failure(0.02, until=0.06),))
    trace = virtual_rig.run(PUMP, PUMP_PID, fall)
    assert trace.outcome == "touchdown"
    free = float(trace.text.partition("free again since t = ")[2].split()[0])
    places = trace.record.between(free + 2e-4, 0.25)
    gap = PUMP.bearings[0].touchdown_gap
    assert np.hypot(places["q_fore-vacuum_zeta"], places["q_fore-vacuum_eta"]).max() < gap
    gone = replace(fall, failures=(Failure(0.02),))
    assert "again" not in virtual_rig.run(PUMP, PUMP_PID, gone).text


@pytest.mark.parametrize(("until", "words"), [(0.05, "after its time"), (0.3, "within 0 to")])
def test_a_return_of_power_at_no_possible_time_is_refused(until, words):
    with pytest.raises(InvalidInput, match=words):
        Scenario("dip", 0.2, failures=(Failure(0.05, until=until),))


def test_pressure_decides_over_stability_along_a_run():
    """Pressure from zero to twice nominal: touchdown only after the rise."""
    scenario = Scenario(
        "rise",
        1.0,
        pulses=(Pulse("e_A_zeta", 0.05, 0.1, 0.01, 0.3),),
        pressures=(PressureChange(0.5, 4.08e5, 0.1),),
    )
    trace = virtual_rig.run(RIG, PID, scenario, point=POINTS["zero pressure"])
    assert trace.outcome == "touchdown" and trace.touchdown_at > 0.55 and not trace.stable
    np.testing.assert_allclose(
        trace.record["p_seal"][[0, 5000, 5500, 9999]], [0, 0, 2.04e5, 4.08e5], atol=1.0
    )


def test_noise_is_reproducible_and_as_large_as_stated():
    noisy = sensors(WEIGHTLESS, noise=0.3e-6)
    scenario = Scenario("quiet", 1.0)
    first, same, other = (
        virtual_rig.run(noisy, PID, scenario, seed=seed).record for seed in (5, 5, 6)
    )
    np.testing.assert_array_equal(first.values, same.values)
    assert np.abs(first.values - other.values).max() > 0
    silent = first["y_A_zeta"] - _at_sensor(first, "zeta")
    assert silent.std() == pytest.approx(0.3e-6, rel=0.03)


def _at_sensor(record, axis):
    """Rigid-body interpolation from the bearings to sensor A."""
    a = RIG.bearings[0].position
    b = RIG.bearings[1].position
    s = RIG.sensors[0].position
    return record[f"q_A_{axis}"] + (record[f"q_B_{axis}"] - record[f"q_A_{axis}"]) * (s - a) / (
        b - a
    )


def test_quantised_offset_and_run_out_are_in_the_measurement():
    trace = virtual_rig.run(
        sensors(WEIGHTLESS, resolution=1e-7, offset=(2e-6, -1e-6)), PID, Scenario("x", 0.5)
    )
    y = trace.record["y_A_zeta"]
    np.testing.assert_allclose(y, np.round(y / 1e-7) * 1e-7, atol=1e-15)
    assert np.abs(y).max() <= 1e-6  # the integrator pulls the reading, not the rotor, to zero
    assert _at_sensor(trace.record, "zeta").mean() == pytest.approx(-2e-6, abs=0.2e-6)
    tracked = sensors(WEIGHTLESS, runout=(Runout(2, 1e-6),))
    turning = virtual_rig.run(tracked, PID, Scenario("x", 0.5, speed=2 * np.pi * 40)).record
    spectrum = np.abs(np.fft.rfft(turning["y_A_zeta"][:5000])) / 2500
    assert np.argmax(spectrum) == 40  # 80 Hz in half a second
    assert (
        np.abs(
            virtual_rig.run(tracked, PID, Scenario("x", 0.1, speed=0.0)).record["y_A_zeta"]
        ).max()
        < 2e-6
    )


def test_switch_between_controllers_is_bumpless():
    """To itself it is not felt; to another controller under the rotor's weight it barely is."""
    steady = Scenario("switch", 0.6, pulses=(Pulse("e_A_zeta", 0.05, 0.28, 0.01),), switch_at=0.3)
    plain = virtual_rig.run(RIG, PID, replace(steady, switch_at=None)).record
    same = virtual_rig.run(RIG, PID, steady, second=PID).record
    assert np.abs(same.values - plain.values).max() < 1e-6
    quiet = replace(steady, pulses=())
    other = pid_controller(
        replace(RIG.controller, gain=(23000.0,), integral_time=0.1, derivative_time=4e-3), RIG
    )
    trace = virtual_rig.run(RIG, PID, quiet, second=other)
    assert trace.outcome == "completed"
    assert np.abs(trace.record.select([f"y_{a}" for a in RIG.axes]).values).max() < 1e-9


def test_scheduled_controller_follows_the_speed():
    asked = []

    def at(speed):
        asked.append(speed)
        return PID

    scenario = RUN_UP
    scheduled, fixed = (virtual_rig.run(RIG, K, scenario).record for K in (at, PID))
    np.testing.assert_allclose(
        scheduled.values, fixed.values, rtol=0, atol=1e-12 * np.abs(fixed.values).max()
    )
    assert (
        min(asked) == pytest.approx(2 * np.pi * 20)
        and max(asked) > 2 * np.pi * 299
        and len(set(asked)) > 100
    )


def test_record_on_disk_is_the_one_returned(tmp_path):
    path = tmp_path / "run.h5"
    trace = virtual_rig.run(RIG, PID, load_scenario("impulse-parallel"), path=path, every=4)
    record = read_record(path)
    np.testing.assert_array_equal(record.values, trace.record.values)
    assert record.sample_rate_hz == 2500 and dict(record.notes)["outcome"] == trace.text
    assert record.signals == trace.record.signals and "e_B_zeta" in record.signals


def test_interrupted_run_leaves_a_readable_record(tmp_path):
    calls = []

    def at(speed):
        calls.append(speed)
        if len(calls) > 100:
            raise KeyboardInterrupt
        return PID

    with pytest.raises(KeyboardInterrupt):
        virtual_rig.run(RIG, at, RUN_UP, path=tmp_path / "run.h5")
    assert not (tmp_path / "run.h5").exists()
    partial = read_record(tmp_path / "run.h5.partial")
    whole = virtual_rig.run(RIG, PID, RUN_UP).record
    assert 2000 < partial.values.shape[1] < 8000
    np.testing.assert_allclose(
        partial.values, whole.values[:, : partial.values.shape[1]], rtol=0, atol=1e-9
    )


def test_a_rotor_pulled_through_its_touchdown_bearing_has_left_the_machine():
    """A soft bearing and a large static current: the magnet's force grows faster than the
    contact's.
    """
    soft = tuple(replace(b, touchdown=Touchdown(stiffness=2e5, damping=50.0)) for b in RIG.bearings)
    pull = Scenario("pull", 0.5, pulses=(Pulse("f_A_zeta", 5e3, 0.05, 0.2),))
    trace = virtual_rig.run(replace(RIG, bearings=soft), PID, pull, bending_modes=0)
    assert trace.outcome == "diverged" and "beyond the air gap of bearing A" in trace.text


def test_without_touchdown_bearings_it_diverges_and_no_nan_leaves():
    open_rig = replace(
        WEIGHTLESS, bearings=tuple(replace(b, touchdown_gap=None) for b in RIG.bearings)
    )
    scenario = Scenario("away", 30.0, pulses=(Pulse("e_A_zeta", 0.05, 0.05, 0.01),))
    trace = virtual_rig.run(
        open_rig, PID, scenario, point=POINTS["twice nominal pressure"], bending_modes=0, every=100
    )
    assert trace.outcome == "diverged" and "record ends" in trace.text
    assert 0.05 < trace.stopped_at < 30  # after the pulse, long before the end
    # out of all bounds, and yet no value that a record refuses
    assert np.abs(trace.record.values).max() < LARGEST_SAMPLE
    assert trace.record.time[-1] <= trace.stopped_at


def refused(match, machine=RIG, controller=PID, scenario=None, error=InvalidInput, **options):
    scenario = load_scenario("impulse-parallel") if scenario is None else scenario
    with pytest.raises(error, match=match):
        virtual_rig.run(machine, controller, scenario, **options)


def test_a_step_too_long_is_refused_with_the_one_needed():
    refused(
        r"integration step is 0.001 s.*at most 0.00028.*fastest pole has 354",
        scenario=Scenario("x", 0.1, sample_time=1e-3),
        dt=1e-3,
        bending_modes=1,
    )
    virtual_rig.run(RIG, PID, Scenario("x", 0.01, sample_time=1e-3), dt=2.7e-4, bending_modes=1)


def test_bad_input_is_refused():
    pulse = Pulse("e_A_zetta", 1.0, 0.0)
    refused(
        'signal.*e_A_zetta.*did you mean "e_A_zeta"', scenario=Scenario("x", 0.1, pulses=(pulse,))
    )
    refused("axis of a failure.*known", scenario=Scenario("x", 0.1, failures=(Failure(0.05, "Q"),)))
    refused("second controller", second=PID)
    refused("second controller", scenario=Scenario("x", 0.1, switch_at=0.05))
    refused(r"size.*\(3, 3\)", controller=StateSpace([], [], [], np.eye(3)))
    refused(
        "another machine",
        controller=StateSpace(
            [], [], [], np.eye(4), [f"err_{i}" for i in "abcd"], [f"u_{i}" for i in "abcd"]
        ),
    )
    refused("every is 0", every=0)
    refused("computing delay", computing_delay=-1)
    refused("bending_modes", bending_modes=-1)
    refused(
        "to a tenth of it",
        scenario=Scenario("x", 0.1, pulses=(Pulse("e_A_zeta", 1.0, 0.01, 1.5e-4),)),
    )
    refused(
        "unbalance is at port 'Q'",
        scenario=replace(RUN_UP, unbalances=(replace(RUN_UP.unbalances[0], port="Q"),)),
    )
    open_rig = replace(RIG, bearings=tuple(replace(b, touchdown_gap=None) for b in RIG.bearings))
    refused("touchdown_gap.*missing", machine=open_rig, scenario=load_scenario("levitation"))
    refused("pressure", point=OperatingPoint(seal_pressure=-1.0))


def test_a_rotor_too_heavy_to_levitate_is_refused():
    weak = replace(RIG, bearings=tuple(replace(b, max_current=0.5) for b in RIG.bearings))
    refused("no levitated equilibrium.*max_current", machine=weak, error=NumericalFailure)
