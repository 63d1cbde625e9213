"""Quantities: against pint and the decimal definition of the units."""

import contextlib
import math
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pint
import pytest
from hypothesis import example, given, settings, strategies as st

from ambrose.machine.units import (
    DIMENSIONS,
    canonical_unit,
    in_si,
    read_quantity,
    rewrite_quantity,
)
from ambrose.record.record import si_values

REGISTRY = pint.UnitRegistry()
EVERYDAY = [(name, unit) for name, dimension in DIMENSIONS.items() for unit in dimension.units]
RATES = {"angular rate", "frequency"}  # pint's hertz is 1/s, and its mil an angle
OF_PINT = [(name, unit) for name, unit in EVERYDAY if name not in RATES and "mil" not in unit]
PINT_SPELLING = {
    "N s/mm": "N*s/mm",
    "Ns/m": "N*s/m",
    "kNs/m": "kN*s/m",
    "Ns/mm": "N*s/mm",
    "°": "deg",
    **{f"{prefix}N{end}": f"{prefix}N*{end}" for prefix in ("", "m", "k") for end in ("m", "mm")},
}


def spelled_for_pint(unit: str) -> str:
    if unit in PINT_SPELLING:
        return PINT_SPELLING[unit]
    return "".join(f"**{c}" if c.isdigit() else c for c in unit).replace(" ", "*")


@pytest.mark.parametrize("name, unit", OF_PINT)
def test_everyday_units_agree_with_pint(name, unit):
    ours = read_quantity(f"1 {unit}", DIMENSIONS[name])
    theirs = (
        REGISTRY.Quantity(1.0, "percent" if unit == "%" else spelled_for_pint(unit))
        .to_base_units()
        .magnitude
    )
    assert ours == pytest.approx(theirs, rel=1e-15)


TURN = 2 * math.pi  # rad
# what a rate's unit counts [rad], and in how many seconds
PER_SECOND = {"Hz": TURN, "cps": TURN, "rps": TURN, "r/s": TURN, "rev/s": TURN, "turn/s": TURN}
PER_SECOND |= {"cycles/s": TURN, "rad/s": 1, "rad s^-1": 1, "rad/sec": 1, "deg/s": TURN / 360}
PLATE = ("rpm", "r/min", "rev/min", "turn/min", "1/min", "min^-1", "min-1", "min⁻¹", "U/min")
PER_MINUTE = dict.fromkeys(
    (*PLATE, "cpm", "cycles/min", "tr/min"),
    TURN,
) | {"rad/min": 1}


@pytest.mark.parametrize("unit", [*PER_SECOND, *PER_MINUTE])
def test_a_rate_is_turns_or_radians_wherever_it_stands(unit):
    """3000 min^-1 were 50 rad/s as a speed, 600000 rpm 62.8 kHz as a sample rate."""
    radians = PER_SECOND[unit] if unit in PER_SECOND else PER_MINUTE[unit] / 60
    speed, frequency = (DIMENSIONS[name] for name in ("angular rate", "frequency"))
    assert read_quantity(f"3000 {unit}", speed) == pytest.approx(3000 * radians, rel=1e-14)
    assert read_quantity(f"3000 {unit}", frequency) == pytest.approx(
        3000 * radians / TURN, rel=1e-14
    )
    column = np.array([0.0, 3000.0])
    assert in_si(column, unit, speed) == pytest.approx(column * radians, rel=1e-14)
    assert si_values("speed_rotor", unit, column)[0] == pytest.approx(column * radians, rel=1e-14)


@pytest.mark.parametrize("unit", ["s^-1", "1/s", "Bq", "count/min", "count/s", "baud", "dB/s"])
@pytest.mark.parametrize("name", sorted(RATES))
def test_a_rate_of_nothing_is_refused(unit, name):
    with pytest.raises(ValueError, match=r"must be an? |cannot be read|is unknown"):
        read_quantity(f"50 {unit}", DIMENSIONS[name])


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("5 N m/deg", "torque"),
        ("5 N/m/rpm", "damping"),
        ("5 N/(m Hz)", "damping"),
        ("5 N s/m/rad", "damping"),
        ("5 bar Hz", "pressure per time"),
        ("5 mm rpm", "velocity"),
        ("5 ohm/Hz", "inductance"),
        ("5 mm percent", "length"),
        ("5 kg m^2/turn", "moment of inertia"),
    ],
)
def test_angles_and_rates_within_a_unit_are_refused(text, name):
    """To pint they are the number 1, or 2 pi, or 1/60 of it."""
    with pytest.raises(ValueError, match="an angle, a share or a rate in it"):
        read_quantity(text, DIMENSIONS[name])


def test_units_with_an_offset_are_shifted_in_columns_as_in_the_file():
    """20 degC of a bearing were 5483 K."""
    found, unit = si_values("T_bearing", "degC", np.array([20.0, -40.0]))
    assert unit == "K" and found == pytest.approx([293.15, 233.15], rel=1e-15)
    assert in_si(20.0, "°C", DIMENSIONS["temperature"]) == pytest.approx(293.15)
    for unit in ("degF", "K/m", "kelvins", "mm"):
        with pytest.raises(ValueError, match="; write one of K, degC"):
            in_si(20.0, unit, DIMENSIONS["temperature"])


@pytest.mark.parametrize(
    "text, name, value",
    [
        ("0.5 mm", "length", 0.0005),
        ("20 um", "length", 20e-6),
        ("20 µm", "length", 20e-6),
        ("20μm", "length", 20e-6),
        ("  -.5e1   mm ", "length", -0.005),
        ("2.04 bar", "pressure", 204000.0),
        ("31500 rpm", "angular rate", 3298.6722862692827),
        ("216 Hz", "angular rate", 1357.1680263507906),
        ("0.5 kHz", "angular rate", 3141.592653589793),
        ("0.001 MHz", "angular rate", 6283.185307179586),
        ("2 turn/s", "angular rate", 12.566370614359172),
        ("45 deg", "angle", 0.7853981633974483),
        ("2.5 mm/s", "velocity", 0.0025),
        ("40 %", "ratio", 0.4),
        ("0.0021 kg*m^2", "moment of inertia", 0.0021),
        ("0.0021 kg·m²", "moment of inertia", 0.0021),
        ("0.0021 kg m**2", "moment of inertia", 0.0021),
        ("12 N/(mm)", "stiffness", 12000.0),
        ("5 kg m s-2", "force", 5.0),
    ],
)
def test_reading(text, name, value):
    assert read_quantity(text, DIMENSIONS[name]) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    "text, name, value",
    [
        ("1 ft", "length", 0.3048),
        ("3 thou", "length", 3 * 0.0254e-3),
        ("5 mil", "length", 5 * 0.0254e-3),
        ("5 mils", "length", 5 * 0.0254e-3),
        ("2 Nm", "torque", 2.0),
        ("2 kNm", "torque", 2000.0),
        ("2 Nmm", "torque", 2e-3),
        ("1 lbf/in", "stiffness", 4.4482216152605 / 0.0254),
        ("1 lbf s/in", "damping", 4.4482216152605 / 0.0254),
        ("30 psi", "pressure", 30 * 4.4482216152605 / 0.0254**2),
        ("1 lb in2", "moment of inertia", 0.45359237 * 0.0254**2),
        ("1 rad/minute", "angular rate", 1 / 60),
    ],
)
def test_less_common_units_by_definition(text, name, value):
    assert read_quantity(text, DIMENSIONS[name]) == pytest.approx(value, rel=1e-12)


@given(
    st.decimals(
        allow_nan=False, allow_infinity=False, min_value=-(10**9), max_value=10**9, places=6
    )
)
def test_decimal_units_are_correctly_rounded(number):
    """1e-6 is not representable, yet "20 um" is the float nearest to 20e-6, as if it had been
    written in metres.
    """
    assert read_quantity(f"{number:f} um", DIMENSIONS["length"]) == float(Fraction(number) / 10**6)


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_plain_numbers_pass_unchanged(number):
    assert read_quantity(number, DIMENSIONS["mass"]) == number


@given(st.text(max_size=30), st.sampled_from(sorted(DIMENSIONS)))
@settings(max_examples=40, deadline=None)
def test_any_text_is_read_or_refused_with_a_remedy(text, name):
    try:
        assert isinstance(read_quantity(text, DIMENSIONS[name]), float)
    except ValueError as error:
        assert "write a" in str(error) or 'write "' in str(error)


@example(0, "A/(", "angle")  # an open bracket once came through as a tokenizer's error
@given(
    st.integers(-9, 9),
    st.from_regex(r"[a-zA-Z/*^0-9 ()]{1,12}", fullmatch=True),
    st.sampled_from(sorted(DIMENSIONS)),
)
def test_any_unit_is_read_or_refused_with_a_remedy(number, unit, name):
    try:
        assert isinstance(read_quantity(f"{number} {unit}", DIMENSIONS[name]), float)
    except ValueError as error:
        assert "write a" in str(error) or 'write "' in str(error)


@pytest.mark.parametrize(
    ("text", "name", "why", "remedy"),
    [
        ("9,500 rpm", "angular rate", "by a comma", 'write "9500 rpm", or "9.500 rpm" if'),
        ("1,250,000 Pa", "pressure", "by a comma", 'write "1250000 Pa"'),
        ("1,234.5 mm", "length", "by a comma", 'write "1234.5 mm"'),
        ("9 500 rpm", "angular rate", "by a blank", 'write "9500 rpm"'),
        ("9\u202f500 rpm", "angular rate", "set apart", 'write "9500 rpm"'),
        ("9'500 rpm", "angular rate", "set apart", 'write "9500 rpm"'),
        ("9_500 rpm", "angular rate", "set apart", 'write "9500 rpm"'),
        ("0,5 mm", "length", "decimal mark is a comma", 'write "0.5 mm"'),
        ("-12,25 mm", "length", "decimal mark is a comma", 'write "-12.25 mm"'),
        ("0,5", "ratio", "decimal mark is a comma", 'write "0.5"'),
        ("\u221220 um", "length", "sign is no hyphen", 'write "-20 um"'),
        ("\u201320 um", "length", "sign is no hyphen", 'write "-20 um"'),
    ],
)
def test_digits_as_people_write_them_are_told_from_the_unit(text, name, why, remedy):
    """ "9,500 rpm" was "its unit cannot be read"."""
    with pytest.raises(ValueError) as error:
        read_quantity(text, DIMENSIONS[name])
    said = str(error.value)
    assert why in said and remedy in said and "unit" not in said
    # what is advised can be read
    advised = said.partition('write "')[2].partition('"')[0]
    if any(letter.isalpha() for letter in advised):
        assert math.isfinite(read_quantity(advised, DIMENSIONS[name]))


def test_a_unit_that_is_wrong_is_still_what_is_blamed():
    for text in ("9500 rmp", "5 kg", "12 34 mm", "1,2,3 mm"):
        with pytest.raises(ValueError, match=r"unit|must be") as error:
            read_quantity(text, DIMENSIONS["length"])
        assert "write a plain number" in str(error.value)


@pytest.mark.parametrize("value", [True, None, [1.0], {"m": 1}, b"1 m", 1j])
def test_other_kinds_of_value_are_refused(value):
    with pytest.raises(ValueError, match="must be a length"):
        read_quantity(value, DIMENSIONS["length"])


@pytest.mark.parametrize(
    "value",
    [
        float("nan"),
        float("inf"),
        10**400,
        pytest.param(10**5000, id="unprintable"),
        "1e999 m",
        "-1e999 ft",
    ],
)
def test_not_finite(value):
    with pytest.raises(ValueError, match="must be finite"):
        read_quantity(value, DIMENSIONS["length"])


def test_dimensions_do_not_share_an_example_that_both_would_read():
    """Each example is read by its own dimension; no closed dimension reads another one's, but for
    rates of turns and of radians.
    """
    for name, dimension in DIMENSIONS.items():
        if dimension.example:
            assert read_quantity(dimension.example, dimension) > 0
        for other in DIMENSIONS.values():
            rates = {name, other.name} == RATES
            if other.closed and other.name != name and dimension.example and not rates:
                with pytest.raises(ValueError, match="write"):
                    read_quantity(dimension.example, other)


def test_one_spelling():
    assert {canonical_unit(u) for u in ("kg*m**2", "kg m^2", "kg·m²", " kg  m2 ")} == {"kg m2"}


def test_pint_is_not_imported_for_everyday_units():
    code = (
        "import sys; from ambrose.machine.units import DIMENSIONS, read_quantity as r;"
        "r('0.5 mm', DIMENSIONS['length']); r('20 µm', DIMENSIONS['length']); assert 'pint' not "
        "in sys.modules;"
        "r('1 ft', DIMENSIONS['length']); assert 'pint' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize(
    "dimension", [d for d in DIMENSIONS.values() if d.units], ids=lambda d: d.name
)
@given(value=st.floats(1e-12, 1e12), sign=st.sampled_from([1.0, -1.0]))
@settings(max_examples=15, deadline=None)
def test_a_number_is_rewritten_in_every_unit_to_the_last_bit(dimension, value, sign):
    for unit in dimension.units:
        text = rewrite_quantity(f"1 {unit}", sign * value, dimension)
        assert read_quantity(text, dimension) == sign * value and text.endswith(f" {unit}")


@pytest.mark.parametrize(
    ("old", "value", "name", "text"),
    [
        ("0.5 mm", 0.0006, "length", "0.6 mm"),
        (" 1.5kHz ", 3000 * math.pi, "angular rate", "1.5kHz"),
        ("17 degC", 293.15, "temperature", "20 degC"),
        ("40 %", 0.3, "ratio", "30 %"),
        ("1 thou", 2.54e-4, "length", "10 thou"),
        ("2 bar", 0.0, "pressure", "0 bar"),
        ("1 Pa", 1e-9, "pressure", "1E-9 Pa"),
    ],
)
def test_a_number_is_rewritten_with_few_digits(old, value, name, text):
    assert rewrite_quantity(old, value, DIMENSIONS[name]) == text


def test_a_unit_is_what_it_says_wherever_no_prefix_tells():
    """A channel of an unknown prefix is read by its unit: what two dimensions can read must mean
    the same in both, per cent above all (a byte is dimensionless to pint, and 8 bits).
    """
    # a rate is one of turns or of radians: told with the unit that it is stored in
    for unit in {unit for name, unit in EVERYDAY if name not in RATES}:
        values = set()
        for dimension in DIMENSIONS.values():
            with contextlib.suppress(ValueError):
                values.add(read_quantity(f"1 {unit}", dimension))
        assert max(values) == pytest.approx(min(values), rel=1e-12), unit
    assert si_values("load", "%", np.array([50.0]))[0] == pytest.approx([0.5], rel=1e-15)
    assert si_values("load", "%", np.array([50.0]))[1] == "-"
