"""Critical speeds and amplification factors against the closed form of one mass on a spring."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose.judge.campbell import critical_speeds, separation_check
from ambrose.judge.checks import Curve
from ambrose.judge.nominal import check
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, Requirements
from ambrose.model.assemble import assemble
from ambrose.model.static_load import allowed_amplification, needed_damping, running_range
from coarse import coarse


def response(speeds, *modes):
    """Orbits under unbalance of masses with (natural speed, damping ratio) each."""
    return np.array(
        [w2 / np.hypot(n**2 - w2, 2 * z * n * speeds) for n, z in modes for w2 in [speeds**2]]
    )


def curve(speeds, rows, labels):
    return Curve("unbalance", "Unbalance response", "speed", speeds, rows, labels, "rad/s", "m")


@pytest.mark.parametrize("damping", [0.02, 0.05, 0.1])
def test_the_factor_of_one_mass_is_that_of_the_closed_form(damping):
    speeds = np.linspace(10, 3000, 8000)
    rows = response(speeds, (600.0, damping))
    ((speed, factor),) = critical_speeds(curve(speeds, rows, ("A, in phase",)))
    peak = 600 / np.sqrt(1 - 2 * damping**2)
    # half power: r^4 / ((1 - r^2)^2 + (2 z r)^2) = max / 2, a quadratic in r^2
    half = 0.5 / (4 * damping**2 * (1 - damping**2))
    roots = np.sqrt(np.roots([1 - 1 / half, 4 * damping**2 - 2, 1]).real)
    assert speed == pytest.approx(peak, rel=1e-3)
    assert factor == pytest.approx(peak / (600 * abs(roots[0] - roots[1])), rel=0.01)


def test_a_critically_damped_peak_and_the_envelope_are_no_critical_speeds():
    speeds = np.linspace(10, 3000, 4000)
    assert critical_speeds(curve(speeds, response(speeds, (600.0, 0.35)), ("A, in phase",))) == ()
    rows = np.vstack([response(speeds, (900.0, 0.02)), response(speeds, (600.0, 0.05))])
    found = critical_speeds(curve(speeds, rows, ("worst case", "A, in phase")))
    assert [round(speed, -1) for speed, _ in found] == [600.0]


def test_lines_that_peak_together_are_one_and_others_go_by_speed():
    speeds = np.linspace(10, 3000, 8000)
    rows = response(speeds, (1500.0, 0.03), (600.0, 0.05), (605.0, 0.04))
    found = critical_speeds(curve(speeds, rows, ("A, in antiphase", "A, in phase", "B, in phase")))
    assert [round(speed, -1) for speed, _ in found] == [610.0, 1500.0]
    assert found[0][1] > critical_speeds(curve(speeds, rows[1:2], ("A, in phase",)))[0][1]


def test_a_curve_that_ends_at_its_peak_has_none_and_one_flank_is_taken_twice():
    speeds = np.linspace(10, 3000, 8000)
    row = response(speeds, (600.0, 0.05))
    rising = speeds <= 600
    assert critical_speeds(curve(speeds[rising], row[:, rising], ("A, in phase",))) == ()
    short = speeds <= 610
    ((_, factor),) = critical_speeds(curve(speeds[short], row[:, short], ("A, in phase",)))
    assert factor == pytest.approx(10, rel=0.1)


RUNNING = (900.0, 1000.0)


@pytest.mark.parametrize(
    ("factor", "below", "above"),
    [(2.5, 0.0, 10.0), (5.0, 12.142857, 22.142857), (10.0, 15.0, 25.0)],
)
def test_the_allowed_factor_is_the_standards_formula_turned_round(factor, below, above):
    """17 (1 - 1/(AF - 1.5)) per cent of the lowest speed below, 10 more of the highest above;
    worked out by hand.
    """
    places = np.array([900 * (1 - below / 100), 1000 * (1 + above / 100)])
    assert allowed_amplification(places, RUNNING) == pytest.approx([factor, factor], rel=1e-5)
    damping, slope = needed_damping(places, RUNNING)
    assert damping == pytest.approx([0.5 / factor] * 2, rel=1e-5)
    steps = [needed_damping(places + h, RUNNING)[0] for h in (-1e-3, 1e-3)]
    if factor > 2.5:  # a corner of the formula
        assert slope == pytest.approx((steps[1] - steps[0]) / 2e-3, rel=1e-6)


def test_inside_nothing_sharp_is_allowed_and_far_away_anything():
    assert (allowed_amplification(np.array([900.0, 950.0, 1000.0, 1050.0]), RUNNING) == 2.5).all()
    assert np.isinf(allowed_amplification(np.array([755.0, 1261.0]), RUNNING)).all()
    assert (needed_damping(np.array([700.0, 1300.0]), RUNNING)[0] == 0).all()


PLACES = [
    (950, 0.21, True),
    (950, 0.1, False),
    (840, 0.05, False),
    (760, 0.05, True),
    (1150, 0.15, True),
    (1150, 0.05, False),
    (1280, 0.01, True),
]


@pytest.mark.parametrize(("at", "damping", "passed"), PLACES)
def test_a_critical_speed_is_judged_by_its_place(at, damping, passed):
    speeds = np.linspace(10, 2000, 20000)
    found = separation_check(
        speeds, response(speeds, (float(at), damping)), Requirements(), RUNNING
    )
    assert found.passed is passed
    assert {950: "allowed 2.5", 760: "allowed", 1280: "far enough"}.get(
        at, ""
    ) in found.detail or damping == 0.21


def test_the_critical_speed_that_binds_is_named_first():
    """A value of 16.1 was explained by an innocent mode at a lower speed, "far enough"."""
    speeds = np.linspace(10, 2000, 20000)
    rows = response(speeds, (300.0, 0.1), (950.0, 0.02))
    found = separation_check(speeds, rows, Requirements(), RUNNING)
    first, *others = found.detail.split("; ")
    assert found.value == pytest.approx(10, rel=0.05) and first.endswith("allowed 2.5")
    assert any(other.endswith("far enough") for other in others)


def test_a_machine_without_running_speeds_runs_at_all_its_turning_points_and_between():
    """Separation was judged with ``running_speeds`` alone: without them verify was silent, and the
    two-disc rotor's critical speed at 59 Hz, AF 3.1 within its running range, in no row.
    """
    machine = coarse("two-disc-rotor")
    law = pid_controller(machine.reference, machine)
    turning = [point.speed for point in machine.operation.envelope if point.speed > 0]
    stated = replace(
        machine,
        requirements=replace(machine.requirements, running_speeds=(min(turning), max(turning))),
    )

    def row(one, point):
        checks = check(assemble(one, point), law).checks
        return [item for item in checks if item.name == "unbalance.separation"]

    for point in (one for one in machine.operation.envelope if one.speed > 0):
        (own,) = row(machine, point)
        (told,) = row(stated, point)
        assert (own.value, own.title, own.passed) == (told.value, told.title, told.passed)
        assert own.passed is False
        assert own.detail == told.detail + (
            "; no running_speeds in the machine file: taken to run from its slowest to its fastest "
            "turning operating point"
        )
    assert row(machine, OperatingPoint(0.0)) == []
    assert running_range(None, [0.0]) is None
