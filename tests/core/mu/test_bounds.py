"""Structured singular value: textbook values, structure of what is returned, scaling extremes,
refusals, frequency.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import ComplexBlock, FullBlock, RealBlock
from ambrose.core.mu.all_frequencies import proved_below
from ambrose.core.mu.bounds import mu_bounds, mu_peak
from ambrose.core.statespace import StateSpace

MIXED = [RealBlock("d", 2), ComplexBlock("c"), FullBlock("f", 3, 2)]


def random_matrix(seed, *shape):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


@pytest.mark.literature
def test_skogestad_postlethwaite_example_8_5():
    """Multivariable Feedback Control, 2nd edition, example 8.5: M = [[2, 2], [-1, -1]]."""
    M = [[2, 2], [-1, -1]]
    full = mu_bounds(M, [FullBlock("f", 2, 2)])
    assert float(full.upper) == pytest.approx(np.sqrt(10), rel=1e-12)
    assert full.worst()["f"] == pytest.approx(np.array([[0.2, -0.1], [0.2, -0.1]]))
    for block in (ComplexBlock, RealBlock):
        diagonal = mu_bounds(M, [block("a"), block("b")])
        assert float(diagonal.upper) == pytest.approx(3.0, rel=1e-6)
        assert float(diagonal.lower) == pytest.approx(3.0, rel=1e-6)
        worst = diagonal.worst()
        assert (worst["a"], worst["b"]) == (
            pytest.approx(1 / 3, rel=1e-6),
            pytest.approx(-1 / 3, rel=1e-6),
        )
    assert float(mu_bounds(M, [ComplexBlock("c", 2)]).upper) == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize(
    ("m", "mu"), [(6.78j, 0.0), (5.34, 5.34), (-5.34, 5.34), (0.0, 0.0), (3 + 1e-3j, 0.0)]
)
def test_one_real_scalar(m, mu):
    result = mu_bounds([[m]], [RealBlock("d")])
    assert float(result.lower) == pytest.approx(mu, rel=1e-12)
    assert float(result.upper) == pytest.approx(mu, rel=1e-6, abs=1e-6)
    assert float(mu_bounds([[m]], [RealBlock("d")], g_scaling=False).upper) == pytest.approx(
        abs(m), rel=1e-12
    )


def test_real_structure_matters_and_the_order_of_bounds_holds():
    """Refining the structure can only lower mu: full >= repeated complex and diagonal complex >=
    real.
    """
    M = random_matrix(1, 50, 3, 3)
    full = mu_bounds(M, [FullBlock("f", 3, 3)]).upper
    diagonal = mu_bounds(M, [ComplexBlock(n) for n in "abc"]).upper
    repeated = mu_bounds(M, [ComplexBlock("c", 3)]).upper
    real = mu_bounds(M, [RealBlock(n) for n in "abc"]).upper
    slack = 1 + 1e-4
    assert (diagonal <= full * slack).all()
    assert (repeated <= diagonal * slack).all()
    assert (real <= diagonal * slack).all()
    assert (real < 0.9 * diagonal).any()


def test_the_scalings_prove_the_upper_bound():
    """M^H D_z^2 M + j (G M - M^H G^H) <= upper^2 D_w^2, and D, G have the block structure;
    evaluated from the definition.
    """
    M = random_matrix(2, 20, 5, 6)
    result = mu_bounds(M, MIXED, lower=False)
    for m, upper, D_w, D_z, G in zip(
        M, result.upper, result.D_w, result.D_z, result.G, strict=True
    ):
        gap = (
            m.conj().T @ D_z @ D_z @ m
            + 1j * (G @ m - m.conj().T @ G.conj().T)
            - upper**2 * D_w @ D_w
        )
        size = np.linalg.norm(upper**2 * D_w @ D_w, 2)
        assert np.linalg.eigvalsh(gap).max() <= 1e-9 * size
        assert D_w[:3, :3] == pytest.approx(D_z[:3, :3])
        assert np.linalg.eigvalsh(D_w[:2, :2]).min() > 0
        assert D_w[3:, 3:] == pytest.approx(np.eye(3))  # the last block is the unit
        assert D_z[3:, 3:] == pytest.approx(np.eye(2))
        assert G[:2, :2] == pytest.approx(G[:2, :2].conj().T)
        G[:2, :2] = 0
        assert not G.any()


def test_complex_scalings_give_the_bound_as_a_singular_value():
    """With g_scaling=False, upper = sigma_max(D_z M D_w^-1): what D-K iteration fits."""
    M = random_matrix(3, 20, 5, 6)
    result = mu_bounds(M, MIXED, g_scaling=False, lower=False)
    assert not result.G.any()
    scaled = result.D_z @ M @ np.linalg.inv(result.D_w)
    assert np.linalg.norm(scaled, 2, axis=(1, 2)) == pytest.approx(result.upper, rel=1e-9)
    assert (mu_bounds(M, MIXED, lower=False).upper <= result.upper * (1 + 1e-4)).all()


def test_batches_of_any_shape_and_one_matrix():
    M = random_matrix(4, 2, 3, 5, 6)
    batch = mu_bounds(M, MIXED)
    assert batch.upper.shape == batch.lower.shape == (2, 3)
    assert batch.D_w.shape == (2, 3, 6, 6)
    assert batch.delta.shape == (2, 3, 6, 5)
    assert batch.gap.shape == (2, 3)
    single = mu_bounds(M[1, 2], MIXED)
    assert float(single.upper) == pytest.approx(batch.upper[1, 2], rel=2e-4)
    assert set(batch.worst((1, 2))) == {"d", "c", "f"}
    assert mu_bounds(M[:0], MIXED).upper.shape == (0, 3)


def test_zero_matrix():
    result = mu_bounds(np.zeros((2, 5, 6)), MIXED)
    assert not result.upper.any()
    assert not result.lower.any()
    assert np.isnan(result.delta).all()
    assert np.isfinite(result.D_w).all()


def test_scaling_of_units_changes_nothing():
    """Channel units from 1e-9 to 1e9: mu is invariant to a scaling that commutes with Delta, and
    homogeneous.
    """
    M = random_matrix(5, 4, 5, 6)
    plain = mu_bounds(M, MIXED)
    rng = np.random.default_rng(0)
    d = 10 ** rng.uniform(-9, 9, 4)
    d_z, d_w = d[[0, 1, 2, 3, 3]], d[[0, 1, 2, 3, 3, 3]]
    scaled = mu_bounds(d_z[:, None] * M / d_w, MIXED)
    assert scaled.upper == pytest.approx(plain.upper, rel=1e-3)
    assert scaled.lower == pytest.approx(plain.lower, rel=1e-2)
    for factor in (1e-9, 1e9, 1e150, 1e-150):
        assert mu_bounds(factor * M, MIXED).upper == pytest.approx(factor * plain.upper, rel=1e-3)


@pytest.mark.parametrize("exponent", [9, 12])
def test_entries_over_eighteen_decades(exponent):
    """Independent entries from 1e-9 to 1e9 (nothing to balance): finite, ordered bounds."""
    rng = np.random.default_rng(exponent)
    M = random_matrix(6, 30, 5, 6) * 10 ** rng.uniform(-exponent, exponent, (30, 5, 6))
    result = mu_bounds(M, MIXED)
    assert np.isfinite(result.upper).all()
    assert (result.lower <= result.upper).all()
    assert np.median(result.gap) < 1e-3


def test_triangular_matrix_whose_best_scaling_is_at_infinity():
    """mu of a block triangular M is that of its diagonal; the infimum over D is not attained."""
    M = np.array([[2.0, 1e3], [0.0, 1.0]])
    result = mu_bounds(M, [ComplexBlock("a"), ComplexBlock("b")])
    assert float(result.lower) == pytest.approx(2.0, rel=1e-9)
    assert 2.0 <= float(result.upper) < 2.0 * (1 + 1e-3)


def test_repeated_real_block_closes_the_gap():
    """delta I_2 with an 8 x 8 performance block, 30 matrices: gap below 0.1 %."""
    M = random_matrix(7, 30, 10, 10)
    result = mu_bounds(M, [RealBlock("k", 2), FullBlock("perf", 8, 8)])
    assert result.gap.max() < 1e-3


def test_repeated_is_not_two_independent_parameters():
    """Two independent reals are a larger set than one repeated: the bound must tell them apart."""
    M = random_matrix(8, 20, 6, 6)
    repeated = mu_bounds(M, [RealBlock("k", 2), FullBlock("f", 4, 4)])
    independent = mu_bounds(M, [RealBlock("k"), RealBlock("l"), FullBlock("f", 4, 4)])
    assert (independent.upper >= repeated.lower).all()
    assert (independent.lower > repeated.upper).any()


@pytest.mark.parametrize(
    ("M", "blocks", "words"),
    [
        (np.eye(3), [FullBlock("perf", 2, 2)], ["(3, 3)", "(..., 2, 2)", "perf"]),
        (np.zeros((3, 2)), [FullBlock("perf", 3, 2)], ["(3, 2)", "(..., 2, 3)", "maps w to z"]),
        ([[1.0, np.nan], [0, 1]], [ComplexBlock("c", 2)], ["M[0, 1]", "nan", "finite"]),
        (np.eye(2), [], ["empty"]),
        (np.eye(2), ["d", "e"], ["'d'", "RealBlock"]),
        (np.ones(2), [ComplexBlock("c", 2)], ["(2,)"]),
    ],
)
def test_refusals_name_sizes_and_remedy(M, blocks, words):
    with pytest.raises(InvalidInput) as error:
        mu_bounds(M, blocks)
    for word in words:
        assert word in str(error.value)


def test_empty_block_is_refused():
    with pytest.raises(InvalidInput, match="empty"):
        RealBlock("d", 0)
    with pytest.raises(InvalidInput, match="tolerance"):
        mu_bounds(np.eye(2), [ComplexBlock("c", 2)], tolerance=0)
    with pytest.raises(InvalidInput, match="max_iterations"):
        mu_bounds(np.eye(2), [ComplexBlock("c", 2)], max_iterations=0)


def test_an_early_stop_still_gives_bounds():
    M = random_matrix(9, 10, 5, 6)
    rough, fine = mu_bounds(M, MIXED, max_iterations=2), mu_bounds(M, MIXED)
    assert (rough.upper >= fine.upper * (1 - 1e-9)).all()
    assert (rough.upper >= fine.lower).all()


# ---- over frequency
# -------------------------------------------------------------------------------------------------


def resonant(damping=0.002):
    """Two lightly damped modes at 10 and 37 rad/s seen by three channels."""
    A = np.zeros((4, 4))
    for i, w in ((0, 10.0), (2, 37.0)):
        A[i : i + 2, i : i + 2] = [[-damping * w, w], [-w, -damping * w]]
    rng = np.random.default_rng(3)
    B, C = rng.standard_normal((4, 3)), rng.standard_normal((3, 4))
    return StateSpace(A, B, C, 0.1 * np.eye(3))


BLOCKS = [RealBlock("k"), FullBlock("perf", 2, 2)]


def fine_peak(system, blocks, low, high):
    omega = np.linspace(low, high, 2001)
    values = mu_bounds(frequency_response(system, omega).values, blocks, lower=False).upper
    return values.max(), omega[values.argmax()]


def test_peak_between_grid_points_is_found():
    """The resonance at 10 rad/s is 0.04 rad/s wide; the grid is 20 times coarser."""
    system = resonant()
    omega = np.geomspace(1, 100, 40)
    coarse = mu_bounds(frequency_response(system, omega).values, BLOCKS, lower=False).upper.max()
    peak = mu_peak(system, BLOCKS, omega)
    truth, at = fine_peak(system, BLOCKS, peak.frequency * 0.99, peak.frequency * 1.01)
    assert peak.resolved
    assert peak.upper > 2 * coarse
    assert peak.upper == pytest.approx(truth, rel=3e-4)
    assert peak.frequency == pytest.approx(at, rel=1e-3)
    assert peak.lower <= peak.upper
    assert peak.lower > 0.99 * peak.upper
    M = frequency_response(system, [peak.lower_frequency]).values[0]
    assert np.linalg.svd(np.eye(3) - M @ peak.delta, compute_uv=False)[-1] < 1e-7
    assert np.linalg.norm(peak.delta, 2) == pytest.approx(1 / peak.lower, rel=1e-6)


def test_peak_of_a_callable_and_without_lower_bound():
    system = resonant(0.05)
    peak = mu_peak(
        lambda omega: frequency_response(system, omega).values,
        BLOCKS,
        np.geomspace(1, 100, 60),
        lower=False,
    )
    assert peak.upper == pytest.approx(
        mu_peak(system, BLOCKS, np.geomspace(1, 100, 60)).upper, rel=2e-4
    )
    assert peak.lower == 0


def test_a_proof_is_tight_on_both_sides():
    peak = mu_peak(resonant(), BLOCKS, np.geomspace(1, 100, 40))
    assert proved_below(resonant(), BLOCKS, peak.upper * 1.002)
    assert not proved_below(resonant(), BLOCKS, peak.upper * 0.998)


def test_a_proof_does_not_believe_the_grid():
    """A level above mu on a coarse grid but below the true peak: a grid says yes, the proof says
    no.
    """
    system = resonant()
    omega = np.geomspace(1, 100, 40)
    level = (
        1.3 * mu_bounds(frequency_response(system, omega).values, BLOCKS, lower=False).upper.max()
    )
    assert not proved_below(system, BLOCKS, level)


@pytest.mark.parametrize("count", [4, pytest.param(12, marks=pytest.mark.study)])
def test_proofs_of_random_systems_agree_with_a_fine_grid(count):
    """Random systems: never proved below a lower bound found on a grid; proved with 1 % room
    above the upper one.
    """
    rng = np.random.default_rng(8)
    blocks = [RealBlock("k", 2), FullBlock("f", 2, 2)]
    for _ in range(count):
        A = rng.standard_normal((5, 5))
        A -= (np.linalg.eigvals(A).real.max() + 0.1) * np.eye(5)
        system = StateSpace(
            A,
            rng.standard_normal((5, 4)),
            rng.standard_normal((4, 5)),
            0.3 * rng.standard_normal((4, 4)),
        )
        omega = np.concatenate([[0.0], np.geomspace(1e-2, 1e3, 60)])
        bounds = mu_bounds(frequency_response(system, omega).values, blocks, restarts=0)
        assert not proved_below(system, blocks, bounds.lower.max() * (1 - 1e-6))
        peak = mu_peak(system, blocks, omega, lower=False)
        assert proved_below(system, blocks, max(peak.upper, bounds.upper.max()) * 1.01)


def test_a_proof_gives_up_within_its_intervals():
    peak = mu_peak(resonant(), BLOCKS, np.geomspace(1, 100, 40), lower=False)
    assert not proved_below(resonant(), BLOCKS, peak.upper * 1.002, max_intervals=1)


def test_refusals_over_frequency():
    with pytest.raises(InvalidInput, match="shape of M"):
        proved_below(resonant(), [FullBlock("f", 2, 2)], 1.0)
    with pytest.raises(InvalidInput, match="start"):
        proved_below(resonant(), BLOCKS, -1.0)
    with pytest.raises(InvalidInput, match="omega"):
        mu_peak(resonant(), BLOCKS, [1.0, 2.0])
    with pytest.raises(InvalidInput, match="shape of M"):
        mu_peak(resonant(), [FullBlock("f", 2, 2)], [1.0, 2.0, 3.0])


def test_never_a_hang():
    """The hardest kinds in one call each, within seconds: many real blocks alone, and a large
    repeated block.
    """
    start = time.process_time()
    mu_bounds(random_matrix(10, 10, 8, 8), [RealBlock(f"d{i}") for i in range(8)])
    mu_bounds(random_matrix(11, 3, 8, 8), [RealBlock("d", 6), FullBlock("f", 2, 2)])
    assert time.process_time() - start < 30
