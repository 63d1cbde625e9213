"""Least squares, its statistics and its sensitivities on small problems with known answers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.response import SystemDerivative
from ambrose.core.statespace import StateSpace
from ambrose.identification.findings import Code
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.normal_equations import Linearised, distinct, minimise
from whole_records import (
    fit_percent,
    lifted_sensitivities,
    residual_input_test,
    sandwich_middle,
    simulate_derivative,
)


@pytest.mark.parametrize(("m", "k"), [(1, 1), (1, 64), (1, 333), (3, 200)])
def test_lifted_sensitivities_are_those_of_the_core(m, k):
    rng = np.random.default_rng(k)
    A = rng.standard_normal((6, 6))
    A *= 0.97 / np.abs(np.linalg.eigvals(A)).max()
    system = StateSpace(
        A, rng.standard_normal((6, m)), rng.standard_normal((2, 6)), np.zeros((2, m)), dt=1e-3
    )
    directions = [
        SystemDerivative(
            rng.standard_normal((6, 6)),
            rng.standard_normal((6, m)),
            np.zeros((2, 6)),
            np.zeros((2, m)),
        )
        for _ in range(3)
    ]
    u, x0 = rng.standard_normal((m, k)), rng.standard_normal(6)
    y, J = simulate_derivative(system, directions, u, x0=x0)
    found, found_J = lifted_sensitivities(system, directions, u, x0)
    np.testing.assert_allclose(found, y, rtol=0, atol=1e-12 * np.abs(y).max())
    np.testing.assert_allclose(found_J, J, rtol=0, atol=1e-12 * max(np.abs(J).max(), 1))


def test_equal_and_opposite_excitations_are_one():
    wave, other = np.random.default_rng(0).standard_normal((2, 20))
    e = np.stack([wave, 0 * wave, -wave, other])
    signals, mix = distinct(e)
    assert len(signals) == 2
    np.testing.assert_array_equal(mix @ np.stack(signals), e)


def test_sandwich_knows_the_colour():
    rng = np.random.default_rng(1)
    a, k = 0.9, 200_000
    noise = lfilter([1.0], [1.0, -a], rng.standard_normal((1, k)))
    J = np.stack([lfilter([1.0], [1.0, -0.95], rng.standard_normal(k)), rng.standard_normal(k)])[
        :, None
    ]
    gamma = a ** np.arange(400) / (1 - a * a)
    exact = np.array(
        [
            [
                sum(
                    g * (1 + (i > 0)) * (x[i:] @ z[: k - i] + z[i:] @ x[: k - i]) / 2
                    for i, g in enumerate(gamma)
                )
                for x in J[:, 0]
            ]
            for z in J[:, 0]
        ]
    )
    middle = sandwich_middle(J, noise)
    size = np.sqrt(np.diag(exact))
    np.testing.assert_allclose(
        middle / size / size[:, None], exact / size / size[:, None], atol=0.05
    )
    white = (J[0, 0] @ J[0, 0]) / (1 - a * a)
    assert exact[0, 0] > 5 * white  # sigma^2 J'J would be far too sure


def test_sandwich_is_the_toeplitz_sum():
    rng = np.random.default_rng(2)
    J, r = rng.standard_normal((3, 2, 60)), rng.standard_normal((2, 60))
    span = 6
    x = np.arange(span + 1) / span
    taper = np.where(x <= 0.5, 1 - 6 * x**2 + 6 * x**3, 2 * (1 - x) ** 3)
    window = toeplitz(np.append(taper, np.zeros(60 - span - 1)))
    total = np.zeros((3, 3))
    for i in range(2):
        for j in range(2):
            lags = np.correlate(r[i], r[j], "full") / 60  # r_i(t + l) r_j(t), l = -59..59
            gamma = np.array([[lags[59 + t - s] for s in range(60)] for t in range(60)])
            total += J[:, i] @ (gamma * window) @ J[:, j].T
    np.testing.assert_allclose(sandwich_middle(J, r), total, atol=1e-10 * np.abs(total).max())


def test_correlation_and_cosine_have_opposite_signs():
    J = np.array([[1.0, 0.0, 0.0], [-0.8, 0.6, 0.0]])
    assert statistics.column_cosine(J @ J.T)[0, 1] == pytest.approx(-0.8)
    assert statistics.parameter_correlation(J @ J.T)[0, 1] == pytest.approx(0.8)


def test_twins_are_named():
    J = np.array([[1.0, 2.0, 0.0], [0.5, 1.0, 0.0], [0.0, 1.0, 1.0]])
    with pytest.raises(InvalidInput, match="cannot tell a from b; excite where they differ"):
        statistics.check_visible("abc", J @ J.T, np.ones(3))
    with pytest.raises(InvalidInput, match="do not determine b"):
        statistics.check_visible("ab", np.diag([1.0, 0.0]), np.ones(2))
    statistics.check_visible("ac", J[[0, 2]] @ J[[0, 2]].T, np.array([1e3, 1e-3]))


def test_fit_percent():
    y = np.sin(np.arange(1000))
    assert fit_percent(y + 7, 0.1 * (y - y.mean())) == pytest.approx(90)


def test_residual_input_test_finds_what_is_there_and_nothing_else():
    k, false = 5000, 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        e = np.repeat(np.sign(rng.standard_normal(k // 10)), 10)
        noise = lfilter([1.0], [1.0, -0.9], rng.standard_normal(k))
        false += not residual_input_test(noise, 30 * noise, e, 100, "y", "e").passed
        if seed < 5:
            late = noise + np.roll(e, 17)
            found = residual_input_test(late, 30 * noise, e, 100, "y", "e")
            assert not found.passed and abs(found.lag - 17) <= 2
    assert false <= 5  # at 99 %: one is expected


def rosenbrock(x):
    r = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])
    J = np.array([[20 * x[0], -10.0], [1.0, 0.0]])  # of the model: r = y - model
    return Linearised(float(r @ r), J.T @ J, J.T @ r)


def test_minimise_reaches_the_bottom_of_the_valley():
    found = minimise(rosenbrock, np.array([-1.2, 1.0]), np.ones(2), lambda _: True)
    np.testing.assert_allclose(found.x, [1, 1], rtol=1e-8)
    assert found.converged


def test_the_guard_is_never_passed():
    seen = []

    def watched(x):
        seen.append(x)
        return rosenbrock(x)

    found = minimise(watched, np.array([-1.2, 1.0]), np.ones(2), lambda x: bool(x[0] < 0.5))
    assert all(x[0] < 0.5 for x in seen) and found.refused > 0 and found.x[0] < 0.5


def test_a_parameter_without_effect_is_named():
    with pytest.raises(NumericalFailure, match="parameter number 2"):
        minimise(
            lambda _: Linearised(1.0, np.diag([1.0, 0.0]), np.zeros(2)),
            np.ones(2),
            np.ones(2),
            lambda _: True,
        )


@pytest.mark.parametrize(("deviation", "told"), [(0.001, False), (0.1, True)])
def test_a_correlation_matters_where_it_makes_a_value_unsure(deviation, told):
    """K_i and K_s of one axis are correlated by 0.99 in every good record, and still known to 0.1
    %.
    """
    correlation = np.array([[1.0, 0.99], [0.99, 1.0]])
    minimum = SimpleNamespace(converged=True, iterations=3, x=np.ones(2))
    found = statistics.warnings_of(
        ("a", "b"), minimum, deviation**2 * correlation, correlation, (), ""
    )
    assert [item.code for item in found] == [Code.CORRELATED] * told


@pytest.mark.parametrize(("factor", "passed"), [(0.5, True), (1.5, False)])
def test_a_test_says_from_where_on_it_sees(factor, passed):
    """A response that the model lacks, of the signal's own course, by the share that the test
    names.
    """
    rng = np.random.default_rng(5)
    e, noise = rng.standard_normal((2, 20_000))
    y = lfilter([0.1], [1.0, -0.9], e)

    def tested(residual):
        sums = [
            np.correlate(a, b, "full")[19_999:20_100]
            for a, b in ((residual, e), (residual, residual), (e, e), (y, e))
        ]
        return statistics.input_test(*sums[:3], 20_000, "y", "e", 1, response=np.abs(sums[3]).max())

    share = tested(0.01 * noise).visible
    assert 1e-3 < share < 0.1 and tested(0.01 * noise + factor * share * y).passed == passed
    assert tested(0.01 * noise).passed and tested(0.1 * noise).visible == pytest.approx(
        10 * share, rel=1e-6
    )


def test_tests_that_would_have_seen_nothing_are_a_doubt():
    """A rotor that turns and is not told so: every test passes, whatever the model lacks."""
    minimum = SimpleNamespace(converged=True, iterations=3, x=np.ones(1))
    tests = [statistics.ResidualTest("y", "e", 0.0, 0.1, 0, True, share) for share in (0.3, 0.2)]
    for chosen, blind in (
        (tests, True),
        ([*tests, replace(tests[0], signal="z", visible=0.01)], False),
    ):
        found = list(
            statistics.warnings_of(("a",), minimum, 1e-6 * np.eye(1), np.eye(1), chosen, "")
        )
        assert [item.code for item in found] == [Code.BLIND] * blind
    assert statistics.power_of(tests) == {
        "y": 0.2
    } and "from 20 to 20 % of a response" in statistics.verdict_of(tests)
