"""Magnet coefficients: given, measured, from geometry; the geometry's against derivatives of the
nonlinear force.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import BiasPoint, MagnetGeometry, MagneticBearing
from ambrose.model.effects.magnet import force_constant, linearised
from physical_numbers import physical

GEOMETRY = MagnetGeometry(turns=36, pole_area=4e-4, gap=0.5e-3)
GIVEN = MagneticBearing(
    "A", 0.1, 8.0, force_per_current=(250.0, 260.0), negative_stiffness=(4e6, 4.2e6)
)
ROWS = (
    BiasPoint(6.0, (190.0, 195.0), (2.4e6, 2.5e6)),
    BiasPoint(10.0, (300.0, 310.0), (5.7e6, 5.9e6)),
)


def force(i, x, bias, geometry):
    """The differential pair's force [N] at control current i [A] and displacement x [m]."""
    k = 4e-7 * np.pi * geometry.turns**2 * geometry.pole_area / 4 * np.cos(geometry.pole_half_angle)
    return k * (((bias + i) / (geometry.gap - x)) ** 2 - ((bias - i) / (geometry.gap + x)) ** 2)


@given(st.floats(0.5, 20.0), st.floats(2e-4, 2e-3), physical(0.0, 1.2))
def test_geometry_gives_the_derivatives_of_the_force(bias, gap, angle):
    geometry = replace(GEOMETRY, gap=gap, pole_half_angle=angle)
    found = linearised(MagneticBearing("A", 0.1, bias, geometry=geometry))
    k_i = force(1e-20j, 0.0, bias, geometry).imag / 1e-20  # complex step
    k_s = force(0.0, 1e-25j, bias, geometry).imag / 1e-25
    assert found.force_per_current == pytest.approx((k_i, k_i), rel=1e-12)
    assert found.negative_stiffness == pytest.approx((k_s, k_s), rel=1e-12)
    assert min(*found.force_per_current, *found.negative_stiffness) > 0


def test_eight_pole_magnet_by_hand():
    """N = 36, A = 4 cm2, s0 = 0.5 mm, i0 = 8 A: k = 1.6286e-7 N m2/A2, k_i = 4 k i0 cos(22.5
    deg)/s0^2 = 19.26 N/A.
    """
    assert force_constant(GEOMETRY) == pytest.approx(1.62860e-7, rel=1e-5)
    found = linearised(MagneticBearing("A", 0.1, 8.0, geometry=GEOMETRY))
    assert found.force_per_current[0] == pytest.approx(19.2594, rel=1e-5)
    assert found.negative_stiffness[1] == pytest.approx(19.2594 * 8 / 0.5e-3, rel=1e-5)


def test_bias_scales_current_gain_linearly_and_stiffness_quadratically():
    bearing = MagneticBearing("A", 0.1, 8.0, geometry=GEOMETRY)
    low, high = linearised(bearing, 4.0), linearised(bearing)
    assert high.force_per_current[0] == pytest.approx(2 * low.force_per_current[0])
    assert high.negative_stiffness[0] == pytest.approx(4 * low.negative_stiffness[0])


def test_given_values_win_at_the_bearings_own_bias():
    bearing = replace(
        GIVEN, geometry=GEOMETRY, measured=(*ROWS, BiasPoint(8.0, (1.0, 1.0), (1.0, 1.0)))
    )
    for bias in (None, 8.0):
        found = linearised(bearing, bias)
        assert found.force_per_current == (250.0, 260.0)
        assert found.negative_stiffness == (4e6, 4.2e6)


def test_measured_rows_are_interpolated_linearly():
    bearing = MagneticBearing("A", 0.1, 8.0, measured=ROWS[::-1])
    assert linearised(bearing, 6.0).negative_stiffness == (2.4e6, 2.5e6)
    assert linearised(bearing, 10.0).force_per_current == (300.0, 310.0)
    assert linearised(bearing, 7.0).force_per_current == pytest.approx((217.5, 223.75))
    assert linearised(bearing).negative_stiffness == pytest.approx((4.05e6, 4.2e6))


def test_given_values_count_as_a_measured_row():
    found = linearised(replace(GIVEN, measured=ROWS), 9.0)
    assert found.force_per_current == pytest.approx((275.0, 285.0))
    assert found.negative_stiffness == pytest.approx((4.85e6, 5.05e6))


@pytest.mark.parametrize(
    ("bearing", "bias", "message"),
    [
        (
            MagneticBearing("A", 0.1, 8.0, measured=ROWS),
            5.0,
            "5 A, but must be within the measured 6 to 10 A",
        ),
        (
            replace(GIVEN, measured=ROWS, geometry=GEOMETRY),
            11.0,
            "11 A, but must be within the measured 6 to 10 A",
        ),
        (
            GIVEN,
            6.0,
            "6 A, but must be the 8 A at which its coefficients are given; add its geometry",
        ),
        (GIVEN, 0.0, "bias current.*must be positive"),
        (GIVEN, np.nan, "bias current.*must be finite"),
        (MagneticBearing("A", 0.1, 8.0), None, "bearing A has no coefficients"),
    ],
)
def test_what_cannot_be_known_is_refused(bearing, bias, message):
    with pytest.raises(InvalidInput, match=message):
        linearised(bearing, bias)
