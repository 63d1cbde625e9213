"""Vector fitting: exact recovery, stability, scales, realisations."""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.rational_fit import fit_on_poles, fit_rational

OMEGA = np.geomspace(1.0, 1000.0, 60)


def random_functions(rng, pairs, reals, count, unit=1.0):
    upper = -rng.uniform(0.5, 100, pairs) + 1j * rng.uniform(3, 900, pairs)
    poles = np.concatenate([upper, upper.conj(), -rng.uniform(2, 500, reals)]) * unit
    r = rng.normal(size=(count, pairs)) + 1j * rng.normal(size=(count, pairs))
    residues = np.concatenate([r, r.conj(), rng.normal(size=(count, reals))], axis=1) * np.abs(
        poles
    )
    return poles, residues, rng.normal(size=count)


def values(poles, residues, constant, omega):
    return residues @ (1 / (1j * omega - poles[:, None])) + constant[:, None]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("unit", [1.0, 1e4])
def test_recovers_a_rational_function(seed, unit):
    rng = np.random.default_rng(seed)
    poles, residues, constant = random_functions(rng, 2, 1, 3, unit)
    H = values(poles, residues, constant, OMEGA * unit)
    fit = fit_rational(OMEGA * unit, H, 5)
    assert fit.error.max() < 1e-8
    np.testing.assert_allclose(np.sort_complex(fit.poles), np.sort_complex(poles), rtol=1e-5)
    between = np.sqrt(OMEGA[1:] * OMEGA[:-1]) * unit
    exact = values(poles, residues, constant, between)
    np.testing.assert_allclose(fit.response(between), exact, atol=1e-7 * np.abs(exact).max())


def test_slope_is_recovered():
    H = 3 + 2e-3j * OMEGA + 50 / (1j * OMEGA + 20)
    fit = fit_rational(OMEGA, H, 1, slope=True)
    assert (fit.slope[0], fit.constant[0], fit.poles[0].real) == pytest.approx(
        (2e-3, 3, -20), rel=1e-8
    )


@pytest.mark.parametrize("order", range(1, 9))
def test_poles_are_stable_whatever_the_data(order):
    """Noise, an unstable function and a pure delay: nothing that stable poles fit exactly."""
    rng = np.random.default_rng(order)
    noise = rng.normal(size=60) + 1j * rng.normal(size=60)
    H = np.array([noise, 1 / (1j * OMEGA - 30), np.exp(-0.01j * OMEGA)])
    fit = fit_rational(OMEGA, H, order)
    assert (fit.poles.real < 0).all()
    assert len(fit.poles) == order
    assert np.isfinite(fit.error).all()


def test_more_poles_fit_a_smooth_function_better():
    """sqrt(1 + s/10), not rational: the error falls by more than three per pole."""
    H = np.sqrt(1 + 1j * OMEGA / 10)
    errors = [fit_rational(OMEGA, H, order, slope=True).error[0] for order in (1, 3, 5, 7)]
    assert (np.array(errors[1:]) < np.array(errors[:-1]) / 9).all(), errors


def test_real_form_is_the_function():
    rng = np.random.default_rng(3)
    H = values(*random_functions(rng, 2, 2, 2), OMEGA)
    fit = fit_rational(OMEGA, H, 6)
    A, b, C = fit.real_form()
    by_state = [C @ np.linalg.solve(1j * w * np.eye(6) - A, b) + fit.constant for w in OMEGA]
    np.testing.assert_allclose(np.array(by_state).T, fit.response(OMEGA), rtol=1e-9)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(A)), np.sort_complex(fit.poles), rtol=1e-9
    )


def test_given_poles_are_kept_and_the_rest_is_the_best_on_them():
    """On the poles of a fit the fit comes back; on others' the error is that of linear least
    squares, larger.
    """
    H = np.array([1 / (1 + 1j * OMEGA / 20) + 3, 5 / (4 + 1j * OMEGA)])
    fit = fit_rational(OMEGA, H, 2)
    again = fit_on_poles(OMEGA, H, fit.poles)
    np.testing.assert_allclose(again.response(OMEGA), fit.response(OMEGA), rtol=1e-9)
    other = fit_on_poles(OMEGA, H, [-7.0, -50.0])
    assert other.poles.tolist() == [-7.0, -50.0]
    assert other.error.max() > 1e3 * again.error.max()
    basis = np.column_stack([1 / (1j * OMEGA + 7), 1 / (1j * OMEGA + 50), np.ones_like(OMEGA)])
    rows, right = np.vstack([basis.real, basis.imag]), np.concatenate([H[0].real, H[0].imag])
    best = basis @ np.linalg.lstsq(rows, right, rcond=None)[0]
    np.testing.assert_allclose(other.response(OMEGA)[0], best, rtol=1e-8)


@pytest.mark.parametrize(
    ("omega", "data", "order", "words"),
    [
        ([0.0, 1.0, 2.0], [1, 1, 1], 1, "omega"),
        ([2.0, 1.0, 3.0], [1, 1, 1], 1, "ascending"),
        ([1.0, 2.0, 3.0], [1, 1], 1, "data"),
        ([1.0, 2.0, 3.0], [1, np.nan, 1], 1, "data"),
        ([1.0, 2.0, 3.0], [1, 1, 1], 0, "order"),
        ([1.0, 2.0, 3.0], [1, 1, 1], 3, "order"),
        ([1.0, 2.0, 3.0], [[[1, 1, 1]]], 1, "data"),
    ],
)
def test_bad_input(omega, data, order, words):
    with pytest.raises(InvalidInput, match=words):
        fit_rational(omega, data, order)


def test_noise_that_is_stated_does_not_split_a_peak():
    """A mode of damping 0.005 with noise of 1 % of every value, which is largest at its peak:
    fitted over the largest value, other poles stand there; over the noise, one."""
    rng = np.random.default_rng(5)
    omega = np.unique(np.concatenate([OMEGA, 300 + 3 * np.linspace(-6, 6, 36)]))
    exact = 1 / (300.0**2 - omega**2 + 2j * 0.005 * 300 * omega) + 1e-6
    H = exact * (1 + 0.01 * rng.normal(size=(2, len(omega))).T @ np.array([1, 1j]) / np.sqrt(2))
    poles = fit_rational(omega, H, 8, noise=0.01 * np.abs(exact)).poles
    upper = poles[poles.imag > 0]
    nearest = upper[np.argmin(np.abs(upper - 300j))]
    assert abs(np.abs(nearest) / 300 - 1) < 1e-4
    assert -nearest.real / np.abs(nearest) == pytest.approx(0.005, rel=0.05)
    assert (np.abs(np.log(np.abs(upper[upper != nearest]) / 300)) > 0.03).all()
