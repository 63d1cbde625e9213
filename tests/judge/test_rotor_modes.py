"""Damping, log decrement and whirl direction against closed forms; the stability verdict names what
is unstable.
"""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace
from ambrose.judge.campbell import (
    Modes,
    damping_ratio,
    direction,
    log_decrement,
    modes,
    pairs,
    pole_checks,
    pole_curve,
    whirl_measure,
)
from ambrose.law.loop import closed_loop
from ambrose.machine.description import Requirements


def test_log_decrement_is_the_log_of_successive_maxima():
    pole = np.array([-7.0 + 90j])
    period = 2 * np.pi / 90
    assert log_decrement(pole)[0] == pytest.approx(np.log(np.exp(7.0 * period)))
    zeta = damping_ratio(pole)[0]
    assert log_decrement(pole)[0] == pytest.approx(2 * np.pi * zeta / np.sqrt(1 - zeta**2))
    np.testing.assert_array_equal(
        log_decrement(np.array([-3.0 + 0j, 3.0 + 0j, 0j])), [np.inf, -np.inf, 0.0]
    )
    assert damping_ratio(np.array([0j]))[0] == 0.0


def test_whirl_measure_of_circles_and_lines():
    ports = ("A_zeta", "A_eta", "seal_x", "seal_y")
    forward = np.array([1, -1j, 2, -2j])  # x = cos wt, y = sin wt
    shapes = np.stack([forward, forward.conj(), np.array([1, 2, 1, 0])], axis=1)
    np.testing.assert_allclose(whirl_measure(shapes, ports), [1, -1, 0], atol=1e-15)
    assert [direction(x) for x in (1.0, -1.0, 0.05)] == ["forward", "backward", "planar"]
    assert pairs(ports) == ([0, 2], [1, 3])


def rotating_oscillator(stiffness, damping, cross):
    """x'' + d x' + w2 x + k y = 0, y'' + d y' + w2 y - k x = 0: k > 0 drives the forward whirl."""
    K = np.array([[stiffness, cross], [-cross, stiffness]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-K, -damping * np.eye(2)]])
    return StateSpace(
        A, np.zeros((4, 1)), np.eye(2, 4), np.zeros((2, 1)), outputs=["q_A_zeta", "q_A_eta"]
    )


def test_cross_coupling_splits_forward_and_backward_as_in_closed_form():
    """z = x + j y: s^2 + d s + w2 - j k = 0 for z ~ exp(s t); forward has the larger real part for
    k > 0.
    """
    found = modes(rotating_oscillator(1e4, 2.0, 300.0), ("A_zeta", "A_eta"))
    root = np.roots([1.0, 2.0, 1e4 - 300j])
    forward = root[np.argmax(root.imag)]
    backward = root[np.argmin(root.imag)].conj()
    for k, word in enumerate(direction(x) for x in found.whirl):
        assert word in {"forward", "backward"}
        assert found.poles[k] == pytest.approx(
            forward if word == "forward" else backward, rel=1e-10
        )
    assert forward.real > 0 > backward.real
    checks = pole_checks(found, Requirements(), 0.0)
    stability = checks[0]
    assert stability.name == "stability.abscissa" and stability.passed is False
    assert stability.value == pytest.approx(forward.real)
    assert f"{forward.imag / (2 * np.pi):.4g} Hz forward" in stability.detail
    assert "backward" not in stability.detail


def test_sampled_poles_map_back(single_masses, pd_controller):
    closed = closed_loop(single_masses(), pd_controller(5000.0, 8.0, 2e-4))
    ports = ("A_zeta", "A_eta", "B_zeta", "B_eta")
    plain, sampled = modes(closed, ports), modes(c2d(closed, 1e-3), ports)
    np.testing.assert_allclose(sampled.poles, plain.poles, rtol=1e-7)


def made(*poles, whirl=None):
    p = np.array(poles)
    return Modes(
        p, np.zeros(len(p)) if whirl is None else np.array(whirl, float), np.zeros((0, len(p))), ()
    )


def by_name(found, requirements=None, speed=0.0):
    return {
        check.name: check for check in pole_checks(found, requirements or Requirements(), speed)
    }


def test_the_standard_judges_the_first_forward_mode_and_all_up_to_the_top_speed():
    found = made(-50 + 100j, -30 + 200j, -1 + 900j, -2 + 3000j, whirl=[-1, 1, 1, 0])
    checks = by_name(found)
    lowest = checks["poles.log_decrement.lowest"]
    assert lowest.value == pytest.approx(2 * np.pi * 30 / 200) and lowest.passed is True
    assert lowest.source.startswith("API 617")
    assert "modes up to 31.83 Hz" in lowest.detail
    fast = by_name(found, speed=1000.0)["poles.log_decrement.lowest"]
    assert fast.value == pytest.approx(2 * np.pi / 900) and fast.passed is False
    own = by_name(found, Requirements(log_decrement=1.0))["poles.log_decrement.lowest"]
    assert (own.limit, own.passed) == (1.0, False)
    assert own.title == fast.title == lowest.title  # so that operating points share a row


def test_a_bending_mode_beyond_the_standards_range_is_not_its_first_forward_mode():
    """Overdamped rigid modes: the first mode that rings lies at 24 times the running speed."""
    overdamped, far = -400 + 300j, -100 + 23e3j
    found = made(overdamped, far)
    lowest = by_name(found, speed=960.0)["poles.log_decrement.lowest"]
    assert lowest.passed is True and lowest.value == pytest.approx(2 * np.pi * 400 / 300)
    assert "modes up to 2000 Hz, no forward one rings" in lowest.detail
    # three times the speed reaches it; a backward one within the range is judged, as is a near one
    assert by_name(found, speed=8e3)["poles.log_decrement.lowest"].passed is False
    backward = made(overdamped, -1 + 3e3j, far, whirl=[0, -1, 1])
    assert by_name(backward)["poles.log_decrement.lowest"].value == pytest.approx(2 * np.pi / 3e3)
    near = made(overdamped, -1 + 9e3j)
    assert by_name(near)["poles.log_decrement.lowest"].passed is False


def test_nothing_is_left_out_of_the_least_damped():
    found = made(-50 + 100j, -30 + 200j, -1 + 900j, -2 + 3000j, -0.1 + 1e6j)
    checks = by_name(found)
    assert checks["poles.damping.least"].value == pytest.approx(1e-7)
    assert checks["poles.damping.least"].limit is None
    detail = checks["poles.damping.least"].detail
    assert (
        checks["poles.log_decrement.least"].detail == "at 159.2 kHz planar" == detail.split(";")[0]
    )
    assert [f"{w / (2 * np.pi):.4g} Hz" in detail for w in (900, 3000, 200, 100)] == [True] * 4


def test_a_loop_without_oscillation_has_only_the_stability_check():
    assert list(by_name(made(-1.0 + 0j, -300.0 + 0j))) == ["stability.abscissa"]
    marginal = by_name(made(0j, -300.0 + 0j))["stability.abscissa"]
    assert marginal.passed is False and "real pole" in marginal.detail


def test_pole_curve_has_both_halves():
    curve = pole_curve(made(-1.0 + 0j, -2 + 5j))
    assert curve.kind == "poles"
    assert sorted(zip(curve.x, curve.y[0], strict=True)) == [(-2.0, -5.0), (-2.0, 5.0), (-1.0, 0.0)]


@pytest.mark.parametrize(("asked", "passed"), [(None, None), (0.01, True), (0.05, False)])
def test_damping_above_the_top_speed_is_a_requirement(asked, passed):
    """Closed form: poles of w (-zeta + j sqrt(1 - zeta^2)); below the top speed none counts."""
    zeta, size = np.array([0.001, 0.2, 0.03]), np.array([50.0, 300.0, 900.0])
    poles = size * (-zeta + 1j * np.sqrt(1 - zeta**2))
    found = Modes(poles, np.zeros(3), np.zeros((1, 3)), ("a",))
    wanted = Requirements(damping_above=asked)
    named = {check.name: check for check in pole_checks(found, wanted, 100.0)}
    assert ("poles.damping.above" in named) == (asked is not None)
    if asked is not None:
        check = named["poles.damping.above"]
        assert check.value == pytest.approx(0.03)
        assert (check.limit, check.relation, check.passed) == (asked, ">=", passed)
