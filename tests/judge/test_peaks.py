"""Refined peaks against closed forms, on coarse grids and sharp resonances."""

from __future__ import annotations

import numpy as np
import pytest

from ambrose.judge.loop_response import LoopResponse, frequency_grid, peaks_of

W0 = 2 * np.pi * 137.0


def resonance(zeta):
    """An evaluator whose G is the unit-gain oscillator of W0 and zeta on every axis, all else
    zero.
    """

    def at(omega):
        zero = np.zeros((len(omega), 2, 2))
        g = 1 / (1 - (omega / W0) ** 2 + 2j * zeta * omega / W0)
        return LoopResponse(
            omega, ("a", "b"), g[:, None, None] * np.eye(2), zero, zero, zero, zero, zero, zero
        )

    return at


def modulus(response):
    return np.abs(np.einsum("wii->iw", response.G))


@pytest.mark.parametrize("zeta", [1e-1, 1e-2, 1e-3, 1e-5])
def test_a_lightly_damped_peak_is_exact_on_the_packed_grid(zeta):
    poles = W0 * (-zeta + 1j * np.sqrt(1 - zeta**2)) * np.ones(1)
    at = resonance(zeta)
    for peak in peaks_of([modulus], at(frequency_grid(poles, 1.0, 1e5)), at)[0]:
        assert peak.value == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=1e-7)
        assert peak.frequency == pytest.approx(W0 * np.sqrt(1 - 2 * zeta**2), rel=1e-3 * zeta)
        assert not peak.at_edge


def test_a_resolved_peak_is_exact_on_a_coarse_grid_too():
    """zeta = 0.02 on a grid of 25 points a decade, whose largest value misses the peak by more than
    a quarter.
    """
    at = resonance(0.02)
    response = at(np.geomspace(10, 1e4, 75))
    exact = 1 / (2 * 0.02 * np.sqrt(1 - 0.02**2))
    assert modulus(response).max() < 0.75 * exact
    assert peaks_of([modulus], response, at)[0][0].value == pytest.approx(exact, rel=1e-5)


def test_the_range_ends_are_evaluated_and_named_as_edges():
    at = resonance(0.5 * np.sqrt(2))  # no peak: falls from 1
    response = at(np.geomspace(10, 1e4, 20))
    low = peaks_of([modulus], response, at, within=(33.0, 5000.0))[0][0]
    assert low.at_edge and low.frequency == 33.0
    assert low.value == pytest.approx(1 / np.sqrt(1 + (33.0 / W0) ** 4), rel=1e-12)
    rising = peaks_of([lambda r: modulus(r) * r.omega**3], response, at, within=(33.0, 5000.0))[0][
        0
    ]
    assert rising.at_edge and rising.frequency == 5000.0


def test_quantities_are_refined_together_as_apart():
    at = resonance(0.01)
    response = at(np.geomspace(10, 1e4, 400))
    weighted = [modulus, lambda r: modulus(r) * r.omega**2, lambda r: modulus(r)[:1] / r.omega]
    together = peaks_of(weighted, response, at)
    assert [len(group) for group in together] == [2, 2, 1]
    for rows, group in zip(weighted, together, strict=True):
        (apart,) = peaks_of([rows], response, at)
        for a, b in zip(apart, group, strict=True):
            assert a.value == pytest.approx(b.value, rel=1e-12)


def test_the_higher_of_two_peaks_wins_though_the_grid_shows_it_lower():
    """Two modes; the grid hits the lower one's top and misses the higher one's."""
    first = 500.0
    second = 2000.0
    zeta = 0.01

    def at(omega):
        zero = np.zeros((len(omega), 1, 1))
        g = 0.8 / np.abs(1 - (omega / first) ** 2 + 2j * zeta * omega / first)
        g = np.maximum(g, 1.0 / np.abs(1 - (omega / second) ** 2 + 2j * zeta * omega / second))
        return LoopResponse(omega, ("a",), g[:, None, None], zero, zero, zero, zero, zero, zero)

    grid = np.sort(np.concatenate([np.geomspace(10, 1e4, 60), [first, 1970.0, 2030.0]]))
    grid = grid[(grid < 1971) | (grid > 2029)]
    response = at(grid)
    assert grid[np.argmax(np.abs(response.G[:, 0, 0]))] == first
    peak = peaks_of([lambda r: np.abs(r.G[:, :, 0]).T], response, at)[0][0]
    assert peak.frequency == pytest.approx(second, rel=1e-3)
    assert peak.value == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=1e-6)


def test_two_planes_alike_to_rounding_have_one_peak_each():
    """Poles of two planes apart in the last digits: of two grid points between which there is
    nothing but rounding neither may be the end of a bracket.
    """
    zeta = 1e-2
    pole = W0 * (-zeta + 1j * np.sqrt(1 - zeta**2))
    poles = np.array([pole, pole * (1 + 3e-14), pole * (1 - 3e-14)])
    grid = frequency_grid(poles, 1.0, 1e5)
    assert (np.diff(grid) > 1e-9 * grid[:-1]).all()
    assert len(grid) == len(frequency_grid(poles[:1], 1.0, 1e5))
    at = resonance(zeta)

    def rough(response):
        """The peak with what rounding adds, of either sign at neighbouring frequencies."""
        noise = np.where(np.arange(len(response.omega)) % 2, 1e-13, -1e-13)
        return modulus(response) * (1 + noise)

    for peak in peaks_of([rough], at(grid), at)[0]:
        assert peak.value == pytest.approx(1 / (2 * zeta * np.sqrt(1 - zeta**2)), rel=1e-7)
