"""Costs of a stretch in closed form, and where they have no bound."""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.annexes.scheduled.varying_proof import TwoPort, flow
from ambrose.core.checks import NumericalFailure

ONE, NONE = np.eye(1), np.zeros((1, 1))


def integrator(time: float, unit: float = 1.0) -> TwoPort:
    """x' = w with the cost x^2 - w^2, x in other units: lambda' = -x, x' = lambda, a rotation."""
    return flow(NONE, ONE / unit, ONE * unit**2, NONE, -ONE, time)


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e7])
@pytest.mark.parametrize("time", [1e-3, 1.0, 1.5])
def test_an_integrator_costs_the_tangent(time: float, unit: float) -> None:
    port = integrator(time, unit)
    assert port.F[0, 0] == pytest.approx(np.tan(time) * unit**2, rel=1e-9)
    assert port.G[0, 0] == pytest.approx(np.tan(time) / unit**2, rel=1e-9)
    assert port.E[0, 0] == pytest.approx(1 / np.cos(time), rel=1e-9)


@pytest.mark.parametrize("time", [1.6, 4.0, 6.0, 2 * np.pi, 7.5])
def test_beyond_a_quarter_turn_its_cost_has_no_bound(time: float) -> None:
    """From 3/2 pi on the tangent and the cosine look as if it had one."""
    with pytest.raises(NumericalFailure, match="unbounded"):
        integrator(time)
