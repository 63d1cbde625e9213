"""Figures in the pages: the quick ones are computed anew, every quoted one is stored, a stale one
is noticed.
"""

import re

import pytest
from docs_build.blocks import pages
from docs_build.figures import UnknownFigure, differences, lookup, quoted, render, stored
from docs_build.recipes import QUICK, SLOW
from docs_build.report_picture import carried, shown


@pytest.mark.parametrize("group", QUICK)
def test_quick_figures_are_those_stored(group):
    changed = differences(stored()[group], QUICK[group]())
    assert not changed, (
        f"stale figures; run python -m docs_build.figures --write {group} and read the pages:\n"
        + "\n".join(changed)
    )


@pytest.mark.parametrize("name", pages())
def test_every_figure_that_a_page_quotes_is_stored(name):
    text = pages()[name].read_text(encoding="utf-8")
    for key in quoted(text):
        lookup(key, stored())
    render(text, stored())


README = [  # the README is read where no site builder fills figures in
    "a finite-element rotor ({{ check.rotor_states }} states)",
    "a reduced plant ({{ check.reduced_rotor_states }} rotor states)",
    "mu ({{ study.mu.states }} states) is stable everywhere with a largest sensitivity of {{ "
    "study.mu.worst:.1f }}",
    "at once, with {{ study.tuned.states }} states and {{ study.tuned.worst:.1f }}",
    "needs {{ study_turboexpander.run_up.mu.rig.first*1e3:.0f }} ms at 20 Hz",
    "`seal-rig` ({{ check.mass:.0f }} kg rotor",
]


@pytest.mark.parametrize("phrase", README)
def test_readme_quotes_what_is_stored(phrase):
    text = " ".join(pages()["README.md"].read_text(encoding="utf-8").split())
    assert render(phrase, stored()) in text


def test_readme_says_below_what_the_polished_controller_stays():
    """2.82 to 2.87, as the processor rounds: the page says less than it."""
    text = " ".join(pages()["README.md"].read_text(encoding="utf-8").split())
    states = stored()["study"]["polish.states"]
    found = re.search(
        rf"polished to {states} states passes every check with less than ([\d.]+);", text
    )
    assert stored()["study"]["polish.worst"] < float(found[1]) < 3  # the seal rig's own limit


def test_the_picture_of_the_report_shows_the_stored_study():
    remedy = "run make demo, then python -m docs_build.report_picture out/seal-rig/report.html"
    assert carried() == shown(), f"stale picture; {remedy}"


def test_groups_stored_are_those_with_a_recipe():
    assert list(stored()) == [name for name in QUICK | SLOW if name in stored()]


def test_rendering():
    figures = {"a": {"b.c": 0.01234, "d": "unstable"}}
    assert (
        render("x {{ a.b.c:.3f }}, {{ a.b.c*1e3:.1f }} ms, {{ a.d:.2f }}", figures)
        == "x 0.012, 12.3 ms, unstable"
    )
    with pytest.raises(UnknownFigure, match=r"a\.x is not in"):
        render("{{ a.x }}", figures)


def test_a_stale_figure_is_noticed():
    assert differences({"a": 2.45}, {"a": 2.4743}) == ["a: stored 2.45, computed 2.4743"]
    assert differences({"a": 2.4743}, {"a": 2.47431}) == []
    assert differences({"a": 1.0}, {}) == ["a: stored 1.0, computed None"]
