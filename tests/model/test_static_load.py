"""The rotor under its weight: shares by the lever, and how far it hangs through as on the virtual
rig.
"""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.model.effects.rotor import STANDARD_GRAVITY, finite_element_rotor, mass_properties
from ambrose.model.static_load import static_sag
from ambrose.rig.scenario import Scenario


def test_two_bearings_share_the_weight_by_the_lever():
    machine = amb.load_machine("overhung-blower")
    _, weight = static_sag(machine)
    rotor, (a, b) = (
        mass_properties(finite_element_rotor(machine)),
        (bearing.position for bearing in machine.bearings),
    )
    share = (rotor.centre - a) / (b - a)
    total = rotor.mass * STANDARD_GRAVITY
    np.testing.assert_allclose(np.hypot(*weight.T), total * np.abs([1 - share, share]), rtol=1e-9)


def test_three_bearings_carry_the_whole_weight():
    machine = amb.load_machine("three-bearing-train")
    _, weight = static_sag(machine)
    angles = np.array([machine.gravity_direction - bearing.angle for bearing in machine.bearings])
    carried = np.sum(weight * np.column_stack([np.cos(angles), np.sin(angles)]))
    assert carried == pytest.approx(
        mass_properties(finite_element_rotor(machine)).mass * STANDARD_GRAVITY, rel=1e-9
    )


def test_a_slender_rotor_hangs_through_as_on_the_rig():
    machine = replace(amb.load_machine("two-disc-rotor"), tolerances=())
    hangs, weight = static_sag(machine)
    law = amb.design(machine, "pid")
    record = amb.simulate(machine, law, Scenario("still", 0.05, speed=0.0), bending_modes=8).record
    seen = np.array(
        [record[f"q_{axis}"].mean() - record[f"y_{axis}"].mean() for axis in machine.axes]
    ).reshape(-1, 2)
    np.testing.assert_allclose(hangs, seen, rtol=0.05)
    assert np.abs(hangs).max() > 2e-5 and np.hypot(*weight.T).min() > 100


def test_no_weight_no_sag():
    machine = replace(amb.load_machine("overhung-blower"), gravity_direction=None)
    for part in static_sag(machine):
        assert part.shape == (2, 2) and not part.any()
