"""The page of a landing: verdict, slow motion, distribution, whip before any simulation."""

from typing import Any

import numpy as np

from ambrose.annexes.touchdown.analysis import HEADS, WHIP_MODEL, Landing, WhipMap
from ambrose.annexes.touchdown.campaign import (
    FRICTION,
    MOUNT,
    SPEED,
    WHIRLS,
    AxialDrop,
    Campaign,
    Row as Cost,
)
from ambrose.report import theme
from ambrose.report.figures.motion import add_controls
from ambrose.report.figures.rotor_drawing import machine_drawing
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers

# Pictures of drops: the orbit in slow motion, speeds and forces over time, the distribution.


FRAMES = 160  # of the animation, at most
SHOWN = 0.12  # [s] after the first contact
_TRAIL = 40  # frames that stay visible
FRAME_TIME = 60  # [ms]
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")


def slow_motion(result: Landing) -> Any:
    """The rotor's centre in every touchdown bearing against its clearance, with what it meets,
    which gives way: a figure with frames and a slider.
    """
    import plotly.graph_objects as go

    log, names = result.fall.log, result.fallen.names
    touched = result.fall.figures[:, 0]
    first = float(touched[touched >= 0].min()) if (touched >= 0).any() else 0.0
    window = np.flatnonzero((log[:, 0] >= 0.6 * first) & (log[:, 0] <= first + SHOWN))
    moments = window[np.unique(np.linspace(0, len(window) - 1, FRAMES).astype(int))]
    figure = theme.subplots(rows=1, cols=len(names), horizontal_spacing=0.12)
    turn = np.linspace(0, 2 * np.pi, 61)
    gap = max(bearing.clearance for bearing in result.fallen.bearings)
    deep = np.hypot(log[window, 2::8], log[window, 3::8]).max() if len(window) else gap
    reach = 1.12e6 * max(gap, float(deep))
    moving: list[int] = []
    for k, name in enumerate(names):
        place = {"row": 1, "col": k + 1}
        circle = 1e6 * result.fallen.bearings[k].clearance
        theme.guide(
            figure,
            place,
            np.float32(circle * np.cos(turn)),
            np.float32(circle * np.sin(turn)),
            color=theme.FAINT,
            width=1,
        )
        for style in ({"color": theme.LIMIT, "width": 1.6}, {"color": _COLOURS[0], "width": 1.4}):
            moving.append(len(figure.data))
            theme.scatter(figure, place, [], [], mode="lines", line=style, hoverinfo="skip")
        moving.append(len(figure.data))
        theme.scatter(
            figure,
            place,
            [],
            [],
            mode="markers",
            marker={"size": 9, "color": theme.INK},
            hoverinfo="skip",
        )
        theme.heading(figure, place, theme.plain(name))
        figure.update_xaxes(range=[-reach, reach], title_text="x [µm]", **place)
        figure.update_yaxes(
            range=[-reach, reach],
            scaleanchor=f"x{k + 1 if k else ''}",
            title_text="y [µm]",
            **place,
        )

    def shown(i: int) -> list[Any]:
        """The moving lines at the moment i."""
        found = []
        for k in range(len(names)):
            at = 2 + 8 * k
            x, y = 1e6 * log[moments, at], 1e6 * log[moments, at + 1]
            met = 1e6 * log[moments[i], at + 4 : at + 6]
            circle = 1e6 * result.fallen.bearings[k].clearance
            part = slice(max(i - _TRAIL, 0), i + 1)
            found += [
                go.Scatter(
                    x=np.float32(met[0] + circle * np.cos(turn)),
                    y=np.float32(met[1] + circle * np.sin(turn)),
                ),
                go.Scatter(x=np.float32(x[part]), y=np.float32(y[part])),
                go.Scatter(x=[float(np.float32(x[i]))], y=[float(np.float32(y[i]))]),
            ]
        return found

    if len(moments):
        last = shown(len(moments) - 1)
        for index, trace in zip(moving, last, strict=True):
            figure.data[index].update(x=trace.x, y=trace.y)
    labels = [f"{i}" for i in range(len(moments))]
    figure.frames = [
        go.Frame(name=label, traces=moving, data=shown(i)) for i, label in enumerate(labels)
    ]
    theme.dress(figure, 330, legend=False)
    add_controls(
        figure,
        labels,
        [f"{1e3 * t:.1f} ms" for t in log[moments, 0]],
        FRAME_TIME,
        below=44,
        left=0.24,
        margin=112,
        growth=64,
        active=len(labels) - 1,
    )
    return figure


def history_figure(result: Landing) -> Any:
    """Contact forces, and speeds of races and rotor, over the drop."""
    log, names = result.fall.log, result.fallen.names
    figure = theme.subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.1)
    looks = theme.styles(names)
    for k, name in enumerate(names):
        for row, column, scale in ((1, 4 + 8 * k, 1e-3), (2, 5 + 8 * k, 30 / np.pi)):
            if row == 2 and not result.fallen.bearings[k].race_mass:
                continue
            x, y = _coarse(log[:, 0], log[:, column] * scale)
            theme.scatter(
                figure,
                {"row": row, "col": 1},
                np.float32(1e3 * x),
                np.float32(y),
                name,
                shown=row == 1,
                mode="lines",
                line={**looks[name].line, "width": 1.2},
                hovertemplate="%{x:.4g} ms: %{y:.4g}<extra></extra>",
            )
    x, y = _coarse(log[:, 0], log[:, 1] * 30 / np.pi)
    theme.scatter(
        figure,
        {"row": 2, "col": 1},
        np.float32(1e3 * x),
        np.float32(y),
        "rotor",
        shown=True,
        mode="lines",
        line={"color": theme.INK, "width": 1.4, "dash": "dash"},
        hovertemplate="%{x:.4g} ms: %{y:.4g} rpm<extra></extra>",
    )
    theme.dress(figure, 400, legend=True)
    figure.update_yaxes(title_text="Contact force [kN]", row=1, col=1)
    figure.update_yaxes(title_text="Speed [rpm]", rangemode="tozero", row=2, col=1)
    figure.update_xaxes(title_text="Time after the loss of power [ms]", row=2, col=1)
    return figure


def axial_figure(drop: AxialDrop) -> Any:
    """Place of the collar between stop and magnet, and the stop's force, until it rests."""
    figure = theme.subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.1)
    end = drop.time[-1] if drop.settled is None else 1.3 * drop.settled
    window = drop.time <= end
    time, sign = 1e3 * drop.time[window], 1.0 if drop.thrust > 0 else -1.0
    for row, values, unit in ((1, 1e6 * drop.place, "µm"), (2, 1e-3 * drop.force, "kN")):
        theme.scatter(
            figure,
            {"row": row, "col": 1},
            np.float32(time),
            np.float32(values[window]),
            mode="lines",
            line={"color": _COLOURS[0], "width": 1.4},
            hovertemplate=f"%{{x:.4g}} ms: %{{y:.4g}} {unit}<extra></extra>",
        )
    ends = [0.0, float(time[-1])]
    for words, at, style in (
        ("stop", drop.way, {"color": theme.MUTED, "width": 1.4, "dash": "dash"}),
        ("magnet", drop.gap, {"color": theme.LIMIT, "width": 1.6}),
    ):
        theme.scatter(
            figure,
            {"row": 1, "col": 1},
            np.array(ends, np.float32),
            np.full(2, 1e6 * sign * at, np.float32),
            words,
            shown=True,
            mode="lines",
            line=style,
            hoverinfo="skip",
        )
    theme.dress(figure, 360, legend=True)
    figure.update_yaxes(title_text="Place along the shaft [µm]", row=1, col=1)
    figure.update_yaxes(title_text="Force of the stop [kN]", rangemode="tozero", row=2, col=1)
    figure.update_xaxes(title_text="Time after the loss of power [ms]", row=2, col=1)
    return figure


def _coarse(x: np.ndarray, y: np.ndarray, most: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """At most so many points, the largest value of each stretch among them."""
    if len(x) <= most:
        return x, y
    width = -(-len(x) // most)
    count = len(x) // width
    chosen = y[: count * width].reshape(count, width).argmax(axis=1) + width * np.arange(count)
    return x[chosen], y[chosen]


def distribution_figure(campaign: Campaign, names: tuple[str, ...]) -> Any:
    """How many drops have at most a force, by bearing; and turns against the spin over friction."""
    figure = theme.subplots(rows=1, cols=2, horizontal_spacing=0.14)
    looks = theme.styles(names)
    share = np.linspace(0, 1, 201)
    for k, name in enumerate(names):
        force = np.quantile(campaign.force[:, k], share) / 1e3
        theme.scatter(
            figure,
            {"row": 1, "col": 1},
            np.float32(force),
            np.float32(100 * share),
            name,
            shown=True,
            mode="lines",
            line=looks[name].line,
            hovertemplate="%{x:.4g} kN: %{y:.3g} %<extra></extra>",
        )
    figure.update_xaxes(title_text="Largest force [kN]", rangemode="tozero", row=1, col=1)
    figure.update_yaxes(title_text="Drops with at most that [%]", row=1, col=1)
    few = slice(0, 1500)
    turns, whirls = campaign.turns[few], campaign.whirls[few]
    for chosen, colour, words in (
        (~whirls, theme.MUTED, "no whirl"),
        (whirls, "#d55e00", "whirls"),
    ):
        theme.scatter(
            figure,
            {"row": 1, "col": 2},
            np.float32(campaign.cases[few][chosen, 0]),
            np.float32(np.maximum(turns[chosen], 0.1)),
            words,
            shown=True,
            mode="markers",
            marker={"size": 3, "color": colour, "opacity": 0.6},
            hovertemplate="friction factor %{x:.3g}: %{y:.3g} turns<extra></extra>",
        )
    theme.guide(
        figure, {"row": 1, "col": 2}, [0.5, 1.5], [WHIRLS] * 2, color=theme.INK, width=1, dash="dot"
    )
    top = max(2 * WHIRLS, float(turns.max()))
    figure.update_xaxes(title_text="Friction over the file's", row=1, col=2)
    figure.update_yaxes(
        title_text="Turns against the spin", row=1, col=2, **theme.decades(0.1, 1.1 * top)
    )
    theme.dress(figure, 300, legend=True)
    return figure


# Pictures of whip: what it needs over its frequency, and its edge over friction and mount.


_ONE = {"row": 1, "col": 1}
_TURN = 2 * np.pi  # rad


def needed_figure(result: Landing) -> Any:
    """Friction that whip needs over its frequency, beside what the bearings have."""
    figure = theme.subplots(rows=1, cols=1)
    looks = theme.styles([curve.kind for curve in result.curves])
    shown = {whip.kind for whip in result.whips}
    for curve in result.curves:
        if curve.kind in shown:
            theme.scatter(
                figure,
                _ONE,
                np.float32(curve.frequency / _TURN),
                np.float32(curve.friction),
                curve.kind,
                shown=True,
                mode="lines",
                line=looks[curve.kind].line,
                hovertemplate="%{x:.4g} Hz: %{y:.3g}<extra></extra>",
            )
    ends = np.array([curve.frequency[[0, -1]] for curve in result.curves]) / _TURN
    low, high = float(ends.min()), float(ends.max())
    for mu in sorted({bearing.friction for bearing in result.fallen.bearings}):
        theme.guide(figure, _ONE, [low, high], [mu, mu], color=theme.INK, width=1, dash="dot")
        theme.note(figure, _ONE, f"friction {mu:g}", np.log10(low), mu, "left", "bottom")
    turn = result.point.speed / _TURN
    theme.guide(figure, _ONE, [turn, turn], [0, 1], color=theme.MUTED, width=1, dash="dash")
    theme.note(figure, _ONE, "speed", np.log10(turn), 1, "left", "top")
    theme.dress(figure, 280, legend=True)
    figure.update_xaxes(title_text="Whip frequency [Hz]", **theme.decades(low, high))
    figure.update_yaxes(title_text="Friction needed", range=[0, 1])
    return figure


def map_figure(item: WhipMap, quantity: str) -> Any:
    """The edge over friction and mount stiffness at the mount's own damping, with the machine's
    place. quantity: "frequency" or "force".
    """
    import plotly.graph_objects as go

    middle = len(item.damping) // 2
    values = getattr(item, quantity)[middle]
    scale = _TURN if quantity == "frequency" else 1e3
    there = np.isfinite(values) & (values > 0)
    shown = np.full(values.shape, np.nan)
    shown[there] = np.log10(values[there] / scale)
    figure = theme.subplots(rows=1, cols=1)
    low, high = (np.nanmin(shown), np.nanmax(shown)) if there.any() else (0.0, 1.0)
    ticks = np.linspace(low, high, 5)
    unit = "Hz" if quantity == "frequency" else "kN"
    figure.add_trace(
        go.Heatmap(
            x=np.float32(item.friction),
            y=np.float32(item.stiffness / 1e6),
            z=np.float32(shown),
            customdata=np.float32(np.where(there, values / scale, 0)),
            colorscale="Viridis",
            colorbar={
                "thickness": 12,
                "tickvals": ticks.tolist(),
                "ticktext": [f"{10**v:.3g}" for v in ticks],
                "title": {"text": unit},
            },
            hovertemplate="friction %{x:.3g}, %{y:.3g} N/µm: %{customdata:.4g} "
            + unit
            + "<extra></extra>",
        ),
        **_ONE,
    )
    if item.place is not None:
        mu, stiffness, _ = item.place
        theme.scatter(
            figure,
            _ONE,
            [mu],
            [stiffness / 1e6],
            mode="markers",
            marker={
                "symbol": "diamond",
                "size": 13,
                "color": "white",
                "line": {"color": "black", "width": 2},
            },
            hovertemplate="this machine<extra></extra>",
        )
        theme.note(
            figure,
            _ONE,
            "this machine",
            np.log10(mu),
            np.log10(stiffness / 1e6) + 0.06,
            "center",
            "bottom",
            colour="black",
            bgcolor="rgba(255,255,255,0.8)",
        )
    theme.dress(figure, 300, legend=False)
    figure.update_xaxes(
        title_text="Friction", **theme.decades(float(item.friction[0]), float(item.friction[-1]))
    )
    span = theme.decades(float(item.stiffness[0]) / 1e6, float(item.stiffness[-1]) / 1e6)
    figure.update_yaxes(title_text="Mount stiffness [N/µm]", **span)
    return figure


_WHIP = (
    "Backward whip: friction at the touchdown bearing drives the rotor around against its spin. "
    "It speeds up where friction exceeds what whip needs, and settles at the edge, where the need "
    f"rises through it. Model: {WHIP_MODEL}."
)
_NEEDED = "Whip settles where a curve rises through the dotted line."
_MAP = (
    "Where whip of the kind '{kind}' settles, over friction and mount stiffness at the mount's own "
    "damping. White: no whip, or a force that nothing "
    "bounds."
)
_DROP = (
    "The magnets lose their power at t = 0 at the operating point, the rotor on the orbit of its "
    "residual unbalance. Rotor in {modes} bending modes per plane, seals and couplings linear."
)
_MOTION = (
    "Centre of the rotor in each bearing. Red: limit of the motion at contact, with the "
    "deflection of the bearing; grey: the limit at rest. Slow motion, {slow:.0f} times slower."
)
_HISTORY = "Forces and speeds: a race at the rotor's speed no longer slips."
_MANY = (
    "{count:,} drops of {duration:.3g} s with friction {f[0]:g} to {f[1]:g} and mount {m[0]:g} to "
    "{m[1]:g} times the file's values, speed {s[0]:g} to {s[1]:g} times the operating point's, and "
    "every phase of unbalance; seed {seed}; {wall:.0f} s on {workers} processors.\n\n"
    "{share:.3g} % whirl within {duration:.3g} s: {turns:g} whole turns against the spin without "
    "going back, counted on this nonlinear model. This is not a statement on stability."
)
_DISTRIBUTION = "Left: share of drops with at most a force. Right: at most 1,500 drops."
_COST = (
    "Over all drops where there is a campaign, else over the one drop; the rest of the run-down is "
    "estimated. Not covered: wear, heat that changes friction or clearance."
)
_ALONG = (
    "The thrust bearing loses its power with the others: rotor, coupling and stop of the machine "
    "file, from rest at the middle, under the process thrust of {thrust:.4g} N. Not included: "
    "magnet force while the flux decays (the rig includes it), friction on the face."
)
_FACE = "The collar against its stop, and how near it comes to the magnet."
_HEADS = (
    "The heads of ISO 14839-5:2022, recalled from its published scope (its text was not at hand; "
    "it states no numeric limits), and where this page has something on them."
)
_WORDS = {"none": "for information", "pass": "met", "fail": "not met"}
_NO_MOUNT = " The machine file states no mount: the map shows what one would do."


def whip_rows(result: Landing) -> tuple[tuple[str, str, str, str], ...]:
    """Kind, friction, frequency and force of every whip, as text."""
    rows = []
    for whip in result.whips:
        if whip.frequency == 0:
            at, force = "no whip", "-"
        elif np.isfinite(whip.frequency):
            at = f"{whip.frequency / (2 * np.pi):.4g} Hz"
            force = force_text(max(whip.force))
            if whip.stop:
                force += " (at the stop)" if whip.with_stop else " (without the stop, which is met)"
        else:
            at, force = "up to rolling", "not bounded"
        rows.append((whip.kind, f"{whip.friction:g}", at, force))
    return tuple(rows)


def force_text(force: float) -> str:
    """A force in kN; what the linear model does not bound says so."""
    return f"{force / 1e3:.3g} kN" if np.isfinite(force) else "not bounded"


def landing_page(result: Landing, *, date: str = "") -> Page:
    """The page of a ``Landing``; date: ISO (today if empty)."""
    rows: tuple[Row, ...] = tuple((kind, *numbers(*values)) for kind, *values in whip_rows(result))
    table = Table("Whip of this machine", ("Kind", "Friction", "Settles at", "Force"), rows)
    item = result.whip_map
    words = _MAP.format(kind=item.kind) + (_NO_MOUNT if item.place is None else "")
    pictures = (
        Figure("Friction that whip needs", needed_figure(result), _NEEDED),
        Figure("Frequency of whip", map_figure(item, "frequency"), words),
        Figure("Force of whip", map_figure(item, "force"), words),
    )
    drawing = Figure("Rotor and its parts", machine_drawing(result.machine))
    sections = (
        Section("Rotor", "", (drawing,)),
        drop_section(result),
        *map(axial_section, result.along),
        *([] if result.campaign is None else [campaign_section(result)]),
        Section(
            "Whip before any simulation", _WHIP, pictures, (table, damping_table(result)), True
        ),
        Section("ISO 14839-5", _HEADS, (), (heads_table(),)),
    )
    facts = (
        ("Controller", result.controller or "none: no recovery was computed"),
        ("Operating point", f"{result.point_name}, {result.point.speed * 30 / np.pi:.6g} rpm"),
        ("Rotor", f"{result.fallen.mass:.4g} kg"),
    )
    return Page(
        "Landing",
        result.machine,
        sections,
        (),
        facts,
        date,
        result=Verdict("Result", result.passed, verdict_text(result)),
        opening=Section("", tables=(cost_table(result),)),
    )


def verdict_text(result: Landing) -> str:
    """How it turned out, in a sentence."""
    judged = [row for row in result.rows if row.passed is not None]
    failed = [row for row in judged if not row.passed]
    over = "one drop" if result.campaign is None else f"{result.campaign.count:,} drops"
    if not judged:
        return f"no limits in [bearing.touchdown.limits]; {over} for information"
    worst = max(failed or judged, key=_share)
    decides = f"{worst.title} {_valued(worst.value, worst.unit)}, {worst.place}"
    decides += f" (limit {_valued(worst.limit or 0.0, worst.unit)})"
    if not failed:
        return f"PASSED: all {len(judged)} limits are met over {over}; tightest: {decides}"
    verb = "is" if len(failed) == 1 else "are"
    words = f"FAILED: {len(failed)} of {len(judged)} limits {verb} not met over {over}"
    return f"{words}; {'furthest beyond its limit: ' if len(failed) > 1 else ''}{decides}"


def _share(row: Cost) -> float:
    """The value over its limit, or the limit over the value where that is a lower one."""
    value, limit = abs(row.value), abs(row.limit or 0.0)
    over, under = (value, limit) if row.relation == "<=" else (limit, value)
    return over / under if under else np.inf


def cost_rows(result: Landing) -> tuple[tuple[str, str, str, str, str], ...]:
    """(place, quantity, value, limit, mark) of every row, as text."""
    rows = []
    for row in result.rows:
        sign = "≤" if row.relation == "<=" else "≥"
        limit = "" if row.limit is None else f"{sign} {_valued(row.limit, row.unit)}"
        mark = {None: "none", True: "pass", False: "fail"}[row.passed]
        rows.append((row.place, row.title, _valued(row.value, row.unit), limit, mark))
    return tuple(rows)


def _valued(value: float, unit: str) -> str:
    if not np.isfinite(value):
        return "not bounded"
    if unit == "N":
        return f"{theme.number(value / 1e3)} kN"
    if unit == "J":
        return f"{theme.number(value / 1e3)} kJ"
    if unit == "K":
        return f"{value - 273.15:.4g} °C"
    if unit == "s":
        return f"{1e3 * value:.4g} ms"
    return f"{value:.4g}" if unit == "-" else f"{value:.4g} {unit}"


def cost_table(result: Landing) -> Table:
    """Forces, heat, load, slip energy and landings allowed, with the file's limits."""
    rows: tuple[Row, ...] = tuple(
        (place, title, *numbers(value, limit), Cell(_WORDS[mark], mark))
        for place, title, value, limit, mark in cost_rows(result)
    )
    notes = dict.fromkeys(row.note for row in result.rows if row.note)
    return Table(
        "Against the limits of the file",
        ("Place", "Quantity", "Value", "Limit", "Verdict"),
        rows,
        " ".join((*(f"{note}." for note in notes), _COST)),
    )


def drop_section(result: Landing) -> Section:
    """The one drop."""
    rows: list[Row] = []
    turn = 2 * np.pi
    for k, name in enumerate(result.fallen.names):
        figures = result.fall.figures[k]
        touched = f"{1e3 * figures[0]:.4g} ms" if figures[0] >= 0 else "never"
        values = (
            touched,
            theme.join(theme.number(figures[1] / 1e3), "kN"),
            theme.join(theme.number(figures[2] / 1e3), "kN"),
            theme.quantity(figures[5], "m", 4),
            f"{figures[6] / turn:.2f} / {figures[7] / turn:.2f}",
            theme.join(theme.number(result.fall.energy[k], 4), "J"),
            f"{figures[10] * 30 / np.pi:,.0f} rpm",
        )
        rows.append((name, *numbers(*values)))
    columns = (
        "Bearing",
        "First contact",
        "First peak",
        "Largest force",
        "Displacement",
        "Turns against / with spin",
        "Slip energy",
        "Race",
    )
    down = result.down
    stands = f"{down.time:.4g} s" if np.isfinite(down.time) else "no time: nothing slows it"
    note = f"After these {result.duration:.3g} s the rotor stops within {stands} (estimated)."
    if result.recovery is not None:
        at, back = 1e3 * result.recovery.start, result.recovery.time
        found = f"free of contact {1e3 * back:.4g} ms later" if np.isfinite(back) else "not free"
        note += (
            f" Second drop, with power back after {at:.4g} ms: {found}, at most "
            f"{result.recovery.force / 1e3:.3g} kN; not a statement on stability."
        )
    table = Table("As the machine is written down", columns, tuple(rows), note)
    slow = FRAME_TIME * FRAMES / (1e3 * SHOWN)
    pictures = (
        Figure("Slow motion", slow_motion(result), _MOTION.format(slow=slow)),
        Figure("Forces and speeds", history_figure(result), _HISTORY),
    )
    modes = (len(result.fallen.mass_matrix) - 4) // 2
    return Section("One drop", _DROP.format(modes=modes), pictures, (table,), True)


def axial_section(drop: AxialDrop) -> Section:
    """The motion along the axis of one thrust bearing."""
    touched, settled = drop.first_contact, drop.settled
    row: Row = (
        f"{drop.bearing} {drop.side}",
        *numbers(
            "never" if touched is None else f"{1e3 * touched:.4g} ms",
            f"{drop.largest_force / 1e3:.3g} kN",
            f"{drop.bound / 1e3:.3g} kN",
            f"{1e6 * drop.reach:.4g} µm",
            f"{1e6 * drop.gap:.4g} µm",
            "not yet" if settled is None else f"{1e3 * settled:.4g} ms",
        ),
    )
    columns = (
        "Face",
        "First contact",
        "Largest force",
        "Without damping",
        "Displacement",
        "Magnet at",
        "At rest from",
    )
    table = Table("Along the shaft", columns, (row,))
    picture = Figure("On the thrust face", axial_figure(drop), _FACE)
    words = _ALONG.format(thrust=drop.thrust)
    return Section("Landing on the thrust face", words, (picture,), (table,), True)


def campaign_section(result: Landing) -> Section:
    """Many drops."""
    campaign = result.campaign
    assert campaign is not None
    words = _MANY.format(
        count=campaign.count,
        duration=campaign.duration,
        f=FRICTION,
        m=MOUNT,
        s=SPEED,
        seed=campaign.seed,
        wall=campaign.wall,
        workers=campaign.workers,
        share=100 * campaign.whirls.mean(),
        turns=WHIRLS,
    )
    rows: list[Row] = []
    for k, name in enumerate(result.fallen.names):
        for title, values, scale, unit in (
            ("largest force", campaign.force[:, k], 1e3, "kN"),
            ("slip energy", campaign.slip[:, k], 1.0, "J"),
        ):
            found = campaign.quantiles(values)
            cells = numbers(*(f"{value / scale:,.4g} {unit}" for value in found.values()))
            rows.append((name, title, *cells))
    for s, name in enumerate(result.fallen.seal_names):
        found = campaign.quantiles(campaign.seals[:, s])
        cells = numbers(*(f"{value:.3g}" for value in found.values()))
        rows.append((name, "displacement over clearance", *cells))
    columns = ("Place", "Quantity", "5 %", "Median", "95 %", "Largest")
    picture = Figure(
        "Distribution", distribution_figure(campaign, result.fallen.names), _DISTRIBUTION
    )
    table = Table("Over all drops", columns, tuple(rows))
    return Section("Many drops", words, (picture,), (table,), True)


def heads_table() -> Table:
    """The nine heads."""
    rows = tuple(
        (head, here, Cell("not covered" if here == "not covered" else "recalled", "muted"))
        for head, here in HEADS
    )
    return Table("Nine heads", ("Head", "Here", "Basis"), rows)


def damping_table(result: Landing) -> Table:
    """The edge at the machine's friction over the mount's damping."""
    item = result.whip_map
    mu = max(bearing.friction for bearing in result.fallen.bearings)
    f = int(np.argmin(np.abs(np.log(item.friction / mu))))
    k = len(item.stiffness) // 2
    rows = []
    for d, damping in enumerate(item.damping):
        w, force = item.frequency[d, k, f], item.force[d, k, f]
        found = np.isfinite(w) and w > 0
        at = f"{w / (2 * np.pi):.4g} Hz" if found else "no whip" if w == 0 else "up to rolling"
        rows.append(
            (
                Cell(f"{damping / 1e3:.3g} kN s/m", "number"),
                *numbers(at, force_text(force) if found else "-"),
            )
        )
    title = f"Over the mount's damping, at friction {item.friction[f]:.2g}"
    return Table(title, ("Mount damping", "Settles at", "Force"), tuple(rows))
