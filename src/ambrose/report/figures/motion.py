"""The rotor's motion in pictures: where a record knows it, the orbits, the spectrum of the whirl
over time, the rotor's axis moving.

Waterfall: x + i y turns forward at positive and backward at negative frequencies (Bently & Hatch,
Fundamentals of Rotating Machinery Diagnostics, 2002, ch. 8): a circular forward orbit of radius r
is r at +f and nothing at -f.

Animation: along the page runs the shaft; at every station x points towards the reader and y
upwards, both magnified alike. One frame is the axis and its dots, a few numbers; the page's drawing
library plays them.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.machine import Machine
from ambrose.model.plant import Port, measured_ports, ports
from ambrose.record.record import Record
from ambrose.report import theme
from ambrose.report.figures.curves import drawn
from ambrose.rig.scenario import Scenario

# Play, pause and a slider of time below an animated figure.


def add_controls(
    figure: Any,
    names: Sequence[str],
    labels: Sequence[str],
    frame_time: float,
    *,
    rounds: int = 1,
    below: float,
    left: float,
    margin: float,
    growth: float,
    active: int = 0,
) -> None:
    """Buttons and slider for the frames ``names`` of a figure, with their ``labels`` on the slider.

    frame_time [ms]; rounds: how often a click plays all frames. below [px]: from the plot to the
    buttons; left: share of the width before the slider. margin, growth [px]: below the plot, and
    what the figure grows by. active: place of the frame that is shown at first.
    """
    still = {"transition": {"duration": 0}, "mode": "immediate"}
    move = {"frame": {"duration": frame_time, "redraw": False}, **still}
    stop = {"frame": {"duration": 0, "redraw": False}, **still}
    buttons = [
        {"label": "▶ play", "method": "animate", "args": [list(names) * rounds, move]},
        {"label": "❚❚ pause", "method": "animate", "args": [[None], stop]},
    ]
    steps = [
        {"label": label, "method": "animate", "args": [[name], stop]}
        for name, label in zip(names, labels, strict=True)
    ]
    menu = {
        "type": "buttons",
        "direction": "left",
        "buttons": buttons,
        "showactive": False,
        "pad": {"t": below},
        "x": 0,
        "y": 0,
        "xanchor": "left",
        "yanchor": "top",
        "bgcolor": "white",
        "bordercolor": theme.MUTED,
        "font": {"size": 12},
    }
    bar = {
        "x": left,
        "len": 1 - left,
        "y": 0,
        "yanchor": "top",
        "pad": {"t": below - 10, "b": 0},
        "ticklen": 0,
        "minorticklen": 0,
        "currentvalue": {
            "prefix": "t = ",
            "font": {"size": 12, "color": theme.INK},
            "xanchor": "right",  # clear of the buttons, on a phone too
        },
        "tickcolor": "white",
        "font": {"size": 11, "color": "rgba(0, 0, 0, 0)"},
        "active": active,
        "steps": steps,
    }
    figure.update_layout(
        updatemenus=[menu],
        sliders=[bar],
        margin={"b": margin},
        height=figure.layout.height + growth,
    )


_FEWEST = 32  # samples in a window
_PERIODS = 3.0
NEAR = 2.2  # a touchdown circle up to this many times the largest orbit is drawn


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """name of the bearing, seal, disc or coupling; position [m] along the rotor; x, y (k,) [m];
    angle [rad] of its own axes.

    gap [m]: radius of the touchdown bearing there. at_sensor: measured at the bearing's sensor, not
    in the bearing.
    """

    name: str
    position: float
    x: np.ndarray
    y: np.ndarray
    angle: float = 0.0
    gap: float | None = None
    bearing: bool = False
    at_sensor: bool = False

    @property
    def title(self) -> str:
        """The name as it stands above a picture: "bearing A", "sensor B", a disc's own; for
        plotly.
        """
        where = "sensor" if self.at_sensor else "bearing" if self.bearing else ""
        return theme.plain(" ".join(filter(None, (where, theme.axis_name(self.name)))))

    @property
    def radius(self) -> np.ndarray:
        """Distance from the centre (k,) [m]."""
        return np.hypot(self.x, self.y)


def stations(record: Record, machine: Machine) -> tuple[Station, ...]:
    """The stations whose two directions the record holds, bearings first: rotor displacements q_,
    else the sensors' y_. Of the axis along the shaft, its two sides.

    Raises InvalidInput where the record has neither.
    """
    if not machine.lateral:
        return _sides(record, machine)
    gaps = {bearing.name: bearing.touchdown_gap for bearing in machine.bearings}
    places = [(pair, "q", False) for pair in _pairs(ports(machine))]
    if not any(
        f"q_{port.name}" in record.signals for (port, _), _, _ in places if _name(port) in gaps
    ):
        places = [(pair, "y", True) for pair in _pairs(measured_ports(machine))] + places
    result = []
    for (first, second), kind, sensor in places:
        names = (f"{kind}_{first.name}", f"{kind}_{second.name}")
        if not all(name in record.signals for name in names):
            continue
        u, v = record[names[0]], record[names[1]]
        c, s = np.cos(first.direction), np.sin(first.direction)
        name = _name(first)
        result.append(
            Station(
                name,
                first.position,
                c * u - s * v,
                s * u + c * v,
                first.direction,
                gaps.get(name),
                name in gaps,
                sensor,
            )
        )
    if not result:
        wanted = f"y_{machine.axes[0]} and y_{machine.axes[1]}"
        raise InvalidInput(
            f"the record of {record.machine} has no displacements in two directions; it needs "
            f"{wanted}"
        )
    return tuple(result)


def _sides(record: Record, machine: Machine) -> tuple[Station, ...]:
    """How far the collar is to the left of its middle, and to the right: each has its own stop."""
    part, (axis,) = machine.thrust, machine.axes
    name = next((f"{kind}_{axis}" for kind in "qy" if f"{kind}_{axis}" in record.signals), None)
    if name is None:
        raise InvalidInput(
            f"the record of {record.machine} has no displacement along the shaft; it needs y_{axis}"
        )
    z, stops = record[name], part.touchdown_gap or (None, None)
    nothing, sensor = np.zeros(len(z)), name.startswith("y")
    ways = zip(("left", "right"), (-z, z), stops, strict=True)
    return tuple(
        Station(
            f"{part.name} to the {side}",
            part.position,
            np.maximum(way, 0.0),
            nothing,
            gap=stop,
            bearing=True,
            at_sensor=sensor,
        )
        for side, way, stop in ways
    )


def rotor_speed(record: Record, scenario: Scenario | None = None) -> np.ndarray:
    """Rotor speed at every sample (k,) [rad/s]: from a signal "speed...", else the scenario, else
    the operating point.
    """
    names = [name for name in record.signals if name.partition("_")[0] == "speed"]
    if names:
        return record[names[0]]
    if scenario is not None and scenario.speed is not None:
        return np.array([scenario.speed_at(t) for t in record.time])
    return np.full(record.values.shape[1], record.point.speed)


def window(record: Record, places: tuple[Station, ...], speed: np.ndarray, centre: int) -> slice:
    """The samples of three revolutions (at standstill: of three periods of the strongest motion)
    around a sample.
    """
    k = len(speed)
    frequency = abs(float(speed[centre])) / (2 * np.pi)
    if frequency <= 0:
        frequency = _strongest(record, places, centre)
    length = int(
        np.clip(_PERIODS * record.sample_rate_hz / max(frequency, 1e-9), min(_FEWEST, k), k)
    )
    start = int(np.clip(centre - length // 2, 0, k - length))
    return slice(start, start + length)


def largest(places: tuple[Station, ...]) -> tuple[Station, int]:
    """The station and the sample of the largest displacement in a bearing (anywhere, where no
    bearing is known).
    """
    known = [station for station in places if station.bearing] or list(places)
    station = max(known, key=lambda item: float(item.radius.max()))
    return station, int(station.radius.argmax())


def _strongest(record: Record, places: tuple[Station, ...], centre: int) -> float:
    """Frequency [Hz] of the strongest motion around a sample."""
    station = largest(places)[0]
    half = min(2048, len(station.x) // 2)
    if half < _FEWEST // 2:
        return 0.0
    start = int(np.clip(centre - half, 0, len(station.x) - 2 * half))
    z = (station.x + 1j * station.y)[start : start + 2 * half]
    size = np.abs(np.fft.fft((z - z.mean()) * np.hanning(2 * half)))
    frequencies = np.abs(np.fft.fftfreq(2 * half, record.dt))
    size[frequencies < 2 * record.sample_rate_hz / (2 * half)] = 0.0  # drift is no vibration
    return float(frequencies[size.argmax()])


def _pairs(flat: tuple[Port, ...]) -> list[tuple[Port, Port]]:
    return list(zip(flat[0::2], flat[1::2], strict=True))


def _name(port: Port) -> str:
    return port.name.rpartition("_")[0]


_CLOUD, _LINE = 2500, 900  # points
_SECTORS = 72  # directions whose farthest point is kept
_MOST, _PER_ROW = 8, 4
_SIDE, _GAP = 225, 58  # [px]
_ALL = "#c3ccd4"
_PEAK = "#d55e00"
_END = "#0072b2"


def orbit_figure(record: Record, places: Sequence[Station], speed: np.ndarray) -> Any:
    """One panel per station, all to one scale: all samples as a pale cloud, the largest motion, the
    end of the record.

    places: from stations.stations. speed (k,) [rad/s]. Returns a plotly Figure.
    """
    stations = tuple(places)[:_MOST]
    columns = len(stations) if len(stations) in {3, 5} else min(_PER_ROW, max(len(stations), 3))
    rows = math.ceil(len(stations) / columns)
    reach = 1.08 * max(float(station.radius.max()) for station in stations) or 1e-6
    gaps = [station.gap for station in stations if station.gap is not None]
    if gaps and min(gaps) <= NEAR * reach:
        reach = max(reach, 1.08 * min(gaps))
    factor, unit = theme.scale("m", reach)
    total = rows * _SIDE + (rows - 1) * _GAP
    figure = theme.subplots(
        rows=rows,
        cols=columns,
        horizontal_spacing=0.05,
        vertical_spacing=_GAP / total if rows > 1 else 0.0,
    )
    centre = largest(stations)[1]
    peak, last = (
        window(record, stations, speed, centre),
        window(record, stations, speed, len(speed) - 1),
    )
    spans = [(_span(record, "largest", peak), _PEAK, peak)]
    if last.start > (peak.start + peak.stop) / 2:
        spans.append((_span(record, "end", last), _END, last))
    for i, station in enumerate(stations):
        place = {"row": i // columns + 1, "col": i % columns + 1}
        _panel(figure, station, place, spans, factor, unit, reach, first=i == 0)
    theme.dress(figure, total, legend=True, lines=1)  # of two lines is a panel's title
    figure.update_layout(legend={"itemsizing": "constant"})
    bound = reach * factor
    figure.update_xaxes(range=[-bound, bound], constrain="domain", nticks=5)
    figure.update_yaxes(range=[-bound, bound], constrain="domain", nticks=5)
    for i in range(len(stations)):
        x = figure.get_subplot(i // columns + 1, i % columns + 1).xaxis.plotly_name.replace(
            "axis", ""
        )
        figure.update_yaxes(scaleanchor=x, row=i // columns + 1, col=i % columns + 1)
    return figure


def _span(record: Record, word: str, part: slice) -> str:
    time = record.time[part]
    factor, unit = theme.seconds_or_milliseconds(float(record.time[-1] - record.time[0]))
    return (
        f"{word}: {theme.number(time[0] * factor, 4)} to {theme.number(time[-1] * factor, 4)} "
        f"{unit}"
    )


def _panel(
    figure: Any,
    station: Station,
    place: dict[str, int],
    spans: Sequence[tuple[str, str, slice]],
    factor: float,
    unit: str,
    reach: float,
    *,
    first: bool,
) -> None:
    def add(x: np.ndarray, y: np.ndarray, name: str, **look: Any) -> None:
        hover = f"x %{{x:.4g}} · y %{{y:.4g}} {unit}<extra>{name}</extra>"
        theme.scatter(
            figure, place, drawn(x), drawn(y), name, shown=first, hovertemplate=hover, **look
        )

    if station.bearing:
        _own_axes(figure, station, place, reach * factor)
    kept = _cloud(station)
    add(
        station.x[kept] * factor,
        station.y[kept] * factor,
        "all",
        mode="markers",
        marker={"size": 2.5, "color": _ALL},
    )
    for name, colour, part in spans:
        step = max(1, (part.stop - part.start) // _LINE)
        x, y = (row[part][::step] * factor for row in (station.x, station.y))
        add(x, y, name, line={"color": colour, "width": 1.6})
    words = f"{theme.number(float(station.radius.max()) * factor)} {unit}"
    if station.gap is not None:
        if station.gap <= reach:
            turn = np.linspace(0, 2 * np.pi, 181)
            line = {"color": theme.LIMIT, "width": 1.4, "dash": "1.5px,2px"}
            circle = station.gap * factor * np.array([np.cos(turn), np.sin(turn)])
            add(circle[0], circle[1], "touchdown circle", line=line)
        share = float(station.radius.max()) / station.gap
        words += f" · {percent(share)} of gap"
    theme.heading(figure, place, f"<b>{station.title}</b> [{unit}]<br>{words}", 12, align="left")


def percent(share: float) -> str:
    """A share as text, with a decimal where it is small."""
    return f"{share:.0%}" if share >= 0.1 else f"{share:.1%}"


def _own_axes(figure: Any, station: Station, place: dict[str, int], bound: float) -> None:
    """The actuator axes as faint lines through the centre, named at their ends."""
    for i, name in enumerate("ζη"):
        angle = station.angle + i * np.pi / 2
        end = (
            np.array([np.cos(angle), np.sin(angle)])
            * bound
            / max(abs(np.cos(angle)), abs(np.sin(angle)))
        )
        theme.guide(
            figure, place, [-end[0], end[0]], [-end[1], end[1]], color=theme.FAINT, width=1.2
        )
        figure.add_annotation(
            x=0.9 * end[0],
            y=0.9 * end[1],
            text=name,
            showarrow=False,
            font={"size": 12, "color": theme.MUTED},
            xshift=(-9, 9)[i] * np.sin(angle),
            yshift=(9, -9)[i] * np.cos(angle),
            **place,
        )


def _cloud(station: Station) -> np.ndarray:
    """Numbers of the samples drawn as a cloud: spread over the record, and the farthest in every
    direction.
    """
    k = len(station.x)
    if k <= _CLOUD:
        return np.arange(k)
    spread = np.unique(
        (np.arange(_CLOUD) + np.modf(np.arange(_CLOUD) * 0.6180339887)[0]) * k / _CLOUD
    ).astype(int)
    sector = ((np.arctan2(station.y, station.x) / (2 * np.pi) + 0.5) * _SECTORS).astype(
        int
    ) % _SECTORS
    order = np.lexsort((station.radius, sector))
    far = order[np.flatnonzero(np.diff(sector[order], append=-1))]
    return np.unique(np.concatenate([np.clip(spread, 0, k - 1), far]))


_COLUMNS, _ROWS = 240, 260  # of one picture
_DECADES = 3.0  # below the largest amplitude
_SHORTEST, _LONGEST = 32, 8192  # samples in a window
_SPECTRUM_HEIGHT, _SPECTRA_GAP = 250, 46  # [px]
_RESONANCE = 1.6  # windows per square root of the sweep rate
_COLOURS = (
    (0.0, "#ffffff"),
    (0.3, "#dbe9f4"),
    (0.55, "#86b8da"),
    (0.8, "#1f6fae"),
    (1.0, "#1c1233"),
)


def waterfall_figure(record: Record, places: Sequence[Station], speed: np.ndarray) -> Any:
    """Amplitude [m] over time and frequency at the bearings (else at the first two stations); speed
    (k,) [rad/s].

    Returns a plotly Figure; None where the record is too short for a spectrum.
    """
    import plotly.graph_objects as go

    stations = [station for station in places if station.bearing][:2] or list(places)[:2]
    turns = speed / (2 * np.pi)
    length = _window(record, turns)
    if len(speed) < 2 * _SHORTEST or length < _SHORTEST:
        return None
    spectra = [spectrum(station, record.sample_rate_hz, length) for station in stations]
    frequency, middle, _ = spectra[0]
    sizes = [size for _, _, size in spectra]
    top = max(float(size.max()) for size in sizes)
    if top <= 0:
        return None
    reach = _reach(frequency, sizes, top, float(np.abs(turns).max()))
    factor, unit = theme.scale("m", top)
    kept = np.flatnonzero(np.abs(frequency) <= reach)
    pool = max(1, int(np.ceil(len(kept) / _ROWS)))
    kept = kept[: len(kept) // pool * pool]
    rows = frequency[kept].reshape(-1, pool).mean(axis=1)
    time = record.start_time + middle / record.sample_rate_hz
    seconds, second = theme.seconds_or_milliseconds(float(record.time[-1] - record.time[0]))
    total = _SPECTRUM_HEIGHT * len(stations) + _SPECTRA_GAP * (len(stations) - 1)
    figure = theme.subplots(
        rows=len(stations), cols=1, shared_xaxes=True, vertical_spacing=_SPECTRA_GAP / total
    )
    for i, (station, size) in enumerate(zip(stations, sizes, strict=True)):
        place = {"row": i + 1, "col": 1}
        level = size[kept].reshape(-1, pool, size.shape[1]).max(axis=1) * factor
        level = np.log10(np.maximum(level, top * factor * 10 ** (-_DECADES - 1)))
        hover = f"%{{x:.4g}} {second} · %{{y:.4g}} Hz · %{{customdata:.3g}} {unit}<extra></extra>"
        figure.add_trace(
            go.Heatmap(
                x=drawn(time * seconds),
                y=drawn(rows),
                z=drawn(level),
                customdata=drawn(10**level),
                coloraxis="coloraxis",
                hovertemplate=hover,
            ),
            **place,
        )
        _speed_lines(figure, place, record, turns, reach, seconds)
        theme.heading(figure, place, f"<b>{station.title}</b> [Hz]")
    theme.dress(figure, total, legend=False)
    high = np.log10(top * factor)
    ticks = np.arange(np.ceil(high - _DECADES), np.floor(high) + 1)
    figure.update_layout(
        margin={"r": 110},
        coloraxis={
            "colorscale": [list(pair) for pair in _COLOURS],
            "cmin": high - _DECADES,
            "cmax": high,
            "colorbar": {
                "title": {"text": f"radius [{unit}]", "side": "right"},
                "tickvals": ticks.tolist(),
                "ticktext": [theme.number(10.0**t) for t in ticks],
                "thickness": 14,
                "outlinewidth": 0,
                "x": 1.03,
                "len": 0.95,
            },
        },
    )
    figure.update_yaxes(range=[-reach, reach], showgrid=False)
    figure.update_xaxes(
        showgrid=False, range=[float(record.time[0]) * seconds, float(record.time[-1]) * seconds]
    )
    _time_axis(figure, record, turns, seconds, second, len(stations))
    return figure


def spectrum(
    station: Station, rate: float, length: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frequencies (m,) [Hz] from negative to positive, middles of the windows (n,) [samples],
    amplitudes (m, n) [m].

    Hann windows, padded four times: an amplitude between two frequencies of the grid is 1 % low at
    most.
    """
    k = len(station.x)
    starts = np.unique(np.linspace(0, k - length, min(_COLUMNS, k - length + 1)).astype(int))
    weight, ramp = np.hanning(length), np.linspace(-1.0, 1.0, length)
    n = 2 ** int(np.ceil(np.log2(4 * length)))
    sizes = np.empty((n, len(starts)), dtype=np.float32)
    for j, start in enumerate(starts):
        z = station.x[start : start + length] + 1j * station.y[start : start + length]
        z = (
            z
            - (weight @ z) / weight.sum()
            - ramp * ((weight * ramp) @ z) / ((weight * ramp) @ ramp)
        )  # static and drifting part
        sizes[:, j] = np.abs(np.fft.fftshift(np.fft.fft(z * weight, n))) / weight.sum()
    return np.fft.fftshift(np.fft.fftfreq(n, 1 / rate)), starts + length / 2, sizes


def _window(record: Record, turns: np.ndarray) -> int:
    """Samples in a window: what a sweep resolves best (its rate [Hz/s] to -1/2), or an eighth of
    the record.
    """
    k = len(turns)
    duration = k / record.sample_rate_hz
    sweep = float(np.ptp(turns)) / duration
    seconds = min(_RESONANCE / np.sqrt(sweep), duration / 6) if sweep > 0 else duration / 8
    return int(
        np.clip(seconds * record.sample_rate_hz, min(_SHORTEST, k // 2), min(_LONGEST, k // 2))
    )


def _reach(frequency: np.ndarray, sizes: Sequence[np.ndarray], top: float, fastest: float) -> float:
    """The highest frequency [Hz] worth showing: twice the speed, and all that is within the visible
    decades.
    """
    visible = np.max([size.max(axis=1) for size in sizes], axis=0) > top * 10 ** (0.5 - _DECADES)
    highest = float(np.abs(frequency[visible]).max())
    return min(float(frequency.max()), 1.15 * max(highest, 2.05 * fastest, 20.0))


def _speed_lines(
    figure: Any,
    place: dict[str, int],
    record: Record,
    turns: np.ndarray,
    reach: float,
    seconds: float,
) -> None:
    """1x and 2x the speed, forward, and 1x backward."""
    if not np.any(turns):
        return
    at = np.unique(np.linspace(0, len(turns) - 1, 200).astype(int))
    for order, dash in ((1, "7px,4px"), (2, "2px,3px"), (-1, "7px,4px")):
        y = np.where(np.abs(order * turns[at]) <= reach, order * turns[at], np.nan)
        theme.guide(
            figure,
            place,
            drawn(record.time[at] * seconds),
            drawn(y),
            color="#d55e00",
            width=1.1,
            dash=dash,
        )
        end = int(np.flatnonzero(np.isfinite(y))[-1])
        figure.add_annotation(
            x=float(record.time[at[end]] * seconds),
            y=float(y[end]),
            text=f"{order}×".replace("-", "−"),
            showarrow=False,
            xanchor="left" if end == len(at) - 1 else "right",
            yanchor="middle" if end == len(at) - 1 else "top",
            xshift=3,
            font={"size": 12, "color": "#d55e00"},
            **place,
        )


def _time_axis(
    figure: Any, record: Record, turns: np.ndarray, seconds: float, second: str, rows: int
) -> None:
    """Times below the lowest picture; with a speed that changes, the speed beneath each."""
    if np.ptp(turns) == 0:
        figure.update_xaxes(title_text=f"Time [{second}]", row=rows, col=1)
        return
    low, high = float(record.time[0]), float(record.time[-1])
    step = 10 ** np.floor(np.log10((high - low) / 4))
    step *= next(m for m in (5, 2, 1) if (high - low) / (m * step) >= 4)
    ticks = np.arange(np.ceil(low / step) * step, high + step / 100, step)
    rpm = np.interp(ticks, record.time, turns * 60)
    texts = [
        f"{theme.number(t * seconds)}<br>{theme.number(r)}" for t, r in zip(ticks, rpm, strict=True)
    ]
    figure.update_xaxes(
        title_text=f"Time [{second}] and, beneath, rotational speed [rpm]",
        tickvals=(ticks * seconds).tolist(),
        ticktext=texts,
        row=rows,
        col=1,
    )
    figure.update_layout(height=figure.layout.height + 16, margin={"b": 64})


_FRAMES, _ROUNDS = 72, 12  # pictures of the window, and how often they are played
_FRAME_TIME = 45  # [ms]
_SIZE = 0.10  # largest displacement on the page, in rotor lengths
_OBLIQUE = np.array([-0.42, -0.30])  # where x points on the page
_STAGE_HEIGHT = 300  # [px]


def rotor_animation(
    record: Record, places: Sequence[Station], machine: Machine, speed: np.ndarray
) -> Any:
    """A plotly Figure with frames, and the buttons that play them; speed (k,) [rad/s]. places: from
    stations.stations.
    """
    import plotly.graph_objects as go

    ordered = sorted(places, key=lambda station: station.position)
    centre = largest(tuple(places))[1]
    part = window(record, tuple(places), speed, centre)
    magnified = (
        _SIZE
        * machine.length
        / max(1e-9, *(float(station.radius[part].max()) for station in ordered))
    )
    moments = np.unique(np.linspace(part.start, part.stop - 1, _FRAMES).astype(int))
    paths = [_seen(station, part, magnified) for station in ordered]
    # (stations, 2, frames)
    axis = np.array([_seen(station, moments, magnified) for station in ordered])

    figure = go.Figure()
    _still(figure, ordered, paths, machine, magnified)
    names = [f"{i}" for i in range(len(moments))]
    moving = len(figure.data)
    line = {"color": theme.INK, "width": 2.5}
    marker = {
        "size": 9,
        "color": [_colour(s) for s in ordered],
        "line": {"color": "white", "width": 1},
    }
    theme.scatter(
        figure,
        {},
        drawn(axis[:, 0, 0]),
        drawn(axis[:, 1, 0]),
        mode="lines+markers",
        line=line,
        marker=marker,
        hoverinfo="skip",
    )
    figure.frames = [
        go.Frame(
            name=names[j],
            traces=[moving],
            data=[go.Scatter(x=drawn(axis[:, 0, j]), y=drawn(axis[:, 1, j]))],
        )
        for j in range(len(moments))
    ]
    theme.dress(figure, _STAGE_HEIGHT, legend=False)
    # room around the orbits, for the touchdown circles and the names below
    reach = 1.25 * _SIZE * machine.length
    figure.update_xaxes(
        visible=False,
        range=[
            -1.6 * reach * abs(_OBLIQUE[0]) - 0.03 * machine.length,
            machine.length * 1.03 + reach * 0.6,
        ],
    )
    figure.update_yaxes(visible=False, range=[-1.7 * reach, 1.55 * reach], scaleanchor="x")
    add_controls(
        figure,
        names,
        [f"{record.time[m] * 1e3:.2f} ms" for m in moments],
        _FRAME_TIME,
        rounds=_ROUNDS,
        below=14,
        left=0.2,
        margin=84,
        growth=36,
    )
    words = f"displacements magnified {theme.number(magnified, 2)} times against the shaft"
    theme.note(figure, {}, words, 0, 1, "left", "bottom", xref="paper", yref="paper")
    return figure


def _seen(station: Station, part: Any, magnified: float) -> np.ndarray:
    """Positions on the page (2, n) [m]."""
    x, y = station.x[part] * magnified, station.y[part] * magnified
    return np.array([station.position + _OBLIQUE[0] * x, _OBLIQUE[1] * x + y])


def _colour(station: Station) -> str:
    return "#0072b2" if station.bearing else theme.MUTED


def _still(
    figure: Any,
    ordered: Sequence[Station],
    paths: Sequence[np.ndarray],
    machine: Machine,
    magnified: float,
) -> None:
    """What does not move: the centre line, the orbits, the touchdown circles, the names."""
    theme.guide(
        figure,
        {},
        drawn([0, machine.length]),
        drawn([0, 0]),
        color=theme.MUTED,
        width=1,
        dash="12px,3px,3px,3px",
    )
    turn = np.linspace(0, 2 * np.pi, 121)
    for station, path in zip(ordered, paths, strict=True):
        step = max(1, path.shape[1] // 400)
        theme.guide(
            figure,
            {},
            drawn(path[0, ::step]),
            drawn(path[1, ::step]),
            color=_colour(station),
            width=1.1,
        )
        if station.gap is not None and station.gap * magnified <= NEAR * _SIZE * machine.length:
            x, y = station.gap * magnified * np.cos(turn), station.gap * magnified * np.sin(turn)
            circle = drawn([station.position + _OBLIQUE[0] * x, _OBLIQUE[1] * x + y])
            theme.guide(figure, {}, *circle, color=theme.LIMIT, width=1.2, dash="1.5px,2px")
        name, below = (
            theme.plain(theme.axis_name(station.name)),
            -1.42 * 1.25 * _SIZE * machine.length,
        )
        theme.note(figure, {}, name, station.position, below, "auto", "top", colour=theme.INK)
