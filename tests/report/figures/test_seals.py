"""Pictures of identified responses and seals: what is drawn is what was found, in the units of the
page.
"""

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse
from ambrose.identification.frf_spectral import Frf
from ambrose.identification.seal.by_pressure import SealFit, averaged, line
from ambrose.report.figures import seals as seal_figures

HZ = 2 * np.pi
BAR = 1e5


def truth(pressure):
    return np.array([1e4, 16.0 * pressure, 0.012 * pressure, -0.012 * pressure])


def found(pressures=(0.7, 1.0, 1.2), frequencies=(5.0, 50.0, 150.0)):
    rows = [(p * BAR, f * HZ) for p in pressures for f in frequencies]
    values = np.array([truth(p) for p, _ in rows])
    n = len(rows)
    eye = np.tile(np.eye(4), (n, 1, 1))
    p, w = (np.array(part) for part in zip(*rows, strict=True))
    return SealFit(
        "rig",
        "center",
        p,
        w,
        values,
        np.full((n, 4), 10.0),
        np.full((n, 8), np.nan),
        np.full((n, 8), np.nan),
        eye,
        eye,
        np.full((n, 4), 3e3),
        "made up",
    )


def response(n=40):
    omega = HZ * np.geomspace(3, 140, n)
    values = 1e-4 / (1 + 1j * omega / 300)[:, None, None] ** 2
    ones = np.ones((n, 1))
    return Frf(
        values,
        omega,
        ("e_A",),
        ("y_A",),
        (0.02 * np.abs(values)) ** 2,
        0.97 * ones,
        ones,
        30.0,
        1e-4,
    )


def named(figure, name):
    return [trace for trace in figure.data if trace.name == name]


def test_responses_with_models_errors_and_coherence():
    measured = response()
    late = FrequencyResponse(
        1.05 * measured.values * np.exp(2j * np.pi), measured.omega, ("e_A",), ("y_A",)
    )
    figure = seal_figures.response_figure(
        {"along ζ": measured, "along η": measured},
        {"along ζ": {"model": late}},
        valid_to={"along ζ": 100 * HZ},
    )
    lines = named(figure, "measured, with 95 %")
    assert len(lines) == 6
    np.testing.assert_allclose(lines[0].x, measured.omega / HZ, rtol=1e-6)
    # um per A
    np.testing.assert_allclose(lines[0].y, 1e6 * np.abs(measured.values[:, 0, 0]), rtol=1e-6)
    np.testing.assert_allclose(lines[2].y, 0.97, rtol=1e-6)
    size, phase, error = named(figure, "model")
    np.testing.assert_allclose(size.y, 1.05 * lines[0].y, rtol=1e-5)
    np.testing.assert_allclose(phase.y, lines[1].y, atol=1e-3)  # on the measured branch
    np.testing.assert_allclose(error.y, 5, rtol=1e-4)
    assert len(figure.layout.shapes) == 4  # the dashed line through the first column
    assert figure.layout.shapes[0].x0 == pytest.approx(100)
    assert sum(bool(trace.showlegend) for trace in figure.data) == 2


def test_a_response_of_many_entries_is_refused():
    both = Frf(
        np.ones((3, 2, 1)),
        np.arange(1.0, 4.0),
        ("e",),
        ("a", "b"),
        np.ones((3, 2, 1)),
        np.ones((3, 2)),
        np.ones((3, 1)),
        5.0,
        1e-4,
    )
    with pytest.raises(InvalidInput, match="select"):
        seal_figures.response_figure({"x": both}, {})
    with pytest.raises(InvalidInput, match="no measured response"):
        seal_figures.response_figure({}, {})


def test_coefficients_over_frequency_at_their_pressures():
    fit = found()
    figure = seal_figures.frequency_figure(fit, averaged(fit), truth=truth, valid_to=100 * HZ)
    points = [trace for trace in named(figure, "1\u00a0bar") if trace.mode == "markers"]
    assert len(points) == 4
    np.testing.assert_allclose(points[1].y, 1600, rtol=1e-6)  # kN/m
    np.testing.assert_allclose(points[2].y, 1200, rtol=1e-6)  # N s/m
    np.testing.assert_allclose(points[1].error_y.array, 1.96 * 10 * 1e-3, rtol=1e-5)
    np.testing.assert_allclose(points[1].x, [5, 50, 150], rtol=1e-3)
    assert len(named(figure, "model's error, taken off")) == 4
    assert len(named(figure, "truth")) == 12
    with pytest.raises(InvalidInput, match="pressure_figure"):
        seal_figures.frequency_figure(averaged(fit))


def test_coefficients_over_pressure_with_their_line():
    rows = averaged(found())
    lines = {letter: line(rows, letter) for letter in "KkCc"}
    figure = seal_figures.pressure_figure(rows, lines, nominal=2.04e5, truth=truth)
    points = named(figure, "identified, 95 %")
    assert len(points) == 4
    np.testing.assert_allclose(points[1].x, [0.7, 1.0, 1.2], rtol=1e-6)
    np.testing.assert_allclose(points[1].y, [1120, 1600, 1920], rtol=1e-6)
    straight, true = named(figure, "regression")[1], named(figure, "truth")[1]
    np.testing.assert_allclose(straight.y, true.y, atol=1.0)
    assert straight.x[-1] > 2.04
    assert figure.layout.shapes[0].x0 == pytest.approx(2.04)
    assert len(named(figure, "true line, 95 %")) == 1
