"""Bounds of mu against truths found another way, on more than a thousand small random problems:
upper >= truth >= lower.

The truth is a fine scan over the real parameters with local refinement (never above mu, up to its
own resolution), an exact polynomial, a spectral radius, or the closed form for rank-one matrices
(Young, Newlin & Doyle 1995).
"""

from __future__ import annotations

import os

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from ambrose.core.lft import ComplexBlock, FullBlock, RealBlock
from ambrose.core.mu.bounds import mu_bounds

pytestmark = pytest.mark.study  # minutes

# problems per structure; the large run uses 1000
COUNT = int(os.environ.get("AMBROSE_MU_SCANS", "40"))


def random_matrices(seed, blocks, count=COUNT):
    rng = np.random.default_rng(seed)
    n_z, n_w = sum(b.n_z for b in blocks), sum(b.n_w for b in blocks)
    M = rng.standard_normal((count, n_z, n_w)) + 1j * rng.standard_normal((count, n_z, n_w))
    return M * 10 ** rng.uniform(-1, 1, (count, n_z, 1)) * 10 ** rng.uniform(-1, 1, (count, 1, n_w))


def reduced(M, repeats, q):
    """F(q) for parameters q (k, m) that own the leading channels, (k, p, p)."""
    channel = np.repeat(q, repeats, axis=1)
    r = channel.shape[1]
    E = np.eye(r) - M[:r, :r] * channel[:, None, :]
    return M[r:, r:] + (M[r:, :r] * channel[:, None, :]) @ np.linalg.solve(
        E, np.broadcast_to(M[:r, r:], (len(q), r, len(M[0]) - r))
    )


def complex_mu(F, kind):
    if kind == "full":
        return np.linalg.norm(F, 2, axis=(1, 2))
    return np.abs(np.linalg.eigvals(F)).max(axis=1)  # repeated complex


def scanned(M, repeats, kind, points, rounds=24):
    """Largest mu found by scanning real parameters for the smallest max(|q|, 1/mu_c(F(q))), then
    zooming in on the best.
    """
    m = len(repeats)

    def size(q):
        with np.errstate(divide="ignore"):
            return np.maximum(np.abs(q).max(axis=1), 1 / complex_mu(reduced(M, repeats, q), kind))

    limit = size(np.zeros((1, m)))[0]
    r = sum(repeats)
    limit = min(limit, 1e3 / max(np.abs(M[:r, :r]).max(), 1e-9))
    axis = np.linspace(-limit, limit, points)
    q = np.stack(np.meshgrid(*[axis] * m, indexing="ij"), axis=-1).reshape(-1, m)
    values = size(q)
    best = np.inf
    for start in np.argsort(values)[:6]:
        centre = q[start]
        value = values[start]
        width = 2 * limit / points
        for _ in range(rounds):
            local = np.clip(
                centre
                + width
                * np.stack(np.meshgrid(*[np.linspace(-1, 1, 7)] * m), axis=-1).reshape(-1, m),
                -value,
                value,
            )
            found = size(local)
            if found.min() < value:
                centre, value = local[found.argmin()], found.min()
            width *= 0.6
        best = min(best, value)
    return 1 / best


def is_singular(M, blocks, result):
    """The perturbation returned does what it claims, checked from the definition."""
    for k in np.flatnonzero(result.lower > 0):
        delta = result.delta[k]
        # residual of the scaled matrix: D commutes with delta, so singularity is unchanged and the
        # numbers are tame
        loop = result.D_z[k] @ M[k] @ np.linalg.inv(result.D_w[k]) @ delta
        s = np.linalg.svd(np.eye(len(loop)) - loop, compute_uv=False)
        assert s[-1] < 1e-7 * (1 + np.linalg.norm(loop, 2))
        assert np.linalg.norm(delta, 2) == pytest.approx(1 / result.lower[k], rel=1e-9)
        i = j = 0
        outside = delta.copy()
        for block in blocks:
            part = delta[i : i + block.n_w, j : j + block.n_z]
            if not isinstance(block, FullBlock):
                assert part == pytest.approx(part[0, 0] * np.eye(block.n_w))
            if isinstance(block, RealBlock):
                assert not part.imag.any()
            outside[i : i + block.n_w, j : j + block.n_z] = 0
            i, j = i + block.n_w, j + block.n_z
        assert not outside.any()


SCANNED = {
    "one real, full 2": ([RealBlock("d"), FullBlock("f", 2, 2)], [1], "full", 401),
    "one repeated real, full 2": ([RealBlock("d", 2), FullBlock("f", 2, 2)], [2], "full", 401),
    "real repeated three times, full 2": (
        [RealBlock("d", 3), FullBlock("f", 2, 2)],
        [3],
        "full",
        401,
    ),
    "one repeated real, full 1 x 3": ([RealBlock("d", 2), FullBlock("f", 3, 1)], [2], "full", 401),
    "one real, repeated complex": ([RealBlock("d", 2), ComplexBlock("c", 2)], [2], "repeated", 401),
    "two reals, complex scalar": (
        [RealBlock("d"), RealBlock("e"), ComplexBlock("c")],
        [1, 1],
        "full",
        61,
    ),
    "two reals, full 2": (
        [RealBlock("d"), RealBlock("e"), FullBlock("f", 2, 2)],
        [1, 1],
        "full",
        61,
    ),
    "two reals, one repeated, full 2": (
        [RealBlock("d", 2), RealBlock("e"), FullBlock("f", 2, 2)],
        [2, 1],
        "full",
        61,
    ),
}


@pytest.mark.parametrize("name", SCANNED)
def test_scanned_truth_lies_between_the_bounds(name):
    blocks, repeats, kind, points = SCANNED[name]
    M = random_matrices(sum(map(ord, name)), blocks)
    result = mu_bounds(M, blocks)
    truth = np.array([scanned(m, repeats, kind, points) for m in M])
    assert (result.upper >= truth * (1 - 1e-9)).all()
    assert (result.upper >= result.lower).all()
    # each lower bound carries its proof, so it may beat a scan, which has holes between points
    is_singular(M, blocks, result)
    assert (result.lower >= truth * (1 - 1e-3)).mean() >= 0.9


@pytest.mark.parametrize("repeat", [1, 2, 3])
def test_complex_repeated_is_the_spectral_radius(repeat):
    blocks = [ComplexBlock("c", repeat)]
    M = random_matrices(repeat, blocks)
    result = mu_bounds(M, blocks, tolerance=1e-6)
    radius = np.abs(np.linalg.eigvals(M)).max(axis=1)
    assert (result.upper >= radius * (1 - 1e-12)).all()
    assert result.upper == pytest.approx(radius, rel=1e-4)
    assert result.lower == pytest.approx(radius, rel=1e-9)


@pytest.mark.parametrize("size", [(2, 2), (3, 1), (1, 3), (2, 4)])
def test_one_full_block_is_the_largest_singular_value(size):
    blocks = [FullBlock("f", *size)]
    M = random_matrices(size[0], blocks)
    result = mu_bounds(M, blocks)
    assert result.upper == pytest.approx(np.linalg.norm(M, 2, axis=(1, 2)), rel=1e-12)
    assert result.lower == pytest.approx(result.upper, rel=1e-12)
    is_singular(M, blocks, result)


@pytest.mark.parametrize(
    "blocks",
    [
        [FullBlock("a", 2, 2), FullBlock("b", 2, 2)],
        [FullBlock("a", 1, 3), FullBlock("b", 2, 1)],
        [ComplexBlock("a"), FullBlock("b", 2, 3)],
    ],
    ids=["2x2, 2x2", "1x3, 2x1", "scalar, 2x3"],
)
def test_two_complex_blocks_equal_the_best_d_scaling(blocks):
    """With up to three full blocks mu equals inf sigma_max(D M D^-1) (Doyle 1982): one parameter,
    minimised here by Brent.
    """
    M = random_matrices(7, blocks)
    result = mu_bounds(M, blocks, tolerance=1e-7)

    def scaled(log_d, m):
        d_z = np.repeat([np.exp(log_d), 1.0], [b.n_z for b in blocks])
        d_w = np.repeat([np.exp(log_d), 1.0], [b.n_w for b in blocks])
        return np.linalg.norm(d_z[:, None] * m / d_w, 2)

    truth = np.array(
        [minimize_scalar(scaled, bracket=(-1, 1), args=(m,), tol=1e-10).fun for m in M]
    )
    assert result.upper == pytest.approx(truth, rel=1e-6)
    assert result.lower == pytest.approx(truth, rel=1e-3)
    is_singular(M, blocks, result)


def two_real_parameters(m):
    """mu for two real scalars, exactly: 1 - a d - b e + c d e = 0 with real d, e."""
    a = m[0, 0]
    b = m[1, 1]
    c = np.linalg.det(m)
    # e = (1 - a d) / (b - c d) must be real: Im((1 - a d) conj(b - c d)) = 0, a quadratic in d
    roots = np.roots([(a * np.conj(c)).imag, (-np.conj(c) - a * np.conj(b)).imag, np.conj(b).imag])
    best = 0.0
    for d in roots[np.abs(roots.imag) < 1e-12 * (1 + np.abs(roots.real))].real:
        e = ((1 - a * d) / (b - c * d)).real
        best = max(best, 1 / max(abs(d), abs(e)))
    return best


def test_two_real_parameters_alone():
    blocks = [RealBlock("d"), RealBlock("e")]
    M = random_matrices(11, blocks, 4 * COUNT)
    result = mu_bounds(M, blocks)
    truth = np.array([two_real_parameters(m) for m in M])
    assert (truth == 0).any()
    assert (truth > 0).any()
    assert (result.upper >= truth * (1 - 1e-9)).all()
    assert (result.lower <= truth * (1 + 1e-6)).all()
    is_singular(M, blocks, result)
    assert (np.abs(result.lower - truth) <= 1e-3 * truth).mean() >= 0.9
    assert (result.lower[truth == 0] == 0).all()


def three_real_parameters(m, limit):
    """mu for three real scalars: one scanned, the other two exact; a few scans with each order of
    the parameters.
    """
    best = np.inf
    c = np.linspace(-limit, limit, 4001)
    for order in ((0, 1, 2), (1, 2, 0), (0, 2, 1)):
        p = m[np.ix_(order, order)]
        F = p[:2, :2] + (c / (1 - p[2, 2] * c))[:, None, None] * (p[:2, 2:] @ p[2:, :2])
        a = F[:, 0, 0]
        b = F[:, 1, 1]
        det = np.linalg.det(F)
        A2 = (a * det.conj()).imag
        A1 = (-det.conj() - a * b.conj()).imag
        A0 = b.conj().imag
        root = A1**2 - 4 * A2 * A0
        for sign in (1, -1):
            d = (-A1 + sign * np.sqrt(np.maximum(root, 0))) / (2 * A2)
            e = ((1 - a * d) / (b - det * d)).real
            size = np.maximum(np.maximum(np.abs(d), np.abs(e)), np.abs(c))
            best = min(best, size[root >= 0].min(initial=np.inf))
    return 1 / best


def test_three_real_parameters_alone():
    blocks = [RealBlock(name) for name in "abc"]
    rng = np.random.default_rng(3)
    M = rng.standard_normal((COUNT, 3, 3)) + 1j * rng.standard_normal((COUNT, 3, 3))
    result = mu_bounds(M, blocks)
    truth = np.array(
        [
            three_real_parameters(m, 3 / max(upper, 1e-3))
            for m, upper in zip(M, result.upper, strict=True)
        ]
    )
    assert (result.upper >= truth * (1 - 1e-9)).all()
    is_singular(M, blocks, result)
    assert (result.lower >= truth * (1 - 1e-3)).mean() >= 0.9
    assert (result.lower <= truth * (1 + 2e-3)).all()  # the scan's resolution


def test_real_repeated_alone_is_the_largest_real_eigenvalue():
    M = random_matrices(12, [RealBlock("d", 3)]).real
    result = mu_bounds(M, [RealBlock("d", 3)])
    values = np.linalg.eigvals(M)
    truth = np.where(np.abs(values.imag) < 1e-12, np.abs(values.real), 0).max(axis=1)
    assert result.lower == pytest.approx(truth, rel=1e-9)
    assert (result.upper >= truth).all()


RANK_ONE = [
    [RealBlock("a"), RealBlock("b"), ComplexBlock("c")],
    [RealBlock("a", 2), ComplexBlock("c", 2), FullBlock("f", 2, 3)],
    [RealBlock("a"), RealBlock("b"), RealBlock("c"), FullBlock("f", 2, 2)],
    [RealBlock("a", 2), RealBlock("b"), ComplexBlock("c"), ComplexBlock("e", 2)],
]


@pytest.mark.parametrize(
    "blocks",
    RANK_ONE,
    ids=lambda blocks: ", ".join(type(b).__name__[:1] + str(b.n_w) for b in blocks),
)
def test_rank_one_closed_form(blocks):
    """M = u v^H: mu = max real part reachable by v^H Delta u with zero imaginary part, and the
    upper bound is exact (Young).
    """
    rng = np.random.default_rng(5)
    n_z, n_w = sum(b.n_z for b in blocks), sum(b.n_w for b in blocks)
    u, v = (
        rng.standard_normal((COUNT, n)) + 1j * rng.standard_normal((COUNT, n)) for n in (n_z, n_w)
    )
    result = mu_bounds(u[:, :, None] * v[:, None, :].conj(), blocks, tolerance=1e-6)
    for k in range(COUNT):
        terms = []
        radius = 0.0
        i = 0
        j = 0
        for block in blocks:
            vi, ui = v[k, i : i + block.n_w], u[k, j : j + block.n_z]
            if isinstance(block, RealBlock):
                terms.append(vi.conj() @ ui)
            elif isinstance(block, ComplexBlock):
                radius += abs(vi.conj() @ ui)
            else:
                radius += np.linalg.norm(vi) * np.linalg.norm(ui)
            i, j = i + block.n_w, j + block.n_z
        a = np.array(terms)

        # support function of (segment sum + disc) in the direction (1, s); its minimum is where the
        # real axis leaves the set
        def support(s, a=a, radius=radius):
            return np.abs(a.real + s * a.imag).sum() + radius * np.hypot(1, s)

        truth = minimize_scalar(support, bracket=(-1, 1), tol=1e-12).fun
        assert result.upper[k] == pytest.approx(truth, rel=1e-4)
        assert result.upper[k] >= truth * (1 - 1e-9)
        assert result.lower[k] <= truth * (1 + 1e-9)
    assert (result.gap < 1e-3).mean() >= 0.9
