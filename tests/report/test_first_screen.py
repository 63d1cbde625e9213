"""The first screen of a page: one verdict and what decides in sight at both widths, the rest folded
so that a reader meets 1,500 words at most.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ambrose.core.statespace import static_gain
from ambrose.judge.checks import Check, Checks, Verification, box_label
from ambrose.judge.result import Synthesis
from ambrose.machine.description import OperatingPoint, Operation
from ambrose.machine.machine import Machine
from ambrose.report import page as document
from ambrose.report.comparison import comparison_page
from ambrose.report.page import Page, Section, Table
from ambrose.rig.trial import Candidate
from first_screen import WIDTHS, measure
from needs import needs

NAMES = ("tuned", "PID", "H-infinity", "mu", "mu, polished", "commissioned")


def loop(label: str, size: float) -> Checks:
    rows = (
        ("sensitivity.output.max", "Peak output sensitivity, maximum singular value", 3.0, "-"),
        ("sensitivity.output.A_zeta", "Peak output sensitivity, A_zeta", 3.0, "-"),
        ("unbalance.orbit_0p", "Worst-case unbalance orbit up to 200 Hz, 0-p", 1e-5, "m"),
        ("unbalance.current_0p", "Worst-case unbalance current, 0-p", 4.0, "A"),
        ("impulse.settling", "Settling time after a current pulse", 0.02, "s"),
    )
    checks = tuple(
        Check(name, title, size * limit, unit, limit, "<=", size <= 1, detail="at 80 Hz")
        for name, title, limit, unit in rows
    )
    stable = Check("stability.abscissa", "Stability", -3.0, "rad/s", 0.0, "<", True)
    return Checks(label, True, (stable, *checks))


def points(machine: Machine, count: int) -> Machine:
    labels = ("standstill", "nominal speed", "nominal speed without seal (P1)", "300 Hz (P3)")
    made = (
        OperatingPoint(100.0 * i, 1e5 * (i % 3), label=labels[i] if i < 4 else f"point {i}")
        for i in range(count)
    )
    return replace(machine, operation=Operation(tuple(made)))


def verification(machine: Machine, count: int) -> Page:
    machine = points(machine, count)
    loops = [loop(p.label, 0.7 + 0.1 * i) for i, p in enumerate(machine.operation.points)]
    boxes = tuple(replace(own, label=box_label(own.label)) for own in loops[:4])
    return document.page_of(Verification(tuple(loops), boxes), machine)


def comparison(machine: Machine) -> Page:
    machine = points(machine, 4)
    labels = [point.label for point in machine.operation.points]
    law = Synthesis(static_gain([[1.0]], ["err_A"], ["u_A"]), "pid")
    candidates = [
        Candidate(
            name,
            law,
            tuple(loop(label, 0.8 + 0.1 * k) for label in labels),
            (replace(loop(labels[0], 0.9 + 0.1 * k), label=box_label(labels[0])),),
        )
        for k, name in enumerate(NAMES)
    ]
    return comparison_page(machine, candidates)


@needs("browser")
@pytest.mark.parametrize("kind", ["verification", "comparison"])
@pytest.mark.parametrize("width", WIDTHS)
def test_verdict_and_what_decides_are_in_sight(
    kind: str, width: int, machine: Machine, browser: Any, tmp_path: Path
) -> None:
    made = verification(machine, 6) if kind == "verification" else comparison(machine)
    seen = measure(browser, document.write(made, tmp_path / "page.html"), width)
    assert seen.verdict < seen.decides <= WIDTHS[width]
    assert seen.words <= 1500 and seen.printed <= 2500
    assert not seen.wider


@needs("browser")
def test_sixteen_points_are_no_longer_to_read(
    machine: Machine, browser: Any, tmp_path: Path
) -> None:
    path = document.write(verification(machine, 16), tmp_path / "page.html")
    seen = measure(browser, path, 1400)
    assert seen.decides <= WIDTHS[1400] and seen.words <= 1500


@needs("browser")
def test_paper_shows_what_the_screen_folds_but_for_what_is_marked(
    machine: Machine, browser: Any, tmp_path: Path
) -> None:
    """A section of 2,000 words is closed on the screen and printed; a folded table is neither."""
    many = Table("rows", ("a",), (("word " * 2000,),))
    kept = Section("printed", tables=(many,))
    aside = replace(kept, on_paper=False)
    folded = Section("folded", tables=(replace(many, folded=True),))
    for sections, printed in (((kept,), 1), ((aside,), 0), ((folded,), 0)):
        page = Page("t", machine, sections, signatures=())
        seen = measure(browser, document.write(page, tmp_path / "page.html"), 1400)
        assert seen.words < 200
        assert (seen.printed > 2000) == printed


_OVERLAP = """() => [...document.querySelectorAll("tbody tr")].some((row) => {
  const cells = [...row.cells].map((cell) => {
    const range = document.createRange();
    range.selectNodeContents(cell);
    return range.getBoundingClientRect();
  });
  return cells.some((one, i) => i && cells[i - 1].right > one.left);
})"""


@needs("browser")
def test_a_number_does_not_run_into_its_limit_on_a_phone(
    machine: Machine, browser: Any, tmp_path: Path
) -> None:
    """36.7 1/s stood over its limit of 0 1/s, in columns of 9 % each."""
    row = ("twice nominal pressure", "Stability", "36.7\u00a01/s", "< 0\u00a01/s", "pole at 46 Hz")
    table = Table(
        "Not met", ("at", "what", "value", "limit", "found"), (row,), "", (15, 29, 9, 9, 38)
    )
    page = Page("t", machine, (Section("s", tables=(table,)),), signatures=())
    context = browser.new_context(viewport={"width": 400, "height": 800})
    shown = context.new_page()
    shown.goto(document.write(page, tmp_path / "page.html").as_uri())
    assert not shown.evaluate(_OVERLAP)
    context.close()


@needs("browser")
def test_paper_holds_nothing_that_acts_on_a_screen_alone(
    machine: Machine, browser: Any, tmp_path: Path
) -> None:
    """A page with the footer alone was printed, a deciding table at half of its width, and closed
    tables as titles without a word.
    """
    table = Table("Limits", ("a", "b"), (("1", "2"),))
    folded = Section("s", tables=(replace(table, folded=True),))
    page = Page("t", machine, (folded,), signatures=(), opening=Section("", tables=(table,)))
    context = browser.new_context(viewport={"width": 700, "height": 900})
    shown = context.new_page()
    shown.goto(document.write(page, tmp_path / "page.html").as_uri())
    shown.emulate_media(media="print")
    width = "(kind) => document.querySelector(kind).getBoundingClientRect().width"
    assert shown.evaluate(width, ".opening table") > 0.9 * shown.evaluate(width, "main")
    assert not shown.locator("footer").is_visible()
    said = "getComputedStyle(document.querySelector('.section details summary'), '::after').content"
    assert "not printed" in shown.evaluate(said)
    context.close()
