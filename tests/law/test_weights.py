"""Weights: values at zero, crossover and infinity in closed form, time responses of what they
allow, refusals.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace, is_stable, static_gain
from ambrose.law.design_problem import (
    Weights,
    control_weight,
    machine_weights,
    performance_weight,
    scale_control,
)
from ambrose.machine.file.toml import dumps_machine, loads_machine


def gain(system: StateSpace, omega: float) -> float:
    """|W(j omega)|; infinite omega gives |D|."""
    if np.isinf(omega):
        return float(np.abs(system.D[0, 0]))
    return float(np.abs(frequency_response(system, [omega]).values[0, 0, 0]))


@pytest.mark.parametrize(
    ("peak", "bandwidth", "error"), [(3.0, 1.5, 1e-3), (2.0, 84.0, 0.01), (1.1, 1e4, 1e-6)]
)
def test_performance_weight_at_its_three_points(peak, bandwidth, error):
    weight = performance_weight(peak, bandwidth, error)
    assert weight.n_states == 1
    assert gain(weight, 0.0) == pytest.approx(1 / error, rel=1e-12)
    assert gain(weight, np.inf) == pytest.approx(1 / peak, rel=1e-12)
    crossover = bandwidth * np.sqrt((1 - error**2) / (1 - peak**-2))  # |s/M + w_B| = |s + w_B A|
    assert gain(weight, crossover) == pytest.approx(1, rel=1e-12)
    s = 1j * 0.3 * bandwidth
    assert frequency_response(weight, [s.imag]).values[0, 0, 0] == pytest.approx(
        (s / peak + bandwidth) / (s + bandwidth * error), rel=1e-12
    )


def test_constant_control_weight():
    weight = control_weight(0.315)
    assert weight.n_states == 0
    assert weight.D[0, 0] == 0.315


@settings(max_examples=50, deadline=None)
@given(
    st.floats(1e-3, 0.95),
    st.floats(10.0, 1e5),
    st.integers(1, 4),
    st.one_of(st.none(), st.floats(1.05, 1e3)),
)
def test_high_pass_passes_one_at_its_crossover(level, crossover, order, limit):
    weight = control_weight(level, crossover, order, limit)
    assert weight.n_states == order
    assert is_stable(weight)
    assert gain(weight, 0.0) == pytest.approx(level, rel=1e-9)
    assert gain(weight, crossover) == pytest.approx(1.0, rel=1e-9)
    assert gain(weight, np.inf) == pytest.approx(30.0 if limit is None else limit, rel=1e-9)
    values = np.abs(frequency_response(weight, np.geomspace(1e-2, 1e8, 200)).values[:, 0, 0])
    assert (np.diff(values) >= -1e-9 * values[1:]).all()  # rises all the way


def test_high_pass_rises_with_its_order():
    """Far below the pole and far above the zero the slope is 20 dB per decade and order."""
    for order in (1, 2, 3):
        weight = control_weight(1e-3, 100.0, order, 1e9)
        zero = 100.0 * 1e-3 ** (1 / order)
        a, b = (gain(weight, f * zero) for f in (30.0, 60.0))
        assert np.log2(b / a) == pytest.approx(order, rel=2e-3)


def test_integral_time_of_the_weight():
    """Above A_w w_B the weight is a PI controller (1 + 1/(T_i s))/M: its phase is -45 degrees at
    1/T_i.
    """
    weight = performance_weight(3.0, 1 / (3.0 * 0.2), 1e-9)
    value = frequency_response(weight, [1 / 0.2]).values[0, 0, 0]
    assert np.angle(value) == pytest.approx(-np.pi / 4, abs=1e-6)


def test_weights_of_the_bundled_machines():
    rig = machine_weights(load_machine("seal-rig"))
    assert (rig.error_scale, rig.current_scale) == (20e-6, 1.0)
    assert gain(rig.performance, np.inf) == pytest.approx(1 / 3)
    assert gain(rig.performance, 0.0) == pytest.approx(1000)
    assert rig.control.n_states == 0 and rig.control.D[0, 0] == 0.315
    expander = machine_weights(load_machine("turboexpander"))
    assert expander.control.n_states == 1
    assert gain(expander.control, 2 * np.pi * 1400) == pytest.approx(1)


def test_bundled_bandwidths_follow_from_the_printed_times():
    """P5: integral time close to 0.2 s. P3: the step response of 1/W_p, M exp(-M w_B t), is at 2 %
    well within 20 ms.
    """
    rig, expander = load_machine("seal-rig").weights, load_machine("turboexpander").weights
    assert rig.bandwidth == pytest.approx(1 / (rig.peak * 0.2), rel=0.11)
    alone = np.log(expander.peak / 0.02) / (expander.peak * 0.02)
    assert 2 * alone < expander.bandwidth < 3 * alone


def test_weights_survive_the_machine_file():
    for name in ("seal-rig", "turboexpander"):
        machine = load_machine(name)
        assert loads_machine(dumps_machine(machine)).weights == machine.weights
    without = replace(load_machine("seal-rig"), weights=None)
    assert loads_machine(dumps_machine(without)) == without


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("peak = 0.9", "peak is 0.9, but must be above 1"),
        ("low_frequency_error = 2", "low_frequency_error is 2, but must be below 1"),
        ("control_limit = 5", "control_limit needs control_crossover"),
        ('bandwidth = "-1 rad/s"', "bandwidth is -1 rad/s, but must be positive"),
        ('error_scale = "1 A"', "error_scale"),
        ("colour = 1", 'unknown key "colour"'),
        ("control_order = 1.5", "a whole number"),
    ],
)
def test_bad_weights_in_a_machine_file(line, words):
    key = line.split(" ")[0]
    text = dumps_machine(load_machine("seal-rig"))
    head, table = text.split("[weights]\n")
    table = "\n".join(row for row in table.splitlines() if not row.startswith(f"{key} ="))
    with pytest.raises(InvalidInput, match="weights") as caught:
        loads_machine(f"{head}[weights]\n{line}\n{table}\n")
    assert words in str(caught.value)


def test_scaling_the_control_weight_keeps_its_shape():
    weights = machine_weights(load_machine("turboexpander"))
    for omega in (0.0, 3e3, 1e5, np.inf):
        assert gain(scale_control(weights, 2.5).control, omega) == pytest.approx(
            2.5 * gain(weights.control, omega)
        )
    assert scale_control(weights, 2.5).performance is weights.performance
    # the factor goes with them: lowering an order designs with the same weights again
    assert scale_control(scale_control(weights, 2.5), 0.5).control_factor == 1.25


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: performance_weight(1.0, 1.0), "peak is 1, but must be above 1"),
        (lambda: performance_weight(3.0, 0.0), "bandwidth is 0"),
        (lambda: performance_weight(3.0, 1.0, 0.0), "low_frequency_error is 0"),
        (
            lambda: performance_weight(3.0, 1.0, 1.0),
            "low_frequency_error is 1, but must be below 1",
        ),
        (lambda: performance_weight(np.nan, 1.0), "peak is nan, but must be finite"),
        (lambda: control_weight(0.0), "level is 0"),
        (lambda: control_weight(0.3, limit=4.0), "left out without a crossover"),
        (lambda: control_weight(1.5, 100.0), "below and above 1"),
        (lambda: control_weight(0.3, 100.0, limit=0.9), "below and above 1"),
        (lambda: control_weight(0.3, 100.0, order=0), "whole number from 1 to 8"),
        (
            lambda: machine_weights(replace(load_machine("seal-rig"), weights=None)),
            r"add a \[weights\] table",
        ),
        (
            lambda: Weights(static_gain(np.eye(2)), control_weight(0.3), 1e-5, 1.0),
            "one input and one output",
        ),
        (
            lambda: Weights(StateSpace(0.0, 1.0, 1.0, 1.0), control_weight(0.3), 1e-5, 1.0),
            "low_frequency_error > 0",
        ),
        (
            lambda: Weights(performance_weight(3, 1), control_weight(0.3), 0.0, 1.0),
            "error_scale is 0",
        ),
    ],
)
def test_refusals_name_quantity_and_remedy(make, words):
    with pytest.raises(InvalidInput, match=words):
        make()
