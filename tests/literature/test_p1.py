"""P1 (Youla residual of the turboexpander at 31,500 rpm): `pytest tests/literature/test_p1.py -s`
prints the figures.
"""

from functools import cache

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import close_uncertainty
from ambrose.core.matrix_equations import balanced_realization
from ambrose.core.realisation import (
    coprime_factors,
    injection_gain,
    observer_controller,
    residual_system,
)
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, connect, feedback, poles, select, spectral_abscissa
from ambrose.identification import youla
from ambrose.identification.output_error import closed_loop as whole_loop
from ambrose.identification.youla import uncertain_residual
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Tolerance
from ambrose.machine.parameters import operating_point
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction, perturbed, reduce
from ambrose.record.record import Record

pytestmark = [pytest.mark.literature, pytest.mark.study]
B_Y = "bearing.B.negative_stiffness.eta"  # the bearing's y axis: its angle is zero
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
U, Y = [f"u_{a}" for a in AXES], [f"y_{a}" for a in AXES]
# a stiffness reduction of 50 %; 0.5 s at 1 ms
THETA = 0.5
DT = 1e-3
SAMPLES = 500


@cache
def machine():
    return load_machine("turboexpander")


@cache
def plants():
    """The full finite-element plant (320 rotor states) and the one of the 8 rigid-body states."""
    full = assemble(
        machine(), operating_point(machine(), "nominal speed without seal"), every_mode=True
    )
    return full, free_mode_reduction(full, 0)


@cache
def moved(full, theta):
    plant = plants()[0 if full else 1]
    return select(perturbed(plant, {B_Y: -theta}, [Tolerance(B_Y, relative=1.0)]).system, U, Y)


@cache
def nominal():
    return select(plants()[1].system, U, Y)


@cache
def gains(decay=0.0):
    G = nominal()
    return injection_gain(G.A.T, G.B.T, None, decay)[0].T, injection_gain(G.A, G.C, None, decay)[0]


@cache
def factors(decay=0.0):
    F, L = gains(decay)
    return coprime_factors(nominal(), observer_controller(nominal(), F, L), L, -nominal().B)


def luenberger_loop(plant, decay=0.0):
    """P1's experiment, written out: the plant, the observer, v = F x^ + eta, eps = y - C x^; eta
    and d enter, eps leaves.
    """
    G, (F, L) = nominal(), gains(decay)
    observer = StateSpace(
        G.A + L @ G.C,
        np.hstack([G.B, -L]),
        np.vstack([F, -G.C]),
        np.zeros((8, 8)),
        [f"{kind}_{a}" for kind in ("v", "s") for a in AXES],
        [f"{kind}_{a}" for kind in ("x", "c") for a in AXES],
    )
    command = {f"{kind}_{a}": [f"x_{a}", f"eta_{a}"] for kind in "uv" for a in AXES}
    return connect(
        [plant, observer],
        inputs=[f"{kind}_{a}" for kind in ("eta", "d") for a in AXES],
        outputs=[f"eps_{a}" for a in AXES],
        sums={
            **command,
            **{f"s_{a}": [f"y_{a}", f"d_{a}"] for a in AXES},
            **{f"eps_{a}": [f"c_{a}", f"y_{a}", f"d_{a}"] for a in AXES},
        },
    )


ETA, D = [f"eta_{a}" for a in AXES], [f"d_{a}" for a in AXES]


def binary(samples, amplitude=0.1, seed=1):
    return amplitude * np.sign(np.random.default_rng(seed).standard_normal((4, samples)))


def identified(eta, eps, dt=DT, decay=0.0, **options):
    found = youla.identify_injected(plants()[1], factors(decay), [B_Y], eta, eps, dt, **options)
    stiffness = machine().bearings[1].negative_stiffness[1]
    return 1 - found.values[0] / stiffness, found.standard_deviations[0] / stiffness, found


def test_P1_1_bending_modes_that_it_takes_to_follow_to_the_printed_frequency():
    """Printed: 8 states follow to 2e4 rad/s. On a shaft that bends at 1 kHz it takes 8 + 4 states
    per mode below.
    """
    full = plants()[0]
    omega = np.geomspace(10, 1e5, 300)
    signals = [f"f_{a}" for a in AXES], [f"s_{a}" for a in AXES]
    largest = np.linalg.svd(
        frequency_response(select(full.rotor, *signals), omega).values, compute_uv=False
    )[:, 0]
    reached = []
    for modes in range(4):
        small = select(reduce(full, modes).rotor, *signals)
        values = np.linalg.svd(frequency_response(small, omega).values, compute_uv=False)[:, 0]
        reached.append(float(omega[np.argmax(np.abs(values / largest - 1) > 0.1)]))
    print(
        f"\nP1.1: largest singular value within 10 % up to {np.round(reached, -2)} rad/s with 0, "
        "1, 2, 3 bending modes"
    )
    assert full.rotor.n_states == 320
    assert reached[0] < 6.3e3 < reached[1]
    assert reached[-1] > 2e4


def pid_factors():
    K = pid_controller(machine().controller, machine())
    K = StateSpace(K.A, -K.B, K.C, -K.D, Y, U)
    return coprime_factors(nominal(), K, None, injection_gain(K.A, K.C, None, 10.0)[0])


@pytest.mark.parametrize("kind", ["observer", "pid"])
def test_P1_2_right_half_plane_poles_in_G_and_none_in_S(kind):
    """S(theta) is stable for every theta that the controller holds, and for no other; as LFT (13)
    and as interconnection.
    """
    f = factors() if kind == "observer" else pid_factors()
    lft = uncertain_residual(plants()[1], f, [B_Y])
    stiffness = machine().bearings[1].negative_stiffness[1]
    omega, held = np.array([0.0, 300.0, 2e3]), {}
    for theta in (-3.0, -1.0, -0.3, -0.1, 0.2, THETA, 0.8):
        G = moved(False, theta)
        S = residual_system(f, G)
        assert (poles(G).real > 0).sum() == 4
        held[theta] = spectral_abscissa(S) < 0
        assert held[theta] == (spectral_abscissa(feedback(G, f.controller, sign=1)) < 0)
        by_lft = frequency_response(close_uncertainty(lft, {B_Y: -theta * stiffness}), omega).values
        direct = frequency_response(S, omega).values
        assert np.abs(by_lft - direct).max() < 1e-8 * np.abs(direct).max()
    S = residual_system(f, moved(False, THETA))
    hankel = balanced_realization(S)[1]
    order = int((hankel > 1e-10 * hankel[0]).sum())
    unstable = poles(moved(False, THETA))
    print(
        f"\nP1.2: G has {np.round(unstable[unstable.real > 0], 0)} rad/s; S ({kind}): "
        f"{S.n_states} states, {order} minimal,"
    )
    print(
        f"rightmost {spectral_abscissa(S):.1f} rad/s; stable at theta = "
        f"{[theta for theta, yes in held.items() if yes]}"
    )
    assert all(held[theta] for theta in (-0.1, 0.2, THETA, 0.8)) and not held[-3.0]
    # the full machine, bending modes included
    assert spectral_abscissa(residual_system(f, moved(True, THETA))) < 0
    rank = np.linalg.svd(frequency_response(S, omega).values, compute_uv=False)
    # one parameter, one direction: S has the rank 1 and no finite zero
    assert (rank[:, 1] < 1e-8 * rank[:, 0]).all()


def test_P1_3_exact_without_noise_and_what_unmodelled_bending_does():
    """Printed: theta = 0.5 is found as 0.502, from 0.5 s of random binary signal at 1 ms."""
    eta = binary(SAMPLES)
    exact, _, found = identified(
        eta, simulate(select(luenberger_loop(moved(False, THETA)), ETA), eta, DT)
    )
    assert exact == pytest.approx(THETA, abs=1e-7) and found.converged
    whole, _, found = identified(
        eta, simulate(select(luenberger_loop(moved(True, THETA)), ETA), eta, DT)
    )
    print(
        f"\nP1.3: noise-free {exact:.6f}; record of the 320-state machine {whole:.4f} (fit "
        f"{found.fit[3][2]:.0f} % in B_y)"
    )
    assert whole == pytest.approx(THETA, abs=0.005)
    for start in (1.1, 0.8, 0.4, 0.0, -0.5):  # of the nominal stiffness
        stiffness = start * machine().bearings[1].negative_stiffness[1]
        again, _, _ = identified(
            eta,
            simulate(select(luenberger_loop(moved(False, THETA)), ETA), eta, DT),
            start={B_Y: stiffness},
        )
        assert again == pytest.approx(THETA, abs=1e-6), start


@pytest.mark.parametrize(("dt", "amplitude", "runs"), [(1e-3, 0.1, 150), (1e-4, 0.3, 100)])
def test_P1_3_scatter_with_noise(dt, amplitude, runs):
    """1 um (rms) of white sensor noise at 10 kHz: the predicted deviation is the scatter."""
    every = round(dt / 1e-4)
    loop = luenberger_loop(moved(False, THETA))
    eta = binary(round(0.5 / dt), amplitude)
    clean = simulate(select(loop, ETA), eta, dt)
    noisy = select(loop, D)
    found, predicted = [], []
    for seed in range(runs):
        noise = 1e-6 * np.random.default_rng([2, seed]).standard_normal((4, 5000))
        value, deviation, _ = identified(eta, clean + simulate(noisy, noise, 1e-4)[:, ::every], dt)
        found.append(value)
        predicted.append(deviation)
    scatter = np.std(found, ddof=1)
    ratio = np.sqrt(np.mean(np.square(predicted))) / scatter
    print(
        f"\nP1.3: {dt:g} s, {amplitude} A: {np.mean(found):.4f} +- {scatter:.4f} (predicted "
        f"{ratio * scatter:.4f})"
    )
    assert abs(np.mean(found) - THETA) < 3.5 * scatter / np.sqrt(runs)
    assert 0.8 < ratio < 1.2


def test_P1_3_the_observer_decides_what_the_experiment_is_worth():
    """Predicted deviation of theta for observers (and state feedbacks) that move all poles to the
    left of -decay.
    """
    eta, noise = (
        binary(SAMPLES),
        1e-6 * np.random.default_rng([4, 0]).standard_normal((4, 10 * SAMPLES)),
    )
    deviations = {}
    for decay in (0.0, 200.0, 400.0):
        loop = luenberger_loop(moved(False, THETA), decay)
        eps = (
            simulate(select(loop, ETA), eta, DT)
            + simulate(select(loop, D), noise, DT / 10)[:, ::10]
        )
        deviations[decay] = identified(eta, eps, decay=decay)[1]
    print(
        "\nP1.3: deviation "
        + ", ".join(f"{value:.3f} (decay {decay:g} rad/s)" for decay, value in deviations.items())
    )
    assert deviations[0.0] < 0.06
    assert deviations[400.0] > 2 * deviations[200.0] > 6 * deviations[0.0]


def test_bending_modes_left_out_bias_the_residual_less_than_the_whole_loop():
    """The 320-state machine under its PID, 40 kHz, 0.5 s, without noise; identified with 8 and with
    16 rotor states.
    """
    dt, samples = 2.5e-5, 20000
    law = c2d(pid_controller(machine().controller, machine()), dt, "tustin")
    plant = perturbed(plants()[0], {B_Y: -THETA}, [Tolerance(B_Y, relative=1.0)])
    e = np.repeat(binary(samples // 40, 0.3), 40, axis=1)
    names = [f"e_{a}" for a in AXES]
    record = Record(
        "turboexpander",
        1 / dt,
        (*Y, *U, *names),
        ("m",) * 4 + ("A",) * 8,
        np.vstack([simulate(select(closed_loop(plant, law), names, Y + U), e), e]),
        plant.point,
    )
    stiffness, found = machine().bearings[1].negative_stiffness[1], {}
    for modes in (0, 2):
        one = youla.identify(
            machine(), record, law, [B_Y], bending_modes=modes, computing_delay=0
        ).estimate
        other = whole_loop.identify(
            machine(), record, law, [B_Y], bending_modes=modes, computing_delay=0
        )
        found[modes] = 1 - one.values[0] / stiffness, 1 - other.values[0] / stiffness
    print(
        "\n"
        + "; ".join(
            f"{modes} bending modes: Youla {a:.4f}, whole loop {b:.4f}"
            for modes, (a, b) in found.items()
        )
    )
    assert abs(found[0][0] - THETA) < 0.004
    assert abs(found[0][1] - THETA) > 0.01
    assert np.abs(np.array(found[2]) - THETA).max() < 0.001
