"""Statements P3.7 and P3.8 of paper P3: LPV against the mu controller of 140 Hz through the
turboexpander's spin-up.

A short version: LPV on 5 grid points instead of 8. The figures of docs/research/reproduction.md come from 8.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.annexes.scheduled.lpv.machine import design_schedule
from ambrose.judge.loop_response import loop_evaluator
from ambrose.judge.result import certify
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import load_scenario
from ambrose.rig.trial import spin_up, steps
from ambrose.synthesis.design import design

pytestmark = [pytest.mark.literature, pytest.mark.study]
HZ = 2 * np.pi


@pytest.fixture(scope="module")
def study():
    machine = load_machine("turboexpander")
    plant = assemble(machine, operating_point(machine, "140 Hz"))
    return plant, design_schedule(plant, HZ * np.linspace(20, 300, 5)), design(plant, "mu")


def run_up(study, scenario):
    plant, lpv, mu = study
    signals = [f"y_{axis}" for axis in plant.axes]
    laws = {"lpv": lpv.scheduled, "mu": mu.controller}
    return {
        name: steps(spin_up(plant, law, scenario), scenario, signals) for name, law in laws.items()
    }


@pytest.fixture(scope="module")
def windows(study):
    return run_up(study, load_scenario("spin-up-steps"))


def test_gamma_close_to_the_largest_pointwise_value_and_guaranteed_between(study):
    _, lpv, _ = study
    margins = lpv.certificate.margins
    # 8 points: 4.9 % above
    assert margins["gamma_optimal"] == pytest.approx(1.049 * margins["pointwise_largest"], rel=0.02)
    assert lpv.status == "verified"
    assert margins["guaranteed_between"] <= 1.02 * margins["gamma_designed"]
    assert lpv.controller.n_states == 20


def test_lpv_settles_within_20_ms_at_both_ends(windows):
    """P3.7, first half."""
    assert windows["lpv"][0].settling < 0.02
    assert windows["lpv"][-1].settling < 0.02
    assert max(step.settling for step in windows["lpv"]) < 0.02


def test_mu_is_slower_at_both_ends_and_rings_at_the_low_one(windows):
    """P3.7, second half: slower at both ends, more oscillatory at the low one only."""
    assert windows["mu"][0].settling > 2 * windows["lpv"][0].settling
    assert windows["mu"][-1].settling > windows["lpv"][-1].settling
    assert windows["mu"][0].crossings >= windows["lpv"][0].crossings + 3
    assert windows["mu"][-1].crossings == windows["lpv"][-1].crossings


def test_each_step_alone_says_the_same(study):
    """P3.7 read otherwise: in the bundled scenario the force drops as the output step rises, here
    no two steps fall together.

    LPV settles within 20 ms in every window; mu does not settle to 2 um of output at 34 Hz within
    its 50 ms, and is slower at the other end for both kinds of step, without ringing there.
    """
    bundled = load_scenario("spin-up-steps")
    pulses = tuple(replace(p, duration=2 * p.duration, every=2 * p.every) for p in bundled.pulses)
    found = run_up(study, replace(bundled, pulses=pulses))
    assert max(step.settling for step in found["lpv"]) < 0.02
    assert found["mu"][0].settling > 0.04 and found["mu"][1].settling > 0.04
    for k in (18, 19):  # a force step and an output step near 280 Hz
        assert found["mu"][k].settling > 1.05 * found["lpv"][k].settling
        assert found["mu"][k].crossings <= 1
    assert found["mu"][1].peak < 2.5e-6  # the output step alone: no 100 N in its window


def test_nonlinear_rig_agrees_with_the_linear_sweep(study, windows):
    plant, lpv, _ = study
    scenario = load_scenario("spin-up-steps")
    trace = virtual_rig.run(plant.machine, lpv.scheduled, scenario, point=plant.point)
    found = steps(trace, scenario, [f"y_{axis}" for axis in plant.axes])
    assert trace.outcome == "completed"
    for rig, linear in zip(found, windows["lpv"], strict=True):
        assert rig.settling == pytest.approx(linear.settling, abs=2e-3)
        # one sample of delay and the sampled controller add 10 %
        assert rig.peak == pytest.approx(linear.peak, rel=0.2)


def test_mu_keeps_the_iso_limit_per_axis_and_not_as_a_singular_value(study):
    """P3.8, first half: per axis, as ISO 14839-3 measures, zone A (below 3, 9.5 dB) at every speed;
    sigma_max(S_o), in which P3.2 is judged, is above 3 at 20 and 25 Hz.
    """
    plant, _, mu = study
    largest = {
        hz: float(np.linalg.norm(_sensitivity(plant, mu.controller, hz)[1], 2, axis=(1, 2)).max())
        for hz in (20, 25, 30)
    }
    assert largest == {
        20: pytest.approx(4.12, abs=0.05),
        25: pytest.approx(3.49, abs=0.05),
        30: pytest.approx(2.94, abs=0.05),
    }
    axis = {hz: _axis_peak(plant, mu.controller, hz) for hz in (20, 80, 140, 300)}
    assert max(axis.values()) == axis[300] == pytest.approx(1.96, abs=0.03)


def test_peak_and_crossover_of_mu_against_lpv(study):
    """P3.8, second half: higher peak (largest singular value) below 35 Hz, lower crossover at both
    ends of the range.
    """
    plant, lpv, mu = study
    norms = {
        hz: [
            certify(_at(plant, hz), K).closed_loop_norm
            for K in (lpv.scheduled.at(HZ * hz), mu.controller)
        ]
        for hz in (20, 140)
    }
    assert norms[20][1] > 1.3 * norms[20][0]
    assert norms[140][1] < norms[140][0]  # not so near the mu controller's own speed
    for hz in (20, 300):
        assert _crossover(plant, mu.controller, hz) < _crossover(
            plant, lpv.scheduled.at(HZ * hz), hz
        )


def _at(plant, hz):
    return assemble(plant.machine, replace(plant.point, speed=HZ * hz))


def _sensitivity(plant, controller, hz):
    omega = HZ * np.geomspace(1, 2000, 800)
    return omega, loop_evaluator(_at(plant, hz), controller)(omega).output_sensitivity()


def _axis_peak(plant, controller, hz):
    return float(np.abs(np.einsum("kii->ki", _sensitivity(plant, controller, hz)[1])).max())


def _crossover(plant, controller, hz):
    """The lowest frequency [rad/s] at which the largest singular value of S passes 1."""
    omega, S = _sensitivity(plant, controller, hz)
    return float(omega[np.argmax(np.linalg.norm(S, 2, axis=(1, 2)) > 1)])
