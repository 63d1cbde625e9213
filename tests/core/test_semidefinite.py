"""Semidefinite programs against Clarabel, known optima, and statements that hold for every
problem.
"""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.matrix_inequalities import (
    Inequality,
    MatrixVariable,
    Term,
    minimise,
    side,
    smat,
    svec,
)


def problem(seed: int) -> tuple[np.ndarray, list[Inequality]]:
    """Bounded from below and strictly feasible at zero: the cost is what positive definite
    multipliers give.
    """
    rng = np.random.default_rng(seed)
    k, items = 12, []
    cost = np.zeros(k)
    for d in (4, 7, 1, 9):
        columns = rng.permutation(k)[:8] if d != 9 else np.arange(k)
        rows = rng.standard_normal((d * (d + 1) // 2, len(columns)))
        Z, F = (M @ M.T + 0.1 * np.eye(d) for M in rng.standard_normal((2, d, d)))
        cost[columns] += svec(Z) @ rows
        items.append(Inequality(rows, svec(F), columns))
    return cost, items


def clarabel_value(cost: np.ndarray, items: list[Inequality]) -> float:
    import clarabel
    from scipy import sparse

    rows = []
    for item in items:
        part = np.zeros((len(item.constant), len(cost)))
        part[:, item.columns] = item.rows
        rows.append(-part)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.PSDTriangleConeT(item.side) for item in items]
    square = sparse.csc_matrix((len(cost), len(cost)))
    constant = np.concatenate([item.constant for item in items])
    return (
        clarabel.DefaultSolver(
            square, cost, sparse.csc_matrix(np.vstack(rows)), constant, cones, settings
        )
        .solve()
        .obj_val
    )


@pytest.mark.parametrize("seed", range(6))
def test_same_optimum_as_clarabel(seed):
    cost, items = problem(seed)
    found = minimise(cost, items)
    assert found.status == "optimal"
    assert found.value == pytest.approx(clarabel_value(cost, items), rel=1e-6)
    assert found.bound <= found.value <= found.bound + 1e-6 * abs(found.value)


@pytest.mark.parametrize("seed", range(3))
def test_solution_lies_strictly_inside_and_costs_what_is_said(seed):
    cost, items = problem(seed)
    found = minimise(cost, items)
    assert found.value == pytest.approx(cost @ found.x, rel=1e-12)
    for item in items:
        assert np.linalg.eigvalsh(smat(item.rows @ found.x[item.columns] + item.constant))[0] > 0


def test_largest_eigenvalue_is_the_smallest_bound():
    M = np.random.default_rng(5).standard_normal((20, 20))
    M = M + M.T
    found = minimise(
        np.ones(1), [Inequality(svec(np.eye(20))[:, None], -svec(M), np.array([0]))], tolerance=1e-9
    )
    assert found.value == pytest.approx(np.linalg.eigvalsh(M)[-1], rel=1e-8)


def test_nothing_satisfies_contradicting_inequalities():
    one = np.ones((1, 1))
    found = minimise(
        np.ones(1),
        [Inequality(one, -np.ones(1), np.array([0])), Inequality(-one, np.zeros(1), np.array([0]))],
    )
    assert found.status == "infeasible"


def test_hopeless_search_ends_early():
    cost, items = problem(0)
    whole = minimise(cost, items)
    found = minimise(cost, items, hopeless=whole.value - 5.0)
    assert found.status == "infeasible"
    assert found.steps < whole.steps
    assert minimise(cost, items, hopeless=whole.value + 5.0).status == "optimal"


def test_time_limit_is_kept():
    assert minimise(*problem(0), time_limit=1e-9).status == "time limit"


def test_a_variable_without_effect_does_not_matter():
    cost, items = problem(1)
    found = minimise(np.append(cost, 0.0), items)
    assert found.value == pytest.approx(minimise(cost, items).value, rel=1e-9)


def test_svec_and_back():
    X = np.random.default_rng(0).standard_normal((3, 5, 5))
    X = X + X.swapaxes(1, 2)
    np.testing.assert_allclose(smat(svec(X)), X, rtol=1e-15)
    assert side(svec(X).shape[-1]) == 5


def test_sizes_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInput, match=r"inequality 0"):
        minimise(np.ones(2), [Inequality(np.ones((3, 1)), np.ones(3), np.array([0, 1]))])


def bounded_real(terms: bool, rows: int = 3) -> tuple[np.ndarray, list[Inequality]]:
    """The bounded real inequalities of a loop at five values of p with X0 + p X1: as terms, or
    written out column by column.
    """
    rng = np.random.default_rng(4)
    n = 6
    q = 2
    A = rng.standard_normal((n, n))
    B = rng.standard_normal((n, q))
    C = rng.standard_normal((q, n)) / n
    A -= (np.linalg.eigvals(A).real.max() + 1) * np.eye(n)
    X0 = MatrixVariable(0, n, n)
    X1 = MatrixVariable(X0.stop, n, rows)
    k = X1.stop
    one = np.eye(n, n + q)
    corner = np.zeros((n + q, n + q))
    corner[n:, n:] = np.eye(q)
    constant, items = svec(-np.block([[C.T @ C, C.T], [C, np.eye(q)]])), []
    for p in np.linspace(-1, 1, 5):
        V = np.hstack([A + 0.2 * p * rng.standard_normal((n, n)), B])
        both = (Term(X0, -one, V), Term(X1, -one, p * V + 0.1 * one))
        written = [
            svec(term.value(x))
            for term in both
            for x in np.eye(k)[term.variable.start : term.variable.stop]
        ]
        dense = np.column_stack([*written, svec(corner)])
        one_item = Inequality(svec(corner)[:, None], constant, np.array([k]), both)
        items.append(one_item if terms else Inequality(dense, constant, np.arange(k + 1)))
    return np.eye(k + 1)[k], items


def test_matrices_among_the_variables_are_their_columns_written_out():
    (cost, items), (_, written) = bounded_real(True), bounded_real(False)
    x = np.random.default_rng(6).standard_normal(len(cost))
    for item, dense in zip(items, written, strict=True):
        np.testing.assert_allclose(item.value(x), smat(dense.rows @ x), atol=1e-12)
        np.testing.assert_allclose(item.squares(len(x)), (dense.rows**2).sum(0), rtol=1e-12)
    found, other = minimise(cost, items), minimise(cost, written)
    assert found.status == "optimal" and found.steps == other.steps
    assert (
        found.value
        == pytest.approx(other.value, rel=1e-7)
        == pytest.approx(clarabel_value(cost, written), rel=1e-6)
    )
    assert minimise(*bounded_real(True, 1)).value > 1.001 * found.value  # fewer rows, less freedom
