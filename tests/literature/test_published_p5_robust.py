"""Lauridsen (2017), paper P5, on its published plant: what the H-infinity controller does over the
range of the seal's k.
"""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.published_p5 import (
    published_p5,
    published_p5_data,
    published_p5_pid,
    published_p5_problem,
    published_p5_weights,
)

from ambrose.judge import robust
from ambrose.law.pid import axes_controller
from ambrose.synthesis.hinf import direct_gain_mismatch, hinf_synthesis, tune_control_weight

pytestmark = pytest.mark.literature
AXES = tuple(published_p5_data()["axes"])
PID = axes_controller(published_p5_pid(), AXES)


@pytest.fixture(scope="module")
def synthesis():
    return hinf_synthesis(published_p5_problem(uncertain=False))


@pytest.fixture(scope="module")
def checks(synthesis):
    return robust.check(published_p5(), synthesis.controller, weights=published_p5_weights())


def test_order_is_twenty(synthesis):
    """P5.3."""
    assert synthesis.controller.n_states == 20


def test_direct_gains_are_those_of_the_pid(synthesis):
    """P5.4: with W_u = 0.315 the mean direct gain to 200 Hz is the PID's (K_p 0.36 A per 20 um)
    within 1 %, 16 % rms.
    """
    mean, spread = direct_gain_mismatch(synthesis.controller, PID)
    assert abs(mean) < 0.01
    assert spread < 0.16


def test_stable_over_the_range_with_high_sensitivity_off_nominal(checks):
    """P5.8: H-infinity exceeds 3 but stays stable over +-100 % k."""
    assert checks["robust.stability.box"].value == 0
    assert checks["robust.stability.proved"].value > 1.6
    at = [checks[f"robust.sensitivity.at{d:+g}"].value for d in (-1, 0, 1)]
    np.testing.assert_allclose(at, [3.91, 2.31, 3.94], atol=0.02)
    assert checks["robust.sensitivity.worst"].value == pytest.approx(3.945, abs=0.02)
    assert (
        checks["robust.sensitivity.bound"].value < 1.005 * checks["robust.sensitivity.worst"].value
    )


def test_input_sensitivity_is_very_similar(checks):
    """P5.9: within 1 % at the worst case."""
    assert checks["robust.sensitivity.input"].value == pytest.approx(
        checks["robust.sensitivity.worst"].value, rel=0.01
    )


def test_pid_is_unstable_at_twice_the_nominal_stiffness():
    """P5.5."""
    found = robust.check(published_p5(), PID)
    assert found.stable
    assert found["robust.stability.margin"].value < 1
    assert np.isinf(found["robust.sensitivity.at+1"].value)


def test_tuning_finds_the_published_weight():
    """Started ten times off, the search for the PID's gains comes back to W_u near 0.315, the value
    inferred from the print.
    """
    from ambrose.law.design_problem import scale_control

    found = tune_control_weight(
        published_p5(),
        scale_control(published_p5_weights(), 0.1),
        PID,
        hinf_synthesis,
        uncertain=False,
        tolerance=0.005,
    )
    assert found.converged
    assert found.weights.control.D[0, 0] == pytest.approx(0.315, rel=0.05)
    assert len(found.history) <= 8
