"""The straight line against scipy's, and its bands against Monte Carlo."""

import numpy as np
import pytest
import scipy.stats

from ambrose.core.checks import InvalidInput
from ambrose.identification.seal.by_pressure import fit_line


def test_line_is_that_of_scipy_and_its_bands_hold():
    rng = np.random.default_rng(4)
    x = np.linspace(1, 9, 12)
    y = 3 - 2 * x + rng.standard_normal(12)
    ours, theirs = fit_line(x, y), scipy.stats.linregress(x, y)
    assert ours.slope == pytest.approx(theirs.slope, rel=1e-12)
    assert ours.intercept == pytest.approx(theirs.intercept, rel=1e-12)
    assert np.sqrt(ours.covariance[1, 1]) == pytest.approx(theirs.stderr, rel=1e-12)
    assert np.sqrt(ours.covariance[0, 0]) == pytest.approx(theirs.intercept_stderr, rel=1e-12)
    assert ours.slope_probability == pytest.approx(theirs.pvalue, rel=1e-9)
    assert ours.r_squared == pytest.approx(theirs.rvalue**2, rel=1e-12)
    held, next_held = 0, 0
    for _ in range(2000):
        again = fit_line(x, 3 - 2 * x + rng.standard_normal(12))
        held += abs(again.at(5.5) - (3 - 11)) < again.confidence(5.5)
        next_held += abs(again.at(12.0) - (3 - 24 + rng.standard_normal())) < again.prediction(12.0)
    assert held / 2000 == pytest.approx(0.95, abs=0.015)
    assert next_held / 2000 == pytest.approx(0.95, abs=0.015)


def test_line_with_known_deviations_and_through_the_origin():
    x = np.array([1.0, 2.0, 3.0, 4.0])
    sd = np.array([0.1, 0.1, 0.1, 10.0])
    line = fit_line(x, [1.0, 2.0, 3.0, 40.0], sd)  # the last point hardly counts
    assert line.slope == pytest.approx(1.0, abs=0.02)
    assert line.scatter > 1  # 36 / 10 off
    calm = fit_line(x, x, sd)
    assert calm.scatter == 1.0
    assert calm.deviation(2.0) == pytest.approx(0.1 / np.sqrt(3), rel=0.01)
    origin = fit_line(x, 2 * x, through_origin=True)
    assert origin.intercept == 0
    assert origin.slope == pytest.approx(2)
    assert origin.deviation(0.0) == 0
    for bad in ({"x": [1.0, 1.0, 1.0], "y": [1.0, 2.0, 3.0]}, {"x": [1.0, 2.0], "y": [1.0, 2.0]}):
        with pytest.raises(InvalidInput, match="points of a line"):
            fit_line(**bad)
    with pytest.raises(InvalidInput, match="positive"):
        fit_line(x, x, [0.1, 0.1, 0.1, 0.0])
    with pytest.raises(InvalidInput, match="level"):
        line.confidence(1.0, 1.5)


def test_each_point_against_the_line_through_the_others():
    rng = np.random.default_rng(8)
    x, sd = np.array([0.0, 1.0, 2.0, 4.0, 5.0]), np.array([0.1, 0.2, 0.1, 0.3, 0.1])
    y = 1 + 2 * x + sd * rng.standard_normal(5)
    for i, apart in enumerate(fit_line(x, y, sd).apart):
        kept = np.arange(5) != i
        rest = fit_line(x[kept], y[kept], sd[kept])
        expected = (y[i] - rest.at(x[i])) / np.hypot(sd[i], rest.deviation(x[i]) / rest.scatter)
        assert apart == pytest.approx(float(expected), rel=1e-9)
    all_of = np.array(
        [fit_line(x, 1 + 2 * x + sd * rng.standard_normal(5), sd).apart for _ in range(4000)]
    )
    np.testing.assert_allclose(all_of.std(axis=0), 1.0, atol=0.04)
    alone = fit_line([0.0, 0.0, 3.0], [1.0, 1.2, 9.0], [0.1, 0.1, 0.1])
    assert alone.apart[2] == 0  # without it there is no line
