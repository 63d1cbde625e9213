"""Seven synthetic controllers at six operating points: the decision, the map behind it and the
page.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.statespace import StateSpace
from ambrose.judge.checks import Check, Checks, Curve, box_label
from ambrose.judge.result import Synthesis
from ambrose.machine.description import OperatingPoint, Operation
from ambrose.machine.file.toml import machine_hash
from ambrose.machine.machine import Machine
from ambrose.record.record import Record
from ambrose.report import (
    comparison as comparison_figures,
    comparison_tables,
    page as document,
    theme,
)
from ambrose.report.comparison import comparison_page
from ambrose.report.comparison_tables import decision, envelope_section, ratio_text, shade_of, share
from ambrose.report.page import Cell, Table
from ambrose.report.tables import still
from ambrose.rig.trace import Trace
from ambrose.rig.trial import Candidate, points_of

NAMES = ("tuned", "PID", "H-infinity", "mu", "mu, polished", "LPV", "commissioned")
SPEEDS, PRESSURES = (0.0, 400.0, 900.0), (0.0, 2e5)
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
OMEGA = np.geomspace(3.0, 6e4, 200)
TIME = np.arange(1500) * 1e-4


def sensitivity(value: float, name: str = "sensitivity.output.max") -> Check:
    return Check(
        name, "Peak output sensitivity", value, "-", 3.0, "<=", value <= 3.0, detail="at 80 Hz"
    )


def settling(value: float) -> Check:
    return Check("impulse.settling", "Settling time", value, "s", 0.02, "<=", value <= 0.02)


def decrement(value: float) -> Check:
    return Check("poles.log_decrement.lowest", "Log decrement", value, "-", 0.1, ">=", value >= 0.1)


def abscissa(value: float) -> Check:
    return Check("stability.abscissa", "Stability", value, "rad/s", 0.0, "<", value < 0)


def at_point(label: str, size: float) -> Checks:
    """A stable loop whose sensitivity is ``size``."""
    rows = size / np.sqrt(1 + np.log(OMEGA / (400 + 3 * np.arange(5)[:, None])) ** 2)
    curves = tuple(
        Curve(name, title, kind, OMEGA, rows * factor, ("worst case", *AXES), "rad/s", unit)
        for name, title, kind, factor, unit in (
            ("sensitivity.output", "Output sensitivity", "frequency", 1.0, "-"),
            ("compliance", "Compliance", "frequency", 1e-7, "m/N"),
            ("unbalance", "Unbalance response", "speed", 1e-6, "m"),
        )
    )
    return Checks(
        label, True, (abscissa(-3.0), sensitivity(size), settling(0.011), decrement(0.5)), curves
    )


def box(label: str, *checks: Check) -> Checks:
    return Checks(box_label(label), True, checks)


def trace(label: str, *, growing: bool) -> Trace:
    wave = 1e-6 * np.sin(600 * TIME) * np.exp((25 if growing else -60) * TIME)
    names = (*(f"y_{axis}" for axis in AXES), *(f"i_{axis}" for axis in AXES))
    record = Record(
        "synthetic",
        1e4,
        names,
        ("m",) * 4 + ("A",) * 4,
        np.tile(wave, (8, 1)),
        OperatingPoint(0.0, label=label),
    )
    return Trace(record, "impulse-parallel", not growing, "completed", "as it went")


@pytest.fixture(scope="module")
def machine(request: pytest.FixtureRequest) -> Machine:
    from tests.report.conftest import sample_machine

    points = tuple(
        OperatingPoint(w, p, label=f"{w:g} at {p:g}")
        for w, p in itertools.product(SPEEDS, PRESSURES)
    )
    return replace(sample_machine(), operation=Operation(points))


@pytest.fixture(scope="module")
def labels(machine: Machine) -> list[str]:
    return [point.label for point in machine.operation.points]


@pytest.fixture(scope="module")
def candidates(labels: list[str]) -> list[Candidate]:
    """tuned holds everything; PID is unstable at one point; LPV leaves two out; the others miss a
    limit.
    """
    made = []
    for k, name in enumerate(NAMES):
        law = StateSpace(-np.eye(4), np.eye(4), (k + 1.0) * 1e4 * np.eye(4), np.zeros((4, 4)))
        checks = [at_point(label, 2.1 + 0.5 * k + 0.01 * i) for i, label in enumerate(labels)]
        if name == "PID":
            checks[1] = Checks(labels[1], False, (abscissa(8.0),))
        left_out = tuple(labels[:2]) if name == "LPV" else ()
        stable = [c for c in checks if c.label not in left_out]
        boxes = tuple(
            box(c.label, sensitivity(2.3 + 0.5 * k, "robust.sensitivity.worst"))
            for c in stable
            if c.stable
        )
        traces = tuple((c.label, trace(c.label, growing=not c.stable)) for c in stable)
        made.append(Candidate(name, Synthesis(law, name), tuple(stable), boxes, traces, left_out))
    return made


def cells_of(table: Table) -> list[tuple[Cell, ...]]:
    return list(table.cells)


def test_a_ratio_is_of_the_limit_whichever_side_is_good() -> None:
    assert sensitivity(1.5).ratio == pytest.approx(0.5)
    assert decrement(0.4).ratio == pytest.approx(0.25)
    assert decrement(-0.1).ratio == decrement(0.0).ratio == np.inf
    assert settling(np.inf).ratio == sensitivity(np.nan).ratio == np.inf
    assert (abscissa(-2.0).ratio, abscissa(2.0).ratio) == (0.0, np.inf)
    assert Check("control.max", "Gain", 5.0, "A/m").ratio is None


@pytest.mark.parametrize("value", [0.3, 0.999, 1.0, 1.0004, 1.3, 4.0])
def test_ratio_shade_and_verdict_agree_on_both_sides_of_the_limit(value: float) -> None:
    for check in (sensitivity(3.0 * value), decrement(0.1 / value)):
        own = share(Checks("p", True, (abscissa(-1.0), check)))
        assert own.check is check
        assert own.passed == bool(check.passed) == shade_of(own).startswith("meets")
        assert own.ratio == pytest.approx(value)
        assert (ratio_text(own.ratio) == "100\u00a0%") == (own.ratio == 1.0)


def test_what_binds_is_the_worst_and_what_fails_goes_first() -> None:
    assert share(Checks("p", True, (sensitivity(2.0), settling(0.019)))).check == settling(0.019)
    strict = Check("x", "x", 3.0, "-", 3.0, "<", False)  # at its limit, and that is not enough
    assert share(Checks("p", True, (strict, sensitivity(3.0)))).check is strict
    assert share(Checks("p", True, ())).check is None
    speeds = Check("stability.speeds", "Stability over speed", 16.0, "rad/s", 0.0, "<", False)
    assert not share(Checks("p", True, (sensitivity(2.0), speeds))).stable


def test_the_decision_names_who_meets_everything_and_what_binds(
    candidates: list[Candidate],
) -> None:
    good = decision(candidates)
    assert good.passed
    assert good.text == (
        "tuned meets every requirement at all 6 operating points and over the tolerances. Tightest "
        "requirement: output sensitivity 2.3 (limit 3), over the tolerances around 0 at 0."
    )
    both = decision([candidates[1], replace(candidates[0], name="other"), candidates[0]])
    assert both.text.startswith("Two controllers meet every requirement at ")
    assert ": other, tuned. Tightest requirement of other: " in both.text
    named = decision(
        [
            candidates[0],
            *(replace(candidates[0], name=name) for name in ("mu, polished", "commissioned")),
        ]
    )
    # mu, which may fail, is not one of them
    assert ': tuned, "mu, polished", commissioned. ' in named.text


def test_without_a_good_one_the_decision_names_the_nearest_and_why(
    candidates: list[Candidate],
) -> None:
    _, pid, hinf, mu, _, lpv, _ = candidates
    bad = decision([pid, mu, hinf, lpv])
    assert bad.passed is False
    assert bad.text.startswith(
        "No controller meets every requirement. Nearest: H-infinity, output sensitivity 3.3 "
        "(limit 3), "
    )
    assert decision([pid, lpv]).text.endswith("Nearest: PID, unstable at 0 at 200000.")
    assert (
        "LPV, not evaluated at 0 at 0 and 0 at 200000, outside its schedule" in decision([lpv]).text
    )
    lost = box("p", Check("robust.stability.margin", "Margin", 0.8, "-", 1.0, ">=", False))
    broken = replace(pid, checks=(at_point("p", 2.0),), boxes=(lost,))
    assert "PID, unstable over the tolerances around p" in decision([broken]).text
    elsewhere, bad_one = replace(candidates[0], name="elsewhere"), replace(pid, boxes=(lost,))
    at_five = tuple(checks for checks in candidates[0].checks if checks.label != "0 at 200000")
    assert (
        "Nearest: elsewhere, not evaluated at 0 at 200000."
        in decision([replace(elsewhere, checks=at_five), bad_one]).text
    )
    bare = replace(pid, checks=(Checks("p", True, ()),), boxes=())
    assert "No limits were given" in decision([bare]).text


def test_a_grid_of_points_becomes_a_panel_of_speed_over_pressure_for_each_controller(
    machine: Machine, candidates: list[Candidate]
) -> None:
    section = envelope_section(machine, candidates, points_of(machine, candidates))
    panels = section.tables
    assert [panel.title for panel in panels] == list(NAMES)
    pid = panels[1]
    assert pid.columns == ("", "0\u00a0rpm", "3\u202f820\u00a0rpm", "8\u202f594\u00a0rpm")
    assert [row[0].text for row in pid.cells] == [
        "2\u00a0bar",
        "± tolerances",
        "0\u00a0bar",
        "± tolerances",
    ]
    top, beneath = pid.cells[:2]
    assert (top[1].text, top[1].shade, top[1].mark) == ("unstable", "unstable", "fail")
    assert (beneath[1].text, beneath[1].shade) == ("not evaluated", "absent")
    assert (top[2].text, top[2].detail, top[2].shade) == ("88\u00a0%", "", "meets-3")
    assert "uses: output sensitivity, where no other is named" in panels[-1].note
    lpv = panels[5]
    assert [row[1].text for row in lpv.cells] == ["not evaluated"] * 4
    assert lpv.cells[0][1].detail == "not in its schedule"


def test_points_that_are_no_grid_become_rows_with_speed_and_pressure(
    machine: Machine, candidates: list[Candidate]
) -> None:
    points = machine.operation.points
    line = replace(machine, operation=Operation((points[0], points[3], points[5])))
    some = [
        replace(c, checks=tuple(x for x in c.checks if x.label != points[4].label), boxes=())
        for c in candidates[:3]
    ]
    kept = {point.label for point in line.operation.points}
    some = [replace(c, checks=tuple(x for x in c.checks if x.label in kept)) for c in some]
    (table,) = envelope_section(line, some, points_of(line, some)).tables
    assert table.columns == ("Operating point", *NAMES[:3])
    assert [row[0].detail for row in table.cells] == [
        "0 rpm, 0 bar".replace(" ", "\u00a0").replace(",\u00a0", ", "),
        *[f"{rpm}\u00a0rpm, 2\u00a0bar" for rpm in ("3\u202f820", "8\u202f594")],
    ]
    assert not any("±" in row[0].text for row in table.cells)  # no tolerances, no second rows


def test_a_point_that_every_schedule_leaves_out_is_in_the_map(
    machine: Machine, candidates: list[Candidate]
) -> None:
    lpv = candidates[5]
    (panel,) = envelope_section(machine, [lpv], points_of(machine, [lpv])).tables
    assert [row[1].text for row in panel.cells] == ["not evaluated"] * 4
    elsewhere = replace(lpv, left_out=("somewhere",))
    (table,) = envelope_section(machine, [elsewhere], points_of(machine, [elsewhere])).tables
    assert table.cells[-1][0].text == "somewhere"


def test_what_has_no_finite_ratio_is_said_all_the_same(candidates: list[Candidate]) -> None:
    never = replace(candidates[0], checks=(Checks("p", True, (settling(np.inf),)),), boxes=())
    assert "settling ∞ (limit 20\u00a0ms), at p" in decision([never]).text.replace("∞\u00a0ms", "∞")
    assert shade_of(share(never.checks[0])) == "fails-4"


def test_no_row_of_the_tables_is_without_its_label(
    candidates: list[Candidate], labels: list[str]
) -> None:
    unstable = [
        replace(c, checks=tuple(Checks(x.label, x.label != labels[0], x.checks) for x in c.checks))
        for c in candidates
    ]
    for table in comparison_tables.point_tables(unstable, labels):
        assert all(row[0].text for row in table.cells)
    words = [
        cell.text
        for table in comparison_tables.point_tables(unstable, labels)
        for row in table.cells
        for cell in row
    ]
    assert "not evaluated" in words


def test_what_is_not_varied_is_counted_by_point_and_reason() -> None:
    told = [
        f"{point} (P1): {name} (zero here)" for point in ("rest", "top") for name in ("K", "C")
    ] + ["top (P1): c (given)"]
    assert still(told) == [
        "Tolerances without effect (coefficient is zero): 2 at rest (P1), 2 at top (P1).",
        "Not varied around top (P1): c (given).",
    ]
    assert still([]) == []


# Okabe & Ito's own differ by 7.6 for deuteranopes. Matrices: Machado et al., 2009, severity 1;
# colour space: Ottosson, 2020.
_SEEN = {
    "normal": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
}
_LMS = [
    [0.4122214708, 0.5363325363, 0.0514459929],
    [0.2119034982, 0.6806995451, 0.1073969566],
    [0.0883024619, 0.2817188376, 0.6299787005],
]
_LAB = [
    [0.2104542553, 0.7936177850, -0.0040720468],
    [1.9779984951, -2.4285922050, 0.4505937099],
    [0.0259040371, 0.7827717662, -0.8086757660],
]


def seen(colour: str, eye: str) -> np.ndarray:
    share_ = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(share_ <= 0.04045, share_ / 12.92, ((share_ + 0.055) / 1.055) ** 2.4)
    return (
        100
        * np.array(_LAB)
        @ np.cbrt(np.array(_LMS) @ np.clip(np.array(_SEEN[eye]) @ linear, 0, 1))
    )


@pytest.mark.parametrize("eye", _SEEN)
def test_every_controller_has_a_colour_of_its_own_for_every_eye(eye: str) -> None:
    colours = [style.colour for style in theme.candidate_styles([*NAMES, "an eighth"]).values()]
    assert len(set(colours)) == 8
    assert (
        min(
            np.linalg.norm(seen(a, eye) - seen(b, eye))
            for a, b in itertools.combinations(colours, 2)
        )
        > 12
    )
    met = [document.SHADES[name] for name in document.SHADES if name.startswith("meets")]
    missed = [
        document.SHADES[name] for name in document.SHADES if name.startswith(("fails", "unstable"))
    ]
    for a, b in itertools.product(met, missed):
        assert all(
            np.linalg.norm(seen(left, eye) - seen(right, eye)) > 5
            for left, right in zip(a, b, strict=True)
        )


def test_panels_stand_in_rows_of_equal_length_and_titles_are_clear_of_the_peaks(
    candidates: list[Candidate], labels: list[str]
) -> None:
    assert [len(row) for n in (3, 5, 6, 7, 9) for row in comparison_figures.wrapped(range(n))] == [
        3,
        3,
        2,
        3,
        3,
        4,
        3,
        3,
        3,
        3,
    ]
    picture = comparison_figures.loop_figures(candidates, labels)[0].picture
    for panel in {
        note.xref
        for note in picture.layout.annotations
        if "domain" in note.xref and "<b>" in note.text
    }:
        above = [
            note
            for note in picture.layout.annotations
            if note.xref == panel and note.y == 1 and note.yanchor == "bottom"
        ]
        heights = sorted(note.yshift for note in above)
        assert len(above) >= 2 and min(np.diff(heights)) >= 14
        assert all(len(re.sub("<[^>]*>", "", note.text)) * 7 <= 900 / 4 for note in above)


def test_an_unstable_run_is_an_outline_and_a_missing_one_is_said(
    machine: Machine, candidates: list[Candidate], labels: list[str]
) -> None:
    picture = comparison_figures.time_figures(machine, candidates, labels)[0].picture
    words = " ".join(note.text for note in picture.layout.annotations)
    assert "unstable" in words and f"{labels[0]}: not evaluated" in words
    unstable = [
        line for line in picture.data if line.name == labels[1] and np.max(np.abs(line.y)) > 5
    ]
    assert len(unstable) == 2 * 4  # two sides, four axes
    for line in unstable:
        assert len(line.y) <= 150
        assert np.all(np.diff(np.abs(line.y)) >= -1e-6)  # no oscillation is left to fill the panel
    calm = [line for line in picture.data if line.name == labels[0]]
    assert max(len(line.y) for line in calm) <= 600 < len(TIME)
    # two float32 of every point in base64, and words
    assert len(picture.to_json()) < 6 * 7 * 4 * 600 * 16
    assert max(np.max(line.y) for line in calm) == pytest.approx(
        max(trace("p", growing=False).record.values[0]) * 1e6, rel=1e-6
    )


def test_the_page_of_seven_controllers_begins_with_the_decision_and_ends_with_the_signature(
    machine: Machine, candidates: list[Candidate], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(document, "get_library", lambda: "")
    report = comparison_page(
        machine, [replace(c, traces=()) for c in candidates], date="2031-02-03"
    )
    text = document.render(report)
    assert len(text) < 1.5e6
    body = text[text.index("<main>") :]
    order = [
        body.index(words)
        for words in (
            "<h1>",
            "tuned meets every requirement",
            "Share of the limit",
            "Controllers (states), SHA-256",
            "At a glance",
        )
    ]
    assert order == sorted(order)
    assert "prefers-color-scheme: dark" in text
    for tag in ("div", "table", "details", "figure"):
        assert len(re.findall(f"<{tag}[ >]", body)) == body.count(f"</{tag}>") > 0
    maps = body[body.index('<div class="opening maps">') : body.index("Share of the limit")]
    # each panel is one part of the grid
    assert [maps.count(f"<div><h2>{name}</h2>") for name in NAMES] == [1] * 7
    assert body.count('<p class="screen">') == 2 and re.search(
        r"\.screen\b[^{]*\{ display: none; \}", text[text.index("@media print") :]
    )
    assert f"SHA-256 {machine_hash(machine)}" in body and "2031-02-03 with ambrose" in body
    (made,) = (s.tables[0] for s in report.sections if s.title == "Controllers")
    assert {row[0].text: row[-1].detail for row in cells_of(made)} == {
        c.name: c.synthesis.digest for c in candidates
    }
    assert body.index("Prepared: name, date, signature") > body.rindex("<h2>")


def test_the_page_of_one_controller_begins_and_ends_alike(
    machine: Machine, candidates: list[Candidate]
) -> None:
    report = comparison_page(
        machine, [replace(candidates[0], traces=(), checks=candidates[0].checks[:1], boxes=())]
    )
    assert report.result is not None and report.result.text.startswith(
        "tuned meets every requirement at the operating point. "
    )
    assert report.opening is not None
    assert len(report.signatures) == 3
