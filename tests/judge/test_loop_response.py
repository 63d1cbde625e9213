"""The loop's matrices against closed forms, the closed loop in state space, and the definition of
aliasing.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra.numpy import arrays

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d, hold
from ambrose.core.statespace import select
from ambrose.judge.loop_response import (
    LoopResponse,
    add_poles,
    frequency_grid,
    loop_at,
    loop_evaluator,
)
from ambrose.law.loop import closed_loop
from physical_numbers import physical

# The shaft's element frequencies reach 1e7 rad/s, its rigid stiffness is 1e5 rad2/s2: in
# first-order form eps 1e7/(1e5/1e7) is
# 1e-7 of relative error, for a Schur form and for a direct solution alike.
ROUNDING = 1e-6
OMEGA = 2 * np.pi * np.geomspace(0.5, 5e3, 40)


def test_single_mass_closed_forms(single_masses, pd_controller):
    mass = 2.0
    k_i = 100.0
    k_s = 2e5
    gain = 5000.0
    derivative = 8.0
    tau = 1e-4
    plant = single_masses(mass, k_i, k_s)
    response = loop_evaluator(plant, pd_controller(gain, derivative, tau))(OMEGA)
    s = 1j * OMEGA
    K = gain + derivative * s / (tau * s + 1)
    G = k_i / (mass * s**2 - k_s)
    eye = np.eye(4)
    S = 1 / (1 + G * K)
    expected = {
        "output_sensitivity": S,
        "input_sensitivity": S,
        "complementary": G * K * S,
        "control_sensitivity": K * S,
        "compliance": 1 / (mass * s**2 - k_s + k_i * K),
        "current_per_force": -K / (mass * s**2 - k_s + k_i * K),
    }
    for name, value in expected.items():
        found = getattr(response, name)()
        np.testing.assert_allclose(
            found, value[:, None, None] * eye, rtol=1e-10, atol=1e-10 * np.abs(value).max()
        )


@pytest.mark.parametrize("label", ["nominal", "zero"])
def test_the_rig_against_the_closed_loop_in_state_space(rig_plants, rig_controller, label):
    plant = rig_plants[label]
    response = loop_evaluator(plant, rig_controller)(OMEGA)
    closed = closed_loop(plant, rig_controller)
    axes = plant.axes

    def between(inputs, outputs):
        return frequency_response(
            select(closed, [f"{inputs}_{a}" for a in axes], [f"{outputs}_{a}" for a in axes]), OMEGA
        ).values

    pairs = {
        "output_sensitivity": between("d", "y"),
        "complementary": between("r", "y"),
        "control_sensitivity": between("r", "u"),
        "compliance": between("f", "q"),
        "current_per_force": between("f", "i"),
        "input_sensitivity": np.eye(4) + between("e", "u"),
    }
    for name, value in pairs.items():
        np.testing.assert_allclose(
            getattr(response, name)(),
            value,
            rtol=0,
            atol=ROUNDING * np.abs(value).max(),
            err_msg=name,
        )


def test_one_frequency_at_a_time_is_the_same(rig_plants, rig_controller):
    plant = rig_plants["nominal"]
    for controller in (rig_controller, c2d(rig_controller, 1e-4, "tustin")):
        many = loop_evaluator(plant, controller)(np.array([262.0, 900.0]))
        one = loop_at(plant, controller, 900.0)
        for name in ("G", "K", "G_yf", "G_qu", "G_qf", "G_iu", "G_if"):
            a, b = getattr(many, name)[1], getattr(one, name)[0]
            np.testing.assert_allclose(b, a, rtol=0, atol=ROUNDING * np.abs(a).max())


def test_the_hold_times_the_plant_summed_over_its_aliases_is_the_sampled_plant(rig_plants):
    dt = 2e-4
    plant = select(rig_plants["zero"].system, ["u_A_zeta"], ["y_A_zeta"])
    omega = np.array([100.0, 1500.0, 9000.0])
    sampled = frequency_response(c2d(plant, dt), omega).values[:, 0, 0]
    total = np.zeros(3, complex)
    for k in range(-6, 7):
        shifted = omega + 2 * np.pi * k / dt
        total += frequency_response(plant, shifted).values[:, 0, 0] * hold(shifted, dt)
    np.testing.assert_allclose(total, sampled, rtol=1e-5)
    base = frequency_response(plant, omega).values[:, 0, 0] * hold(omega, dt)
    np.testing.assert_allclose(base[:2], sampled[:2], rtol=1e-3)


def test_above_nyquist_and_wrong_size_are_refused(rig_plants, rig_controller):
    sampled = c2d(rig_controller, 1e-3, "tustin")
    evaluator = loop_evaluator(rig_plants["zero"], sampled)
    with pytest.raises(InvalidInput, match="Nyquist"):
        evaluator(np.array([100.0, 3200.0]))
    with pytest.raises(InvalidInput, match="Nyquist"):
        loop_at(rig_plants["zero"], sampled, 3200.0)
    with pytest.raises(InvalidInput, match="controller's size"):
        loop_evaluator(rig_plants["zero"], select(rig_controller, outputs=["u_A_zeta"]))


entries = physical(-3, 3)


@settings(max_examples=60, deadline=None)
@given(arrays(float, (2, 2, 4, 4), elements=entries))
def test_invariants_of_any_loop(parts):
    """S + T = I; S_o G = G S_i; K S_o = S_i K, wherever the loop is well posed."""
    G, K = parts[0, 0] + 1j * parts[0, 1], parts[1, 0] + 1j * parts[1, 1]
    condition = max(np.linalg.cond(np.eye(4) + G @ K), np.linalg.cond(np.eye(4) + K @ G))
    if condition > 1e6:
        return
    zero = np.zeros((1, 4, 4))
    r = LoopResponse(
        np.ones(1), ("a", "b", "c", "d"), G[None], K[None], zero, zero, zero, zero, zero
    )
    So = r.output_sensitivity()[0]
    Si = r.input_sensitivity()[0]
    T = r.complementary()[0]
    tolerance = {"atol": 1e-12 * condition * max(1.0, np.linalg.norm(G), np.linalg.norm(K)) ** 3}
    np.testing.assert_allclose(So + T, np.eye(4), **tolerance)
    np.testing.assert_allclose(So @ G, G @ Si, **tolerance)
    np.testing.assert_allclose(r.control_sensitivity()[0], Si @ K, **tolerance)


def test_grid_reaches_the_ends_and_packs_lightly_damped_poles():
    poles = np.array([-0.5 + 1000j, -0.5 - 1000j, -900 + 100j, -900 - 100j, -3.0 + 0j, -1 + 9e9j])
    grid = frequency_grid(poles, 1.0, 1e4)
    assert grid[0] == 1.0 and grid[-1] == pytest.approx(1e4)
    assert (np.diff(grid) > 0).all()
    assert ((grid > 999) & (grid < 1001)).sum() >= 9  # within two half-bandwidths
    assert np.diff(np.log(grid)).max() < np.log(10) / 149
    given = np.array([10.0, 20.0])
    np.testing.assert_array_equal(add_poles(given, poles), given)
