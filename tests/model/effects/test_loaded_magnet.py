"""Magnets that carry a load: coefficients stated without it and at it lead to one magnet, which
carries the load.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import MagnetGeometry, MagneticBearing, MagnetIron
from ambrose.model.effects.magnet import carrying, force, parameters, slopes, with_coefficients

GIVEN = MagneticBearing(
    "DE", 0.1, 4.0, force_per_current=(144.34, 139.44), negative_stiffness=(0.863e6, 0.871e6)
)
STEEL = MagnetIron(turns=72, flux_density=1.73, equivalent_gap=60e-6)
WAYS = {
    "plain": GIVEN,
    "iron": replace(GIVEN, iron=STEEL),
    "off centre": replace(GIVEN, iron=STEEL, magnetic_offset=(40e-6, -30e-6)),
    "axes that act on each other": replace(GIVEN, cross_coupling=0.05),
}
LOAD, PLACE = (-210.0, -180.0), (5e-6, -8e-6)


def test_a_load_stiffens_by_its_share_of_the_bias_squared():
    """k_s = c ((i_0 + i)^2 + (i_0 - i)^2)/s_0^3 without iron, at the centre; k_i is the same."""
    found = carrying(GIVEN, (-1.6 * 144.34, 0.8 * 139.44))
    assert found.currents == pytest.approx((1.6, -0.8), rel=1e-12)
    np.testing.assert_allclose(
        found.coefficients.force_per_current, GIVEN.force_per_current, rtol=1e-9
    )
    np.testing.assert_allclose(
        np.divide(found.coefficients.negative_stiffness, GIVEN.negative_stiffness),
        [1.16, 1.04],
        rtol=1e-9,
    )


@pytest.mark.parametrize("way", WAYS)
def test_the_magnets_carry_the_load(way):
    found = carrying(WAYS[way], LOAD, PLACE)
    assert force(*found.currents, *PLACE, found.parameters) == pytest.approx(
        (210.0, 180.0), rel=1e-9
    )


@pytest.mark.parametrize("way", WAYS)
def test_coefficients_at_the_load_lead_back_to_the_magnet(way):
    """What is found at the load, and stated so, is the magnet from whose data sheet it came."""
    here = carrying(WAYS[way], LOAD, PLACE)
    again = carrying(with_coefficients(WAYS[way], 4.0, here.coefficients), LOAD, PLACE)
    assert again.coefficients == here.coefficients
    np.testing.assert_allclose(again.parameters, here.parameters, rtol=1e-8)
    assert again.currents == pytest.approx(here.currents, rel=1e-9)
    assert slopes(again.parameters, again.currents, PLACE).negative_stiffness == pytest.approx(
        here.coefficients.negative_stiffness, rel=1e-10
    )


def test_without_load_both_mean_the_same():
    for way in ("no-load", "static-load"):
        found = carrying(replace(GIVEN, iron=STEEL, coefficients_at=way), (0.0, 0.0))
        assert (
            found.coefficients.negative_stiffness == GIVEN.negative_stiffness
            and found.currents == (0.0, 0.0)
        )
        assert found.parameters == parameters(replace(GIVEN, iron=STEEL))


def test_coefficients_that_no_magnet_has_act_as_stated():
    odd = replace(GIVEN, negative_stiffness=(-1e5, 1e5))
    found = carrying(odd, LOAD)
    assert found.parameters is None and found.coefficients.negative_stiffness == (-1e5, 1e5)


def test_a_load_beyond_the_iron_is_refused():
    found = carrying(replace(GIVEN, iron=STEEL), (-3e4, 0.0))
    assert found.coefficients.negative_stiffness == GIVEN.negative_stiffness
    with pytest.raises(InvalidInput, match=r"static load of bearing DE.*raise the bias"):
        _ = found.of_force


def test_the_geometry_is_always_without_load():
    made = MagneticBearing("DE", 0.1, 4.0, geometry=MagnetGeometry(72, 24e-4, 0.5e-3))
    one, other = (
        carrying(replace(made, coefficients_at=way), LOAD) for way in ("no-load", "static-load")
    )
    assert (
        one == other
        and one.coefficients.negative_stiffness[0]
        > 1.01 * carrying(made, (0.0, 0.0)).coefficients.negative_stiffness[0]
    )
