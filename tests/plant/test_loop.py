"""The closed loop against the definitions in the loop diagram."""

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, poles, select, static_gain
from ambrose.plant.assemble import assemble
from ambrose.plant.loop import closed_loop
from ambrose.plant.reduce import reduce

RNG = np.random.default_rng(4)
OMEGA = np.geomspace(1, 3e3, 30)


@pytest.fixture(scope="module")
def plant():
    return reduce(assemble(load_machine("seal-rig")))


@pytest.fixture(scope="module")
def controller():
    A = RNG.standard_normal((5, 5)) * 100 - 500 * np.eye(5)
    return StateSpace(A, RNG.standard_normal((5, 4)) * 1e3, RNG.standard_normal((4, 5)) * 1e3, 2e4 * np.eye(4))


def between(system, inputs, outputs):
    return frequency_response(select(system, inputs, outputs), OMEGA).values


def test_every_transfer_function_of_the_diagram(plant, controller):
    loop = closed_loop(plant, controller)
    names = {kind: [f"{kind}_{a}" for a in plant.axes] for kind in "edryu"}
    G = between(plant.system, plant.named("u"), plant.named("y"))
    K = frequency_response(controller, OMEGA).values
    eye = np.eye(4)
    S_o, S_i = np.linalg.inv(eye + G @ K), np.linalg.inv(eye + K @ G)

    def equal(inputs, outputs, expected):
        got = between(loop, inputs, outputs)
        assert got == pytest.approx(expected, rel=1e-7, abs=1e-9 * np.abs(expected).max())

    equal(names["d"], names["y"], S_o)
    equal(names["r"], names["y"], eye - S_o)
    equal(names["r"], names["u"], K @ S_o)
    equal(names["d"], names["u"], -K @ S_o)
    equal(names["e"], names["u"], S_i - eye)  # v = u + e, e -> v is S_i
    f, q = plant.bearing_named("f"), plant.bearing_named("q")
    G_qf, G_qu, G_yf = (between(plant.system, *pair) for pair in ((f, q), (plant.named("u"), q), (f, plant.named("y"))))
    equal(f, q, G_qf - G_qu @ K @ S_o @ G_yf)


def test_sampled_controller_closes_the_sampled_plant(plant, controller):
    dt = 1e-4
    loop = closed_loop(plant, c2d(controller, dt, "tustin", delay=dt))
    assert loop.dt == dt
    sampled = c2d(plant.system, dt)
    K = c2d(controller, dt, "tustin", delay=dt)
    G = between(sampled, plant.named("u"), plant.named("y"))
    S_o = np.linalg.inv(np.eye(4) + G @ frequency_response(K, OMEGA).values)
    got = between(loop, [f"d_{a}" for a in plant.axes], plant.named("y"))
    assert got == pytest.approx(S_o, rel=1e-6, abs=1e-9)


def test_open_loop_is_kept_without_control(plant):
    loop = closed_loop(plant, static_gain(np.zeros((4, 4))))
    assert poles(loop) == pytest.approx(poles(plant.system), abs=1e-6)


def test_wrong_size_names_the_axes(plant):
    with pytest.raises(InvalidInput, match="A_zeta"):
        closed_loop(plant, static_gain(np.eye(3)))
