"""The page of the magnets: their sheets, poles with their fluxes, and maps of the straight law."""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.annexes.magnets.analysis import MagnetSheet, MagnetSheets
from ambrose.machine.file.toml import machine_hash
from ambrose.report import theme
from ambrose.report.page import Cell, Figure, Page, Section, Table

_SHEET = (
    "From a magnetic network of the poles, their gaps, coils, iron and permanent magnets: force by "
    "Maxwell's stress, the coefficients by its derivatives. No eddy currents, no hysteresis."
)
_POLES = "Flux density in the gap of every pole at the bias current, the arrow out of the stator."
_MAP = (
    "Force of the straight law k_i i + k_s x less the magnet's, over k_i times the bias current, "
    "along one axis with the other at rest."
)
_ONE = {"row": 1, "col": 1}


def sheet_rows(sheet: MagnetSheet, share: float) -> tuple[tuple[str, str], ...]:
    """Name and value of what the sheet says."""
    within = f"within {100 * share:g} % of gap and current"
    worst = max(item.worst for item in sheet.maps)
    ranges = [
        [end for item in sheet.maps for end in getattr(item, name)]
        for name in ("force_per_current", "negative_stiffness")
    ]
    return (
        ("bias current of the pair", f"{sheet.bias:.4g} A"),
        ("k_i (zeta, eta)", " / ".join(f"{v:.4g}" for v in sheet.force_per_current) + " N/A"),
        (
            "k_s (zeta, eta)",
            " / ".join(f"{v / 1e6:.4g}" for v in sheet.negative_stiffness) + " MN/m",
        ),
        ("inductance of a coil", f"{1e3 * sheet.inductance:.4g} mH"),
        ("flux density in the gap at the bias", f"{sheet.flux_density[0]:.3g} T"),
        ("at full modulation", f"{sheet.flux_density[1]:.3g} T"),
        ("force at full modulation", f"{sheet.capacity:.4g} N"),
        (f"error of the straight law {within}", f"{100 * worst:.3g} % of k_i i_0"),
        ("k_i there, relative", f"{min(ranges[0]):.3g} to {max(ranges[0]):.3g}"),
        ("k_s there, relative", f"{min(ranges[1]):.3g} to {max(ranges[1]):.3g}"),
        ("first coil open: force at once", f"{sheet.lost_force:.4g} N"),
        ("first coil open: k_i left along zeta", f"{100 * sheet.lost_share:.3g} %"),
    )


def magnet_page(result: MagnetSheets, *, date: str = "") -> Page:
    """The page of ``MagnetSheets``; date: ISO (today if empty)."""
    sections = []
    for sheet in result.sheets:
        rows = tuple(
            (name, Cell(value, "number")) for name, value in sheet_rows(sheet, result.share)
        )
        table = Table(f"Magnet {sheet.bearing}", ("Quantity", "Value"), rows)
        pictures = (
            Figure("Poles", poles_figure(sheet), _POLES),
            Figure("Error of the straight law [%]", map_figure(sheet), _MAP),
        )
        sections.append(
            Section(f"{sheet.bearing}: {sheet.part.kind}", _SHEET, pictures, (table,), True)
        )
    facts = (("Machine file", machine_hash(result.machine)),)
    return Page("Magnets", result.machine, tuple(sections), (), facts, date, signatures=())


def poles_figure(sheet: MagnetSheet) -> Any:
    """The poles around the journal, each with its flux density."""
    figure = theme.subplots(rows=1, cols=1)
    turn = np.linspace(0, 2 * np.pi, 73)
    theme.guide(figure, _ONE, np.cos(turn), np.sin(turn), color=theme.INK, width=1.5)
    network = sheet.driven.network
    density = sheet.driven.at(sheet.current).flux_density
    moving = np.flatnonzero(network.normals.any(axis=1))
    shown = moving[: sheet.part.pole_count]
    widest = max(network.area[shown])
    for branch in shown:
        n, b = network.normals[branch], density[branch]
        # width of the pole by its face, length of the arrow by its flux density
        across = np.array([-n[1], n[0]]) * 0.17 * network.area[branch] / widest
        corners = np.array([1.06 * n - across, 1.55 * n - across, 1.55 * n + across])
        corners = np.vstack([corners, 1.06 * n + across, corners[:1]])
        theme.scatter(
            figure,
            _ONE,
            corners[:, 0],
            corners[:, 1],
            fill="toself",
            fillcolor="#dfeaf3" if b > 0 else "#f8e3d4",
            line={"color": theme.INK, "width": 1},
            hoverinfo="skip",
        )
        ends = (1.5, 1.12) if b > 0 else (1.12, 1.5)
        figure.add_annotation(
            x=ends[1] * n[0],
            y=ends[1] * n[1],
            ax=ends[0] * n[0],
            ay=ends[0] * n[1],
            axref="x",
            ayref="y",
            arrowhead=2,
            arrowwidth=1.6,
            arrowcolor="#0072b2" if b > 0 else "#d55e00",
            text="",
        )
        theme.note(figure, _ONE, f"{abs(b):.2f} T", 1.82 * n[0], 1.82 * n[1], "center", "middle")
    for axis, x, y in (("zeta", 0.72, 0.0), ("eta", 0.0, 0.72)):
        theme.guide(figure, _ONE, [0, x], [0, y], color=theme.MUTED, width=1)
        theme.note(figure, _ONE, axis, x, y, "center", "bottom")
    theme.dress(figure, 330, legend=False)
    figure.update_layout(margin={"l": 4, "r": 4, "t": 10, "b": 10})
    figure.update_xaxes(visible=False, range=[-2.1, 2.1], constrain="domain")
    figure.update_yaxes(visible=False, range=[-2.1, 2.1], scaleanchor="x", constrain="domain")
    return figure


def map_figure(sheet: MagnetSheet) -> Any:
    """The straight law's error over place and control current, along zeta."""
    import plotly.graph_objects as go

    item = sheet.maps[0]
    error = -100 * item.error
    most = max(float(np.abs(error).max()), 1e-6)
    figure = theme.subplots(rows=1, cols=1)
    figure.add_trace(
        go.Contour(
            x=np.float32(1e6 * item.places),
            y=np.float32(item.currents),
            z=np.float32(error),
            zmin=-most,
            zmax=most,
            colorscale="RdBu",
            contours={"showlabels": True, "labelfont": {"size": 11}},
            line={"width": 0.5},
            colorbar={"thickness": 12, "title": {"text": "%"}},
            hovertemplate="%{x:.3g} um, %{y:.3g} A: %{z:.3g} %<extra></extra>",
        ),
        **_ONE,
    )
    theme.dress(figure, 300, legend=False)
    figure.update_xaxes(title_text="Place along zeta [um]")
    figure.update_yaxes(title_text="Control current [A]")
    return figure
