"""What a model lacks: a step found by one more unknown is the one that a whole fit finds, and
effects decide, not traces.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose.core.response import simulate
from ambrose.identification.findings import ERROR, WARNING, Code, Finding
from ambrose.identification.loop import identify_loop
from ambrose.identification.output_error.closed_loop import ParameterEstimate, identify
from ambrose.identification.output_error.loop_model import loop_model, timed
from ambrose.identification.output_error.problem import FitOptions
from ambrose.identification.parameters import nominal_values
from ambrose.identification.validation import suspects as tried
from ambrose.identification.validation.suspects import Suspect, explained, judged, suspects
from ambrose.record.record import Record
from linear_rig import DT, E, Y, rig

SAMPLES = 3000

pytestmark = pytest.mark.usefixtures("rigid")


@pytest.fixture
def rigid(monkeypatch):
    """The recorded rotor is rigid, which no rotor is: bending modes beyond the model are not looked
    for.
    """
    monkeypatch.setattr(tried, "FURTHER_MODES", 0)


KNOWN = ("bearing.A.negative_stiffness.zeta", "bearing.A.force_per_current.zeta", "seal.center.k")


@cache
def record(delay, noise=2e-8):
    """The linear loop with a command ``delay`` samples late."""
    _, plant, _, law = rig()
    loop, _ = timed(loop_model(plant, law, (), np.zeros(0), E, Y), delay, ()).loop(np.zeros(0))
    e = np.stack([0.1 * waveforms.prbs(9, 10, SAMPLES, shift=127 * i) for i in range(4)])
    y = simulate(loop, e)[:4] + noise * np.random.default_rng(0).standard_normal((4, SAMPLES))
    return Record(
        "seal-rig", 1 / DT, (*Y, *E), ("m",) * 4 + ("A",) * 4, np.vstack([y, e]), plant.point
    )


@pytest.mark.parametrize("off", [0.02, -0.04])
def test_one_step_finds_what_a_whole_fit_finds(off):
    machine, plant, controller, _ = rig()
    data, how = record(1.0 + off), FitOptions(bending_modes=0, computing_delay=1)
    given = identify(machine, data, controller, KNOWN, bending_modes=0)
    whole = identify(machine, data, controller, (*KNOWN, "delay"), bending_modes=0)
    first = suspects(machine, [data], controller, given, how)[0]
    assert first.path == "controller.delay" and first.score > 8
    assert first.step == pytest.approx(off * DT, rel=0.05)
    np.testing.assert_allclose(
        first.shift, whole.values[:-1] - given.values, rtol=0.1, atol=1e-4 * abs(given.values).max()
    )
    np.testing.assert_allclose(given.values + first.shift, nominal_values(plant, KNOWN), rtol=2e-3)


def test_nothing_is_suspected_of_a_model_that_is_right():
    machine, _, controller, _ = rig()
    given = identify(machine, record(1.0), controller, KNOWN, bending_modes=0)
    assert given.adequate
    found = suspects(machine, [record(1.0)], controller, given, FitOptions(bending_modes=0))
    assert all(item.held for item in found)


@pytest.mark.parametrize(("off", "harmless"), [(0.02, True), (0.6, False)])
def test_a_trace_without_effect_is_no_doubt_and_one_with_effect_is(off, harmless):
    """Two per cent of a sample passed all residual tests, and its intervals missed the true
    values.
    """
    machine, plant, controller, _ = rig()
    done = identify_loop(
        machine, [record(1.0 + off)], controller, KNOWN, options=FitOptions(bending_modes=0)
    )
    result = done.result
    assert all(test.passed for test in result.tests) is harmless  # blind to a fiftieth of a sample
    assert result.adequate is harmless and done.passed is harmless
    assert "controller.delay" in result.verdict and "its effect, up to" in result.verdict
    if harmless:
        true = nominal_values(plant, KNOWN)
        assert (np.abs(result.values - true) < 1.96 * result.standard_deviations).all()
        bare = identify(machine, record(1.0 + off), controller, KNOWN, bending_modes=0)
        assert not (np.abs(bare.values - true) < 1.96 * bare.standard_deviations).all()


def test_what_cannot_be_tried_is_left_out():
    machine, _, controller, _ = rig()
    given = identify(machine, record(1.05), controller, KNOWN, bending_modes=0)
    without = replace(record(1.05), values=record(1.05).values.copy())
    found = suspects(
        machine, [without], controller, given, FitOptions(bending_modes=0, initial_state=False)
    )
    assert {item.path for item in found}.isdisjoint({"excitation.delay"})  # needs an initial state


def test_a_value_near_zero_is_not_judged_by_its_own_size():
    """An excitation that is not late has a delay of zero: any move is many times of it, and a
    fraction of a sample.
    """
    result = ParameterEstimate(
        "m",
        None,
        ("excitation.delay", "seal.center.k"),
        np.array([1e-12, 1.0]),
        np.zeros(2),
        np.diag([1e-14, 1e4]),
        np.eye(2),
        np.eye(2),
        (),
        (),
        1.0,
        True,
        1,
        (),
        "",
    )
    found = (Suspect("seal.center.C", 1.0, 9.0, 0.1, np.array([1e-6, 50.0])),)
    assert judged(result, found, DT).adequate
    late = (Suspect("seal.center.C", 1.0, 9.0, 0.1, np.array([1e-5, 50.0])),)
    assert not judged(result, late, DT).adequate


def test_causes_are_told_the_likeliest_first():
    found = tuple(
        Suspect(path, 1e-5, 9.0, part, np.zeros(1))
        for path, part in (("controller.delay", 0.4), ("seal.center.C", 0.1))
    )
    refused = explained(
        Finding(Code.MISSING_RESPONSE, ERROR, "no values", "38 %", "another machine"), found
    )
    assert "(40 %), seal.center.C" in refused.remedy and refused.remedy.endswith(
        "; else another machine"
    )
    other = Finding(Code.BURST, WARNING, "y leaves the model")
    assert explained(other, found) is other and explained(refused, ()) is refused


def test_where_no_suspect_explains_it_the_verdict_says_what_was_tried():
    machine, _, controller, _ = rig()
    given = identify(machine, record(1.6), controller, KNOWN, bending_modes=0)
    verdict = judged(given, (), DT).verdict
    assert (
        "no one of delays, gains" in verdict and judged(given, (), DT).warnings[-1].what == verdict
    )
