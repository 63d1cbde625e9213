"""Delays that are no whole number of samples: their model, its derivative, and what records tell
about them.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla
from benchmarks import waveforms

from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.identification.output_error.closed_loop import identify
from ambrose.identification.output_error.loop_model import AHEAD, loop_model, timed
from ambrose.identification.parameters import expand, nominal_values, update_machine
from ambrose.machine.parameters import CONTROLLER_DELAY, EXCITATION_DELAY
from ambrose.record.record import Record
from linear_rig import AXES, DT, E, Y, rig
from whole_records import simulate_derivative

KNOWN = ("bearing.A.negative_stiffness.zeta", "seal.center.k", "amplifier.natural_frequency")


def model(paths, delay, unknown):
    machine, plant, _, law = rig()
    paths = expand(machine, paths) if paths else ()
    return timed(loop_model(plant, law, paths, nominal_values(plant, paths), E, Y), delay, unknown)


def sequences(k):
    return np.stack([0.1 * waveforms.prbs(9, 10, k, shift=127 * i) for i in range(4)])


def finely(e, delay, late=0.0, parts=10):
    """y (4, k) of the loop stepped ``parts`` times per sample: the command acts ``delay`` samples
    late, e ``late`` samples.
    """
    _, plant, _, law = rig()
    fine = c2d(plant.system, DT / parts)
    u_in, y_out = [fine.inputs.index(f"u_{a}") for a in AXES], [fine.outputs.index(y) for y in Y]
    B, C = fine.B[:, u_in], fine.C[y_out]
    k = e.shape[1]
    steps = round(delay * parts)
    lag = round(late * parts)
    total = k * parts
    command, wave = np.zeros((4, total + steps + parts)), np.zeros((4, total))
    held = np.repeat(e, parts, axis=1)
    wave[:, max(lag, 0) : total + min(lag, 0)] = held[:, max(-lag, 0) : total - max(lag, 0)]
    x = np.zeros(len(fine.A))
    z = np.zeros(law.n_states)
    shown = np.zeros((4, k))
    for t in range(total):
        if t % parts == 0:
            shown[:, t // parts] = y = C @ x
            command[:, t + steps : t + steps + parts] = (law.C @ z - law.D @ y)[:, None]
            z = law.A @ z - law.B @ y
        x = fine.A @ x + B @ (command[:, t] + wave[:, t])
    return shown


@pytest.mark.parametrize(
    ("delay", "late"),
    [(0.0, 0.0), (1.0, 0.0), (0.3, 0.0), (1.7, 0.0), (1.2, 0.4), (2.0, -0.6), (0.5, 1.3)],
)
def test_the_model_is_the_loop_stepped_finely(delay, late):
    e = sequences(200)
    unknown = (CONTROLLER_DELAY, EXCITATION_DELAY) if late else (CONTROLLER_DELAY,)
    loop, _ = model((), delay, unknown).loop(np.array([delay * DT, late * DT])[: len(unknown)])
    ahead = AHEAD if late else 0
    x0 = np.zeros(loop.n_states)
    if ahead:  # the first two samples, which the signals given early have passed already
        x0[-4 * (AHEAD + 3) :][:8] = np.concatenate([e[:, 1], e[:, 0]])
    expected = finely(e, delay, late)
    found = simulate(loop, np.pad(e, ((0, 0), (0, ahead)))[:, ahead:], x0=x0)
    np.testing.assert_allclose(
        found[:, :190], expected[:, :190], rtol=0, atol=1e-9 * np.abs(expected).max()
    )


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 1.6])
def test_jacobian_against_complex_step(delay):
    made = model(KNOWN, delay, (CONTROLLER_DELAY, EXCITATION_DELAY))
    inner, law = made.inner, made.inner.controller
    theta, e = np.append(inner.theta0, [delay * DT, 0.3 * DT]), sequences(150)
    loop, directions = made.loop(theta)
    y, J = simulate_derivative(loop, directions, e)
    d, d_e = int(np.floor(delay + 1e-9)), AHEAD

    def held(A, B, t):
        n, m = B.shape
        both = sla.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * t)
        return both[:n, :n], both[:n, n:]

    # an independent recursion in complex numbers, with old commands and excitations in a list
    def outputs(theta):
        A, B, *_ = inner.plant(theta[:-2])
        Phi, Gamma = held(A, B, DT)
        late = [held(A, B, DT - tau)[1] for tau in (theta[-2] - d * DT, theta[-1])]
        x = np.zeros(len(A), complex)
        z = np.zeros(law.n_states, complex)
        shown = []
        sent, waves = [np.zeros(4)] * 9, [np.zeros(4)] * 9
        for now in e.T:
            out = inner.C[:4] @ x
            shown.append(out)
            sent, waves = [law.C @ z - law.D @ out, *sent], [now, *waves]
            x = Phi @ x + late[0][:, :4] @ sent[d] + (Gamma - late[0])[:, :4] @ sent[d + 1]
            x = x + late[1][:, 4:] @ waves[d_e] + (Gamma - late[1])[:, 4:] @ waves[d_e + 1]
            z = law.A @ z - law.B @ out
        return np.array(shown).T

    np.testing.assert_allclose(outputs(theta + 0j).real, y, rtol=0, atol=1e-11 * np.abs(y).max())
    for j, size in enumerate([*inner.theta0, DT, DT]):
        step = np.zeros(len(theta), complex)
        step[j] = 1e-30j * size
        exact = outputs(theta + step).imag / (1e-30 * size)
        np.testing.assert_allclose(J[j], exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def record(e, delay, late=0.0, noise=0.0, seed=0):
    _, plant, *_ = rig()
    y = finely(e, delay, late)
    y = y + noise * np.random.default_rng(seed).standard_normal(y.shape)
    return Record(
        "seal-rig", 1 / DT, (*Y, *E), ("m",) * 4 + ("A",) * 4, np.vstack([y, e]), plant.point
    )


@pytest.mark.parametrize(("delay", "begin"), [(1.4, 1), (2.0, 1), (2.3, 1), (0.6, 1.8)])
def test_a_delay_is_found_beside_the_machine(delay, begin):
    machine, plant, controller, _ = rig()
    found = identify(
        machine,
        record(sequences(2000), delay),
        controller,
        (*KNOWN, "delay"),
        bending_modes=0,
        computing_delay=begin,
    )
    nominal = np.append(nominal_values(plant, KNOWN), delay * DT)
    assert found.paths[-1] == CONTROLLER_DELAY
    np.testing.assert_allclose(found.values, nominal, rtol=1e-6)
    assert found.converged and not found.warnings
    updated = update_machine(machine, found)
    assert updated.controller.delay == found.values[-1]
    assert [tolerance.parameter for tolerance in updated.tolerances] == [
        "seal.center.pressure",
        *KNOWN,
    ]


@pytest.mark.parametrize("late", [-1.0, 1.0, 0.7])
def test_a_mistimed_excitation_is_found(late):
    machine, plant, controller, _ = rig()
    data = record(sequences(1500), 1.0, late)
    found = identify(machine, data, controller, (*KNOWN, EXCITATION_DELAY), bending_modes=0)
    np.testing.assert_allclose(found.values[-1], late * DT, rtol=1e-6)
    np.testing.assert_allclose(found.values[:-1], nominal_values(plant, KNOWN), rtol=1e-6)


@pytest.mark.study
def test_deviation_of_the_delay_against_monte_carlo():
    machine, _, controller, _ = rig()
    clean = record(sequences(1200), 1.3)
    values, predicted = [], []
    for seed in range(50):
        noise = 1e-7 * np.random.default_rng(seed).standard_normal((4, 1200))
        data = replace(clean, values=np.vstack([clean.values[:4] + noise, clean.values[4:]]))
        found = identify(
            machine,
            data,
            controller,
            (KNOWN[0], CONTROLLER_DELAY),
            bending_modes=0,
            computing_delay=1.3,
        )
        values.append(found.values)
        predicted.append(found.standard_deviations)
    scatter = np.std(values, axis=0, ddof=1)
    ratio = np.sqrt(np.mean(np.square(predicted), axis=0)) / scatter
    assert ((ratio > 0.8) & (ratio < 1.2)).all(), ratio


def test_a_known_fraction_and_the_delay_alone():
    machine, plant, controller, _ = rig()
    data = record(sequences(1500), 1.4)
    found = identify(machine, data, controller, KNOWN, bending_modes=0, computing_delay=1.4)
    np.testing.assert_allclose(found.values, nominal_values(plant, KNOWN), rtol=1e-6)
    alone = identify(machine, data, controller, ["controller.delay"], bending_modes=0)
    np.testing.assert_allclose(alone.values, 1.4 * DT, rtol=1e-6)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"signals": ["y_A_zeta", "u_A_zeta"]}, "instant is not a whole sample"),
        ({"unknown": ["delay", "controller.delay"]}, "named twice"),
        ({"unknown": ["excitation.delay"], "initial_state": False}, "initial_state"),
        ({"computing_delay": 21}, "computing_delay"),
    ],
)
def test_bad_input(change, words):
    machine, _, controller, _ = rig()
    data = record(sequences(300), 1.0)
    data = replace(
        data,
        signals=(*data.signals, "u_A_zeta"),
        units=(*data.units, "A"),
        values=np.vstack([data.values, data.values[-1:]]),
    )
    arguments = {"unknown": ["delay"], "bending_modes": 0, **change}
    with pytest.raises(InvalidInput, match=words):
        identify(machine, data, controller, **arguments)
