"""One repeated real block on a real matrix: mu against sign changes of det(I - delta M)."""

import numpy as np
import pytest

from ambrose.core.lft import RealBlock
from ambrose.core.mu.bounds import mu_bounds, real_eigenvalue_bound


def smallest_crossing(M):
    """The smallest |delta| at which det(I - delta M) changes its sign, by a grid and bisection."""

    def det(delta):
        return np.linalg.det(np.eye(len(M)) - delta * M)

    found = np.inf
    for sign in (1.0, -1.0):
        grid = sign * np.geomspace(1e-2, 1e3, 700)
        signs = np.sign([det(delta) for delta in grid])
        changes = np.flatnonzero(signs[1:] != signs[:-1])
        if len(changes):
            low, high = grid[changes[0]], grid[changes[0] + 1]
            for _ in range(60):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if det(middle) * det(low) > 0 else (low, middle)
            found = min(found, abs(low))
    return found


@pytest.mark.parametrize("n", [2, 3, 4, 5])
def test_the_bound_is_the_first_sign_change_of_the_determinant(n):
    rng = np.random.default_rng(n)
    for _ in range(5):
        M = rng.normal(size=(n, n))
        first = smallest_crossing(M)
        bounds = mu_bounds(M, [RealBlock("d", n)])
        exact = 0.0 if first > 999 else 1 / first
        assert bounds.upper == pytest.approx(exact, rel=1e-7, abs=1e-6)
        assert bounds.lower <= bounds.upper


def test_rounding_is_on_the_safe_side():
    # two real eigenvalues that coincide: any rounding may make a complex pair of them
    jordan = np.array([[1.0, 1.0], [0.0, 1.0]])
    rng = np.random.default_rng(0)
    for _ in range(30):
        T = rng.normal(size=(2, 2))
        assert real_eigenvalue_bound(T @ jordan @ np.linalg.inv(T)) >= 1 - 1e-7
    assert real_eigenvalue_bound(np.array([[0.0, 1.0], [-1.0, 0.0]])) == 0.0
    assert real_eigenvalue_bound(np.zeros((2, 2))) == 0.0
