"""A range of operating points: its corners, and what is found between them."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.judge.result import certify
from ambrose.judge.verdict import search, verify_controller, verify_ranges
from ambrose.law.loop import Timing, closed_loop, running_law
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, OperatingRange
from ambrose.machine.part import SealTable
from ambrose.model.assemble import assemble
from ambrose.model.effects.stations import JournalBearing
from ambrose.model.uncertainty import reduce

AREA = OperatingRange("running", (0.0, 600.0), (0.0, 0.5e5))


@pytest.fixture(scope="module")
def machine():
    m = amb.load_machine("seal-rig")
    points = (OperatingPoint(label="rest"), OperatingPoint(600.0, 0.5e5, label="full"))
    return replace(
        m,
        operation=replace(m.operation, points=points, ranges=(AREA,), design_point=""),
        tolerances=(),
    )


def test_corners_are_operating_points_but_those_that_are_points_already(machine):
    labels = [point.label for point in machine.operation.envelope]
    assert labels == ["rest", "full", "running: 0 rpm, 0.5 bar", "running: 5729.58 rpm, 0 bar"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"speed": (5.0, 5.0), "seal_pressure": (1.0, 1.0)},
            "has no width in speed nor in seal_pressure; make it an",
        ),
        ({"speed": (9.0, 5.0)}, r"speed is \[9, 5\].*swap the two"),
        ({"seal_pressure": (-1.0, 5.0)}, "seal_pressure"),
        ({"label": "rest"}, "is taken by a point or an earlier range"),
        ({"label": ""}, "label"),
    ],
)
def test_a_range_that_is_none_is_refused(machine, change, words):
    with pytest.raises(amb.InvalidInput, match=words):
        replace(machine, operation=replace(machine.operation, ranges=(replace(AREA, **change),)))


@pytest.mark.parametrize(
    "timing",
    [
        pytest.param(None, marks=pytest.mark.study),
        Timing(1e-4, 1),
    ],
)
def test_the_peak_that_is_found_is_that_of_a_fine_grid(machine, timing):
    K = pid_controller(machine.controller, machine)
    found = search(machine, AREA, K, timing)
    runs = K if timing is None else timing.in_loop(K)
    fine = [
        certify(reduce(assemble(machine, AREA.at(speed, pressure)), 3), runs).closed_loop_norm
        for speed in np.linspace(0, 600, 4)
        for pressure in np.linspace(0, 0.5e5, 4)
    ]
    assert found.peak.max() == pytest.approx(max(fine), rel=5e-3)
    assert found.change <= 0.05 or found.peak.size > 26
    assert (found.abscissa < 0).all()


def test_a_loop_that_is_lost_at_high_pressure_is_found(machine):
    """The PID holds the seal rig without pressure and loses it below 4 bar; the search says where
    it is lost most.
    """
    wide = replace(
        machine,
        operation=replace(machine.operation, ranges=(replace(AREA, seal_pressure=(0.0, 4e5)),)),
    )
    found = search(
        wide, wide.operation.ranges[0], pid_controller(machine.controller, machine), Timing(1e-4, 1)
    )
    lost = found.abscissa >= 0
    assert lost[:, -1].all()
    assert not lost[:, 0].any()
    assert np.isinf(found.peak[lost]).all()
    assert found.worst(wide.operation.ranges[0]).seal_pressure == 4e5


def test_the_range_is_part_of_the_verdict(machine):
    law = pid_controller(machine.controller, machine)
    (inside,), beyond = verify_ranges(machine, law, (), lambda stage: None, Timing(1e-4, 1))
    assert inside.label == "running"
    assert beyond == ()
    corner = assemble(machine, machine.operation.points[1])
    assert (
        inside["range.sensitivity"].value
        >= 0.999 * certify(corner, Timing(1e-4, 1).in_loop(law)).closed_loop_norm
    )
    assert inside["range.sensitivity"].passed is (
        inside["range.sensitivity"].value <= inside["range.sensitivity"].limit
    )
    verdict = amb.Verification((), (), ranges=(inside,))
    assert dict(verdict.labelled)["running"] is inside
    assert verdict.to_dict()["ranges"][0]["label"] == "running"


def test_verify_judges_the_corners_and_what_lies_between(machine):
    verdict = verify_controller(
        machine, pid_controller(machine.controller, machine), rate=1e4, tolerances=False
    )
    (inside,) = verdict.ranges
    corners = max(checks["sensitivity.output.max"].value for checks in verdict.points)
    assert len(verdict.points) == 4
    assert inside["range.sensitivity"].value >= 0.999 * corners


def test_the_worst_of_a_range_is_that_of_a_grid_of_its_own(machine):
    """A range in which the peak lies inside: no point of another grid is worse by more than
    0.1 %.
    """
    law, timing = pid_controller(machine.controller, machine), Timing(1e-4, 1)
    (inside,), _ = verify_ranges(machine, law, (), lambda stage: None, timing)
    runs = timing.in_loop(law)
    own = [
        certify(assemble(machine, AREA.at(speed, pressure)), runs, margins=False)
        for speed in np.linspace(0, 600, 7)
        for pressure in np.linspace(0, 0.5e5, 5)
    ]
    assert inside["range.sensitivity"].value >= 0.999 * max(item.closed_loop_norm for item in own)
    worst = max(item.spectral_abscissa for item in own)
    assert inside["range.abscissa"].value >= worst - 1e-3 * abs(worst)
    for name in ("range.sensitivity", "range.abscissa"):
        assert "speeds and pressures, refined at the worst" in inside[name].title


def test_a_speed_of_a_range_at_which_a_table_bends_is_judged(machine):
    """A film that drives whirl at 355 rad/s alone: between the speeds of any even grid."""
    film = JournalBearing(
        "film",
        0.43,
        *((0.0,) * 5 for _ in range(4)),
        speed=(0.0, 350.0, 355.0, 360.0, 600.0),
        K_xy=(0.0, 0.0, 2e7, 0.0, 0.0),
        K_yx=(0.0, 0.0, -2e7, 0.0, 0.0),
    )
    driven = replace(machine, effects=(*machine.effects, film))
    law = pid_controller(machine.controller, machine)
    (inside,), _ = verify_ranges(driven, law, (), lambda stage: None, Timing(1e-4, 1))
    own = Timing(1e-4, 1).in_loop(law)
    lost = certify(assemble(driven, AREA.at(355.0, 0.5e5)), own, margins=False)
    assert lost.spectral_abscissa > 0
    assert inside["range.abscissa"].value >= lost.spectral_abscissa * (1 - 1e-9)
    assert not inside.passed


def test_a_table_that_bends_between_grid_pressures_is_looked_at_where_it_bends(machine):
    """Ends and middle of the pressures have no cross-coupling; three quarters of the way has."""
    (seal,) = machine.seals
    span = (0.0, 0.25e5, 0.375e5, 0.5e5)
    table = SealTable((("pressure", span),), (("k", (0.0, 0.0, 5e7, 0.0)),))
    seal = replace(seal, k=0.0, table=table, scales_with_pressure=(), reference_pressure=None)
    why = ("seal.center.scales_with_pressure", "made for this test")
    bent = replace(machine, seals=(seal,), assumed=(*machine.assumed, why))
    law = pid_controller(machine.reference, machine)
    own = closed_loop(plant := assemble(bent, AREA.at(0.0, span[2])), running_law(law, plant, None))
    assert np.linalg.eigvals(own.A).real.max() > 10.0
    ((checks,), _) = verify_ranges(bent, law, (), lambda stage: None)
    assert not checks.stable
    assert checks["range.abscissa"].value >= 0.99 * np.linalg.eigvals(own.A).real.max()


def test_the_speeds_are_followed_at_the_pressure_of_every_point(machine):
    """Whichever point comes first, a loop that is lost at another one's pressure fails."""
    rest, full = OperatingPoint(label="rest"), OperatingPoint(600.0, 0.5e5, label="full")
    law, found = pid_controller(machine.reference, machine), []
    for points in ((rest, full), (full, rest)):
        operation = replace(machine.operation, points=points, ranges=(), speed_range=(0.0, 600.0))
        verdict = verify_controller(replace(machine, operation=operation), law, tolerances=False)
        found.append({p.label: p["stability.speeds"].value for p in verdict.points if p.stable})
    assert found[0] == pytest.approx(found[1], rel=1e-6) and set(found[0]) == {"rest", "full"}


def test_a_law_that_follows_the_speed_is_followed_over_it_too(machine):
    """Nothing holds the rotor from 200 to 400 rad/s, where no operating point is."""
    law = pid_controller(machine.reference, machine)

    def at(speed):
        gain = 0.0 if 200.0 < speed < 400.0 else 1.0
        return replace(law, C=gain * law.C, D=gain * law.D)

    points = (OperatingPoint(label="rest"), OperatingPoint(600.0, label="fast"))
    operation = replace(machine.operation, points=points, ranges=(), speed_range=(0.0, 600.0))
    verdict = verify_controller(replace(machine, operation=operation), at, tolerances=False)
    assert all(point.stable for point in verdict.points) and not verdict.passed
    check = verdict.points[0]["stability.speeds"]
    assert check.value > 100.0 and "unstable from" in check.detail
