"""A rotor that hangs in its magnets: what its weight makes of their coefficients is said."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.identification.validation.operating_load import load_remarks
from ambrose.machine.description import OperatingPoint
from ambrose.machine.record.record import Record

RIG = load_machine("seal-rig")
RIG = replace(RIG, bearings=tuple(replace(bearing, iron=None) for bearing in RIG.bearings))


def record(**means):
    rows = [value + 0.1 * np.sin(np.arange(100) * 0.2 * np.pi) for value in means.values()]
    return Record("seal-rig", 1e4, tuple(means), ("A",) * len(means), np.array(rows))


@pytest.mark.parametrize("prefix", ["u", "i"])
def test_the_stiffness_grows_with_the_square_of_the_load(prefix):
    """Without iron k_s is c ((i_0 + i)^2 + (i_0 - i)^2)/s^3: 1 + (i/i_0)^2 of that without load, and k_i is the same."""
    bias = RIG.bearings[0].bias_current
    found = load_remarks(RIG, [record(**{f"{prefix}_A_zeta": 0.2 * bias, f"{prefix}_A_eta": 0.05 * bias})])
    assert len(found) == 1 and found[0].startswith("A_zeta carries a mean current")
    assert "+4 % of k_s" in found[0]


def test_a_rotor_without_load_gets_no_remark():
    assert load_remarks(RIG, [record(u_A_zeta=0.0, u_B_eta=0.1)]) == () == load_remarks(RIG, [])


def test_the_bias_is_that_of_the_operating_point():
    """At 6 A the same load is a smaller part of the bias; the machine file's own is 4 A."""
    given = record(u_A_zeta=0.8)
    own, other = (
        float(load_remarks(RIG, [item])[0].split("k_i and +")[1].split(" %")[0])
        for item in (given, replace(given, point=OperatingPoint(bias_current=6.0)))
    )
    assert own == pytest.approx(4.0, abs=0.1) and other == pytest.approx(100 * (0.8 / 6) ** 2, abs=0.1)
