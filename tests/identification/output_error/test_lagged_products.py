"""Sums and sensitivities in pieces of a record, against the same over the whole of it; and the
memory they need.
"""

import tracemalloc

import numpy as np
import pytest

from ambrose.core.response import SystemDerivative, simulate
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error import statistics
from ambrose.identification.output_error.normal_equations import (
    Task,
    lift,
    normal_equations,
    stream,
)
from ambrose.identification.output_error.statistics import (
    coloured_products,
    lagged_sums,
    residual_scores,
)
from whole_records import fit_percent, residual_input_test, sandwich_middle


def pieces(signals, length):
    return [signals[..., i : i + length] for i in range(0, signals.shape[-1], length)]


@pytest.mark.parametrize(("k", "length"), [(700, 100), (700, 333), (90, 200), (701, 7)])
def test_lagged_sums(k, length):
    x, span = (
        np.random.default_rng(k).standard_normal((3, k)) + np.array([[1.0], [-2.0], [0.0]]),
        40,
    )
    found = lagged_sums(pieces(x, length), [(0, 1), (2, 2)], span)
    assert found.samples == k
    np.testing.assert_allclose(found.squares, np.sum(x**2, axis=1), rtol=1e-12)
    m = x - x.mean(axis=1, keepdims=True)
    for lag in range(span + 1):
        assert found.values[0, lag] == pytest.approx(x[0, lag:] @ x[1, : k - lag], abs=1e-10 * k)
        assert found.about_the_means(0, 1)[lag] == pytest.approx(
            m[0, lag:] @ m[1, : k - lag], abs=1e-10 * k
        )


@pytest.mark.parametrize(("k", "length"), [(2000, 500), (2000, 2000), (2000, 90), (1999, 640)])
def test_coloured_products_are_those_of_the_whole_record(k, length):
    rng = np.random.default_rng(k + length)
    J, r = rng.standard_normal((4, 2, k)), np.cumsum(rng.standard_normal((2, k)), axis=1)
    span = statistics.memory(k)
    sums = lagged_sums(pieces(r, length), [(i, j) for i in range(2) for j in range(2)], span)
    covariance = statistics.tapered(sums.values, k).reshape(2, 2, span + 1)
    expected = sandwich_middle(J, r)
    found = coloured_products(pieces(J, length), covariance)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


def system_and_directions(n=7, m=2, p=2, q=3):
    rng = np.random.default_rng(5)
    A = rng.standard_normal((n, n))
    A *= 0.99 / np.abs(np.linalg.eigvals(A)).max()
    system = StateSpace(
        A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), np.zeros((p, m)), dt=1e-3
    )
    directions = [
        SystemDerivative(
            rng.standard_normal((n, n)),
            rng.standard_normal((n, m)),
            np.zeros((p, n)),
            np.zeros((p, m)),
        )
        for _ in range(q)
    ]
    return system, directions


def test_scores_are_those_of_the_whole_record():
    system, directions = system_and_directions()
    rng, k = np.random.default_rng(6), 30_000
    e = rng.standard_normal((2, k))
    y = (
        simulate(system, e, x0=rng.standard_normal(7))
        + np.cumsum(0.01 * rng.standard_normal((2, k)), axis=1)
        + 3.0
    )
    task = Task(e, np.eye(2), y, True, True)
    found = normal_equations(system, directions, task)
    residual = y - simulate(system, e, x0=found.x0) - found.b
    assert found.equations.cost == pytest.approx(np.sum(residual**2), rel=1e-9)
    scores = residual_scores(system, task, found, ["a", "b"], ["y1", "y2"], 4)
    for i in range(2):
        assert scores.fit[i] == pytest.approx(fit_percent(y[i], residual[i]), rel=1e-9)
        for j in range(2):
            expected = residual_input_test(residual[i], y[i], e[j], 100, f"y{i + 1}", "ab"[j], 4)
            test = scores.tests[2 * i + j]
            assert (test.signal, test.excitation, test.lag) == (
                expected.signal,
                expected.excitation,
                expected.lag,
            )
            assert test.correlation == pytest.approx(expected.correlation, rel=1e-6, abs=1e-9)
            assert test.limit == pytest.approx(expected.limit, rel=1e-6)


def test_pieces_and_blocks_of_any_length_give_the_same():
    system, directions = system_and_directions()
    rng = np.random.default_rng(7)
    u, x0, dx0 = rng.standard_normal((2, 777)), rng.standard_normal(7), rng.standard_normal((3, 7))

    def whole(length, piece):
        parts = [
            F.transpose(0, 2, 1, 3).reshape(4, 2, -1)
            for _, F in stream(lift(system, directions, length), u, x0, dx0, piece)
        ]
        return np.concatenate(parts, axis=2)[:, :, :777]

    first = whole(16, 1000)
    np.testing.assert_allclose(
        first[0], simulate(system, u, x0=x0), rtol=0, atol=1e-11 * np.abs(first[0]).max()
    )
    for length, piece in ((1, 100), (5, 3), (16, 1), (64, 2)):
        np.testing.assert_allclose(
            whole(length, piece), first, rtol=0, atol=1e-10 * np.abs(first).max()
        )


def test_memory_does_not_grow_with_the_record():
    system, directions = system_and_directions()
    peaks = []
    for k in (20_000, 200_000):
        e = np.random.default_rng(8).standard_normal((2, k))
        task = Task(e, np.eye(2), e, True, True)
        normal_equations(system, directions, task.first(500))
        tracemalloc.start()
        normal_equations(system, directions, task)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.1 * peaks[0] + 1e5, peaks
