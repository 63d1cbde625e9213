"""Chords of a response and levels of mu proved at all frequencies, against dense evaluation, norms
and closed forms.
"""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput, NumericalFailure, UnstableSystem
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import ComplexBlock, FullBlock, RealBlock
from ambrose.core.mu import all_frequencies
from ambrose.core.mu.all_frequencies import chords, modal_chords, proved_below, proved_level
from ambrose.core.mu.bounds import mu_peak
from ambrose.core.mu.upper import UpperBound
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace, append


def random_system(seed: int, states: int = 6, ports: int = 3) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(states, states))
    A -= (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-3, -0.3)) * np.eye(states)
    return StateSpace(
        A,
        rng.normal(size=(states, ports)),
        rng.normal(size=(ports, states)),
        0.2 * rng.normal(size=(ports, ports)),
    )


def filter_chain(order: int) -> StateSpace:
    """1/(s + 1)^order: one pole without a second eigenvector."""
    A = -np.eye(order) + np.eye(order, k=-1)
    return StateSpace(A, np.eye(order)[:, :1], np.eye(order)[-1:], [[0.0]], ["in"], ["out"])


SYSTEMS = [
    *(random_system(seed) for seed in range(6)),
    filter_chain(5),
    append(filter_chain(3), random_system(9, 4, 2)),
]


@pytest.mark.parametrize("system", SYSTEMS)
def test_nothing_lies_farther_from_a_chord_than_its_bound(system):
    model, cells = chords(system), 4
    ends = np.concatenate([[0.0], np.geomspace(1e-3, 1e2, 120)])
    bound = model.distance(ends[:-1], ends[1:], cells)
    used = 0
    for low, high, most in zip(ends[:-1], ends[1:], bound, strict=True):
        points = np.linspace(low, high, cells * 8 + 1)
        M = frequency_response(system, points).values
        share = np.linspace(0, 1, 9)[:, None, None]
        for i in range(cells):
            part = M[8 * i : 8 * i + 9]
            apart = np.abs(part - (1 - share) * part[0] - share * part[-1]).max(axis=0)
            assert (apart <= most * (1 + 1e-6) + 1e-9 * np.abs(M).max()).all()
            used = max(
                used, float((apart / np.maximum(most, 1e-300))[apart > 1e-6].max(initial=0.0))
            )
    assert used > 0.9  # and the bound is no larger than it must be
    for low in (1.0, 30.0, 1e3):
        beyond = frequency_response(system, low * np.geomspace(1, 100, 50)).values - system.D
        assert (
            np.abs(beyond).max(axis=0)
            <= model.distance(np.array([low]), np.array([np.inf]), cells)[0] + 1e-12
        ).all()


@pytest.mark.parametrize("system", SYSTEMS)
def test_values_and_slopes(system):
    model, omega = chords(system), np.geomspace(1e-2, 1e2, 40)
    M = frequency_response(system, omega).values
    np.testing.assert_allclose(model.at(omega), M, atol=1e-9 * np.abs(M).max())
    np.testing.assert_allclose(model.at(np.array([np.inf]))[0], system.D)
    slope = (model.at(omega * (1 + 1e-6)) - model.at(omega * (1 - 1e-6))) / (
        2e-6 * omega[:, None, None]
    )
    values, slopes = zip(*(model.with_slope(one) for one in omega.tolist()), strict=True)
    np.testing.assert_allclose(values, M, atol=1e-9 * np.abs(M).max())
    np.testing.assert_allclose(slopes, slope, atol=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize("seed", range(4))
def test_a_full_block_gives_the_norm(seed):
    """mu of one full block is the largest singular value: its level at all frequencies is the
    H-infinity norm.
    """
    system = random_system(seed)
    norm = hinf_norm(system).value
    found = proved_level(system, [FullBlock("all", 3, 3)], 0.5 * norm, room=1e-3)
    assert norm < found.level < 1.003 * norm
    assert not proved_below(system, [FullBlock("all", 3, 3)], 0.999 * norm)


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.study) for seed in (2, 3))]
)
def test_no_level_is_below_mu_anywhere(seed):
    blocks = [RealBlock("r"), ComplexBlock("c"), FullBlock("f", 1, 1)]
    system = random_system(seed)
    peak = mu_peak(system, blocks, np.geomspace(1e-2, 1e2, 150))
    found = proved_level(system, blocks, 0.5 * peak.lower)
    assert peak.lower < found.level < 1.01 * peak.upper
    assert not proved_below(system, blocks, 0.99 * peak.lower)


def test_a_peak_far_narrower_than_any_grid():
    """Damping 1e-6: the peak is 1/(2 zeta), and a level that only forgets the peak is refused."""
    zeta = 1e-6
    system = StateSpace([[0, 1], [-1, -2 * zeta]], [[0], [1]], [[1, 0]], [[0]])
    assert not proved_below(system, [ComplexBlock("c")], 0.4 / zeta)
    assert proved_below(system, [ComplexBlock("c")], 0.51 / zeta)


def test_a_direct_term_that_leaves_one_way_only():
    """1 + 0.1 d/(s + 1 - 0.01 d), |d| <= 1: 1 + 0.1/0.99 at s = 0, d = 1. At infinity nothing comes
    back from d, so that the scalings of the direct term alone are without bound.
    """
    system = StateSpace([[-1.0]], [[1.0, 0.0]], [[0.01], [1e-6]], [[0.0, 1e5], [0.0, 1.0]])
    blocks = [RealBlock("d"), FullBlock("gain", 1, 1)]
    found = proved_level(system, blocks, 1.0, skew=np.array([False, True]), room=1e-3)
    worst = 1 + 0.1 / 0.99
    assert worst < found.level < 1.003 * worst


def test_refusals(monkeypatch):
    with pytest.raises(UnstableSystem, match="real part"):
        chords(StateSpace([[1.0]], [[1.0]], [[1.0]], [[0.0]]))
    with pytest.raises(InvalidInput, match="continuous"):
        chords(StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1))
    system = random_system(0)
    with pytest.raises(InvalidInput, match="shape of M"):
        proved_level(system, [FullBlock("f", 2, 2)], 1.0)
    with pytest.raises(NumericalFailure, match="not proved below"):
        proved_level(system, [FullBlock("f", 3, 3)], 1e-3, highest=2e-3)
    with pytest.raises(NumericalFailure, match="did not suffice"):
        proved_level(system, [FullBlock("f", 3, 3)], 100 * hinf_norm(system).value, max_intervals=2)

    def singular(*arguments, **options):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(all_frequencies, "osborne", singular)
    assert proved_below(system, [FullBlock("f", 3, 3)], 1e3) is False


def test_a_parameter_that_hardly_matters_spoils_no_proof():
    """Its G may be 1e6 where its row of M is 1e-9: the set is |m|^2 < 1 of the other one."""
    one = np.eye(2)[None] + 0j
    G = np.diag([0.0, 1e6])[None] + 0j
    scalings = UpperBound(np.array([0.9]), one, one, G, np.zeros((1, 2)))
    for m, inside in ((0.99, True), (1.01, False)):
        M = np.broadcast_to(np.diag([m, 1e-9]) + 0j, (1, 2, 2, 2))
        good = all_frequencies._contained(scalings, M, np.zeros((1, 1, 2, 2)))
        assert good.tolist() == [[inside]]


@pytest.mark.parametrize("seed", range(4))
def test_rounding_is_allowed_for(seed):
    """Phi - I with the scalings of a random block, against the same in extended precision."""
    rng = np.random.default_rng(seed)
    n, digits = 6, np.finfo(np.longdouble).eps
    assert digits < np.finfo(float).eps, "this platform has no extended precision"

    def drawn(*shape):
        return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)

    def definite():
        Q = np.linalg.qr(drawn(n, n))[0]
        return (Q * np.geomspace(1e-6, 1.0, n)) @ Q.conj().T

    H = drawn(n, n)
    scalings = UpperBound(
        np.ones(1),
        definite()[None],
        definite()[None],
        1e3 * (H + H.conj().T)[None],
        np.ones((1, n)),
    )
    M = drawn(1, 1, n, n)
    L_w, L_z = np.linalg.cholesky(scalings.X_w), np.linalg.cholesky(scalings.X_z)
    R = np.linalg.inv(L_w)[0]
    N = L_z[0].conj().T @ M[0, 0] @ R.conj().T
    cross = 1j * (R @ scalings.G[0] @ np.linalg.inv(L_z)[0].conj().T) @ N
    Phi = N.conj().T @ N + cross + cross.conj().T - np.eye(n)

    # the inequality itself, under the same congruence, with every product in extended precision
    exact = [np.asarray(part, np.clongdouble) for part in (R, M[0, 0])]
    X_w, X_z, G = (
        np.asarray(part[0], np.clongdouble) for part in (scalings.X_w, scalings.X_z, scalings.G)
    )
    R, m = exact
    inner = m.conj().T @ X_z @ m + 1j * (G @ m - m.conj().T @ G.conj().T) - X_w
    error = np.linalg.norm((R @ inner @ R.conj().T - Phi).astype(complex))
    allowed = float(all_frequencies._rounding(scalings, L_w, L_z, M)[0])
    assert 0 < error < allowed


@pytest.mark.parametrize("system", SYSTEMS)
def test_values_are_those_of_the_system_from_rest_to_infinity(system):
    """Real poles, pairs and clusters, stable or not."""
    grid = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 300)])
    turned = StateSpace(-system.A, system.B, system.C, system.D)
    for one in (system, turned):
        apart = modal_chords(one).at(grid) - frequency_response(one, grid).values
        assert np.abs(apart).max() <= 1e-11 * np.abs(frequency_response(one, grid).values).max()
    np.testing.assert_array_equal(modal_chords(system).at(np.array([np.inf]))[0], system.D)


def test_the_values_beside_a_light_pole_keep_their_digits():
    """1 / (s^2 + 2 zeta s + 1) at its resonance: 1 / (2 j zeta)."""
    zeta = 1e-7
    one = StateSpace([[0.0, 1.0], [-1.0, -2 * zeta]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    assert chords(one).at(np.array([1.0]))[0, 0, 0] == pytest.approx(-0.5j / zeta, rel=1e-8)
