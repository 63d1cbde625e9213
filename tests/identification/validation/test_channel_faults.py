"""Faults of channels and magnets: each is made on a loop of the test's own, and named with its size;
before, none of them was among what is tried.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import waveforms
from scipy.linalg import expm

from ambrose.identification.output_error.closed_loop import identify
from ambrose.identification.output_error.problem import FitOptions
from ambrose.identification.validation import suspects as tried
from ambrose.identification.validation.suspects import judged, suspects
from ambrose.machine.description import OperatingPoint
from ambrose.record.record import Record
from linear_rig import AXES, DT, E, Y, rig

SAMPLES = 3000
KNOWN = tuple(
    f"bearing.{name}.{quantity}.{axis}"
    for quantity in ("force_per_current", "negative_stiffness")
    for name in "AB"
    for axis in ("zeta", "eta")
)


def recorded(measure=None, cross=None, e_gain=1.0, late=0.0):
    """A record of the rig's loop with the sensors' matrix ``measure`` (4, 4), the currents' matrix
    ``cross`` (4, 4), a gain of the first excitation and a lag [s] of the first sensor; stepped
    sample by sample, a state u for the delay of one sample.
    """
    machine, plant, _, law = rig()
    system = plant.system
    u = [system.inputs.index(f"u_{axis}") for axis in AXES]
    y = [system.outputs.index(name) for name in Y]
    A, B, C = np.array(system.A), system.B[:, u].copy(), system.C[y].copy()

    # what the magnets push beyond their own current, through the ports of forces: K_i dM i
    if cross is not None:
        i = system.C[[system.outputs.index(f"i_{axis}") for axis in AXES]]
        f = system.B[:, [system.inputs.index(f"f_{axis}") for axis in AXES]]
        gains = np.concatenate([item.force_per_current for item in machine.bearings])
        A += f @ np.diag(gains) @ (cross - np.eye(4)) @ i
    M = np.eye(4) if measure is None else measure
    first = C.copy()
    first[0] -= late * C[0] @ A
    n = len(A)
    block = expm(np.block([[A, B], [np.zeros((4, n + 4))]]) * DT)
    Ad, Bd = block[:n, :n], block[:n, n:]
    e = np.stack([0.1 * waveforms.prbs(9, 10, SAMPLES, shift=127 * k) for k in range(4)])
    acts = e * np.array([[e_gain], [1.0], [1.0], [1.0]])
    x, z, held = np.zeros(n), np.zeros(law.n_states), np.zeros(4)
    rows = np.zeros((4, SAMPLES))
    for k in range(SAMPLES):
        rows[:, k] = M @ first @ x
        command = law.C @ z - law.D @ rows[:, k]
        z = law.A @ z - law.B @ rows[:, k]
        x = Ad @ x + Bd @ (held + acts[:, k])
        held = command
    rows += 2e-8 * np.random.default_rng(0).standard_normal(rows.shape)
    values = np.vstack([rows, e])
    units = ("m",) * 4 + ("A",) * 4
    point = OperatingPoint(plant.point.speed, plant.point.seal_pressure)
    return Record("seal-rig", 1 / DT, (*Y, *E), units, values, point)


@cache
def turn(angle):
    """Two pairs of axes, the first turned by an angle [deg], to first order."""
    M = np.eye(4)
    M[0, 1], M[1, 0] = np.radians(angle), -np.radians(angle)
    return M


@pytest.fixture
def rigid(monkeypatch):
    monkeypatch.setattr(tried, "FURTHER_MODES", 0)


@pytest.mark.usefixtures("rigid")
@pytest.mark.parametrize(
    ("fault", "name", "size"),
    [
        ({"measure": np.diag([1, 1.05, 1, 1])}, "gain of y_A_eta", 5.0),
        ({"late": 2e-5}, "lag of y_A_zeta", 20.0),
        ({"e_gain": 1.05}, "gain of e_A_zeta", 5.0),
        ({"measure": turn(3.0)}, "sensors of A turned by", 3.0),
        ({"cross": np.eye(4) + 0.1 * np.eye(4)[[1, 0, 3, 2]] * [[1], [1], [0], [0]]},
         "cross of the currents in A", 10.0),
        pytest.param(
            {"cross": turn(3.0)}, "magnets of A turned by", 3.0, marks=pytest.mark.study
        ),
    ],
)  # fmt: skip
def test_a_fault_is_named_with_its_size_and_ends_with_a_finding(fault, name, size):
    machine, _, controller, _ = rig()
    data, how = recorded(**fault), FitOptions(bending_modes=0)
    given = identify(machine, data, controller, KNOWN, bending_modes=0)
    found = suspects(machine, [data], controller, given, how)
    first = found[0]
    assert first.path == name, [(item.path, item.step, item.explains) for item in found[:4]]
    assert first.step == pytest.approx(size, rel=0.15)
    assert not judged(given, found, DT).adequate


@pytest.mark.usefixtures("rigid")
def test_the_loop_of_the_test_is_the_models_without_a_fault():
    machine, _, controller, _ = rig()
    data = recorded()
    given = identify(machine, data, controller, KNOWN, bending_modes=0)
    found = suspects(machine, [data], controller, given, FitOptions(bending_modes=0))
    assert all(item.held for item in found)
    assert judged(given, found, DT).adequate


@pytest.mark.usefixtures("rigid")
def test_a_number_that_the_file_holds_widens_what_it_would_move():
    """The amplifier's damping 1 % off moved its frequency by ten of its standard deviations."""
    machine, _, controller, _ = rig()
    own = machine.amplifier
    off = replace(machine, amplifier=replace(own, damping=1.01 * own.damping))
    paths = (*KNOWN, "amplifier.natural_frequency")
    data = recorded()
    given = identify(off, data, controller, paths, bending_modes=0)
    found = suspects(off, [data], controller, given, FitOptions(bending_modes=0))
    result = judged(given, found, DT)
    error = abs(result.values[-1] - own.natural_frequency)
    assert error > 4 * given.standard_deviations[-1]
    assert error < 1.96 * result.standard_deviations[-1]
