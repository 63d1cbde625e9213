"""Linear simulation of a small loop with known answers, and of the bundled machine."""

import json
from functools import cache

import control
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp

import run_ups
from ambrose import load_machine
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace, select
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.files import read_record, write_record
from ambrose.rig import linear
from ambrose.rig.scenario import Pulse, Scenario, Sine, Unbalance, bundled_scenarios, load_scenario
from ambrose.rig.trace import Trace, peaks, settling
from physical_numbers import physical

AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
M = 17.0
KI = 150.0
W = 250.0
ZETA = 0.08


def fake_loop(damping=ZETA, speed=0.0, gyroscopic=0.0):
    """Two points A and B of mass M, each on u = K (r - y) with damping; q'' + 2 z W q' + W^2 q =
    (KI (e + K (r - d)) + f)/M.

    The first and second axis of a point are coupled by gyroscopic forces, q1'' + speed g q2', q2''
    - speed g q1'.
    """
    gain = M * W**2 / KI
    G = np.kron(np.eye(2), [[0.0, 1.0], [-1.0, 0.0]]) * speed * gyroscopic
    eye, zero = np.eye(4), np.zeros((4, 4))
    A = np.block([[zero, eye], [-(W**2) * eye, -2 * damping * W * eye - G]])
    B = np.hstack([KI / M * eye, -(W**2) * eye, W**2 * eye, eye / M])  # e, d, r, f
    B = np.vstack([np.zeros((4, 16)), B])
    C = np.vstack(
        [np.hstack([eye, zero]), np.hstack([-gain * eye, zero])] * 2 + [np.hstack([zero, eye])]
    )
    D = np.zeros((20, 16))
    D[:4, 4:8], D[4:8, 4:12] = eye, np.hstack([-gain * eye, gain * eye])
    D[12:16, :4], D[12:16, 4:12] = eye, D[4:8, 4:12]
    inputs = [f"{kind}_{a}" for kind in "edrf" for a in AXES]
    outputs = [f"{kind}_{a}" for kind in ("y", "u", "q", "i", "qdot") for a in AXES]
    return StateSpace(A, B, C, D, inputs, outputs)


def step_of_oscillator(t):
    wd = W * np.sqrt(1 - ZETA**2)
    t = np.maximum(t, 0)
    return (1 - np.exp(-ZETA * W * t) * (np.cos(wd * t) + ZETA * W / wd * np.sin(wd * t))) / W**2


def test_current_impulse_has_its_closed_form():
    trace = linear.run(fake_loop(), load_scenario("impulse-orthogonal"), machine="fake")
    t = trace.record.time
    exact = 0.05 * KI / M * (step_of_oscillator(t - 0.05) - step_of_oscillator(t - 0.06))
    for axis in ("A_zeta", "B_eta"):
        np.testing.assert_allclose(
            trace.record[f"y_{axis}"], exact, rtol=0, atol=1e-13 * np.abs(exact).max() * len(t)
        )
        assert trace.record[f"e_{axis}"][[499, 500, 599, 600]].tolist() == [0, 0.05, 0.05, 0]
    for axis in ("A_eta", "B_zeta"):
        assert not trace.record[f"y_{axis}"].any()
    assert len(t) == 3001 and t[-1] == pytest.approx(0.3)
    assert trace.stable and trace.outcome == "completed" and trace.stopped_at is None
    assert trace.pole == pytest.approx(complex(-ZETA * W, W * np.sqrt(1 - ZETA**2)))


def test_python_control_agrees_on_the_held_loop():
    loop = fake_loop()
    trace = linear.run(loop.to_control(), load_scenario("force-impulse"))
    force = trace.record["f_A_zeta"]
    assert force.sum() * trace.record.dt == pytest.approx(100 * 2e-3)
    held = control.c2d(select(loop, "f_A_zeta").to_control(), 1e-4)
    expected = control.forced_response(held, trace.record.time, force).outputs
    for i, name in enumerate(loop.outputs):
        np.testing.assert_allclose(
            trace.record[name],
            expected[i],
            rtol=0,
            atol=1e-11 * max(np.abs(expected[i]).max(), 1e-9),
        )


ALONG_THE_SHAFT = {"five-axes", "surge", "thrust-reversal", "thrust-step"}  # tests/thrust has these


@pytest.mark.parametrize("name", sorted(set(bundled_scenarios()) - ALONG_THE_SHAFT))
def test_every_bundled_scenario_runs_or_is_for_the_rig(name):
    scenario = load_scenario(name).on(load_machine("turboexpander"))
    if scenario.only_for_the_rig:
        with pytest.raises(InvalidInput, match="virtual rig"):
            linear.run(fake_loop(0.3), scenario)
        return
    trace = linear.run(fake_loop(0.3), scenario, mass=2 * M, outputs=["y_A_zeta"])
    assert (
        trace.outcome == "completed"
        and trace.record.signals[0] == "y_A_zeta"
        and np.abs(trace.record["y_A_zeta"]).max() > 0
    )


def test_steady_unbalance_is_the_frequency_response():
    loop = fake_loop(0.3)
    speed = 1200.0
    U = 3e-4
    scenario = Scenario("x", 0.5, unbalances=(Unbalance("A", U, phase=0.4),), speed=speed)
    trace = linear.run(loop, scenario)
    gain = frequency_response(select(loop, "f_A_zeta", "q_A_zeta"), [speed]).values[0, 0, 0]
    t = trace.record.time
    orbit = gain * U * speed**2 * np.exp(1j * (speed * t + 0.4))
    late = t > 0.35
    # from zeta to eta: forward whirl
    for axis, part in (("zeta", orbit.real), ("eta", orbit.imag)):
        np.testing.assert_allclose(
            trace.record[f"q_A_{axis}"][late], part[late], rtol=0, atol=1e-6 * np.abs(orbit[0])
        )
    assert trace.record.point.speed == speed


def test_sine_converges_with_fourth_order():
    scenario = Scenario(
        "x", 0.1, sines=(Sine("e_A_zeta", 0.3, 400.0, phase=1.0, start=0.02, duration=0.06),)
    )

    def answer(dt):
        return linear.run(fake_loop(), scenario, dt=dt).record["y_A_zeta"][:: round(5e-4 / dt)]

    exact = answer(5e-4 / 64)
    errors = [np.abs(answer(5e-4 / n) - exact).max() for n in (1, 2, 4)]
    assert (
        np.log2(errors[0] / errors[1])
        == pytest.approx(4, abs=0.3)
        == np.log2(errors[1] / errors[2])
    )
    assert errors[0] < 3e-5 * np.abs(exact).max()


def test_sampled_loop_gets_the_mean_of_a_smooth_disturbance():
    """The mean over a sample removes the half-sample delay of a staircase: the rest is (w
    dt)^2/24.
    """
    scenario = Scenario("x", 0.1, sines=(Sine("e_A_zeta", 0.3, 400.0),))
    exact = linear.run(fake_loop(), scenario, dt=1e-4).record["y_A_zeta"]
    sampled = linear.run(c2d(fake_loop(), 1e-4), scenario)
    assert sampled.record.sample_rate_hz == 1e4
    assert (
        np.abs(sampled.record["y_A_zeta"] - exact).max()
        < 2 * (400 * 1e-4) ** 2 / 24 * np.abs(exact).max()
    )
    pulse = load_scenario("impulse-parallel")
    np.testing.assert_allclose(
        linear.run(c2d(fake_loop(), 1e-4), pulse).record["y_B_zeta"],
        linear.run(fake_loop(), pulse).record["y_B_zeta"],
        atol=1e-16,
    )


RUN_UP = Scenario(
    "x", 0.25, unbalances=(Unbalance("A", 1e-4),), speed=50.0, to_speed=700.0, ramp=0.2
)


def gyroscopic(speed):
    return fake_loop(0.1, speed, gyroscopic=0.3)


@cache
def run_up_oracle():
    """Runge-Kutta of order 8 with the matrix as it changes and the force from its formula."""

    def slope(t, x):
        a = 3250.0 if t < 0.2 else 0.0
        W_t = min(50 + 3250 * t, 700.0)
        phi = 50 * t + 1625 * t**2 if t < 0.2 else 75.0 + 700 * (t - 0.2)
        F = 1e-4 * (W_t**2 - 1j * a) * np.exp(1j * phi)
        loop = gyroscopic(W_t)
        return loop.A @ x + (F.real * loop.B[:, 12] + F.imag * loop.B[:, 13])

    parts, x = [], np.zeros(8)
    for start, stop in ((0, 2000), (2000, 2500)):  # the ramp's end is a kink
        t = np.arange(start, stop + 1) * 1e-4
        solution = solve_ivp(slope, (t[0], t[-1]), x, "DOP853", t, rtol=1e-10, atol=1e-16)
        parts.append(solution.y[:2, :-1])
        x = solution.y[:, -1]
    return np.hstack([*parts, x[:2, None]])


def test_run_up_agrees_with_runge_kutta_and_knows_its_error():
    trace = linear.run(gyroscopic, RUN_UP, dt=1e-4)
    exact = run_up_oracle()
    ours = np.array([trace.record["q_A_zeta"], trace.record["q_A_eta"]])
    error = np.abs(ours - exact).max() / np.abs(exact).max()
    assert error < 1e-3
    assert 0.3 * error < trace.speed_error < 3 * error
    assert trace.record["speed"][[0, 1000, -1]] == pytest.approx([50, 375, 700])
    assert "error of the run-up" in trace.text


def test_run_up_converges_with_second_order(monkeypatch):
    monkeypatch.setattr(linear, "_CLOSE", np.inf)
    monkeypatch.setattr(linear, "_TOLERATED", np.inf)
    exact, errors = run_up_oracle(), []
    for count in (64, 128, 256):
        monkeypatch.setattr(linear, "_FEWEST", count)
        errors.append(
            np.abs(linear.run(gyroscopic, RUN_UP, dt=1e-4).record["q_A_zeta"] - exact[0]).max()
        )
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.1)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.1)


def test_run_up_that_does_not_converge_is_refused(monkeypatch):
    monkeypatch.setattr(linear, "_FEWEST", 1)
    monkeypatch.setattr(linear, "_MOST", 2)
    with pytest.raises(NumericalFailure, match=r"2 intervals.*lengthen the run-up"):
        linear.run(gyroscopic, RUN_UP)


def test_loop_between_two_speeds():
    loop_at = ScheduledSystem([50.0, 700.0], [gyroscopic(50.0), gyroscopic(700.0)])
    direct, between = (linear.run(loop, RUN_UP).record["q_A_eta"] for loop in (gyroscopic, loop_at))
    np.testing.assert_allclose(between, direct, rtol=0, atol=1e-12 * np.abs(direct).max())


def test_unstable_loop_is_an_outcome():
    loop = fake_loop(damping=-0.05)
    scenario = Scenario("x", 1000.0, pulses=(Pulse("f_A_zeta", 1.0, 0.0, 1e-3),), sample_time=1e-3)
    trace = linear.run(loop, scenario, displacement_limit=2.5e-4)
    q = trace.record["q_A_zeta"]
    assert not trace.stable and trace.outcome == "diverged"
    assert np.abs(q[:-1]).max() <= 2.5e-4 < abs(q[-1])
    assert trace.stopped_at == pytest.approx(trace.record.time[-1])
    # force times duration over M W grows with exp(0.05 W t); the swing adds less than a period
    envelope = 1e-3 / M / W
    assert np.log(2.5e-4 / envelope) / (0.05 * W) == pytest.approx(
        trace.stopped_at, abs=2 * np.pi / W
    )
    assert "q_A_zeta passed 250 um at t = " in trace.text and "pole 12.5+249.7j" in trace.text
    assert settling(trace) == np.inf
    assert "1000 um" in linear.run(loop, scenario).text  # without a limit it stops at a millimetre
    short = linear.run(loop, load_scenario("force-impulse"))
    assert not short.stable and short.outcome == "completed" and "unstable" in short.text


def test_fast_divergence_in_a_long_record_does_not_overflow():
    scenario = Scenario(
        "x",
        20.0,
        pulses=(Pulse("f_B_eta", 1.0),),
        unbalances=(Unbalance("A", 1e-5),),
        speed=10.0,
        to_speed=90.0,
    )
    for loop in (fake_loop(-0.9), lambda w: fake_loop(-0.9, w, 0.1)):
        trace = linear.run(loop, scenario)
        assert trace.outcome == "diverged" and trace.stopped_at < 0.1


def test_stable_loop_beyond_the_limit():
    trace = linear.run(fake_loop(), load_scenario("force-impulse"), displacement_limit=1e-5)
    assert (
        trace.stable and trace.outcome == "limit exceeded" and "q_A_zeta passed 10 um" in trace.text
    )
    assert np.abs(trace.record["q_A_zeta"][:-1]).max() <= 1e-5


@settings(max_examples=15, deadline=None)
@given(physical(-5, 5), st.integers(0, 400), st.sampled_from(AXES))
def test_superposition_and_time_shift(factor, shift, axis):
    loop = fake_loop()
    one = Pulse("f_A_zeta", 40.0, 2e-3, 3e-3)
    late = Pulse(f"e_{axis}", factor, 2e-3 + shift * 1e-4, 3e-3)

    def y(*pulses):
        return (
            linear.run(loop, Scenario("x", 0.06, pulses=pulses))
            .record.select([f"y_{a}" for a in AXES])
            .values
        )

    np.testing.assert_allclose(y(one, late), y(one) + y(late), rtol=0, atol=1e-16)
    early = y(Pulse(f"e_{axis}", factor, 2e-3, 3e-3))
    np.testing.assert_allclose(y(late)[:, shift:], early[:, : 601 - shift], rtol=0, atol=1e-16)


def test_output_disturbance_is_seen_at_once_and_not_by_the_rotor():
    trace = linear.run(fake_loop(), Scenario("x", 0.01, pulses=(Pulse("d_A_zeta", 2e-6, 1e-3),)))
    assert trace.record["y_A_zeta"][10] == 2e-6 and trace.record["q_A_zeta"][10] == 0.0


def test_settling_and_peaks():
    trace = linear.run(fake_loop(), load_scenario("impulse-orthogonal"))
    assert settling(trace, band=0.05, start=0.06) == pytest.approx(
        np.log(20) / (ZETA * W), abs=np.pi / W
    )
    assert peaks(trace)["e_A_zeta"] == 0.05
    assert settling(trace, ["y_A_eta"]) == 0.0


def test_trace_goes_to_a_file(tmp_path):
    point = OperatingPoint(seal_pressure=1e5)
    trace = linear.run(fake_loop(), load_scenario("force-impulse"), machine="fake", point=point)
    again = read_record(write_record(trace.record, tmp_path / "trace.h5"))
    assert again.point.seal_pressure == 1e5 and ("scenario", "force-impulse") in again.notes
    assert np.array_equal(again.values, trace.record.values)


@pytest.mark.parametrize(
    ("scenario", "arguments", "message"),
    [
        (
            Scenario("x", 1.0, pulses=(Pulse("e_C_zeta", 1.0),)),
            {},
            "input 'e_C_zeta'.*it has e_A_zeta, e_A_eta",
        ),
        (
            Scenario("x", 1.0, pulses=(Pulse("e_A_zeta", 1.0),)),
            {"outputs": ["y_C"]},
            "output 'y_C'",
        ),
        (
            Scenario("x", 1.0, unbalances=(Unbalance("C", 1.0),), speed=1.0),
            {},
            "port 'C'.*it has A, B",
        ),
        (
            Scenario("x", 1.0, unbalances=(Unbalance("A", None, 1e-3, 100.0),), speed=1.0),
            {},
            "needs the rotor's mass",
        ),
        (
            Scenario("x", 1.0, unbalances=(Unbalance("A", None, 1e-3, 100.0),), speed=1.0),
            {"mass": -1.0},
            "mass is -1",
        ),
        (
            Scenario("x", 1.0, pulses=(Pulse("e_A_zeta", 1.0, 0.0, 1.5e-4),)),
            {},
            "to a tenth of it",
        ),
        (Scenario("x", 1.0, sines=(Sine("e_A_zeta", 1.0, 1e4),)), {"dt": 1e-4}, "sample faster"),
        (
            Scenario("x", 1.0, unbalances=(Unbalance("A", 1.0),), speed=1e4),
            {"dt": 1e-4},
            "sample faster",
        ),
        (Scenario("x", 1.0), {"dt": 0.0}, "dt is 0"),
        (Scenario("x", 1e300), {}, "shorten the scenario"),
        (Scenario("x", 1.0), {"displacement_limit": -1.0}, "displacement_limit"),
    ],
)
def test_bad_input_is_refused(scenario, arguments, message):
    with pytest.raises(InvalidInput, match=message):
        linear.run(fake_loop(), scenario, **arguments)


def test_a_sampled_loop_keeps_its_rate():
    with pytest.raises(InvalidInput, match=r"the loop's own 0\.001"):
        linear.run(c2d(fake_loop(), 1e-3), Scenario("x", 1.0), dt=1e-4)


@cache
def seal_rig(pressure, scenario) -> Trace:
    machine, point = load_machine("seal-rig"), OperatingPoint(seal_pressure=pressure)
    loop = closed_loop(assemble(machine, point), pid_controller(machine.controller, machine))
    gap = machine.bearings[0].touchdown_gap
    return linear.run(
        loop, load_scenario(scenario), machine=machine.name, point=point, displacement_limit=gap
    )


@pytest.mark.literature
@pytest.mark.parametrize("scenario", ["impulse-orthogonal", "impulse-parallel"])
def test_seal_rig_with_the_reference_controller(scenario):
    """P5: settling near 0.03 s without pressure (within 10 % of the peak), oscillating at 2.04 bar,
    unstable at twice that.
    """
    calm, nominal, double = (seal_rig(pressure, scenario) for pressure in (0.0, 2.04e5, 4.08e5))
    assert settling(calm, band=0.1, start=0.05) == pytest.approx(0.03, abs=0.003)
    assert nominal.stable and settling(nominal, band=0.1, start=0.05) > 2 * settling(
        calm, band=0.1, start=0.05
    )
    assert not double.stable and double.outcome == "diverged"


def test_seal_rig_equals_stepping_its_336_states():
    trace = seal_rig(0.0, "force-impulse")
    machine = load_machine("seal-rig")
    loop = closed_loop(
        assemble(machine, OperatingPoint()), pid_controller(machine.controller, machine)
    )
    held = c2d(select(loop, "f_A_zeta", "y_A_zeta"), 1e-4)
    x, y = np.zeros(held.n_states), []
    for force in trace.record["f_A_zeta"]:
        y.append(held.C[0] @ x)
        x = held.A @ x + held.B[:, 0] * force
    np.testing.assert_allclose(trace.record["y_A_zeta"], y, rtol=0, atol=1e-9 * np.abs(y).max())


def test_seal_rig_run_up_is_affine_in_speed():
    machine = load_machine("seal-rig")
    K = pid_controller(machine.controller, machine)

    def loop_at(speed):
        return closed_loop(
            free_mode_reduction(assemble(machine, OperatingPoint(speed=speed)), 2), K
        )

    scenario = run_ups.RUN_UP
    ends = [scenario.speed_at(0.0), scenario.speed_at(1.0)]
    fast = ScheduledSystem(ends, [loop_at(speed) for speed in ends])
    for letter in "ABCD":  # gyroscopic forces make the loop affine in the speed
        middle, between = (getattr(at(sum(ends) / 2), letter) for at in (loop_at, fast))
        np.testing.assert_allclose(between, middle, rtol=0, atol=1e-9 * np.abs(middle).max())
    trace = linear.run(fast, scenario, mass=68.9, outputs=["y_A_zeta", "y_B_eta"])
    assert (
        trace.outcome == "completed"
        and trace.speed_error < 1e-3
        and peaks(trace)["y_A_zeta"] < 8e-6
    )


def test_a_trace_shows_itself():
    trace = linear.run(
        fake_loop(0.1, 0.0, 1e-3), Scenario("x", 0.1, pulses=(Pulse("f_A_zeta", 1.0, 0.0, 1e-3),))
    )
    assert repr(trace).startswith(
        "Trace(scenario=x, outcome=completed, stable=True, duration=0.1 s, largest_displacement_0p="
    )
    assert len(repr(trace)) < 200
    assert "<table>" in trace._repr_html_()
    plain = json.loads(json.dumps(trace.to_dict(), allow_nan=False))
    assert plain["peaks_0p"] == peaks(trace)
    assert plain["pole"] == [trace.pole.real, trace.pole.imag]


def test_a_trace_as_a_frame():
    pytest.importorskip("pandas")
    trace = linear.run(
        fake_loop(0.1, 0.0, 1e-3), Scenario("x", 0.1, pulses=(Pulse("f_A_zeta", 1.0, 0.0, 1e-3),))
    )
    frame = trace.to_frame()
    assert len(frame) == len(trace.record.time)
    np.testing.assert_array_equal(frame["y_A_zeta [m]"], trace.record["y_A_zeta"])
