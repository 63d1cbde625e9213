"""The unknowns of a controller that is tuned or polished: they give back the controller, and each
of them can move it.
"""

import numpy as np
from scipy.linalg import block_diag

from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace
from ambrose.synthesis.fixed_order.polish import block_form
from ambrose.synthesis.fixed_order.structure import structured

OMEGA = np.geomspace(0.1, 1e4, 60)


def same(controller, groups=None):
    structure, x = structured(controller, groups)
    a, b = (
        frequency_response(item, OMEGA).values for item in (controller, structure.controller(x))
    )
    np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-10 * np.abs(a).max())
    return structure, x


def test_equal_lags_in_series_stay_what_they_are():
    """Their eigenvectors are parallel: pairing them as two real poles gave another controller, off
    by more than its gain.
    """
    for n in (2, 3, 4):
        lags = -100.0 * np.eye(n) + 100.0 * np.eye(n, k=-1)
        controller = StateSpace(lags, 100 * np.eye(n)[:, :1], np.eye(n)[-1:], np.zeros((1, 1)))
        structure, _ = same(controller)
        assert structure.free[1:, 1:].sum() == n * n


def test_polishing_keeps_them_too():
    """Its form paired the two as real poles: the controller was another one, off by 1.16 times its
    gain.
    """
    lags = -100.0 * np.eye(2) + 100.0 * np.eye(2, k=-1)
    controller = StateSpace(lags, [[100.0], [0.0]], [[0.0, 1.0]], [[0.0]])
    form, x = block_form(controller)
    a, b = (frequency_response(item, OMEGA).values for item in (controller, form.controller(x)))
    np.testing.assert_allclose(b, a, rtol=1e-9, atol=1e-10)


def test_real_and_odd_poles_and_another_number_of_outputs():
    rng = np.random.default_rng(1)
    A = block_diag([[-1.0, 5.0], [-5.0, -1.0]], [[-0.01]], [[-200.0]], [[-3.0]])
    controller = StateSpace(
        A, rng.normal(size=(5, 2)), rng.normal(size=(3, 5)), rng.normal(size=(3, 2))
    )
    structure, _ = same(controller)
    assert structure.free[3:, 2:].sum() == 4 + 4 + 1


def test_an_integrator_can_move():
    """Scaled by its own rate of 1e-5 rad/s it could not: a step of 0.1 in an unknown moves the pole
    by 0.1 rad/s.
    """
    controller = StateSpace([[-1e-5]], [[1.0]], [[1.0]], [[2.0]])
    structure, x = same(controller)
    before = structure.matrices(x)[0][0, 0]
    moved = max(
        abs(structure.matrices(x + 0.1 * step)[0][0, 0] - before) for step in np.eye(len(x))
    )
    assert moved >= 0.0999
