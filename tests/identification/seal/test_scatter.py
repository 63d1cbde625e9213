"""Points off their line over pressure, and coefficients beyond the file's tolerance, are named."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.identification.findings import Code
from ambrose.identification.seal.by_pressure import SealByPressure, SealFit, beyond_tolerance
from ambrose.machine.description import Tolerance

PRESSURES = np.array([0.0, 0.5e5, 1.0e5, 1.5e5, 2.0e5])
SLOPES = np.array([1.0, 15.7, 0.01, 0.002])  # of K, k, C, c over pressure
DEVIATIONS = np.array([2e3, 3e3, 5.0, 5.0])


def fit(seed=0, off=None, count=5):
    """Points on lines with the scatter that they state; off: (row, column, standard deviations)
    moved further.
    """
    rng = np.random.default_rng(seed)
    pressure = PRESSURES[:count]
    values = pressure[:, None] * SLOPES + DEVIATIONS * rng.standard_normal((count, 4))
    if off is not None:
        values[off[0], off[1]] += off[2] * DEVIATIONS[off[1]]
    deviations = np.tile(DEVIATIONS, (count, 1))
    eight = np.full((count, 8), np.nan)
    cosine = np.full((count, 4, 4), np.nan)
    still = np.full(count, np.nan), np.zeros((count, 4))
    return SealFit(
        "seal-rig",
        "center",
        pressure,
        still[0],
        values,
        deviations,
        eight,
        eight,
        cosine,
        cosine,
        still[1],
        "made",
    )


def test_scatter_as_stated_says_nothing():
    quiet = [SealByPressure(fit(seed), "line", 0.0) for seed in range(100)]
    # of 4 x 5 points beyond 3 deviations: 5 % by chance
    assert sum(bool(one.findings or one.note) for one in quiet) <= 10


def test_a_point_off_the_line_is_named_with_its_pressure():
    one = SealByPressure(fit(off=(3, 1, 40.0)), "line", 0.0)
    (found,) = one.findings
    assert (
        found.code == Code.SEAL_SCATTER
        and "seal center k at 150000 Pa is off the line" in found.what
    )
    assert "% of its largest value" in found.evidence and "the others lie on a line" in found.remedy
    # a table holds any course
    assert SealByPressure(fit(off=(3, 1, 40.0)), "table", 0.0).findings == ()
    little = SealByPressure(fit(off=(3, 1, 9.0)), "line", 3e5)  # sure, but below 2 % of k
    assert (
        not little.findings
        and "is extrapolated to 300000 Pa" in little.note
        and "k at 150000 Pa is off the line" in little.note
    )
    three = SealByPressure(fit(off=(1, 1, 40.0), count=3), "line", 0.0).findings
    assert "do not tell which" in three[0].remedy


def test_a_bent_course_is_no_line():
    bent = fit()
    values = bent.values.copy()
    values[:, 1] = 3.2e6 * np.sqrt(PRESSURES / 2e5)
    (found,) = SealByPressure(replace(bent, values=values), "line", 0.0).findings
    assert "the others scatter, too: take the form table" in found.remedy


def test_coefficients_beyond_the_tolerance_of_the_file_at_their_pressure():
    machine = load_machine("seal-rig")
    item = machine.seals[0]
    assert {"K", "k", "C", "c"} >= set(item.scales_with_pressure) - {"M"}
    given = np.array([getattr(item, letter) for letter in "KkCc"])
    law = PRESSURES[:, None] / item.reference_pressure * given
    stated = replace(
        machine,
        tolerances=(
            Tolerance("seal.center.k", relative=0.1),
            Tolerance("seal.center.C", relative=0.2),
        ),
    )
    as_given = replace(fit(), values=law)
    assert beyond_tolerance(stated, as_given) == ()
    # nothing was stated
    assert beyond_tolerance(replace(stated, tolerances=()), replace(as_given, values=2 * law)) == ()
    (found,) = beyond_tolerance(stated, replace(as_given, values=law * [2.0, 1.15, 1.15, 2.0]))
    assert (
        found.code == Code.FAR_FROM_FILE
        and "k at 200000 Pa is 1.15 times the file's, beyond its tolerance of 10 %" in str(found)
    )
    assert "C at" not in str(found) and "K at" not in str(found)
    pressed = replace(machine, tolerances=(Tolerance("seal.center.pressure", relative=0.3),))
    assert beyond_tolerance(pressed, replace(as_given, values=1.25 * law)) == ()
    assert "k at 50000 Pa is 1.4 times" in str(
        beyond_tolerance(pressed, replace(as_given, values=1.4 * law))[0]
    )
    assert pytest.approx(0.0) == law[0, 1]  # without pressure there is no share to tell
