"""A frequency-dependent seal as a linear system with few states."""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.physics.bulkflow import Friction, SealCondition, SealGeometry, air, bulk_flow
from ambrose.physics.seal import matrices
from ambrose.physics.seal_dynamics import seal_dynamics

HZ = 2 * np.pi
SEAL = SealGeometry(0.0857, 0.11474, 2.115e-4, 2.102e-4, 3.3e-3, 0.684, stator_friction=Friction(0.02, 0.0))
CONDITION = SealCondition(70e5, 31.5e5, 290.55, 20200 * HZ / 60, air(290.55))


@pytest.fixture(scope="module")
def flow():
    return bulk_flow(SEAL, CONDITION, HZ * np.arange(20, 301, 20))


@pytest.mark.parametrize(("order", "most"), [(1, 0.1), (2, 3e-3), (3, 1e-3), (4, 1e-4)])
def test_thesis_seal_needs_few_states(flow, order, most):
    dynamics = seal_dynamics(flow.frequencies, flow.K, flow.k, flow.C, flow.c, order)
    between = HZ * np.arange(30, 300, 20.0)
    other = bulk_flow(SEAL, CONDITION, between)
    D, E = dynamics.fit.response(between)
    for fitted, exact in zip((D, E), other.impedance, strict=True):
        assert np.abs(fitted - exact).max() < most * np.abs(exact).max()
    assert dynamics.system.A.shape == (2 * order, 2 * order)
    assert np.linalg.eigvals(dynamics.system.A).real.max() < 0


@pytest.mark.parametrize("damping", [True, False])
def test_force_is_that_of_the_coefficients(flow, damping):
    """Constant part plus states against -(K + j w C) with the coefficients at each frequency, all four entries."""
    dynamics = seal_dynamics(flow.frequencies, flow.K, flow.k, flow.C, flow.c, 5, damping)
    stiffness, damper, _ = matrices(dynamics.constant)
    system = dynamics.system
    for i, w in enumerate(flow.frequencies):
        through = system.C @ np.linalg.solve(1j * w * np.eye(len(system.A)) - system.A, system.B)
        got = through - stiffness - 1j * w * damper
        D, E = (part[i] for part in flow.impedance)
        np.testing.assert_allclose(got, -np.array([[D, E], [-E, D]]), atol=1e-4 * np.abs(D))
    if not damping:
        assert (dynamics.constant.C, dynamics.constant.c) == (0, 0)
    expected = [flow.K, flow.k, flow.C, flow.c]
    np.testing.assert_allclose(dynamics.coefficients(flow.frequencies), expected, rtol=1e-3)


def test_constant_coefficients_need_no_states():
    omega = HZ * np.linspace(10, 300, 12)
    one = np.ones(12)
    dynamics = seal_dynamics(omega, 8e6 * one, 6e6 * one, 1e4 * one, -3e3 * one, 1)
    np.testing.assert_allclose(dynamics.coefficients(omega), np.outer([8e6, 6e6, 1e4, -3e3], one), rtol=1e-7)


def test_lengths_must_agree():
    with pytest.raises(InvalidInput, match="k"):
        seal_dynamics([1.0, 2.0, 3.0], [1, 1, 1], [1, 1], [1, 1, 1], [1, 1, 1], 1)
