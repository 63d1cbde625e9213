"""The page of a lateral analysis: the summary sheet first, then what each row rests on.

write(lateral_page(lateral(machine, controller)), "lateral.html")
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ambrose.annexes.rotordynamics import standard
from ambrose.annexes.rotordynamics.capacity import PART, SEALS, UNBALANCE, AxisCapacity
from ambrose.annexes.rotordynamics.comparison import Comparison, Pair
from ambrose.annexes.rotordynamics.critical_map import CriticalMap, Support
from ambrose.annexes.rotordynamics.items import level_one_beyond, speeds_in_words
from ambrose.annexes.rotordynamics.levels import OVERDAMPED, LevelOne
from ambrose.annexes.rotordynamics.loop import PhaseBudget
from ambrose.annexes.rotordynamics.placement import ShaftMode
from ambrose.annexes.rotordynamics.response import Separation, UnbalanceResponse
from ambrose.annexes.rotordynamics.result import Item, Lateral, not_finite
from ambrose.annexes.rotordynamics.stations import Layout
from ambrose.core.presentation import with_unit
from ambrose.judge.campbell import OSCILLATORY, PLANAR
from ambrose.law.loop import timing_in_words
from ambrose.machine.machine import Machine
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.effects.stations import IMPULSE, SURGE, Load
from ambrose.report import theme
from ambrose.report.figures.rotor_drawing import Whirl, machine_drawing, whirl_figure
from ambrose.report.identification import responses_figure
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers
from ambrose.report.tables import assumed_table

# Pictures of a lateral analysis: response over speed, placement, Level I, capacity.


UM, MM = 1e6, 1e3  # um, mm per m
_MARKERS = {UNBALANCE: "circle", PART: "circle-open", IMPULSE: "diamond", SURGE: "square"}
_KINDS = {PART: "contribution of seals and stages"}
_SHADES = ("#d55e00", "#009e73", "#cc79a7", "#e69f00")
_FAR = 3.0  # a limit this many times above the readings would press them to the ground
# what an amplifier may state, its unit and that in SI
_DRIVE = (
    ("bandwidth", "Hz", 2 * np.pi),
    ("eddy_bandwidth", "Hz", 2 * np.pi),
    ("natural_frequency", "Hz", 2 * np.pi),
    ("damping", "1/s", 1.0),
    ("resistance", "ohm", 1.0),
    ("inductance", "mH", 1e-3),
    ("max_voltage", "V", 1.0),
)
_EVERY = 5  # of the fine grid: enough for the eye
# [px], of a narrow page: plot of the response, a letter and a line of its words
_WIDE, _HIGH = 600.0, 200.0
_LETTER, _LINE = 6.5, 14.0
_ONE = {"row": 1, "col": 1}
_TOP, _LOW = _ONE, {"row": 2, "col": 1}


def response_figure(
    response: UnbalanceResponse,
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
    return words + (item.name if len(names) <= 4 else f"{names[0]} and {len(names) - 1} others")


def placement_figure(layout: Layout, response: UnbalanceResponse) -> Any:
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
    """The shape of every damped mode in space, with its frequency, whirl and log decrement, and the
    orbits at the journals and probes.
    """
    shapes = [
        Whirl(
            mode.shape,
            f"{standard.rpm(mode.frequency)} rpm ({mode.frequency / (2 * np.pi):.4g} Hz), "
            f"{mode.way}, log decrement {mode.log_decrement:.3g}",
            {"forward": True, "backward": False}.get(mode.way),
        )
        for mode in modes
    ]
    marks = [("bearing", item.name, item.position) for item in layout.journals]
    marks += [("sensor", item.name, item.position) for item in layout.readings]
    return whirl_figure(layout.positions, shapes, marks)


def campbell_figure(result: Lateral) -> Any:
    """Frequencies of the poles that ring over the speed, coloured by their log decrement, with
    marks by whirl and the line of the speed itself.
    """
    figure = theme.subplots(rows=1, cols=1)
    table = np.hstack(
        [
            np.array([np.full(len(own.poles), speed), own.frequency, own.log_decrement, own.whirl])[
                :, (own.damping < OSCILLATORY) & (own.poles.imag > 0)
            ]
            for speed, own in result.along
        ]
    )
    decrement, whirl = table[2:]
    least = standard.LEAST_LOG_DECREMENT
    high = result.modes_to / (2 * np.pi)
    rpm, hertz = table[0] / standard.RPM, table[1] / (2 * np.pi)
    low = -np.inf
    for top, colour, name in (
        (0.0, theme.LIMIT, "below 0: unstable"),
        (least, "#e69f00", f"0 to {least:g}: below the limit"),
        (3 * least, "#0072b2", f"{least:g} to {3 * least:g}"),
        (1.0, "#56b4e9", f"{3 * least:.1g} to 1"),
        (np.inf, "#b9c3cb", "above 1"),
    ):
        own = (low <= decrement) & (decrement < top) & (hertz <= high)
        low = top
        if own.any():
            marks = np.where(whirl > PLANAR, "triangle-up", "triangle-down")
            marks = np.where(np.abs(whirl) <= PLANAR, "circle", marks)
            theme.scatter(
                figure,
                _ONE,
                np.float32(rpm[own]),
                np.float32(hertz[own]),
                f"log decrement {name}",
                shown=True,
                mode="markers",
                marker={"size": 6, "color": colour, "symbol": marks[own].tolist()},
                customdata=np.float32(decrement[own]),
                hovertemplate="%{x:.5g} rpm: %{y:.4g} Hz, log decrement %{customdata:.3g}"
                "<extra></extra>",
            )
    last = float(rpm.max())
    line = min(last, 60 * high)
    theme.guide(figure, _ONE, [0, line], [0, line / 60], color=theme.INK, width=1, dash="dot")
    for at in sorted({item / standard.RPM for item in result.speeds}):
        theme.guide(figure, _ONE, [at, at], [0, high], color=theme.MUTED, width=1, dash="dot")
    theme.dress(figure, 360, legend=True, lines=1)
    figure.update_xaxes(title_text="Speed [rpm]", range=[0, last])
    figure.update_yaxes(title_text="Frequency [Hz]", range=[0, high])
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


_BASIS = (
    "Basis: recalled - the standard's text was not at hand; formula and limit are those of open "
    "code and tutorials that quote it. Checked - a source at hand quotes the limit. Own - no "
    "clause of the standard, added here. p-p: peak to peak; 0-p: zero to peak."
)
_DECIDE = 8  # rows of the table that decides
_ABSENT = "not_covered."  # how names of clauses begin that are not computed
_RESPONSE = (
    "Probe readings, peak to peak, with twice the residual unbalance placed for the mode named, "
    "and their phase lag in the direction of rotation, relative to a keyphasor at the angle of the "
    "first unbalance. Computed at {count} speeds from {first} to {last} rpm, with speed-dependent "
    "coefficients at each, and interpolated by a spline (interpolation error, estimated from every "
    "second speed: {error} of the largest amplitude)."
)
_PLACED = (
    "Shape of each forward mode at maximum continuous speed, in the rotating plane of largest "
    "deflection, and the unbalance that excites it."
)
_LEVEL_ONE = (
    "Rotor without seals and stages. Cross-coupled stiffness Q, applied at mid-span (or at the "
    "overhung impellers), reduces the damping of the forward modes; Q0 is the value at the "
    "stability threshold of the loop with the controller as it runs."
)
_LEVEL_TWO = (
    "Oscillatory lateral modes (damping ratio up to 0.7) at operating point {point}, with seals, "
    "stages and {acting}, up to {hertz} Hz ({top} rpm): 1.25 times the trip speed or, if higher, "
    "1.25 times the second bending frequency of the free rotor. The limit applies up to the "
    "running speed; modes above it are listed for information. Below each mode the largest "
    "contributions to its log decrement: all contributions add up to it, negative ones destabilise."
)
_CAMPBELL = (
    "All poles that ring, those of the controller too: up forward, down backward, round planar. "
    "Dotted: once per revolution; lowest, highest running and trip speed. Where a forward mode "
    "meets the rising line is a critical speed."
)
_CAPACITY = (
    "Dynamic force amplitude (0-p) available on a control axis, limited by bias current, maximum "
    "current, maximum force and the slew rate at the amplifier voltage: in the direction of the "
    "static load (weight, static force of the seals, sustained loads) and against it. Markers: "
    "demand of unbalance, impulses and surges in the closed loop. The margin is the smallest ratio "
    "of available to demanded; impulses and surges count in addition to unbalance at trip."
)
_DEMANDS = (
    "Force: control current times k_i. An impulse is plotted at the frequency of the sine with the "
    "same peak current and peak slew rate. Seals and stages: their forces at trip, transferred to "
    "the bearings by static equilibrium; they are part of the unbalance demand. Voltage of a coil: "
    "(R + j w L) i + j w k_u q (- where the file has no inductance)."
)
_LASTS = (
    "The static sag of the rotor from the seal centres gives the seals a static force while they "
    "are pressurised. The static load is the larger of the sums with this force and without it."
)
_PHASE = (
    "Phase from shaft displacement to the coil current, element by element, at the bending "
    "frequencies of the free rotor at rest. Negative values are phase lag; positive values of the "
    "controller are phase lead."
)
_UNDAMPED = (
    "Undamped forward synchronous critical speeds of the rotor alone (no seals, stages or damping) "
    "on equal springs at all bearings. Overlaid is the stiffness of the bearings at each speed: "
    "{of}. An intersection is the critical speed that the rotor would have with this stiffness at "
    "every bearing; the effect of damping is in the unbalance response."
)
_OF_MAGNETS = (
    "of a magnet the modulus of the dynamic stiffness (force divided by displacement) of one axis, "
    "with sensor, controller as it runs, amplifier and negative stiffness"
)
_OF_FILMS = "of a film K_xx and K_yy of its table"
_MAPPED = "Undamped critical speeds"
_RESPONSES, _FOR = "Unbalance response", "Unbalance placed for the "
_SECTIONS = {  # where a row's figure stands, by the first word of its name
    "undamped": _MAPPED,
    "critical_speed": _RESPONSES,
    "small_peaks": _RESPONSES,
    "vibration": _RESPONSES,
    "scale_factor": "Clearances",
    "clearance": "Clearances",
    "level_one": "Stability, Level I",
    "level_two": "Stability, Level II",
    "capacity": "Load capacity",
    "phase": "Phase budget",
}
_MICRO = re.compile(r"\bum\b")
_HYPHEN, _SPACE = "\u2011", "\u00a0"  # where no line ends
_PREDICTED = (
    "Each axis on itself, as measured (95 % band of its noise), and as the full model and this "
    "controller make it. Third row: the model's error and the measurement's own (pale)."
)
_CLAUSE = (
    "API 617 asks for measured and predicted responses of magnetic bearings side by side "
    "(recalled; read clause and limits in the standard)."
)
_BESIDE = (
    "Critical speeds and modes are paired so that the sum of all deviations is least. Amplitudes "
    "are comparable only where both analyses have the same unbalance."
)


def verdict_words(result: Lateral) -> str:
    """The verdict of a lateral analysis: how many requirements are met, which are not, and which
    have no known value.
    """
    judged = [item for item in result.items if item.passed is not None]
    failed = [item for item in judged if not item.passed]
    met = f"{len(judged)} requirement{' is' if len(judged) == 1 else 's are'} met"
    words = f"PASSED: {'all ' * (len(judged) > 1)}{met}" if result.passed else f"FAILED: {met}"
    if failed:
        worst = max(failed, key=_share)
        value, limit = (cell.text for cell in numbers_of(worst))
        words = (
            f"FAILED: {len(failed)} of {len(judged)} requirements "
            f"{'is' if len(failed) == 1 else 'are'} not met. Furthest beyond its limit: "
            f"{worst.title}"
        )
        if worst.value is not None and worst.limit is not None:
            words += f", {value} (limit {limit})"
    if unknown := [item.title for item in result.items if item.unjudged]:
        words += f". Not checked, value unknown, which does not pass: {'; '.join(unknown)}"
    return words


def lateral_page(result: Lateral, *, comparison: Comparison | None = None, date: str = "") -> Page:
    """The report of a ``Lateral``; comparison: beside what it is shown; date: ISO (today if
    empty).
    """
    sections = [
        Section("Summary sheet"),
    ]
    if result.critical_map is not None:
        sections.append(_map_section(result.critical_map, result.speeds))
    if result.response is not None:
        sections += _response_sections(result)
    if result.level_one is not None:
        picture = Figure(
            "Log decrement versus cross-coupled stiffness",
            level_one_figure(result.level_one),
            _at_the_border(result.level_one),
        )
        sections.append(Section("Stability, Level I", _LEVEL_ONE, (picture,)))
    if result.modes:
        acting = "the controller as it runs" if result.machine.bearings else "journal bearings"
        two = _LEVEL_TWO.format(
            acting=acting,
            point=result.point,
            hertz=f"{result.modes_to / (2 * np.pi):.4g}",
            top=standard.rpm(result.modes_to),
        )
        shapes = Figure(
            "Damped mode shapes",
            shapes_figure(result.layout, [row.mode for row in result.modes]),
            "Each scaled to its largest deflection, its decay left out. Orbits: blue forward, red "
            "backward, grey planar; thick at bearings and, black, at probes.",
        )
        pictures: tuple[Figure, ...] = (shapes,)
        if result.along:
            over = Figure("Campbell diagram of the loop", campbell_figure(result), _CAMPBELL)
            pictures = (over, shapes)
        sections.append(Section("Stability, Level II", two, pictures, (modes_table(result),)))
    if result.rubs:
        sections.append(Section("Clearances", "", (), (clearance_table(result),)))
    if result.capacities:
        worst = min(result.capacities, key=lambda axis: axis.margin)
        picture = Figure(
            f"Load capacity of axis {worst.axis}, which has the least margin",
            capacity_figure(worst),
        )
        own = load_table(result.machine)
        tables = (*own, capacity_table(result), demand_table(worst))
        sections.append(Section("Load capacity", _CAPACITY, (picture,), tables))
    if result.phase_budgets:
        tables = tuple(phase_table(budget) for budget in result.phase_budgets)
        sections.append(Section("Phase budget", _PHASE, (), tables))
    if comparison is not None:
        sections.append(_comparison_section(comparison))
    chosen = assumed_table(result.machine)
    if result.notes or chosen:
        sections.append(Section("Notes", "\n\n".join(result.notes), (), chosen))
    lowest, highest, trip = result.speeds
    running = f"running {speeds_in_words(lowest, highest)}, trip {standard.rpm(trip)} rpm"
    controlled = bool(result.machine.bearings)
    facts: tuple[tuple[str, str], ...] = (
        (
            "Controller",
            f"{result.controller}; {timing_in_words(result.timing)}"
            if controlled
            else "none: journal bearings",
        ),
        ("Operating point", f"{result.point}{_judged_elsewhere(result)}"),
        ("Speeds", running),
        ("Model", "finite-element rotor, all modes to 100 kHz; consistent mass"),
        ("Standards", _standards(result)),
        ("Not covered", _not_covered(result)),
    )
    if result.density is not None:
        given = f"{result.density:.4g} kg/m³, mean, for the screening of Level I"
        facts = (*facts, ("Gas density", given))
    words = verdict_words(result)
    drawing = Figure("Rotor and its parts", machine_drawing(result.machine))
    tables = (rotor_table(result), *signal_tables(result))
    opening = Section("Rotor", "", (drawing,), tables)
    summary, *rest = sections
    ordered = (summary, opening, *rest)
    summary = replace(summary, tables=(summary_table(result, ordered),))
    return Page(
        "Lateral analysis",
        result.machine,
        (summary, *ordered[1:]),
        (),
        facts,
        date,
        result=Verdict("Result", result.passed, words),
        opening=Section("", tables=(deciding_table(result),)),
    )


def deciding_table(result: Lateral) -> Table:
    """The requirements that are not met or have no known value, then those nearest to the limit."""
    judged = [item for item in result.items if item.passed is not None or item.unjudged]
    judged.sort(key=lambda item: (item.passed is True, -_share(item)))
    # the log decrement is asked for in any case
    damped = [item for item in judged[_DECIDE:] if item.name.startswith("level_two")]
    shown = [*judged[: _DECIDE - len(damped[:1])], *damped[:1]]
    rows = tuple((item.title, *_summary_row(item)[1:4]) for item in shown)
    more = len(judged) - len(rows)
    note = f"{more} more requirements: summary sheet." if more else ""
    return Table("", ("Requirement, tightest first", "Verdict", "Value", "Limit"), rows, note)


def _share(item: Item) -> float:
    """Of the limit that the value takes; 0 where there is none."""
    if not item.limit or not item.value:
        return 0.0
    share = abs(item.value / item.limit)
    return 1.0 / share if item.relation in {">", ">="} else share


def _judged_elsewhere(result: Lateral) -> str:
    """What is judged at the other operating points of the machine file."""
    if len(result.machine.operation.envelope) < 2:
        return ""
    if not any(item.name.startswith("points.") for item in result.items):
        return "; the other requirements of the machine file are not checked here"
    return "; at all other points of the machine file only stability and sensitivity"


def rotor_table(result: Lateral) -> Table:
    """Mass, inertia, length and span of the rotor, and what each journal carries of it."""
    rotor = finite_element_rotor(result.machine)
    whole, layout = mass_properties(rotor), result.layout
    places = [journal.position for journal in layout.journals]
    length = rotor.positions[-1] - rotor.positions[0]
    rows: list[Row] = [
        ("Mass", *numbers(f"{whole.mass:.5g} kg")),
        ("Centre of mass, from the left end", *numbers(f"{1e3 * whole.centre:.5g} mm")),
        ("Polar inertia", *numbers(f"{whole.polar_inertia:.4g} kg m²")),
        (
            "Diametral inertia about the centre of mass",
            *numbers(f"{whole.diametral_inertia:.4g} kg m²"),
        ),
        ("Length", *numbers(f"{1e3 * length:.5g} mm")),
        ("Bearing span", *numbers(f"{1e3 * (max(places) - min(places)):.5g} mm")),
    ]
    rows += [
        (
            Cell(f"Bearing {journal.name}", detail=f"at {1e3 * journal.position:.5g} mm"),
            *numbers(f"{journal.weight:.4g} kg"),
        )
        for journal in layout.journals
    ]
    note = "Bearings: static share of the rotor's mass, for a horizontal rotor."
    return Table("Rotor", ("Quantity", "Value"), tuple(rows), note)


def signal_tables(result: Lateral) -> tuple[Table, ...]:
    """The sensors with the amplifier, and the controller as it runs."""
    control = result.control
    if control is None:
        return ()
    rows: list[Row] = [
        (
            f"Sensors of {item.bearing}",
            *numbers(
                f"{1e3 * item.position:.5g}",
                f"{np.degrees(item.angle or 0.0):.4g}",
                f"{item.weight:.3g}",
                "no lag" if item.bandwidth is None else f"{item.bandwidth / (2 * np.pi):.4g} Hz",
            ),
        )
        for item in result.machine.sensor_pairs
    ]
    drive = result.machine.amplifier
    stated = [
        f"{name.replace('_', ' ')} {value:.4g} {unit}"
        for name, unit, scale in _DRIVE
        if (found := getattr(drive, name)) is not None
        for value in (found / scale,)
    ]
    note = f"Amplifier: order {', '.join([f'{chr(34)}{drive.order}{chr(34)}', *stated])}."
    heads = ("Pair", "Position [mm]", "First sensor at [deg]", "Weight", "First-order lag")
    gains: tuple[Row, ...] = tuple(
        (
            f"{w / (2 * np.pi):.4g} Hz",
            *numbers(*(f"{abs(k) / 1e3:.3g}, {np.degrees(np.angle(k)):.0f}°" for k in row)),
        )
        for w, row in zip(control.omega, control.gain, strict=True)
    )
    paced = "continuous" if control.sample_time is None else f"{1 / control.sample_time:.5g} Hz"
    words = (
        f"{result.controller}: {control.states} states, {paced}; delay and hold are included. "
        "Couplings between axes are not listed."
    )
    columns = ("Frequency", *control.axes)
    return (
        Table("Sensors and amplifier", heads, tuple(rows), note),
        Table("Controller, gain [A/mm] and phase of every axis", columns, gains, words),
    )


def phase_table(budget: PhaseBudget) -> Table:
    """Phases of every element at every bending mode [deg]."""
    heads = tuple(f"{w / (2 * np.pi):.5g} Hz [deg]" for w in budget.frequencies)
    named = [*zip(budget.elements, budget.phases, strict=True)]
    named += [("total without controller", budget.cost), ("total", budget.total)]
    rows: tuple[Row, ...] = tuple(
        (name, *numbers(*(f"{np.degrees(value):.2f}" for value in row))) for name, row in named
    )
    note = ". ".join(budget.notes)
    which = "Axis" if len(budget.axes) == 1 else "Axes"
    return Table(f"{which} {', '.join(budget.axes)}", ("Element", *heads), rows, note)


def _at_the_border(one: LevelOne) -> str:
    """What happens at Q0, and what the red line is."""
    asked = f"Red line: required log decrement, {standard.LEAST_LOG_DECREMENT:g}."
    if not np.isfinite(one.border):
        words = level_one_beyond(one)
        return f"{words[0].upper()}{words[1:]}. {asked}"
    mode = f"the mode at {standard.rpm(one.crossing)} rpm"
    other = "" if one.binding is not None else ", none of the forward modes shown,"
    late = any(branch.late for branch in one.branches)
    since = " At Q = 0 it is not an oscillatory forward mode." if late else ""
    q = f"{1e-6 * one.border:.4g} N/µm ({theme.number(one.border)} N/m)"
    return f"At Q0, {q}, {mode}{other} becomes unstable.{since} {asked}"


def _comparison_section(comparison: Comparison) -> Section:
    """Theirs and ours, with the measured responses where there are some."""
    table = (comparison_table(comparison),)
    if not comparison.responses:
        return Section("Side by side", _BESIDE, (), table)
    picture = responses_figure(comparison.responses, ("this analysis",), _PREDICTED)
    agreed = comparison.agreement
    words = f"{agreed[0].upper()}{agreed[1:]}. {_CLAUSE}"
    return Section("Measured responses beside predicted ones", words, (picture,), table)


def comparison_table(comparison: Comparison) -> Table:
    """Theirs and ours row by row."""
    rows: list[Row] = []
    for pair in comparison.pairs:
        where, quantity, *values, note = comparison_texts(pair)
        rows.append((Cell(where, detail=note), quantity, *numbers(*values)))
    columns = ("Where", "Quantity", comparison.theirs_name, "This analysis", "This less other")
    return Table(f"This analysis beside {comparison.theirs_name}", columns, tuple(rows))


def comparison_texts(pair: Pair) -> tuple[str, ...]:
    """Where, quantity, theirs, ours, difference and note of a pair."""
    unit = pair.unit
    percent = "" if pair.percent is None else f" ({pair.percent:+.3g} %)"
    difference = pair.difference
    return (
        pair.where,
        pair.quantity,
        with_unit(pair.theirs, unit, 5),
        "-" if pair.ours is None else with_unit(pair.ours, unit, 5),
        "-" if difference is None else f"{with_unit(difference, unit, 3)}{percent}",
        pair.note,
    )


def summary_table(result: Lateral, sections: Sequence[Section] = ()) -> Table:
    """Clause, basis, value, limit, verdict and figure of every row; sections: those of the page, in
    order.
    """
    places = _places(sections)
    covered = [item for item in result.items if not item.name.startswith(_ABSENT)]
    rows = tuple((*_summary_row(item), _figure_of(item, places)) for item in covered)
    columns = ("Item", "Verdict", "Value", "Limit", "Edition and clause", "Basis", "Figure")
    return Table("Clause by clause", columns, rows, _BASIS)


def _standards(result: Lateral) -> str:
    """The standards of the rows, without limits of the machine file and the package's own."""
    names = dict.fromkeys(_edition(item.standard) for item in result.items)
    return "; ".join(name for name in names if name.startswith(("API", "ISO")))


def _not_covered(result: Lateral) -> str:
    """The clauses without a row of their own, for the head."""
    return "; ".join(item.title.lower() for item in result.items if item.name.startswith(_ABSENT))


def _places(sections: Sequence[Section]) -> dict[str, Cell]:
    """Title of a section -> its first figure's number, or "table", as a link to it; placement of
    the unbalance -> the number of its own figure.
    """
    number, found = 1, {}
    for k, section in enumerate(sections):
        text = f"{number}" if section.figures else "table"
        found[section.title] = Cell(text, link=f"#section-{k + 1}")
        if section.title == _RESPONSES:
            for own, figure in enumerate(section.figures, number):
                name = figure.title.removeprefix(_FOR)
                found[name] = Cell(f"{own}", link=f"#figure-{own}")
        number += len(section.figures)
    return found


def _figure_of(item: Item, places: Mapping[str, Cell]) -> Cell:
    """The figure of its placement of the unbalance, where its note names one, else its section's
    first.
    """
    title = _SECTIONS.get(item.name.partition(".")[0], "")
    named = [name for name in places if name in item.note]
    if title == _RESPONSES and named:
        return places[max(named, key=len)]
    return places.get(title, Cell("-"))


def _summary_row(item: Item) -> Row:
    mark = "none" if item.passed is None else "pass" if item.passed else "fail"
    word = "" if item.passed is None else "met" if item.passed else "not met"
    return (
        Cell(item.title, detail=_whole(item.note)),
        Cell(word, mark),
        *numbers_of(item),
        Cell(_edition(item.standard), detail=_said_once(item)),
        item.basis,
    )


def numbers_of(item: Item) -> tuple[Cell, ...]:
    """Its value and its limit, with their unit."""
    unit = "" if item.unit == "-" else f" {_whole(item.unit)}"
    value = "-" if item.value is None else f"{item.bound} {_number(item.value)}{unit}".strip()
    limit = "-" if item.limit is None else f"{_relation(item.relation)} {_number(item.limit)}{unit}"
    return numbers(value, limit)


def _said_once(item: Item) -> str:
    """The clause, where it is more than the title."""
    return "" if item.clause.lower() == item.title.lower() else item.clause


def _whole(text: str) -> str:
    """p-p and 0-p that no line ends within, beside their unit; micrometres with their letter."""
    text = _MICRO.sub("µm", text)
    for end in ("p", "0"):
        text = text.replace(f" {end}-p", f"{_SPACE}{end}{_HYPHEN}p")
    return text


def _edition(text: str) -> str:
    """A standard's number and edition that no line ends within."""
    whole, comma, part = text.rpartition(", ")
    first, last = (
        words.replace(" ", _SPACE).replace("-", _HYPHEN) for words in (whole or part, part)
    )
    return f"{first}{comma}{last}" if whole else first


def _relation(text: str) -> str:
    return {"<=": "≤", ">=": "≥"}.get(text, text)


def _number(value: float) -> str:
    return theme.number(value) if np.isfinite(value) else not_finite(value)


def _map_section(found: CriticalMap, speeds: tuple[float, float, float]) -> Section:
    kinds = {item.magnetic for item in found.supports}
    of = [
        words for magnetic, words in ((True, _OF_MAGNETS), (False, _OF_FILMS)) if magnetic in kinds
    ]
    text = _UNDAMPED.format(of="; ".join(of))
    picture = Figure("Critical-speed map", critical_map_figure(found, speeds))
    rows: tuple[Row, ...] = tuple(
        (
            item.support,
            *numbers(
                f"{item.number}",
                f"{standard.rpm(item.speed)}",
                f"{1e-6 * item.stiffness:.4g}",
            ),
        )
        for item in found.crossings
    )
    rows += tuple(
        ("rigid supports", *numbers(f"{number}", f"{standard.rpm(speed)}", "-"))
        for number, speed in enumerate(found.rigid, 1)
    )
    columns = ("Supports", "Critical speed", "Speed [rpm]", "Stiffness [N/µm]")
    return Section(_MAPPED, text, (picture,), (Table("Intersections", columns, rows),))


def _response_sections(result: Lateral) -> list[Section]:
    response = result.response
    assert response is not None
    limit = standard.vibration_limit(result.speeds[1] / standard.RPM)
    text = _RESPONSE.format(
        count=len(response.speeds),
        first=standard.rpm(float(response.speeds[0])),
        last=standard.rpm(float(response.speeds[-1])),
        error=f"{100 * response.widest:.2g} %",
    )
    pictures = tuple(
        Figure(
            f"{_FOR}{case.name}",
            response_figure(response, result.speeds, k, limit, result.critical_speeds),
            f"{case.why[0].upper()}{case.why[1:]}. "
            "Circles: critical speeds found with this unbalance.",
        )
        for k, case in enumerate(response.cases)
    )
    placed = Figure("Placement of the unbalance", placement_figure(result.layout, response))
    rows: tuple[Row, ...] = tuple(
        (
            case.name,
            *numbers(
                f"{1e3 * result.layout.positions[w.station]:.4g} mm",
                f"{1e6 * w.amount:.4g} g mm",
                f"{np.degrees(w.angle):.0f} deg",
                f"{w.carried:.4g} kg",
            ),
        )
        for case in response.cases
        for w in case.weights
    )
    table = Table(
        "Unbalance, twice the residual amount",
        ("Placed for", "Position", "Amount", "Angle", "Static load"),
        rows,
    )
    return [
        Section("Placement of the unbalance", _PLACED, (placed,), (table,)),
        Section("Unbalance response", text, pictures),
    ]


def modes_table(result: Lateral) -> Table:
    """Frequency, log decrement, whirl, limit and the largest shares of every mode."""
    sought = any(row.least is not None for row in result.modes)
    highest, asked = result.speeds[1], standard.LEAST_LOG_DECREMENT
    rows: list[Row] = []
    for row in result.modes:
        mode = row.mode
        shares = sorted(row.shares, key=lambda share: -abs(share.log_decrement))[:4]
        words = ", ".join(f"{share.component} {share.log_decrement:+.3g}" for share in shares)
        least = "-" if row.least is None else f"{row.least:.3g}"
        rows.append(
            (
                Cell(f"{standard.rpm(mode.frequency)} rpm", detail=words),
                mode.way,
                *numbers(f"{mode.frequency / (2 * np.pi):.4g}", f"{mode.log_decrement:.3g}"),
                *numbers(_relation(">=") + f" {asked:g}" if mode.frequency <= highest else "-"),
                *((Cell(least, "number", detail=row.member),) if sought else ()),
            )
        )
    return Table(
        "Modes, with the largest contributions to their log decrement",
        (
            "Mode",
            "Whirl",
            "Frequency [Hz]",
            "Log decrement",
            "Limit",
            *(("Least found within the tolerances",) if sought else ()),
        ),
        tuple(rows),
    )


def clearance_table(result: Lateral) -> Table:
    """Scaled motion at every clearance."""
    rows = tuple(
        (
            Cell(rub.name, detail=f"{1e3 * rub.position:.4g} mm; {rub.case}"),
            *numbers(
                f"{1e6 * rub.diametral:.4g}",
                f"{1e6 * rub.motion:.3g}",
                f"{1e6 * rub.offset:.3g}",
                f"{standard.rpm(rub.speed)}",
                f"{100 * rub.share:.3g}",
            ),
            Cell("met" if rub.passed else "not met", "pass" if rub.passed else "fail"),
        )
        for rub in result.rubs
    )
    columns = (
        "Location",
        "Diametral clearance [µm]",
        _whole("Scaled motion [um p-p]"),
        "Static offset [µm]",
        "Speed [rpm]",
        "Of the clearance [%]",
        "Verdict",
    )
    capped, uncapped = result.scale
    note = (
        f"Scale factor {capped:.3g} (uncapped {_number(uncapped)}); permitted for motion and "
        "static offset of both sides: 75 % of the diametral clearance, unless the machine file "
        "states another limit."
    )
    title = "Motion at the close clearances"
    if result.response is not None:
        ends = result.response.speeds[[0, -1]]
        title += f", {speeds_in_words(*map(float, ends))}"
    return Table(title, columns, rows, note)


def capacity_table(result: Lateral) -> Table:
    """Static load, capacity on both sides and the least margin of every axis."""
    rows: list[Row] = []
    for axis in result.capacities:
        parts = ", ".join(f"{name} {force:.4g} N" for name, force in axis.static)
        rows.append(
            (
                axis.axis,
                Cell(f"{axis.static_force:.4g}", "number", detail=parts),
                *numbers(
                    f"{axis.limits.static:.3g}",
                    f"{axis.force[0]:.4g}",
                    f"{axis.other[0]:.4g}",
                ),
                Cell(f"{axis.margin:.3g}", "number", detail=_whole(axis.worst)),
                Cell("met" if axis.margin >= 1 else "not met", _mark(axis.margin >= 1)),
            )
        )
    columns = (
        "Axis",
        "Static load [N]",
        "Static current [A]",
        _whole("Available along it [N 0-p]"),
        _whole("Available against it [N 0-p]"),
        "Least margin [-]",
        "Verdict",
    )
    seals = any(name == SEALS for axis in result.capacities for name, _ in axis.static)
    return Table(
        "Static load and capacity of each control axis",
        columns,
        tuple(rows),
        _LASTS if seals else "",
    )


def load_table(machine: Machine) -> tuple[Table, ...]:
    """What the machine file says that the magnets must carry; nothing where it says nothing."""
    rows: list[Row] = []
    for part in machine.parts(Load):
        time = "sustained"
        if part.duration is not None:
            time = f"half-sine of {theme.quantity(part.duration, 's')}"
        elif part.frequency is not None:
            time = f"sine of {part.frequency / (2 * np.pi):.4g} Hz"
        way = "worst case" if part.direction is None else f"{np.degrees(part.direction):.4g} deg"
        values = (f"{1e3 * part.position:.5g}", f"{part.force:.4g}", time, way)
        rows.append((part.name, part.kind, *numbers(*values)))
    reason = dict(machine.assumed).get("load", "")
    note = f"Assumed: {reason}." if reason else ""
    columns = (
        "Load",
        "Kind",
        "Position [mm]",
        _whole("Force [N 0-p]"),
        "Time history",
        "Direction",
    )
    return (
        (Table("Loads specified in the machine file", columns, tuple(rows), note),) if rows else ()
    )


def demand_table(axis: AxisCapacity) -> Table:
    """Every load on one axis with what it takes."""
    rows: tuple[Row, ...] = tuple(
        (
            item.name,
            item.kind,
            *numbers(
                f"{item.frequency / (2 * np.pi):.4g}",
                f"{item.force:.4g}",
                f"{item.current:.3g}",
                f"{item.voltage:.3g}" if axis.limits.inductance else "-",
                "-" if item.kind == PART else f"{axis.limits.margin(item).value:.3g}",
            ),
        )
        for item in axis.demands
    )
    columns = (
        "Load",
        "Kind",
        "Frequency [Hz]",
        _whole("Force [N 0-p]"),
        _whole("Current [A 0-p]"),
        _whole("Voltage [V 0-p]"),
        "Margin without other loads [-]",
    )
    return Table(f"Demand on axis {axis.axis} by load", columns, rows, _DEMANDS)


def _mark(passed: bool) -> str:
    return "pass" if passed else "fail"
