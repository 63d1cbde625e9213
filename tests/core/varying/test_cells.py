"""Proofs on cells: control nets, products in twice the precision, an inequality of its own, norms
at rest, motions in time.
"""

from __future__ import annotations

from fractions import Fraction
from functools import reduce
from itertools import pairwise
from math import comb

import numpy as np
import pytest

from ambrose.annexes.scheduled.varying_cells import (
    Cell,
    CellSearch,
    _entries,
    accurate_product,
    elevated,
    product,
    proved_on_cells,
)
from ambrose.core.checks import NumericalFailure
from ambrose.core.matrix_inequalities import Inequality, minimise, svec
from ambrose.core.norms import hinf_norm
from ambrose.core.statespace import StateSpace

C = np.array([[1.0, 0.0]])


def value(net: np.ndarray, s: float, t: float) -> np.ndarray:
    """A control net at a place of its cell."""
    a, c = len(net) - 1, net.shape[1] - 1
    S = np.array([comb(a, i) * s**i * (1 - s) ** (a - i) for i in range(a + 1)])
    T = np.array([comb(c, k) * t**k * (1 - t) ** (c - k) for k in range(c + 1)])
    return np.einsum("i,k,ik...->...", S, T, net)


def test_nets_multiply_and_rise_as_their_polynomials() -> None:
    rng = np.random.default_rng(1)
    p, net = rng.normal(size=(2, 3)), rng.normal(size=(3, 2, 4, 2))
    both, higher = product(p, net), elevated(net, (6, 5))
    assert both.shape[:2] == (4, 4) and higher.shape[:2] == (6, 5)
    for s, t in ((0.0, 1.0), (0.3, 0.8), (0.9, 0.1)):
        np.testing.assert_allclose(
            value(both, s, t), value(p[:, :, None, None], s, t) * value(net, s, t), atol=1e-13
        )
        np.testing.assert_allclose(value(higher, s, t), value(net, s, t), atol=1e-13)


def test_products_are_as_of_twice_the_precision() -> None:
    rng = np.random.default_rng(2)
    A, B = (rng.normal(size=(6, 6)) * 10.0 ** rng.integers(-8, 8, (6, 6)) for _ in range(2))
    high, low = accurate_product(A, B)
    for i in range(6):
        for k in range(6):
            exact = sum(Fraction(a) * Fraction(b) for a, b in zip(A[i], B[:, k], strict=True))
            size = sum(abs(a * b) for a, b in zip(A[i], B[:, k], strict=True))
            assert abs(Fraction(high[i, k]) + Fraction(low[i, k]) - exact) <= 1e-29 * size
    assert np.abs(low).max() > 0


def test_entries_are_of_the_chebyshev_polynomials_and_their_slopes() -> None:
    """Put together again, the entries of a cell give T_d(p) A, T_d(p) B and p' T_d'(p) everywhere
    in it.
    """
    rng = np.random.default_rng(5)
    degree = 3
    rate = 0.7
    p = np.array([[-0.9, -0.2], [0.1, 0.8]])
    A = rng.normal(size=(2, 2, 3, 3))
    B = rng.normal(size=(1, 1, 3, 2))
    entries = _entries(p, A, B, degree, rate)
    shape = (len(A) + degree, A.shape[1] + degree)
    assert len(entries) == 2 * shape[0] * shape[1]
    for sign, own in ((-1, entries[::2]), (1, entries[1::2])):
        nets = [np.array([getattr(e, name) for e in own]) for name in ("A", "B", "slope")]
        nets = [net.reshape(*shape, *net.shape[1:]) for net in nets]
        for s, t in ((0.0, 0.0), (0.3, 0.9), (1.0, 0.4)):
            here = float(value(p[:, :, None, None], s, t)[0, 0])
            for d in range(degree + 1):
                T = np.polynomial.Chebyshev.basis(d)
                found = [value(net[:, :, d], s, t) for net in nets]
                np.testing.assert_allclose(found[0], T(here) * value(A, s, t), atol=1e-12)
                np.testing.assert_allclose(found[1], T(here) * B[0, 0], atol=1e-12)
                np.testing.assert_allclose(found[2], sign * rate * T.deriv()(here), atol=1e-12)


def test_more_terms_prove_no_less_and_fewer_rows_no_more() -> None:
    cells = band(0.0)
    gains = [
        proved_on_cells(cells, C, 0.2, degree=d, share=share).gamma
        for d, share in ((3, 1.0), (1, 1.0), (1, 0.5))
    ]
    assert at_rest(cells) < gains[0] < 1.002 * gains[1] and gains[1] < 1.002 * gains[2]
    assert gains[2] < 1.002 * proved_on_cells(cells, C).gamma


def oscillator(stiffness: float, gain: float) -> np.ndarray:
    """q'' + (0.3 + gain) q' + (1 + stiffness + gain/2) q = d."""
    return np.array([[0.0, 1.0], [-1 - stiffness - gain / 2, -0.3 - gain]])


def band(error: float) -> list[Cell]:
    """Stiffness 0.5 p, and a controller that is told p within the error and damps the less the
    stiffer it believes it.
    """
    knots = sorted({-1.0, *(v for v in (-1 + error, 1 - error) if -1 < v < 1), 1.0})
    found = []
    for pair in pairwise(knots):
        p = np.array([[max(-1, told - error), min(1, told + error)] for told in pair])
        A = np.array(
            [[oscillator(0.5 * p[i, k], 0.4 - 0.3 * pair[i]) for k in (0, 1)] for i in (0, 1)]
        )
        found.append(Cell(A, np.tile([[0.0], [1.0]], (2, 2, 1, 1)), p))
    return found


def constant_gain(cells: list[Cell]) -> float:
    """The smallest gamma for one X at all corners, by an inequality assembled here."""
    basis = [
        np.array([[1.0, 0], [0, 0]]),
        np.array([[0, 1.0], [1, 0]]),
        np.array([[0, 0], [0, 1.0]]),
    ]
    items = []
    for cell in cells:
        for A, B in zip(cell.A.reshape(-1, 2, 2), cell.B.reshape(-1, 2, 1), strict=True):
            F = [-np.block([[A.T @ E + E @ A, E @ B], [B.T @ E, np.zeros((1, 1))]]) for E in basis]
            F.append(np.diag([0.0, 0, 1]))
            F0 = -np.block([[C.T @ C, C.T], [C, np.eye(1)]])
            items.append(Inequality(svec(np.array(F)).T, svec(F0), np.arange(4)))
    return float(np.sqrt(minimise(np.eye(4)[3], items, tolerance=1e-8).value))


@pytest.mark.parametrize("error", [0.0, 0.5])
def test_any_speed_is_the_smallest_gamma_of_one_function(error: float) -> None:
    cells = band(error)
    found = proved_on_cells(cells, C)
    assert (
        found.gamma == pytest.approx(constant_gain(cells), rel=5e-3)
        and found.slack > found.rounding > 0
    )
    assert found.gamma >= constant_gain(cells)


def at_rest(cells: list[Cell]) -> float:
    places = np.linspace(0, 1, 9)
    loops = [
        StateSpace(value(c.A, s, t), value(c.B, s, t), C, np.eye(1))
        for c in cells
        for s in places
        for t in places
    ]
    return max(hinf_norm(loop).value for loop in loops)


def test_a_slow_parameter_is_proved_close_to_rest_and_a_wider_error_costs() -> None:
    slow = [proved_on_cells(band(error), C, 1e-3).gamma for error in (0.0, 0.5)]
    fast = proved_on_cells(band(0.0), C).gamma
    assert at_rest(band(0.0)) < slow[0] < 1.01 * at_rest(band(0.0)) and fast > 1.02 * slow[0]
    assert slow[1] > 1.02 * slow[0]


@pytest.mark.parametrize(("rate", "share"), [(0.2, 0.75), (np.inf, 0.5)])
def test_no_motion_passes_what_was_proved(rate: float, share: float) -> None:
    """The gain along motions of p and of what is told, by power iteration over the sampled loop and
    its adjoint.
    """
    error = 0.5
    h = 0.05
    steps = 1000
    gamma = proved_on_cells(band(error), C, rate).gamma
    rng, worst = np.random.default_rng(3), 0.0
    for k in range(12):
        # about twice the natural frequency
        wanted = np.sign(np.sin((1.2 + 0.15 * k) * h * np.arange(steps)))
        p = np.clip(wanted, -1, 1)
        for i in range(1, steps):
            p[i] = p[i - 1] + np.clip(p[i] - p[i - 1], -rate * h, rate * h)
        if k < 2:
            p[:] = 0.5 - k
        told = np.clip(
            p
            + error * (1 if k < 2 else np.sign(np.sin(rng.uniform(0.1, 3) * h * np.arange(steps)))),
            -1,
            1,
        )
        A = [
            np.linalg.inv(np.eye(2) - h / 2 * M)
            for M in (oscillator(0.5 * a, 0.4 - 0.3 * b) for a, b in zip(p, told, strict=True))
        ]
        d = rng.normal(size=steps)
        for _ in range(12):
            d /= np.linalg.norm(d)
            x, y = np.zeros(2), np.empty(steps)
            for i in range(steps):  # implicit midpoint, p and what is told held
                half = A[i] @ (x + h / 2 * np.array([0.0, d[i]]))
                y[i] = half[0] + d[i]
                x = 2 * half - x
            costate, gain = np.zeros(2), np.linalg.norm(y)
            for i in range(steps - 1, -1, -1):
                inner = A[i].T @ (2 * costate + np.array([y[i], 0.0]))
                d[i], costate = y[i] + h / 2 * inner[1], inner - costate
        worst = max(worst, gain)
    assert share * gamma < worst <= gamma


def test_an_unstable_parameter_has_no_proof() -> None:
    p = np.array([[-1.0, -1.0], [1.0, 1.0]])
    A = np.array([[oscillator(0.0, -0.4 * v) for v in row] for row in p])
    with pytest.raises(NumericalFailure, match=r"no quadratic function|does not hold"):
        proved_on_cells([Cell(A, np.tile([[0.0], [1.0]], (2, 2, 1, 1)), p)], C, 0.1)


def exact(*factors: np.ndarray) -> np.ndarray:
    """The product without rounding."""
    return reduce(np.matmul, [np.vectorize(Fraction)(factor) for factor in factors])


def test_y_keeps_its_digits_in_any_coordinates_and_rounding_covers_every_part() -> None:
    rng = np.random.default_rng(1)
    A, C = -np.eye(2) + 0.3 * rng.normal(size=(2, 2)), np.array([[1 / 3, -1 / 3]])
    T = np.array([[1.0, 1.0], [1.0, 1.0 + 2.0**-30]])
    for B in (rng.normal(size=(2, 1)), 1e9 * rng.normal(size=(2, 1))):
        cell = Cell(A[None, None], B[None, None], np.array([[-1.0], [1.0]]))
        search = CellSearch([cell], C, np.inf, 0, 1.0, (T, np.linalg.inv(T)))

        # C T: what is left of 1/3 - 1/3 (1 + 2^-30)
        wanted = exact(C, T).astype(float) / np.sqrt(search.pace)
        assert np.abs(search.C - wanted).max() <= 2e-16 * np.abs(wanted).max()

        # X B in floating point against the same without rounding
        X, e = np.array([[1 / 3, 0.1], [0.1, 0.7]]), search.entries[0]
        error = np.abs(exact(X @ e.B[0], np.eye(1)) - exact(X, e.B[0])).astype(float).max()
        assert error < search.rounding(X[None], 1.0)
    assert error > 1.0  # of entries of 1e18
