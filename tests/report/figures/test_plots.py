"""Figures: the data arrive unchanged but for their units, limits and views are honest, bad curves
are refused.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.judge.campbell import ONCE, CampbellMap, campbell_curves
from ambrose.judge.checks import Checks, Curve
from ambrose.machine.file.toml import load_machine
from ambrose.machine.machine import Machine
from ambrose.machine.part import Disc
from ambrose.report import theme
from ambrose.report.figures import curves as plots
from ambrose.report.figures.curves import pole_figure
from ambrose.report.figures.rotor_drawing import (
    equivalent_cylinder,
    machine_drawing,
    rotor_drawing,
)

TWO_PI = 2 * np.pi


def named(figure: Any, start: str) -> list[Any]:
    return [trace for trace in figure.data if (trace.name or "").startswith(start)]


def texts(figure: Any) -> str:
    return " | ".join(annotation.text for annotation in figure.layout.annotations)


def test_every_point_of_every_line_is_drawn_in_hertz_and_micrometres(
    verifications: list[Checks],
) -> None:
    pairs = [(checks.label, checks.curve("compliance")) for checks in verifications]
    figure = plots.figure(pairs)
    curve = pairs[1][1]
    lines = named(figure, "nominal pressure")
    assert len(lines) == len(curve.labels)
    for line, row in zip(lines, curve.y, strict=True):
        np.testing.assert_allclose(line.x, curve.x / TWO_PI, rtol=1e-7)
        np.testing.assert_allclose(line.y, row * 1e6, rtol=1e-7)
    assert figure.layout.xaxis.title.text == "Frequency [Hz]"
    assert figure.layout.xaxis.type == figure.layout.yaxis.type == "log"
    assert "[µm/N]" in texts(figure)


def test_legend_names_each_operating_point_once_with_its_peak(verifications: list[Checks]) -> None:
    pairs = [(checks.label, checks.curve("sensitivity.output")) for checks in verifications]
    entries = [trace.name for trace in plots.figure(pairs).data if trace.showlegend is not False]
    assert len(entries) == len(pairs)
    for (_, curve), entry in zip(pairs, entries, strict=True):
        assert f"{curve.y[0].max():.3g}" in entry
        assert f"{curve.x[curve.y[0].argmax()] / TWO_PI:.3g}" in entry


def test_an_operating_point_keeps_its_colour_when_others_are_missing(
    verifications: list[Checks],
) -> None:
    order = [checks.label for checks in verifications]
    last = verifications[-1]
    alone = plots.figure([(last.label, last.curve("unbalance"))], order=order).data[0].line.color
    together = plots.figure([(c.label, c.curve("unbalance")) for c in verifications], order=order)
    assert alone == named(together, "twice")[0].line.color == theme.styles(order)[last.label].colour
    assert len({style.colour for style in theme.styles(order).values()}) == 3
    assert len({style.dash for style in theme.styles(order).values()}) == 3


def test_limits_are_drawn_and_named_at_their_level(verifications: list[Checks]) -> None:
    figure = plots.figure([("point", verifications[0].curve("sensitivity.output"))])
    assert "zone A/B 3" in texts(figure)
    assert any(len(trace.y) == 2 and np.allclose(trace.y, 3.0) for trace in figure.data)
    label = next(a for a in figure.layout.annotations if a.text == "zone A/B 3")
    assert label.y == pytest.approx(np.log10(3.0))


def test_a_limit_outside_the_view_is_named() -> None:
    t = np.linspace(0, 0.3, 50)
    curve = Curve(
        "y",
        "y",
        "time",
        t,
        1e-6 * np.sin(40 * t)[None, :],
        ("A_zeta",),
        "s",
        "m",
        (("touchdown", 2.5e-4),),
    )
    figure = plots.figure([("point", curve)])
    assert "beyond the view: touchdown 250" in texts(figure)
    assert figure.layout.yaxis.range[1] < 2
    assert figure.layout.xaxis.title.text == "Time [ms]"
    assert figure.data[0].x[-1] == pytest.approx(300.0)


def test_a_view_that_cuts_curves_says_so_and_the_data_stay_complete() -> None:
    omega = np.geomspace(1, 1e6, 200)
    curve = Curve(
        "c",
        "c",
        "frequency",
        omega,
        (1e-6 / (1 + (omega / 10) ** 2))[None, :],
        ("max",),
        "rad/s",
        "m/N",
    )
    figure = plots.figure([("point", curve)])
    assert "beyond the view: some curves" in texts(figure)
    assert len(figure.data[0].x) == 200
    short = replace(curve, y=np.ones((1, 200)))
    assert "beyond the view" not in texts(plots.figure([("point", short)]))


def test_limits_at_one_level_share_a_name() -> None:
    omega = np.geomspace(1, 1e4, 50)
    limits = (("zone A/B", 3.0), ("zone B/C", 4.0), ("required", 3.0))
    curve = Curve(
        "s",
        "s",
        "frequency",
        omega,
        np.linspace(0.5, 3, 50)[None, :],
        ("max",),
        "rad/s",
        "-",
        limits,
    )
    assert "zone A/B, required 3" in texts(plots.figure([("point", curve)]))


def test_an_unstable_response_does_not_set_the_view() -> None:
    t = np.linspace(0, 1, 300)
    calm = Curve("y", "y", "time", t, 1e-6 * np.sin(40 * t)[None, :], ("A_zeta",), "s", "m")
    wild = replace(calm, y=np.exp(8 * t)[None, :] * calm.y)
    figure = plots.figure([("calm", calm), ("wild", wild)])
    assert figure.layout.yaxis.range[1] < 2
    assert "beyond the view: some curves" in texts(figure)
    assert max(named(figure, "wild")[0].y) > 1000
    assert max(plots.figure([("wild", wild)]).layout.yaxis.range) > 1000


def test_a_curve_that_starts_highest_has_no_peak_and_a_rising_one_an_end(
    verifications: list[Checks],
) -> None:
    omega = np.geomspace(1, 1e4, 50)
    falling = Curve("l", "l", "frequency", omega, 1 / omega[None, :], ("loop",), "rad/s", "-")
    assert plots.figure([("point", falling)]).data[0].name == "point"
    rising = replace(falling, y=omega[None, :])
    assert "up to 10" in plots.figure([("point", rising)]).data[0].name


def test_overlay_says_up_to_where_the_models_agree() -> None:
    omega = TWO_PI * np.geomspace(1, 1000, 400)
    reference = np.ones(400)
    other = np.where(omega < TWO_PI * 100, 1.04, 1.06)
    curves = [
        (label, Curve("g", "g", "frequency", omega, y[None, :], ("max",), "rad/s", "m/A"))
        for label, y in (("full", reference), ("reduced", other), ("same", reference))
    ]
    entries = [trace.name for trace in plots.figure(curves, overlay=True).data if trace.name]
    edge = omega[omega >= TWO_PI * 100][0] / TWO_PI
    assert entries == [
        "full",
        f"reduced · within 5% up to {edge:.3g}\u00a0Hz",
        "same · within 5% everywhere",
    ]


def test_campbell_map_over_rpm_with_the_synchronous_line(verifications: list[Checks]) -> None:
    curve = verifications[0].curve("campbell")
    figure = plots.figure([("point", curve)])
    np.testing.assert_allclose(figure.data[0].x, curve.x * 60 / TWO_PI, rtol=1e-7)
    synchronous = next(trace for trace in figure.data if len(trace.x) == 2)
    np.testing.assert_allclose(np.array(synchronous.x), 60 * np.array(synchronous.y))
    assert "bending 1 backward" in texts(figure)


def test_poles_once_per_pair_and_instability_in_both_pictures() -> None:
    poles = np.array([-3.0, 5 + 300j, 5 - 300j, -20 + 3400j, -20 - 3400j, 0.0])
    curve = Curve(
        "poles", "Poles", "poles", poles.real, poles.imag[None, :], ("poles",), "rad/s", "rad/s"
    )
    left, right = pole_figure([("point", curve)], theme.styles(["point"])).data
    assert sorted(left.x.tolist()) == [-20.0, -3.0, 0.0, 5.0]
    assert max(left.y) == pytest.approx(3400 / TWO_PI)
    assert len(right.x) == 3  # the pole at the origin has no frequency
    assert min(right.y) == pytest.approx(np.arcsinh(-5 / abs(5 + 300j) / 1e-3))
    assert "least damping ratio −0.0167 at 47.8 Hz" in left.name
    assert "all poles but 1 at the origin" in texts(
        pole_figure([("point", curve)], theme.styles(["point"]))
    )


def test_labels_cannot_inject_markup(verifications: list[Checks]) -> None:
    figure = plots.figure([('<a href="x">here</a>', verifications[0].curve("unbalance"))])
    assert "<a" not in figure.to_json().replace("\\u003c", "<")


def test_gaps_and_single_points_are_drawn() -> None:
    x = np.array([1.0, 2.0, 3.0, 4.0])
    holes = Curve(
        "c", "c", "frequency", x, np.array([[1.0, np.nan, 2.0, 0.5]]), ("max",), "rad/s", "-"
    )
    assert "peak 2" in plots.figure([("point", holes)]).data[0].name
    empty = replace(holes, y=np.full((1, 4), np.nan))
    assert plots.figure([("point", empty)]).data[0].name == "point"
    single = Curve("c", "c", "frequency", x[:1], np.ones((1, 1)), ("max",), "rad/s", "-")
    low, high = plots.figure([("point", single)]).layout.xaxis.range
    assert low < np.log10(1 / TWO_PI) < high


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "pie"}, "kind of curve c is 'pie'"),
        ({"y": np.ones((2, 3))}, "shape"),
        ({"y": np.ones((1, 3)) * 1j}, "complex"),
    ],
)
def test_bad_curves_are_refused(change: dict[str, Any], message: str) -> None:
    good = Curve(
        "c", "c", "frequency", np.array([1.0, 2.0, 3.0]), np.ones((1, 3)), ("max",), "rad/s", "-"
    )
    with pytest.raises(InvalidInput, match=message):
        plots.figure([("point", replace(good, **change))])


def test_mixed_quantities_are_refused() -> None:
    good = Curve(
        "c", "c", "frequency", np.array([1.0, 2.0]), np.ones((1, 2)), ("max",), "rad/s", "-"
    )
    with pytest.raises(InvalidInput, match="different figures"):
        plots.figure([("one", good), ("two", replace(good, y_unit="m"))])
    with pytest.raises(InvalidInput, match="has no curves"):
        plots.figure([])


def test_rotor_drawing_is_to_scale_and_complete(
    machine: Machine, shapes: tuple[np.ndarray, np.ndarray]
) -> None:
    nodes = np.linspace(0, machine.length, 40)
    figure = rotor_drawing(machine, nodes, *shapes)
    assert figure.layout.yaxis.scaleanchor == "x"
    corners = {(min(t.x), max(t.x), max(t.y)) for t in figure.data if t.fill == "toself"}
    for section in machine.shaft:
        left, right = 1e3 * section.start, 1e3 * (section.start + section.length)
        assert any(
            np.allclose((left, right, section.outer_diameter * 500), corner) for corner in corners
        )
    hatched = [trace for trace in figure.data if trace.fillpattern.shape]
    assert {max(np.abs(trace.y)) for trace in hatched} == {75.0}
    for name in (
        "bearing A",
        "bearing B",
        "sensor A",
        "sensor B",
        "seal center",
        "coupling",
        "thrust disc",
        "hub",
    ):
        assert name in texts(figure)
    for name in ("rigid 1", "rigid 2", "bending 1", "551", "bending 2"):
        assert name in texts(figure)
    curves = [t for t in figure.data if t.fill == "tozeroy"]
    assert len(curves) == 4
    assert all(np.abs(t.y).max() == pytest.approx(1.0) for t in curves)


def test_a_disc_is_the_cylinder_with_its_mass_and_inertias() -> None:
    mass = 7.0
    radius = 0.1
    width = 0.03
    disc = Disc("d", 0.1, mass, mass * radius**2 / 2, mass * (3 * radius**2 + width**2) / 12)
    assert equivalent_cylinder(disc) == pytest.approx((radius, width))
    assert equivalent_cylinder(Disc("d", 0.1, mass)) is None


def test_shapes_of_the_wrong_length_are_refused(machine: Machine) -> None:
    with pytest.raises(InvalidInput, match="shapes"):
        rotor_drawing(machine, np.linspace(0, 0.86, 40), np.ones((39, 2)), np.ones(2))


def test_the_line_of_the_speed_differs_from_modes_and_far_modes_leave_the_view() -> None:
    """It was drawn twice, once as a mode is, on an axis up to 14 kHz for a rotor of 150 Hz."""
    speeds = np.linspace(0, 150 * TWO_PI, 20)
    rows = np.array([np.full(20, f * TWO_PI) for f in (100, 300, 14400)])
    found = CampbellMap(speeds, rows, np.full((3, 20), 0.1), np.ones((3, 20)))
    curve = campbell_curves(found)[0]
    figure = plots.figure([("loop", curve)])
    modes, (line,) = figure.data[:3], figure.data[3:]
    assert {trace.line.color for trace in modes}.isdisjoint({line.line.color})
    assert {trace.line.dash for trace in modes}.isdisjoint({line.line.dash})
    assert (line.x[-1], line.y[-1]) == (pytest.approx(9000), pytest.approx(150))
    assert 300 < figure.layout.yaxis.range[1] < 400
    words = texts(figure)
    assert words.count(ONCE) == 1 and "1× speed" not in words
    assert "mode 3" not in words and "modes above 318" in words


def test_a_wide_disc_does_not_fill_a_page_of_its_own() -> None:
    """The flywheel's drawing was 1,200 px high, more than a printed page."""
    machine = load_machine("flywheel")
    picture = machine_drawing(machine)
    assert picture.layout.height < 900
    assert machine.length * 1e3 < picture.layout.xaxis.range[1]
