"""The fit over the lines of a periodic excitation, beside the one in time domain."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.linalg as sla
from benchmarks import waveforms
from scipy.signal import lfilter

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.output_error.closed_loop import identify
from ambrose.identification.output_error.periodic import _columns, _rows
from ambrose.identification.parameters import expand, nominal_values
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record

DT, P = 1e-4, 1270
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
Y, E = tuple(f"y_{a}" for a in AXES), tuple(f"e_{a}" for a in AXES)
NINE = (
    "bearing.*.force_per_current.*",
    "bearing.*.negative_stiffness.*",
    "amplifier.natural_frequency",
)


@cache
def rig():
    machine = load_machine("seal-rig")
    plant = free_mode_reduction(assemble(machine), 0)
    controller = pid_synthesis(plant).controller
    return machine, plant, controller, nominal_values(plant, expand(machine, NINE))


@cache
def clean(k=5 * P, skip=0):
    """From rest, or with ``skip`` periods cut off: in steady state."""
    _, plant, controller, _ = rig()
    e = np.stack([0.1 * waveforms.prbs(7, 10, k + skip * P, shift=31 * i) for i in range(4)])
    y = simulate(select(closed_loop(plant, c2d(controller, DT, "tustin", delay=DT)), E, Y), e)
    values = np.vstack([y, e])[:, skip * P :]
    return Record("seal-rig", 1 / DT, (*Y, *E), ("m",) * 4 + ("A",) * 4, values, plant.point)


def noisy(record, seed, size=5e-8):
    noise = lfilter(
        [1.0],
        [1.0, -0.9],
        np.random.default_rng(seed).standard_normal((4, record.values.shape[1])),
        axis=1,
    )
    return replace(record, values=np.vstack([record.values[:4] + size * noise, record.values[4:]]))


@pytest.mark.parametrize("skip", [0, 3])
@pytest.mark.parametrize("period", ["auto", P * DT])
def test_parameters_without_noise_from_rest_and_in_steady_state(skip, period):
    machine, _, controller, nominal = rig()
    start = dict(
        zip(
            expand(machine, NINE),
            nominal * (1 + 0.1 * np.array([1, -1, 1, -1, -1, 1, -1, 1, 1])),
            strict=True,
        )
    )
    found = identify(
        machine, clean(skip=skip), controller, NINE, bending_modes=0, start=start, period=period
    )
    np.testing.assert_allclose(found.values, nominal, rtol=1e-6)
    assert (
        found.converged
        and not found.warnings
        and min(percent for *_, percent in found.fit) > 99.999
    )


def test_steady_state_needs_no_transient():
    machine, _, controller, nominal = rig()
    found = identify(
        machine,
        clean(skip=20),
        controller,
        NINE,
        bending_modes=0,
        initial_state=False,
        period="auto",
    )
    np.testing.assert_allclose(found.values, nominal, rtol=1e-6)
    wrong = identify(
        machine, clean(), controller, NINE, bending_modes=0, initial_state=False, period="auto"
    )
    assert np.abs(wrong.values / nominal - 1).max() > 1e-4  # leakage, where there is a transient


def test_agrees_with_time_domain():
    machine, _, controller, nominal = rig()
    record = noisy(clean(), 1)
    lines = identify(machine, record, controller, NINE, bending_modes=0, period="auto")
    time = identify(machine, record, controller, NINE, bending_modes=0)
    assert (np.abs(lines.values - time.values) < 1.5 * time.standard_deviations).all()
    assert (np.abs(lines.values - nominal) < 4 * lines.standard_deviations).all()
    ratio = lines.standard_deviations / time.standard_deviations
    assert ((ratio > 0.75) & (ratio < 1.5)).all(), ratio
    assert all(test.passed for test in lines.tests) and len(lines.tests) == 4


@pytest.mark.study
def test_predicted_deviation_against_monte_carlo():
    machine, _, controller, _ = rig()
    values, predicted = [], []
    for seed in range(60):
        found = identify(
            machine, noisy(clean(), seed), controller, NINE, bending_modes=0, period=P * DT
        )
        values.append(found.values)
        predicted.append(found.standard_deviations)
    scatter = np.std(values, axis=0, ddof=1)
    ratio = np.sqrt(np.mean(np.square(predicted), axis=0)) / scatter
    assert ((ratio > 0.8) & (ratio < 1.2)).all(), ratio


def test_a_wrong_delay_leaves_more_than_the_periods_scatter():
    machine, _, controller, _ = rig()
    record = noisy(clean(), 2)
    wrong = identify(
        machine, record, controller, NINE, bending_modes=0, period="auto", computing_delay=0
    )
    assert not all(test.passed for test in wrong.tests) and "look for a delay" in wrong.verdict
    right = identify(
        machine,
        record,
        controller,
        (*NINE, "delay"),
        bending_modes=0,
        period="auto",
        computing_delay=0,
    )
    assert right.values[-1] == pytest.approx(DT, rel=0.02) and all(
        test.passed for test in right.tests
    )


def test_one_period_is_enough_for_values_but_not_for_tests():
    machine, _, controller, nominal = rig()
    record = noisy(clean(k=P, skip=5), 3)
    found = identify(machine, record, controller, NINE, bending_modes=0, period=P * DT)
    assert not found.tests
    assert (np.abs(found.values - nominal) < 5 * found.standard_deviations).all()


def test_equal_poles_and_pure_delays_are_no_matter():
    rng = np.random.default_rng(0)
    A = np.diag([0.5, 0.5, 0.5, 0.2]) + np.diag([1.0, 1.0, 0.0], 1)  # a Jordan block
    B = rng.standard_normal((4, 2))
    C = rng.standard_normal((3, 4))
    z = np.exp(1j * np.array([0.1, 1.0, 2.0]))
    U = rng.standard_normal((2, 3))
    T, Z = sla.schur(A, output="complex")
    L, X = _rows(T, Z, C, z), _columns(T, Z, B @ U, z)
    for i, at in enumerate(z):
        np.testing.assert_allclose(L[i], C @ np.linalg.inv(at * np.eye(4) - A), rtol=1e-12)
        np.testing.assert_allclose(
            X[:, i], np.linalg.solve(at * np.eye(4) - A, B @ U[:, i]), rtol=1e-12
        )


@pytest.mark.parametrize(
    ("period", "change", "words"),
    [
        (
            "auto",
            lambda v: np.vstack(
                [v[:7], 0.1 * np.random.default_rng(0).choice([-1, 1], v.shape[1])]
            ),
            "does not repeat",
        ),
        (0.05, None, "does not repeat"),
        ("always", None, 'a time in s, or "auto"'),
        (1e-4 * 1270.5, None, "a whole number of samples"),
        (10.0, None, "at least one whole period"),
        (-1.0, None, "period"),
    ],
)
def test_bad_input(period, change, words):
    machine, _, controller, _ = rig()
    record = clean()
    if change is not None:
        record = replace(record, values=change(record.values))
    with pytest.raises(InvalidInput, match=words):
        identify(machine, record, controller, NINE, bending_modes=0, period=period)
