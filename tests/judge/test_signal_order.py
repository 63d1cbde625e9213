"""A controller whose signals stand in another order is the same controller, wherever a loop is
closed.

Before the signals were matched by name, every one of these found another loop, most of them an
unstable one.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.lft import GeneralizedPlant
from ambrose.core.sampling import c2d
from ambrose.core.statespace import connect, poles, rename, select
from ambrose.judge import nominal, robust
from ambrose.judge.campbell import follow, speed_stability_check
from ambrose.judge.exploration import loop_over_box
from ambrose.judge.loop_response import loop_at, loop_evaluator
from ambrose.judge.result import certify, generalized_certificate
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Tolerance
from ambrose.model.uncertainty import reduce
from ambrose.rig import linear, virtual_rig
from ambrose.rig.scenario import Pulse, Scenario
from pole_sets import matched

TOLERANCES = (Tolerance("seal.center.k", relative=0.5),)


@pytest.fixture(scope="module")
def plant(rig_plants):
    return reduce(rig_plants["nominal"], 1)


@pytest.fixture(scope="module")
def controllers(rig):
    """A controller that couples the axes, and the same one with its signals in another order."""
    design = pid_controller(
        replace(rig.controller, coordinates="tilt-translate", tilt_gain=1.3), rig
    )
    return design, select(
        design, [design.inputs[k] for k in (2, 0, 3, 1)], [design.outputs[k] for k in (3, 1, 2, 0)]
    )


def same(first, second):
    """Equal but for rounding, entry by entry."""
    assert first.keys() == second.keys()
    for name, value in first.items():
        if isinstance(value, dict):
            same(value, second[name])
        else:
            assert second[name] == (
                pytest.approx(value, rel=1e-6, abs=1e-9) if isinstance(value, float) else value
            )


def numbers(checks):
    return {check.name: check.value for check in checks.checks}


def test_poles_and_responses(plant, controllers):
    first, second = (poles(closed_loop(plant, K)) for K in controllers)
    np.testing.assert_allclose(matched(first, second), second, rtol=1e-9)
    omega = np.geomspace(10, 3000, 5)
    for give in (lambda K: loop_evaluator(plant, K)(omega), lambda K: loop_at(plant, K, 300.0)):
        first, second = (give(K).output_sensitivity() for K in controllers)
        np.testing.assert_allclose(first, second, rtol=1e-9, atol=1e-9)
    first, second = (
        speed_stability_check(follow(lambda _, K=K: closed_loop(plant, K), np.array([1.0, 2.0])))
        for K in controllers
    )
    assert first.value == pytest.approx(second.value, rel=1e-9)


def test_checks(plant, controllers):
    first, second = (nominal.check(plant, K) for K in controllers)
    assert first.stable
    same(numbers(first), numbers(second))


def test_checks_over_the_tolerances(plant, controllers):
    first, second = (robust.check(plant, K, TOLERANCES) for K in controllers)
    assert first.stable
    same(numbers(first), numbers(second))
    first, second = (
        loop_over_box(plant, K, ["f_A_zeta"], ["q_A_zeta"], TOLERANCES).system for K in controllers
    )
    np.testing.assert_allclose(first.A, second.A, rtol=1e-9)


def test_certificates(plant, controllers):
    bare = select(plant.system, plant.named("u"), plant.named("y"))
    for part in (plant, bare):
        first, second = (certify(part, K) for K in controllers)
        assert first.stable
        same(first.to_dict(), second.to_dict())


def test_a_generalized_plant(plant, controllers):
    """Its measurements are errors: the minus sign sits inside."""
    axes = plant.axes
    u, y, err = ([f"{kind}_{axis}" for axis in axes] for kind in ("u", "y", "err"))
    w = [f"w_{axis}" for axis in axes]
    part = rename(select(plant.system, u, y), {name: f"v_{name}" for name in u})
    sums = {f"v_{a}": [a, b] for a, b in zip(u, w, strict=True)} | {
        a: [f"-{b}"] for a, b in zip(err, y, strict=True)
    }
    problem = GeneralizedPlant(connect([part], [*w, *u], [*y, *err], sums), w, u, y, err)
    first, second = (generalized_certificate(problem, K) for K in controllers)
    assert first.stable
    same(first.to_dict(), second.to_dict())


@pytest.mark.study
def test_linear_simulation_and_the_virtual_rig(rig, plant, controllers):
    scenario = Scenario("push", 0.02, pulses=(Pulse("e_A_zeta", 0.05, 0.0, 0.005),))
    first, second = (linear.run(closed_loop(plant, K), scenario) for K in controllers)
    np.testing.assert_allclose(first.record.values, second.record.values, rtol=1e-9, atol=1e-15)
    programs = [Program(K) for K in controllers]
    first, second, third, fourth = (
        virtual_rig.run(rig, law, scenario, point=plant.point) for law in (*controllers, *programs)
    )
    assert first.stable
    np.testing.assert_allclose(first.record.values, second.record.values, rtol=1e-9, atol=1e-15)
    for other in (third, fourth):  # only the sums are formed in another order
        np.testing.assert_allclose(other.record.values, first.record.values, rtol=1e-9, atol=1e-15)


class Program:
    """A controller as a running program, in the order of its own signals."""

    sample_time, delay = 1e-4, 1

    def __init__(self, controller):
        self.system = c2d(controller, self.sample_time, method="tustin")

    def begin(self, states):
        self.states = states.copy()

    def step(self, errors):
        K = self.system
        currents = K.C @ self.states + K.D @ errors
        self.states = K.A @ self.states + K.B @ errors
        return currents
