"""A rotor that hangs in its magnets otherwise than the machine file says: what that makes of the
coefficients is said.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.identification.validation.places import load_doubt, load_remarks, machine_at_load
from ambrose.machine.description import OperatingPoint
from ambrose.model.static_load import operating_magnets
from ambrose.record.record import Record

RIG = load_machine("seal-rig")
UPRIGHT = replace(
    RIG,
    bearings=tuple(replace(bearing, iron=None) for bearing in RIG.bearings),
    gravity_direction=None,
)


def record(**means):
    rows = [value + 0.1 * np.sin(np.arange(100) * 0.2 * np.pi) for value in means.values()]
    return Record("seal-rig", 1e4, tuple(means), ("A",) * len(means), np.array(rows))


@pytest.mark.parametrize("prefix", ["u", "i"])
def test_the_stiffness_grows_with_the_square_of_the_load(prefix):
    """Without iron k_s is c ((i_0 + i)^2 + (i_0 - i)^2)/s^3: 1 + (i/i_0)^2 of that without load,
    and k_i is the same.
    """
    bias = UPRIGHT.bearings[0].bias_current
    data = record(**{f"{prefix}_A_zeta": 0.2 * bias, f"{prefix}_A_eta": 0.05 * bias})
    found = load_remarks(UPRIGHT, [data])
    assert len(found) == 1 and found[0].startswith(
        "A_zeta carries a mean current of 0.8 A, by the weight in the machine file 0 A"
    )
    assert "+4 % of k_s" in found[0]
    here = machine_at_load(UPRIGHT, [data]).bearings[0]
    assert np.divide(
        here.negative_stiffness, UPRIGHT.bearings[0].negative_stiffness
    ) == pytest.approx([1.04, 1.0025], rel=1e-6)


def test_a_rotor_without_load_gets_no_remark():
    assert (
        load_remarks(UPRIGHT, [record(u_A_zeta=0.0, u_B_eta=0.1)])
        == ()
        == load_remarks(UPRIGHT, [])
    )


def test_the_bias_is_that_of_the_operating_point():
    """At 6 A the same load is a smaller part of the bias; the machine file's own is 4 A."""
    given = record(u_A_zeta=0.8)
    own, other = (
        float(load_remarks(UPRIGHT, [item])[0].split("k_i and +")[1].split(" %")[0])
        for item in (given, replace(given, point=OperatingPoint(bias_current=6.0)))
    )
    assert own == pytest.approx(4.0, abs=0.1) and other == pytest.approx(
        100 * (0.8 / 6) ** 2, abs=0.1
    )


def test_the_load_of_the_machine_file_is_no_news():
    """The rig lies: its file knows what its magnets carry, and its coefficients are those there."""
    currents = dict(
        zip(RIG.axes, (i for item in operating_magnets(RIG) for i in item.currents), strict=True)
    )
    as_told = record(**{f"i_{axis}": value for axis, value in currents.items()})
    assert load_remarks(RIG, [as_told]) == ()
    for given, here in zip(RIG.bearings, machine_at_load(RIG, [as_told]).bearings, strict=True):
        assert here.negative_stiffness == pytest.approx(given.negative_stiffness, rel=1e-6)
    more = record(**{f"i_{axis}": 1.3 * value for axis, value in currents.items()})
    assert "of k_s" in load_remarks(RIG, [more])[0]


def test_currents_without_their_mean_are_no_load():
    flat = record(**{f"i_{axis}": 0.0 for axis in RIG.axes})
    assert load_remarks(RIG, [flat]) == () and machine_at_load(RIG, [flat]) is RIG


def test_a_machine_that_needs_other_currents_for_its_weight_is_doubted():
    """Balancing and calibration go by the model: magnets a quarter weaker than stated would pass
    their error on.
    """
    currents = dict(
        zip(RIG.axes, (i for item in operating_magnets(RIG) for i in item.currents), strict=True)
    )
    for share, doubted in ((1.0, False), (1.05, False), (1.25, True), (0.8, True), (0.0, False)):
        told = load_doubt(
            RIG, [record(**{f"i_{axis}": share * value for axis, value in currents.items()})]
        )
        assert bool(told) is doubted and (not doubted or "identify the machine first" in told)
    assert load_doubt(UPRIGHT, [record(i_A_zeta=0.5)]) == ""
