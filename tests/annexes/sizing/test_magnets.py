"""Magnets of another size: their force by the formulas, their cost, and what stays."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import InvalidInput, load_machine
from ambrose.annexes.sizing.least import Size, costs, drives, flux_within, resized
from ambrose.machine.description import MagnetGeometry
from ambrose.model.effects.magnet import VACUUM_PERMEABILITY
from ambrose.model.static_load import magnet_coefficients, operating_magnets

EXPANDER, TRAIN, RIG = (
    load_machine(name) for name in ("turboexpander", "three-bearing-train", "seal-rig")
)


def test_without_iron_k_i_goes_with_area_and_bias_and_k_s_with_the_bias_squared():
    k_i, k_s = magnet_coefficients(EXPANDER, EXPANDER.operation.nominal)
    found = resized(EXPANDER, Size(area=0.5, bias=0.7))
    np.testing.assert_allclose(
        magnet_coefficients(found, found.operation.nominal)[0], 0.5 * 0.7 * k_i, rtol=1e-9
    )
    np.testing.assert_allclose(
        magnet_coefficients(found, found.operation.nominal)[1], 0.5 * 0.7**2 * k_s, rtol=1e-9
    )
    assert costs(EXPANDER, Size(0.5, 0.7)).volt_amperes == pytest.approx(0.5 * 0.49)
    # two of four sides of a turn are half
    assert costs(EXPANDER, Size(0.5, 0.7)).copper_loss == pytest.approx(0.49 * 0.75)


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
    np.testing.assert_allclose(
        found.controller.gain,
        np.resize(machine.reference.gain, len(found.controller.gain)),
        rtol=1e-8,
    )
    for bearing, own, item in zip(
        found.bearings, machine.bearings, operating_magnets(machine), strict=True
    ):
        most = own.max_current or own.bias_current
        assert bearing.max_current == pytest.approx(most - np.abs(item.currents).max(), rel=1e-7)
    assert (
        costs(machine, Size()).copper_loss == pytest.approx(1.0)
        and costs(machine, Size()).volume == 1.0
    )


def test_a_smaller_magnet_carries_its_load_with_more_current():
    for area in (0.9, 0.7):
        small, whole = (operating_magnets(resized(TRAIN, Size(a))) for a in (area, 1.0))
        for one, other in zip(small, whole, strict=True):
            assert np.abs(one.currents).max() == pytest.approx(
                np.abs(other.currents).max() / area, rel=0.02
            )
    assert costs(TRAIN, Size(0.5)).reserve == pytest.approx(
        costs(TRAIN, Size()).reserve / 2, rel=1e-9
    )


def test_turns_trade_current_for_voltage_and_the_gaps_give_an_inductance():
    half, one, two = drives(TRAIN, Size(0.5, 0.8), (0.5, 1.0, 2.0))
    assert (half.current, half.voltage) == pytest.approx((2 * one.current, one.voltage / 2))
    assert two.inductance == pytest.approx(4 * one.inductance)
    assert one.voltage == pytest.approx(0.5 * 0.8 * drives(TRAIN, Size(), (1.0,))[0].voltage)
    assert one.voltage == pytest.approx(
        TRAIN.operation.speed_range[1] * one.inductance * one.current
    )
    geometry = MagnetGeometry(turns=100, pole_area=4e-4, gap=0.5e-3)
    bearing = replace(
        EXPANDER.bearings[0],
        geometry=geometry,
        force_per_current=None,
        negative_stiffness=None,
        measured=(),
    )
    magnets = tuple(replace(bearing, name=b.name, position=b.position) for b in EXPANDER.bearings)
    whole = replace(
        EXPANDER, bearings=magnets, amplifier=replace(EXPANDER.amplifier, inductance=None)
    )
    (found,) = drives(whole, Size(), (1.0,))
    assert found.inductance == pytest.approx(VACUUM_PERMEABILITY * 100**2 * 4e-4 / (2 * 0.5e-3))
    k_i, k_s = (value.max() for value in magnet_coefficients(whole, whole.operation.nominal))
    assert k_i**2 / (2 * k_s) == pytest.approx(np.cos(np.pi / 8) * found.inductance)


def test_iron_lets_the_flux_rise_and_takes_force_for_it():
    assert (
        flux_within(RIG, Size(bias=1.5))
        and not flux_within(EXPANDER, Size(bias=1.1))
        and flux_within(EXPANDER, Size(bias=0.5))
    )
    k_i = [
        magnet_coefficients(resized(RIG, Size(bias=b)), RIG.operation.nominal)[0].mean()
        for b in (1.0, 2.0, 3.0)
    ]
    assert k_i[2] - k_i[1] < k_i[1] - k_i[0]


def test_refusals():
    with pytest.raises(InvalidInput, match="area"):
        Size(area=0.0)
    odd = replace(EXPANDER.bearings[0], negative_stiffness=(0.0, 0.0))
    with pytest.raises(InvalidInput, match="negative stiffness"):
        resized(replace(EXPANDER, bearings=(odd, EXPANDER.bearings[1]), tolerances=()), Size())
