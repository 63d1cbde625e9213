"""The residual system S in the frequency domain: measured without a model beside S(theta) as
identified.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.identification.frf import spectral as frf
from ambrose.identification.youla.identify import ResidualIdentification
from ambrose.report import theme, units
from ambrose.report.figures.axes import drawn

_BAND, _MEASURED = "rgba(0, 114, 178, 0.18)", "#0072b2"
_WIDE = float(np.sqrt(-np.log(0.05)))  # 95 % of a circular error lies within this times its rms


def residual_figure(result: ResidualIdentification, segment: float = 0.2) -> Any:
    """A plotly figure: |S| of every axis on itself [um/A], measured (H1 from alpha to eps, 95 %
    band) and S(theta) found.

    segment [s]: of the spectra. Where the band reaches the bottom, the axis shows no difference
    from the machine as modelled. Raises InvalidInput where the excitations of the axes cannot be
    told apart.
    """
    factors = result.factors
    measured = frf.h1(result.signals, factors.alpha, factors.eps, segment=segment)
    model = 1e6 * frequency_response(result.residual, measured.omega).values
    f = measured.omega / units.TWO_PI
    axes = [name.removeprefix("alpha_u_") for name in factors.alpha]
    figure = theme.subplots(
        rows=1,
        cols=len(axes),
        shared_yaxes=True,
        horizontal_spacing=0.02,
        subplot_titles=[f"<b>{theme.plain(units.axis_name(axis))}</b>" for axis in axes],
    )
    size, half = 1e6 * np.abs(measured.values), 1e6 * _WIDE * np.sqrt(measured.variance)
    floor = float(np.median(half)) / 10
    for i in range(len(axes)):
        first, place = i == 0, {"row": 1, "col": i + 1}
        low, high = (
            np.maximum(size[:, i, i] - half[:, i, i], floor),
            np.maximum(size[:, i, i] + half[:, i, i], floor),
        )
        theme.band(figure, place, f, low, high, _BAND, "95 % band" if first else "")
        for name, values, line in (
            ("measured, no model", size[:, i, i], {"color": _MEASURED, "width": 1.2}),
            ("S(theta) identified", np.abs(model[:, i, i]), {"color": theme.INK, "width": 1.8}),
        ):
            theme.scatter(figure, place, drawn(f), drawn(values), name, shown=first, line=line)
        figure.update_xaxes(
            title_text="Frequency [Hz]", **theme.decades(float(f[0]), float(f[-1])), **place
        )
        figure.update_yaxes(
            **theme.decades(floor, 2 * float(max(size.max(), np.abs(model).max()))), **place
        )
    figure.update_yaxes(title_text="|S| [µm/A]", row=1, col=1)
    return theme.dress(figure, 320, legend=True)
