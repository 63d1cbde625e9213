"""Families over the box against loops that are assembled and closed one by one."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import poles, select
from ambrose.judge.exploration import loop_over_box, pulse_family, unbalance_over_box
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.model.assemble import assemble
from ambrose.model.static_load import residual_unbalance
from ambrose.model.uncertainty import perturbed, reduce
from ambrose.rig import linear
from ambrose.rig.scenario import Pulse, Scenario

MACHINE = load_machine("turboexpander")
PLANT = reduce(assemble(MACHINE, MACHINE.operation.points[4]), 1)
PID = pid_controller(MACHINE.controller, MACHINE)
NAMES = [tolerance.parameter for tolerance in MACHINE.tolerances]
OUTPUTS = ["q_A_zeta", "y_A_eta", "i_B_zeta"]


def member(delta):
    return closed_loop(perturbed(PLANT, dict(zip(NAMES, delta, strict=True))), PID)


def test_every_member_is_the_loop_closed_around_the_perturbed_plant():
    delta = np.random.default_rng(3).uniform(-1, 1, (4, 8))
    family = pulse_family(PLANT, PID, "A_zeta", 100.0, 2e-3, OUTPUTS, delta, duration=0.02)
    scenario = Scenario("x", 0.02, pulses=(Pulse("f_A_zeta", 100.0, 0.0, 2e-3),))
    for row, found in zip(delta, family.responses, strict=True):
        trace = linear.run(member(row), scenario)
        for name, values in zip(OUTPUTS, found, strict=True):
            expected = trace.record[name][: len(values)]
            assert np.abs(values - expected).max() < 1e-6 * np.abs(expected).max()
    assert family.stable.all()


def test_unstable_members_are_told_apart():
    """A derivative part too weak for the box: the family holds both kinds, as the eigenvalues
    say.
    """
    weak = pid_controller(
        replace(MACHINE.controller, derivative_time=0.35e-3, integral_time=None), MACHINE
    )
    delta = np.array(np.meshgrid(*[[-1.0, 1.0]] * 2)).reshape(2, -1).T @ np.kron(
        np.eye(2), np.ones((1, 4))
    )
    family = pulse_family(PLANT, weak, "A_zeta", 1.0, 2e-3, OUTPUTS, 4 * delta, duration=0.01)
    truth = []
    for row in 4 * delta:
        wide = replace(
            MACHINE, tolerances=tuple(replace(t, relative=1.6) for t in MACHINE.tolerances)
        )
        plant = perturbed(replace(PLANT, machine=wide), dict(zip(NAMES, row / 4, strict=True)))
        truth.append(poles(closed_loop(plant, weak)).real.max() < 0)
    assert family.stable.tolist() == truth
    assert {True, False} == set(truth)
    assert np.isinf(family.settling()[~family.stable]).all()


def test_settling_of_a_known_response():
    family = pulse_family(PLANT, PID, "A_zeta", 1.0, 2e-3, OUTPUTS, np.zeros((1, 8)), duration=0.05)
    known = replace(family, responses=np.exp(-family.time / 5e-3)[None, None, :], outputs=("x",))
    assert known.settling(0.05) == pytest.approx([5e-3 * np.log(20)], abs=1e-4)
    assert np.isinf(known.settling(1e-6)).all()


def test_worst_unbalance_lies_between_any_member_and_the_bound():
    speeds = 2 * np.pi * np.array([60.0, 140.0, 250.0])
    found = unbalance_over_box(PLANT, PID, speeds)
    force = residual_unbalance(MACHINE).force(speeds)
    ports = PLANT.bearing_named("f"), PLANT.bearing_named("q")

    def orbits(delta):
        compliance = frequency_response(select(member(delta), *ports), speeds).values
        return np.linalg.norm(compliance, 2, axis=(1, 2)) * force

    assert found.nominal == pytest.approx(orbits(np.zeros(8)), rel=1e-8)
    for delta in np.random.default_rng(5).choice((-1.0, 0.3, 1.0), (12, 8)):
        assert (orbits(delta) <= found.found * (1 + 1e-9)).all()
    for k, delta in enumerate(found.delta):
        assert orbits(delta)[k] == pytest.approx(found.found[k], rel=1e-8)
    assert (found.bound >= found.found).all()
    assert (found.bound < 1.05 * found.found).all()


def test_plants_of_every_speed():
    speeds = 2 * np.pi * np.array([100.0, 140.0])

    def at(speed):
        return reduce(assemble(MACHINE, replace(PLANT.point, speed=speed)), 1)

    found = unbalance_over_box(at, PID, speeds, bound=False)
    assert found.found[1] == pytest.approx(
        unbalance_over_box(PLANT, PID, speeds[1:], bound=False).found[0], rel=1e-9
    )
    assert np.isnan(found.bound).all()


def test_bad_input():
    with pytest.raises(InvalidInput, match="continuous"):
        loop_over_box(PLANT, c2d(PID, 1e-4, "tustin"), ["f_A_zeta"], ["q_A_zeta"])
    with pytest.raises(InvalidInput, match="multiple of the step"):
        pulse_family(PLANT, PID, "A_zeta", 1.0, 2.05e-4, OUTPUTS)
    with pytest.raises(InvalidInput, match="f_C_zeta"):
        pulse_family(PLANT, PID, "C_zeta", 1.0, 2e-3, OUTPUTS)
    with pytest.raises(InvalidInput, match="positive"):
        unbalance_over_box(PLANT, PID, [0.0])
