"""Numbers and units on the page."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ambrose.report import theme as units


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (4.1, "4.1"),
        (-2.5, "−2.5"),
        (6905.0, "6\u202f900"),
        (0.03123, "0.0312"),
        (9.999, "10"),
        (999.6, "1\u202f000"),
        (1.2e-7, "1.2×10⁻⁷"),
        (3e8, "3×10⁸"),
        (math.inf, "∞"),
        (math.nan, "n/a"),
    ],
)
def test_number_has_three_significant_digits(value: float, text: str) -> None:
    assert units.number(value) == text


def test_every_rounded_number_reads_back_within_half_a_digit() -> None:
    superscripts = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹−", "-0123456789-")
    for value in np.concatenate([np.geomspace(1e-9, 1e12, 301), -np.geomspace(1e-9, 1e12, 57)]):
        text = (
            units.number(float(value), 4)
            .translate(superscripts)
            .replace("\u202f", "")
            .replace("×10", "e")
        )
        assert float(text) == pytest.approx(value, rel=5.01e-4)


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (4.1e-5, "m", "41\u00a0µm"),
        (0.5, "m", "500\u00a0mm"),
        (2 * math.pi * 41, "rad/s", "41\u00a0Hz"),
        (math.pi / 4, "rad", "45°"),
        (2.04e5, "Pa", "2.04\u00a0bar"),
        (0.2, "s", "200\u00a0ms"),
        (3.0, "s", "3\u00a0s"),
        (2.0, "-", "2"),
        (1.5, "furlong", "1.5\u00a0furlong"),
    ],
)
def test_quantity_in_the_unit_of_the_page(value: float, unit: str, text: str) -> None:
    assert units.quantity(value, unit) == text


def test_a_violated_limit_never_looks_met() -> None:
    assert units.pair(3.0004, 3.0, "-") == ("3.0004", "3")
    assert units.pair(8.0004e-6, 8e-6, "m") == ("8.0004\u00a0µm", "8\u00a0µm")
    assert units.pair(3.0, 3.0, "-") == ("3", "3")
    assert units.pair(2e-3, 0.5, "m") == ("2\u00a0mm", "500\u00a0mm")


def test_axes_are_written_as_people_write_them() -> None:
    assert units.axis_name("y_A_zeta") == "y A ζ"
    assert (
        units.prose("at 83 Hz, loop A_zeta; B_eta_x beta_1")
        == "at 83 Hz, loop A\u00a0ζ; B_eta_x beta_1"
    )
    assert units.decibel(2.0) == "6.0\u00a0dB"
    assert units.decibel(0.0) == ""
