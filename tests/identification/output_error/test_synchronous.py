"""What turns with the rotor and other tones, eliminated from the fit, its tests and frequency
responses.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.statespace import select
from ambrose.identification import frf_spectral as spectral
from ambrose.identification.findings import Code
from ambrose.identification.output_error.closed_loop import LeastSquares, identify
from ambrose.identification.output_error.normal_equations import normal_equations
from ambrose.identification.output_error.problem import FitOptions, build_experiment
from ambrose.identification.output_error.synchronous import synchronous_of
from ambrose.identification.parameters import expand, nominal_values
from ambrose.identification.validation.plausibility import diagnose_outputs
from ambrose.identification.validation.repeatability import simulate_outputs
from ambrose.law.loop import closed_loop
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record
from linear_rig import DT, E, Y, rig

KNOWN = ("bearing.*.force_per_current.*", "bearing.*.negative_stiffness.*")
SPEED = 2 * np.pi * 47.3


@cache
def truth():
    machine, plant, *_ = rig()
    paths = expand(machine, KNOWN)
    return dict(zip(paths, nominal_values(plant, paths), strict=True))


def excited(k, axes=4):
    return np.stack(
        [
            0.1 * waveforms.prbs(9, 10, k, shift=127 * i) if i < axes else np.zeros(k)
            for i in range(4)
        ]
    )


def turning(k, speed=SPEED, drift=0.0):
    t = np.arange(k) * DT
    angle = speed * t + drift * t**2 / 2
    return angle, t


def record(
    k=4000,
    noise=0.0,
    stated=SPEED,
    drift=0.0,
    mains=0.0,
    unbalance=20.0,
    e=None,
    seed=0,
    channel=False,
    speed=SPEED,
):
    """Excited and turning: a force of ``unbalance`` [N] goes round at a port, sensors see a run-out
    of 2 um at 2x.
    """
    machine, still, _, law = rig()
    plant = free_mode_reduction(assemble(machine, replace(still.point, speed=speed)), 0)
    angle, t = turning(k, speed, drift)
    e = excited(k) if e is None else e
    loop = closed_loop(plant, law)
    ports = [f"f_{port}" for port in plant.ports[:2]]
    force = unbalance * np.stack([np.cos(angle), np.sin(angle)])
    y = simulate(select(loop, [*E, *ports], Y), np.vstack([e, force]))
    out = 2e-6 * (unbalance > 0) * np.stack([np.cos(2 * angle + i) for i in range(4)])
    y = (
        y
        + out
        + mains * np.cos(2 * np.pi * 50 * t)
        + noise * np.random.default_rng(seed).standard_normal(y.shape)
    )
    rows = [y, e]
    names = [*Y, *E]
    units = ["m"] * 4 + ["A"] * 4
    if channel:
        rows = [*rows, (speed + drift * t)[None]]
        names = [*names, "speed"]
        units = [*units, "rad/s"]
    point = replace(plant.point, speed=stated)
    return Record("seal-rig", 1 / DT, tuple(names), tuple(units), np.vstack(rows), point)


def errors(found):
    return np.array(
        [value / truth()[path] - 1 for path, value in zip(found.paths, found.values, strict=True)]
    )


def found(data, **options):
    return identify(rig()[0], data, rig()[2], KNOWN, bending_modes=0, computing_delay=0, **options)


def worst(estimate):
    return float(np.abs(errors(estimate)).max())


def test_unbalance_and_run_out_of_any_size_leave_the_values_exact():
    """Without these waves the fit does not even converge: 17 um at 1x beside 1 um that the
    excitation makes.
    """
    exact = found(record(2000))
    assert worst(exact) < 1e-9 and min(fit for _, _, fit in exact.fit) > 99.9999
    assert not found(record(2000), harmonics=0, max_iterations=5).converged


def test_standard_deviations_are_those_of_standstill_but_for_what_the_waves_hide():
    still, runs = (
        found(record(2000, noise=1e-7, unbalance=0.0), harmonics=0),
        found(record(2000, noise=1e-7)),
    )
    ratio = runs.standard_deviations / still.standard_deviations
    assert (ratio > 0.8).all() and (ratio < 1.4).all()
    assert (np.abs(errors(runs) * runs.values) < 4 * runs.standard_deviations).all()


@pytest.mark.parametrize("period", (None, 511 * 10 * DT))
def test_a_speed_known_nearly_is_found_with_the_parameters(period):
    data = record(511 * 30 if period else 4000, noise=1e-7, stated=1.01 * SPEED)
    near = found(data, period=period)
    once = (
        {wave.order: wave for wave in near.turning if wave.signal == "y_A_zeta"}
        if not period
        else {}
    )
    assert (np.abs(errors(near) * near.values) < 4 * near.standard_deviations).all()
    assert worst(near) < (5e-3 if period is None else 2e-2)
    if once:
        assert once[1].frequency == pytest.approx(47.3, rel=1e-4) and once[
            2
        ].frequency == pytest.approx(94.6, rel=1e-4)
        assert once[2].amplitude == pytest.approx(2e-6, abs=4 * once[2].standard_deviation)
        assert 0 < once[2].standard_deviation < 2e-8


@pytest.mark.parametrize("channel", (False, True))
def test_a_speed_that_drifts_is_followed(channel):
    data = record(10_000, noise=1e-7, unbalance=1.0, drift=3.0, channel=channel)
    drifting = found(data)
    assert (
        np.abs(errors(drifting) * drifting.values) < 4 * drifting.standard_deviations
    ).all() and worst(drifting) < 5e-3


def test_mains_are_a_tone_that_is_named():
    data = record(2000, noise=1e-8, unbalance=0.0, mains=3e-6)
    assert (
        found(data).standard_deviations > 3 * found(data, tones=(50.0,)).standard_deviations
    ).all()
    named = found(data, tones=(50.0,))
    assert worst(named) < 5e-3
    assert [wave.amplitude for wave in named.turning if wave.order == 0] == pytest.approx(
        [3e-6] * 4, rel=0.05
    )


@pytest.mark.parametrize("tones", [(0.6 / DT,), (50.0, 50.0), (2 * SPEED / (2 * np.pi),), (-50.0,)])
def test_tones_that_cannot_be_told_are_refused(tones):
    """Above half the rate, twice the same, and what turns with the rotor: the equations would be
    singular.
    """
    with pytest.raises(InvalidInput, match="tone"):
        synchronous_of(record(400), tones=tones)


def test_what_is_eliminated_is_the_least_squares_of_all_columns():
    """Against the dense problem of one record: initial state, constant, waves and parameters in one
    matrix.
    """
    data = record(600, noise=1e-7)
    options = FitOptions(bending_modes=0, computing_delay=0)
    experiment = build_experiment(rig()[0], data, rig()[2], KNOWN[:1], options)
    loop, directions = LeastSquares(experiment, normal_equations).loops(1.05 * experiment.nominal)[
        0
    ]
    task = experiment.tasks[0]
    solution = normal_equations(loop, directions, task)
    k = 600
    n = loop.n_states
    p = 4
    e = np.stack(task.e)
    y = np.stack([task.measured(i, 0, k) for i in range(p)])
    W = task.waves_at(0, k)
    free = [
        simulate(replace(loop, inputs=None, outputs=None), 0 * e, x0=x0).ravel() for x0 in np.eye(n)
    ]
    waves = [np.kron(row, wave) for row in np.eye(p) for wave in W]
    N = np.column_stack([*free, *waves])
    Q, R = np.linalg.qr(N / np.linalg.norm(N, axis=0))
    Q = np.linalg.svd(Q)[0][:, : np.linalg.matrix_rank(R, tol=1e-9)]
    r = y.ravel() - simulate(loop, task.mix @ e).ravel()
    left = r - Q @ (Q.T @ r)
    assert solution.equations.cost == pytest.approx(float(left @ left), rel=1e-6)


def test_an_excitation_at_the_speed_is_said_and_not_used():
    """A multisine with a line at 1x: refused before, for what unbalance makes of that line follows
    no model.
    """
    t = np.arange(10_000) * DT
    lines = 2 * np.pi * np.array([10, 20, 30, 50, 70, 110, 160, 230, 310, 410])
    e = 0.03 * np.stack(
        [
            np.sum(np.cos(lines[:, None] * t + i * np.arange(10)[:, None] ** 2), axis=0)
            for i in range(1, 5)
        ]
    )
    data = record(10_000, noise=1e-7, e=e, speed=2 * np.pi * 50, stated=2 * np.pi * 50)
    multisine = found(data)
    assert (
        "not used, for the rotor turns with it: e_A_zeta at 50 Hz, 1 x the speed"
        in multisine.verdict
    )
    assert (np.abs(errors(multisine) * multisine.values) < 4 * multisine.standard_deviations).all()
    assert "not used" not in found(record(2000, noise=1e-7)).verdict


def test_a_frequency_response_is_that_of_standstill():
    """Response at lines beside 1x, which the window's leakage of unbalance disturbs."""
    still, runs = (
        spectral.h1(
            record(20_000, noise=1e-8, unbalance=force, stated=1.002 * SPEED),
            "e_A_zeta",
            "y_A_zeta",
            segment=0.2,
        )
        for force in (0.0, 20.0)
    )
    lines, one, other = np.intersect1d(still.omega, runs.omega, return_indices=True)
    near = (lines > 0.5 * SPEED) & (lines < 3 * SPEED)
    error = np.abs(runs.values[other] / still.values[one] - 1)[near, 0, 0]
    assert np.median(error) < 0.02


def test_a_speed_that_was_not_told_is_said():
    """Residual tests pass beside such a tone, whatever the model lacks."""
    for data, words in (
        (record(4000, noise=1e-7, stated=0.0), "a tone at 47"),
        (record(2000, noise=1e-7), ""),
    ):
        experiment = build_experiment(
            rig()[0], data, rig()[2], KNOWN, FitOptions(bending_modes=0, computing_delay=0)
        )
        outputs = simulate_outputs(experiment, [data], experiment.nominal)
        told = [
            finding for finding in diagnose_outputs(rig()[0], outputs) if finding.code == Code.TONE
        ]
        assert bool(told) == bool(words) and all(words in finding.what for finding in told)
