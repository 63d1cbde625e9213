"""Machines made in code: the same physical checks as for a file."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.config import load_machine
from ambrose.machine.description import Amplifier, Machine, SealTable, ShaftSection
from ambrose.machine.validate import check_machine, problems

SMALL = load_machine(Path(__file__).with_name("small.toml"))
NAN, INF = float("nan"), float("inf")


def with_bearing(**changes) -> Machine:
    return replace(SMALL, bearings=(replace(SMALL.bearings[0], **changes), SMALL.bearings[1]))


def with_seal(**changes) -> Machine:
    return replace(SMALL, seals=(replace(SMALL.seals[0], **changes),), tolerances=())


def test_a_good_machine_has_no_problems():
    assert problems(SMALL) == ()
    check_machine(SMALL)


def test_the_least_machine():
    """A free rotor is a machine, too."""
    check_machine(Machine("free", (ShaftSection(0.0, 1.0, 0.1),), (), (), Amplifier("none")))


@pytest.mark.parametrize("value", [NAN, INF, -INF, np.float64("nan")])
@pytest.mark.parametrize(
    "change, place",
    [
        (lambda x: replace(SMALL, modal_damping=x), "modal_damping"),
        (lambda x: replace(SMALL, shaft=(replace(SMALL.shaft[0], length=x), SMALL.shaft[1])), "shaft 1: length"),
        (lambda x: with_bearing(position=x), "bearings A: position"),
        (lambda x: with_bearing(force_per_current=(1.0, x)), "bearings A: force_per_current 2"),
        (lambda x: with_seal(K=x), "seals center: K"),
        (lambda x: replace(SMALL, controller=replace(SMALL.controller, gain=(x,))), "controller: gain 1"),
    ],
)
def test_not_finite(change, place, value):
    found = problems(change(value))
    assert len(found) == 1
    assert found[0].startswith(f"{place} is {float(value)}")


def test_not_finite_in_an_array():
    table = SealTable((("pressure", (0.0, 1.0)),), (("k", np.array([0.0, NAN])),))
    assert problems(with_seal(table=table))[0].startswith("seals center: table: values 1 2 has an element")


def test_no_section():
    found = problems(replace(SMALL, shaft=()))
    assert len(found) == 1
    assert found[0].startswith("[[shaft]]: there is no section")


def test_sections_may_touch_within_rounding():
    """0.1 + 0.2 is not 0.3."""
    sections = (ShaftSection(0.0, 0.1, 0.1), ShaftSection(0.1, 0.2, 0.1), ShaftSection(0.3, 0.3, 0.1))
    assert sections[1].start + sections[1].length != sections[2].start
    check_machine(replace(SMALL, shaft=sections))


def test_an_attachment_may_sit_on_the_last_millimetre():
    check_machine(with_bearing(position=SMALL.length))
    check_machine(with_bearing(position=SMALL.length * (1 + 1e-15)))
    assert problems(with_bearing(position=SMALL.length * 1.000001))


@pytest.mark.parametrize("kind", ["discs", "bearings", "seals", "couplings"])
def test_names_are_unique_over_all_attachments(kind):
    entries = getattr(SMALL, kind)
    other = "B" if kind != "bearings" else "wheel"
    changed = replace(SMALL, **{kind: (replace(entries[0], name=other), *entries[1:])}, tolerances=())
    assert any(f'"{other}" is taken' in line for line in problems(changed))


@pytest.mark.parametrize(
    "changes, wanted",
    [
        ({"table": SealTable((), ())}, "axes are missing"),
        ({"table": SealTable((("temperature", (1.0, 2.0)),), (("k", (1.0, 2.0)),))}, 'axis "temperature" is unknown'),
        ({"table": SealTable((("speed", (1.0, 2.0)),), (("q", (1.0, 2.0)),))}, 'coefficient "q" is unknown'),
        ({"table": SealTable((("speed", (1.0, 2.0)), ("speed", (1.0, 2.0))), (("k", (1.0, 2.0)),))}, "repeated"),
        ({"table": SealTable((("speed", ()),), (("k", ()),))}, "ascending"),
        ({"table": SealTable((("speed", (1.0, 2.0)),), (("k", np.ones((2, 1))),))}, "the size of k is 2 x 1"),
        ({"scales_with_pressure": ("C", "C")}, "names a coefficient twice"),
        ({"scales_with_pressure": ("Q",)}, 'unknown coefficient "Q"'),
        ({"reference_pressure": 0.0}, "reference_pressure is 0 Pa"),
    ],
)
def test_seals(changes, wanted):
    assert any(wanted in line for line in problems(with_seal(**changes)))


def test_tolerances_must_not_name_the_same_number():
    first, second = SMALL.tolerances
    for path in ("seal.center.K", "seal.center.K_xx"):
        changed = replace(SMALL, tolerances=(first, replace(second, parameter=path)))
        assert any("are the same number" in line for line in problems(changed))
    apart = replace(
        SMALL, tolerances=(replace(first, parameter="seal.center.K_yy"), replace(second, parameter="seal.center.K_xx"))
    )
    check_machine(apart)


def test_tilting_needs_two_bearings():
    one = replace(SMALL, bearings=SMALL.bearings[:1], sensors=SMALL.sensors[:1])
    assert any("tilting needs two bearings, there are 1" in line for line in problems(one))


def test_the_exception_lists_all_of_it():
    with pytest.raises(InvalidInput) as caught:
        check_machine(replace(SMALL, modal_damping=-1.0, beam_theory="euler", discs=(replace(SMALL.discs[0], mass=0.0),)))
    assert str(caught.value).splitlines()[0] == 'machine "small" has 3 problems:'
    assert "mass is 0 kg" in str(caught.value)
