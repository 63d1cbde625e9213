"""Run-ups against a Runge-Kutta solution in physical coordinates: seals that change with the speed
must not move the states.

The machines are the turboexpander with its gas seal, and with a table over speed whose stiffness,
damping and added mass all change. Before the states of ``assemble`` were the free rotor's, its
velocity states were scaled by the stiffness at each speed (264 to 684 rad/s over this range).
Run-ups in 0.2 s to 3200 rad/s were then wrong by 1.4 % (gas seal) and 3.6 % (table) of the peak.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.mechanical import to_statespace
from ambrose.core.statespace import StateSpace, static_gain
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.machine import Machine
from ambrose.machine.parameters import operating_point
from ambrose.machine.part import SealTable, ShaftSection
from ambrose.model.assemble import assemble, attached_rotor, wire
from ambrose.model.effects import amplifier, magnet, sensor
from ambrose.model.effects.rotor import finite_element_rotor
from ambrose.model.plant import Plant
from ambrose.model.uncertainty import free_mode_reduction, reduce
from ambrose.rig import linear
from ambrose.rig.scenario import Pulse, Scenario, Unbalance
from ambrose.rig.trial import simulate_linear, spin_up

# rad/s; of the table
LOW = 60.0
HIGH = 2800.0
KNOT = 1500.0
RUN_UP = Scenario("run-up", 0.1, unbalances=(Unbalance("piston", 1e-4),), speed=LOW, to_speed=HIGH)
OUTPUTS = ["q_A_zeta", "q_B_eta", "q_piston_x"]
DT = 1e-4
NOTHING = static_gain(np.zeros((1, 1)))  # only machine and point of the plant are looked at


@cache
def machine(kind: str) -> Machine:
    """The turboexpander: "gas" seal; a seal "table"; the table on a "coarse" shaft of two elements,
    24 states.
    """
    given = load_machine("turboexpander")
    if kind == "gas":
        return given
    values = {
        "K": (0.0, 4e6, 0.4e6),
        "k": (0.0, 0.5e6, 1e6),
        "C": (400.0, 1500.0, 900.0),
        "c": (0.0, 200.0, 100.0),
    }
    table = SealTable((("speed", (0.0, KNOT, 3500.0)),), (*values.items(), ("M", (0.0, 1.5, 4.0))))
    tabled = replace(
        given, seals=(replace(given.seals[0], geometry=None, table=table),), tolerances=()
    )
    if kind == "table":
        return tabled
    end = given.shaft[-1].start + given.shaft[-1].length
    halves = tuple(
        ShaftSection(start=end * k / 2, length=end / 2, outer_diameter=0.085) for k in range(2)
    )
    return replace(tabled, shaft=halves)


@cache
def controller(kind: str):
    return pid_controller(machine(kind).controller, machine(kind))


def at(kind: str, speed: float) -> Plant:
    """Machine and operating point, which is all that a reduction takes of a plant."""
    point = replace(operating_point(machine(kind), "140 Hz"), speed=speed)
    return Plant(machine(kind), point, NOTHING, NOTHING, ())


@cache
def runge_kutta(kind: str, bending_modes: int) -> np.ndarray:
    """OUTPUTS of RUN_UP: M(W) q'' + (D(W) + W G) q' + K(W) q = B f, amplifiers, sensors and
    controller, by DOP853.
    """
    here, K = at(kind, LOW), controller(kind)
    rotor, axes = finite_element_rotor(here.machine), here.machine.axes
    grid = np.unique([*np.linspace(LOW, KNOT, 60), *np.linspace(KNOT, HIGH, 60)])
    found = [
        attached_rotor(here.machine, at(kind, speed).point, rotor, bending_modes) for speed in grid
    ]
    inverse = [np.linalg.inv(x.mass) for x in found]
    parts = {
        "K": [W @ x.stiffness for W, x in zip(inverse, found, strict=True)],
        "D": [
            W @ (x.damping + speed * x.gyroscopic)
            for W, x, speed in zip(inverse, found, grid, strict=True)
        ],
        "B": [W @ x.B for W, x in zip(inverse, found, strict=True)],
    }
    spline = {name: CubicSpline(grid, np.array(values)) for name, values in parts.items()}
    power, sensed = (
        amplifier.linearised(here.machine.amplifier, axes),
        sensor.linearised(here.machine.sensors, axes),
    )
    k_i = np.concatenate(
        [
            magnet.linearised(b, here.point.bias_current).force_per_current
            for b in here.machine.bearings
        ]
    )
    inputs = found[0].inputs
    outputs = found[0].outputs
    n = found[0].n
    magnets, seen = (
        [inputs.index(f"f_{a}") for a in axes],
        found[0].C[[outputs.index(f"s_{a}") for a in axes]],
    )
    x, y = (inputs.index(f"f_piston_{d}") for d in "xy")
    ends = np.cumsum([n, n, power.n_states, sensed.n_states])
    rate, U = (HIGH - LOW) / RUN_UP.duration, 1e-4

    def slope(t: float, state: np.ndarray) -> np.ndarray:
        W = LOW + rate * t
        q, v, a, s, k = np.split(state, ends)
        measured = sensed.C @ s + sensed.D @ (seen @ q)
        u = K.C @ k - K.D @ measured
        turning = U * (W**2 - 1j * rate) * np.exp(1j * (LOW * t + rate * t**2 / 2))
        f = np.zeros(len(inputs))
        f[x], f[y] = turning.real, turning.imag
        f[magnets] += k_i * (power.C @ a + power.D @ u)
        bend = spline["B"](W) @ f - spline["K"](W) @ q - spline["D"](W) @ v
        return np.concatenate(
            [
                v,
                bend,
                power.A @ a + power.B @ u,
                sensed.A @ s + sensed.B @ (seen @ q),
                K.A @ k - K.B @ measured,
            ]
        )

    t = np.arange(round(RUN_UP.duration / DT) + 1) * DT
    solution = solve_ivp(
        slope, (0, t[-1]), np.zeros(ends[-1] + K.n_states), "DOP853", t, rtol=1e-6, atol=1e-13
    )
    return found[0].C[[outputs.index(name) for name in OUTPUTS]] @ solution.y[:n]


def error(trace, exact: np.ndarray) -> float:
    return float(np.abs(trace.record.select(OUTPUTS).values - exact).max() / np.abs(exact).max())


@pytest.mark.parametrize("kind", ["gas", "table"])
def test_spin_up_of_a_seal_that_changes_with_speed(kind):
    trace = spin_up(
        assemble(machine(kind), at(kind, LOW).point), controller(kind), RUN_UP, bending_modes=1
    )
    assert trace.outcome == "completed" and trace.speed_error < 1e-3
    assert error(trace, runge_kutta(kind, 1)) < 1e-3


@pytest.mark.study
def test_full_plants_assembled_at_every_speed_may_be_run_up():
    """All modes of the coarse shaft, no reduction and no interpolation: ``assemble`` itself keeps
    the states.
    """
    first = assemble(machine("coarse"), at("coarse", LOW).point)
    assert first.rotor.n_states == 24

    def loop_at(speed):
        return closed_loop(
            assemble(machine("coarse"), at("coarse", speed).point), controller("coarse")
        )

    trace = linear.run(loop_at, RUN_UP, outputs=OUTPUTS)
    assert error(trace, runge_kutta("coarse", 4)) < 2 * trace.speed_error < 2e-3


def _own_scales(speed):
    """The coarse plant with its states scaled and normalised by its own matrices, as it was
    once.
    """
    here = at("coarse", speed)
    rotor = to_statespace(
        attached_rotor(here.machine, here.point, finite_element_rotor(here.machine)), speed
    )
    return closed_loop(wire(here.machine, here.point, rotor), controller("coarse"))


@pytest.mark.study
def test_states_scaled_by_the_stiffness_of_the_moment_are_refused(monkeypatch):
    with pytest.raises(
        InvalidInput,
        match=r"the states of the loop is others at .* than at 60 rad/s .*free_mode_reduction",
    ):
        linear.run(_own_scales, RUN_UP, outputs=OUTPUTS)
    # why: the answer is wrong, and the error estimate does not see it
    monkeypatch.setattr(linear, "_SAME_STATES", np.inf)
    monkeypatch.setattr(linear, "_MOST", 256)
    trace = linear.run(_own_scales, RUN_UP, outputs=OUTPUTS)
    assert error(trace, runge_kutta("coarse", 4)) > 0.01 > 5 * trace.speed_error


def test_plants_reduced_in_a_basis_of_their_own_are_refused():
    with pytest.raises(InvalidInput, match="reduce has a basis of its own"):
        linear.run(lambda speed: closed_loop(reduce(at("gas", speed)), controller("gas")), RUN_UP)


def test_loops_of_different_size_are_refused():
    def loop_at(speed):
        return closed_loop(
            free_mode_reduction(at("gas", speed), 1 if speed < 1000 else 2), controller("gas")
        )

    with pytest.raises(
        InvalidInput, match=r"n_states of the loop at 1430 rad/s is \d+, but must be as at 60 rad/s"
    ):
        linear.run(loop_at, RUN_UP)


def test_bending_modes_of_a_spin_up():
    """What two modes lack is static flexibility; with the twelve of the default nothing of it is
    left to see.
    """
    plant = assemble(machine("table"), at("table", LOW).point)
    exact = (
        spin_up(plant, controller("table"), RUN_UP, bending_modes=20).record.select(OUTPUTS).values
    )
    assert error(spin_up(plant, controller("table"), RUN_UP, bending_modes=2), exact) > 5e-3
    assert error(spin_up(plant, controller("table"), RUN_UP), exact) < 1e-3
    # a mesh with fewer modes
    spin_up(assemble(machine("coarse")), controller("coarse"), replace(RUN_UP, duration=0.02))


def test_poles_of_a_seal_with_states_are_common_to_all_speeds():
    """Fitted at each speed, two real poles become a pair between 1500 and 2200 rad/s and their
    states change places.
    """
    given = machine("gas")
    item = given.seals[0]
    moving = replace(
        item, frequency_dependence="states", poles=5, geometry=replace(item.geometry, speed=None)
    )
    own = replace(given, seals=(moving,))
    dynamics = [
        assemble(own, at("gas", speed).point).rotor.A[-10:, -10:] for speed in (1500.0, 2200.0)
    ]
    np.testing.assert_array_equal(dynamics[0], dynamics[1])


def test_the_linear_simulation_of_a_run_up_changes_the_plant_with_the_speed():
    short = replace(RUN_UP, duration=0.05, pulses=(Pulse("f_A_zeta", 50.0, 0.01),))
    plant = assemble(machine("table"), at("table", 900.0).point)
    found = simulate_linear(plant, controller("table"), short)
    np.testing.assert_array_equal(
        found.record.values, spin_up(plant, controller("table"), short).record.values
    )
    held = linear.run(closed_loop(plant, controller("table")), short)
    assert error(held, found.record.select(OUTPUTS).values) > 0.01


def test_states_that_differ_over_pressure_are_told_in_pascal():
    loops = [StateSpace([[-1.0]], [[1.0]], [[c]], [[0.0]], ["d_x"], ["q_x"]) for c in (1.0, 1.5)]
    with pytest.raises(InvalidInput, match=r"others at 300000 than at 1000 Pa \(q_x reads"):
        linear._check_same_states([(1e3, loops[0]), (3e5, loops[1])], ["q_x"], "Pa")
