"""The verdict over several points: passed, worst, tables."""

import json
import sys

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.judge.checks import Check, Checks, Curve, Verification, box_label

BOX = box_label("first")


def point(label, peak, margin=2.0, delay=1e-3, *, stable=True):
    checks = (
        Check(
            "sensitivity.output.max",
            "Peak",
            peak,
            "-",
            3.0,
            "<",
            peak < 3.0,
            "A",
            detail="at 80 Hz",
        ),
        Check("margin.gain.A", "Gain margin", margin, "-", 1.5, ">=", margin >= 1.5),
        Check("margin.delay.A", "Delay margin", delay, "s", relation=">="),
    )
    return Checks(label, stable, checks)


def test_worst_over_points_and_tolerances_by_the_sense_of_the_relation():
    box = Checks(BOX, True, (Check("sensitivity.output.max", "Peak", 2.9, "-", 3.0, "<", True),))
    verdict = Verification(
        (point("first", 2.0, 1.9, 2e-3), point("second", 2.5, 1.7, 3e-3)), (box,)
    )
    assert verdict.worst["sensitivity.output.max"].value == 2.9
    assert verdict.worst["sensitivity.output.max"].detail == BOX
    assert verdict.worst["margin.gain.A"].value == 1.7
    assert verdict.worst["margin.gain.A"].detail == "second"
    assert verdict.worst["margin.delay.A"].value == 2e-3  # information too has a sense
    assert (
        Verification((point("first", 2.0), point("second", 2.5)))
        .worst["sensitivity.output.max"]
        .detail
        == "second: at 80 Hz"
    )


def test_a_value_that_is_no_number_is_the_worst():
    verdict = Verification((point("first", 2.0, float("nan")), point("second", 2.5, 0.1)))
    assert np.isnan(verdict.worst["margin.gain.A"].value)


@pytest.mark.parametrize(
    ("verdict", "passed", "stable"),
    [
        (Verification((point("first", 2.0),)), True, True),
        (Verification((point("first", 2.0), point("second", 3.5))), False, True),
        (Verification((point("first", 2.0),), (Checks("box", False, ()),)), False, False),
        (Verification((point("first", 2.0, stable=False),)), False, False),
        (
            Verification(
                (point("first", 2.0),), left_out=("second: 600 rad/s lies beyond the schedule",)
            ),
            False,
            True,
        ),
        (Verification(()), False, True),
    ],
)
def test_passed_needs_every_point(verdict, passed, stable):
    assert (verdict.passed, verdict.stable) == (passed, stable)


def test_points_by_label():
    verdict = Verification((point("first", 2.0), point("second", 2.5)), (point(BOX, 2.7),))
    assert verdict["second"]["sensitivity.output.max"].value == 2.5
    assert verdict[BOX]["sensitivity.output.max"].value == 2.7
    with pytest.raises(
        KeyError,
        match="'third' was not verified; there are 'first', 'second', 'over all tolerances around "
        "first'",
    ):
        verdict["third"]


def test_it_shows_itself_and_gives_plain_data():
    many = tuple(
        point(f"an operating point with a long name, number {k}", 2.0 + k) for k in range(20)
    )
    verdict = Verification(many, left_out=("<b>",))
    for item in (verdict, many[0], many[0].checks[0], Verification(())):
        assert len(repr(item)) < 200
        assert "\n" not in repr(item)
        assert "<table" in item._repr_html_()
        json.dumps(item.to_dict(), allow_nan=False)
    assert repr(verdict).startswith(
        "Verification(passed=False, stable=True, worst_sensitivity=21, "
        "failed=[sensitivity.output.max]"
    )
    assert "&lt;b&gt;" in verdict._repr_html_()
    assert (
        repr(many[0].checks[1]) == "Check(name=margin.gain.A, value=2, limit=>= 1.5, passed=True)"
    )


def test_frames():
    pandas = pytest.importorskip("pandas")
    verdict = Verification((point("first", 2.0), point("second", 3.5)))
    frame = verdict.to_frame()
    assert isinstance(frame, pandas.DataFrame)
    assert list(frame.columns) == [
        "point",
        "check",
        "value",
        "unit",
        "relation",
        "limit",
        "passed",
        "zone",
        "detail",
    ]
    assert frame[frame.point == "second"].passed.tolist() == [False, True, None]
    assert verdict["first"].to_frame().loc["margin.gain.A", "value"] == 2.0
    curve = Curve(
        "c",
        "Curve",
        "frequency",
        np.array([1.0, 2.0]),
        np.array([[3.0, 4.0]]),
        ("max",),
        "rad/s",
        "-",
    )
    assert curve.to_frame()["max [-]"].to_dict() == {1.0: 3.0, 2.0: 4.0}


def test_a_frame_without_pandas_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InvalidInput, match="pip install pandas"):
        Verification((point("first", 2.0),)).to_frame()
