"""Repeats, their intervals, and predicted against observed scatter."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy.stats
from benchmarks.scatter_study import deviation_factors, scatter_study, study

from ambrose.core.checks import InvalidInput
from ambrose.identification.validation.repeatability import of_estimates, repeats

PATHS = ("bearing.A.force_per_current.zeta", "amplifier.eddy_bandwidth")


def estimate(values, deviations, paths=PATHS):
    return SimpleNamespace(
        paths=paths,
        values=np.array(values, dtype=float),
        standard_deviations=np.array(deviations, dtype=float),
    )


def test_five_repeats_by_hand():
    """Student's t for 4 degrees at 95 % is 2.776; chi-square gives 0.599 s to 2.874 s for the
    deviation.
    """
    values = np.array([[100.0, 3.0], [102.0, 3.0], [98.0, 3.1], [101.0, 2.9], [99.0, 3.0]])
    found = repeats(PATHS, values)
    assert found.count == 5
    np.testing.assert_allclose(found.mean, [100.0, 3.0])
    np.testing.assert_allclose(found.deviation[0], np.sqrt(10 / 4))
    np.testing.assert_allclose(found.rsd[0], np.sqrt(2.5))
    np.testing.assert_allclose(found.half_width[0], 2.7764451 * np.sqrt(2.5 / 5), rtol=1e-7)
    np.testing.assert_allclose(deviation_factors(found.count), [0.5991, 2.8736], rtol=1e-4)
    assert np.isnan(found.predicted).all()


def test_intervals_against_scipy_stats():
    rng = np.random.default_rng(1)
    values = rng.normal(5.0, 2.0, (7, 2))
    found = repeats(PATHS, values, level=0.9)
    for i in range(2):
        low, high = scipy.stats.t.interval(
            0.9, 6, values[:, i].mean(), scipy.stats.sem(values[:, i])
        )
        np.testing.assert_allclose(
            [found.mean[i] - found.half_width[i], found.mean[i] + found.half_width[i]], [low, high]
        )
    low, high = deviation_factors(7, 0.9)
    np.testing.assert_allclose([6 / low**2, 6 / high**2], scipy.stats.chi2.ppf([0.95, 0.05], 6))


def test_the_intervals_hold_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(2)
    inside = []
    for _ in range(2000):
        found = repeats(PATHS, rng.normal([10.0, -4.0], [1.0, 3.0], (5, 2)))
        low, high = (
            factor * found.deviation for factor in deviation_factors(found.count, found.level)
        )
        inside.append(
            [
                np.abs(found.mean - [10.0, -4.0]) < found.half_width,
                (low < [1.0, 3.0]) & (high > [1.0, 3.0]),
            ]
        )
    np.testing.assert_allclose(np.mean(inside, axis=0), 0.95, atol=0.015)


def test_a_mean_of_zero_has_no_relative_deviation():
    assert np.isnan(repeats(("a",), [[-1.0], [1.0]]).rsd[0])


def experiments(runs, stated):
    """Scatter (0.5, 0.01) around the truth (200, 3), with the deviations stated."""

    def one(seed):
        rng = np.random.default_rng(seed)
        return estimate(
            [200 + 0.5 * rng.standard_normal(), 3 + 0.01 * rng.standard_normal()], stated
        )

    return scatter_study(one, runs, (200.0, 3.0))


def test_a_right_prediction_passes_and_a_wrong_one_is_named():
    right = experiments(200, (0.5, 0.01))
    assert ((right.ratio > right.ratio_range[0]) & (right.ratio < right.ratio_range[1])).all()
    assert "outside" not in right.verdict and (np.abs(right.bias) < 3).all()
    np.testing.assert_allclose(right.covered, 0.95, atol=0.04)
    wrong = experiments(200, (0.25, 0.01))  # half the truth, as a white-noise covariance is
    np.testing.assert_allclose(wrong.ratio[0], 0.5, rtol=0.15)
    assert wrong.covered[0] < 0.75
    assert "outside are 1, the worst bearing.A.force_per_current.zeta" in wrong.verdict


def test_progress_and_bias():
    told = []
    moved = scatter_study(
        lambda seed: estimate([np.random.default_rng(seed).normal(1.2, 0.1)], [0.1], ("a",)),
        20,
        [1.0],
        progress=told.append,
    )
    assert told == list(range(1, 21)) and moved.bias[0] > 5


def test_bad_input():
    with pytest.raises(
        InvalidInput, match=r"number of repeats is 1, but must be at least 2.*repeat it"
    ):
        repeats(PATHS, [[1.0, 2.0]])
    with pytest.raises(InvalidInput, match="shape of values"):
        repeats(PATHS, [[1.0], [2.0]])
    with pytest.raises(InvalidInput, match="level is 95"):
        repeats(PATHS, [[1.0, 2.0]] * 2, level=95)
    with pytest.raises(InvalidInput, match="no experiment"):
        of_estimates([])
    with pytest.raises(
        InvalidInput, match=r"parameters of experiment 2 is other.*identify the same"
    ):
        of_estimates([estimate([1, 2], [1, 1]), estimate([1], [1], ("other",))])
    with pytest.raises(InvalidInput, match="runs is 5"):
        experiments(5, (1.0, 1.0))
    with pytest.raises(InvalidInput, match="no scatter at all"):
        study([estimate([1, 2], [1, 1])] * 3, [1.0, 2.0])
