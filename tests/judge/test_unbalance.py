"""Unbalance: the grade's force, orbits of rotating forces in closed form, limits, re-assembly at
every speed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace
from ambrose.judge.loop_response import frequency_grid, loop_evaluator
from ambrose.judge.unbalance import (
    assembled_check,
    distributed_orbits,
    orbit,
    top_speed,
    unbalance_checks,
    unbalance_curve,
    worst_orbit,
)
from ambrose.machine.description import OperatingPoint, Operation, Requirements
from ambrose.model.assemble import assemble
from ambrose.model.static_load import residual_unbalance, unbalance

BALANCED_AT = 2 * np.pi * 500
MASS = 2.0
K_I = 100.0
K_S = 2e5
GAIN = 5000.0
DERIVATIVE = 8.0
TAU = 2e-4


@pytest.mark.literature
def test_g2_5_at_500_hz_pulls_with_541_newton(rig):
    """Lauridsen, paper P5: 541 N for the test rig; its mass of 69 kg is rounded (541 N needs 68.9
    kg).
    """
    assert unbalance(69.0, 2.5e-3, BALANCED_AT).force(BALANCED_AT) == pytest.approx(541.0, rel=2e-3)
    residual = residual_unbalance(rig)
    assert residual.force(BALANCED_AT) == pytest.approx(541.0, rel=2e-3)
    assert residual.force(BALANCED_AT / 5) == pytest.approx(541.0 / 25, rel=2e-3)


def test_residual_unbalance_of_the_standard():
    """ISO 21940-11: permissible eccentricity grade / speed; G6.3 at 3000 rpm leaves 20 g mm per
    kg.
    """
    residual = unbalance(10.0, 6.3e-3, 2 * np.pi * 50)
    assert residual.moment / 10.0 == pytest.approx(20.05e-6, rel=1e-3)


def test_shares_follow_the_lever_rule(rig):
    residual = residual_unbalance(rig)
    assert sum(residual.share) == pytest.approx(1.0)
    assert residual.share == pytest.approx((0.5, 0.5), abs=1e-9)  # this rotor is symmetric
    a, b = rig.bearings
    moved = residual_unbalance(replace(rig, bearings=(replace(a, position=0.33), b)))
    assert moved.share[0] == pytest.approx((0.698 - 0.43) / (0.698 - 0.33))


def test_defaults_and_refusals(rig):
    silent = replace(rig, requirements=Requirements())
    assert residual_unbalance(silent) is None
    fast = replace(silent, operation=Operation((OperatingPoint(),), (0.0, 1000.0)))
    assert (top_speed(fast), residual_unbalance(fast).speed, residual_unbalance(fast).grade) == (
        1000.0,
        1000.0,
        2.5e-3,
    )
    with pytest.raises(InvalidInput, match="balance_grade"):
        residual_unbalance(rig, replace(rig.requirements, balance_grade=-1.0))


def test_orbit_is_the_semi_major_axis():
    t = np.linspace(0, 2 * np.pi, 20001)
    for x, y in ((1.0 + 0.3j, 0.2 - 0.7j), (1.0, -1j), (3.0, 1.0 + 1e-3j)):
        path = np.hypot((x * np.exp(1j * t)).real, (y * np.exp(1j * t)).real)
        assert orbit(np.array(x), np.array(y)) == pytest.approx(path.max(), rel=1e-6)


def response_of_masses(single_masses, pd_controller, **changes):
    plant = single_masses(MASS, K_I, K_S, **changes)
    evaluator = loop_evaluator(plant, pd_controller(GAIN, DERIVATIVE, TAU))
    return plant, evaluator, evaluator(np.geomspace(10, 1200, 300))


def exact_compliance(w):
    s = 1j * w
    return np.abs(1 / (MASS * s**2 - K_S + K_I * (GAIN + DERIVATIVE * s / (TAU * s + 1))))


def test_uncoupled_axes_in_closed_form(single_masses, pd_controller):
    plant, _, response = response_of_masses(single_masses, pd_controller)
    residual = unbalance(10.0, 2.5e-3, 1000.0, (0.4, 0.6))
    expected = exact_compliance(response.omega) * 10.0 * 2.5e-3 / 1000.0 * response.omega**2
    np.testing.assert_allclose(worst_orbit(response, residual), expected, rtol=1e-9)
    for flag in (False, True):  # no coupling: both distributions give each bearing its own share
        found = distributed_orbits(response, residual, plant.machine, antiphase=flag)
        np.testing.assert_allclose(found, np.outer([0.4, 0.6], expected), rtol=1e-9)


def test_checks_peak_limit_and_range(single_masses, pd_controller):
    wanted = Requirements(unbalance_orbit=1e-6, unbalance_to=300.0)
    plant, evaluator, response = response_of_masses(
        single_masses, pd_controller, requirements=wanted
    )
    residual = unbalance(10.0, 2.5e-3, 1000.0)
    checks = {c.name: c for c in unbalance_checks(plant, response, evaluator, wanted, residual)[0]}
    w = np.linspace(10, 300, 200_001)
    exact = (exact_compliance(w) * residual.force(w)).max()
    orbit_check = checks["unbalance.orbit_0p"]
    assert orbit_check.value == pytest.approx(exact, rel=1e-8)
    assert (orbit_check.limit, orbit_check.passed) == (1e-6, bool(exact <= 1e-6))
    clearance = checks["unbalance.clearance"]
    assert clearance.value == pytest.approx(exact / 2.5e-4, rel=1e-8)
    assert (clearance.limit, clearance.zone) == (0.3, "A")
    K = GAIN + DERIVATIVE * 1j * w / (TAU * 1j * w + 1)
    current = (np.abs(K) * exact_compliance(w) * residual.force(w)).max()
    assert checks["unbalance.current_0p"].value == pytest.approx(current, rel=1e-8)
    assert checks["unbalance.current_0p"].limit == 4.0
    assert checks["unbalance.current_0p"].source == "bearing A, max_current"
    force = (np.abs(K_S - K_I * K) * exact_compliance(w) * residual.force(w)).max()
    assert checks["unbalance.force_0p"].value == pytest.approx(force, rel=1e-8)


def test_the_axis_nearest_to_its_limit_is_reported(single_masses, pd_controller):
    plant, evaluator, response = response_of_masses(single_masses, pd_controller)
    a, b = plant.machine.bearings
    weak = replace(
        plant, machine=replace(plant.machine, bearings=(a, replace(b, max_current=1e-9)))
    )
    residual = unbalance(10.0, 2.5e-3, 1000.0)
    check = {
        c.name: c for c in unbalance_checks(weak, response, evaluator, Requirements(), residual)[0]
    }["unbalance.current_0p"]
    assert (
        check.passed is False and check.source == "bearing B, max_current" and "B_" in check.detail
    )
    own = Requirements(max_current=100.0)
    check = {c.name: c for c in unbalance_checks(weak, response, evaluator, own, residual)[0]}[
        "unbalance.current_0p"
    ]
    assert check.passed is True and check.limit == 100.0


def test_bearing_angles_enter_the_phase(single_masses, pd_controller):
    """Two coupled bearings, B turned against A: in phase means in phase in space, so turning
    changes nothing.
    """
    plant, _, response = response_of_masses(single_masses, pd_controller)
    residual = unbalance(10.0, 2.5e-3, 1000.0)
    T = np.eye(4)
    c, s = np.cos(0.9), np.sin(0.9)
    T[2:, 2:] = [[c, s], [-s, c]]  # B's own axes, 0.9 rad further
    X = np.random.default_rng(3).normal(size=(2, 2))
    mixed = np.kron(X + X.T, np.eye(2)) * 1e-6  # isotropic, couples the planes
    a, b = plant.machine.bearings
    turned = replace(plant.machine, bearings=(a, replace(b, angle=b.angle + 0.9)))
    zero = np.zeros_like(response.G)

    def orbits(compliance, machine):
        r = replace(
            response,
            G=zero,
            K=zero,
            G_yf=zero,
            G_qu=zero,
            G_qf=np.broadcast_to(compliance, zero.shape),
        )
        return distributed_orbits(r, residual, machine, antiphase=False)

    np.testing.assert_allclose(
        orbits(T @ mixed @ T.T, turned), orbits(mixed, plant.machine), rtol=1e-12
    )


def test_reassembly_at_every_speed_agrees_where_nothing_depends_on_speed(
    rig_plants, rig_controller, rig
):
    plant = rig_plants["zero"]
    speeds = 2 * np.pi * np.array([20.0, 110.0, 200.0])
    curve = unbalance_curve(lambda speed: plant, speeds, rig_controller)
    residual = residual_unbalance(rig)
    response = loop_evaluator(plant, rig_controller)(speeds)
    given = np.isin(curve.x, speeds)
    np.testing.assert_allclose(curve.y[0, given], worst_orbit(response, residual), rtol=1e-5)
    np.testing.assert_allclose(
        curve.y[1:3, given], distributed_orbits(response, residual, rig, antiphase=False), rtol=1e-5
    )
    # between the three given speeds the peak is found
    dense = np.linspace(speeds[0], speeds[-1], 4001)
    assert curve.y[0].max() == pytest.approx(
        worst_orbit(loop_evaluator(plant, rig_controller)(dense), residual).max(), rel=1e-6
    )
    assert len(curve.x) == 4
    assert (
        curve.labels[0] == "worst case"
        and curve.kind == "speed"
        and curve.limits == (("required", 8e-6),)
    )
    check = assembled_check(curve, replace(rig.requirements, unbalance_to=speeds[1]))
    assert check.value == curve.y[0, curve.x <= speeds[1]].max() and check.passed is True


def test_gyroscopic_forces_are_seen_only_by_reassembly(rig, rig_controller):
    point = rig.operation.points[1]
    plants = {}

    def plant_at(speed):
        plants[speed] = assemble(rig, replace(point, speed=speed))
        return plants[speed]

    speed = 2 * np.pi * 200.0
    curve = unbalance_curve(plant_at, np.array([speed]), rig_controller)
    assert set(plants) == {speed}
    still = unbalance_curve(lambda _: assemble(rig, point), np.array([speed]), rig_controller)
    assert curve.y[0, 0] != pytest.approx(still.y[0, 0], rel=1e-6)
    with pytest.raises(InvalidInput, match="speeds"):
        unbalance_curve(plant_at, np.array([0.0, 1.0]), rig_controller)
    with pytest.raises(InvalidInput, match="balancing speed"):
        silent = replace(rig, requirements=Requirements())
        unbalance_curve(lambda s: assemble(silent, point), np.array([speed]), rig_controller)


def test_peaks_do_not_depend_on_the_grid(rig_plants, rig_controller, rig):
    plant = rig_plants["nominal"]
    evaluator = loop_evaluator(plant, rig_controller)
    residual = residual_unbalance(rig)
    values = []
    for per_decade in (30, 217):
        response = evaluator(frequency_grid(np.zeros(0, complex), 3.0, 6e4, per_decade))
        checks = unbalance_checks(plant, response, evaluator, rig.requirements, residual)[0]
        values.append([c.value for c in checks])
    np.testing.assert_allclose(values[0], values[1], rtol=1e-5)


def test_shares_for_other_than_two_bearings_are_equal(rig):
    one = replace(rig, bearings=rig.bearings[:1], sensors=rig.sensors[:1])
    assert residual_unbalance(one).share == (1.0,)
    assert isinstance(assemble(one).system, StateSpace)


def test_every_maximum_of_the_reassembled_rotor_keeps_its_refined_point(
    rig_plants, rig_controller, monkeypatch
):
    """Two maxima between the speeds given, the first the larger: its point was dropped."""
    bump = lambda w: 1 / (1 + (w / 60.0) ** 2)  # noqa: E731
    orbit = lambda w: 3 * bump(w - 210.0) + 2 * bump(w - 612.0)  # noqa: E731
    at = "ambrose.judge.unbalance."
    monkeypatch.setattr(at + "loop_at", lambda plant, controller, speed: speed)
    monkeypatch.setattr(at + "worst_orbit", lambda speed, residual: np.array([orbit(speed)]))
    monkeypatch.setattr(at + "distributed_orbits", lambda *_, antiphase: np.zeros((2, 1)))
    speeds = np.arange(100.0, 901.0, 100.0)
    curve = unbalance_curve(lambda _: rig_plants["zero"], speeds, rig_controller)
    assert len(curve.x) == len(speeds) + 2
    for low, high in ((100.0, 400.0), (400.0, 800.0)):
        inside = (curve.x > low) & (curve.x < high)
        most = orbit(np.linspace(low, high, 100_001)).max()
        assert curve.y[0, inside].max() == pytest.approx(most, rel=1e-6)
