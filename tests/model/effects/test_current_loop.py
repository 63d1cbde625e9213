"""The amplifier as a circuit, against a simulation of two coils written here: flux linkages

l = N^2 mu_0 A i/(2 (s_0 -+ x)),  v = R i + l',  F = sum of +- l i/(2 (s_0 -+ x)),

each coil under a PI controller of its own. Nothing of it is Ambrose's but the figures.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.machine.description import Amplifier, Tolerance
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.model.assemble import assemble
from ambrose.model.effects.amplifier import derivative, linearised, parameters
from ambrose.model.uncertainty import perturbed
from ambrose.rig.engine.equilibrium import linear_view, slope, state_at_rest
from ambrose.rig.engine.inputs import stretch
from ambrose.rig.engine.state import build
from ambrose.rig.scenario import Scenario
from ambrose.rig.virtual_rig import plan

MU_0 = 4e-7 * math.pi
TURNS, AREA, GAP, BIAS = 150.0, 4e-4, 0.5e-3, 3.0
L_0 = TURNS**2 * MU_0 * AREA / (2 * GAP)
R = 4.0
LOOP = Amplifier("current-loop", bandwidth=5000.0, inductance=L_0, resistance=R)
# of the pair at its centre: f = L_0 s_0/2 (i_1^2/s_1^2 - i_2^2/s_2^2)
K_I, K_S = 2 * L_0 * BIAS / GAP, 2 * L_0 * BIAS**2 / GAP**2


def circuit(omega, size=2e-5 * GAP):
    """Force per displacement of two coils under imposed motion, first harmonic, u = 0."""
    c, w = TURNS**2 * MU_0 * AREA / 2, LOOP.bandwidth

    def slopes(t, state):
        linkage, integral = state[:2], state[2:]
        gaps = GAP - np.array([1.0, -1.0]) * size * math.sin(omega * t)
        error = BIAS - linkage * gaps / c
        volts = w * L_0 * error + w * R * integral
        return [*(volts - R * linkage * gaps / c), *error]

    period = 2 * math.pi / omega
    begin = period * math.ceil(22 / (R / L_0) / period)
    t = begin + np.arange(64) * period / 64
    start = [c * BIAS / GAP] * 2 + [BIAS / w] * 2
    found = solve_ivp(
        slopes, (0, t[-1]), start, t_eval=t, method="DOP853", rtol=1e-12, atol=1e-13
    ).y
    # l i/(2 s) = l^2/(2 c) whatever the gap
    force = (found[0] ** 2 - found[1] ** 2) / (2 * c)
    return 2j * np.mean(force * np.exp(-1j * omega * t)) / size


@pytest.mark.parametrize("omega", [400.0, 2000.0, 9000.0])
def test_negative_stiffness_through_the_loop_is_that_of_the_circuit(omega):
    assert K_I**2 / (2 * L_0) == pytest.approx(K_S)  # a coil without leakage
    system = linearised(LOOP, ["a"], [K_I])
    assert system.inputs == ("u_a", "qdot_a")
    s = 1j * omega
    current = (system.C @ np.linalg.solve(s * np.eye(2) - system.A, system.B[:, 1:])).item()
    ours = K_S + K_I * current * s
    assert abs(ours - K_S) > 0.05 * K_S  # the loop does something
    assert abs(circuit(omega) - ours) < 1e-6 * K_S


def test_command_sees_a_first_order_lag_and_standstill_a_pole_that_cancels():
    system = linearised(LOOP, ["a"])
    for omega in (10.0, 5e3, 5e4):
        s = 1j * omega
        got = (system.C @ np.linalg.solve(s * np.eye(2) - system.A, system.B)).item()
        assert got == pytest.approx(LOOP.bandwidth / (s + LOOP.bandwidth), rel=1e-12)


def test_voltage_is_cut_at_what_the_bias_leaves():
    """Far from the command: L i' + R i = V - R i_0, in closed form, and no winding up after it."""
    volts = 60.0
    p = parameters(replace(LOOP, max_voltage=volts), None, BIAS, K_I)
    left = volts - R * BIAS
    end = 4e-3
    found = solve_ivp(
        lambda t, s: derivative(12.0, *s, p), (0, end), [0.0, 0.0], rtol=1e-10, atol=1e-12
    )
    # until w (u - i) = left/L the voltage is at its limit
    expected = left / R * (1 - np.exp(-R / L_0 * found.t))
    early = LOOP.bandwidth * (12.0 - expected) > 1.05 * left / L_0
    assert early.sum() > 5
    assert found.y[0][early] == pytest.approx(expected[early], abs=1e-7)
    assert found.y[0].max() < 12.0 * (1 + 1e-3)
    # motion against the voltage: i' = ... - k_i/(2 L) x'
    still, moving = (derivative(0.0, 0.0, 0.0, p, v)[0] for v in (0.0, 0.1))
    assert moving - still == pytest.approx(-0.1 * K_I / (2 * L_0), rel=1e-12)
    assert derivative(12.0, 0.0, 0.0, p)[1] == 0.0
    assert derivative(-12.0, 1.0, 0.0, p)[1] == 0.0


@pytest.fixture(scope="module")
def machine():
    pump = load_machine("turbomolecular-pump")
    drive = replace(
        pump.amplifier, order="current-loop", bandwidth=9000.0, inductance=20e-3, resistance=2.0
    )
    return replace(pump, amplifier=drive, gravity_direction=None, tolerances=())


def test_the_rig_turns_into_the_plant(machine):
    rig = build(machine, bending_modes=1)
    task = plan(rig, Scenario("still", 0.01, speed=machine.operation.nominal.speed), 1e-4, 0)
    u = np.zeros(len(machine.axes))
    A, _ = linear_view(
        rig, stretch(task, 0, 2), state_at_rest(rig, np.zeros(rig.coordinates), u), u
    )
    rows = np.linalg.eigvals(A)
    plant = assemble(machine)
    poles = np.linalg.eigvals(plant.system.A)
    slow = poles[abs(poles) < 3000]
    assert len(slow) >= 8
    bare = replace(machine, amplifier=Amplifier("first", bandwidth=9000.0))
    unlike = np.linalg.eigvals(assemble(bare).system.A)
    for pole in slow:
        assert abs(rows - pole).min() < 3e-3 * abs(pole)
    unstable = poles[poles.real > 1]
    # the circuit takes of the negative stiffness: all unstable poles are slower
    assert unstable.real.max() < 0.995 * unlike.real.max()


def test_the_rig_cuts_the_voltage_and_feels_the_motion(machine):
    """L i' = +-(V - R i_0) - R i - k_i/2 x' far from the command; within the limit, w (u - i)."""
    drive = replace(machine.amplifier, max_voltage=60.0)
    bearings = tuple(replace(b, max_current=None) for b in machine.bearings)
    rig = build(replace(machine, amplifier=drive, bearings=bearings), bending_modes=0)
    task = plan(rig, Scenario("still", 0.01), 1e-4, 0)
    n, count = rig.coordinates, len(rig.axes)
    z = state_at_rest(rig, np.zeros(n), np.zeros(count))
    L, bias = drive.inductance, rig.constants.magnet[0, 0]
    left = 60.0 - drive.resistance * bias
    for u, expected in ((50.0, left / L), (-50.0, -left / L), (1e-3, 9000.0 * 1e-3)):
        rate = slope(rig, stretch(task, 0, 2), z, np.full(count, u))[2 * n : 2 * n + 2]
        assert rate[0] == pytest.approx(expected, rel=1e-9)
        assert rate[1] == pytest.approx(0.0 if abs(u) > 1 else expected, rel=1e-9)
    # a velocity of the first mode moves the current by -k_u/L of what the bearing sees of it
    z[n] = 0.02
    rate = slope(rig, stretch(task, 0, 2), z, np.zeros(count))[2 * n]
    cosine, shape = rig.constants.direction[0, 0], rig.constants.shape[0, 0]
    k_i = machine.bearings[0].force_per_current[0]
    assert rate == pytest.approx(-k_i / (2 * L) * cosine * shape * 0.02, rel=1e-9)


@pytest.mark.parametrize(
    ("path", "change"),
    [
        (
            "bearing.{}.force_per_current",
            lambda m, f: replace(
                m,
                bearings=(
                    replace(
                        m.bearings[0],
                        force_per_current=tuple(
                            f * value for value in m.bearings[0].force_per_current
                        ),
                    ),
                    *m.bearings[1:],
                ),
            ),
        ),
        (
            "amplifier.bandwidth",
            lambda m, f: replace(
                m, amplifier=replace(m.amplifier, bandwidth=f * m.amplifier.bandwidth)
            ),
        ),
    ],
)
def test_a_block_is_the_changed_machine(machine, path, change):
    path = path.format(machine.bearings[0].name)
    ours = perturbed(assemble(machine), {path: -1.0}, [Tolerance(path, relative=0.2)]).system
    theirs = assemble(change(machine, 0.8)).system
    for omega in (50.0, 900.0, 6000.0):
        answers = [
            system.C @ np.linalg.solve(1j * omega * np.eye(system.n_states) - system.A, system.B)
            for system in (ours, theirs)
        ]
        scale = np.abs(answers[1]).max()
        assert np.abs(answers[0] - answers[1]).max() < 1e-9 * scale


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ('order = "current-loop"\nbandwidth = "2 kHz"', "resistance is missing"),
        ('order = "first"\nbandwidth = "2 kHz"\nresistance = "1 Ohm"', "does not use it"),
        (
            'order = "current-loop"\nbandwidth = "2 kHz"\nresistance = "9 Ohm"\n'
            'inductance = "20 mH"\nmax_voltage = "2 V"',
            "alone takes",
        ),
    ],
)
def test_a_wrong_circuit_is_refused(rows, words):
    text = dumps_machine(load_machine("two-disc-rotor"))
    head, _, rest = text.partition("[amplifier]\n")
    tail = rest[rest.index("\n[") :] if "\n[" in rest else ""
    with pytest.raises(InvalidInput, match=words):
        loads_machine(f"{head}[amplifier]\n{rows}\n{tail}", "two-disc-rotor")
