"""Seals from geometry: what a file must say, and what the coefficients at an operating point
are.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble, seal_coefficients
from ambrose.model.effects.bulkflow import Friction, SealCondition, SealGeometry, air, bulk_flow
from ambrose.model.effects.seal import coefficients
from ambrose.model.uncertainty import reduce, uncertain

MACHINE = load_machine("turboexpander")
PISTON = MACHINE.seals[0]
TEXT = dumps_machine(MACHINE)
HZ = 2 * np.pi


@pytest.mark.literature
def test_the_seal_of_P3():
    """The printed geometry, in SI, and the published figures' operating point."""
    g = PISTON.geometry
    assert (g.length, g.diameter, g.hole_depth, g.hole_area_ratio) == (
        0.0857,
        0.11474,
        3.3e-3,
        0.684,
    )
    assert (g.inlet_clearance, g.exit_clearance, g.preswirl) == (0.2115e-3, 0.2102e-3, 0)
    assert g.temperature == pytest.approx(290.55)
    assert g.speed == pytest.approx(20200 * np.pi / 30)
    assert (g.exit_pressure, PISTON.reference_pressure) == (31.5e5, 38.5e5)
    at = coefficients(PISTON, 38.5e5, frequency=140 * HZ)
    assert (at.K, at.k, at.C, at.c) == pytest.approx((17.4e6, 2.55e6, 17.5e3, -2.97e3), rel=5e-3)


@pytest.mark.parametrize("hz", [20.0, 140.0, 525.0])
def test_coefficients_are_those_of_the_bulk_flow(hz):
    seal = SealGeometry(
        0.0857, 0.11474, 0.2115e-3, 0.2102e-3, 3.3e-3, 0.684, stator_friction=Friction(0.02, 0.0)
    )
    condition = SealCondition(70e5, 31.5e5, 290.55, 20200 * np.pi / 30, air(290.55))
    expected = bulk_flow(seal, condition, [hz * HZ])
    point = OperatingPoint(speed=hz * HZ, seal_pressure=38.5e5)
    found = seal_coefficients(PISTON, point)
    for name in "KkCc":
        assert getattr(found, name) == pytest.approx(getattr(expected, name)[0], rel=1e-12)
    whirl = seal_coefficients(PISTON, replace(point, speed=10.0, whirl_frequency=hz * HZ))
    assert whirl == found


def test_without_a_speed_of_its_own_the_seal_turns_with_the_rotor():
    free = replace(PISTON, geometry=replace(PISTON.geometry, speed=None))
    slow, fast = (
        coefficients(free, 38.5e5, speed, 140 * HZ) for speed in (1.0, 20200 * np.pi / 30)
    )
    assert fast == coefficients(PISTON, 38.5e5, frequency=140 * HZ)
    assert abs(slow.k) < 1e-2 * fast.k  # without spin and preswirl nothing drives the whirl
    assert slow.K == pytest.approx(fast.K, rel=0.05)


def test_the_other_pressure_is_the_given_one():
    g = PISTON.geometry
    before = replace(PISTON, geometry=replace(g, exit_pressure=None, inlet_pressure=70e5))
    assert coefficients(before, 38.5e5, frequency=900.0) == coefficients(
        PISTON, 38.5e5, frequency=900.0
    )
    assert coefficients(before, 20e5, frequency=900.0) != coefficients(
        PISTON, 20e5, frequency=900.0
    )


def test_pressure_falls_to_zero_without_a_jump():
    assert coefficients(PISTON, 0.0, frequency=900.0) == coefficients(
        replace(PISTON, geometry=None)
    )
    least = 0.05 * 31.5e5
    at, half, above = (
        coefficients(PISTON, p, frequency=900.0) for p in (least, least / 2, 1.001 * least)
    )
    assert half.k == pytest.approx(at.k / 2)
    assert above.k == pytest.approx(at.k, rel=2e-2)


def test_standstill_is_the_limit_of_slow_whirl():
    rest, slow = (coefficients(PISTON, 38.5e5, frequency=w) for w in (0.0, 5.0))
    for name in "KkCc":
        assert getattr(rest, name) == pytest.approx(getattr(slow, name), rel=1e-3)


def test_a_flow_that_chokes_is_refused_with_what_it_can_follow():
    low = replace(PISTON, geometry=replace(PISTON.geometry, exit_pressure=2e5))
    words = (
        r"\[\[seal\]\] piston, \[seal.geometry\]: the exit pressure of the seal is 2 bar, but "
        r"must be above .* chokes"
    )
    with pytest.raises(InvalidInput, match=words):
        coefficients(low, 66e5, frequency=900.0)


def test_kelvin_that_are_degrees_celsius_are_named_where_the_flow_chokes():
    """60 for 60 degC: cold, heavy air chokes, and the message spoke of choking alone."""
    low = replace(PISTON.geometry, exit_pressure=2e5)
    with pytest.raises(InvalidInput, match=r'60 K, .* write "60 degC".*unchanged.* chokes'):
        coefficients(replace(PISTON, geometry=replace(low, temperature=60.0)), 66e5, frequency=9e2)
    cold = replace(low, temperature=60.0, viscosity=5e-6)
    with pytest.raises(InvalidInput) as caught:
        coefficients(replace(PISTON, geometry=cold), 66e5, frequency=9e2)
    assert "chokes" in str(caught.value) and "degC" not in str(caught.value)


def test_a_drop_below_vacuum_is_refused():
    before = replace(
        PISTON, geometry=replace(PISTON.geometry, exit_pressure=None, inlet_pressure=30e5)
    )
    with pytest.raises(
        InvalidInput,
        match=r"seal_pressure is 38.5 bar, but must be below the inlet_pressure, 30 bar",
    ):
        coefficients(before, 38.5e5, frequency=900.0)


def test_frequencies_beyond_the_highest():
    with pytest.raises(
        InvalidInput, match=r"whirl frequency.* of seal piston is 12566.*max_frequency, 9424.78"
    ):
        coefficients(PISTON, 38.5e5, frequency=2000 * HZ)
    with pytest.raises(InvalidInput, match="piston"):
        assemble(MACHINE, OperatingPoint(speed=2000 * HZ, seal_pressure=38.5e5))


def test_relative_tolerance_on_a_coefficient_that_is_zero():
    point = operating_point(MACHINE, "nominal speed without seal")
    with pytest.raises(
        InvalidInput, match=r"nominal value of seal.piston.K_xx is 0, but must be non-zero"
    ):
        uncertain(reduce(assemble(MACHINE, point)))
    assert (
        len(
            uncertain(
                reduce(assemble(MACHINE, point)), [Tolerance("seal.piston.K_xx", absolute=1e6)]
            ).blocks
        )
        == 1
    )


WRONG = {
    "clearance": (
        "inlet_clearance = 0.0002115",
        "inlet_clearance = 0",
        "inlet_clearance is 0 m",
        "positive",
    ),
    "diameter for clearance": (
        "exit_clearance = 0.0002102",
        "exit_clearance = 0.2102",
        "is 0.2102 m",
        "below 5 %",
    ),
    "share": (
        "hole_area_ratio = 0.684",
        "hole_area_ratio = 68.4",
        "hole_area_ratio is 68.4",
        "at most 1",
    ),
    "friction": (
        "stator_friction = [0.02, 0.0]",
        "stator_friction = [0, 0.0]",
        "(coefficient) is 0",
        "positive",
    ),
    "friction alone": (
        "stator_friction = [0.02, 0.0]",
        "stator_friction = 0.02",
        "stator_friction is 0.02",
        "list of two",
    ),
    "exponent": (
        "stator_friction = [0.02, 0.0]",
        "stator_friction = [0.02, 2]",
        "(exponent) is 2",
        "-1 to 1",
    ),
    "no pressure": (
        "exit_pressure = 3150000.0\n",
        "",
        "neither exit_pressure nor inlet_pressure is given",
        "give one",
    ),
    "both pressures": (
        "exit_pressure = 3150000.0",
        "exit_pressure = 3e6\ninlet_pressure = 7e6",
        "both exit_",
        "give one",
    ),
    "celsius": (
        "temperature = 290.55",
        'temperature = "-300 degC"',
        "temperature is -26.85 K",
        "absolute",
    ),
    "unit of the temperature": (
        "temperature = 290.55",
        'temperature = "17 F"',
        'temperature is "17 F"',
        "17.4 degC",
    ),
    "preswirl": (
        "exit_pressure = 3150000.0",
        "exit_pressure = 3e6\npreswirl = 60",
        "preswirl is 60",
        "surface speed",
    ),
    "missing": ("length = 0.0857\ndiameter", "diameter", "length is missing", "length [m]"),
    "unknown": (
        "hole_depth = 0.0033",
        "hole_deep = 0.0033",
        'unknown key "hole_deep"',
        'did you mean "hole_depth"',
    ),
    "constant besides": (
        'name = "piston"',
        'name = "piston"\nk = 5',
        "k is 5, but [seal.geometry] yields it",
        "keep one",
    ),
    "scaled": (
        'name = "piston"',
        'name = "piston"\nscales_with_pressure = ["K"]',
        "names K",
        "remove it",
    ),
    "mode": (
        'name = "piston"',
        'name = "piston"\nfrequency_dependence = "state"',
        '"state"',
        'did you mean "states"',
    ),
    "poles": ('name = "piston"', 'name = "piston"\npoles = 0', "poles is 0", "from 1 to 12"),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_files(name):
    old, new, *words = WRONG[name]
    assert TEXT.count(old) >= 1, name
    with pytest.raises(InvalidInput) as caught:
        loads_machine(TEXT.replace(old, new, 1))
    assert all(word in str(caught.value) for word in words), str(caught.value)
    assert "[[seal]] piston" in str(caught.value)


def test_states_need_something_that_depends_on_the_frequency():
    with pytest.raises(InvalidInput, match="no coefficient depends on the frequency"):
        replace(MACHINE, seals=(replace(PISTON, geometry=None, frequency_dependence="states"),))
    with pytest.raises(InvalidInput, match=r"reference_pressure is missing; frequency_dependence"):
        replace(
            MACHINE,
            seals=(replace(PISTON, reference_pressure=None, frequency_dependence="states"),),
        )
