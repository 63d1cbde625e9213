"""core/interval_proof.py: enclosures hold what they must, and nothing unstable is ever proved."""

import numpy as np
import pytest

from ambrose.core.interval_proof import Pencil, enclose, prove, proved_angle
from ambrose.core.synchronous import convergence


def system(rng, n=6, p=2, members=2):
    """Matrices of P = j w I - A - w A1 + sum p_j E_j with A stable."""
    A = rng.standard_normal((n, n))
    A = A - (np.linalg.eigvals(A).real.max() + rng.uniform(0.5, 2)) * np.eye(n)
    A1 = 0.1 * rng.standard_normal((n, n))
    A1 = A1 - A1.T
    E = [rng.uniform(0, 0.08) * rng.standard_normal((n, n)) for _ in range(members)]
    return A, A1, E, rng.standard_normal((n, p)), rng.standard_normal((p, n)) * 0.4


def pencil_of(A, A1, E, B, C, low, high):
    n, w = len(A), (low + high) / 2
    return Pencil(
        1j * w * np.eye(n) - A - w * A1,
        1j * np.eye(n) - A1,
        np.zeros((n, n), complex),
        tuple(E),
        np.zeros((n, n)),
        C.astype(complex),
        B.astype(complex),
        np.eye(len(C), dtype=complex),
        (high - low) / 2,
    )


def value(A, A1, E, B, C, w, p):
    P = 1j * w * np.eye(len(A)) - A - w * A1 + sum(x * e for x, e in zip(p, E, strict=True))
    return np.eye(len(C)) + C @ np.linalg.solve(P, B)


@pytest.mark.parametrize("seed", range(20))
def test_every_value_of_a_cell_lies_in_its_enclosure(seed):
    rng = np.random.default_rng(seed)
    parts = system(rng)
    low, high = 1.0, 1.0 + rng.uniform(0.02, 0.3)
    cell = enclose(pencil_of(*parts, low, high))
    if cell is None:
        pytest.skip("too wide for its series")
    for _ in range(200):
        t, p = rng.uniform(0, 1), rng.uniform(-1, 1, 2)
        weights = np.array([(1 - t) ** 2, 2 * t * (1 - t), t**2])
        polynomial = np.einsum("k,kij->ij", weights, cell.corners) + np.einsum(
            "j,jik->ik", p, cell.slopes
        )
        off = np.abs(value(*parts, low + t * (high - low), p) - polynomial)
        assert (off <= cell.tail + 1e-12).all()


def test_the_bound_is_tight_enough_to_prove_a_good_matrix_and_none_that_is_unstable():
    """An attack: random matrices, intervals and members; what is proved converges wherever it is
    tried.
    """
    rng = np.random.default_rng(7)
    proved = refused = 0
    for _ in range(60):
        parts = system(rng)
        middle = value(*parts, 1.25, (0, 0))
        T = np.linalg.inv(middle) @ (
            np.eye(2) + 0.7 * (rng.standard_normal((2, 2)) + 1j * rng.standard_normal((2, 2)))
        )
        result = prove(
            lambda a, b, parts=parts: enclose(pencil_of(*parts, a, b)),
            lambda w, T=T: T,
            1.0,
            1.5,
            0.1,
            narrowest=1e-2,
        )
        tried = [
            convergence(T, value(*parts, rng.uniform(1, 1.5), rng.uniform(-1, 1, 2)))
            for _ in range(40)
        ]
        if result.proved:
            proved += 1
            assert min(tried) > 0
            assert result.angle > 0
        else:
            refused += 1
    assert proved > 10  # the proof is worth something
    assert refused > 10  # and the attack reaches it


def test_a_matrix_that_is_linear_between_two_ends_is_proved_by_the_ends():
    rng = np.random.default_rng(1)
    parts = system(rng)
    cell = enclose(pencil_of(*parts, 1.2, 1.22))
    T = np.linalg.inv(value(*parts, 1.21, (0, 0)))
    turned = np.exp(0.4j) * T
    angle = proved_angle(cell, [T, turned])
    assert 0 < angle < np.pi / 2 - 0.3
    assert proved_angle(cell, [T]) > angle
    assert proved_angle(cell, [-T]) < 0
    assert proved_angle(cell, [T], allowance=10.0) < 0
