"""Points that share parameters, against the determinant and the solution of each point by
itself.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from ambrose.core import worst_case_loop as box_elimination
from ambrose.core.lft import Ports, upper_lft_responses
from ambrose.core.worst_case_loop import determinants_at


def problem(
    seed: int, repeats: tuple[int, ...], frequencies: int = 7
) -> tuple[np.ndarray, np.ndarray]:
    """M (w, n + 2, n + 3) and the owner of each channel, the channels of a parameter not side by
    side.
    """
    rng = np.random.default_rng(seed)
    owner = rng.permutation(np.repeat(np.arange(len(repeats)), repeats))
    shape = (frequencies, len(owner) + 2, len(owner) + 3)
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / len(owner), owner


def one_by_one(
    M: np.ndarray, owner: np.ndarray, delta: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    n = len(owner)
    h, T = np.empty((len(delta), len(M)), complex), np.empty((len(delta), len(M), 2, 3), complex)
    for (i, d), (j, m) in product(enumerate(delta), enumerate(M)):
        D = np.diag(d[owner])
        h[i, j] = np.linalg.det(np.eye(n) - m[:n, :n] @ D)
        T[i, j] = m[n:, n:] + m[n:, :n] @ D @ np.linalg.inv(np.eye(n) - m[:n, :n] @ D) @ m[:n, n:]
    return h, T


def transfers_at(M: np.ndarray, owner: np.ndarray, delta: np.ndarray) -> np.ndarray:
    gain = delta[:, owner, None] * np.eye(len(owner))
    return upper_lft_responses(M.transpose(1, 2, 0), gain).transpose(0, 3, 1, 2)


@pytest.mark.parametrize("repeats", [(1,), (3,), (1, 1), (2, 1, 4, 1), (1,) * 6, (3, 2, 2, 1, 1)])
def test_corners_scattered_points_and_both(repeats):
    M, owner = problem(len(repeats), repeats)
    k, rng = len(repeats), np.random.default_rng(5)
    corners = np.array(list(product((-1.3, 1.3), repeat=k)))
    scattered = rng.uniform(-1, 1, (20, k))
    partly = np.where(rng.random((40, k)) < 0.6, corners[0], rng.uniform(-1, 1, (40, k)))
    twice = rng.permutation(np.vstack([corners, corners, np.zeros((1, k))]))
    for delta in (
        corners,
        scattered,
        partly,
        twice,
        np.vstack([corners, scattered]),
        corners[:1],
        corners[:0],
    ):
        h, T = one_by_one(M, owner, delta)
        n = len(owner)
        np.testing.assert_allclose(determinants_at(M[:, :n, :n], owner, delta), h, rtol=1e-10)
        np.testing.assert_allclose(transfers_at(M, owner, delta), T, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.parametrize("distance", [0.0, 1e-13, 1e-6, 0.5])
def test_points_that_act_at_two_places(channels, distance):
    """Also next to a singular point, where the sum over minors would lose its digits."""
    rng = np.random.default_rng(channels)
    into, out_of = rng.standard_normal((channels, 6)), rng.standard_normal((6, 4))
    into[:, :channels], out_of[:4] = np.eye(channels), np.eye(4)
    few = Ports(np.arange(channels), into, np.arange(4), out_of)
    N = rng.standard_normal((5, 4, channels)) + 1j * rng.standard_normal((5, 4, channels))
    corners = np.array(list(product((-1.0, 1.0), repeat=6)))
    N[2] /= np.linalg.eigvals(few.gain(corners[7]) @ N[2])[0] / (1 - distance)
    M11 = out_of @ N @ into
    h = np.linalg.det(np.eye(6) - M11 * corners[:, None, None])
    assert np.abs(h[7, 2]) < 10 * distance + 1e-9
    found = determinants_at(M11, np.arange(6), corners, few)
    np.testing.assert_allclose(found, h, rtol=1e-9, atol=1e-13)
    every = np.sort_complex(few.eigenvalues(M11, corners[:, None]))
    expected = np.linalg.eigvals(few.gain(corners)[:, None] @ N)
    np.testing.assert_allclose(every, np.sort_complex(expected), rtol=1e-9, atol=1e-12)


def test_corners_do_share(monkeypatch):
    """Of the determinants of 64 corners none is computed as a whole."""
    M, owner = problem(3, (1,) * 6)
    corners = np.array(list(product((-1.0, 1.0), repeat=6)))
    expected = one_by_one(M, owner, corners)[0]
    monkeypatch.setattr(box_elimination, "_determinants", None)
    np.testing.assert_allclose(determinants_at(M[:, :6, :6], owner, corners), expected, rtol=1e-10)


@pytest.mark.parametrize("distance", [0.0, 1e-16, 1e-13, 1e-9, 1e-6, 1e-4])
@pytest.mark.parametrize("repeats", [(1, 1, 1), (1, 1, 1, 1, 1), (3, 1, 1, 1, 1)])
def test_pivots_next_to_zero_keep_their_digits(repeats, distance):
    """I - M11 delta is regular, but its leading entry, or block, is not: elimination in order would
    lose digits.
    """
    M, owner = problem(11, repeats)
    owner = np.sort(owner)
    n, r = len(owner), repeats[0]
    M[:, :r, :r] = 0.3 * np.triu(M[:, :r, :r], 1)
    M[:, 0, 0] = 1 - distance  # at delta = 1 the first pivot is ``distance``
    corners = np.array(list(product((-1.0, 1.0), repeat=len(repeats))))
    h, T = one_by_one(M, owner, corners)
    assert np.abs(h).min() > 1e-3
    np.testing.assert_allclose(determinants_at(M[:, :n, :n], owner, corners), h, rtol=1e-9)
    np.testing.assert_allclose(transfers_at(M, owner, corners), T, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_a_point_on_a_pole_leaves_the_others_theirs(n):
    M, owner = problem(2, (1,) * n)
    owner = np.arange(n)
    M[3, :n, :n] = np.diag(np.full(n, 0.25))
    M[3, 0, 0] = 1.0
    delta = np.vstack([np.full(n, 0.5), np.ones(n), np.full(n, -0.5)])
    with np.errstate(all="ignore"):
        found = transfers_at(M, owner, delta)
    assert not np.isfinite(found[1, 3]).any()
    rest = np.ones((3, len(M)), bool)
    rest[1, 3] = False
    for i, j in np.argwhere(rest):
        expected = one_by_one(M[j : j + 1], owner, delta[i : i + 1])[1][0, 0]
        np.testing.assert_allclose(found[i, j], expected, rtol=1e-9)


def test_a_singular_point_has_determinant_zero():
    """The other points of its branch keep theirs."""
    M = np.diag([1.0, 0.5, 0.25, 0.2, 0.1]).astype(complex)[None]
    corners = np.array(list(product((-1.0, 1.0), repeat=5)))
    expected = np.prod(1 - corners * np.diag(M[0]).real, axis=1)
    np.testing.assert_allclose(
        determinants_at(M, np.arange(5), corners)[:, 0], expected, atol=1e-15
    )
    assert (expected == 0).sum() == 16
