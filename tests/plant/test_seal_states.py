"""Seals whose frequency dependence is part of the plant: full, reduced, uncertain; the rig is in test_virtual_rig_accuracy."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace, poles, select
from ambrose.machine.description import OperatingPoint
from ambrose.machine.parameters import operating_point
from ambrose.plant.assemble import assemble, seal_coefficients
from ambrose.plant.model import Plant
from ambrose.plant.reduce import free_mode_reduction, modal_reduction, reduce
from ambrose.plant.uncertainty import perturbed, uncertain

MACHINE = load_machine("turboexpander")
STATES = replace(MACHINE, seals=(replace(MACHINE.seals[0], frequency_dependence="states", poles=5),))
POINT = operating_point(MACHINE, "140 Hz (P3)")
EMPTY = StateSpace([], [], [], [[0.0]])
OMEGA = 2 * np.pi * np.array([5.0, 60.0, 140.0, 320.0, 700.0])


def gain(plant, omega):
    return frequency_response(select(plant.system, plant.named("u"), plant.named("y")), omega).values


def small(machine, point=POINT):
    """Ten bending modes per plane on the free rotor's modes: no reduction that depends on the seal."""
    return free_mode_reduction(Plant(machine, point, EMPTY, EMPTY, ()), 10)


def test_at_every_frequency_the_plant_is_the_one_with_the_constants_of_that_frequency():
    found = gain(small(STATES), OMEGA)
    for w, value in zip(OMEGA, found, strict=True):
        there = gain(small(MACHINE, replace(POINT, whirl_frequency=w)), [w])[0]
        assert np.abs(value - there).max() < 2e-3 * np.abs(there).max()
    constant = gain(small(MACHINE), OMEGA)
    assert np.abs(found - constant).max() > 0.1 * np.abs(constant).max()  # the dependence matters


def test_sizes():
    full = assemble(STATES, POINT)
    assert full.rotor.n_states == assemble(MACHINE, POINT).rotor.n_states + 2 * 5
    assert reduce(full).rotor.n_states == 8 + 10
    assert free_mode_reduction(full).rotor.n_states == 8 + 10
    without = replace(POINT, seal_pressure=0.0)
    assert poles(assemble(STATES, without).rotor) == pytest.approx(poles(assemble(MACHINE, without).rotor))


@pytest.mark.parametrize("bending_modes", [0, 1])
def test_reduced_plant_follows_the_full_one(bending_modes):
    reduction = modal_reduction(small(STATES), bending_modes)
    truth = gain(small(STATES), OMEGA[:4])
    assert np.abs(gain(reduction.plant, OMEGA[:4]) - truth).max() < 5e-3 * np.abs(truth).max()
    assert reduction.T_L @ reduction.T_R == pytest.approx(np.eye(reduction.plant.rotor.n_states), abs=1e-8)


def test_a_tolerance_is_a_constant_spring_or_damper_of_the_synchronous_size():
    """K_xx + 40 % of K at the whirl frequency: a spring from the rotor to ground beside the seal with its states."""
    full = small(STATES)
    nominal = seal_coefficients(STATES.seals[0], POINT)
    assert nominal == seal_coefficients(MACHINE.seals[0], POINT)
    moved = perturbed(full, {"seal.piston.K_xx": 1.0})
    ports = ["f_piston_x", "f_piston_y"], ["q_piston_x", "q_piston_y"]
    before, after = (frequency_response(select(p.system, *ports), OMEGA).values for p in (full, moved))
    change = np.linalg.inv(after) - np.linalg.inv(before)
    expected = np.zeros((2, 2))
    expected[0, 0] = 0.4 * nominal.K
    assert change == pytest.approx(np.broadcast_to(expected, change.shape), abs=1e-3 * nominal.K)
    assert len(uncertain(full).blocks) == 8


def test_no_state_at_a_point_without_pressure_but_a_pole_per_pressure():
    point = OperatingPoint(speed=500.0, seal_pressure=10e5)
    assert assemble(STATES, point).rotor.n_states == assemble(MACHINE, point).rotor.n_states + 10
