"""Where `new` puts the sensors, and what a design that fails says: checked by moving what it named.

The test rig of TU Munich (702 mm x 8 mm, three discs), whose magnets stand near the node of the
second bending mode, and machines drawn at random.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.model.assemble import driven_modes, seen_modes

DISCS = (
    ("113 mm", "0.85074 kg", "92 mm"),
    ("363 mm", "1.276499 kg", "192 mm"),
    ("623 mm", "0.85074 kg", "92 mm"),
)
RIG = {"length": "702 mm", "diameter": "8 mm", "speed": "3000 rpm", "discs": DISCS}
PLACES = ("113 mm", "623 mm")


def moved(machine, names):
    """The sensors of these bearings at their magnets."""
    places = {bearing.name: bearing.position for bearing in machine.bearings}
    sensors = tuple(
        replace(item, position=places[item.bearing]) if item.bearing in names else item
        for item in machine.sensors
    )
    return replace(machine, sensors=sensors)


def test_beside_no_magnet_of_the_test_rig_four_modes_agree_so_the_sensors_stand_at_its_middle():
    machine = amb.new_machine("rig", bearings=PLACES, **RIG)
    assert [sensor.position for sensor in machine.sensors] == [0.113, 0.623]
    assert "of A, B nowhere" in dict(machine.assumed)["sensor.position"]
    assert not driven_modes(machine)  # w^2 of each bearing: nothing is driven


def test_places_that_are_stated_stay():
    machine = amb.new_machine("rig", bearings=PLACES, sensors=("84.92 mm", "651.1 mm"), **RIG)
    assert [sensor.position for sensor in machine.sensors] == [0.08492, 0.6511]
    assert "sensor.position" not in dict(machine.assumed)
    with pytest.raises(InvalidInput, match="sensors is 1 places, but must be 2, one for each"):
        amb.new_machine("rig", bearings=PLACES, sensors=("85 mm",), **RIG)


def test_a_mode_is_driven_where_its_deflections_at_magnets_and_sensors_disagree_in_sum():
    machine = amb.new_machine("rig", bearings=PLACES, sensors=("84.92 mm", "651.1 mm"), **RIG)
    sums = dict.fromkeys(range(1, 9), 0.0)
    for _, mode, _, at, measured in seen_modes(machine, 8):
        sums[mode] += at * measured
    driven = {mode for mode, total in sums.items() if total < 0}
    assert {*driven_modes(machine)} == driven and {1, 2}.isdisjoint(driven) and {3, 4} <= driven


def test_a_design_that_fails_names_mode_and_place_and_holds_once_they_are_moved():
    machine = amb.new_machine("rig", bearings=PLACES, sensors=("84.92 mm", "651.1 mm"), **RIG)
    with pytest.raises(NumericalFailure, match="what damps the others drives") as caught:
        amb.design(machine)
    said = str(caught.value)
    assert "bending mode 3 (165 Hz), in which magnet and sensor A move oppositely" in said
    assert "order, give another" not in said and "allow a higher order" not in said
    named = re.findall(r"sensor (\w+) towards", said)
    made = amb.design(moved(machine, named))
    assert made.status == "verified" and not made.lost


def random_machine(number):
    """0.5 to 2,000 kg: a shaft of 8 to 40 diameters with one to three discs, as its size asks."""
    rng = np.random.default_rng(number)
    mass = 10 ** rng.uniform(np.log10(0.5), np.log10(2000))
    slim = rng.uniform(8, 40)
    thick = (0.6 * mass / (7850 * np.pi / 4 * slim)) ** (1 / 3)
    long = slim * thick
    count = int(rng.integers(1, 4))
    at = np.sort(rng.uniform(0.25, 0.75, count)) * long
    discs = [(float(z), float(0.4 * mass / count), float(thick * rng.uniform(2, 5))) for z in at]
    top = float(rng.uniform(0.3, 1.2) * 2 * np.pi * 1500 * thick / (slim / 12) ** 2 / 0.04 / 10)
    return amb.new_machine(
        f"random {number}", length=long, diameter=thick, speed=min(top, 3000.0), discs=discs
    )


def outcome(number):
    """Verified, or barred with a cause that was true: moving what it names lets the design hold."""
    machine = random_machine(number)
    try:
        made = amb.design(machine)
    except NumericalFailure as error:
        named = re.findall(r"sensor (\w+) towards", str(error))
        assert named or "no controller can" in str(error), str(error)
        return "" if not named else amb.design(moved(machine, named)).status
    return made.status


# 0 to 6 were run when this was written; of 1, 38 diameters long with four modes below 600 Hz, no
# controller was found at its magnets either, nor of order 16, and no cause is named
UNSOLVED = pytest.param(1, marks=pytest.mark.xfail(reason="no cause is named", strict=True))


@pytest.mark.study
@pytest.mark.parametrize("number", [0, UNSOLVED, *range(2, 40)])
def test_forty_machines_are_designed_or_name_what_bars_them(number):
    assert outcome(number) in ("verified", "")
