"""Pictures of a lateral analysis: response over speed, placement, Level I, capacity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.capacity import PART, UNBALANCE, AxisCapacity
from ambrose.annexes.rotordynamics.critical import Separation
from ambrose.annexes.rotordynamics.critical_map import CriticalMap, Support
from ambrose.annexes.rotordynamics.level_one import OVERDAMPED, LevelOne
from ambrose.annexes.rotordynamics.placement import ShaftMode
from ambrose.annexes.rotordynamics.response import Response
from ambrose.annexes.rotordynamics.stations import Layout
from ambrose.model.effects.load import IMPULSE, SURGE
from ambrose.report import theme

UM, MM = 1e6, 1e3  # um, mm per m
_MARKERS = {UNBALANCE: "circle", PART: "circle-open", IMPULSE: "diamond", SURGE: "square"}
_KINDS = {PART: "part of it: seals, stages"}
_SHADES = ("#d55e00", "#009e73", "#cc79a7", "#e69f00")
_FAR = 3.0  # a limit this many times above the readings would press them to the ground
_EVERY = 5  # of the fine grid: enough for the eye
# [px], of a narrow page: plot of the response, a letter and a line of its words
_WIDE, _HIGH = 600.0, 200.0
_LETTER, _LINE = 6.5, 14.0
_ONE = {"row": 1, "col": 1}
_TOP, _LOW = _ONE, {"row": 2, "col": 1}


def response_figure(
    response: Response,
    speeds: tuple[float, float, float],
    case: int,
    limit: float,
    found: Sequence[tuple[Separation, str, str]] = (),
) -> Any:
    """Probe readings over the speed for one placement: phase lag above, amplitude peak to peak
    below; limit A_vl [um]; found: the critical speeds of all placements, drawn where they are of
    this one.

    A limit far above all readings is told in words, so that the readings keep their shape.
    """
    figure = theme.subplots(
        rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.05, row_heights=[0.3, 0.7]
    )
    readings = response.layout.readings or response.all_readings
    rpm = response.fine[::_EVERY] / standard.RPM
    looks = theme.styles([item.name for item in readings])
    highest = 0.0
    lags = []
    for item in readings:
        look, name = looks[item.name], theme.plain(item.name)
        y = 2 * UM * response.read(item, case)[::_EVERY]
        lag = np.degrees(response.phase_lag(item, case))[::_EVERY]
        lags += [lag.min(), lag.max()]
        for place, values, text in ((_TOP, lag, "%{y:.4g}°"), (_LOW, y, "%{y:.3g} µm p-p")):
            theme.scatter(
                figure,
                place,
                np.float32(rpm),
                np.float32(values),
                item.name,
                shown=place is _LOW,
                line={"color": look.colour, "dash": look.dash, "width": 1.8},
                hovertemplate=f"%{{x:.5g}} rpm: {text}<extra>{name}</extra>",
            )
        highest = max(highest, float(y.max()))
    lowest, top, trip = (speed / standard.RPM for speed in speeds)
    if limit > _FAR * highest:
        highest *= 1.15
        words = f"vibration limit {limit:.3g} µm p-p (above the range shown)"
        theme.note(figure, _LOW, words, rpm[0], highest, "left", "bottom", colour=theme.LIMIT)
    else:
        highest = max(highest, limit)
        theme.guide(figure, _LOW, [rpm[0], rpm[-1]], [limit, limit], color=theme.LIMIT, width=1.4)
        theme.note(figure, _LOW, "vibration limit", rpm[0], limit, "left", "bottom")
    own = [item for item in found if item[2] == response.cases[case].name]
    _peaks(figure, own, float(rpm[-1] - rpm[0]), highest)
    marks = {lowest: "lowest", top: "highest running"}
    marks[trip] = "highest running, trip" if trip == top else "trip"
    for speed, word in marks.items():
        for place, ends in ((_TOP, [min(lags), max(lags)]), (_LOW, [0, highest])):
            theme.guide(figure, place, [speed, speed], ends, color=theme.MUTED, width=1, dash="dot")
        # above the phase, off the critical speeds' words; trip stands close to the running speed
        up = 14 if speed == trip > top else 0
        theme.note(figure, _TOP, word, speed, max(lags), "right", "bottom", yshift=up)
    theme.dress(figure, 360, legend=True, lines=1)
    figure.update_xaxes(range=[float(rpm[0]), float(rpm[-1])])
    figure.update_xaxes(title_text="Speed [rpm]", **_LOW)
    # four steps or so: readings that lag by several turns crowd a step of 90 degrees
    steps = (max(lags) - min(lags)) / 4
    dtick = next((step for step in (90, 180, 360, 720) if step >= steps), 1440)
    figure.update_yaxes(title_text="Lag [°]", dtick=dtick, **_TOP)
    figure.update_yaxes(title_text="Reading [µm p-p]", rangemode="tozero", **_LOW)
    return figure


def _peaks(
    figure: Any, found: Sequence[tuple[Separation, str, str]], width: float, height: float
) -> None:
    """A ring at every critical speed, with its speed and amplification factor; words that would
    overprint stand above each other. width [rpm], height [um]: of the plot.
    """
    placed: list[tuple[float, float, float]] = []  # middle, foot and half the width [px]
    for item, name, _ in found:
        peak = item.critical
        x, y = peak.speed / standard.RPM, 2 * UM * peak.amplitude
        factor = f", AF {peak.amplification:.3g}" if np.isfinite(peak.amplification) else ""
        theme.scatter(
            figure,
            _LOW,
            [x],
            [y],
            mode="markers",
            marker={"size": 9, "color": theme.INK, "symbol": "circle-open"},
            hovertemplate=f"{theme.plain(name)}: %{{y:.3g}} µm p-p<extra></extra>",
        )
        words = f"{x:.5g} rpm{factor}"
        half, shift = _LETTER * len(words) / 2, 5.0
        middle, foot = _WIDE * x / width, _HIGH * y / height
        for other, ground, reach in sorted(placed, key=lambda row: row[1]):
            apart = abs(middle - other) - half - reach
            if apart < 0 and abs(foot + shift - ground) < _LINE:
                shift = ground + _LINE - foot
        placed.append((middle, foot + shift, half))
        theme.note(figure, _LOW, words, x, y, "center", "bottom", yshift=round(shift))


def critical_map_figure(found: CriticalMap, speeds: tuple[float, float, float]) -> Any:
    """Undamped critical speeds over the stiffness of the supports, that of the bearings over them,
    and a ring where they meet.
    """
    figure = theme.subplots(rows=1, cols=1)
    stiffness = 1e-6 * found.stiffness  # [N/um]
    ends = [float(stiffness[0]), float(stiffness[-1])]
    for number, row in enumerate(found.speeds, 1):
        rpm = row / standard.RPM
        theme.scatter(
            figure,
            _ONE,
            np.float32(stiffness),
            np.float32(rpm),
            line={"color": theme.INK, "width": 1.8},
            hovertemplate=f"critical speed {number}: %{{y:.5g}} rpm at %{{x:.4g}} N/µm"
            "<extra></extra>",
        )
        theme.note(figure, _ONE, f"{number}", *_log(ends[1], rpm[-1]), "left", "middle", xshift=3)
    looks = theme.styles([item.name for item in found.supports])
    for item in found.supports:
        size = np.abs(item.stiffness)
        shown = size > 0
        theme.scatter(
            figure,
            _ONE,
            np.float32(1e-6 * size[shown]),
            np.float32(item.speeds[shown] / standard.RPM),
            _short(item),
            shown=True,
            line=looks[item.name].line,
            hovertemplate="%{x:.4g} N/µm at %{y:.5g} rpm<extra>"
            + theme.plain(item.name)
            + "</extra>",
        )
        rings = [crossing for crossing in found.crossings if crossing.support == item.name]
        theme.scatter(
            figure,
            _ONE,
            [1e-6 * crossing.stiffness for crossing in rings],
            [crossing.speed / standard.RPM for crossing in rings],
            mode="markers",
            marker={"size": 9, "color": looks[item.name].colour, "symbol": "circle-open"},
            hovertemplate="%{y:.5g} rpm at %{x:.4g} N/µm<extra>"
            + theme.plain(item.name)
            + "</extra>",
        )
    lowest, top, trip = (speed / standard.RPM for speed in speeds)
    for rpm in sorted({lowest, top, trip}):
        theme.guide(figure, _ONE, ends, [rpm, rpm], color=theme.MUTED, width=1, dash="dot")
    word = "running speed" if lowest == top else "highest running speed"
    word += " and trip" if trip > top else ""
    theme.note(figure, _ONE, word, *_log(ends[0], trip), "left", "bottom")
    if lowest < top:
        theme.note(figure, _ONE, "lowest running speed", *_log(ends[0], lowest), "left", "top")
    low = min(float(found.speeds[0].min()), *(float(s.speeds[0]) for s in found.supports))
    high = max(float(found.speeds[-1].max()), speeds[2])
    theme.dress(figure, 360, legend=True)
    figure.update_xaxes(title_text="Stiffness of each support [N/µm]", **theme.decades(*ends))
    figure.update_yaxes(
        title_text="Critical speed [rpm]",
        **theme.decades(low / standard.RPM, 1.2 * high / standard.RPM),
    )
    return figure


def _log(x: float, y: float) -> tuple[float, float]:
    """A place on logarithmic axes, as annotations take it."""
    return float(np.log10(x)), float(np.log10(y))


def _short(item: Support) -> str:
    """A support in a legend: its axes, or the first and how many are like it."""
    words = "|K(jω)| " if item.magnetic else ""
    names = item.axes
    return words + (item.name if len(names) <= 4 else f"{names[0]} and {len(names) - 1} alike")


def placement_figure(layout: Layout, response: Response) -> Any:
    """The shape of each placement along the shaft, with its weights; journals as lines."""
    shown = response.cases
    gap = 0.27 / len(shown)  # for a heading, of all panels together
    figure = theme.subplots(rows=len(shown), cols=1, shared_xaxes=True, vertical_spacing=gap)
    x = MM * layout.positions
    for row, case in enumerate(shown, 1):
        place, line = {"row": row, "col": 1}, case.line
        theme.guide(figure, place, [x[0], x[-1]], [0, 0], color=theme.MUTED, width=1)
        theme.scatter(
            figure, place, np.float32(x), np.float32(line), line={"color": "#0072b2", "width": 2}
        )
        for journal in layout.journals:
            at = MM * journal.position
            theme.guide(figure, place, [at, at], [-1, 1], color=theme.MUTED, width=1, dash="dot")
            # on the side that the shaft and its weights leave free
            below = np.interp(at, x, line) >= 0
            edge, side = (-1, "bottom") if below else (1, "top")
            theme.note(figure, place, theme.plain(journal.name), at, edge, "left", side, xshift=3)
        for weight in case.weights:
            at = MM * layout.positions[weight.station]
            tip = float(line[weight.station])
            theme.scatter(
                figure,
                place,
                [at],
                [tip],
                mode="markers",
                marker={"size": 11, "color": theme.LIMIT, "symbol": "circle"},
                hovertemplate=f"{1e6 * weight.amount:.4g} g mm at {at:.4g} mm<extra></extra>",
            )
            text = f"{1e6 * weight.amount:.4g} g mm, {np.degrees(weight.angle):.0f} deg"
            side = "left" if at < 0.5 * x[-1] else "right"
            up, shift = ("bottom" if tip > 0 else "top"), 7 if side == "left" else -7
            theme.note(figure, place, text, at, tip, side, up, xshift=shift)
        theme.heading(figure, place, case.heading)
    theme.dress(figure, 150 * len(shown), legend=False, lines=1)
    figure.update_yaxes(showticklabels=False, ticks="", range=[-1.6, 1.6])
    figure.update_xaxes(title_text="Position [mm]", row=len(shown), col=1)
    return figure


def shapes_figure(layout: Layout, modes: Sequence[ShaftMode]) -> Any:
    """The shape of every damped mode along the shaft, with its frequency, whirl and log decrement;
    journals as lines.
    """
    gap = 0.27 / len(modes)  # for a heading, of all panels together
    figure = theme.subplots(rows=len(modes), cols=1, shared_xaxes=True, vertical_spacing=gap)
    x = MM * layout.positions
    for row, mode in enumerate(modes, 1):
        place, line = {"row": row, "col": 1}, mode.dominant_line()
        theme.guide(figure, place, [x[0], x[-1]], [0, 0], color=theme.MUTED, width=1)
        for values, dash in ((line.imag, "dash"), (line.real, "solid")):
            theme.scatter(
                figure,
                place,
                np.float32(x),
                np.float32(values),
                line={"color": "#0072b2", "width": 2 if dash == "solid" else 1.3, "dash": dash},
            )
        for journal in layout.journals:
            at = MM * journal.position
            theme.guide(figure, place, [at, at], [-1, 1], color=theme.MUTED, width=1, dash="dot")
            if row == 1:
                below = np.interp(at, x, line.real) >= 0
                edge, side = (-1, "bottom") if below else (1, "top")
                words = theme.plain(journal.name)
                theme.note(figure, place, words, at, edge, "left", side, xshift=3)
        hertz = mode.frequency / (2 * np.pi)
        heading = f"{standard.rpm(mode.frequency)} rpm ({hertz:.4g} Hz), {mode.way}"
        theme.heading(figure, place, f"{heading}, log decrement {mode.log_decrement:.3g}")
    theme.dress(figure, 110 * len(modes), legend=False, lines=1)
    figure.update_yaxes(showticklabels=False, ticks="", range=[-1.3, 1.3])
    figure.update_xaxes(title_text="Position [mm]", row=len(modes), col=1)
    return figure


def level_one_figure(one: LevelOne) -> Any:
    """Log decrement of every forward mode over the cross-coupled stiffness."""
    figure = theme.subplots(rows=1, cols=1)
    q = one.cross_coupling / 1e6
    names = [
        f"{standard.rpm(branch.mode.frequency)} rpm" + (" (at Q0)" if branch.late else "")
        for branch in one.branches
    ]
    looks = theme.styles(names)
    for name, branch in zip(names, one.branches, strict=True):
        look = looks[name]
        theme.scatter(
            figure,
            _ONE,
            np.float32(q),
            # a mode that cannot ring has no log decrement
            np.float32(np.where(branch.log_decrement < OVERDAMPED, branch.log_decrement, np.nan)),
            name,
            shown=True,
            line={"color": look.colour, "dash": look.dash, "width": 1.8},
        )
    if one.anticipated is not None and one.at_anticipated < OVERDAMPED:
        theme.scatter(
            figure,
            _ONE,
            [one.anticipated / 1e6],
            [one.at_anticipated],
            "least at Q_A",
            shown=True,
            mode="markers",
            marker={"size": 9, "color": theme.LIMIT, "symbol": "circle"},
        )
    levels = [branch.log_decrement for branch in one.branches]
    low = min([0.0, *(float(level.min()) for level in levels)])
    high = max([standard.LEAST_LOG_DECREMENT, *(float(level.max()) for level in levels)])
    theme.guide(
        figure,
        _ONE,
        [q[0], q[-1]],
        [standard.LEAST_LOG_DECREMENT] * 2,
        color=theme.LIMIT,
        width=1.4,
    )
    for value, word in ((one.anticipated, "Q_A"), (one.border, "Q0")):
        if value is not None and np.isfinite(value):
            at = value / 1e6
            theme.guide(figure, _ONE, [at, at], [low, high], color=theme.MUTED, width=1, dash="dot")
            theme.note(figure, _ONE, word, at, high, "left", "top")
    theme.dress(figure, 280, legend=True)
    figure.update_xaxes(title_text="Cross-coupled stiffness Q [N/µm]", rangemode="tozero")
    figure.update_yaxes(title_text="Log decrement [-]")
    return figure


def capacity_figure(axis: AxisCapacity) -> Any:
    """Force that is left beside what lasts over the frequency, on both sides of the bias, and what
    every load takes.
    """
    figure = theme.subplots(rows=1, cols=1)
    hertz = axis.omega / (2 * np.pi)
    sides = (("along the static load", axis.force, "solid"), ("against it", axis.other, "dash"))
    for name, force, dash in sides:
        theme.scatter(
            figure,
            _ONE,
            np.float32(hertz),
            np.float32(force),
            name,
            shown=True,
            line={"color": "#0072b2", "width": 2, "dash": dash},
            customdata=list(axis.limited_by),
            hovertemplate="%{x:.4g} Hz: %{y:.4g} N 0-p, by %{customdata}<extra></extra>",
        )
    if axis.static_force:
        theme.scatter(
            figure,
            _ONE,
            [hertz[0], hertz[-1]],
            [axis.static_force] * 2,
            "static load",
            shown=True,
            line={"color": theme.MUTED, "width": 1.4, "dash": "dot"},
            hovertemplate="%{y:.4g} N<extra>static load</extra>",
        )
    for (kind, marker), colour in zip(_MARKERS.items(), _SHADES, strict=False):
        items = [item for item in axis.demands if item.kind == kind and item.current > 0]
        if items:
            theme.scatter(
                figure,
                _ONE,
                [item.frequency / (2 * np.pi) for item in items],
                [item.force for item in items],
                _KINDS.get(kind, kind),
                shown=True,
                mode="markers",
                marker={"size": 9, "color": colour, "symbol": marker},
                customdata=[item.name for item in items],
                hovertemplate="%{customdata}: %{y:.4g} N 0-p<extra></extra>",
            )
    theme.dress(figure, 320, legend=True)
    figure.update_xaxes(title_text="Frequency [Hz]", type="log", dtick=1)
    figure.update_yaxes(title_text="Force [N 0-p]", type="log", dtick=1)
    return figure
