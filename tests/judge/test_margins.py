"""Margins against closed forms, against an eigenvalue method, and by crossing them: the loop must
turn unstable there.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import brentq

from ambrose.core.sampling import pade
from ambrose.core.statespace import (
    StateSpace,
    append,
    connect,
    is_stable,
    poles,
    rename,
    select,
    series,
    static_gain,
)
from ambrose.judge import nominal
from ambrose.judge.loop_response import frequency_grid, loop_evaluator
from ambrose.judge.margins import loop_margins, margin_checks, opened_loops
from ambrose.law.loop import closed_loop, match_controller
from ambrose.machine.description import Requirements
from ambrose.model.uncertainty import reduce
from eigenvalue_margins import loop_margins as eigenvalue_margins
from physical_numbers import physical

MASS = 2.0
K_I = 100.0
K_S = 2e5
GAIN = 5000.0
DERIVATIVE = 8.0
TAU = 2e-4


def measured(plant, controller):
    evaluator = loop_evaluator(plant, controller)
    grid = frequency_grid(poles(closed_loop(plant, controller)), 3.0, 1e5)
    response = evaluator(grid)
    return loop_margins(response, evaluator), response, evaluator


def scalar_loop(w):
    s = 1j * w
    return K_I * (GAIN + DERIVATIVE * s / (TAU * s + 1)) / (MASS * s**2 - K_S)


def test_single_mass_with_pd_in_closed_form(single_masses, pd_controller):
    """Down: the static loop k_i K_p / k_s; up: none, the PD's phase lead stays; phase and delay at
    |L| = 1.
    """
    found, _, _ = measured(single_masses(MASS, K_I, K_S), pd_controller(GAIN, DERIVATIVE, TAU))
    crossover = brentq(lambda w: abs(scalar_loop(w)) - 1, 10, 1e5, xtol=1e-10)
    phase = np.angle(-scalar_loop(crossover))
    for where in ("output", "input"):
        for m in found[where]:
            assert m.gain_down == pytest.approx(K_S / (K_I * GAIN), rel=1e-9)
            assert m.gain_down_at == 0.0
            assert m.gain_up == np.inf and np.isnan(m.gain_up_at)
            assert m.phase == pytest.approx(phase, rel=1e-8)
            assert m.phase_at == pytest.approx(crossover, rel=1e-9)
            assert m.delay == pytest.approx(phase / crossover, rel=1e-8)
            assert m.gain == pytest.approx(K_I * GAIN / K_S, rel=1e-9)


def opened(plant, controller, axis):
    """The scalar loop at one axis, cut at the measurement, with the other axes closed, as a state
    space.
    """
    controller = match_controller(controller, plant)
    part = select(plant.system, plant.named("u"), plant.named("y"))
    sums = {f"err_{a}": [f"-y_{a}"] for a in plant.axes}
    sums[f"err_{axis}"] = ["cut"]
    return connect([part, controller], ["cut"], [f"y_{axis}"], sums)


@pytest.mark.parametrize("label", ["nominal", "zero"])
def test_the_rig_against_the_eigenvalue_method(rig_plants, rig_controller, label):
    # the oracle solves eigenvalue problems of twice the order, many times
    plant = reduce(rig_plants[label], 1)
    found, _, _ = measured(plant, rig_controller)
    for axis, m in zip(plant.axes, found["output"], strict=True):
        oracle = eigenvalue_margins(opened(plant, rig_controller, axis))
        assert m.gain_up == pytest.approx(oracle.gain_margin, rel=1e-6)
        assert m.gain_down == pytest.approx(oracle.gain_reduction, rel=1e-6)
        assert m.phase == pytest.approx(oracle.phase_margin, rel=1e-6)


@pytest.mark.parametrize("where", ["output", "input"])
@pytest.mark.parametrize("k", [0, 3])
def test_crossing_a_margin_makes_the_rig_unstable(rig_plants, rig_controller, where, k):
    plant = rig_plants["nominal"]
    m = measured(plant, rig_controller)[0][where][k]

    def stable(element: StateSpace) -> bool:
        ones = append(
            *[
                rename(element if i == k else static_gain([[1.0]]), [f"a{i}"], [f"b{i}"])
                for i in range(4)
            ]
        )
        changed = (
            series(ones, rig_controller) if where == "output" else series(rig_controller, ones)
        )
        return is_stable(closed_loop(plant, changed))

    for factor in (m.gain_up, m.gain_down):
        outward = 1.002 if factor > 1 else 1 / 1.002
        assert stable(static_gain([[factor / outward]]))
        assert not stable(static_gain([[factor * outward]]))
    assert stable(pade(0.998 * m.delay, 6))
    assert not stable(pade(1.002 * m.delay, 6))


def test_phase_margin_by_an_all_pass(single_masses, pd_controller):
    """(a - s)/(a + s) takes the phase margin exactly at the crossover when a is chosen so: poles on
    the imaginary axis.
    """
    plant, controller = single_masses(MASS, K_I, K_S), pd_controller(GAIN, DERIVATIVE, TAU)
    m = measured(plant, controller)[0]["output"][1]
    a = m.phase_at / np.tan(m.phase / 2)
    lag = StateSpace([[-a]], [[1.0]], [[2 * a]], [[-1.0]])
    lags = append(*[rename(lag, [f"a{i}"], [f"b{i}"]) for i in range(4)])
    rightmost = poles(closed_loop(plant, series(lags, controller)))
    assert np.abs(rightmost.real).min() < 1e-6 * m.phase_at


@pytest.fixture(scope="module")
def disk(rig_plants, rig_controller):
    plant = rig_plants["zero"]
    _, response, evaluator = measured(plant, rig_controller)
    checks, curves = margin_checks(
        response, evaluator, Requirements(gain_margin=2.2, phase_margin=0.5)
    )
    return plant, {check.name: check for check in checks}, curves, response


@settings(max_examples=25, deadline=None)
@given(factors=st.lists(physical(-1, 1), min_size=4, max_size=4))
def test_gains_inside_the_disk_margin_keep_the_loop_stable(disk, rig_controller, factors):
    plant, checks, _, _ = disk
    limit = checks["margin.disk.input"].value
    scaled = series(rig_controller, static_gain(np.diag(limit ** (0.999 * np.array(factors)))))
    assert is_stable(closed_loop(plant, scaled))


def test_the_disk_margin_of_one_loop_is_its_closed_form(single_masses, pd_controller):
    plant, controller = single_masses(MASS, K_I, K_S), pd_controller(GAIN, DERIVATIVE, TAU)
    _, response, evaluator = measured(plant, controller)
    w = np.geomspace(3.0, 1e5, 400_000)
    alpha = 1 / np.abs(1 / (1 + scalar_loop(w)) - 0.5).max()
    check = {c.name: c for c in margin_checks(response, evaluator, Requirements())[0]}[
        "margin.disk.output"
    ]
    assert check.value == pytest.approx((1 + alpha / 2) / (1 - alpha / 2), rel=1e-6)


def test_information_says_whether_large_is_good(rig_plants, rig_controller):
    plant = rig_plants["zero"]
    names = {
        check.name
        for check in nominal.check(plant, rig_controller).checks
        if check.relation == ">="
    }
    delays = {
        f"margin.delay.{where}.{axis}" for where in ("output", "input") for axis in plant.axes
    }
    assert (
        delays | {"margin.disk.output", "poles.damping.least", "poles.log_decrement.least"} <= names
    )
    assert not {
        name
        for name in names
        if name.startswith(("sensitivity", "unbalance", "stability", "impulse"))
    }


def test_checks_are_judged_and_name_their_frequency(disk):
    _, checks, curves, response = disk
    assert checks["margin.gain.output.A_zeta"].passed is True
    assert checks["margin.gain.output.B_zeta"].passed is False  # 2.06 < 2.2
    assert checks["margin.gain.output.B_zeta"].limit == 2.2
    assert "149" in checks["margin.gain.output.B_zeta"].detail
    assert checks["margin.phase.input.A_eta"].passed is True
    assert checks["margin.delay.input.A_eta"].limit is None
    assert [curve.name for curve in curves] == ["margin.loop.output", "margin.loop.input"]
    np.testing.assert_allclose(curves[0].y, np.abs(opened_loops(response, "output")).T)
