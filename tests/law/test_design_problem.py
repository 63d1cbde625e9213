"""The design problem against formulas from G, K and the weights, written out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.published_p5 import (
    published_p5,
    published_p5_data,
    published_p5_pid,
    published_p5_problem,
    published_p5_weights,
)

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import FullBlock, GeneralizedPlant, RealBlock, close_uncertainty, lft
from ambrose.core.statespace import StateSpace, is_stable, select
from ambrose.law.design_problem import (
    Weights,
    control_weight,
    design_plant,
    machine_weights,
    performance_weight,
    with_performance_block,
)
from ambrose.law.pid import axes_controller, pid_controller
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import perturbed, reduce

OMEGA = np.array([0.01, 1.0, 30.0, 250.0, 900.0, 1e4])
AXES = tuple(published_p5_data()["axes"])
UNEVEN = Weights(
    performance_weight(2.5, 7.0, 0.01), control_weight(0.2, 3e3, 2), 15e-6, 0.7, 0.3, 1.9
)


@pytest.fixture(scope="module")
def rig() -> Machine:
    return load_machine("seal-rig")


@pytest.fixture(scope="module")
def plant(rig: Machine) -> Plant:
    return reduce(assemble(rig))


@pytest.fixture(scope="module")
def controller(rig: Machine) -> StateSpace:
    return pid_controller(rig.controller, rig)


def values(system: StateSpace, inputs=None, outputs=None) -> np.ndarray:
    return frequency_response(select(system, inputs, outputs), OMEGA).values


def names(*letters: str, axes=AXES) -> list[str]:
    return [f"{letter}_{axis}" for letter in letters for axis in axes]


def by_hand(G: np.ndarray, K: np.ndarray, weights: Weights) -> np.ndarray:
    """(w, 8, 8) from (w1, w2) to (z1, z2): err = -S_o (G D_u w1 + D_e w2), u = K err, z1 = W_p
    err/D_e, z2 = W_u u/D_u.
    """
    eye = np.eye(4)
    W_p = values(weights.performance)[:, :1, :1]
    W_u = values(weights.control)[:, :1, :1]
    S = np.linalg.inv(eye + G @ K)
    from_current = -S @ G * weights.current_scale * weights.current_disturbance
    from_offset = -S * weights.error_scale * weights.output_disturbance
    err = np.concatenate([from_current, from_offset], axis=2)
    return np.concatenate(
        [W_p * err / weights.error_scale, W_u * (K @ err) / weights.current_scale], axis=1
    )


@pytest.mark.parametrize("weights", [None, UNEVEN], ids=["machine's", "uneven"])
@pytest.mark.parametrize("uncertain", [True, False])
def test_lower_lft_equals_the_formulas(plant, controller, weights, uncertain):
    problem = design_plant(plant, weights, uncertain=uncertain)
    closed = lft(problem, controller)
    used = machine_weights(plant.machine) if weights is None else weights
    expected = by_hand(values(plant.system, names("u"), names("y")), values(controller), used)
    found = values(closed, names("w1", "w2"), names("z1", "z2"))
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


def test_published_plant_equals_the_formulas():
    weights = published_p5_weights()
    data = published_p5_data()
    controller = axes_controller(published_p5_pid(), AXES)
    s = 1j * OMEGA[:, None, None]
    wn, d = data["actuator"]["natural_frequency"], data["actuator"]["damping"]
    A, B, C = (np.array(data[key]) for key in "ABC")
    force = C @ np.linalg.solve(
        s * np.eye(8) - A, np.broadcast_to(B, (len(OMEGA), 8, 4)).astype(complex)
    )
    G = force * np.array(data["force_per_current"]) * wn**2 / (s**2 + d * s + wn**2)
    found = values(lft(published_p5_problem(), controller), names("w1", "w2"), names("z1", "z2"))
    expected = by_hand(G, values(controller), weights)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("delta", [-1.0, -0.37, 1.0])
def test_blocks_carry_the_perturbed_plant(plant, controller, delta):
    """Closing the block gives the formulas around the plant perturbed by itself: w_delta and
    z_delta sit in the right place.
    """
    closed = close_uncertainty(design_plant(plant, UNEVEN), {"seal.center.pressure": delta})
    problem = GeneralizedPlant(
        closed, names("w1", "w2"), names("u"), names("z1", "z2"), names("err")
    )
    moved = perturbed(plant, {"seal.center.pressure": delta})
    expected = by_hand(values(moved.system, names("u"), names("y")), values(controller), UNEVEN)
    found = values(lft(problem, controller))
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())


def test_published_block_carries_the_perturbed_plant():
    closed = close_uncertainty(published_p5_problem(), {"seal.k": 0.6})
    alone = close_uncertainty(published_p5(), {"seal.k": 0.6})
    expected = -values(alone, names("u"), names("y"))
    error = np.abs(values(closed, names("u"), names("err")) - expected)
    assert (error.max(axis=(1, 2)) <= 1e-9 * np.abs(expected).max(axis=(1, 2))).all()


def test_orders_and_signals(rig, plant):
    problem = published_p5_problem()
    assert problem.system.n_states == 20  # 8 rotor, 8 actuator, 4 weights
    assert problem.blocks == (RealBlock("seal.k", 2),)
    assert problem.w == ("w_seal.k_1", "w_seal.k_2", *names("w1", "w2"))
    assert problem.z == ("z_seal.k_1", "z_seal.k_2", *names("z1", "z2"))
    assert (list(problem.u), list(problem.y)) == (names("u"), names("err"))
    full = assemble(rig)
    assert [design_plant(reduce(full, modes)).system.n_states for modes in (0, 1)] == [20, 24]
    assert design_plant(plant, UNEVEN).system.n_states == 20 + 4 * 2
    nominal = design_plant(plant, uncertain=False)
    assert nominal.blocks == () and len(nominal.w) == 8


def test_turboexpander_problem_has_eight_independent_parameters():
    machine = load_machine("turboexpander")
    problem = design_plant(reduce(assemble(machine, operating_point(machine, "140 Hz")), 0))
    assert [(type(b), b.repeat) for b in problem.blocks] == [(RealBlock, 1)] * 8
    assert problem.system.n_states == 8 + 4 + 4 + 4  # rotor, amplifiers, W_p, W_u


def test_controller_signals_are_physical(plant, controller):
    """u and err are amperes and metres: the PID closes the loop as it is and holds the plant
    without uncertainty or weights.
    """
    problem = design_plant(plant, UNEVEN)
    assert tuple(controller.inputs) == problem.y
    assert tuple(controller.outputs) == problem.u
    assert is_stable(lft(problem, controller))


def test_performance_block_spans_what_is_left():
    problem = published_p5_problem()
    whole = with_performance_block(problem)
    assert whole.blocks == (*problem.blocks, FullBlock("performance", 8, 8))
    assert (whole.n_w_blocks, whole.n_z_blocks) == (len(whole.w), len(whole.z))
    with pytest.raises(InvalidInput, match="block already"):
        with_performance_block(whole)


def test_refusals(rig, plant):
    with pytest.raises(InvalidInput, match="carries none"):
        design_plant(published_p5())
    with pytest.raises(InvalidInput, match="has its blocks already"):
        design_plant(published_p5(), UNEVEN, rig.tolerances)
    with pytest.raises(InvalidInput, match="has no tolerance"):
        design_plant(plant, tolerances=())
    bare = published_p5()
    with pytest.raises(InvalidInput, match="no blocks"):
        design_plant(GeneralizedPlant(bare.system, bare.w, bare.u, bare.z, bare.y), UNEVEN)
    with pytest.raises(InvalidInput, match="u_<axis>"):
        design_plant(GeneralizedPlant(static(), [], ["a"], [], ["b"]), UNEVEN, uncertain=False)
    with pytest.raises(InvalidInput, match=r"add a \[weights\] table"):
        design_plant(replace(plant, machine=replace(rig, weights=None)))


def static() -> StateSpace:
    return StateSpace([], np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]], ["a"], ["b"])
