"""The least sensitivity that unstable poles and delay allow, against closed forms and an
independent computation.
"""

import numpy as np
import pytest
import scipy.linalg as sla
from scipy.optimize import brentq

from ambrose.core.aliasing import least_sensitivity
from ambrose.core.checks import InvalidInput


@pytest.mark.parametrize("p_tau", [0.01, 0.1, 0.5, 1.0, 2.0])
def test_one_real_pole_is_the_exponential(p_tau):
    assert least_sensitivity([[p_tau / 3e-4]], [[7.0]], 3e-4) == pytest.approx(
        np.exp(p_tau), rel=1e-6
    )


def by_conjugate_points(poles, tau):
    """The norm of prod (s + p)/(s - p) on L2[0, tau]: the largest gamma at which the boundary value
    problem has a solution.
    """
    A = np.diag(poles)
    C = np.ones((1, len(poles)))
    B = np.linalg.solve(sla.solve_continuous_lyapunov(A.T, C.T @ C), C.T)

    def determinant(gamma):
        r = gamma**2 - 1
        H = np.block([[A + B @ C / r, B @ B.T / r], [-C.T @ C * gamma**2 / r, -(A + B @ C / r).T]])
        n = len(A)
        return np.linalg.det(sla.expm(tau * H)[n:, n:])

    start = np.exp(np.sum(poles) * tau) * 1.05  # sub-multiplicative: no norm lies above
    grid = np.linspace(start, 1.001, 3000)
    values = [determinant(gamma) for gamma in grid]
    k = next(i for i in range(len(grid) - 1) if values[i] * values[i + 1] < 0)
    return brentq(determinant, grid[k + 1], grid[k])


@pytest.mark.parametrize("poles", [(100.0, 250.0), (300.0, 310.0), (50.0, 200.0, 600.0)])
def test_several_poles_seen_by_one_sensor(poles):
    expected = by_conjugate_points(np.array(poles), 1.5e-3)
    found = least_sensitivity(np.diag(poles), np.ones((1, len(poles))), 1.5e-3)
    assert found == pytest.approx(expected, rel=1e-5)
    assert found > np.exp(max(poles) * 1.5e-3)


def test_poles_seen_apart_bind_apart_and_states_do_not_matter():
    A, C = np.diag([100.0, 300.0, -50.0]), np.array([[1.0, 0.0, 2.0], [0.0, 1.0, -1.0]])
    apart = least_sensitivity(A, C, 1e-3)
    assert apart == pytest.approx(np.exp(0.3), rel=1e-6)
    T = np.array([[1.0, 2.0, 0.0], [0.0, 3.0, 1.0], [1.0, 0.0, 1.0]])
    assert least_sensitivity(np.linalg.solve(T, A @ T), C @ T, 1e-3) == pytest.approx(
        apart, rel=1e-6
    )


def test_nothing_binds_a_stable_or_undelayed_loop_and_nothing_holds_what_no_sensor_sees():
    assert least_sensitivity([[-3.0]], [[1.0]], 1.0) == 1.0
    assert least_sensitivity([[300.0]], [[1.0]], 0.0) == 1.0
    assert least_sensitivity([[300.0]], [[0.0]], 1e-4) == np.inf
    assert least_sensitivity([[300.0]], [[1.0]], 1.0) == np.inf
    with pytest.raises(InvalidInput):
        least_sensitivity([[1.0]], [[1.0]], -1.0)


def test_a_controller_comes_near_it_and_none_below():
    """1/(s - p), late: S of K = k is |1/(1 + k e^{-s tau}/(s - p))|; the best gain stays above the
    limit.
    """
    p, tau = 200.0, 1e-3
    omega = np.geomspace(1.0, 1e5, 4000)
    G = np.exp(-1j * omega * tau) / (1j * omega - p)
    peaks = [np.abs(1 / (1 + k * G)).max() for k in np.linspace(1.05 * p, 6 * p, 60)]
    limit = least_sensitivity([[p]], [[1.0]], tau)
    assert limit < min(peaks) < 2.2 * limit
