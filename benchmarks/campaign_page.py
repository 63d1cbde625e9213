"""A campaign on one page: repeated experiments under several conditions, every parameter with its
interval.

    six = Condition("6 A", 6.0, {"closed loop": repeats_6, "static load": loads_6}, truth)
    write(campaign_page(machine, [six, eight, ten]), "campaign.html")

One panel per parameter over the condition (a bias current, a pressure), methods side by side with
the intervals of their means; then the tables: mean, interval, relative scatter, what a single
record states for it, the distance to the truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.identification.static_load import StaticLoad
from ambrose.identification.validation.repeatability import Repeats
from ambrose.machine.machine import Machine
from ambrose.report import theme, theme as units
from ambrose.report.page import Cell, Figure, Page, Section, Table, Verdict

_QUANTITIES = {
    "force_per_current": ("Force per current", "N/A"),
    "negative_stiffness": ("Negative stiffness", "N/m"),
    "tau_e": ("Lag of the actuator", "s"),
}
# [px]; panels per row; of the axis, between methods
_HEIGHT = 200
_COLUMNS = 2
_APART = 0.035
_AGREE = 10.0  # [%] that two methods may differ (paper P2)


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """One condition: label, its place ``x`` on the axis, the repeats of every method, what is
    known.

    truth and reference: path -> value, where known (a rig's own force; a published figure). fit
    [%]: mean of the records. loaded: static loads whose local slopes are drawn.
    """

    label: str
    x: float
    methods: Mapping[str, Repeats]
    truth: Mapping[str, float] = field(default_factory=dict)
    reference: Mapping[str, float] = field(default_factory=dict)
    fit: float | None = None
    loaded: StaticLoad | None = None


def campaign_page(
    machine: Machine,
    conditions: Sequence[Condition],
    *,
    axis: str = "bias current [A]",
    reference: str = "published",
    title: str = "Identification campaign",
    date: str = "",
) -> Page:
    """The page. axis: what ``x`` is; reference: what the reference values are. Raises InvalidInput
    without a condition.
    """
    if not conditions:
        raise InvalidInput("a campaign needs at least one condition; give those that were measured")
    sections = []
    for quantity, paths in _grouped(conditions).items():
        name, unit = _QUANTITIES.get(quantity, (units.axis_name(quantity), ""))
        picture = _figure(conditions, paths, unit, axis, reference)
        caption = (
            "Means of the repeats with their "
            f"{conditions[0].methods[_first(conditions)].level:.0%} intervals."
        )
        caption += " Rings: the truth." if any(c.truth for c in conditions) else ""
        caption += (
            f" Diamonds: {reference}."
            if any(set(c.reference) & set(paths) for c in conditions)
            else ""
        )
        sections.append(
            Section(
                name,
                "",
                (Figure(name, picture, caption),),
                (_table(conditions, paths, name, unit, reference),),
            )
        )
    loaded = [c for c in conditions if c.loaded is not None]
    if loaded:
        words = (
            "Slope of force over current between neighbouring static levels, against the load. A "
            "straight magnet gives a level "
            "line; iron bends it down where the total flux is large. Small motion sees the value "
            "at zero load."
        )
        sections.append(
            Section("Saturation", "", (Figure("Local force per current", _slopes(loaded), words),))
        )
    return Page(title, machine, tuple(sections), _verdicts(conditions), _facts(conditions), date)


def _first(conditions: Sequence[Condition]) -> str:
    return next(iter(conditions[0].methods))


def _grouped(conditions: Sequence[Condition]) -> dict[str, list[str]]:
    """quantity -> paths, in the order in which they come."""
    found: dict[str, list[str]] = {}
    for condition in conditions:
        for result in condition.methods.values():
            for path in result.paths:
                parts = path.split(".")
                quantity = parts[2] if len(parts) > 2 else parts[-1]
                if path not in found.setdefault(quantity, []):
                    found[quantity].append(path)
    return found


def _short(path: str) -> str:
    """ "bearing.A.force_per_current.zeta" -> "A ζ"."""
    parts = path.split(".")
    return (
        units.axis_name(f"{parts[1]}_{parts[3]}") if len(parts) > 3 else units.axis_name(parts[-1])
    )


def _scale(unit: str, values: Sequence[float]) -> tuple[float, str]:
    return (
        (1e-6, "MN/m")
        if unit == "N/m"
        else units.scale(unit, max((abs(v) for v in values), default=0.0))
    )


def _at(result: Repeats, path: str) -> tuple[float, float] | None:
    if path not in result.paths:
        return None
    i = result.paths.index(path)
    return float(result.mean[i]), float(result.half_width[i])


def _figure(
    conditions: Sequence[Condition], paths: Sequence[str], unit: str, axis: str, reference: str
) -> Any:
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    methods = list(dict.fromkeys(name for c in conditions for name in c.methods))
    look = theme.styles(methods)
    rows, columns = -(-len(paths) // _COLUMNS), min(_COLUMNS, len(paths))
    x = np.array([c.x for c in conditions])
    apart = _APART * max(float(np.ptp(x)), 1.0)
    factor, shown = _scale(
        unit,
        [
            abs(r.mean[r.paths.index(p)])
            for c in conditions
            for r in c.methods.values()
            for p in paths
            if p in r.paths
        ],
    )
    figure = make_subplots(
        rows=rows, cols=columns, horizontal_spacing=0.09, vertical_spacing=0.26 / max(rows, 1)
    )
    named: set[str] = set()
    for number, path in enumerate(paths):
        place = {"row": number // _COLUMNS + 1, "col": number % _COLUMNS + 1}
        for kind, values, symbol, size in (
            ("truth", [c.truth.get(path) for c in conditions], "circle-open", 15),
            (reference, [c.reference.get(path) for c in conditions], "diamond-open", 9),
        ):
            if any(value is not None for value in values):
                y = [None if value is None else value * factor for value in values]
                marker = {
                    "symbol": symbol,
                    "size": size,
                    "color": theme.MUTED,
                    "line": {"width": 1.5},
                }
                shift = 1.5 * apart if kind == reference else 0.0
                figure.add_trace(
                    go.Scatter(
                        x=x + shift,
                        y=y,
                        mode="markers",
                        marker=marker,
                        name=theme.plain(kind),
                        legendgroup=kind,
                        showlegend=kind not in named,
                    ),
                    **place,
                )
                named.add(kind)
        for j, method in enumerate(methods):
            found = [
                _at(c.methods[method], path) if method in c.methods else None for c in conditions
            ]
            kept = [
                (a + (j - (len(methods) - 1) / 2) * apart, *f)
                for a, f in zip(x, found, strict=True)
                if f is not None
            ]
            if kept:
                place_x, mean, width = (np.array(part) for part in zip(*kept, strict=True))
                style = look[method]
                figure.add_trace(
                    go.Scatter(
                        x=place_x,
                        y=mean * factor,
                        mode="lines+markers",
                        name=theme.plain(method),
                        legendgroup=method,
                        error_y={
                            "type": "data",
                            "array": width * factor,
                            "color": style.colour,
                            "thickness": 1.4,
                            "width": 5,
                        },
                        line={"color": style.colour, "dash": style.dash, "width": 1.0},
                        showlegend=method not in named,
                        marker={"size": 5, "color": style.colour},
                        hovertemplate=f"{theme.plain(method)}<br>%{{y:.5g}} {shown}<extra></extra>",
                    ),
                    **place,
                )
                named.add(method)
        figure.add_annotation(
            text=f"<b>{theme.plain(_short(path))}</b>",
            x=0,
            y=1,
            xanchor="left",
            yanchor="bottom",
            xref="x domain",
            yref="y domain",
            showarrow=False,
            **place,
        )
        figure.update_yaxes(
            title_text=f"[{shown}]" if place["col"] == 1 else None, rangemode="tozero", **place
        )
        figure.update_xaxes(
            title_text=theme.plain(axis) if number >= len(paths) - columns else None,
            tickvals=x.tolist(),
            **place,
        )
    return theme.dress(figure, _HEIGHT * rows + 30 * (rows - 1), legend=True)


def _slopes(conditions: Sequence[Condition]) -> Any:
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    first = conditions[0].loaded
    axes = first.axes if first is not None else ()
    look = theme.styles([c.label for c in conditions])
    rows = -(-len(axes) // _COLUMNS)
    figure = make_subplots(
        rows=rows, cols=_COLUMNS, horizontal_spacing=0.09, vertical_spacing=0.26 / max(rows, 1)
    )
    for i, axis in enumerate(axes):
        place = {"row": i // _COLUMNS + 1, "col": i % _COLUMNS + 1}
        for condition in conditions:
            if condition.loaded is not None:
                local, style = condition.loaded.local[i], look[condition.label]
                error = {"type": "data", "array": 2 * local.deviation, "width": 3}
                line = {"color": style.colour, "dash": style.dash, "width": 1.6}
                trace = go.Scatter(
                    x=local.force,
                    y=local.slope,
                    mode="lines+markers",
                    name=theme.plain(condition.label),
                    error_y=error,
                    legendgroup=condition.label,
                    showlegend=i == 0,
                    line=line,
                    marker={"size": 4},
                )
                figure.add_trace(trace, **place)
        figure.add_annotation(
            text=f"<b>{units.axis_name(axis)}</b>",
            x=0,
            y=1.0,
            yanchor="bottom",
            xanchor="left",
            xref="x domain",
            yref="y domain",
            showarrow=False,
            **place,
        )
        figure.update_yaxes(title_text="[N/A]" if place["col"] == 1 else None, **place)
        figure.update_xaxes(
            title_text="magnet force beside the weight [N]" if i >= len(axes) - _COLUMNS else None,
            **place,
        )
    return theme.dress(figure, _HEIGHT * rows + 30 * (rows - 1), legend=True)


def _table(
    conditions: Sequence[Condition], paths: Sequence[str], name: str, unit: str, reference: str
) -> Table:
    rows: list[tuple[str | Cell, ...]] = []
    factor, shown = _scale(
        unit,
        [
            abs(m)
            for c in conditions
            for r in c.methods.values()
            for m in [r.mean[r.paths.index(p)] for p in paths if p in r.paths]
        ],
    )
    for condition in conditions:
        for path in paths:
            for method, result in condition.methods.items():
                if path not in result.paths:
                    continue
                i = result.paths.index(path)
                mean, width = float(result.mean[i]), float(result.half_width[i])
                truth, published = condition.truth.get(path), condition.reference.get(path)
                entries = (
                    f"{units.number(mean * factor, 5)} ± "
                    f"{_small(width * factor, abs(mean * factor))}",
                    "< 0.01 %"
                    if result.rsd[i] < 0.01
                    else f"{units.number(float(result.rsd[i]), 2)} %",
                    ""
                    if np.isnan(result.predicted[i])
                    else f"{units.number(100 * result.predicted[i] / abs(mean), 2)} %",
                    "" if truth is None else units.number(truth * factor, 4),
                    "" if truth is None else f"{100 * (mean / truth - 1):+.2f} %".replace("-", "−"),
                    "" if published is None else units.number(published * factor, 4),
                )
                rows.append(
                    (
                        condition.label,
                        _short(path),
                        method,
                        *(Cell(entry, "number") for entry in entries),
                    )
                )
    count = max(r.count for c in conditions for r in c.methods.values())
    note = (
        f"Mean of {count} repeats ± half of its interval by Student's t; RSD: scatter of one "
        "repeat; stated: standard "
        "deviation that a single record gives for itself."
    )
    head = (
        "Condition",
        "Axis",
        "Method",
        f"Mean [{shown}]",
        "RSD",
        "Stated",
        "Truth",
        "Error",
        reference.capitalize(),
    )
    used = [
        j
        for j in range(len(head))
        if j < 4 or any(isinstance(c := row[j], Cell) and c.text for row in rows)
    ]
    return Table(
        name, tuple(head[j] for j in used), tuple(tuple(row[j] for j in used) for row in rows), note
    )


def _small(width: float, size: float) -> str:
    """A half-width with two digits, but no more digits than five of the value itself."""
    least = 10.0 ** (np.floor(np.log10(size)) - 4) if size > 0 else 0.0
    return f"< {units.number(least, 1)}" if width < least else units.number(width, 2)


def _verdicts(conditions: Sequence[Condition]) -> tuple[Verdict, ...]:
    """How far the methods differ, and how far they are from the truth."""
    found = []
    for condition in conditions:
        words, passed = [], None
        methods = list(condition.methods.items())
        for i, (name, one) in enumerate(methods):
            for other_name, other in methods[i + 1 :]:
                common = [path for path in one.paths if path in other.paths]
                if common:
                    worst = max(abs(100 * (_mean(other, p) / _mean(one, p) - 1)) for p in common)
                    passed = (passed is not False) and worst <= _AGREE
                    words.append(
                        f"{other_name} and {name} agree within {units.number(worst, 2)} % "
                        f"(wanted: {_AGREE:g} %)"
                    )
            known = [path for path in one.paths if path in condition.truth]
            if known:
                worst = max(abs(100 * (_mean(one, p) / condition.truth[p] - 1)) for p in known)
                words.append(f"{name} within {units.number(worst, 2)} % of the truth")
        if condition.fit is not None:
            words.append(f"average fit {condition.fit:.1f} %")
        found.append(
            Verdict(condition.label, passed, "; ".join(words) or "nothing to compare with")
        )
    return tuple(found)


def _mean(result: Repeats, path: str) -> float:
    return float(result.mean[result.paths.index(path)])


def _facts(conditions: Sequence[Condition]) -> tuple[tuple[str, str], ...]:
    methods = list(dict.fromkeys(name for c in conditions for name in c.methods))
    counts = [
        str(max(c.methods[name].count for c in conditions if name in c.methods)) for name in methods
    ]
    told = ", ".join(f"{name} ({count})" for name, count in zip(methods, counts, strict=True))
    return (("Conditions", ", ".join(c.label for c in conditions)), ("Methods (repeats)", told))
