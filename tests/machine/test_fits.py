"""What cuts into the shaft is refused in a sentence; what touches it is not."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import loads_machine

sys.path.insert(0, str(Path(__file__).parents[1] / "thrust"))
from rotor import RADIAL, THRUST

MAGNET = """
[bearing.magnet]
kind = "heteropolar"
turns = 60
pole_area = "500 mm^2"
gap = "0.5 mm"
journal_radius = "{} mm"
"""
TOUCHDOWN = """
touchdown_gap = "0.2 mm"
[bearing.touchdown]
radius = "{} mm"
"""
SEAL = """
[[seal]]
name = "S"
position = "200 mm"
[seal.geometry]
length = "50 mm"
diameter = "{} mm"
inlet_clearance = "0.2 mm"
exit_clearance = "0.2 mm"
temperature = 300
exit_pressure = "1 bar"
"""
STEP = '"48 mm"\nelements = 6'  # the one section of the test rotor
# a second section from 214 mm on is thicker: inside the right stator, 206.5 to 231.5 mm, alone
LATER = STEP + '\n[[shaft]]\nlength = "100 mm"\nouter_diameter = "{} mm"'


def read(text: str, change: dict[str, str]):
    for old, new in change.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return loads_machine(text)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {'["25 mm", "34 mm"]': '["23 mm", "34 mm"]'},
            r"\[\[thrust_bearing.stator\]\] 1: inner_pole \(inner\) is 0.023 m, but must be "
            r"above the rotor's radius inside it, 0.024 m \(\[\[shaft\]\] 1\)",
        ),
        ({'"400 mm"': '"214 mm"', STEP: LATER.format(52)}, r"0.026 m \(\[\[shaft\]\] 2\)"),
        # laminations are as solid as the shaft
        ({STEP: STEP + '\nmass_diameter = "50 mm"'}, "inner_pole .* above .* 0.025 m"),
        (
            {'"60 mm"\ncollar_th': '"24 mm"\ncollar_th'},
            "collar_radius is 0.024 m, but must be above the shaft's radius there, 0.024 m",
        ),
        (
            {'position = "320 mm"\nbias': 'position = "220 mm"\nbias'},
            r"\[\[bearing\]\] B: position is 0.22 m, inside \[\[thrust_bearing\]\] T, whose "
            "stators stand from 0.1685 to 0.2315 m",
        ),
        (
            {"[amplifier]": SEAL.format(47) + "[amplifier]"},
            r"\[seal.geometry\]: diameter is 0.047 m, but must be at least the shaft's there, "
            "0.048 m",
        ),
    ],
)
def test_what_cuts_into_the_shaft_is_refused(change, message):
    with pytest.raises(InvalidInput, match=message):
        read(RADIAL + THRUST, change)


@pytest.mark.parametrize(("table", "key"), [(MAGNET, "journal_radius"), (TOUCHDOWN, "radius")])
def test_what_sits_on_the_shaft_is_no_smaller_than_it(table, key):
    first = 'negative_stiffness = "0.8 N/um"\n[[bearing]]'
    assert RADIAL.count(first) == 1

    def with_radius(radius):
        return RADIAL.replace(
            first, first.replace("[[bearing]]", table.format(radius)) + "[[bearing]]"
        )

    loads_machine(with_radius(24))
    with pytest.raises(InvalidInput, match=f"{key} is 0.023 m, but must be at least the shaft's"):
        loads_machine(with_radius(23))


@pytest.mark.parametrize(
    "change",
    [
        {},
        {'["25 mm", "34 mm"]': '["24.1 mm", "34 mm"]'},
        # thicker behind the stator, which ends at 231.5 mm
        {'"400 mm"': '"310 mm"', STEP: LATER.format(90)},
        {"[amplifier]": SEAL.format(48) + "[amplifier]"},
        # at a step a surface may sit on the smaller side
        {
            '"400 mm"': '"200 mm"',
            STEP: LATER.format(49.9),
            "[amplifier]": SEAL.format(48) + "[amplifier]",
            '"320 mm"\nbias': '"260 mm"\nbias',
            'bearing = "B"\nposition = "320 mm"': 'bearing = "B"\nposition = "260 mm"',
            'position = "390 mm"': 'position = "290 mm"',
        },
    ],
)
def test_what_fits_is_accepted(change):
    read(RADIAL + THRUST, change)


def test_a_rotor_without_a_shaft_is_refused_for_that_alone():
    text = (RADIAL + THRUST).replace(
        RADIAL[RADIAL.index("[[shaft]]") : RADIAL.index("[[bearing]]")], ""
    )
    with pytest.raises(InvalidInput, match=r"\[\[shaft\]\]") as told:
        loads_machine(text)
    assert "stator" not in str(told.value)


def test_without_a_shaft_nothing_cuts_into_it():
    """A machine that is put together in Python; in a file the table itself is asked for."""
    with pytest.raises(InvalidInput, match="there is no section"):
        replace(amb.load_machine("turboexpander"), shaft=())
