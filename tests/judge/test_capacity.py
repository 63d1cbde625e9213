"""Load capacity: bounds in closed form, an impulse against an integration in time of this file's
own loop, a surge against the same loop's long run.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import StateSpace as Lti, lsim

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.judge.unbalance import (
    AxisLimits,
    Demand,
    axis_limits,
    levers,
    load_demands,
    on_axes,
    static_forces,
    together,
)
from ambrose.law.law import law_of
from ambrose.machine.description import Amplifier
from ambrose.model.assemble import assemble
from ambrose.model.effects.stations import Load
from ambrose.model.static_load import magnet_coefficients

R, L = 0.4, 0.02


@pytest.fixture(scope="module")
def machine():
    """The turboexpander with a circuit, an impulse and a surge beside the middle."""
    given = amb.load_machine("turboexpander")
    drive = Amplifier("current-loop", 9e3, max_voltage=150.0, inductance=L, resistance=R)
    place = 0.4 * given.length
    loads = (
        Load("knock", place, "impulse", 300.0, duration=3e-3, direction=0.4),
        Load("swell", place, "surge", 200.0, frequency=2 * math.pi * 30),
    )
    return replace(given, amplifier=drive, effects=(*given.effects, *loads), tolerances=())


def own_loop(machine):
    """x' = A x + B f, (i, q, i', q') = C x of plant and continuous PID, joined here."""
    plant = assemble(machine, machine.operation.nominal)
    controller = amb.design(machine, "pid", rate=None).controller
    K = law_of(controller).at(plant.point)
    P = plant.system
    u, y, i = (plant.named(name) for name in "uyi")
    column, row = P.inputs.index, P.outputs.index
    Bu, Cy = P.B[:, [column(n) for n in u]], P.C[[row(n) for n in y]]
    Bf = P.B[:, [column(f"f_knock_{axis}") for axis in "xy"]]
    C = P.C[[row(n) for n in (*i, *(f"q_{axis}" for axis in plant.axes))]]
    A = np.block([[P.A - Bu @ K.D @ Cy, -Bu @ K.C], [K.B @ Cy, K.A]])
    B, C = (
        np.vstack([Bf, np.zeros((K.n_states, 2))]),
        np.hstack([C, np.zeros((len(C), K.n_states))]),
    )
    return plant, controller, A, B, C


def peaks(machine, plant, A, B, C, t, force):
    """Largest current and voltage of every axis while a force (t, 2) acts."""
    _, out, x = lsim(Lti(A, B, C, np.zeros((len(C), 2))), force, t)
    slopes = (x @ A.T + force @ B.T) @ C.T
    a = len(plant.axes)
    k_i, _ = magnet_coefficients(machine, plant.point)
    v = R * out[:, :a] + L * slopes[:, :a] + k_i / 2 * slopes[:, a:]
    return np.abs(out[:, :a]).max(axis=0), np.abs(v).max(axis=0)


def test_an_impulse_takes_what_the_loop_does_in_time(machine):
    plant, controller, A, B, C = own_loop(machine)
    t = np.linspace(0, 0.25, 25_001)
    pulse = 300.0 * np.where(t < 3e-3, np.sin(np.pi * t / 3e-3), 0.0)
    current, voltage = peaks(
        machine, plant, A, B, C, t, np.outer(pulse, [math.cos(0.4), math.sin(0.4)])
    )
    for axis, demands in enumerate(load_demands(plant, controller, None)):
        knock = next(item for item in demands if item.name == "knock")
        assert knock.current == pytest.approx(current[axis], rel=2e-3)
        assert knock.voltage == pytest.approx(voltage[axis], rel=2e-3)


def test_a_surge_takes_the_sines_amplitude_in_its_worst_direction(machine):
    plant, controller, A, B, C = own_loop(machine)
    w = 2 * math.pi * 30
    G = C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B)
    turns = np.linspace(0, math.pi, 20_001)
    ways = np.array([np.cos(turns), np.sin(turns)])
    for axis, demands in enumerate(load_demands(plant, controller, None)):
        swell = next(item for item in demands if item.name == "swell")
        assert swell.current == pytest.approx(200.0 * np.abs(G[axis] @ ways).max(), rel=1e-6)
        assert swell.frequency == w


def test_bounds_are_their_closed_forms():
    limits = AxisLimits(
        bias=3.0,
        static=-1.0,
        force_per_current=100.0,
        largest=2.5,
        force=190.0,
        voltage=50.0,
        inductance=L,
        resistance=R,
    )
    w = np.array([1.0, 1e4])
    carries, why = limits.over(w)
    assert carries == pytest.approx([0.9, (50 - 4 * R) / math.hypot(R, 1e4 * L)])
    assert why == ("force", "voltage")
    other, _ = limits.over(w, -1)
    assert other == pytest.approx([2.9, (50 - 2 * R) / math.hypot(R, 1e4 * L)])
    # peaks of two demands add up, of current and of voltage
    one = Demand("a", "unbalance", 1e4, 0.1, 20.0, 10.0)
    two = Demand("b", "surge", 10.0, 0.3, 2.0, 30.0)
    slow = limits.margin(one)
    assert (slow.value, slow.limited_by) == (pytest.approx((50 - 4 * R) / 20), "voltage")
    assert (slow.taken, slow.able, slow.unit) == (20.0, pytest.approx(50 - 4 * R), "V")
    strong = limits.margin(two)
    assert (strong.value, strong.limited_by) == (pytest.approx(3.0), "force")
    # of 190 N the static current takes 100
    assert (strong.taken, strong.able, strong.unit) == (30.0, pytest.approx(90.0), "N")
    both = together(limits, one, [two])[1]
    assert both.value == pytest.approx((50 - 4 * R) / 22)
    assert (both.of, both.limited_by) == ("b with a", "voltage")


def test_lasting_loads_are_carried_by_levers(machine):
    first, second = (bearing.position for bearing in machine.bearings)
    share = levers(machine, first + 0.25 * (second - first))
    assert share == pytest.approx([0.75, 0.25])
    angle = machine.bearings[0].angle
    along = on_axes(machine, first, np.array([math.cos(angle), math.sin(angle)]))
    assert along == pytest.approx([1.0, 0.0, 0.0, 0.0], abs=1e-12)
    lasting = (
        Load("belt", first, "static", 70.0, direction=angle),
        Load("any", second, "static", 50.0),
    )
    signed, free = static_forces(replace(machine, effects=(*machine.effects, *lasting)))
    assert signed == pytest.approx([70, 0, 0, 0], abs=1e-9)
    assert free == pytest.approx([0, 0, 50, 50], abs=1e-9)
    plant = assemble(machine, machine.operation.nominal)
    k_i, _ = magnet_coefficients(machine, plant.point)
    assert axis_limits(plant, k_i)[0].static == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("load", "words"),
    [
        (Load("a", 0.1, "impulse", 10.0), "duration is missing"),
        (Load("a", 0.1, "surge", 10.0, duration=1.0, frequency=1.0), "duration is given"),
        (Load("a", 0.1, "static", -1.0), "force is -1"),
        (Load("a", 9.0, "static", 1.0), "on the shaft"),
    ],
)
def test_a_load_that_cannot_be_is_refused(machine, load, words):
    with pytest.raises(InvalidInput, match=words):
        replace(machine, effects=(load,))
