"""The page of a controller over its whole range: poles over speed and pressure, Campbell, pulse and
unbalance families.

write(exploration_page(explore(machine, controller)), "map.html")
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ambrose.judge.exploration import Exploration
from ambrose.judge.family.poles import PoleMap
from ambrose.judge.family.responses import BoxUnbalance, PulseFamily
from ambrose.judge.stability import Stability, describe
from ambrose.law.timing import DEFAULT, STATE_RATE
from ambrose.report import tables, theme, units
from ambrose.report.figures.axes import drawn
from ambrose.report.figures.curves import figure
from ambrose.report.page import Figure, Page, Row, Section, Table, Verdict, numbers

_POLES = (
    "Left: poles of the closed loop, coloured by the value (circles); right of the line at zero "
    "the loop is unstable. Right: "
    "the largest real part of all poles over the value; where it passes zero, stability ends "
    "(dashed, by bisection)."
)
_CAMPBELL = (
    "Damped natural frequencies of the closed loop over speed, every mode followed by its shape, "
    "and their damping."
)
_PULSES = (
    "Every member of the tolerances (nominal, corners, samples) after 100 N for 2 ms at {port}. "
    "Pale: what the stable "
    "ones fill; dark: nominal; dashed: the stable member that swings longest."
)
_UNBALANCE = (
    "Largest orbit at a bearing over speed, for the worst distribution of the residual unbalance: "
    "nominal, and the worst found "
    "over the tolerances. That is a search; the upper bound, where it was asked for, is proved at "
    "these speeds."
)
_SCALE = ((0.0, "#56b4e9"), (0.5, "#009e73"), (1.0, "#d55e00"))
_BAND, _HEIGHT = "rgba(130,89,174,0.25)", 190


def exploration_page(exploration: Exploration, *, date: str = "") -> Page:
    """The page of an exploration; date: ISO (today if empty)."""
    sections = []
    for item in exploration.maps:
        title = f"Poles over {item.over}"
        sections.append(
            Section(
                title, "", (Figure(title, pole_picture(item), _POLES),), (_ends(item),), folded=True
            )
        )
    if exploration.campbell:
        pictures = [
            Figure(curve.title, figure([("closed loop", curve)]), "")
            for curve in exploration.campbell
        ]
        sections.append(Section("Modes over speed", _CAMPBELL, tuple(pictures)))
    if exploration.pulses is not None:
        caption = _PULSES.format(port=units.axis_name(exploration.port))
        picture = pulse_picture(exploration.pulses)
        sections.append(
            Section(
                "Pulse over the tolerances",
                _members(exploration.pulses),
                (Figure("Pulses", picture, caption),),
            )
        )
    if exploration.unbalance is not None:
        limit = exploration.machine.requirements.unbalance_orbit
        sections.append(
            Section(
                "Unbalance",
                "",
                (Figure("Unbalance", unbalance_picture(exploration.unbalance, limit), _UNBALANCE),),
            )
        )
    verdicts = [
        Verdict(
            f"Stable over {item.over}",
            None,
            _words(item),
        )
        for item in exploration.maps
    ]
    if exploration.pulses is not None:
        whole = bool(exploration.pulses.stable.all())
        verdicts.append(Verdict("Members of the tolerances", whole, _members(exploration.pulses)))
    facts = (
        tables.machine_fact(exploration.machine),
        ("Operating point", exploration.point.label),
        ("Loop", exploration.timing),
        ("How", units.prose(tables.capitalised(exploration.notes, ". ", ""))),
    )
    verdicts.insert(
        0, Verdict("Operating points", _all(exploration.standing), describe(exploration.standing))
    )
    if exploration.assumed:
        worst = max(exploration.assumed, key=lambda item: item.abscissa)
        late = f"{DEFAULT.rate:g} Hz and one sample late, as virtual rig and export assume"
        lost = (
            f"unstable at {late}: {', '.join(item.label for item in exploration.assumed)} (at most "
            f"{worst.abscissa:+.4g} 1/s); nobody states the rate and the continuous loop was "
            f"judged; {STATE_RATE}"
        )
        verdicts.insert(1, Verdict("As it would run", False, lost))
    words = (
        "stable wherever it was examined"
        if exploration.stable
        else "not stable everywhere that was examined"
    )
    result = Verdict("Result", exploration.stable, words)
    return Page(
        "The loop over its range",
        exploration.machine,
        tuple(sections),
        tuple(verdicts),
        facts,
        date,
        result=result,
    )


def _members(family: PulseFamily) -> str:
    return f"{int(family.stable.sum())} of {len(family.stable)} members are stable"


def _all(stabilities: tuple[Stability, ...]) -> bool:
    return bool(stabilities) and all(item.stable for item in stabilities)


def _words(item: PoleMap) -> str:
    if not item.ends:
        return f"{'everywhere' if item.stable.all() else 'nowhere'} on the map"
    parts = [
        f"{'gains' if above else 'loses'} stability at {units.quantity(at, item.unit, 4)}"
        for at, above in item.ends
    ]
    return ", ".join(parts)


def _ends(item: PoleMap) -> Table:
    rows: list[Row] = []
    for value, real, ratio, stable in zip(
        item.values.tolist(),
        item.abscissa.tolist(),
        item.damping.tolist(),
        item.stable.tolist(),
        strict=True,
    ):
        verdict = "stable" if stable else "unstable"
        cells = (
            units.quantity(value, item.unit, 4),
            units.quantity(real, "1/s"),
            f"{100 * ratio:.3g} %",
        )
        rows.append((*numbers(*cells), verdict))
    columns = (item.over.capitalize(), "Largest real part", "Least damping ratio", "")
    return Table(f"By {item.over}", columns, tuple(rows), _words(item) if item.ends else "")


def pole_picture(item: PoleMap) -> Any:
    """The poles coloured by value, and the largest real part over the value."""
    picture = theme.subplots(rows=1, cols=2, column_widths=[0.58, 0.42], horizontal_spacing=0.16)
    factor, unit = units.scale(item.unit, float(item.values.max()))
    x = np.concatenate([p.real for p in item.poles])
    y = np.concatenate([p.imag for p in item.poles]) / units.TWO_PI
    shade = np.concatenate(
        [np.full(len(p), v * factor) for p, v in zip(item.poles, item.values, strict=True)]
    )
    bar = {
        "title": {"text": f"[{unit}]", "side": "top"},
        "thickness": 10,
        "x": 0.5,
        "len": 0.9,
        "outlinewidth": 0,
    }
    marker = {
        "color": drawn(shade),
        "colorscale": _SCALE,
        "size": 5,
        "colorbar": bar,
        "symbol": "circle-open",
        "line": {"width": 1.4},
    }
    hover = f"%{{x:.4g}} 1/s, %{{y:.4g}} Hz at %{{marker.color:.4g}} {unit}<extra></extra>"
    first, second = {"row": 1, "col": 1}, {"row": 1, "col": 2}
    theme.scatter(
        picture, first, drawn(x), drawn(y), mode="markers", marker=marker, hovertemplate=hover
    )
    look = theme.Style("#0072b2", "solid", "circle", 1.8)
    theme.scatter(
        picture,
        second,
        drawn(item.values * factor),
        drawn(item.abscissa),
        mode="lines+markers",
        line=look.line,
        marker={"size": 4},
        hovertemplate=f"%{{x:.4g}} {unit}: %{{y:.4g}} 1/s<extra></extra>",
    )
    for at, _ in item.ends:
        picture.add_vline(
            x=at * factor, row=1, col=2, line={"dash": "dash", "color": theme.LIMIT, "width": 1.2}
        )
    theme.dress(picture, 330, legend=False)
    slow = np.abs(x) < max(
        3.0 * float(np.abs(item.abscissa).max()), 0.5 * float(np.median(np.abs(x)))
    )
    reach = float(np.abs(x[slow]).max())
    right = max(1.2 * float(item.abscissa.max()), 0.1 * reach)
    picture.add_vline(x=0, row=1, col=1, line={"color": theme.LIMIT, "width": 1})
    picture.add_hline(y=0, row=1, col=2, line={"color": theme.LIMIT, "width": 1})
    picture.update_xaxes(title_text="Real part [1/s]", range=[-reach, right], **first)
    picture.update_yaxes(title_text="Imaginary part [Hz]", **first)
    picture.update_xaxes(title_text=f"{item.over.capitalize()} [{unit}]", **second)
    picture.update_yaxes(title_text="Largest real part [1/s]", **second)
    return picture


def pulse_picture(family: PulseFamily) -> Any:
    """Every output over time: the band of the stable members, the nominal one, the one that settles
    last.
    """
    count, columns = len(family.outputs), 2
    titles = [f"<b>{theme.plain(units.axis_name(name))}</b>" for name in family.outputs]
    rows = -(-count // columns)
    picture = theme.subplots(
        rows=rows,
        cols=columns,
        subplot_titles=titles,
        horizontal_spacing=0.1,
        vertical_spacing=0.35 / rows,
    )
    stable, time = family.responses[family.stable], 1e3 * family.time[::5]
    tail = np.abs(family.responses[:, :, -len(family.time) // 10 :]).max(axis=(1, 2))
    last = int(np.argmax(np.where(family.stable, tail, -1.0)))
    for i, name in enumerate(family.outputs):
        place, in_legend = {"row": i // columns + 1, "col": i % columns + 1}, i == 0
        factor, unit = units.scale(
            "m" if name.startswith("q") else "A", float(np.abs(family.responses[0, i]).max())
        )
        if len(stable):
            low, high = (f(axis=0)[::5] * factor for f in (stable[:, i].min, stable[:, i].max))
            theme.band(
                picture, place, time, low, high, _BAND, "stable members" if in_legend else ""
            )
        for label, member, look in (
            ("nominal", 0, theme.Style(theme.INK, "solid", "x", 1.6)),
            ("swings longest", last, theme.Style("#d55e00", "6px,3px", "x", 1.3)),
        ):
            values = drawn(family.responses[member, i, ::5] * factor)
            theme.scatter(
                picture, place, drawn(time), values, label, shown=in_legend, line=look.line
            )
        picture.update_yaxes(title_text=f"[{unit}]", **place)
    theme.dress(picture, _HEIGHT * rows, legend=True)
    picture.update_xaxes(title_text="Time [ms]", row=rows)
    return picture


def unbalance_picture(curve: BoxUnbalance, limit: float | None) -> Any:
    """Orbits over speed: nominal, worst found, upper bound."""
    picture = theme.subplots(rows=1, cols=1)
    factor, unit = units.scale("m", float(curve.found.max()))
    x = curve.speeds * units.RPM
    rows = [("nominal", curve.nominal), ("worst found over the tolerances", curve.found)]
    if not np.isnan(curve.bound).any():
        rows.append(("upper bound", curve.bound))
    for (label, values), look in zip(
        rows, theme.styles([label for label, _ in rows]).values(), strict=True
    ):
        theme.scatter(
            picture, {}, drawn(x), drawn(values * factor), label, shown=True, line=look.line
        )
    if limit is not None:
        theme.guide(
            picture,
            {},
            x[[0, -1]],
            np.full(2, limit * factor),
            color=theme.LIMIT,
            width=1.2,
            dash="1.5px,2px",
        )
    theme.dress(picture, 300, legend=True)
    picture.update_xaxes(title_text="Speed [rpm]")
    picture.update_yaxes(title_text=f"Orbit, zero to peak [{unit}]", rangemode="tozero")
    return picture
