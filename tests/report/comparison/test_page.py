"""The comparison page of real results for the seal rig: what it says is what was found, and nothing
that fails is hidden.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.judge import nominal, robust
from ambrose.judge.checks import Check, Checks, Curve
from ambrose.judge.result import Certificate, Synthesis, pid_synthesis
from ambrose.law.design_problem import design_plant
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.report import (
    comparison as comparison_figures,
    comparison_tables,
    page as document,
    theme,
    theme as units,
)
from ambrose.report.comparison import comparison_page
from ambrose.report.figures.bode import Panel, panel_figure
from ambrose.report.page import Cell, Page, Section, Table
from ambrose.rig.trial import SCENARIOS, Candidate, points_of, simulate_linear
from ambrose.synthesis.hinf import hinf_synthesis
from ambrose.synthesis.mu import mu_synthesis
from coarse import coarse

POINTS = ("zero pressure", "nominal pressure", "twice nominal pressure")


@pytest.fixture(scope="module")
def rig() -> Machine:
    return coarse("seal-rig")


@pytest.fixture(scope="module")
def candidates(rig: Machine) -> list[Candidate]:
    """PID, H-infinity and mu on the reduced rig at its three pressures."""
    plants = [reduce(assemble(rig, point)) for point in rig.operation.points]
    made = {
        "PID": pid_synthesis(plants[0]),
        "H-infinity": hinf_synthesis(design_plant(plants[0], uncertain=False)),
        "mu": mu_synthesis(design_plant(plants[0]), iterations=1),
    }
    return [
        Candidate(
            name,
            synthesis,
            tuple(nominal.check(plant, synthesis.controller) for plant in plants),
            (robust.check(plants[0], synthesis.controller),),
            tuple(
                (p.point.label, simulate_linear(p, synthesis.controller, scenario))
                for p in plants
                for scenario in SCENARIOS
            ),
        )
        for name, synthesis in made.items()
    ]


@pytest.fixture(scope="module")
def report(rig: Machine, candidates: list[Candidate]) -> Page:
    return comparison_page(rig, candidates, facts=[("Purpose", "test")], date="2031-02-03")


@pytest.fixture(scope="module")
def page(report: Page) -> str:
    return document.render(report)


def table(report: Page, title: str) -> Table:
    return next(
        table for section in report.sections for table in section.tables if table.title == title
    )


def section(report: Page, title: str) -> Section:
    return next(section for section in report.sections if section.title == title)


def row(found: Table, start: str) -> tuple[Cell, ...]:
    return next(cells for cells in found.cells if cells[0].text.startswith(start))


def texts(figure: Any) -> list[str]:
    return [re.sub("<[^>]*>", "", str(note.text)) for note in figure.layout.annotations]


def lines(figure: Any, label: str) -> list[Any]:
    return [trace for trace in figure.data if trace.mode == "lines" and trace.name == label]


def test_points_go_by_pressure_and_keep_their_colour_in_every_figure(
    rig: Machine, candidates: list[Candidate], report: Page
) -> None:
    assert points_of(rig, candidates) == POINTS
    style = theme.styles(POINTS)
    drawn = 0
    for part in ("Closed loop, side by side", "Time responses"):
        for figure in section(report, part).figures:
            for label in POINTS:
                colours = {
                    (trace.line.color, trace.line.dash) for trace in lines(figure.picture, label)
                }
                assert colours == {(style[label].colour, style[label].dash)}
                drawn += 1
    assert drawn == 3 * (3 + 2 * len(SCENARIOS))


def test_colours_of_points_controllers_and_families_differ() -> None:
    names = [str(i) for i in range(4)]
    palettes = [
        {style.colour for style in make(names).values()}
        for make in (theme.styles, theme.candidate_styles, theme.family_styles)
    ]
    assert all(len(palette) == 4 for palette in palettes)
    assert (
        not (palettes[0] & palettes[1]) | (palettes[0] & palettes[2]) | (palettes[1] & palettes[2])
    )


def test_what_is_not_met_is_listed_for_each_controller_that_fails(
    report: Page, candidates: list[Candidate]
) -> None:
    titles = [t.title for t in section(report, "At a glance").tables if "not met" in t.title]
    assert titles == [f"{c.name}: requirements not met" for c in candidates if not c.passed]
    rows = [cells for cells in table(report, "PID: requirements not met").cells]
    words = [" ".join(cell.text for cell in cells).replace("\u00a0", " ") for cells in rows]
    assert any("maximum singular value 7.1 ≤ 3 at 42.51 Hz" in line for line in words)
    assert any(line.startswith("twice nominal pressure") and "forward" in line for line in words)
    assert any("the loop is unstable in the box" in line for line in words)


def test_head_says_who_passes_everywhere(
    report: Page, page: str, candidates: list[Candidate]
) -> None:
    good = [candidate.name for candidate in candidates if candidate.passed]
    expected = " every requirement at all 3" if good else "No controller meets every requirement. "
    assert expected in page and report.verdicts == ()


def test_the_deciding_table_holds_the_worst_of_the_points(
    report: Page, candidates: list[Candidate]
) -> None:
    found = table(report, "The quantities that decide")
    assert found.columns == ("Quantity", "Limit", "PID", "H-infinity", "mu")
    sensitivity = row(found, "Peak output sensitivity")
    assert sensitivity[1].text == "≤ 3"
    assert sensitivity[2].text == "unstable"
    for cell, candidate in zip(sensitivity[3:], candidates[1:], strict=True):
        worst = max(
            (checks["sensitivity.output.max"].value, checks.label) for checks in candidate.checks
        )
        assert cell.text == units.number(worst[0])
        assert (worst[1] in cell.detail) == (worst[0] > 3)
        assert cell.mark == ("pass" if worst[0] <= 3 else "fail")
    decrement = row(found, "Log decrement")
    least = [
        min(checks["poles.log_decrement.lowest"].value for checks in c.checks)
        for c in candidates[1:]
    ]
    assert [cell.text for cell in decrement[3:]] == [units.number(value) for value in least]
    assert [cell.best for cell in decrement[2:]] == [
        False,
        least[0] > least[1],
        least[1] > least[0],
    ]


def test_the_deciding_table_holds_box_mu_and_controller(
    report: Page, candidates: list[Candidate]
) -> None:
    found = table(report, "The quantities that decide")
    assert any(
        "seal.center.pressure ±100\u00a0%" in cells[0].text
        for cells in found.cells
        if cells[0].mark == "heading"
    )
    worst = row(found, "Worst-case output sensitivity over the box")
    assert (worst[2].text, worst[2].mark) == ("∞", "fail")
    margins = row(found, "Smallest destabilising factor")
    values = [
        candidate.robust["robust.stability.margin"].value
        for candidate in candidates
        if candidate.robust is not None
    ]
    assert [cell.text for cell in margins[2:]] == [units.number(value) for value in values]
    assert [cell.best for cell in margins[2:]] == [value == max(values) for value in values]
    mixed = row(found, "Peak of mixed µ")
    assert [cell.text for cell in mixed[2:4]] == ["not evaluated"] * 2
    assert mixed[4].text == units.number(candidates[2].synthesis.certificate.margins["mu_mixed"])
    assert mixed[4].detail.startswith("lower bound")
    orders = row(found, "Order")
    assert [cell.text for cell in orders[2:]] == [
        str(c.synthesis.controller.n_states) for c in candidates
    ]
    fastest = row(found, "Fastest pole [Hz]")
    assert fastest[2].text == units.number(
        candidates[0].synthesis.certificate.fastest_pole / 2 / np.pi
    )
    gamma = row(found, "γ")
    assert (gamma[2].text, gamma[3].text) == ("none", units.number(candidates[1].synthesis.gamma))
    assert not any(cell.best for cell in gamma)  # different norms: no winner


def test_columns_are_grouped_by_operating_point_and_each_has_its_best(
    report: Page, candidates: list[Candidate]
) -> None:
    found = table(report, "At every operating point")
    assert found.groups == (("", 2), *((point, 3) for point in POINTS))
    assert found.columns[2:] == ("PID", "H-infinity", "mu") * 3
    cells = row(found, "Peak compliance")[2:]
    for i, point in enumerate(POINTS):
        values = [
            checks["compliance.max"].value
            if (checks := c.at(point)) is not None and checks.stable
            else np.inf
            for c in candidates
        ]
        assert [cell.best for cell in cells[3 * i : 3 * i + 3]] == [
            value == min(values) for value in values
        ]
    assert [cell.text for cell in row(found, "Stability")[2:]].count("unstable") == 1


def sample(name: str, **values: tuple[float, float | None]) -> Candidate:
    """A candidate with some checks at one point: name=(value, limit)."""
    checks = tuple(
        Check(key, key, value, "-", limit, "<=", None if limit is None else value <= limit)
        for key, (value, limit) in values.items()
    )
    controller = pid_synthesis(reduce(assemble(load_machine("seal-rig")))).controller
    certificate = Certificate(True, -1.0, 2.0, 100.0)
    return Candidate(
        name,
        Synthesis(controller, "pid", np.nan, "verified", certificate),
        (Checks("one", True, checks),),
    )


def test_a_check_that_fails_is_never_left_out(rig: Machine) -> None:
    pair = [
        sample("a", obscure=(2.0, 1.0), other=(1.0, 2.0)),
        sample("b", obscure=(0.5, 1.0), other=(1.0, 2.0)),
    ]
    found = comparison_tables.glance_table(rig, pair, ("one",))
    cells = row(found, "obscure")
    assert [(cell.text, cell.mark, cell.best) for cell in cells[2:]] == [
        ("2", "fail", False),
        ("0.5", "pass", True),
    ]
    assert not any(cells[0].text == "other" for cells in found.cells)


def test_equal_values_have_no_best_and_a_near_limit_enough_digits(rig: Machine) -> None:
    pair = [
        sample("a", **{"compliance.max": (3.0004, 3.0)}),
        sample("b", **{"compliance.max": (3.0004, 3.0)}),
    ]
    cells = row(comparison_tables.glance_table(rig, pair, ("one",)), "compliance.max")
    assert [(cell.text, cell.best) for cell in cells[2:]] == [("3.0004", False)] * 2


def test_points_that_a_candidate_lacks_are_named_not_guessed(
    rig: Machine, candidates: list[Candidate]
) -> None:
    partial = replace(candidates[2], checks=candidates[2].checks[:1], boxes=())
    tables = comparison_tables.point_tables([candidates[0], partial], POINTS)
    assert "not evaluated" in [cell.text for cell in row(tables[0], "Peak compliance")]


def test_many_points_are_cut_into_tables_that_fit(candidates: list[Candidate]) -> None:
    labels = [f"point {i}" for i in range(7)]
    many = [
        replace(c, checks=tuple(replace(c.checks[0], label=label) for label in labels))
        for c in candidates
    ]
    found = comparison_tables.point_tables(many, labels)
    assert [len(part.columns) for part in found] == [11, 11, 5]
    assert all(sum(part.widths) == 100 for part in found)
    assert found[2].title == "At point 6"


def test_one_panel_per_controller_with_common_axes_and_peaks_from_the_checks(
    report: Page, candidates: list[Candidate]
) -> None:
    figure = section(report, "Closed loop, side by side").figures[0]
    picture = figure.picture
    words = texts(picture)
    assert [name for name in ("PID", "H-infinity", "mu") if name in words] == [
        "PID",
        "H-infinity",
        "mu",
    ]
    assert "2.98 · 7.1 · unstable" in words
    drawn = [
        (candidate, point)
        for point in POINTS
        for candidate in candidates
        if candidate.at(point).stable
    ]  # type: ignore[union-attr]
    assert sum(len(lines(picture, point)) for point in POINTS) == len(drawn) == 8
    assert picture.layout.xaxis2.matches == picture.layout.xaxis3.matches == "x"
    assert picture.layout.yaxis2.matches == picture.layout.yaxis3.matches == "y"
    curve = candidates[1].checks[0].curve("sensitivity.output")
    middle = next(trace for trace in lines(picture, "nominal pressure") if trace.xaxis == "x2")
    np.testing.assert_allclose(middle.y, curve.y[0], rtol=1e-6)
    assert len([trace for trace in picture.data if trace.showlegend]) == 3


def test_families_leave_out_unstable_lines_and_say_so(
    report: Page, candidates: list[Candidate]
) -> None:
    figures = section(report, "Over the tolerances").figures
    assert [figure.title for figure in figures] == [
        "Output sensitivity over the tolerances",
        "Input sensitivity over the tolerances",
    ]
    words = texts(figures[0].picture)
    assert "2 of 5 unstable" in words
    assert candidates[2].robust is not None
    assert (
        f"worst case {units.number(candidates[2].robust['robust.sensitivity.worst'].value)}"
        in words
    )
    names = [trace.name for trace in figures[0].picture.data if trace.showlegend]
    assert names[:3] == [
        "seal.center.pressure −100\u00a0%",
        "seal.center.pressure −50\u00a0%",
        "seal.center.pressure nominal",
    ]
    assert sorted(names[3:]) == [
        "seal.center.pressure +100\u00a0%",
        "seal.center.pressure +50\u00a0%",
    ]


def test_single_robust_curves_are_overlaid_in_the_colours_of_the_controllers(
    rig: Machine, candidates: list[Candidate]
) -> None:
    omega = np.geomspace(1, 1e3, 20)
    curve = Curve(
        "robust.mu",
        "Mu",
        "frequency",
        omega,
        1 / omega[None],
        ("upper bound",),
        "rad/s",
        "-",
        (("limit", 1.0),),
    )
    some = [
        replace(c, boxes=(replace(c.robust, curves=(curve,)),))
        for c in candidates
        if c.robust is not None
    ]
    (figure,) = comparison_figures.family_figures(rig, some)
    style = theme.candidate_styles([candidate.name for candidate in some])
    for candidate in some:
        assert [trace.line.color for trace in lines(figure.picture, candidate.name)] == [
            style[candidate.name].colour
        ]


def test_gains_are_those_of_the_controllers_and_absent_coupling_is_said(
    report: Page, candidates: list[Candidate]
) -> None:
    picture = section(report, "Controllers").figures[0].picture
    titles = [words for words in texts(picture) if words.startswith("(")]
    assert [words[:5] for words in titles] == [
        "(1,1)",
        "(2,2)",
        "(3,3)",
        "(4,4)",
        "(1,2)",
        "(1,3)",
        "(1,4)",
    ]
    assert len(lines(picture, "PID")) == 4  # decentralised: no cross coupling to draw
    assert texts(picture).count("PID: none") == 3
    for candidate in candidates[1:]:
        system = candidate.synthesis.controller
        panels = lines(picture, candidate.name)
        assert len(panels) == 7
        for trace, (i, j) in zip(
            panels, [(0, 0), (1, 1), (2, 2), (3, 3), (0, 1), (0, 2), (0, 3)], strict=True
        ):
            k = 250  # an oracle of its own at one frequency: K = C (jw - A)^-1 B + D, in A/mm
            resolvent = np.linalg.inv(
                2j * np.pi * float(trace.x[k]) * np.eye(system.n_states) - system.A
            )
            gain = abs((system.C @ resolvent @ system.B + system.D)[i, j]) * 1e-3
            assert float(trace.y[k]) == pytest.approx(gain, rel=1e-4)
    assert 10 ** np.array(picture.layout.xaxis.range) == pytest.approx([0.1, 2000])


def test_a_diverging_response_is_named_and_does_not_squash_the_others(
    report: Page, candidates: list[Candidate]
) -> None:
    figure = section(report, "Time responses").figures[0]
    calm = [
        t
        for c in candidates
        for _, t in c.traces
        if t.outcome == "completed" and t.scenario == SCENARIOS[0]
    ]
    axes = load_machine("seal-rig").axes
    largest = (
        max(
            np.abs(trace.record.select([f"y_{axis}" for axis in axes]).values).max()
            for trace in calm
        )
        * 1e6
    )
    assert figure.picture.layout.yaxis.range[1] < 1.3 * largest
    # all of it is there
    assert max(max(np.abs(t.y)) for t in lines(figure.picture, POINTS[2])) > 10 * largest
    assert any(re.match(r"unstable, down at \d+\sms", words) for words in texts(figure.picture))
    assert "some curves" in figure.caption
    assert "double-click shows all" in figure.caption
    assert len(figure.picture.data) >= 4 * 3 * 3  # axes, controllers, points


def test_page_is_whole_light_and_escaped(
    rig: Machine, candidates: list[Candidate], tmp_path: Path, page: str
) -> None:
    assert len(page) < 12e6
    assert page.count("<details") == page.count("</details>") > 3 * 4
    assert '<th colspan="3" scope="colgroup">zero pressure</th>' in page
    named = [replace(candidates[0], name="<b>&PID"), candidates[1]]
    made = comparison_page(rig, named)
    path = document.write(made, tmp_path / "page.html")
    text = path.read_text(encoding="utf-8")
    assert "<b>&PID" not in text
    assert "&lt;b&gt;&amp;PID" in text


def test_all_checks_of_all_candidates_are_listed(report: Page, candidates: list[Candidate]) -> None:
    details = section(report, "All checks in detail")
    assert details.folded
    expected = [checks for c in candidates for checks in (*c.checks, *c.boxes)]
    assert sorted(len(part.rows) for part in details.tables) == sorted(
        len(checks.checks) for checks in expected
    )


def test_mu_iterations_are_listed(report: Page, candidates: list[Candidate]) -> None:
    found = table(report, "mu: what each iteration reached")
    assert len(found.rows) == len(candidates[2].synthesis.history)


def test_a_single_candidate_gets_the_verification_report(
    rig: Machine, candidates: list[Candidate]
) -> None:
    made = comparison_page(rig, candidates[:1], title="One")
    titles = [part.title for part in made.sections]
    assert titles == [
        "Requirements",
        "Closed loop",
        "Time responses",
        "Machine",
        "Over the tolerances",
        "All checks in detail",
    ]
    assert made.result is not None and made.result.passed is False
    document.render(made)


def test_maps_over_speed_and_models_have_their_sections(
    rig: Machine, candidates: list[Candidate]
) -> None:
    speed = np.linspace(0, 300, 5)
    campbell = Curve(
        "campbell", "Campbell map", "speed", speed, speed[None] + 50, ("mode",), "rad/s", "rad/s"
    )
    gain = Curve("g", "Gain", "frequency", speed + 1, np.ones((1, 5)), ("max",), "rad/s", "m/A")
    made = comparison_page(
        rig,
        candidates[:2],
        comparison=[("full", gain), ("reduced", gain)],
        over_speed=[("PID", campbell), ("H-infinity", campbell)],
    )
    over = section(made, "Over speed")
    assert [figure.title for figure in over.figures] == [
        "Campbell map, PID",
        "Campbell map, H-infinity",
    ]
    assert section(made, "Model against model").figures


def test_names_that_do_not_tell_apart_are_refused(
    rig: Machine, candidates: list[Candidate]
) -> None:
    with pytest.raises(InvalidInput, match="one name each"):
        comparison_page(rig, [candidates[0], candidates[0]])
    with pytest.raises(InvalidInput, match="one name each"):
        comparison_page(rig, [])
    with pytest.raises(InvalidInput, match="no checks"):
        replace(candidates[0], checks=())
    with pytest.raises(InvalidInput, match="two verifications labelled 'nominal pressure'"):
        replace(candidates[0], checks=candidates[0].checks[:1] * 2)
    with pytest.raises(InvalidInput, match="no name"):
        replace(candidates[0], name=" ")


def test_panels_share_a_view_and_rows_may_end_early() -> None:
    t = np.linspace(0, 1, 50)
    curve = Curve("y", "y", "time", t, np.sin(t)[None], ("a",), "s", "m")
    rows = [
        [Panel("one", (("p", curve),)), Panel("two", (("p", curve),))],
        [Panel("three", (("q", curve),))],
    ]
    figure, hidden = panel_figure(rows, theme.styles(["p", "q"]), span=(0.25, 0.5))
    assert hidden == ""
    assert list(figure.layout.xaxis.range) == [0.25, 0.5]
    assert [figure.data[0].x0, figure.data[0].dx] == pytest.approx([0, 1 / 49])
    assert figure.layout.xaxis2.showticklabels is True  # nothing stands beneath it
    assert figure.layout.xaxis.showticklabels is False


def test_groups_must_span_the_columns() -> None:
    with pytest.raises(InvalidInput, match="span 3 columns, but must span 2"):
        Table("t", ("a", "b"), (), groups=(("x", 3),))
