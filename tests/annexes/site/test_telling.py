"""Lines that tell nothing of a limit: which, where they are, and that a hidden peak is no pass."""

import numpy as np
import pytest

from ambrose.annexes.site.acceptance import judged_reach, share, silent_bands, telling, where

HERTZ = 2 * np.pi


def test_noise_beyond_a_third_of_the_way_to_the_limit_tells_nothing():
    value, noise = np.array([1.6, 1.6, 164.0, 9.0]), np.array([0.6, 0.7, 403.0, 2.0])
    assert telling(value, noise, 3.0).tolist() == [True, False, False, True]
    assert telling(value, noise, None).tolist() == telling(value, noise, 3.0).tolist()
    assert telling(value, noise, 2.0).tolist() == [False, False, False, True]

    # a value that noise alone reaches is none
    assert telling(value, noise, 3.0, np.array([0.0, 0.0, 0.0, 4.0]))[3].item() is False


def test_noise_alone_hardly_stands_out():
    """Of a circular error with 20 degrees of freedom, its own half-width estimated."""
    rng = np.random.default_rng(0)
    count, freedom = 400_000, 40
    error = np.hypot(*rng.standard_normal((2, count)))
    half = 2.021 * np.sqrt(rng.chisquare(freedom, count) / freedom)
    told = telling(10 * error, 10 * half, 3.0)
    expected = (1 + (3 * 2.021) ** 2 / freedom) ** (-freedom / 2)
    assert told.mean() < 4 * expected + 3 / count


def test_bands_are_named_the_widest_first_in_their_order():
    omega = HERTZ * np.arange(10.0, 110.0, 10.0)
    told = np.ones(10, bool)
    assert where(omega, told) == "" and share(omega, told) == 1
    told[[1, 2, 5]] = False
    ends = np.array([[20.0, 30.0], [60.0, 60.0]])
    np.testing.assert_allclose(silent_bands(omega, told), HERTZ * ends)
    assert where(omega, told) == "20 to 30 Hz, 60 Hz" and share(omega, told) == pytest.approx(0.7)
    told[:] = [0, 1] * 5
    assert where(omega, told).endswith("and 2 more")


def test_a_hidden_peak_fails_however_narrow_the_gap():
    omega = HERTZ * np.arange(1.0, 101.0)
    predicted = np.ones((100, 2))
    predicted[40] = 2.0
    told = np.ones((100, 2), bool)
    assert judged_reach(["a", "b"], omega, told, predicted, [3.0, None]).passed is True
    told[70, 1] = False
    apart = judged_reach(["a", "b"], omega, told, predicted, [3.0, None])
    assert apart.passed is True and "b: excite there: 71 Hz" in apart.detail
    told[40, 0] = False
    hidden = judged_reach(["a", "b"], omega, told, predicted, [3.0, None])
    assert (
        hidden.passed is False and "predicted peak of a at 41 Hz is not measured" in hidden.detail
    )

    # one that is far below its limit hides nothing
    assert judged_reach(["a", "b"], omega, told, predicted, [4.5, 3.0]).passed is True
    told[:20] = False
    assert judged_reach(["a", "b"], omega, told, predicted, [4.5, 3.0]).passed is False
