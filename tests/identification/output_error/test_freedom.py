"""What a fit takes out of its residuals is given back to the variances: against dense projections,
and against scatter.
"""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose.core.response import simulate
from ambrose.core.statespace import select
from ambrose.identification.output_error import (
    closed_loop as freedom,
    closed_loop as whole_loop,
    statistics,
)
from ambrose.identification.output_error.normal_equations import (
    explained_columns,
    jacobian_pieces,
    normal_equations,
)
from ambrose.identification.output_error.problem import FitOptions, build_experiment
from ambrose.identification.output_error.statistics import coloured_products
from ambrose.law.loop import closed_loop
from ambrose.record.record import Record
from linear_rig import DT, E, Y, rig

UNKNOWN = ["bearing.*.negative_stiffness.*", "amplifier.natural_frequency"]
K = 400


def record(seed, k=K, noise=1e-7):
    machine, plant, _, law = rig()
    e = np.stack([0.1 * waveforms.prbs(9, 10, k, shift=127 * i) for i in range(4)])
    y = simulate(select(closed_loop(plant, law), E, Y), e)
    y = y + noise * np.random.default_rng(seed).standard_normal(y.shape)
    return Record(
        machine.name, 1 / DT, (*Y, *E), ("m",) * 4 + ("A",) * 4, np.vstack([y, e]), plant.point
    )


def columns():
    """Of the fit at its truth: loop, derivatives, task, solution, and J and the nuisances' columns
    as (., 4 k).
    """
    machine, _, _, law = rig()
    experiment = build_experiment(
        machine,
        record(0),
        law,
        UNKNOWN,
        FitOptions(bending_modes=0, computing_delay=0, tones=(50.0,)),
    )
    (task,) = experiment.tasks
    loop, directions = whole_loop.LeastSquares(experiment, normal_equations).loops(
        experiment.nominal
    )[0]
    part = normal_equations(loop, directions, task)
    J = np.concatenate(list(jacobian_pieces(loop, directions, task, part)), axis=2).reshape(
        len(directions), -1
    )
    return loop, directions, task, part, J, explained_columns(loop, task).reshape(-1, 4 * K)


def test_the_columns_are_orthonormal_and_hold_state_offset_and_waves():
    loop, _, task, part, J, N = columns()
    np.testing.assert_allclose(N @ N.T, np.eye(len(N)), atol=1e-8)
    np.testing.assert_allclose(N @ J.T, 0.0, atol=1e-6 * np.linalg.norm(J, axis=1).max())
    size = np.sqrt(np.diag(part.equations.H))
    np.testing.assert_allclose((J @ J.T - part.equations.H) / size / size[:, None], 0.0, atol=1e-9)
    powers = [np.linalg.matrix_power(loop.A, t) for t in range(K)]
    free = np.einsum("pn,tnm->mpt", loop.C, np.array(powers)).reshape(loop.n_states, -1)
    waves = np.kron(np.eye(4), task.waves_at(0, K))
    for row in (*free, *waves):
        assert np.linalg.norm(row - N.T @ (N @ row)) < 1e-4 * np.linalg.norm(row)


def test_what_white_noise_loses_in_the_mean_is_given_back_exactly():
    """The mean of the estimate from r = (I - P) e, by the dense projection, becomes the variance
    that e has.
    """
    loop, directions, task, part, J, N = columns()
    every = np.vstack([J, N])
    rest = np.eye(4 * K) - every.T @ np.linalg.solve(every @ every.T, every)
    lags = statistics.memory(K)
    blocks = rest.reshape(4, K, 4, K)  # the covariance of r, of unit noise
    sums = np.array(
        [
            [[np.trace(blocks[a, :, b], -lag) for lag in range(lags + 1)] for b in range(4)]
            for a in range(4)
        ]
    )
    gamma = statistics.tapered(sums, K)
    middle = coloured_products([J.reshape(-1, 4, K)], gamma)
    H = part.equations.H
    small = np.diag(statistics.sandwich_covariance(H, middle)) / np.diag(np.linalg.inv(H))
    assert 0.5 < small.min() < small.max() < 0.97  # as stated without it
    mended = freedom.restored(middle, loop, directions, task, part, H)
    np.testing.assert_allclose(
        np.diag(statistics.sandwich_covariance(H, mended)), np.diag(np.linalg.inv(H)), rtol=1e-6
    )


@pytest.mark.study
def test_stated_deviations_of_short_records_are_those_that_appear():
    machine, _, _, law = rig()
    found = [
        whole_loop.identify(machine, record(seed), law, UNKNOWN, bending_modes=0, computing_delay=0)
        for seed in range(150)
    ]
    values, stated = (
        np.array([getattr(one, name) for one in found])
        for name in ("values", "standard_deviations")
    )
    ratio = stated.mean(axis=0) / values.std(axis=0, ddof=1)
    assert ratio.mean() == pytest.approx(1.0, abs=0.07)  # 150 runs know each to 6 %


def test_a_long_record_is_left_as_it_is(monkeypatch):
    machine, _, _, law = rig()
    short = whole_loop.identify(
        machine, record(1), law, UNKNOWN, bending_modes=0, computing_delay=0
    )
    monkeypatch.setattr(freedom, "_LONG", K - 1)
    plain = whole_loop.identify(
        machine, record(1), law, UNKNOWN, bending_modes=0, computing_delay=0
    )
    np.testing.assert_array_equal(short.values, plain.values)
    assert np.all(short.standard_deviations > plain.standard_deviations)
    assert replace(short, covariance=plain.covariance).paths == plain.paths
