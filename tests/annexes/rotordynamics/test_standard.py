"""The standard's formulas against what they must fulfil between themselves."""

import math

import pytest

from ambrose.annexes.rotordynamics import standard


def test_both_branches_of_the_amount_meet_at_25000_rpm():
    below, above = (standard.residual_amount(100.0, n) for n in (25_000 - 1e-9, 25_000))
    assert below == pytest.approx(above, rel=1e-9)
    assert above == pytest.approx(100.0 / 3.937, rel=1e-4)
    assert standard.residual_amount(100.0, 50_000) == above
    # 6350 W/N
    assert standard.residual_amount(200.0, 10_000) == pytest.approx(127.0)


def test_vibration_limit_is_one_mil_up_to_12000_rpm():
    assert standard.vibration_limit(3000) == standard.vibration_limit(12_000) == 25.4
    assert standard.vibration_limit(48_000) == pytest.approx(12.7)


@pytest.mark.parametrize(
    ("factor", "below", "above"),
    [(2.49, 0, 0), (2.5, 0, 10), (3.5, 8.5, 18.5), (10, 15, 25), (1e9, 16, 26)],
)
def test_separation_margins(factor, below, above):
    assert standard.margin_below(factor) == pytest.approx(below, abs=1e-9)
    assert standard.margin_above(factor) == pytest.approx(above, abs=1e-9)


def test_border_of_region_b():
    assert standard.border_speed_ratio(10.0) == 2.5
    assert standard.border_speed_ratio(16.53) == pytest.approx(2.5, abs=1e-3)
    assert standard.border_speed_ratio(60.0) == pytest.approx(2.0)
    assert standard.border_speed_ratio(61.0) == 0.0


def test_screening_says_every_reason():
    assert standard.screen(1e6, 12e6, 0.3, None, None).enough
    assert standard.screen(1e6, 5e6, 0.3, 2.0, 10.0).enough
    near = standard.screen(1e6, 1.5e6, 0.05, 2.0, 10.0)
    assert not near.enough
    assert len(near.reasons) == 2
    assert not standard.screen(1e6, 5e6, 0.3, 2.6, 10.0).enough
    assert "region B assumed" in standard.screen(1e6, 5e6, 0.3, None, None).reasons[0]
    assert standard.screen(1e6, math.inf, 0.3, None, None).enough
