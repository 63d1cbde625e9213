"""The page of a campaign: the worst cases first, what drives them, maps, all cases side by side;
and a page for a single case.

write(campaign_page(result, machine), "campaign/report.html")
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from itertools import combinations
from typing import Any

import numpy as np

from ambrose.annexes.campaigns.case import Subject
from ambrose.annexes.campaigns.result import Campaign
from ambrose.annexes.campaigns.tasks import PEAK, checks_of, run
from ambrose.core.presentation import in_words
from ambrose.machine.machine import Machine
from ambrose.report import theme
from ambrose.report.figures.axes import drawn
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict
from ambrose.report.record import record_page
from ambrose.report.verification import verification_page

_WORST = 20  # rows of each table
_LINES = 1500  # drawn; of more, the best half and the worst half
_BINS = 10  # classes of a parameter that has more than three times as many values
_MAPS = 3  # pairs of parameters that are mapped
_SCALE = ((0.0, "#d5efe8"), (0.5, "#f7bd80"), (1.0, "#d55e00"))
_DARK = "#4a1626"
_MAP = (
    "Each cell shows the worst of all cases that fall into it, whatever else is varied. Dark "
    "cells hold an unstable loop. "
    "Drawn over the settings that matter most; the tenth of the cells that is worst has one colour."
)
_SHARES = (
    "Share of the variance of the measure (of its logarithm) that goes when one setting alone is "
    "known: first-order indices of "
    "Sobol, from the cases themselves; unstable cases are left out. What is missing to 100 % is "
    "due to settings together."
)
_PARALLEL = (
    "Every line is a case; drag along an axis to keep those that pass there. Shown are the worst "
    "and an even choice of others."
)
_HOW = {
    "screen": "Stability and the largest singular value of the output sensitivity of the "
    "continuous loop, with the mean delay "
    "of the sampled one, on a frequency grid refined around its peak: a screening, not a "
    "verification.",
    "verify": "Every nominal check on the full plant, of the loop as it runs.",
    "design": "A design for each case, certified on the full plants.",
    "simulate": "The scenario on the nonlinear virtual rig.",
    "identify": "A run of the case's machine, identified from the machine of the file.",
}


def campaign_page(
    campaign: Campaign, machine: Machine, pages: Collection[str] = (), *, date: str = ""
) -> Page:
    """The page of a campaign; machine: the one it began with; pages: the cases (keys) that have a
    page of their own.
    """
    effects = campaign.effects()
    sections = [Section("Worst cases", "", (), _worst_tables(campaign, pages))]
    sections += [
        Section("Maps", "", tuple(maps), ()) for maps in [_maps(campaign, effects)] if maps
    ]
    if effects:
        pictures = (
            Figure("What drives it", _shares(effects), _SHARES),
            Figure("Distribution", _distribution(campaign, machine)),
        )
        sections.append(Section("What drives it", "", pictures))
        sections.append(
            Section(
                "All cases", "", (Figure("Cases side by side", _parallel(campaign), _PARALLEL),)
            )
        )
    seed = f", seed {campaign.plan.seed}" if campaign.plan.plan != "grid" else ""
    facts = (
        ("Task", campaign.plan.task),
        ("Plan", f"{campaign.plan.plan}, {len(campaign.keys)} cases{seed}"),
        (
            "How",
            _HOW[campaign.plan.task]
            + (" On the reduced plant." if campaign.plan.model == "reduced" else ""),
        ),
        ("Not computed yet", str(campaign.missing) if campaign.missing else ""),
    )
    verdicts = [Verdict(name.capitalize(), passed, text) for name, passed, text in counts(campaign)]
    bad = [verdict.text for verdict in verdicts if verdict.passed is False]
    words = (
        f"{'; '.join(bad)}"
        if bad
        else f"nothing failed in {len(campaign.keys) - campaign.missing} cases"
    )
    result = Verdict("Result", not bad, words)
    return Page("Campaign", machine, tuple(sections), tuple(verdicts), facts, date, result=result)


def counts(campaign: Campaign) -> list[tuple[str, bool | None, str]]:
    """What is to be said in words of all cases together: about what, whether it is good, how
    many.
    """
    done = len(campaign.keys) - campaign.missing
    rows: list[tuple[str, bool | None, str]] = []
    for name, bad in (
        ("stable", "unstable"),
        ("passed", "do not pass"),
        ("completed", "not completed"),
    ):
        if name in campaign.values and (evaluated := int((~np.isnan(campaign.values[name])).sum())):
            count = int((campaign.values[name] == 0).sum())
            rows.append(
                (
                    name,
                    count == 0,
                    f"{count} of {evaluated} cases {bad}" if count else f"all {evaluated} cases",
                )
            )
    order = campaign.worst_first
    if len(order) and math.isfinite(value := float(campaign.values[campaign.measure][order[0]])):
        rows.append(("worst", None, f"{campaign.measure} {value:.4g}"))
    if campaign.failed:
        rows.append(
            ("without values", False, f"{campaign.failed} of {done} cases could not be computed")
        )
    return rows


def _told(campaign: Campaign, path: str, i: int) -> str:
    value = campaign.settings[path][i]
    return (
        f"{value:.4g} {campaign.units[path]}".rstrip() if isinstance(value, float) else str(value)
    )


def _worst_tables(campaign: Campaign, pages: Collection[str]) -> tuple[Table, ...]:
    order = campaign.worst_first[:_WORST].tolist()
    paths, tables = list(campaign.settings), []
    rows: list[Row] = []
    for i in order:
        key, value = campaign.keys[i], float(campaign.values[campaign.measure][i])
        words = "unstable" if campaign.lost[i] else f"{value:.4g}"
        link = f"cases/{key}.html" if key in pages else ""
        rows.append(
            (
                Cell(key[:8], link=link),
                Cell(words, "number"),
                *(Cell(_told(campaign, p, i), "number") for p in paths),
            )
        )
    if rows:
        note = "A case's name leads to its own page." if pages else ""
        tables.append(
            Table(f"By {campaign.measure}", ("Case", "Measure", *paths), tuple(rows), note)
        )
    reasons = Counter(text for text in campaign.failures if text)
    if reasons:
        reason_rows = tuple(
            (reason, Cell(str(count), "number")) for reason, count in reasons.most_common(_WORST)
        )
        tables.append(Table("Why cases have no values", ("Reason", "Cases"), reason_rows))
    return tuple(tables)


def _axis(campaign: Campaign, path: str) -> tuple[np.ndarray, list[str]]:
    """In which class of a setting each case falls (c,), and the classes' names."""
    column = campaign.settings[path]
    unit = campaign.units[path]
    if column.dtype.kind != "f":
        names, which = np.unique(column.astype(str), return_inverse=True)
        return which, list(map(str, names))
    levels, which = np.unique(column, return_inverse=True)
    if len(levels) > 3 * _BINS:
        edges = np.linspace(column.min(), column.max(), _BINS + 1)
        which = np.clip(np.digitize(column, edges) - 1, 0, _BINS - 1)
        levels = (edges[1:] + edges[:-1]) / 2
    return which, [f"{level:.4g} {unit}".rstrip() for level in levels]


def _maps(campaign: Campaign, effects: Mapping[str, float]) -> list[Figure]:
    """The worst over pairs of the settings that matter most."""
    chosen = [
        path
        for path in (effects or campaign.settings)
        if len(np.unique(campaign.settings[path].astype(str))) > 1
    ][:_MAPS]
    return [
        Figure(f"Worst over {a} and {b}", picture, _MAP if n == 0 else "")
        for n, (a, b) in enumerate(combinations(chosen, 2))
        if (picture := _map(campaign, a, b)) is not None
    ]


def _map(campaign: Campaign, a: str, b: str) -> Any:
    import plotly.graph_objects as go

    if not campaign.measure:
        return None
    values = campaign.values[campaign.measure]
    x, across = _axis(campaign, a)
    y, down = _axis(campaign, b)
    worst = np.full((len(down), len(across)), np.nan)
    unstable = worst.copy()
    evaluated = ~np.isnan(values)
    np.fmax.at(worst, (y[evaluated], x[evaluated]), values[evaluated])
    unstable[y[campaign.lost], x[campaign.lost]] = 1.0  # one case is enough for a cell
    finite = np.where(np.isfinite(worst) & np.isnan(unstable), worst, np.nan)
    picture = theme.subplots(rows=1, cols=1)
    hover = f"{theme.plain(a)} %{{x}}<br>{theme.plain(b)} %{{y}}<br>"
    bar = {
        "title": {"text": theme.plain(campaign.measure), "side": "right"},
        "thickness": 10,
        "outlinewidth": 0,
    }
    if np.isfinite(finite).any():
        # cells next to instability would take all the colours
        highest = float(np.nanpercentile(finite, 90))
        picture.add_trace(
            go.Heatmap(
                x=across,
                y=down,
                z=_none(finite),
                zmin=float(np.nanmin(finite)),
                zmax=highest,
                colorscale=_SCALE,
                colorbar=bar,
                xgap=1,
                ygap=1,
                hovertemplate=f"{hover}worst %{{z:.4g}}<extra></extra>",
            )
        )
    if np.isfinite(unstable).any():
        picture.add_trace(
            go.Heatmap(
                x=across,
                y=down,
                z=_none(unstable),
                colorscale=((0, _DARK), (1, _DARK)),
                showscale=False,
                xgap=1,
                ygap=1,
                hovertemplate=f"{hover}unstable<extra></extra>",
            )
        )
    theme.dress(picture, max(220, 24 * len(down) + 60), legend=False)
    picture.update_xaxes(title_text=theme.plain(a), type="category")
    picture.update_yaxes(title_text=theme.plain(b), type="category")
    return picture


def _none(values: np.ndarray) -> list[list[float | None]]:
    return [[float(f"{v:.5g}") if np.isfinite(v) else None for v in row] for row in values]


def _shares(effects: Mapping[str, float]) -> Any:
    picture = theme.subplots(rows=1, cols=1)
    names = list(effects)[::-1]
    shares = [100 * effects[name] for name in names]
    picture.add_trace(
        {
            "type": "bar",
            "orientation": "h",
            "x": shares,
            "y": [theme.plain(name) for name in names],
            "marker": {"color": "#0072b2"},
            "text": [f"{share:.3g} %" for share in shares],
            "textposition": "auto",
            "hovertemplate": "%{y}: %{x:.3g} %<extra></extra>",
        }
    )
    theme.dress(picture, 28 * len(names) + 70, legend=False)
    picture.update_xaxes(
        title_text=f"Share of the variance [%], together {sum(shares):.3g} %", rangemode="tozero"
    )
    return picture


def _distribution(campaign: Campaign, machine: Machine) -> Any:
    """How many cases have which measure, and where the requirement is."""
    values = campaign.values[campaign.measure]
    finite = values[np.isfinite(values)]
    positive = bool((finite > 0).all()) and finite.max() > 3 * finite.min()
    edges = (np.geomspace if positive else np.linspace)(
        finite.min(), finite.max() * (1 + 1e-12) + (finite.max() == 0), 41
    )
    count, _ = np.histogram(finite, edges)
    picture = theme.subplots(rows=1, cols=1)
    picture.add_trace(
        {
            "type": "bar",
            "x": drawn((edges[1:] + edges[:-1]) / 2),
            "y": count.tolist(),
            "width": drawn(np.diff(edges)),
            "marker": {"color": "#0072b2"},
            "hovertemplate": "%{x:.4g}: %{y} cases<extra></extra>",
        }
    )
    limit = machine.requirements.sensitivity_peak if campaign.measure == PEAK else None
    if limit is not None:
        picture.add_vline(
            x=math.log10(limit) if positive else limit,
            line={"dash": "dash", "color": theme.LIMIT, "width": 1.2},
        )
    theme.dress(picture, 240, legend=False)
    unstable = int(campaign.lost.sum())
    beside = f" ({unstable} unstable cases beside)" if unstable else ""
    axis = theme.decades(float(edges[0]), float(edges[-1])) if positive else {}
    picture.update_xaxes(title_text=f"{theme.plain(campaign.measure)}{beside}", **axis)
    picture.update_yaxes(title_text="Cases", rangemode="tozero")
    return picture


def _parallel(campaign: Campaign) -> Any:
    import plotly.graph_objects as go

    order = campaign.worst_first
    if len(order) > _LINES:
        half = _LINES // 2
        order = np.concatenate(
            [order[:half], order[np.linspace(half, len(order) - 1, half).astype(int)]]
        )
    values = campaign.values[campaign.measure][order]
    finite = values[np.isfinite(values)]
    highest = float(finite.max())
    colour = np.where(np.isfinite(values), values, 1.1 * highest)
    columns: list[dict[str, Any]] = []
    for path, column in campaign.settings.items():
        label = (
            f"{theme.plain(path)} [{campaign.units[path]}]"
            if campaign.units[path]
            else theme.plain(path)
        )
        if column.dtype.kind == "f":
            columns.append({"label": label, "values": drawn(column[order])})
        else:
            which, names = _axis(campaign, path)
            columns.append(
                {
                    "label": label,
                    "values": which[order].tolist(),
                    "tickvals": list(range(len(names))),
                    "ticktext": names,
                }
            )
    end = " (unstable: at the top)" if campaign.lost[order].any() else ""
    columns.append({"label": f"{theme.plain(campaign.measure)}{end}", "values": drawn(colour)})
    for i, entry in enumerate(columns):  # long names would cover their neighbours
        entry["label"] = f"{i + 1}. {str(entry['label'])[-22:]}"
    picture = theme.subplots(rows=1, cols=1)
    picture.add_trace(
        go.Parcoords(
            dimensions=columns,
            labelside="bottom",
            line={"color": drawn(colour), "colorscale": _SCALE, "cmin": float(finite.min())},
            labelfont={"size": 11},
            tickfont={"size": 10},
        )
    )
    theme.dress(picture, 420, legend=False)
    picture.update_xaxes(visible=False)
    picture.update_yaxes(visible=False)
    picture.update_layout(margin={"t": 30, "b": 60, "l": 60, "r": 60})
    return picture


def case_page(task: str, key: str, settings: Mapping[str, Any], item: Subject) -> Page:
    """The page of one case, computed anew: its checks and curves, or its run."""
    facts = tuple(
        (path, in_words(value) if isinstance(value, float) else str(value))
        for path, value in settings.items()
    )
    if task in {"simulate", "identify"}:
        return record_page(
            run(item),
            item.machine,
            title=f"Case {key[:8]}: " + ", ".join(" ".join(pair) for pair in facts),
        )
    return verification_page(
        item.machine, [checks_of(item)], facts=facts, title=f"Case {key[:8]} of a campaign"
    )
