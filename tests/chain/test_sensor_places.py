"""Where `new` puts the sensors, and what a design that fails says: checked by moving what it named.

The test rig of TU Munich (702 mm x 8 mm, three discs), whose magnets stand near the node of the
second bending mode, and machines drawn at random.
"""

import re
import time
from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.model.assemble import badly_placed, driven_modes, judged_bending, seen_modes
from ambrose.synthesis.design import _barred

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


def test_a_design_that_fails_names_mode_and_place_once_the_search_found_nothing(monkeypatch):
    machine = amb.new_machine("rig", bearings=PLACES, sensors=("84.92 mm", "651.1 mm"), **RIG)

    def nothing(*given, **how):
        raise NumericalFailure("no controller of order 5 holds it; allow a higher order")

    monkeypatch.setattr("ambrose.synthesis.methods.Tuned.design", nothing)
    with pytest.raises(NumericalFailure, match="no controller of order 5 holds it; ") as caught:
        amb.design(machine)
    said = str(caught.value)
    assert "what damps the others drives" in said and "allow a higher order" not in said
    assert "bending mode 3 (165 Hz), in which magnet and sensor A move oppositely" in said
    assert not driven_modes(moved(machine, re.findall(r"sensor (\w+) towards", said)))


@pytest.mark.study
def test_the_search_does_find_nothing_and_a_controller_once_they_are_moved():
    machine = amb.new_machine("rig", bearings=PLACES, sensors=("84.92 mm", "651.1 mm"), **RIG)
    with pytest.raises(NumericalFailure, match="what damps the others drives") as caught:
        amb.design(machine)
    named = re.findall(r"sensor (\w+) towards", str(caught.value))
    made = amb.design(moved(machine, named))
    assert made.status == "verified" and not made.lost


def random_machine(number):
    """0.5 to 2,000 kg, one to four bending modes within the amplifier's reach: a shaft of 8 to 30
    diameters, one to three discs, the magnets outside of them or between; each sensor to either
    side of its magnet, 1.5 to 12 % of the length away.
    """
    rng = np.random.default_rng(number)
    for _ in range(100):
        mass = 10 ** rng.uniform(np.log10(0.5), np.log10(2000))
        slim, share = rng.uniform(8, 30), rng.uniform(0.4, 0.9)
        thick = (share * mass / (7850 * np.pi / 4 * slim)) ** (1 / 3)
        long, count = slim * thick, int(rng.integers(1, 4))
        if rng.random() < 0.4:  # discs overhang
            a, b = rng.uniform(0.15, 0.3), rng.uniform(0.7, 0.85)
            ends = (0.0, a - 0.08), (b + 0.08, 1.0), (a + 0.1, b - 0.1)
            at = [rng.uniform(*part) for part in ends][:count]
        else:
            a, b = rng.uniform(0.06, 0.2), rng.uniform(0.8, 0.94)
            at = rng.uniform(a + 0.08, b - 0.08, count)
        discs = [
            (float(z * long), float((1 - share) * mass / count), float(thick * rng.uniform(2, 5)))
            for z in sorted(at)
        ]
        away = [rng.choice((-1, 1)) * rng.uniform(0.015, 0.12) for _ in "AB"]
        sensors = [
            float(np.clip(z + d, 0.01, 0.99) * long) for z, d in zip((a, b), away, strict=True)
        ]
        asked = {
            "length": float(long),
            "diameter": float(thick),
            "speed": min(float(rng.uniform(5, 60) / thick), 2500.0),
            "discs": discs,
            "bearings": (float(a * long), float(b * long)),
            "sensors": sensors,
        }
        machine = amb.new_machine(f"random {number}", **asked)
        if 1 <= (judged_bending(machine) <= machine.amplifier.bandwidth).sum() <= 4:
            return machine, asked
    raise AssertionError("no plausible machine was drawn")


def designed(machine):
    """Whether all that verify asks is met, and what is said: of a design, or of its failure."""
    try:
        made = amb.design(machine)
    except NumericalFailure as error:
        return False, str(error)
    missed = made.gamma > 1 or made.lost or "unmet_checks" in made.certificate.margins
    return made.status == "verified" and not missed, "\n".join(made.notes)


BARS = re.compile(r"bending mode (\d) \(")
NEAR_SPEED = "amplification factor near the running speeds"


def as_named(machine, asked, said):
    """The machine with what was named moved as the sentence says, and what bars it no longer."""
    magnets = {name: at / 1e3 for name, at in numbers(r"magnet (\w) and its sensor towards", said)}
    sensors = {name: at / 1e3 for name, at in numbers(r"sensor (\w) towards", said)}
    if magnets or sensors:
        places = {b.name: magnets.get(b.name, b.position) for b in machine.bearings}
        own = {s.bearing: s.position for s in machine.sensors} | magnets | sensors
        asked = asked | {"bearings": [*places.values()], "sensors": [own[n] for n in places]}
        return amb.new_machine(machine.name, **asked), set(BARS.findall(said))
    if "sample faster" in said:
        rate = 2 / machine.controller.sample_time
        return amb.new_machine(machine.name, rate=rate, **asked), set(BARS.findall(said))
    if NEAR_SPEED in said:
        slower = asked | {"speed": 0.7 * asked["speed"]}
        return amb.new_machine(machine.name, **slower), {NEAR_SPEED}
    return None, set()


def numbers(pattern, said):
    return [(name, float(at)) for name, at in re.findall(pattern + r" ([\d.]+) mm", said)]


def outcome(number):
    """One row of the table: number, mass, modes; what came out; what is named; of a failure whether
    what was named bars it no longer, once moved; seconds of processor time.
    """
    begun = time.process_time()
    machine, asked = random_machine(number)
    good, said = designed(machine)
    spent = time.process_time() - begun
    kind, rightly = "holds", ""
    if not good:
        other, bars = as_named(machine, asked, said)
        kind = ", ".join(sorted(bars)) or "nothing named"
        if other is not None:
            again, more = designed(other)
            left = set(BARS.findall(more)) | ({NEAR_SPEED} if NEAR_SPEED in more else set())
            worse = more.startswith("no controller") or bars & left
            rightly = "holds once moved" if again else "still" if worse else "other cause"
    modes = int((judged_bending(machine) <= machine.amplifier.bandwidth).sum())
    return number, modes, kind, rightly, round(spent, 1), said


@pytest.mark.parametrize("number", [3, 36])
def test_random_machines_are_designed_as_verify_asks(number):
    assert outcome(number)[2] == "holds"


def test_the_first_bending_mode_is_damped_where_the_rigid_ones_do_not_ring():
    """558 Hz, which verify holds against the log decrement: the design left it at 0.05 of 0.1."""
    machine = amb.new_machine(
        "fan",
        length=0.49546,
        diameter=0.034013,
        speed=1711.39,
        discs=[(0.243338, 0.422266, 0.0833374), (0.272136, 0.422266, 0.11217)],
        bearings=(0.0335526, 0.415438),
        sensors=(0.00495456, 0.45581),
    )
    assert designed(machine)[0]


def test_what_stands_wrong_is_named_by_the_sums_of_deflections():
    """One bending mode of each kind: magnets at its node, sensors at its node, loud sensors."""
    shaft = {"length": "1 m", "diameter": "40 mm", "speed": "1000 rpm"}
    cases = {
        # the uniform beam's nodes of mode 1 are at 0.224 and 0.776 of its length
        "magnet": (("200 mm", "800 mm"), ("200 mm", "800 mm")),
        "sensor": (("100 mm", "900 mm"), ("215 mm", "785 mm")),
        "loud sensor": (("120 mm", "880 mm"), ("10 mm", "990 mm")),
    }
    for kind, (magnets, sensors) in cases.items():
        machine = amb.new_machine("beam", bearings=magnets, sensors=sensors, **shaft)
        frequency, found, moved = badly_placed(machine)[1]
        assert found == kind and {*moved} == {"A", "B"}
        assert frequency / (2 * np.pi) == pytest.approx(182, rel=0.02)
        if kind == "magnet":  # to where the beam moves by 0.4 of its ends
            assert moved["A"] == pytest.approx(0.136, abs=0.02)
        else:
            places = {bearing.name: bearing.position for bearing in machine.bearings}
            assert moved == places
        said = _barred(machine, [frequency])
        assert "bending mode 1 (18" in said and "towards" in said
    assert 1 not in badly_placed(
        amb.new_machine(
            "beam", bearings=("100 mm", "900 mm"), sensors=("100 mm", "900 mm"), **shaft
        )
    )


@pytest.mark.study
@pytest.mark.parametrize("number", range(40))
def test_forty_machines_are_designed_or_name_what_bars_them(number):
    row = outcome(number)
    print(*row[:-1], sep=" | ")
    if row[2] != "holds":
        print(row[-1])
    assert row[2] == "holds" or row[3] in ("holds once moved", "other cause"), row[-1]
