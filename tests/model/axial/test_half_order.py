"""The solid core: closed form of its corner, the rational model within its bounds, refusals."""

import math

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.model import axial as module
from ambrose.model.axial import CORNER, core_constant, half_order, lags


def test_minus_three_decibels_and_fifteen_degrees_stand_together():
    """tau sqrt(w) = (sqrt 6 - sqrt 2)/2; the phase never passes -45 deg."""
    tau = 0.13
    h = half_order([((math.sqrt(6) - math.sqrt(2)) / 2 / tau) ** 2], tau)[0]
    assert abs(h) == pytest.approx(1 / math.sqrt(2), rel=1e-12)
    assert math.degrees(math.atan2(h.imag, h.real)) == pytest.approx(-15, rel=1e-12)
    assert pytest.approx((math.sqrt(6) - math.sqrt(2)) / 2) == CORNER
    far = half_order(np.geomspace(1, 1e12, 50), tau)
    assert np.degrees(np.angle(far)).min() > -45


@pytest.mark.parametrize("tau", [1e-3, 0.05, 0.2])
def test_the_rational_model_is_passive_and_close(tau):
    model = lags(tau)
    assert len(model.poles) <= 8
    assert (model.weights > 0).all() and (model.poles > 0).all()  # residues g p are positive
    assert model.weights.sum() == pytest.approx(1, rel=1e-12)
    # on a grid of the test's own
    omega = 2 * np.pi * np.geomspace(0.1, 5000, 777)
    ratio = model.response(omega) / half_order(omega, tau)
    assert np.abs(20 * np.log10(np.abs(ratio))).max() <= 0.1
    assert np.abs(np.degrees(np.angle(ratio))).max() <= 1
    # the rest everywhere is bounded by what it says
    wide = np.geomspace(1e-4, 1e9, 999)
    assert np.abs(model.response(wide) - half_order(wide, tau)).max() <= model.rest * 1.001
    # the state space, its states scaled, is the same
    found = frequency_response(model.system("a", "b", scale=1e6), omega).values[:, 0, 0]
    assert found == pytest.approx(model.response(omega), rel=1e-9)


def test_the_constant_of_the_core():
    """By hand: sigma = 5e6 S/m, mu_r = 500, cylinders of 30 mm, discs from 60 to 80 mm."""
    mu = 4e-7 * math.pi * 500
    by_hand = 0.03 / (2 * math.pi * 0.06) + 2 * math.log(80 / 60) / (2 * math.pi)
    by_hand += 0.03 / (2 * math.pi * 0.08)
    found = core_constant(5e6, 500, (0.04, 0.06), (0.08, 0.095), 0.03)
    assert found == pytest.approx(math.sqrt(5e6 / mu) * by_hand, rel=1e-12)


def test_refusals(monkeypatch):
    with pytest.raises(InvalidInput, match="leave the core laminated"):
        lags(0.0)
    assert lags(0.21, 3).phase_error > 1  # so many and no more, however close
    monkeypatch.setattr(module, "_MOST", 3)
    with pytest.raises(InvalidInput, match=r"with 3 states, more than 0\.1 dB and 1 deg"):
        lags(0.21)
