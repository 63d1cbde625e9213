"""The page: complete, self-contained, valid, escaped, and written in one step."""

from __future__ import annotations

import base64
import gzip
import json
import os
import re
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest

from ambrose import __version__
from ambrose.core.checks import InvalidInput
from ambrose.judge.checks import Check, Checks, Curve, Verification
from ambrose.machine.machine import Machine
from ambrose.registry import registered, resolve
from ambrose.report import page as document, tables
from ambrose.report.figures.motion import add_controls
from ambrose.report.page import Cell, Figure, Page, Section, Subject, Table, Verdict
from ambrose.report.verification import verification_page
from needs import CHROMIUM, needs

VOID = {"meta", "link", "img", "br", "hr", "input", "col"}


class Parsed(HTMLParser):
    """Checks that elements nest, and collects text, identifiers and references."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.stack: list[str] = []
        self.words: list[str] = []
        self.ids: list[str] = []
        self.references: list[str] = []
        self.scripts: dict[str, str] = {}
        self.script = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if values.get("id"):
            self.ids.append(str(values["id"]))
        self.references += [
            str(values[name])
            for name in ("src", "href", "srcset", "action", "data")
            if values.get(name)
        ]
        if tag not in VOID:
            self.stack.append(tag)
        self.script = str(values.get("id") or "") if tag == "script" else ""

    def handle_endtag(self, tag: str) -> None:
        assert self.stack.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.stack and self.stack[-1] == "script":
            if self.script:
                self.scripts[self.script] = self.scripts.get(self.script, "") + data
        elif self.stack and self.stack[-1] != "style":
            self.words.append(data)

    @property
    def text(self) -> str:
        return re.sub(r"\s+", " ", " ".join(self.words))


@pytest.fixture(scope="module")
def report(
    machine: Machine,
    verifications: list[Checks],
    responses: list[tuple[str, Curve]],
    comparison: list[tuple[str, Curve]],
) -> Page:
    return verification_page(
        machine,
        verifications,
        models=[("full model", "320 states"), ("reduced model", "8 states")],
        responses=responses,
        comparison=comparison,
        facts=[("Controller", "PID <reference>")],
        title="Acceptance of <b>rig</b> & seal",
        date="2031-02-03",
    )


@pytest.fixture(scope="module")
def source(report: Page) -> str:
    return document.render(report)


@pytest.fixture(scope="module")
def page(source: str) -> Parsed:
    return Parsed(source)


def test_elements_nest_and_identifiers_are_unique(page: Parsed) -> None:
    assert page.stack == []
    assert len(page.ids) == len(set(page.ids))


def test_nothing_is_fetched_from_anywhere(page: Parsed, source: str) -> None:
    assert all(reference.startswith("#") for reference in page.references)
    assert {reference.removeprefix("#") for reference in page.references} <= set(page.ids)
    library = document.packed(document.get_library())
    assert source.count(library) == 1
    rest = source.replace(library, "")
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(", rest)
    assert "showSendToCloud: false" in rest  # no button of the page uploads anything


def test_head_states_machine_source_date_version_and_verdicts(
    page: Parsed, machine: Machine
) -> None:
    for expected in (
        machine.name,
        machine.source,
        machine.description,
        "2031-02-03",
        f"ambrose {__version__}",
        "PID <reference>",
    ):
        assert expected in page.text
    assert "✗ at least one operating point fails" in page.text
    assert (
        "stable, 3 of 4 checks passed; fails: unbalance orbit up to 200 Hz 8.0004 µm > 8 µm"
        in page.text.replace("\u00a0", " ")
    )


def test_every_check_of_every_operating_point_is_listed(
    page: Parsed, verifications: list[Checks]
) -> None:
    for checks in verifications:
        table = tables.checks_table(checks)
        assert len(table.rows) == len(checks.checks)
        for row in table.cells:
            for cell in row:
                assert re.sub(r"\s+", " ", cell.text) in page.text
    assert page.text.count("ISO 21940-11:2016") == len(verifications)


def test_every_figure_has_its_place_its_data_and_its_number(page: Parsed, report: Page) -> None:
    figures = [figure for section in report.sections for figure in section.figures]
    assert len(figures) == 11
    for i, figure in enumerate(figures, start=1):
        assert f"figure-{i}" in page.ids
        assert f"Figure {i}. {figure.title}" in page.text
        data = json.loads(gzip.decompress(base64.b64decode(page.scripts[f"data-{i}"])))
        assert len(data["data"]) == len(figure.picture.data)


def test_assumed_parameters_and_models_are_listed(page: Parsed) -> None:
    for expected in (
        "Chosen, not measured",
        "diameters chosen so that the rotor weighs 69 kg",
        "320 states",
        "8 states",
    ):
        assert expected in page.text


def test_titles_are_escaped(source: str, page: Parsed) -> None:
    rest = source.replace(document.packed(document.get_library()), "")
    assert "<b>rig</b>" not in rest
    assert "&lt;b&gt;rig&lt;/b&gt; &amp; seal" in rest
    assert "twice nominal <pressure>" in page.text


def test_a_script_in_a_label_cannot_close_the_data_element(machine: Machine) -> None:
    curve = Curve(
        "c", "c", "frequency", np.array([1.0, 2.0]), np.ones((1, 2)), ("max",), "rad/s", "-"
    )
    from ambrose.report.figures import curves as plots

    picture = plots.figure([("</script><script>alert(1)</script>", curve)])
    text = document.render(Page("t", machine, (Section("s", "", (Figure("</script>", picture),)),)))
    assert "<script>alert" not in text
    assert Parsed(text).stack == []


def test_no_name_leaves_its_string_in_the_style_sheet(machine: Machine) -> None:
    """Name and title stand at the foot of every printed page, in a style sheet's string."""
    name = '"; } body { display: none } /* \\ </style>'
    text = document.render(Page("A & B", Subject(name), ()))
    (foot,) = re.findall(r'@bottom-left { content: "(.*?)"; font', text)
    decoded = re.sub(r"\\([0-9a-f]{6})", lambda found: chr(int(found[1], 16)), foot)
    assert decoded == f"A & B: {name}"
    assert re.fullmatch(r"(?:[A-Za-z0-9]|\\[0-9a-f]{6})*", foot)


@pytest.mark.parametrize(("detail", "short"), [("", True), ("word " * 50, False)])
def test_a_table_is_kept_on_one_page_where_it_fits_with_its_details(
    machine: Machine, detail: str, short: bool
) -> None:
    """Eight rows with four lines each were pushed off a page that they had begun to fill."""
    table = Table("Rows", ("a",), tuple((Cell("x", detail=detail),) for _ in range(8)))
    text = document.render(Page("Report", machine, (Section("S", tables=(table,)),)))
    (kind,) = re.findall(r'<table style="--columns: 1" class="(.*?)"', text)
    assert ("short" in kind.split()) is short


@needs("browser")
def test_the_page_counts_as_loaded_when_its_figures_stand(source: str, tmp_path: Path) -> None:
    """A printer without a person, ``--print-to-pdf``, begins at the load: it had printed "Being
    drawn: wait before you print" in place of every figure.
    """
    path = tmp_path / "report.html"
    path.write_text(source, "utf-8")
    words = ("--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", path.as_uri())
    done = subprocess.run(
        [str(CHROMIUM), *words], capture_output=True, text=True, timeout=120, check=False
    )
    if done.returncode or "<h1>" not in done.stdout:
        pytest.skip(f"chromium does not start here: {done.stderr[-200:]}")
    assert "Being drawn" not in done.stdout
    places = re.findall(r'id="figure-\d+"', done.stdout)
    assert len(places) == done.stdout.count('class="plot-container plotly"') > 0


@needs("browser")
def test_an_animation_is_paused_without_a_mistake_in_the_console(
    browser: Any, machine: Machine, tmp_path: Path
) -> None:
    """plotly rejects the promise of the frames that a click ends, without a reason."""
    names = [f"{i}" for i in range(40)]
    picture = go.Figure(
        data=[go.Scatter(x=[0, 1], y=[0, 1])],
        layout={"height": 300},
        frames=[go.Frame(name=name, data=[go.Scatter(y=[0, i])]) for i, name in enumerate(names)],
    )
    add_controls(picture, names, names, 60.0, rounds=9, below=40, left=0.3, margin=90, growth=60)
    page = Page("Motion", machine, (Section("Motion", "", (Figure("A line", picture),)),))
    path = tmp_path / "motion.html"
    path.write_text(document.render(page), "utf-8")
    opened, mistakes = browser.new_page(), list[str]()
    opened.on("pageerror", lambda error: mistakes.append(str(error)))
    opened.goto(path.as_uri())
    moving = "document.querySelector('.plot .scatterlayer path.js-line').getAttribute('d')"
    drawn = opened.evaluate(moving)
    opened.locator(".updatemenu-button", has_text="play").click()
    opened.wait_for_function(f"(was) => {moving} !== was", arg=drawn)
    opened.locator(".updatemenu-button", has_text="pause").click()
    # it stands still, and any other mistake is told, after all that was told before
    still = opened.evaluate(moving)
    later = f"new Promise((done) => setTimeout(() => done({moving}), 200))"
    assert opened.evaluate(later) == still
    with opened.expect_event("pageerror") as told:
        opened.evaluate("void Promise.reject(new Error('another'))")
    assert mistakes == [str(told.value)] == ["another"]
    opened.close()


def test_written_in_one_step(
    machine: Machine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "report.html"
    assert document.write(Page("first", machine, (Section("only", "one\n\ntwo"),)), path) == path
    before = path.read_text(encoding="utf-8")
    assert "<p>one</p>" in before
    assert "<p>two</p>" in before

    def fail(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", fail)
    with pytest.raises(InvalidInput, match="disk full"):
        document.write(Page("second", machine, ()), path)
    assert path.read_text(encoding="utf-8") == before
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_a_missing_folder_is_refused_in_words(machine: Machine, tmp_path: Path) -> None:
    with pytest.raises(
        InvalidInput, match=r"report .*nowhere is not a directory; .*create the folder first"
    ):
        document.write(Page("t", machine, ()), tmp_path / "nowhere" / "report.html")


def test_a_page_without_figures_is_small_and_has_no_script(machine: Machine) -> None:
    text = document.render(
        Page(
            "t",
            machine,
            (Section("s", "words", (), (Table("x", ("a",), (("1",),)),)),),
            signatures=(),
        )
    )
    assert "<script" not in text
    assert len(text) < 20_000


def test_ragged_tables_and_unknown_marks_are_refused() -> None:
    with pytest.raises(InvalidInput, match="row 1 of table 'x' has 1 cells"):
        Table("x", ("a", "b"), (("1", "2"), ("3",)))
    with pytest.raises(InvalidInput, match="mark"):
        Cell("1", "maybe")


def test_verdicts_in_plain_words(verifications: list[Checks]) -> None:
    failed = Check(
        "s",
        "Output sensitivity",
        4.1,
        "-",
        3.0,
        passed=False,
        detail="at 41 Hz; beyond the range it falls",
    )
    good = Check("g", "Gain margin", 2.5, "-", 2.0, ">=", True)
    information = Check("i", "Peak current", 2.5, "A")
    assert tables.verdict(Checks("p", True, (failed, good, information))) == Verdict(
        "p", False, "stable, 1 of 2 checks passed; fails: output sensitivity 4.1 > 3 at 41 Hz"
    )
    assert tables.verdict(Checks("p", True, (good,))) == Verdict(
        "p", True, "stable, all 1 checks passed"
    )
    low = replace(good, value=1.5, passed=False, detail="loop A_zeta")
    assert tables.verdict(Checks("p", True, (low,))).text.endswith(
        "fails: gain margin 1.5 < 2 (loop A\u00a0ζ)"
    )
    unstable = tables.verdict(Checks("p", False, ()))
    assert (unstable.passed, unstable.symbol) == (False, "✗")
    assert "UNSTABLE" in unstable.text
    pole = replace(
        good,
        limit=0.0,
        passed=False,
        detail="pole at 49.2 Hz forward, damping ratio -0.171; pole at 7 Hz planar",
    )
    words = "UNSTABLE: pole at 49.2 Hz forward, damping ratio -0.171; nothing else was evaluated"
    assert tables.verdict(Checks("p", False, (pole,))).text == words


LOST = {  # checks that only an unstable loop fails: over the tolerances, a range, a block
    "sampled.stability.box": "every tolerance",
    "robust.stability.margin": "every tolerance",
    "stability.speeds": "asymptotic stability",
    "range.abscissa": "stability",
    "synchronous.gain": "stability",
}


@pytest.mark.parametrize("name", LOST)
def test_a_loop_lost_around_its_point_is_not_called_stable(name: str) -> None:
    """The box with 23 unstable members was headed "stable, 0 of 4 checks passed"."""
    lost = Check(name, "T", 2.0, "-", 1.0, passed=False, source=LOST[name])
    checks = Checks("over all tolerances around p", True, (lost,))
    assert not checks.holds and not checks.to_dict()["stable"] and not checks.facts()["stable"]
    assert tables.verdict(checks).text.startswith("stable in the middle, UNSTABLE elsewhere")
    (overview,) = tables.overview_tables((checks,))
    assert overview.rows[0][2].text == "unstable"
    assert not Verification((checks,)).stable
    weak = replace(lost, name="sensitivity.output.max", source="ISO 14839-3")
    assert Checks("p", True, (weak,)).holds  # a limit missed is no loss


def test_overview_has_a_verdict_as_symbol_and_word_for_each_point(
    verifications: list[Checks],
) -> None:
    unstable = Checks("burst seal", False, ())
    (table,) = tables.overview_tables([*verifications, unstable])
    assert table.columns == ("Quantity", "Limit", *(c.label for c in verifications), "burst seal")
    stability, *rows = table.cells
    assert [cell.mark for cell in stability[2:]] == ["pass", "pass", "pass", "fail"]
    assert {row[-1].text for row in rows} == {"not evaluated"}
    # it has no limit: only in the detailed table
    assert not any("control sensitivity" in row[0].text for row in rows)
    assert all(cell.symbol for row in table.cells for cell in row if cell.mark in {"pass", "fail"})


def test_many_operating_points_are_cut_into_tables_that_fit(verifications: list[Checks]) -> None:
    points = [replace(verifications[i % 3], label=f"point {i}") for i in range(8)]
    first, second = tables.overview_tables(points)
    assert first.columns[2:] + second.columns[2:] == tuple(point.label for point in points)
    assert len(first.rows) == len(second.rows)
    assert sum(first.widths) == sum(second.widths) == 100


def test_limits_that_differ_stand_beside_the_values() -> None:
    points = [
        Checks(f"p{limit}", True, (Check("o", "Orbit", 5e-6, "m", limit, "<=", True),))
        for limit in (8e-6, 9e-6)
    ]
    (table,) = tables.overview_tables(points)
    assert [cell.text.replace("\u00a0", " ") for cell in table.cells[1]] == [
        "Orbit",
        "",
        "5 µm (≤ 8 µm)",
        "5 µm (≤ 9 µm)",
    ]


def test_every_kind_of_result_with_a_page_names_a_function_that_makes_it() -> None:
    makers = {**document._MAKERS, **registered("page")}
    assert {"Exploration", "Trace", "Campaign", "SealHistory", "Acceptance", "Sizing"} <= set(
        makers
    )
    assert all(callable(resolve(place)) for place in makers.values())


def test_the_page_of_a_result_is_found_by_its_type(
    machine: Machine, verifications: list[Checks]
) -> None:
    box = replace(verifications[0], label="over all tolerances")
    verification = Verification(tuple(verifications), (box,), ("standstill",), "continuous")
    made = document.page_of(verification, machine, date="2031-02-03")
    assert made.verdicts == () and made.opening is not None
    assert "Over the tolerances" in [section.title for section in made.sections]
    assert made.result is not None and made.result.passed is verification.passed
    assert made.result.text.startswith("FAILED: ") and made.date == "2031-02-03"
    assert "which does not pass: standstill." in dict(made.facts)["Not checked"]


def test_a_result_without_a_page_is_refused_with_those_that_have_one() -> None:
    with pytest.raises(
        InvalidInput, match=r"a dict has no page of its own; give one of Acceptance"
    ):
        document.page_of({})
