"""Seals whose frequency dependence is part of the plant: full, reduced, uncertain; the rig is in
test_virtual_rig_accuracy.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace, poles, select
from ambrose.machine.description import OperatingPoint
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.effects.seal_rational import linearised, rational
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import (
    free_mode_reduction,
    modal_reduction,
    perturbed,
    reduce,
    uncertain,
)

MACHINE = load_machine("turboexpander")
STATES = replace(
    MACHINE, seals=(replace(MACHINE.seals[0], frequency_dependence="states", poles=5),)
)
POINT = operating_point(MACHINE, "140 Hz (P3)")
EMPTY = StateSpace([], [], [], [[0.0]])
OMEGA = 2 * np.pi * np.array([5.0, 60.0, 140.0, 320.0, 700.0])


def gain(plant, omega):
    return frequency_response(
        select(plant.system, plant.named("u"), plant.named("y")), omega
    ).values


def small(machine, point=POINT):
    """Ten bending modes per plane on the free rotor's modes: no reduction that depends on the
    seal.
    """
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
    assert poles(assemble(STATES, without).rotor) == pytest.approx(
        poles(assemble(MACHINE, without).rotor)
    )


@pytest.mark.parametrize("bending_modes", [0, 1])
def test_reduced_plant_follows_the_full_one(bending_modes):
    reduction = modal_reduction(small(STATES), bending_modes)
    truth = gain(small(STATES), OMEGA[:4])
    assert np.abs(gain(reduction.plant, OMEGA[:4]) - truth).max() < 5e-3 * np.abs(truth).max()
    assert reduction.T_L @ reduction.T_R == pytest.approx(
        np.eye(reduction.plant.rotor.n_states), abs=1e-8
    )


def test_tolerances_move_the_static_stiffness_and_what_comes_with_motion():
    """K_xx adds 40 % of H_d(0) at the seal, C_xx 40 % of H_d(s) - H_d(0), both 40 % of H_d; k_xy,
    c_xy the same of H_c.
    """
    full = small(STATES)
    ports = ["f_piston_x", "f_piston_y"], ["q_piston_x", "q_piston_y"]

    def stiffness(plant):
        return np.linalg.inv(frequency_response(select(plant.system, *ports), OMEGA).values)

    def change(**delta):
        return (
            stiffness(
                perturbed(full, {f"seal.piston.{name}": value for name, value in delta.items()})
            )
            - before
        )

    before, model = stiffness(full), rational(STATES.seals[0], POINT.seal_pressure)
    at = [linearised(model, w) for w in OMEGA]
    rest = linearised(model, 0.0)
    direct = np.array([c.K + 1j * w * c.C for c, w in zip(at, OMEGA, strict=True)])
    cross = np.array([c.k + 1j * w * c.c for c, w in zip(at, OMEGA, strict=True)])
    size = np.abs(direct).max()
    for delta, entry, expected in (
        ({"K_xx": 1.0}, (0, 0), 0.4 * rest.K + 0 * direct),
        ({"C_xx": 1.0}, (0, 0), 0.4 * (direct - rest.K)),
        ({"K_yy": -1.0, "C_yy": -1.0}, (1, 1), -0.4 * direct),
        ({"k_xy": 1.0, "c_xy": 1.0}, (0, 1), 0.4 * cross),
        ({"k_yx": 1.0, "c_yx": 1.0}, (1, 0), -0.4 * cross),
    ):
        found, wanted = change(**delta), np.zeros((len(OMEGA), 2, 2), dtype=complex)
        wanted[:, *entry] = expected
        assert np.abs(found - wanted).max() < 1e-5 * size, delta
    assert len(uncertain(full).blocks) == 8


def test_no_state_at_a_point_without_pressure_but_a_pole_per_pressure():
    point = OperatingPoint(speed=500.0, seal_pressure=10e5)
    assert assemble(STATES, point).rotor.n_states == assemble(MACHINE, point).rotor.n_states + 10
