"""The rotor to scale with its stations, and its free-free mode shapes beneath on the same axial
axis; shapes that whirl, in space.

Shaft sections, bores, lamination (mass) diameters and discs are to scale, a disc as the cylinder
that has its mass and inertias. Bearings, sensors, seals and couplings are symbols at their true
axial positions.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.core.checks import check_shape
from ambrose.machine.attachment import attached
from ambrose.machine.machine import Machine
from ambrose.machine.part import Disc
from ambrose.model.effects.rotor import finite_element_rotor, free_modes
from ambrose.report import theme

_PIXELS = 800  # width of the plot area that the height is computed for [px]
_LEAST = (
    760  # page width [px] for which the names are staggered; a narrower page scrolls the figure
)
_LEFT, _RIGHT = 112, 16  # margins [px]
_TALLEST = 380  # [px], of the rotor; a wider one is drawn smaller, its length within more room
_ROW, _GAP = 74, 14  # height of one mode shape, space between two [px]
_STEEL = "#dfe4e8"
_LAMINATION = "#b9c3cb"
_DISC = "#c9d0d6"
_KINDS = {
    "bearing": "#0072b2",
    "sensor": "#1c2329",
    "seal": "#a3341f",
    "disc": "#1c2329",
}
_EFFECT = "#66717b"
_SEES = {"bearing": "square", "sensor": "circle-open", "seal": "diamond"}  # on a mode shape


@dataclass(frozen=True, slots=True)
class Station:
    """A named place on the rotor [mm]: what, where, and how far its symbol reaches from the centre
    line; symbol: of a registered effect.
    """

    kind: str
    name: str
    position: float
    reach: float
    symbol: str = ""


def machine_drawing(machine: Machine, bending_modes: int = 2, *, rigid: bool = True) -> Any:
    """The rotor of a machine with its free-free modes, from its finite elements; rigid: with those
    of the rigid rotor. Returns a plotly Figure.
    """
    rotor = finite_element_rotor(machine)
    modes = free_modes(rotor, bending_modes)
    plane = slice(0 if rigid else 4, None, 2)  # the modes come in x/y pairs; the drawing shows x
    return rotor_drawing(
        machine, rotor.positions, modes.shapes[0::4, plane], modes.frequencies[plane]
    )


def rotor_drawing(
    machine: Machine, node_positions: ArrayLike, shapes: ArrayLike, frequencies: ArrayLike
) -> Any:
    """The rotor with its stations and its mode shapes in one plane.

    machine: the description. node_positions (n,) [m]: the finite-element nodes. shapes (n, k)
    [any]: lateral displacement of the nodes, each mode scaled to its largest. frequencies (k,)
    [rad/s]: 0 for a rigid-body mode. Returns a plotly Figure. Raises InvalidInput.
    """
    nodes = check_shape(node_positions, "node_positions", "(n,)") * 1e3
    modes = check_shape(shapes, "shapes", "(n, k)", n=nodes.size)
    omega = check_shape(frequencies, "frequencies", "(k,)", k=modes.shape[1])
    length = machine.length * 1e3
    cylinders = [size for disc in machine.discs if (size := equivalent_cylinder(disc)) is not None]
    widths = [2 * size[0] for size in cylinders]
    widths += [max(part.diameters(end)) for part in machine.shaft for end in (0, 1)]
    pixel = 1e3 * max(1.08 * machine.length / _PIXELS, max(widths) / _TALLEST)  # [mm]
    figure = theme.subplots(1, 1)
    _shaft(figure, machine)
    for disc in machine.discs:
        if (size := equivalent_cylinder(disc)) is not None:
            half, place = max(size[1] * 500, machine.length * 2.5), disc.position * 1e3
            _patch(figure, place - half, place + half, -size[0] * 1e3, size[0] * 1e3, _DISC)
    stations = _stations(machine, pixel)
    for station in stations:
        _symbol(figure, machine, station, pixel, _room(station, stations, pixel))
    top, bottom = _labels(figure, stations, machine, pixel)
    _centre_line(figure, nodes, length)
    drawn = (top - bottom) / pixel
    total = drawn + modes.shape[1] * (_ROW + _GAP) + _GAP
    theme.dress(figure, round(total), legend=False)
    figure.update_layout(meta={**figure.layout["meta"], "least": _LEAST})
    width = 0.5 * (length - _PIXELS * pixel), 0.5 * (length + _PIXELS * pixel)
    shares = drawn / total, _GAP / total
    _layout(figure, width, (bottom, top), shares, modes.shape[1])
    _shapes(figure, nodes, modes, omega, stations, 1 - (drawn + _GAP) / total)
    return figure


def _shaft(figure: Any, machine: Machine) -> None:
    for section in machine.shaft:
        left, right = section.start * 1e3, (section.start + section.length) * 1e3
        outer, bore, mass = (
            np.array(ends) * 500
            for ends in zip(section.diameters(0), section.diameters(1), strict=True)
        )
        if (mass > outer).any():
            for sign in (1, -1):
                _patch(figure, left, right, sign * outer, sign * mass, _LAMINATION, hatched=True)
        _patch(figure, left, right, -outer, outer, _STEEL)
        if bore.any():
            _patch(figure, left, right, -bore, bore, "white", dash="3px,2px")


def _patch(
    figure: Any,
    left: float,
    right: float,
    low: Any,
    high: Any,
    fill: str,
    *,
    hatched: bool = False,
    dash: str = "solid",
) -> None:
    """From low to high at both ends: a number each, or one for the left and one for the right
    end.
    """
    low, high = np.broadcast_to(low, 2), np.broadcast_to(high, 2)
    pattern = (
        {"shape": "/", "fgcolor": theme.MUTED, "bgcolor": "white", "size": 5, "solidity": 0.25}
        if hatched
        else None
    )
    theme.scatter(
        figure,
        {},
        [left, right, right, left, left],
        [low[0], low[1], high[1], high[0], low[0]],
        fill="toself",
        fillcolor=fill,
        fillpattern=pattern,
        line={"color": theme.INK, "width": 0.9, "dash": dash},
        hoverinfo="skip",
    )


def equivalent_cylinder(disc: Disc) -> tuple[float, float] | None:
    """Radius and width [m] of the solid cylinder with the disc's mass and inertias: I_p = m r^2/2,
    I_d = m (3 r^2 + w^2)/12. None where no inertia is given; width 0 where I_d allows none."""
    if disc.polar_inertia <= 0 or disc.mass <= 0:
        return None
    radius = math.sqrt(2 * disc.polar_inertia / disc.mass)
    return radius, math.sqrt(max(12 * disc.diametral_inertia / disc.mass - 3 * radius**2, 0.0))


def _radius_at(machine: Machine, position: float) -> float:
    """The outermost radius [mm] of the shaft at an axial position [mm]."""
    at = [
        max(*section.diameters(0.0), *section.diameters(1.0)) * 500
        for section in machine.shaft
        if section.start * 1e3 - 1e-6 <= position <= (section.start + section.length) * 1e3 + 1e-6
    ]
    return max(at, default=0.0)


def _surface(machine: Machine, position: float) -> float:
    """The outermost radius [mm] of the rotor at an axial position [mm]: shaft, or disc of known
    size.
    """
    radius = _radius_at(machine, position)
    for disc in machine.discs:
        size = equivalent_cylinder(disc)
        if size is not None and abs(disc.position * 1e3 - position) <= max(
            size[1] * 500, machine.length * 2.5
        ):
            radius = max(radius, size[0] * 1e3)
    return radius


def _stations(machine: Machine, pixel: float) -> list[Station]:
    """All named places, bearings first; the reach of the symbols is chosen on the page, not on the
    machine.
    """
    known = [("bearing", b.name, b.position, 30.0) for b in machine.bearings]
    known += [("sensor", s.bearing, s.position, 17.0) for s in machine.sensors]
    known += [("seal", s.name, s.position, 18.0) for s in machine.seals]
    stations = [
        Station(k, n, p * 1e3, _radius_at(machine, p * 1e3) + 4 * pixel + r * pixel)
        for k, n, p, r in known
    ]
    stations += [
        Station(
            effect.table,
            station.name,
            station.position * 1e3,
            _surface(machine, station.position * 1e3) + (4 + effect.reach) * pixel,
            effect.symbol,
        )
        for effect, part in attached(machine)
        for station in effect.stations(part)
    ]
    for disc in machine.discs:
        size = equivalent_cylinder(disc)
        reach = max(_radius_at(machine, disc.position * 1e3), size[0] * 1e3 if size else 0.0) + (
            0 if size else 10 * pixel
        )
        stations.append(Station("disc", disc.name, disc.position * 1e3, reach))
    return stations


def _room(station: Station, stations: Sequence[Station], pixel: float) -> float:
    """Half the width [mm] that a seal's symbol may have: neighbouring seals stay apart."""
    apart = [
        abs(other.position - station.position)
        for other in stations
        if other.kind == station.kind and other.position != station.position
    ]
    return min([12 * pixel, *(0.42 * distance for distance in apart)])


def _symbol(figure: Any, machine: Machine, station: Station, pixel: float, room: float) -> None:
    """One station's symbol, above and below the shaft; room: half the width of a seal's [mm]."""
    colour = _KINDS.get(station.kind, _EFFECT)
    gap = _radius_at(machine, station.position) + 3 * pixel
    x, reach = station.position, station.reach
    outlines: list[tuple[list[float], list[float]]] = []
    if station.kind == "bearing":  # a horseshoe: two poles and a yoke
        a = 16 * pixel
        b = 6 * pixel
        yoke = reach - 9 * pixel
        sides = [x - a, x - a, x + a, x + a, x + b, x + b, x - b, x - b, x - a]
        outlines = [(sides, [gap, reach, reach, gap, gap, yoke, yoke, gap, gap])]
    elif station.kind == "sensor":  # a probe pointing at the shaft
        a = 5 * pixel
        outlines = [
            ([x, x - a, x - a, x + a, x + a, x], [gap, gap + a, reach, reach, gap + a, gap])
        ]
    elif station.kind == "seal":  # a comb
        teeth = (
            np.array([-12, -12, -10, -10, -4, -4, -1, -1, 1, 1, 4, 4, 10, 10, 12, 12, -12])
            * room
            / 12
        )
        tip, root = gap, gap + 6 * pixel
        levels = [
            reach,
            tip,
            tip,
            root,
            root,
            tip,
            tip,
            root,
            root,
            tip,
            tip,
            root,
            root,
            tip,
            tip,
            reach,
            reach,
        ]
        outlines = [(list(x + teeth), [float(v) for v in levels])]
    elif station.kind not in _KINDS:  # a registered effect: below only
        near = _surface(machine, x) + 3 * pixel
        for xs, ys, width in _effect_symbol(station.symbol, x, near, reach, pixel):
            theme.guide(figure, {}, list(xs), list(ys), color=colour, width=width)
        return
    elif reach > _radius_at(machine, x) + pixel and not _has_size(
        machine, station.name
    ):  # a disc of unknown size
        theme.guide(figure, {}, [x, x], [-reach, reach], color=colour, width=3)
        return
    look: dict[str, Any] = {
        "fill": "toself",
        "fillcolor": colour,
        "line": {"color": colour, "width": 0.8},
        "hoverinfo": "skip",
    }
    for xs, ys in outlines:
        for sign in (1, -1):
            theme.scatter(figure, {}, xs, [sign * y for y in ys], **look)


def _effect_symbol(
    symbol: str, x: float, gap: float, reach: float, pixel: float
) -> list[tuple[Any, Any, float]]:
    """Lines (x, y, width) of a registered effect's symbol below the rotor, from gap to reach [mm];
    a spring to the ground alone carries or restrains the shaft.
    """
    if symbol == "probe":  # the outline of a sensor
        a = 5 * pixel
        sides = [x, x - a, x - a, x + a, x + a, x]
        return [(sides, [-gap, -gap - a, -reach, -reach, -gap - a, -gap], 1.3)]
    if symbol == "clearance":  # the edge of the part that stands still
        a = 7 * pixel
        hatch = [
            ([x + k * pixel, x + (k - 4) * pixel], [-gap - pixel, -gap - 6 * pixel], 0.9)
            for k in (-3, 2, 7)
        ]
        return [([x - a, x + a], [-gap, -gap], 2.5), *hatch]
    if symbol == "load":  # an arrow at the shaft
        a = 4 * pixel
        head = ([x - a, x, x + a], [-gap - 2 * a, -gap, -gap - 2 * a], 1.6)
        return [([x, x], [-gap, -reach], 1.6), head]
    if symbol == "stage":  # a circle that turns: it drives whirl
        turn, radius = np.linspace(-0.35 * np.pi, 1.35 * np.pi, 25), (reach - gap) / 2
        xs, ys = x + radius * np.cos(turn), -gap - radius + radius * np.sin(turn)
        a = 4 * pixel
        head = ([xs[-1] - a, xs[-1], xs[-1] - a], [ys[-1] - a, ys[-1], ys[-1] + a], 1.3)
        return [(xs, ys, 1.3), head]
    if symbol == "mark":
        a = (reach - gap) / 2
        square = [-gap, -gap, -reach, -reach, -gap]
        return [([x - a, x + a, x + a, x - a, x - a], square, 1.3)]
    turns = np.linspace(-gap, -reach, 9)
    side = np.array([0, 0, 5, -5, 5, -5, 5, 0, 0]) * pixel
    return [(x + side, turns, 1.3), ([x - 9 * pixel, x + 9 * pixel], [-reach, -reach], 2.5)]


def _has_size(machine: Machine, name: str) -> bool:
    return any(
        disc.name == name and equivalent_cylinder(disc) is not None for disc in machine.discs
    )


def _labels(
    figure: Any, stations: Sequence[Station], machine: Machine, pixel: float
) -> tuple[float, float]:
    """Names above the rotor (sensors and registered effects below), staggered where they would
    overlap. Returns the y range [mm].
    """
    high = (
        max(
            [s.reach for s in stations]
            + [max(_radius_at(machine, s.start * 1e3 + 1e-3) for s in machine.shaft)]
        )
        + 4 * pixel
    )
    extent = [high, -high]
    for sign in (1, -1):
        taken: list[float] = []  # right end of the text on each level
        on_side = (s for s in stations if (s.kind in {"bearing", "seal", "disc"}) == (sign > 0))
        for station in sorted(on_side, key=lambda s: s.position):
            text = (
                f"{station.kind.replace('_', ' ')} {theme.axis_name(station.name)}"
                if station.name.lower() != station.kind
                else station.kind
            )
            text = text if station.kind != "disc" else theme.axis_name(station.name)
            # a page of the least width has fewer pixels for the same millimetres
            half = (3.2 * len(text) + 7) * pixel * _PIXELS / (_LEAST - _LEFT - _RIGHT)
            # a name at the right end moves in from the page's edge
            edge = 1.04e3 * machine.length + _RIGHT * pixel
            middle = station.position - max(0.0, station.position + half - edge)
            level = next((i for i, end in enumerate(taken) if middle - half > end), len(taken))
            taken[level : level + 1] = [middle + half]
            y = sign * (high + (4 + 16 * level) * pixel)
            colour = _KINDS.get(station.kind, _EFFECT)
            theme.guide(
                figure,
                {},
                [station.position] * 2,
                [sign * station.reach, y],
                color=colour,
                width=0.7,
            )
            figure.add_annotation(
                x=middle,
                y=y,
                text=theme.plain(text),
                showarrow=False,
                yanchor="bottom" if sign > 0 else "top",
                xanchor="center",
                font={"size": 12.5, "color": colour},
                bgcolor="white",  # the lines to names further out pass behind
                borderpad=0,
            )
            extent[0 if sign > 0 else 1] = (
                max(extent[0], y + 18 * pixel) if sign > 0 else min(extent[1], y - 18 * pixel)
            )
    return extent[0], extent[1]


def _centre_line(figure: Any, nodes: np.ndarray, length: float) -> None:
    """The axis of rotation and the finite-element nodes on it."""
    ends = [-0.03 * length, 1.03 * length]
    theme.guide(figure, {}, ends, [0, 0], color=theme.MUTED, width=0.8, dash="12px,3px,2px,3px")
    theme.scatter(
        figure,
        {},
        nodes,
        np.zeros(nodes.size),
        mode="markers",
        marker={"size": 4, "color": theme.INK},
        customdata=np.arange(1, nodes.size + 1),
        hovertemplate="node %{customdata} at %{x:.1f} mm<extra></extra>",
    )


def _layout(
    figure: Any,
    x_range: tuple[float, float],
    y_range: tuple[float, float],
    shares: tuple[float, float],
    rows: int,
) -> None:
    """One axial axis for all rows; the drawing keeps its proportions (equal millimetres in both
    directions).
    """
    figure.update_layout(margin={"l": _LEFT, "r": _RIGHT, "t": 26, "b": 48})
    figure.update_xaxes(
        title_text="Axial position from the left end [mm]",
        range=list(x_range),
        showgrid=False,
        anchor=f"y{rows + 1}" if rows else "y",
        constrain="domain",
    )
    bottom = 1 - shares[0]
    drawing = {"domain": [bottom, 1], "range": list(y_range), "visible": False}
    # Room that the proportions leave over shrinks the drawing's place: ranges would grow at every
    # change of the page's width.
    figure.update_layout(
        yaxis={**drawing, "scaleanchor": "x", "scaleratio": 1, "constrain": "domain"}
    )
    below = bottom - shares[1]
    step = below / max(rows, 1)
    for i in range(rows):
        domain = [below - (i + 1) * step + shares[1], below - i * step]
        axis = {
            "domain": domain,
            "range": [-1.15, 1.15],
            "anchor": "x",
            "visible": False,
            "fixedrange": True,
        }
        figure.update_layout(**{f"yaxis{i + 2}": axis})


def _shapes(
    figure: Any,
    nodes: np.ndarray,
    modes: np.ndarray,
    omega: np.ndarray,
    stations: Sequence[Station],
    high: float,
) -> None:
    """Free-free shapes, one row each, with guides and dots where bearings, sensors and seals see
    them.
    """
    order = np.argsort(nodes)
    sensed = [station for station in stations if station.kind in _SEES]
    for station in sensed if modes.size else []:
        line = {"color": theme.FAINT, "width": 1}
        at = station.position
        figure.add_shape(
            type="line",
            xref="x",
            yref="paper",
            x0=at,
            x1=at,
            y0=0,
            y1=high,
            line=line,
            layer="below",
        )
    counts = {"rigid": 0, "bending": 0}
    for i in range(modes.shape[1]):
        axis = f"y{i + 2}"
        peak = float(np.abs(modes[:, i]).max()) or 1.0
        shape = modes[order, i] / peak * (1.0 if modes[order[0], i] >= 0 else -1.0)
        zero = {"color": theme.MUTED, "width": 0.8}
        theme.scatter(
            figure, {}, nodes[order[[0, -1]]], [0, 0], line=zero, yaxis=axis, hoverinfo="skip"
        )
        theme.scatter(
            figure,
            {},
            nodes[order],
            shape,
            line={"color": theme.INK, "width": 1.8},
            yaxis=axis,
            fill="tozeroy",
            fillcolor="rgba(102,113,123,0.13)",
            hovertemplate="%{x:.0f} mm: %{y:.3f}<extra></extra>",
        )
        for station in sensed:
            deflection = float(np.interp(station.position, nodes[order], shape))
            symbol, colour = _SEES[station.kind], _KINDS[station.kind]
            theme.scatter(
                figure,
                {},
                [station.position],
                [deflection],
                mode="markers",
                yaxis=axis,
                marker={
                    "symbol": symbol,
                    "size": 7,
                    "color": colour,
                    "line": {"width": 1.5, "color": colour},
                },
                hovertemplate=f"{station.kind} {theme.plain(station.name)}: "
                "%{y:.3f}<extra></extra>",
            )
        kind = "rigid" if omega[i] < 1e-6 * float(omega.max(initial=1.0)) else "bending"
        counts[kind] += 1
        text = f"<b>{kind} {counts[kind]}</b>"
        text += f"<br>{theme.quantity(float(omega[i]), 'rad/s')}" if kind == "bending" else ""
        figure.add_annotation(
            x=0,
            xref="paper",
            y=0,
            yref=axis,
            text=text,
            showarrow=False,
            xanchor="right",
            align="right",
            xshift=-8,
            font={"size": 12.5},
        )


# Shapes that whirl, one above the other in space: the bent shaft, its orbits, and a turn of it to
# play.


_TURN = 20  # pictures of one turn
_PLAYED = 15  # turns, until the next press
_EVERY_MS = 70
_RINGS = 15  # orbits along the shaft, but for those of marked places
_POINTS = 61  # of the shaft at most
_APART = 2.9  # rows, in largest deflections
_ROW_HIGH = 125  # [px]
_UNIT = 0.57  # of the height: a unit of the scene's proportions, seen without perspective
_LONG = 640  # [px], of the shaft
_AHEAD, _BACK = "#0072b2", "#d55e00"
_VIEWS = {"oblique": (0.7, -2.0, 0.5), "side": (0.0, -2.0, 0.0), "end": (2.0, 0.0, 0.0)}


@dataclass(frozen=True, slots=True, eq=False)
class Whirl:
    """A shape: motion (s, 2), complex amplitudes in x and y of e^{j w t} at the stations; heading:
    what it is; forward: the sense of its orbits, None for a line.
    """

    motion: np.ndarray
    heading: str
    forward: bool | None = None


def whirl_figure(
    positions: ArrayLike, shapes: Sequence[Whirl], marks: Sequence[tuple[str, str, float]] = ()
) -> Any:
    """Shapes in space, to be played; positions (s,) [m] of the stations; marks: (kind, name,
    position [m]) of bearings and sensors, whose orbits are drawn in their colours. Returns a plotly
    Figure.
    """
    import plotly.graph_objects as go

    x = check_shape(positions, "positions", "(s,)") * 1e3
    rows = []
    for shape in shapes:
        motion = np.asarray(shape.motion)
        turned = motion[:, None] * np.exp(2j * np.pi * np.arange(_TURN) / _TURN)[:, None]
        orbits = np.stack([turned[..., 0].real, turned[..., 1].real], axis=-1)  # (s, t, 2)
        size = float(np.linalg.norm(orbits, axis=-1).max()) or 1.0
        # at first the largest deflection points upwards
        largest = int(np.linalg.norm(orbits, axis=-1).max(axis=1).argmax())
        rows.append(np.roll(orbits, -int(orbits[largest, :, 1].argmax()), axis=1) / size)
    kept = np.unique(np.linspace(0, len(x) - 1, min(_POINTS, len(x))).astype(int))
    rings = kept[np.unique(np.linspace(0, len(kept) - 1, _RINGS).astype(int))]
    low = [-_APART * k for k in range(len(rows))]
    figure = go.Figure()
    ends = x[[0, -1]]

    def line(parts: Sequence[tuple[Any, Any, Any]], **look: Any) -> None:
        figure.add_scatter3d(
            **dict(zip("xyz", _joined(parts), strict=True)), mode="lines", hoverinfo="skip", **look
        )

    line([(ends, [0, 0], [z, z]) for z in low], line={"color": theme.MUTED, "width": 1})
    for colour, forward in ((_AHEAD, True), (_BACK, False), (theme.MUTED, None)):
        parts = [
            _ring(x[k], row[k], z)
            for row, z, shape in zip(rows, low, shapes, strict=True)
            if shape.forward is forward
            for k in rings
        ]
        if parts:
            line(parts, line={"color": colour, "width": 1.5}, opacity=0.6)
    for kind in dict.fromkeys(kind for kind, _, _ in marks):
        places = [int(np.abs(x - 1e3 * at).argmin()) for own, _, at in marks if own == kind]
        parts = [_ring(x[k], row[k], z) for row, z in zip(rows, low, strict=True) for k in places]
        line(parts, line={"color": _KINDS[kind], "width": 5})

    def bent(step: int) -> dict[str, Any]:
        parts = [
            (x[kept], row[kept, step, 0], z + row[kept, step, 1])
            for row, z in zip(rows, low, strict=True)
        ]
        return dict(zip("xyz", _joined(parts), strict=True))

    figure.add_scatter3d(
        **bent(0), mode="lines", line={"color": theme.INK, "width": 7}, hoverinfo="skip"
    )
    moving = len(figure.data) - 1
    words = [(ends[0], z + 1.1, shape.heading) for z, shape in zip(low, shapes, strict=True)]
    named = [(name, at) for kind, name, at in marks if kind == "bearing"]
    words += [(1e3 * at, low[-1] - 1.2, theme.axis_name(name)) for name, at in named]
    figure.add_scatter3d(
        x=[item[0] for item in words],
        y=[0.0] * len(words),
        z=[item[1] for item in words],
        text=[theme.plain(item[2]) for item in words],
        textposition=["top right"] * len(shapes) + ["bottom center"] * len(named),
        textfont={"size": 13, "color": theme.INK},
        mode="text",
        hoverinfo="skip",
    )
    figure.frames = [
        go.Frame(name=f"{k}", data=[{"type": "scatter3d", **bent(k)}], traces=[moving])
        for k in range(_TURN)
    ]
    height = _ROW_HIGH * len(rows) + 70
    theme.dress(figure, height, legend=False)
    high = _APART * (len(rows) - 1) + 3.8
    tall = 1.07 / _UNIT
    unit = tall / high  # of the scene, per largest deflection
    hidden = {"visible": False}
    figure.update_layout(
        meta={"room": 24, "least": _LEAST},
        margin={"l": 0, "r": 0, "t": 40, "b": 0},
        updatemenus=[_buttons(figure.frames), _views()],
        scene={
            "aspectmode": "manual",
            "aspectratio": {"x": _LONG / (_UNIT * height), "y": 2.2 * unit, "z": tall},
            "camera": _camera("oblique"),
            "dragmode": False,
            "xaxis": hidden,
            "yaxis": {**hidden, "range": [-1.1, 1.1]},
            "zaxis": {**hidden, "range": [low[-1] - 1.9, 1.9]},
        },
    )
    return figure


def _ring(x: float, orbit: np.ndarray, z: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    closed = np.vstack([orbit, orbit[:1]])
    return np.full(len(closed), x), closed[:, 0], z + closed[:, 1]


def _joined(parts: Sequence[tuple[Any, Any, Any]]) -> list[np.ndarray]:
    """Lines as one, with gaps between them."""
    gap = [np.nan]
    return [
        np.concatenate([piece for part in parts for piece in (part[k], gap)]).astype(np.float32)
        for k in range(3)
    ]


def _camera(view: str) -> dict[str, Any]:
    eye = dict(zip("xyz", _VIEWS[view], strict=True))
    return {"projection": {"type": "orthographic"}, "eye": eye, "center": {"x": 0, "y": 0, "z": 0}}


def _menu(buttons: list[dict[str, Any]], x: float, anchor: str) -> dict[str, Any]:
    place = {"x": x, "xanchor": anchor, "y": 1.0, "yanchor": "bottom", "pad": {"b": 4}}
    font = {"size": 13, "color": theme.INK}
    look = {"bgcolor": "white", "bordercolor": theme.MUTED, "font": font}
    return {
        "type": "buttons",
        "direction": "left",
        "showactive": False,
        "buttons": buttons,
        **place,
        **look,
    }


def _buttons(frames: Sequence[Any]) -> dict[str, Any]:
    """Play some turns, and pause."""
    pace = {"frame": {"duration": _EVERY_MS, "redraw": True}, "transition": {"duration": 0}}
    names = [frame.name for frame in frames] * _PLAYED
    stop = {"frame": {"duration": 0, "redraw": True}, "mode": "immediate"}
    return _menu(
        [
            {"label": "play", "method": "animate", "args": [names, {**pace, "mode": "immediate"}]},
            {"label": "pause", "method": "animate", "args": [[None], stop]},
        ],
        0.0,
        "left",
    )


def _views() -> dict[str, Any]:
    """The places from which the shapes are seen."""
    return _menu(
        [
            {"label": name, "method": "relayout", "args": [{"scene.camera": _camera(name)}]}
            for name in _VIEWS
        ],
        1.0,
        "right",
    )
