import numpy as np
import pytest

from ambrose.core.frequency import peak_gains


def summed(increment, B, steps):
    """The definition, term by term."""
    total, response = np.zeros_like(B), B.copy()
    A = np.eye(len(B)) + increment
    for _ in range(steps):
        total += np.abs(response)
        response = A @ response
    return total


@pytest.mark.parametrize("a", [0.5, -0.5, 0.999, 0.0])
def test_one_state_is_exact(a):
    found = peak_gains(np.array([[a - 1]]), np.array([[2.0, -3.0]]))
    assert found == pytest.approx(np.array([[2.0, 3.0]]) / (1 - abs(a)))


def test_a_slow_pole_keeps_its_digits():
    assert peak_gains(np.array([[-1.5e-13]]), np.array([[1.0]]))[0, 0] == pytest.approx(
        1 / 1.5e-13, rel=1e-12
    )


@pytest.mark.parametrize("radius", [0.3, 0.9, 0.999, 0.9998])
@pytest.mark.parametrize("angle", [0.01, 0.3, 2.0, 3.1])
def test_a_rotation_is_bounded_tightly(radius, angle):
    c, s = radius * np.cos(angle), radius * np.sin(angle)
    increment, B = np.array([[c - 1, s], [-s, c - 1]]), np.array([[1.0, 0.3], [0.5, -2.0]])
    found, exact = peak_gains(increment, B), summed(increment, B, int(25 / (1 - radius)))
    assert (found >= exact * (1 - 1e-9)).all()
    assert (found <= 1.6 * exact).all()


@pytest.mark.parametrize("steps", [1, 10, 5000, 20_000])
@pytest.mark.parametrize("a", [1.0, 0.9999, 1.0005])
def test_finite_time(steps, a):
    found = peak_gains(np.array([[a - 1]]), np.array([[1.0]]), steps)
    assert found[0, 0] == pytest.approx(np.sum(a ** np.arange(steps)), rel=1e-9)


def test_a_random_block_of_three():
    rng = np.random.default_rng(0)
    A = rng.normal(0, 1, (3, 3))
    A *= 0.9995 / np.abs(np.linalg.eigvals(A)).max()
    B = rng.normal(0, 1, (3, 2))
    found, exact = peak_gains(A - np.eye(3), B), summed(A - np.eye(3), B, 60_000)
    assert (found >= exact * (1 - 1e-9)).all()
    assert (found <= 2 * exact).all()


def test_unstable_and_marginal_are_infinite():
    assert np.isinf(peak_gains(np.array([[0.0]]), np.array([[1.0]]))).all()
    assert np.isinf(peak_gains(np.array([[0.0, 1.0], [0.0, 0.0]]), np.ones((2, 1)))).all()
    assert (peak_gains(np.array([[0.0, 1.0], [0.0, 0.0]]), np.zeros((2, 1))) == 0).all()


def test_a_slow_state_in_large_units_is_summed_to_its_end():
    """Beside a fast one of order 1 its sum 1e-19/(1 - 0.99999) ended after a batch of samples."""
    B = np.diag([1.0, 1e-19])
    found = peak_gains(np.diag([-0.9, -1e-5]), B)
    assert np.diag(found) * [0.9, 1e14] == pytest.approx(np.ones(2), rel=1e-6)


def test_a_state_that_forgets_at_once():
    """A pole at z = 0 exactly, as Tustin makes of a lag of half a sample (munich-rig's derivative):
    one sample's input is all that it holds, and no logarithm of zero on the way.
    """
    with np.errstate(all="raise"):
        for steps in (1.0, 5.0, np.inf):
            assert peak_gains(np.array([[-1.0]]), np.array([[3.0]]), steps) == pytest.approx(3.0)
