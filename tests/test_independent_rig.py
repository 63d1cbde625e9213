"""The rig of the tests' own against the package's plant, and against itself: what it computes in
frequency is what it does in time.
"""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ambrose as amb
import independent_rig as own
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.output_error.problem import deployed_controller
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble

MACHINES = Path(amb.__file__).parent / "machines"
CASES = {  # machine: seal's pressure, speed, rate
    "seal-rig": (2.04e5, 2 * np.pi * 50, 1e4),
    "overhung-blower": (0.3e5, 2 * np.pi * 100, 4e4),
    "turboexpander": (0.0, 2 * np.pi * 525, 4e4),
}
OMEGA = 2 * np.pi * np.geomspace(3, 900, 60)


def pid(name, pressure, speed, rate):
    """Plant and sampled PID of a bundled machine."""
    machine = replace(amb.load_machine(name), tolerances=())
    sampled = replace(machine.controller, sample_time=1 / rate)
    plant = assemble(machine, OperatingPoint(speed, pressure))
    law = amb.design(replace(machine, controller=sampled), "pid")
    K = deployed_controller(plant, law, 1 / rate, 0)
    return plant, (K.A, K.B, K.C, K.D)


def test_nothing_of_the_package_is_in_it():
    tree = ast.parse(Path(own.__file__).read_text())
    names = {a.name for node in ast.walk(tree) if isinstance(node, ast.Import) for a in node.names}
    names |= {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert {name.split(".")[0] for name in names} == {
        "re", "tomllib", "dataclasses", "pathlib", "numpy", "numba", "scipy",
    }  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_linear_response(name):
    """Rotor, gyroscopic moments, seal, coupling, magnets at their load, amplifier and hold: within
    0.5 % of the package's, and so is the sensitivity.
    """
    pressure, speed, rate = CASES[name]
    plant, law = pid(name, pressure, speed, rate)
    rig = own.Rig(own.numbers_of(MACHINES / f"{name}.toml", pressure), rate, speed, modes=12)
    G, K = rig.responses(law, OMEGA)
    system = c2d(select(plant.system, plant.named("u"), plant.named("y")), 1 / rate)
    theirs = frequency_response(system, OMEGA).values
    off = np.linalg.norm(G - theirs, axis=(1, 2)) / np.linalg.norm(theirs, axis=(1, 2))
    assert off.max() < 5e-3
    S, other = (np.linalg.inv(np.eye(G.shape[1]) + item @ K) for item in (G, theirs))
    assert np.abs(S - other).max() < 5e-3 * np.abs(S).max()


def test_time_is_frequency():
    """A sine of 0.5 mA at every axis in turn: its phasors in y are those of -(I + G K)^-1 G e."""
    pressure, speed, rate = CASES["seal-rig"]
    _, law = pid("seal-rig", pressure, speed, rate)
    rig = own.Rig(own.numbers_of(MACHINES / "seal-rig.toml", pressure), rate, speed)
    f, k = 40.0, 5000
    wave = 5e-4 * np.cos(2 * np.pi * f * np.arange(2 * k) / rate)
    G, K = (item[0] for item in rig.responses(law, [2 * np.pi * f]))
    T = np.linalg.inv(np.eye(4) + G @ K) @ G
    for axis in range(2):
        e = np.zeros((4, 2 * k))
        e[axis] = wave
        y = rig.run(law, e, settle=0.0)["y"][:, k:]
        y = y - y.mean(axis=1, keepdims=True)
        phasor = 2 / k * (y * np.exp(-2j * np.pi * f * np.arange(k, 2 * k) / rate)).sum(axis=1)
        np.testing.assert_allclose(phasor, 5e-4 * T[:, axis], atol=2e-3 * 5e-4 * np.abs(T).max())


def test_magnets_have_the_slopes_that_were_asked_for():
    """k_i and k_s of a file are those at the load, with and without saturation; then they bend."""
    _, law = pid("seal-rig", *CASES["seal-rig"])
    for saturation in (0.0, 2.0):
        rig = own.Rig(own.numbers_of(MACHINES / "seal-rig.toml"), saturation=saturation)
        ki, ks = rig.slopes(law)
        np.testing.assert_allclose(ki, [144.34, 139.44, 163.75, 163.48], rtol=1e-3)
        np.testing.assert_allclose(ks, [0.863e6, 0.871e6, 1.226e6, 1.215e6], rtol=1e-3)
        c, gap, bias, sat = rig.mag[0, :4]
        near, far = (own.pull(i, 0.0, c, gap, bias, sat) / i for i in (0.01, 3.0))
        assert (far < 0.9 * near) if saturation else abs(far / near - 1) < 1e-9


def test_converters():
    """Steps of y and u, and a delay of two samples: what is recorded is what the controller did."""
    _, law = pid("seal-rig", *CASES["seal-rig"])
    numbers = own.numbers_of(MACHINES / "seal-rig.toml", 2.04e5)
    rig = own.Rig(numbers, delay=2, step_y=1e-8, step_u=1e-4, noise=1e-7)
    found = rig.run(law, 0.2, seed=1)
    for key, step in (("y", 1e-8), ("u", 1e-4)):
        assert np.abs(found[key] / step - np.round(found[key] / step)).max() < 1e-6
    A, B, C, D = law
    x = np.linalg.lstsq(C, found["u"][:, 2] + D @ found["y"][:, 0])[0]
    assert A.shape[0] == len(x) and B.shape == (len(x), 4)
    direct = np.diff(found["u"][:, 2:], axis=1) + D @ np.diff(found["y"][:, :-2], axis=1)
    late = np.diff(found["u"][:, 1:-1], axis=1) + D @ np.diff(found["y"][:, :-2], axis=1)
    assert direct.std() < 0.2 * late.std()
