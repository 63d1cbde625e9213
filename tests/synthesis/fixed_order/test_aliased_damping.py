"""Tuning asks modes above half the sample rate for no damping ratio at the frequency of their
aliases, and stays with the judge and with its own slope.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.aliasing import continuous_poles
from ambrose.law.loop import Timing, closed_loop, running_law
from ambrose.law.pid import pid_controller
from ambrose.machine.file.toml import load_machine
from ambrose.model.assemble import assemble
from ambrose.synthesis.fixed_order.channels import aims_of, loop_model
from ambrose.synthesis.fixed_order.objective import Objective
from ambrose.synthesis.fixed_order.structure import axis_groups, structured

TWO_PI = 2 * np.pi
BASE = load_machine("high-speed-spindle")
# the mode at 41.1 kHz stands at 1137 Hz when sampled at 40 kHz, with a damping ratio of 0.168, where
# the separation margin asks for 0.2
MACHINE = replace(
    BASE,
    requirements=replace(BASE.requirements, running_speeds=(TWO_PI * 1000, TWO_PI * 1500)),
)
PLANT = assemble(MACHINE, MACHINE.operation.envelope[0])
LAW = pid_controller(MACHINE.controller, MACHINE)
RUNS = Timing(1 / 40e3)


def objective(model, omega=(100.0,)):
    structure, x = structured(LAW, axis_groups(MACHINE, "free"))
    return Objective(structure, [model], np.array(omega), aims_of(MACHINE, LAW)), x


def test_running_speeds_at_an_alias_ask_for_no_damping_there():
    model = loop_model(PLANT, RUNS)
    cost, x = objective(model)
    blind, _ = objective(replace(model, fast=None))
    assert blind.ratios(x)["damping"].value == pytest.approx(1.05 * 1.56, abs=0.01)
    assert cost.ratios(x)["damping"].value < 0.6
    assert cost.abscissa(x) == blind.abscissa(x)


def test_tuning_and_the_judge_read_the_same_poles_at_their_own_frequency():
    model = loop_model(PLANT, RUNS)
    cost, x = objective(model)
    loop = closed_loop(PLANT, running_law(LAW, PLANT, RUNS))
    poles = continuous_poles(loop.A, loop.dt, PLANT.system.A)[0]
    judged = np.abs(poles.imag) > np.pi / RUNS.sample_time * (1 + 1e-9)

    # in w the ratio is left out: 0
    values, aliased = cost._read(cost.structure.theta(x))[0]
    assert aliased.sum() == judged.sum() > 100
    z = (1 + values[aliased] * RUNS.sample_time / 2) / (1 - values[aliased] * RUNS.sample_time / 2)
    real = np.log(np.abs(z)) / RUNS.sample_time
    assert np.sort(real) == pytest.approx(np.sort(poles[judged].real), rel=1e-6)


@pytest.mark.parametrize("narrowed", [False, True])
def test_the_slope_leaves_them_out_as_the_value_does(narrowed):
    cost, x = objective(loop_model(PLANT, RUNS), np.geomspace(50, 1e5, 12))
    if narrowed:
        assert cost.narrow(x, 20)
    value, slope = cost(x, 20)
    assert np.isfinite(value)
    way = np.random.default_rng(1).normal(size=len(x)) * np.maximum(np.abs(x), 1e-3) * 1e-6
    change = cost(x + way, 20)[0] - cost(x - way, 20)[0]
    assert change / 2 == pytest.approx(slope @ way, rel=1e-4)
