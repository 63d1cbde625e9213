"""A campaign's page: what is on it, its verdicts, and pages without truth or with one method
only.
"""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.identification.validation.repeatability import repeats
from ambrose.report.page import render

# the campaigns are commands and no part of the package
sys.path.insert(0, str(Path(__file__).parents[2]))
campaign_page = importlib.import_module("benchmarks.campaign_page")
sys.path.pop(0)
Condition, campaign_page = campaign_page.Condition, campaign_page.campaign_page
MACHINE = load_machine("seal-rig")
K_I = tuple(f"bearing.{b}.force_per_current.{a}" for b in "AB" for a in ("zeta", "eta"))
PATHS = (*K_I, "bearing.A.negative_stiffness.zeta", "tau_e")
TRUTH = dict(zip(PATHS, (230.0, 240.0, 277.0, 283.0, 2.4e6, 3e-4), strict=True))


def condition(bias, off=0.0, **more):
    rng = np.random.default_rng(int(bias))
    size = np.array([TRUTH[path] for path in PATHS])
    dynamic = repeats(
        PATHS, size * (1 + 1e-3 * rng.standard_normal((5, 6))), np.tile(1e-3 * size, (5, 1))
    )
    static = repeats(K_I, size[:4] * (1 + off) * (1 + 1e-6 * rng.standard_normal((5, 4))))
    return Condition(f"{bias:g} A", bias, {"closed loop": dynamic, "static load": static}, **more)


def test_everything_is_on_the_page():
    known = {"truth": TRUTH, "reference": {PATHS[4]: 2.39e6}, "fit": 95.4}
    report = campaign_page(
        MACHINE, [condition(6.0, **known), condition(8.0, -0.01, **known)], reference="printed"
    )
    assert [section.title for section in report.sections] == [
        "Force per current",
        "Negative stiffness",
        "Lag of the actuator",
    ]
    first, second, third = (section.tables[0] for section in report.sections)
    assert len(first.rows) == 16 and "Printed" not in first.columns and "Printed" in second.columns
    assert (
        first.columns[3] == "Mean [N/A]"
        and second.columns[3] == "Mean [MN/m]"
        and third.columns[3] == "Mean [ms]"
    )
    assert first.rows[1][3].text.endswith("± < 0.01") and first.rows[1][4].text == "< 0.01 %"
    assert report.passed and "static load and closed loop agree within 1" in report.verdicts[1].text
    assert "average fit 95.4 %" in report.verdicts[0].text
    page = render(report)
    assert "A ζ" in page and "Diamonds: printed" in page


def test_methods_that_differ_fail():
    report = campaign_page(MACHINE, [condition(6.0), condition(10.0, -0.12)])
    assert [verdict.passed for verdict in report.verdicts] == [True, False] and not report.passed


def test_one_method_alone_is_no_verdict():
    alone = Condition(
        "6 A", 6.0, {"closed loop": repeats(K_I, [[1.0, 2.0, 3.0, 4.0], [1.1, 2.1, 3.1, 4.1]])}
    )
    report = campaign_page(MACHINE, [alone])
    assert report.passed is None and report.verdicts[0].text == "nothing to compare with"
    assert "Truth" not in report.sections[0].tables[0].columns
    with pytest.raises(InvalidInput, match="at least one condition"):
        campaign_page(MACHINE, [])
