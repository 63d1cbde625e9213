"""Magnets of another size: their force by the formulas, their cost, and what stays."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import InvalidInput, load_machine
from ambrose.plant.static_load import magnet_coefficients, operating_magnets
from ambrose.sizing.magnets import Size, costs, flux_within, resized

EXPANDER, TRAIN, RIG = (load_machine(name) for name in ("turboexpander", "three-bearing-train", "seal-rig"))


def test_without_iron_k_i_goes_with_area_and_bias_and_k_s_with_the_bias_squared():
    k_i, k_s = magnet_coefficients(EXPANDER, EXPANDER.operation.nominal)
    found = resized(EXPANDER, Size(area=0.5, bias=0.7))
    np.testing.assert_allclose(magnet_coefficients(found, found.operation.nominal)[0], 0.5 * 0.7 * k_i, rtol=1e-9)
    np.testing.assert_allclose(magnet_coefficients(found, found.operation.nominal)[1], 0.5 * 0.7**2 * k_s, rtol=1e-9)
    assert costs(EXPANDER, Size(0.5, 0.7)).volt_amperes == pytest.approx(0.5 * 0.49)
    assert costs(EXPANDER, Size(0.5, 0.7)).copper_loss == pytest.approx(0.49 * 0.75)  # two of four sides of a turn are half


@pytest.mark.parametrize("machine", [EXPANDER, TRAIN, RIG], ids=lambda machine: machine.name)
def test_the_machine_files_own_size_changes_nothing_but_what_is_left_of_the_current(machine):
    found = resized(machine, Size())
    for k, (a, b) in enumerate(
        zip(
            magnet_coefficients(found, found.operation.nominal),
            magnet_coefficients(machine, machine.operation.nominal),
            strict=True,
        )
    ):
        np.testing.assert_allclose(a, b, rtol=1e-8, err_msg=str(k))
    np.testing.assert_allclose(found.controller.gain, np.resize(machine.reference.gain, len(found.controller.gain)), rtol=1e-8)
    for bearing, own, item in zip(found.bearings, machine.bearings, operating_magnets(machine), strict=True):
        most = own.max_current or own.bias_current
        assert bearing.max_current == pytest.approx(most - np.abs(item.currents).max(), rel=1e-7)
    assert costs(machine, Size()).copper_loss == pytest.approx(1.0) and costs(machine, Size()).volume == 1.0


def test_a_smaller_magnet_carries_its_load_with_more_current():
    for area in (0.9, 0.7):
        small, whole = (operating_magnets(resized(TRAIN, Size(a))) for a in (area, 1.0))
        for one, other in zip(small, whole, strict=True):
            assert np.abs(one.currents).max() == pytest.approx(np.abs(other.currents).max() / area, rel=0.02)
    assert costs(TRAIN, Size(0.5)).reserve == pytest.approx(costs(TRAIN, Size()).reserve / 2, rel=1e-9)


def test_iron_lets_the_flux_rise_and_takes_force_for_it():
    assert (
        flux_within(RIG, Size(bias=1.5)) and not flux_within(EXPANDER, Size(bias=1.1)) and flux_within(EXPANDER, Size(bias=0.5))
    )
    k_i = [magnet_coefficients(resized(RIG, Size(bias=b)), RIG.operation.nominal)[0].mean() for b in (1.0, 2.0, 3.0)]
    assert k_i[2] - k_i[1] < k_i[1] - k_i[0]


def test_refusals():
    with pytest.raises(InvalidInput, match="area"):
        Size(area=0.0)
    odd = replace(EXPANDER.bearings[0], negative_stiffness=(0.0, 0.0))
    with pytest.raises(InvalidInput, match="negative stiffness"):
        resized(replace(EXPANDER, bearings=(odd, EXPANDER.bearings[1]), tolerances=()), Size())
