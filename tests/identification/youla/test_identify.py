"""The Youla residual of records of known machines: signals, exact recovery, scatter, comparison
with closed_loop, bad input.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput, UnstableSystem
from ambrose.core.frequency import frequency_response
from ambrose.core.realisation import coprime_factors, injection_gain, observer_controller
from ambrose.core.response import impulse_response, simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, is_stable, select
from ambrose.identification import frf_spectral as frf, youla
from ambrose.identification.output_error import closed_loop as whole_loop
from ambrose.identification.parameters import nominal_values, update_machine
from ambrose.identification.youla import finite_response, sampled_residual
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop, match_controller
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Tolerance
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.record.record import Record
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Prbs, Scenario
from coarse import coarse
from whole_records import simulate_derivative

DT = 1e-4
PATH = "bearing.B.negative_stiffness.eta"
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
Y, U, E, D = ([f"{kind}_{axis}" for axis in AXES] for kind in "yued")


@cache
def machine():
    return coarse("turboexpander")


@cache
def plant():
    return free_mode_reduction(
        assemble(machine(), operating_point(machine(), "nominal speed without seal")), 0
    )


@cache
def controller():
    return pid_controller(machine().controller, machine())


@cache
def loop(theta=0.5):
    """The loop of the machine with a bearing stiffness reduced by the share ``theta``, from an
    independent assembly.
    """
    moved = perturbed(plant(), {PATH: -theta}, [Tolerance(PATH, relative=1.0)])
    return closed_loop(moved, c2d(controller(), DT, "tustin", delay=DT))


def sequences(k, amplitude=0.3, seed=0):
    return amplitude * np.sign(np.random.default_rng(seed).standard_normal((4, k)))


def record(k=2000, theta=0.5, noise=0.0, seed=0, skip=0, amplitude=0.3):
    e = sequences(k, amplitude)
    y = simulate(select(loop(theta), E, Y + U), e)
    if noise:
        y = y + simulate(
            select(loop(theta), D, Y + U),
            noise * np.random.default_rng([1, seed]).standard_normal((4, k)),
        )
    values = np.vstack([y, e])[:, skip:]
    return Record(
        "turboexpander", 1 / DT, (*Y, *U, *E), ("m",) * 4 + ("A",) * 8, values, plant().point
    )


def identify(records, unknown=(PATH,), **options):
    return youla.identify(machine(), records, controller(), unknown, bending_modes=0, **options)


def share(result):
    """theta: by how much the stiffness found is below the machine's."""
    return 1 - result.estimate.values[0] / nominal_values(plant(), [PATH])[0]


@cache
def factors():
    return youla.sampled_factors(
        plant(), match_controller(c2d(controller(), DT, "tustin", delay=DT), plant())
    )[0]


def test_alpha_is_free_of_the_noise_and_eps_is_its_response_through_s():
    quiet, loud = record(), record(noise=1e-6)
    one, other = (youla.residual_signals(factors(), r) for r in (quiet, loud))
    alpha, eps = factors().alpha, factors().eps
    np.testing.assert_array_equal(one.select(alpha).values, other.select(alpha).values)
    S = identify(quiet).residual
    assert is_stable(S)
    expected = simulate(S, one.select(alpha).values)
    assert np.abs(one.select(eps).values - expected).max() < 1e-8 * np.abs(expected).max()
    # the plant's factors see nothing where the machine is the one modelled
    same = youla.residual_signals(factors(), record(theta=0.0)).select(eps).values
    assert np.abs(same).max() < 1e-9 * np.abs(record(theta=0.0).select(Y).values).max()
    # alpha may as well be made of what was measured: V~ v - U~ y
    v, y = loud.select(U).values + loud.select(E).values, loud.select(Y).values
    observed = simulate(select(factors().left, outputs=alpha), np.vstack([v, y]))
    assert np.abs(observed - other.select(alpha).values).max() < 1e-10


def test_white_sensor_noise_is_white_in_eps_of_the_machine_as_modelled():
    eps = (
        youla.residual_signals(factors(), record(20000, theta=0.0, noise=1e-6))
        .select(factors().eps)
        .values[:, 500:]
    )
    covariance = youla.sampled_factors(
        plant(), match_controller(c2d(controller(), DT, "tustin", delay=DT), plant())
    )[1]
    W = np.linalg.inv(np.linalg.cholesky(covariance))
    white = W @ eps / 1e-6
    np.testing.assert_allclose(np.cov(white), np.eye(4), atol=0.05)
    for lag in range(1, 30):
        assert np.abs(white[:, lag:] @ white[:, :-lag].T / white.shape[1]).max() < 5 / np.sqrt(
            white.shape[1]
        )


def test_model_of_s_and_its_jacobian():
    paths = (PATH, "bearing.A.force_per_current.zeta", "amplifier.bandwidth")
    nominal = nominal_values(plant(), paths)
    model = sampled_residual(plant(), factors(), paths, nominal, np.eye(4))
    a = sequences(300)
    theta = nominal * [0.6, 1.1, 0.9]
    system, directions = model.loop(theta)
    y, J = simulate_derivative(system, directions, a)
    for j, value in enumerate(nominal):
        h = 1e-4 * value * np.eye(3)[j]
        change = [simulate(model.loop(theta + step * h)[0], a) for step in (2, 1, -1, -2)]
        slope = (-change[0] + 8 * change[1] - 8 * change[2] + change[3]) / (12e-4 * value)
        assert np.abs(J[j] - slope).max() < 1e-8 * np.abs(slope).max()
    assert np.abs(simulate(model.loop(nominal)[0], a)).max() < 1e-9 * np.abs(y).max()


@pytest.mark.parametrize("theta", [-0.1, 0.2, 0.5, 0.8])
def test_recovery_without_noise(theta):
    result = identify(record(theta=theta))
    assert share(result) == pytest.approx(theta, abs=1e-6)
    assert (
        result.estimate.converged
        and not result.estimate.warnings
        and result.controller_error < 1e-9
    )


def test_initial_state_offset_several_records_and_other_parameters():
    later = record(2500, skip=700)
    values = later.values.copy()
    values[:4] += np.array([[3e-6], [-1e-6], [2e-6], [5e-6]])
    assert share(identify(replace(later, values=values))) == pytest.approx(0.5, abs=1e-4)
    assert share(identify(later, offset=False)) == pytest.approx(0.5, abs=1e-6)
    assert abs(share(identify(replace(later, values=values), offset=False)) - 0.5) > 1e-3
    paths = (
        "bearing.*.negative_stiffness.*",
        "bearing.*.force_per_current.*",
        "amplifier.bandwidth",
    )
    result = identify([record(1200), record(1500)], paths)
    nominal = nominal_values(plant(), result.estimate.paths)
    expected = np.where(np.array(result.estimate.paths) == PATH, 0.5, 1.0)
    np.testing.assert_allclose(result.estimate.values / nominal, expected, rtol=1e-5)
    assert update_machine(machine(), result.estimate).name == "turboexpander"


def test_several_starts_find_the_same():
    nominal = nominal_values(plant(), [PATH])[0]
    for factor in (1.3, 1.1, 0.7, 0.4, 0.0, -0.5):
        result = identify(record(1500), start={PATH: factor * nominal})
        assert share(result) == pytest.approx(0.5, abs=1e-6), factor


@pytest.mark.study
def test_scatter_and_predicted_deviation_are_half_those_of_the_whole_loop_method():
    """0.3 A, 1 um of white sensor noise; P1's own experiment has its Monte Carlo study in
    tests/literature/test_p1.py.
    """
    nominal = nominal_values(plant(), [PATH])[0]
    results = [identify(record(1500, noise=1e-6, seed=seed)).estimate for seed in range(30)]
    found = np.array([result.values[0] for result in results]) / nominal
    predicted = np.array([result.standard_deviations[0] for result in results]) / nominal
    scatter = found.std(ddof=1)
    assert abs(found.mean() - 0.5) < 3 * scatter / np.sqrt(30)
    assert 0.7 < np.sqrt(np.mean(predicted**2)) / scatter < 1.4  # 30 runs tell the scatter to 13 %
    other = whole_loop.identify(
        machine(), record(1500, noise=1e-6), controller(), [PATH], bending_modes=0
    )
    assert other.standard_deviations[0] / nominal > 1.5 * scatter


def test_sensors_of_different_noise_are_weighted():
    sizes = np.array([[2e-6], [2e-6], [2e-7], [2e-7]])
    quiet = simulate(select(loop(), E, Y + U), sequences(3000))
    noise = sizes * np.random.default_rng(9).standard_normal((4, 3000))
    values = quiet + simulate(select(loop(), D, Y + U), noise)
    measured = replace(record(3000), values=np.vstack([values, sequences(3000)]))
    known = identify(measured, noise=dict(zip(Y, sizes[:, 0], strict=True))).estimate
    alike = identify(measured).estimate
    assert known.standard_deviations[0] < 0.8 * alike.standard_deviations[0]
    for result in (known, alike):
        error = 1 - result.values[0] / nominal_values(plant(), [PATH])[0] - 0.5
        assert abs(error) * nominal_values(plant(), [PATH])[0] < 3.5 * result.standard_deviations[0]
    with pytest.raises(InvalidInput, match="noise of y_A_eta"):
        identify(measured, noise={"y_A_zeta": 1e-6})


def test_a_controller_that_is_not_quite_the_one_given_does_less_harm():
    """eps is made of the recorded currents; the whole-loop method simulates them."""
    K = controller()
    louder = StateSpace(K.A, K.B, 1.05 * K.C, 1.05 * K.D)
    result = youla.identify(machine(), record(), louder, [PATH], bending_modes=0)
    other = whole_loop.identify(machine(), record(), louder, [PATH], bending_modes=0)
    assert result.controller_error == pytest.approx(0.05, abs=0.01)
    assert "unexplained" in result.estimate.warnings[-1].what
    nominal = nominal_values(plant(), [PATH])[0]
    assert abs(share(result) - 0.5) < 0.06
    assert abs(1 - other.values[0] / nominal - 0.5) > 0.2


def test_response_of_s_without_a_model():
    """H1 from alpha to eps against S(theta) found: within what its own variance says."""
    result = identify(record(20000, noise=2e-7))
    measured = frf.h1(result.signals[0], factors().alpha, factors().eps, segment=0.1)
    expected = frequency_response(result.residual, measured.omega).values
    i = factors().eps.index("eps_y_B_eta"), factors().alpha.index("alpha_u_B_eta")
    strong = measured.omega < 2 * np.pi * 120  # above, S sinks into the noise
    error = np.abs(measured.values - expected)[strong][:, *i]
    assert np.median(error / np.abs(expected)[strong][:, *i]) < 0.1
    assert np.mean(error**2 / measured.variance[strong][:, *i]) < 3


def test_pulse_response_without_a_model_agrees_with_s_and_with_no_other():
    noisy = record(5000, noise=2e-7)
    result = identify(noisy)
    alpha, eps = (
        result.signals[0].select(names).values for names in (factors().alpha, factors().eps)
    )
    free = finite_response(alpha, eps, 150)
    assert free.h.shape == (4, 4, 150) and (free.noise < 1.2 * 2e-7).all()
    # 600 unknowns: its standard deviation is 6 %
    assert (free.disagreement(result.residual) < 1.15).all()
    other = sampled_residual(plant(), factors(), [PATH], nominal_values(plant(), [PATH]), np.eye(4))
    wrong = other.loop(0.7 * nominal_values(plant(), [PATH]))[0]
    assert free.disagreement(wrong).max() > 2
    expected = impulse_response(result.residual, 150)
    score = (free.h - expected) / free.deviation
    assert 0.9 < np.sqrt(np.mean(score**2)) < 1.1
    with pytest.raises(InvalidInput, match="taps"):
        finite_response(alpha, eps, 1500)
    with pytest.raises(InvalidInput, match="does not excite"):
        finite_response(np.vstack([alpha[:3], alpha[:1]]), eps, 50)


def test_nonlinear_rig_under_its_weight():
    """The machine file's coefficients are those under the weight: they are found, not those of a
    magnet without load.
    """
    rig = coarse("seal-rig")
    rig = replace(rig, sensors=tuple(replace(sensor, noise=1e-7) for sensor in rig.sensors))
    model = free_mode_reduction(assemble(rig), 1)
    law = pid_synthesis(model).controller
    waves = tuple(
        Prbs(f"e_{axis}", amplitude=0.1, bit_time=1e-3, seed=i) for i, axis in enumerate(AXES)
    )
    measured = virtual_rig.run(rig, law, Scenario("prbs", 2.0, sequences=waves)).record
    result = youla.identify(rig, measured, law, ["bearing.*.negative_stiffness.*"])
    static = (
        np.array([measured[f"i_{axis}"].mean() for axis in AXES]) / rig.bearings[0].bias_current
    )
    assert result.controller_error < 1e-9 and (static > 0.3).all()
    np.testing.assert_allclose(
        result.estimate.values, nominal_values(model, result.estimate.paths), rtol=0.005
    )


def test_bad_input_of_the_injected_experiment():
    G = select(plant().system, U, Y)
    F, L = injection_gain(G.A.T, G.B.T)[0].T, injection_gain(G.A, G.C)[0]
    f = coprime_factors(G, observer_controller(G, F, L), L, -G.B)
    alpha, eps = sequences(200), 1e-7 * sequences(200, seed=3)
    with pytest.raises(InvalidInput, match="alpha never changes"):
        youla.identify_injected(plant(), f, [PATH], 0 * alpha, eps, 1e-3)
    with pytest.raises(InvalidInput, match="eps"):
        youla.identify_injected(plant(), f, [PATH], alpha, eps[:, :100], 1e-3)
    with pytest.raises(InvalidInput, match="start values is unstable"):
        youla.identify_injected(plant(), f, [PATH], alpha, eps, 1e-3, start={PATH: 10e6})
    with pytest.raises(InvalidInput, match="eps is zero"):
        youla.identify_injected(plant(), f, [PATH], alpha, 0 * eps, 1e-3)


def test_bad_input():
    good = record(400)
    K = controller()
    with pytest.raises(UnstableSystem, match="does not stabilise the plant it is factored with"):
        youla.identify(machine(), good, StateSpace(K.A, -K.B, K.C, -K.D), [PATH], bending_modes=0)
    with pytest.raises(InvalidInput, match="no signal u_A_zeta; the residual needs every command"):
        identify(good.select([*Y, *E]))
    with pytest.raises(InvalidInput, match="has no excitation"):
        identify(replace(good, values=np.vstack([good.values[:8], 0 * good.values[8:]])))
    growing = (
        good.values * np.where(np.arange(12) < 8, 1.0, 0.0)[:, None] * np.exp(np.arange(400) / 60)
    )
    with pytest.raises(InvalidInput, match=r"grows .* times towards its end"):
        identify(replace(good, values=np.vstack([growing[:8], good.values[8:]])))
    with pytest.raises(InvalidInput, match="unknown"):
        identify(good, ["bearing.C.negative_stiffness.eta"])
    with pytest.raises(InvalidInput, match="start values is unstable"):
        identify(good, start={PATH: 20e6})
    with pytest.raises(InvalidInput, match=r"does not explain .* of the recorded currents"):
        identify(replace(good, sample_rate_hz=20000.0))
    with pytest.raises(InvalidInput, match="sample rate"):
        youla.identify(machine(), good, c2d(K, 2 * DT, "tustin"), [PATH], bending_modes=0)
    with pytest.raises(InvalidInput, match="noise"):
        identify(good, noise={"y_C_eta": 1e-6})
    force = Record(
        good.machine,
        good.sample_rate_hz,
        (*good.signals, "f_A_zeta"),
        (*good.units, "N"),
        np.vstack([good.values, good.values[:1]]),
        good.point,
    )
    with pytest.raises(InvalidInput, match="holds the excitation f_A_zeta"):
        identify(force)
