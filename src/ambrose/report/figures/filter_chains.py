"""A filter bank as it is built: per channel the chain of its sections, above the Bode diagram of
each.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.core.frequency import frequency_response
from ambrose.law.filters import DERIVATIVE_FILTER, chain, section_matrix, section_text
from ambrose.law.pid import channel_chains, channel_names, theta_system
from ambrose.machine.controller import PidSettings, Section
from ambrose.report import theme, units
from ambrose.report.figures.bode import Line, bode_figure, grid_of

_ACROSS = 3  # blocks in a line: what a telephone shows
# height of a block, of a line of blocks and of a channel's name [px]
_BLOCK = 66
_LINE = 82
_HEADING = 26
_ARROW = 0.045  # of the width, between blocks
_FILL = {"gain": "#eef1f3", "pid": "#e3edf5", "notch": "#f7e6dc", "phase-bump": "#e2f1ec"}
_OTHER = "#f3edf4"


def filter_figure(
    settings: PidSettings, axes: tuple[str, ...], sample_time: float | None = None
) -> Any:
    """The chains of a [controller] and their responses, channels that are the same drawn once.
    Returns a plotly Figure.

    sample_time [s]: half of its rate is marked. Raises InvalidInput for settings that describe no
    controller.
    """
    groups: dict[tuple[float, tuple[Section, ...]], list[str]] = {}
    for name, found in zip(
        channel_names(settings, axes), channel_chains(settings, axes), strict=True
    ):
        groups.setdefault(found, []).append(units.axis_name(name))
    systems = {
        ", ".join(names): theta_system(
            chain(gain, [section_matrix(item) for item in sections]), (names[0],)
        )
        for (gain, sections), names in groups.items()
    }
    omega = np.unique(np.concatenate([grid_of(system) for system in systems.values()]))
    lines = [
        Line(name, omega, frequency_response(system, omega).values[:, 0, 0])
        for name, system in systems.items()
    ]
    picture = bode_figure(lines, "A/m", sample_time=sample_time)
    looks = theme.styles(list(systems))
    rows: list[tuple[str, list[tuple[str, list[str], str]]]] = []
    for name, (gain, sections) in zip(systems, groups, strict=True):
        blocks = [("gain", [units.quantity(gain, "A/m")], f"gain {gain / 1e3:.6g} A/mm")]
        rows.append(
            (
                name,
                blocks
                + [
                    (item.kind, _numbers(item), f"{item.kind}: {section_text(item)}")
                    for item in sections
                ],
            )
        )
    _draw(picture, rows, {name: looks[name].colour for name in systems})
    return picture


def _numbers(section: Section) -> list[str]:
    """What stands in a block under the section's kind."""

    def hertz(rate: float | None) -> str:
        return units.quantity(rate or 0.0, "rad/s")

    def damped(rate: float | None, damping: float | None) -> str:
        return f"{hertz(rate)}, {units.number(damping or 0.0)}"

    if section.kind == "pid":
        times = (("i", section.integral_time), ("d", section.derivative_time))
        words = [f"T<sub>{key}</sub> {units.quantity(value, 's')}" for key, value in times if value]
        if section.derivative_time:
            corner = 1 / (
                (section.derivative_filter or DERIVATIVE_FILTER) * section.derivative_time
            )
            words.append(f"× {hertz(corner)}")
        return words
    if section.kind == "notch":
        zeros, poles = (
            damped(section.zero_frequency, section.zero_damping),
            damped(section.pole_frequency, section.pole_damping),
        )
        return [f"○ {zeros}", f"× {poles}"]
    if section.kind == "phase-bump":
        return [
            units.quantity(section.phase or 0.0, "rad"),
            f"at {damped(section.frequency, section.damping)}",
        ]
    if section.kind == "lead-lag":
        return [f"○ {hertz(section.zero_frequency)}", f"× {hertz(section.pole_frequency)}"]
    if section.kind == "low-pass":
        return [f"× {damped(section.frequency, section.damping)}"]
    above, below = section.numerator or (), section.denominator or ()
    if not (np.roots(above).size or np.roots(below).size):
        return [f"times {units.number(float(above[-1] / below[-1]))}"]
    return [f"○ {_roots(above)}", f"× {_roots(below)}"]


def _roots(coefficients: tuple[float, ...]) -> str:
    """Frequency and damping of a pair of roots, or each of two real ones; a dash for none."""
    roots = np.roots(coefficients)
    if len(roots) == 2 and roots[0].imag:
        size = float(abs(roots[0]))
        return f"{units.quantity(size, 'rad/s')}, {units.number(float(-roots[0].real) / size)}"
    return ", ".join(units.quantity(float(-root.real), "rad/s") for root in roots) or "none"


def _draw(
    picture: Any, rows: list[tuple[str, list[tuple[str, list[str], str]]]], colours: dict[str, str]
) -> None:
    """The chains above the axes, in the margin: it grows by their height, and so does the room
    under the page's legend.
    """
    layout = picture.layout
    inside = layout.height - layout.margin.t - layout.margin.b
    height = sum(_HEADING + _LINE * -(-len(blocks) // _ACROSS) for _, blocks in rows) + 10
    room, width = layout.meta["room"], (1 - (_ACROSS - 1) * _ARROW) / _ACROSS
    top = float(height + room - 16)

    def y(pixels: float) -> float:
        return 1 + (top - pixels) / inside

    paper = {"xref": "paper", "yref": "paper"}
    shapes = []
    notes = []
    down = 0.0

    def write(text: str, x: float, pixels: float, size: int, colour: str, **more: Any) -> None:
        words = {"text": text, "font": {"size": size, "color": colour}, "showarrow": False}
        notes.append(
            {
                **paper,
                "x": x,
                "y": y(pixels),
                "xanchor": "center",
                "yanchor": "middle",
                **words,
                **more,
            }
        )

    for name, blocks in rows:
        write(
            f"<b>{theme.plain(name)}</b>",
            0.0,
            down,
            13,
            colours[name],
            xanchor="left",
            yanchor="top",
        )
        down += _HEADING
        for i, (kind, numbers, full) in enumerate(blocks):
            column = i % _ACROSS
            down += _LINE if i and not column else 0.0
            left, middle = column * (width + _ARROW), down + _BLOCK / 2
            box = {
                "x0": left,
                "x1": left + width,
                "y0": y(down),
                "y1": y(down + _BLOCK),
                "fillcolor": _FILL.get(kind, _OTHER),
            }
            shapes.append(
                {**paper, **box, "type": "rect", "line": {"color": theme.MUTED, "width": 1}}
            )
            write(
                "<br>".join([f"<b>{kind}</b>", *numbers]),
                left + width / 2,
                middle,
                11,
                theme.INK,
                hovertext=full,
            )
            if i + 1 < len(blocks) and column + 1 < _ACROSS:
                write("→", left + width + _ARROW / 2, middle, 13, theme.MUTED)
        down += _LINE
    picture.update_layout(
        height=layout.height + height,
        margin={"t": layout.margin.t + height},
        meta={"room": room + height},
        shapes=[*layout.shapes, *shapes],
        annotations=[*layout.annotations, *notes],
    )
