"""Seal coefficients against pressure, with the regression lines and their bands."""

from __future__ import annotations

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.identify.seal_result import SealFit, averaged, line
from ambrose.report import theme, units
from ambrose.report.document import Figure

_UNITS = {"K": "N/m", "k": "N/m", "C": "N s/m", "c": "N s/m"}
_TITLES = {
    "K": "K, direct stiffness", "k": "k, cross-coupled stiffness", "C": "C, direct damping", "c": "c, cross-coupled damping",
}  # fmt: skip
_POINT, _CONFIDENCE, _PREDICTION = "#0072b2", "rgba(0,114,178,0.30)", "rgba(0,114,178,0.12)"
_CAPTION = (
    "Points are the identified coefficients with their 95 % intervals; the line is the weighted regression over pressure, the "
    "dark band holds the true line, the pale one the next measurement (95 % each). k decides stability: read where its band "
    "crosses what the damping C times the whirl frequency can carry."
)


def seal_figure(fit: SealFit) -> Figure:
    """K, k, C and c over pressure; bands where three pressures or more were identified."""
    import plotly.graph_objects as go
    from plotly.subplots import make_subplots

    rows = fit if np.isnan(fit.frequency).all() else averaged(fit)
    titles = [f"<b>{_TITLES[letter]}</b>" for letter in _UNITS]
    figure = make_subplots(
        rows=2, cols=2, subplot_titles=titles, shared_xaxes=True, horizontal_spacing=0.1, vertical_spacing=0.12
    )
    pressure_factor, pressure_unit = units.scale("Pa", float(rows.pressure.max()))
    span = np.linspace(0.0, 1.05 * float(rows.pressure.max()), 60)
    for number, (letter, unit) in enumerate(_UNITS.items()):
        place = {"row": number // 2 + 1, "col": number % 2 + 1}
        values, deviations = rows.column(letter)
        factor, name = units.scale(unit, float(np.nanmax(np.abs(values))))
        try:
            fitted = line(fit, letter)
        except InvalidInput:
            fitted = None
        if fitted is not None:
            middle = fitted.at(span) * factor
            for half, colour in ((fitted.prediction(span), _PREDICTION), (fitted.confidence(span), _CONFIDENCE)):
                x = np.r_[span, span[::-1]] * pressure_factor
                y = np.r_[middle + half * factor, (middle - half * factor)[::-1]]
                look = {"fill": "toself", "fillcolor": colour, "line": {"width": 0}, "mode": "lines"}
                figure.add_trace(go.Scatter(x=x, y=y, showlegend=False, hoverinfo="skip", **look), **place)
            look = {"mode": "lines", "line": {"color": theme.INK, "width": 1.5}}
            figure.add_trace(
                go.Scatter(x=span * pressure_factor, y=middle, showlegend=False, hoverinfo="skip", **look), **place
            )
        figure.add_trace(
            go.Scatter(
                x=rows.pressure * pressure_factor, y=values * factor, mode="markers", showlegend=False,
                marker={"size": 7, "color": _POINT},
                error_y={"type": "data", "array": 1.96 * deviations * factor, "color": _POINT, "thickness": 1.5, "width": 4},
                hovertemplate=f"%{{x:.4g}} {pressure_unit}: %{{y:.4g}} ± %{{error_y.array:.2g}} {name}<extra></extra>",
            ),
            **place,
        )  # fmt: skip
        figure.update_yaxes(title_text=f"[{name}]", **place)
    figure.update_annotations(font={"size": 13})
    theme.dress(figure, 460, legend=False)
    figure.update_xaxes(title_text=f"Pressure difference [{pressure_unit}]", row=2)
    return Figure(f"Seal {units.axis_name(fit.seal)}: coefficients against pressure", figure, _CAPTION)
