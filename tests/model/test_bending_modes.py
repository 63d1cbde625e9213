"""Bending modes as measured: they replace frequency and damping of shaft and discs wherever modes
are used.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.chain.check import critical_speeds
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import poles
from ambrose.machine.description import Tolerance
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.machine import Machine
from ambrose.machine.part import BendingMode
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_bending_frequencies,
    free_modes,
    mass_properties,
)
from ambrose.model.static_load import static_sag
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.rig.engine.state import build


@cache
def machine(name="seal-rig"):
    given = load_machine(name)
    return replace(
        given, shaft=tuple(replace(part, elements=1) for part in given.shaft), tolerances=()
    )


@cache
def frequencies(count=3, name="seal-rig"):
    return free_bending_frequencies(finite_element_rotor(machine(name)), count)


def stiffer(given, factor):
    """Young's modulus times factor^2: every bending mode is ``factor`` times as high, of the same
    shape.
    """
    shaft = tuple(
        replace(
            s, material=replace(s.material, youngs_modulus=factor**2 * s.material.youngs_modulus)
        )
        for s in given.shaft
    )
    return replace(given, shaft=shaft)


def measured(given, factor, count, damping=None):
    modes = tuple(
        BendingMode(k + 1, float(factor * w), damping)
        for k, w in enumerate(frequencies(count, given.name))
    )
    return replace(given, bending_modes=modes)


@pytest.mark.parametrize("name", ["seal-rig", "three-bearing-train"])
def test_all_modes_measured_higher_are_a_stiffer_shaft(name):
    """Independent route: other finite elements, of another modulus."""
    ours, theirs = measured(machine(name), 1.03, 3), stiffer(machine(name), 1.03)
    one, other = (free_modes(finite_element_rotor(given), 3) for given in (ours, theirs))
    np.testing.assert_allclose(one.frequencies, other.frequencies, rtol=1e-9)
    np.testing.assert_allclose(
        one.shapes, other.shapes, rtol=0, atol=1e-6 * np.abs(other.shapes).max()
    )
    a, b = (free_mode_reduction(assemble(given), 3).system for given in (ours, theirs))
    np.testing.assert_allclose(a.A, b.A, rtol=0, atol=1e-7 * np.abs(b.A).max())
    # of more modes than three
    np.testing.assert_allclose(critical_speeds(ours), critical_speeds(theirs), rtol=2e-3)
    first, second = build(ours, bending_modes=3).constants, build(theirs, bending_modes=3).constants
    np.testing.assert_allclose(first.stiffness, second.stiffness, rtol=1e-9)
    np.testing.assert_allclose(first.damping, second.damping, rtol=1e-9)
    assert mass_properties(finite_element_rotor(ours)) == mass_properties(
        finite_element_rotor(machine(name))
    )


def test_the_free_rotor_rings_as_measured_and_all_other_modes_as_before():
    given = replace(
        machine(),
        bending_modes=(
            BendingMode(1, float(0.97 * frequencies()[0]), 0.02),
            BendingMode(2, None, 0.01),
        ),
    )
    seal, coupling = (), ()
    idle = tuple(replace(b, negative_stiffness=(1e-6, 1e-6), geometry=None) for b in given.bearings)
    free = replace(
        given, seals=seal, couplings=coupling, bearings=idle, operation=type(given.operation)()
    )
    values = poles(free_mode_reduction(assemble(free), 3).system)
    ringing = np.sort_complex(values[values.imag > 1000])
    found = {round(abs(p), 3): -p.real / abs(p) for p in ringing if -p.real / abs(p) < 0.1}
    # nodes where seal and coupling stood are gone with them
    rest = free_bending_frequencies(finite_element_rotor(replace(free, bending_modes=())), 3)
    expected = {
        0.97 * frequencies()[0]: 0.02,
        rest[1]: 0.01,
        rest[2]: machine().modal_damping,
    }
    for rate, ratio in expected.items():
        near = min(found, key=lambda w: abs(w - rate))
        assert near == pytest.approx(rate, rel=1e-6) and found[near] == pytest.approx(
            ratio, rel=1e-4
        )


def test_a_measured_frequency_is_what_its_tolerance_moves_to():
    """The other route: the parameter moved by feedback around the plant of the drawing."""
    path, w = "rotor.bending_1.frequency", float(frequencies()[0])
    named = replace(machine(), tolerances=(Tolerance(path, relative=0.05),))
    moved = perturbed(assemble(named), {path: 1.0})
    made = assemble(
        replace(
            machine(), bending_modes=(BendingMode(1, 1.05 * w, machine().modal_damping / 1.05),)
        )
    )
    at = 2 * np.pi * np.geomspace(1, 3000, 60)
    one, other = (frequency_response(plant.system, at).values for plant in (moved, made))
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-8 * np.abs(other).max())


def test_the_shaft_hangs_through_as_its_modes_are():
    softer, stiff = (
        replace(machine(), bending_modes=(BendingMode(1, f * float(frequencies()[0])),))
        for f in (0.8, 1.2)
    )
    sag = [
        np.abs(static_sag(replace(one, gravity_direction=-np.pi / 2))[0]).max()
        for one in (softer, machine(), stiff)
    ]
    assert sag[0] > sag[1] > sag[2] > 0


def test_a_file_holds_them_and_a_wrong_order_is_refused():
    given = measured(machine(), 0.98, 2, 0.007)
    assert loads_machine(dumps_machine(given)) == given and isinstance(given, Machine)
    with pytest.raises(
        InvalidInput,
        match=r"\[\[bending_mode\]\] 1 is .* Hz, but must be between those of its neighbours",
    ):
        assemble(
            replace(machine(), bending_modes=(BendingMode(1, float(1.01 * frequencies()[1])),))
        )


@pytest.mark.parametrize(
    ("modes", "words"),
    [
        ((BendingMode(0, 3000.0),), "number is 0, but must be from 1 to"),
        ((BendingMode(999, 3000.0),), "number is 999"),
        ((BendingMode(1),), "neither frequency nor damping"),
        ((BendingMode(1, -3.0),), "frequency is -3 rad/s"),
        ((BendingMode(1, 3e3, 1.0),), "damping is 1, but must be a ratio"),
        ((BendingMode(1, 3e3), BendingMode(1, None, 0.1)), "number 1 is taken"),
        ((BendingMode(1, 4e3), BendingMode(2, 3e3)), "out of order"),
    ],
)
def test_what_no_rotor_has(modes, words):
    with pytest.raises(InvalidInput, match=words):
        replace(machine(), bending_modes=modes)
