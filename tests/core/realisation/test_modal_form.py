import numpy as np
import pytest

from ambrose.core.frequency import frequency_response
from ambrose.core.realisation import modal_form
from ambrose.core.statespace import StateSpace, poles


def same(first, second, omega, tolerance):
    a, b = (frequency_response(s, omega).values for s in (first, second))
    assert np.abs(a - b).max() <= tolerance * np.abs(a).max()


@pytest.mark.parametrize("seed", range(20))
def test_random_systems(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 25))
    A = rng.normal(0, 1, (n, n)) * 10.0 ** rng.uniform(-3, 3, n)
    system = StateSpace(
        A, rng.normal(0, 1, (n, 2)), rng.normal(0, 1, (3, n)), rng.normal(0, 1, (3, 2))
    )
    found = modal_form(system)
    assert sum(found.sizes) == n
    inside = np.zeros((n, n), bool)
    for start, k in zip(found.starts, found.sizes, strict=True):
        inside[start : start + k, start : start + k] = True
        if k == 2:
            block = found.system.A[start : start + 2, start : start + 2]
            assert block[0, 0] == pytest.approx(block[1, 1], rel=1e-9)
            assert block[0, 1] == pytest.approx(-block[1, 0], rel=1e-9)
    assert (found.system.A[~inside] == 0).all()
    same(system, found.system, np.geomspace(1e-4, 1e4, 100), 1e-7)


@pytest.mark.parametrize("beside", [0.0, 1e-14, 1e-10, 1e-7])
def test_a_double_pole_with_one_vector_stays_together(beside):
    """Separating a Jordan block needs a transform of 1/distance: it stays a block of two, and the
    response stays right.
    """
    J = np.array([[-1.0, 1.0, 0], [0, -1.0 - beside, 0], [0, 0, -5.0]])
    T = np.random.default_rng(1).normal(0, 1, (3, 3))
    system = StateSpace(
        np.linalg.solve(T, J @ T), np.linalg.solve(T, np.ones((3, 1))), np.ones((1, 3)) @ T, [[0.0]]
    )
    found = modal_form(system)
    assert sorted(found.sizes) == [1, 2]
    same(system, found.system, np.geomspace(1e-2, 1e2, 50), 1e-9)


def test_equal_poles_with_their_own_vectors_are_parted():
    system = StateSpace(-2 * np.eye(4), np.eye(4), np.eye(4), np.zeros((4, 4)))
    assert modal_form(system).sizes == (1, 1, 1, 1)


def test_a_far_twin_is_fetched():
    """The pole to stay with stands at the other end of the Schur form."""
    rng = np.random.default_rng(3)
    A = np.diag([-1.0, -50.0, -7.0, -1.0, -300.0])
    A[0, 3] = 1.0
    T = rng.normal(0, 1, (5, 5))
    B, C = rng.normal(0, 1, (5, 1)), rng.normal(0, 1, (1, 5))
    system = StateSpace(np.linalg.solve(T, A @ T), np.linalg.solve(T, B), C @ T, [[0.0]])
    found = modal_form(system)
    assert sorted(found.sizes) == [1, 1, 1, 2]
    assert np.allclose(np.sort(poles(found.system).real), [-300, -50, -7, -1, -1], rtol=1e-6)
    same(system, found.system, np.geomspace(1e-2, 1e3, 50), 1e-9)


def test_without_states():
    assert modal_form(StateSpace([], [], [], [[1.0]])).sizes == ()
