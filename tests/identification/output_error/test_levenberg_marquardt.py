"""Levenberg-Marquardt: what a trial step may not do to the whole."""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.identification.output_error.normal_equations import Linearised, minimise


def valley(refused, seen):
    """Rosenbrock's residuals; at ``refused`` points nothing can be told."""

    def linearise(x):
        seen.append(x.copy())
        if refused(x):
            raise InvalidInput("these records do not determine b")
        r = np.array([1 - x[0], 10 * (x[1] - x[0] ** 2)])
        J = np.array([[1.0, 0.0], [20 * x[0], -10.0]])  # of the model, r = data - model
        return Linearised(float(r @ r), J.T @ J, J.T @ r)

    return linearise


def test_a_trial_at_which_nothing_can_be_told_is_a_refused_step():
    """The full step leads far below zero; the way round it leads to the minimum all the same."""
    seen = []
    found = minimise(
        valley(lambda x: x[1] < -1.2, seen), np.array([-1.2, 1.0]), np.ones(2), lambda x: True
    )
    assert min(x[1] for x in seen) < -1.2, "the test must have come across a refused point"
    assert found.refused > 0 and found.converged
    np.testing.assert_allclose(found.x, [1, 1], atol=1e-8)


def test_a_start_at_which_nothing_can_be_told_is_an_error():
    with pytest.raises(InvalidInput, match="do not determine b"):
        minimise(valley(lambda x: True, []), np.zeros(2), np.ones(2), lambda x: True)


def test_where_every_step_is_refused_it_has_not_converged():
    start = np.array([-1.2, 1.0])
    found = minimise(valley(lambda x: (x != start).any(), []), start, np.ones(2), lambda x: True)
    assert not found.converged and (found.x == start).all()


def test_a_parameter_without_effect_is_named():
    def linearise(x):
        return Linearised(1.0, np.diag([1.0, 0.0]), np.array([1.0, 0.0]))

    with pytest.raises(NumericalFailure, match="number 2"):
        minimise(linearise, np.zeros(2), np.ones(2), lambda x: True)
