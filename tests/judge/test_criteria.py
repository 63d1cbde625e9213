"""Limits are data; requirements override them; a value becomes a zone and a verdict."""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.judge.checks import Check, Checks, judge, zone as zone_of, zone_lines
from ambrose.machine import criteria
from ambrose.machine.description import Requirements


@pytest.mark.parametrize(
    ("value", "zone"),
    [
        (1.0, "A"),
        (2.999, "A"),
        (3.0, "B"),
        (3.999, "B"),
        (4.0, "C"),
        (4.999, "C"),
        (5.0, "D"),
        (40.0, "D"),
    ],
)
def test_iso_14839_3_zones(value, zone):
    assert zone_of(criteria.SENSITIVITY, value) == zone


@pytest.mark.parametrize(("value", "zone"), [(0.29, "A"), (0.39, "B"), (0.49, "C"), (0.51, "D")])
def test_iso_14839_2_zones(value, zone):
    assert zone_of(criteria.CLEARANCE, value) == zone


def test_a_criterion_without_zones_has_none():
    assert zone_of(criteria.LOG_DECREMENT, 0.01) is None


def test_the_standard_judges_an_axis_and_no_singular_value():
    free = Requirements()
    per_axis = criteria.demand("sensitivity of an axis", free)
    assert (per_axis.limit, per_axis.relation) == (3.0, "<")
    assert per_axis.source.startswith("ISO 14839-3:2006")
    largest = criteria.demand("maximum singular value of a sensitivity", free)
    check = judge("s", "S", 4.5, "-", largest)
    assert (check.limit, check.passed, check.zone) == (None, None, None)


def test_a_value_on_the_zone_border_fails_the_standard_and_meets_an_equal_requirement():
    free, own = Requirements(), Requirements(sensitivity_peak=3.0)
    assert (
        judge("s", "S", 3.0, "-", criteria.demand("sensitivity of an axis", free)).passed is False
    )
    assert judge("s", "S", 3.0, "-", criteria.demand("sensitivity of an axis", own)).passed is True


@pytest.mark.parametrize(
    ("quantity", "field", "relation"),
    [
        ("sensitivity of an axis", "sensitivity_peak", "<="),
        ("maximum singular value of a sensitivity", "sensitivity_peak", "<="),
        ("compliance", "compliance_peak", "<="),
        ("log decrement", "log_decrement", ">="),
        ("unbalance orbit", "unbalance_orbit", "<="),
        ("settling time", "settling_time", "<="),
        ("gain margin", "gain_margin", ">="),
        ("phase margin", "phase_margin", ">="),
        ("current", "max_current", "<="),
    ],
)
def test_requirements_override(quantity, field, relation):
    wanted = criteria.demand(quantity, Requirements(**{field: 0.37}))
    assert (wanted.limit, wanted.relation, wanted.source) == (
        0.37,
        relation,
        f"requirement {field}",
    )
    good, bad = (0.36, 0.38) if relation == "<=" else (0.38, 0.36)
    assert judge("c", "C", good, "-", wanted).passed is True
    assert judge("c", "C", bad, "-", wanted).passed is False


def test_every_rule_names_a_field_of_the_requirements():
    for rule in criteria.RULES.values():
        assert rule.requirement is None or rule.requirement in Requirements.__dataclass_fields__
        criteria.demand(rule.quantity, Requirements())


def test_recalled_figures_say_so():
    known = [item for item in vars(criteria).values() if isinstance(item, criteria.Criterion)]
    assert len(known) == 6
    for item in known:
        assert item.standard and item.edition and item.unit and item.limits
        assert list(item.limits) == sorted(item.limits, key=lambda limit: limit.value)
        assert ("recalled" in item.source) is not item.limits[0].confirmed
    assert [limit.confirmed for limit in criteria.SENSITIVITY.limits] == [True, False, False]


def test_zone_lines_are_the_borders_with_the_users_own_first():
    lines = zone_lines(criteria.SENSITIVITY, 2.5)
    assert lines == (("required", 2.5), ("zone A/B", 3.0), ("zone B/C", 4.0), ("zone C/D", 5.0))


def test_an_infinite_value_is_judged():
    wanted = criteria.demand("settling time", Requirements(settling_time=0.1))
    assert judge("t", "T", np.inf, "s", wanted).passed is False


def test_checks_look_up_and_summary():
    fine, bad = (
        Check("a", "A", 1.0, "-", 2.0, passed=True),
        Check("b", "B", 3.0, "-", 2.0, passed=False),
    )
    note = Check("c", "C", 3.0, "-")
    assert Checks("x", True, (fine, note)).passed
    assert not Checks("x", True, (fine, bad)).passed
    assert not Checks("x", False, (fine,)).passed
    assert Checks("x", True, (fine, note))["c"] is note
    with pytest.raises(KeyError):
        Checks("x", True, (fine,))["nothing"]
