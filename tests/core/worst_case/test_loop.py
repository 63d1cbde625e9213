"""Real parameters in a box, against eigenvalues, closed forms and scans."""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput, UnstableSystem
from ambrose.core.lft import ComplexBlock, FullBlock, GeneralizedPlant, RealBlock, close_uncertainty
from ambrose.core.mu.bounds import mu_bounds
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace
from ambrose.core.worst_case import _log_gain, gain_bound, peak_at, proved_margin, worst_gain
from ambrose.core.worst_case_loop import (
    box_loop,
    box_margin,
    corners,
    count_unstable,
    gains,
    perturbed_matrix,
    samples,
    sweep,
    unstable_poles,
)


def lag(rate: float = 1.0) -> StateSpace:
    """x' = -x + delta rate x + d, e = x: stable for delta rate < 1, peak gain 1/(1 - delta rate) at
    zero frequency.
    """
    return StateSpace([[-1.0]], [[rate, 1.0]], [[1.0], [1.0]], np.zeros((2, 2)))


def whirl(stiffness: float, damping: float, cross: float) -> StateSpace:
    """A unit mass, q'' + c q' + K q = -delta k [[0, 1], [-1, 0]] q + d: stable for |delta| k < c
    sqrt(K).
    """
    J = np.array([[0.0, -1.0], [1.0, 0.0]])
    A = np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness * np.eye(2), -damping * np.eye(2)]])
    B = np.block([[np.zeros((2, 4))], [np.eye(2), np.eye(2)]])
    C = np.block([[cross * J, np.zeros((2, 2))], [np.eye(2), np.zeros((2, 2))]])
    return StateSpace(A, B, C, np.zeros((4, 4)))


def random_loop(rng: np.random.Generator, parameters: int, states: int = 6, direct: float = 0.0):
    """A stable loop whose parameters are strong enough to destabilise it now and then."""
    repeats = rng.integers(1, 3, parameters)
    n = int(repeats.sum())
    A = rng.normal(size=(states, states))
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.05, 0.5)) * np.eye(states)
    B, C = rng.normal(size=(states, n + 2)), rng.normal(size=(n + 2, states))
    B[:, :n] *= 0.3
    D = np.zeros((n + 2, n + 2))
    D[:n, :n] = direct * rng.normal(size=(n, n))
    blocks = [RealBlock(f"p{i}", int(r)) for i, r in enumerate(repeats)]
    return box_loop(StateSpace(A, B, C, D), blocks)


def eigenvalue_count(loop, delta: np.ndarray) -> np.ndarray:
    return np.array([(np.linalg.eigvals(perturbed_matrix(loop, d)).real > 0).sum() for d in delta])


@pytest.mark.parametrize("direct", [0.0, 0.1])
def test_unstable_poles_equal_the_eigenvalues(direct):
    rng = np.random.default_rng(4)
    seen: list[int] = []
    for _ in range(15):
        loop = random_loop(rng, int(rng.integers(1, 5)), direct=direct)
        delta = np.vstack(
            [
                corners(loop.parameters),
                samples(loop.parameters, 20),
                2.5 * samples(loop.parameters, 10),
            ]
        )
        expected = eigenvalue_count(loop, delta)
        np.testing.assert_array_equal(unstable_poles(loop, delta), expected)
        seen += expected.tolist()
    assert {0, 1, 2} <= set(seen)  # the loops do lose stability, by real poles and by pairs


def test_unstable_poles_next_to_the_axis():
    """A lightly damped whirl on either side of its limit, 1e-6 of it away."""
    loop = box_loop(whirl(400.0, 0.02, 1.0), [RealBlock("k", 2)])
    limit = 0.02 * 20.0
    delta = limit * np.array([[1 - 1e-6], [1 + 1e-6], [-1 - 1e-6], [-1 + 1e-6], [0.0]])
    assert unstable_poles(loop, delta).tolist() == [0, 2, 2, 0, 0]


def test_perturbed_matrix_is_the_upper_lft():
    rng = np.random.default_rng(1)
    loop = random_loop(rng, 2, direct=0.2)
    n, p = len(loop.owner), loop.system.D.shape[0]
    plant = GeneralizedPlant(
        loop.system,
        loop.system.inputs[:n],
        loop.system.inputs[n:],
        loop.system.outputs[:n],
        loop.system.outputs[n:],
        loop.blocks,
    )
    closed = close_uncertainty(plant, {"p0": 0.7, "p1": -0.4})
    delta = np.array([0.7, -0.4])
    np.testing.assert_allclose(perturbed_matrix(loop, delta), closed.A, atol=1e-12)
    omega = np.array([0.1, 1.3, 20.0])
    expected = [
        np.linalg.norm(
            closed.C @ np.linalg.solve(1j * w * np.eye(6) - closed.A, closed.B) + closed.D, 2
        )
        for w in omega
    ]
    np.testing.assert_allclose(gains(loop.at(omega), loop, delta[None])[0], expected, rtol=1e-10)
    assert p == n + 2


def test_modes_that_lose_stability_in_pairs():
    """Two equal modes, away from the nominal poles and hardly unstable: their full turn hides
    between grid points.
    """
    for shift in (0.21, 0.34, 0.5):  # delta moves the frequency, and takes the damping away
        K, c = 400.0, 0.3
        A = np.array([[0.0, 1.0], [-K, -c]])
        B, C = np.array([[0.0], [1.0]]), np.array([[-shift * K, 1.00002 * c]])
        eye = np.eye(2)
        loop = box_loop(
            StateSpace(np.kron(eye, A), np.kron(eye, B), np.kron(eye, C), np.zeros((2, 2))),
            [RealBlock("p", 2)],
        )
        damping = np.linalg.eigvals(perturbed_matrix(loop, np.ones(1))).real
        assert (damping > 0).all() and (damping < 1e-5).all()
        assert unstable_poles(loop, np.array([[1.0], [0.9999], [-1.0]])).tolist() == [4, 0, 0]


def test_sweep_grows_with_what_was_added():
    loop = box_loop(whirl(400.0, 0.02, 1.0), [RealBlock("k", 2)])
    coarse = sweep(loop)
    count, fine = count_unstable(loop, np.array([[0.4001]]), coarse)
    assert count[0] == 2
    assert len(fine.omega) > len(coarse.omega)
    assert (np.diff(fine.omega) > 0).all()
    np.testing.assert_allclose(fine.M11[:-1], loop.at(fine.omega)[:-1, :2, :2], atol=1e-12)
    again = count_unstable(loop, np.array([[0.4001]]), fine)[1]
    assert len(again.omega) == len(fine.omega)


@pytest.mark.parametrize("rate", [0.3, -1.7, 4.0])
def test_margin_of_a_lag(rate):
    margin = box_margin(box_loop(lag(rate), [RealBlock("p")]))
    assert margin.factor == pytest.approx(1 / abs(rate), rel=2e-5)
    assert margin.delta[0] == pytest.approx(1 / rate, rel=2e-5)
    assert margin.frequency == pytest.approx(0, abs=1e-9)


def test_margin_of_a_whirl():
    """c sqrt(K) / k, at the frequency sqrt(K), for either sign."""
    loop = box_loop(whirl(900.0, 0.5, 3.0), [RealBlock("k", 2)])
    margin = box_margin(loop)
    assert margin.factor == pytest.approx(0.5 * 30 / 3.0, rel=2e-5)
    assert margin.frequency == pytest.approx(30, rel=1e-4)
    proved = proved_margin(loop, margin.factor).value
    assert 0.93 * margin.factor < proved < margin.factor


def test_margin_beyond_all_bounds():
    loop = box_loop(lag(1e-3), [RealBlock("p")])
    margin = box_margin(loop)
    assert np.isinf(margin.factor) and np.isnan(margin.delta).all()
    assert proved_margin(loop, margin.factor).value > 19


@pytest.mark.parametrize("count", [4, pytest.param(8, marks=pytest.mark.study)])
def test_margins_of_random_loops_enclose_the_truth(count):
    """proved <= the smallest unstable scale of many random directions, and the search finds no
    larger one.
    """
    rng = np.random.default_rng(9)
    compared = 0
    for _ in range(count):
        loop = random_loop(rng, 2)
        margin = box_margin(loop)
        if not np.isfinite(margin.factor):
            continue
        compared += 1
        assert eigenvalue_count(loop, 1.0001 * margin.delta[None])[0] > 0  # it does destabilise
        angle = np.linspace(0, 2 * np.pi, 361)
        directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        directions /= np.abs(directions).max(axis=1, keepdims=True)
        assert (eigenvalue_count(loop, 0.97 * margin.factor * directions) == 0).all()
        assert proved_margin(loop, margin.factor).value <= margin.factor
    assert compared >= 3 * count / 4


def test_worst_gain_of_a_lag():
    loop = box_loop(lag(0.5), [RealBlock("p")])
    worst = worst_gain(loop)
    # at zero frequency, which a logarithmic grid only approaches
    assert worst.value == pytest.approx(2.0, rel=1e-3)
    assert worst.delta[0] == pytest.approx(1.0)


def test_gradient_of_the_gain():
    rng = np.random.default_rng(2)
    loop = random_loop(rng, 3, direct=0.1)
    delta = rng.uniform(-0.5, 0.5, 3)
    step = 1e-6
    omega = 0.8
    _, gradient, over_omega = _log_gain(loop, delta, omega)
    higher, lower = (_log_gain(loop, delta, omega + sign * step)[0] for sign in (1, -1))
    assert over_omega == pytest.approx((higher - lower) / (2 * step), rel=1e-6)
    for i in range(3):
        e = step * np.eye(3)[i]
        numeric = (_log_gain(loop, delta + e, omega)[0] - _log_gain(loop, delta - e, omega)[0]) / (
            2 * step
        )
        assert gradient[i] == pytest.approx(numeric, rel=1e-6, abs=1e-9)


def test_worst_gain_against_a_scan_and_its_bound():
    rng = np.random.default_rng(7)
    compared = 0
    while compared < 3:
        loop = random_loop(rng, 2)
        if unstable_poles(loop, 1.1 * np.vstack([corners(2), samples(2, 300)])).any():
            continue
        compared += 1
        axis = np.linspace(-1, 1, 15)
        delta = np.array([[a, b] for a in axis for b in axis])
        omega = np.geomspace(1e-2, 1e3, 300)
        scan = gains(loop.at(omega), loop, delta).max()
        worst = worst_gain(loop)
        assert worst.value >= scan * (1 - 1e-6)
        closed = loop.system
        n = len(loop.owner)
        at = StateSpace(
            perturbed_matrix(loop, worst.delta), closed.B[:, n:], closed.C[n:], np.zeros((2, 2))
        )
        # what is claimed is attained by that plant
        assert worst.value <= hinf_norm(at).value * (1 + 1e-6)
        near = np.unique(np.append(omega[::5], worst.frequency))
        bound = gain_bound(loop, near, worst.value)
        assert bound >= worst.value
        assert bound <= 1.3 * worst.value


def test_bound_for_one_parameter_is_tight():
    loop = box_loop(whirl(100.0, 2.0, 8.0), [RealBlock("k", 2)])
    worst = worst_gain(loop)
    bound = gain_bound(loop, np.append(np.geomspace(1, 100, 40), worst.frequency), worst.value)
    assert worst.value <= bound <= 1.005 * worst.value
    assert abs(worst.delta[0]) == pytest.approx(1.0)
    # one whirl direction at delta = 1
    axis = 1 / abs(100 - 8j - worst.frequency**2 + 2j * worst.frequency)
    assert worst.value == pytest.approx(axis, rel=1e-6)


def test_bound_is_infinite_where_the_box_is_unstable():
    loop = box_loop(lag(2.0), [RealBlock("p")])
    assert np.isinf(gain_bound(loop, np.array([1e-4, 1e-2, 1.0]), 1.0))


def test_peak_between_grid_points():
    loop = box_loop(whirl(100.0, 0.4, 0.0), [RealBlock("k", 2)])
    resonance = np.sqrt(100 - 0.4**2 / 2)
    omega, value = peak_at(loop, np.zeros(1), 8.0, 9.3, 13.0)
    assert omega == pytest.approx(resonance, rel=1e-5)
    assert value == pytest.approx(1 / (0.4 * np.sqrt(100 - 0.4**2 / 4)), rel=1e-8)


def test_refusals():
    with pytest.raises(InvalidInput, match="real parameters"):
        box_loop(lag(), [ComplexBlock("p")])
    with pytest.raises(InvalidInput, match="real parameters"):
        box_loop(lag(), [])
    with pytest.raises(InvalidInput, match="3 or more inputs"):
        box_loop(lag(), [RealBlock("p", 3)])
    with pytest.raises(UnstableSystem, match="change the controller"):
        box_loop(
            StateSpace([[0.5]], [[1.0, 1.0]], [[1.0], [1.0]], np.zeros((2, 2))), [RealBlock("p")]
        )
    with pytest.raises(InvalidInput, match="delta"):
        unstable_poles(box_loop(lag(), [RealBlock("p")]), np.zeros((1, 2)))


def test_gain_bound_asks_no_more_than_mu_below_one():
    """The same number as by bisection over the converged structured singular value of every
    frequency.
    """
    rng = np.random.default_rng(11)
    loop = random_loop(rng, 4)
    factor = 0.7 * box_margin(loop).factor
    s, n = loop.system, len(loop.owner)
    C = s.C.copy()
    C[:n] *= factor
    loop = box_loop(StateSpace(s.A, s.B, C, s.D), loop.blocks)
    worst = worst_gain(loop)
    omega = worst.frequency * np.array([0.2, 0.9, 1.0, 1.1, 4.0])
    bound = gain_bound(loop, omega, worst.value)

    def mu(gamma: float) -> float:
        M = loop.at(omega)
        M[:, n:] /= gamma
        return float(
            mu_bounds(
                M, [*loop.blocks, FullBlock("gain", 2, 2)], lower=False, tolerance=2e-4
            ).upper.max()
        )

    assert mu(bound) < 1 + 2e-4
    assert mu(bound / 1.0025) > 1 - 2e-4 or bound <= 1.002 * worst.value


@pytest.mark.parametrize("direct", [0.0, 0.1])
def test_eigenvalues_of_parameters_that_share_inputs(direct):
    """Three parameters whose inputs are combinations of two columns: the eigenvalues of the whole
    matrix without its zeros.
    """
    rng = np.random.default_rng(7)
    loop = random_loop(rng, 5, direct=direct)
    n, s = len(loop.owner), loop.system
    B, D = s.B.copy(), s.D.copy()
    for i, mix in zip(
        range(2, n),
        rng.normal(size=(n - 2, 2)) * np.geomspace(1e-6, 1e6, n - 2)[:, None],
        strict=True,
    ):
        B[:, i], D[:, i] = B[:, :2] @ mix, D[:, :2] @ mix
    loop = box_loop(StateSpace(s.A, B, s.C, D), loop.blocks)
    shared = loop.ports
    assert len(shared.inputs) == 2
    M = loop.at(np.array([0.3, 2.0]))[:, :n, :n]
    wide = rng.normal(size=(4, 1, n)) / np.linalg.norm(M[0], axis=0)
    whole = np.linalg.eigvals(M * wide[..., None, :])
    largest = np.take_along_axis(whole, np.argsort(-np.abs(whole))[..., :2], axis=-1)
    found = shared.eigenvalues(M, wide)
    assert np.sort_complex(found) == pytest.approx(np.sort_complex(largest), rel=1e-9)
