"""Machines made in code: the same physical checks as for a file, when they are made."""

import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.description import Amplifier, MagnetIron, Tolerance, Touchdown
from ambrose.machine.file.toml import load_machine
from ambrose.machine.machine import Machine
from ambrose.machine.part import Channel, PidSettings, Runout, SealTable, ShaftSection
from ambrose.machine.validation.machine import InvalidMachine, check_machine, problems

SMALL = load_machine(Path(__file__).with_name("small.toml"))
NAN, INF = float("nan"), float("inf")


def with_bearing(**changes) -> Machine:
    return replace(SMALL, bearings=(replace(SMALL.bearings[0], **changes), SMALL.bearings[1]))


def with_seal(**changes) -> Machine:
    return replace(SMALL, seals=(replace(SMALL.seals[0], **changes),), tolerances=())


def refused(make: Callable[[], Machine]) -> tuple[str, ...]:
    """The problems for which a machine cannot be made."""
    with pytest.raises(InvalidMachine) as caught:
        make()
    return caught.value.problems


def test_a_good_machine_has_no_problems():
    assert problems(SMALL) == ()
    check_machine(SMALL)


@pytest.mark.parametrize("wrong", [{"position": NAN}, {"force_per_current": (1.0, 1e70)}])
def test_what_is_refused_is_refused_again(wrong):
    """Numbers that were found good are not looked at twice; those of a refused part are."""
    bearings = (replace(SMALL.bearings[0], **wrong), SMALL.bearings[1])
    first, again = (refused(lambda: replace(SMALL, bearings=bearings)) for _ in range(2))
    assert first == again and len(first) == 1


def test_the_least_machine():
    """A free rotor is a machine, too."""
    free = Machine("free", (ShaftSection(0.0, 1.0, 0.1),), (), ())
    assert free.amplifier == Amplifier("none")
    assert problems(free) == ()


@pytest.mark.parametrize("value", [NAN, INF, -INF, np.float64("nan")])
@pytest.mark.parametrize(
    "change, place",
    [
        (lambda x: replace(SMALL, modal_damping=x), "modal_damping"),
        (
            lambda x: replace(SMALL, shaft=(replace(SMALL.shaft[0], length=x), SMALL.shaft[1])),
            "shaft 1: length",
        ),
        (lambda x: with_bearing(position=x), "bearings A: position"),
        (lambda x: with_bearing(force_per_current=(1.0, x)), "bearings A: force_per_current 2"),
        (lambda x: with_seal(K=x), "seals center: K"),
        (
            lambda x: replace(SMALL, controller=replace(SMALL.controller, gain=(x,))),
            "controller: gain 1",
        ),
    ],
)
def test_not_finite(change, place, value):
    found = refused(lambda: change(value))
    assert len(found) == 1
    assert found[0].startswith(f"{place} is {float(value)}")


def test_not_finite_in_an_array():
    table = SealTable((("pressure", (0.0, 1.0)),), (("k", np.array([0.0, NAN])),))
    assert refused(lambda: with_seal(table=table))[0].startswith(
        "seals center: table: values 1 2 has an element"
    )


def test_no_section():
    found = refused(lambda: replace(SMALL, shaft=()))
    assert len(found) == 1
    assert found[0].startswith("[[shaft]]: there is no section")


def test_sections_may_touch_within_rounding():
    """0.1 + 0.2 is not 0.3."""
    sections = (
        ShaftSection(0.0, 0.1, 0.06),
        ShaftSection(0.1, 0.2, 0.06),
        ShaftSection(0.3, 0.3, 0.06),
    )
    assert sections[1].start + sections[1].length != sections[2].start
    assert replace(SMALL, shaft=sections).length == pytest.approx(0.6)


def test_an_attachment_may_sit_on_the_last_millimetre():
    for place in (SMALL.length, SMALL.length * (1 + 1e-15)):
        assert with_bearing(position=place).bearings[0].position == place
    (found,) = refused(lambda: with_bearing(position=SMALL.length * 1.000001))
    assert "on the shaft, from 0 to 0.6 m" in found


@pytest.mark.parametrize("kind", ["discs", "bearings", "seals", "couplings"])
def test_names_are_unique_over_all_attachments(kind):
    entries = getattr(SMALL, kind)
    other = "B" if kind != "bearings" else "wheel"
    changed = (replace(entries[0], name=other), *entries[1:])
    assert any(
        f'"{other}" is taken' in line
        for line in refused(lambda: replace(SMALL, **{kind: changed}, tolerances=()))
    )


@pytest.mark.parametrize(
    "changes, wanted",
    [
        ({"table": SealTable((), ())}, "axes are missing"),
        (
            {"table": SealTable((("temperature", (1.0, 2.0)),), (("k", (1.0, 2.0)),))},
            'axis "temperature" is unknown',
        ),
        (
            {"table": SealTable((("speed", (1.0, 2.0)),), (("q", (1.0, 2.0)),))},
            'coefficient "q" is unknown',
        ),
        (
            {
                "table": SealTable(
                    (("speed", (1.0, 2.0)), ("speed", (1.0, 2.0))), (("k", (1.0, 2.0)),)
                )
            },
            "repeated",
        ),
        ({"table": SealTable((("speed", ()),), (("k", ()),))}, "ascending"),
        (
            {"table": SealTable((("speed", (1.0, 2.0)),), (("k", np.ones((2, 1))),))},
            "the size of k is 2 x 1",
        ),
        ({"scales_with_pressure": ("C", "C")}, "names a coefficient twice"),
        ({"scales_with_pressure": ("Q",)}, 'unknown coefficient "Q"'),
        ({"reference_pressure": 0.0}, "reference_pressure is 0 Pa"),
    ],
)
def test_seals(changes, wanted):
    assert any(wanted in line for line in refused(lambda: with_seal(**changes)))


def test_tolerances_must_not_name_the_same_number():
    first, second = SMALL.tolerances
    for path in ("seal.center.K", "seal.center.K_xx"):
        both = (first, replace(second, parameter=path))
        (found,) = refused(lambda both=both: replace(SMALL, tolerances=both))
        assert "are the same number" in found
    apart = (
        replace(first, parameter="seal.center.K_yy"),
        replace(second, parameter="seal.center.K_xx"),
    )
    assert replace(SMALL, tolerances=apart).tolerances == apart


def test_a_tolerance_goes_with_its_seal():
    """What belongs together is replaced together."""
    alone = replace(SMALL, supports=(), casing_modes=())
    (found,) = refused(lambda: replace(alone, seals=()))
    assert found.startswith("[[tolerance]] 1: ")
    assert 'names the unknown seal "center"; the machine has no [[seal]]' in found
    assert replace(alone, seals=(), tolerances=()).seals == ()


def test_the_added_mass_takes_no_tolerance():
    (found,) = refused(
        lambda: replace(SMALL, tolerances=(Tolerance("seal.center.M", relative=0.2),))
    )
    assert found.startswith("[[tolerance]] 1: ")
    assert 'give "seal.center.K" or "seal.center.C" a tolerance' in found


def test_a_bearing_goes_with_its_sensor():
    (found,) = refused(lambda: replace(SMALL, sensors=SMALL.sensors[:1]))
    assert (
        found
        == '[[bearing]] B: no [[sensor]] serves it; add one with bearing = "B" and its position'
    )


def test_tilting_needs_two_bearings():
    """One bearing translates; three and more bend, which needs no chain."""
    one = {"bearings": SMALL.bearings[:1], "sensors": SMALL.sensors[:1], "tolerances": ()}
    found = refused(
        lambda: replace(SMALL, **one, controller=replace(SMALL.controller, tilt_gain=1.5))
    )
    assert any(
        "tilt_gain is 1.5, but must be left out; one bearing cannot tilt the rotor, add a second"
        in x
        for x in found
    )
    tilting = PidSettings(
        channels=(Channel(("translate_x", "translate_y", "tilt_x"), 1e4),),
        coordinates="tilt-translate",
    )
    found = refused(lambda: replace(SMALL, **one, controller=tilting))
    wrong = (
        'names holds "tilt_x", but one bearing cannot tilt the rotor; leave it out, or add a '
        "bearing"
    )
    assert list(found) == [f"[[controller.channel]] 1: {wrong}"]


def test_the_exception_lists_all_of_it():
    with pytest.raises(InvalidInput) as caught:
        replace(
            SMALL,
            modal_damping=-1.0,
            beam_theory="euler",
            discs=(replace(SMALL.discs[0], mass=0.0),),
        )
    lines = str(caught.value).splitlines()
    assert lines[0] == 'machine "small" has 3 problems:'
    assert len(lines) == 4
    assert "mass is 0 kg" in str(caught.value)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


@pytest.mark.parametrize(
    "make, place, words",
    [
        (
            lambda: with_bearing(iron=MagnetIron(40.0, 0.0, 5e-5)),
            "[bearing.iron]",
            "flux_density is 0 T",
        ),
        (
            lambda: with_bearing(iron=MagnetIron(40.0, 1.6, -5e-5)),
            "[bearing.iron]",
            "equivalent_gap is -5e-05 m",
        ),
        (lambda: with_bearing(cross_coupling=1.5), "[[bearing]] A", "cross_coupling is 1.5"),
        (
            lambda: with_bearing(magnetic_offset=(0.0, 20.0)),
            "[[bearing]] A",
            "magnetic_offset (eta) is 20 m",
        ),
        (
            lambda: with_bearing(touchdown=Touchdown(friction=-0.1)),
            "[bearing.touchdown]",
            "friction is -0.1",
        ),
        (
            lambda: with_bearing(touchdown_gap=None, touchdown=Touchdown()),
            "[[bearing]] A",
            "touchdown_gap is missing",
        ),
        (lambda: with_sensor(noise=-1e-6), "[[sensor]] A", "noise is -1e-06 m"),
        (lambda: with_sensor(runout=(Runout(0, 1e-6),)), "[[sensor.runout]] 1", "order is 0"),
        (lambda: with_amplifier(inductance=None), "[amplifier]", "inductance is missing"),
        (lambda: with_amplifier(max_voltage=-5.0), "[amplifier]", "max_voltage is -5 V"),
        (
            lambda: replace(SMALL, amplifier=Amplifier(max_voltage=1.0, inductance=1.0)),
            "[amplifier]",
            'order "none"',
        ),
    ],
)
def test_what_only_the_rig_uses_is_checked_too(make, place, words):
    found = refused(make)
    assert len(found) == 1
    assert place in found[0]
    assert words in found[0]


def test_turns_must_agree():
    other = replace(SMALL.bearings[1], iron=MagnetIron(40.0, 1.6, 5e-5))
    assert "turns differ" in refused(lambda: replace(SMALL, bearings=(SMALL.bearings[0], other)))[0]


def with_sensor(**changes) -> Machine:
    return replace(SMALL, sensors=(replace(SMALL.sensors[0], **changes), SMALL.sensors[1]))


def with_amplifier(**changes) -> Machine:
    return replace(SMALL, amplifier=replace(SMALL.amplifier, **changes))


def test_coefficients_as_an_array_are_those_as_a_pair():
    machine = load_machine("seal-rig")
    first, *others = machine.bearings
    pair: Any = np.array(first.force_per_current)
    given = replace(machine, bearings=(replace(first, force_per_current=pair), *others))
    assert given == machine and hash(given.bearings[0]) == hash(first)
    with pytest.raises(InvalidInput, match="force_per_current"):
        replace(machine, bearings=(replace(first, force_per_current=-pair), *others))
