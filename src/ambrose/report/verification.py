"""The standard page of a verified loop: verdicts, machine, curves of all operating points overlaid,
models, checks; and the caption of a curve, which says what to look at.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ambrose.judge.checks import Checks, Curve, Verification, moving_proofs
from ambrose.judge.exploration import BoxUnbalance, Exploration, PoleMap, PulseFamily
from ambrose.judge.plants import describe
from ambrose.law.loop import DEFAULT, STATE_RATE, timing_in_words
from ambrose.machine.machine import Machine
from ambrose.options import Verifying
from ambrose.report import tables, theme
from ambrose.report.figures.curves import drawn, figure
from ambrose.report.figures.rotor_drawing import machine_drawing
from ambrose.report.page import Figure, Page, Row, Section, Table, Verdict, numbers

# The first entry whose words all occur in the curve's name applies.
_BY_NAME = {
    "complementary": "The gain falls before the first bending mode; 1/peak is the multiplicative "
    "model error that the loop tolerates.",
    "control": "The plateau at high frequency turns sensor noise and run-out into current.",
    "sensitivity input": "Peaks above the output sensitivity show unequal axes.",
    "sensitivity": "Peaks above the limit are too close to instability: a narrow spike at a "
    "bending mode is spillover, a broad hump poor damping of the rigid modes.",
    "compliance": "The peak is the softest frequency; the left end is the static compliance, zero "
    "with integral action.",
    "unbalance current": "Peaks approach the amplifier's limit at critical speeds.",
    "unbalance": "Peaks are critical speeds; they stay below the limit over the speed range.",
    "margin loop": "Stability margins are read where the curve passes 1.",
    "campbell": "Crossings with the dotted line, once per revolution, are critical speeds. Solid: "
    "forward or planar whirl, dashed: backward.",
    "current": "Above the amplifier's limit the linear result is not valid.",
    "displacement": "The motion settles and stays within the touchdown gap.",
}

_BY_KIND = {
    "frequency": "Circles mark the peaks that the legend quotes.",
    "speed": "Crossings, and lines beyond their limits within the speed range.",
    "time": "The largest excursion, and how fast it settles.",
    "poles": "The shaded half is unstable. Left: rigid-body and controller poles; right: all, the "
    "bending modes far up with little damping.",
}

_MEASURED = "sensitivity.output."  # measured, its ends and the model (judge/measured.py)
_ALIASES = {"T": "complementary", "KS": "control", "S": "sensitivity"}


def caption(curve: Curve) -> str:
    """The caption of a figure of that curve."""
    name = " ".join(
        _ALIASES.get(part, part) for part in curve.name.replace(".", " ").split()
    ).lower()
    if curve.kind != "poles":
        for words, text in _BY_NAME.items():
            if all(word in name for word in words.split()):
                return text
    return _BY_KIND.get(curve.kind, "")


Labelled = Sequence[tuple[str, Curve]]
OVER_SPEED = "The closed loop, assembled at every speed."


def verification_page(
    machine: Machine,
    verifications: Sequence[Checks],
    *,
    models: Sequence[tuple[str, str]] = (),
    responses: Labelled = (),
    comparison: Labelled = (),
    over_speed: Labelled = (),
    facts: Sequence[tuple[str, str]] = (),
    title: str = "Verification of the magnetic bearing loop",
    date: str = "",
) -> Page:
    """The report of one machine and controller at several operating points.

    verifications: one Checks per operating point, labelled as in ``machine.operation``; their
    curves of the same name share a figure. models: (name, size in words) such as ("full model",
    "320 states"). responses: (operating point, Curve) pairs of time responses; comparison: (model,
    Curve) pairs, the reference model first; over_speed: (operating point, Curve) pairs of the
    Campbell map; pairs whose curves share a name share a figure. facts: (name, text) for the head,
    e.g. the controller. date: ISO date, today if empty. Raises InvalidInput.
    """
    order = [checks.label for checks in verifications]
    loops = [(checks.label, curve) for checks in verifications for curve in checks.curves]
    sections = [_overview(machine, verifications)]
    if loops:
        text = (
            "An operating point has the same colour in all figures. Peaks in the legends are those "
            "of the points drawn; the tables have refined ones."
        )
        sections.append(Section("Closed loop", text, curve_figures(loops, order)))
    if over_speed:
        sections.append(Section("Over speed", OVER_SPEED, curve_figures(over_speed, order)))
    if responses:
        text = "Linear model, valid while currents and displacements stay well inside their limits."
        sections.append(Section("Time responses", text, curve_figures(responses, order)))
    sections += models_section(comparison)
    sections.append(machine_section(machine, models))
    detailed = tuple(tables.checks_table(checks) for checks in verifications if checks.checks)
    sections.append(Section("All checks in detail", "", (), detailed, folded=True))
    return Page(
        title,
        machine,
        tuple(sections),
        tuple(map(tables.verdict, verifications)),
        tuple(facts),
        date,
    )


def page_of_verification(verification: Verification, machine: Machine, **options: Any) -> Page:
    """The page of a Verification; options: as for ``verification_page``. What was shown between and
    around the operating points has sections of its own.
    """
    points, beside = [], []
    for point in verification.points:
        own = [curve for curve in point.curves if curve.name.startswith(_MEASURED)]
        rest = tuple(curve for curve in point.curves if curve not in own)
        points.append(replace(point, curves=rest))
        for curve in own:
            label = (
                f"{curve.name.removeprefix(_MEASURED)}, {point.label.removesuffix(', measured')}"
            )
            beside.append((label, replace(curve, name="sensitivity.output.beside")))
    if beside:
        options = {"comparison": (*beside, *options.get("comparison", ())), **options}
    page = verification_page(machine, points, **options)
    for title, checks in (
        ("Between the operating points", verification.ranges),
        ("Over the tolerances", verification.boxes),
        ("While parameters move", verification.moving),
    ):
        page = with_checks(page, title, checks) if checks else page
    proofs = () if verification.moving else moving_proofs()
    sentences = filter(None, (proof.unproved(machine, Verifying()) for proof in proofs))
    unproved = [words.removeprefix("Not checked: ") for words in sentences]
    facts = (
        ("Controller", verification.controller),
        ("Loop", tables.loop_in_words(verification.timing)),
        tables.tolerances_in_head(machine),
        (
            "Not checked",
            " ".join((*tables.unchecked(verification), tables.capitalised(unproved, end=""))),
        ),
        tables.unstated(machine),
    )
    failing, first = tables.failing_table(verification), page.sections[0]
    if failing.rows:
        first = replace(first, tables=(failing, *first.tables))
    return replace(
        page,
        facts=(*page.facts, *facts),
        sections=(first, *page.sections[1:]),
        verdicts=(),
        result=Verdict("", verification.passed, tables.deciding_verdict(verification)),
        opening=Section("", tables=(tables.deciding_table(verification),)),
    )


def with_checks(
    page: Page, title: str, checks: Sequence[Checks], figures: Sequence[Figure] = ()
) -> Page:
    """The page with a section of further checks before its last one, and their verdicts."""
    contents = tuple(map(tables.checks_table, checks))
    section = Section(title, "", tuple(figures), contents, folded=True)
    sections = (*page.sections[:-1], section, page.sections[-1])
    return replace(page, sections=sections, verdicts=(*page.verdicts, *map(tables.verdict, checks)))


def curve_figures(
    curves: Labelled, order: Sequence[str], *, overlay: bool = False
) -> tuple[Figure, ...]:
    """One figure for all curves of the same name, in the order of first appearance."""
    figures = []
    for name in dict.fromkeys(curve.name for _, curve in curves):
        same = [(label, curve) for label, curve in curves if curve.name == name]
        words = "" if overlay else caption(same[0][1])
        figures.append(
            Figure(theme.prose(same[0][1].title), figure(same, order=order, overlay=overlay), words)
        )
    return tuple(figures)


def models_section(comparison: Labelled) -> list[Section]:
    """The curves of several models laid over each other; none without any."""
    if not comparison:
        return []
    words = "Where a thin line leaves the broad one, the models differ."
    pictures = curve_figures(comparison, (), overlay=True)
    return [Section("Model against model", words, pictures, on_paper=False)]


def _overview(machine: Machine, verifications: Sequence[Checks]) -> Section:
    wanted = {checks.label for checks in verifications}
    points = [point for point in machine.operation.envelope if point.label in wanted]
    overview = [*tables.overview_tables(verifications)]
    if points:
        overview.append(tables.operating_points_table(points))
    return Section("Requirements", "", (), tuple(replace(table, folded=True) for table in overview))


def machine_section(machine: Machine, models: Sequence[tuple[str, str]]) -> Section:
    """The rotor drawing, the stations, the sizes of the models and what was chosen; models: as for
    the whole report.
    """
    words = (
        "To scale; hatched: mass without stiffness, dashed: bores. Below: free-free modes at "
        "standstill, at bearings (squares), sensors (circles) and seals (diamonds). A bearing and "
        "its sensor on opposite sides of a zero need a phase reversal at that mode."
    )
    drawing = Figure("Rotor and free-free modes", machine_drawing(machine), words)
    contents = [replace(tables.stations_table(machine), folded=True)]
    if models:
        contents.append(Table("Models", ("Model", "Size"), tuple(models)))
    contents += [replace(table, folded=True) for table in tables.assumed_table(machine)]
    return Section("Machine", "", (drawing,), tuple(contents))


# What synchronous blocks change over speed: current, force, orbit and sensitivity, and the margin
# of convergence.


_BEFORE, _AFTER = "without the block", "block converged"
_ROWS = (
    ("synchronous.current_0p", "1× control current, zero to peak"),
    ("synchronous.force_0p", "1× force on the housing, zero to peak"),
    ("synchronous.orbit_0p", "Worst-case 1× orbit, zero to peak"),
    ("synchronous.sensitivity", "Largest sensitivity of an axis"),
    ("synchronous.margin", "Angle all phases may be off by"),
)
_HEIGHT, _GAP = 170, 64  # [px] of a panel, and between two


def synchronous_figure(blocks: Sequence[Checks]) -> Any:
    """One panel each for current, force, orbit, sensitivity and margin over speed; a piece of each
    line for every block.

    blocks: the checks of each block that have curves.
    """
    rows = [
        (name, title)
        for name, title in _ROWS
        if any(_curve(block, name) is not None for block in blocks)
    ]
    total = _HEIGHT * len(rows) + _GAP * (len(rows) - 1)
    figure = theme.subplots(
        rows=len(rows), cols=1, shared_xaxes=True, vertical_spacing=_GAP / total
    )
    pressures = list(
        dict.fromkeys(
            label
            for block in blocks
            if (c := _curve(block, "synchronous.margin"))
            for label in c.labels
        )
    )
    style = theme.styles([_BEFORE, _AFTER, *pressures])
    in_legend: set[str] = set()
    for k, (name, title) in enumerate(rows, start=1):
        place = {"row": k, "col": 1}
        curves = [curve for block in blocks if (curve := _curve(block, name)) is not None]
        largest = max(float(np.nanmax(np.abs(curve.y))) for curve in curves)
        factor, unit = theme.scale(curves[0].y_unit, largest)
        for curve in curves:
            _draw(figure, place, curve, factor, unit, style, in_legend)
        # zero is part of every picture: what falls is seen against it
        figure.update_yaxes(rangemode="tozero", **place)
        theme.heading(figure, place, f"<b>{title}</b>{f' [{unit}]' if unit else ''}")
    theme.dress(figure, total, legend=True)
    figure.update_xaxes(title_text="Rotational speed [Hz]", row=len(rows), col=1)
    return figure


def _curve(block: Checks, name: str) -> Curve | None:
    return next((curve for curve in block.curves if curve.name == name), None)


def _draw(
    figure: Any,
    place: dict[str, int],
    curve: Curve,
    factor: float,
    unit: str,
    style: dict[str, theme.Style],
    in_legend: set[str],
) -> None:
    """The lines of one block, and its limit."""
    x = drawn(curve.x / theme.TWO_PI)
    for label, values in zip(curve.labels, curve.y, strict=True):
        look = style[label]
        words = theme.plain(label)
        theme.scatter(
            figure,
            place,
            x,
            drawn(values * factor),
            label,
            shown=label not in in_legend,
            name=words,
            hovertemplate=f"{words}<br>%{{x:.4g}} Hz · %{{y:.4g}} {unit}<extra></extra>",
            line={"color": look.colour, "dash": look.dash, "width": look.width},
        )
        in_legend.add(label)
    for words, level in curve.limits:
        if level > 0:
            ends = np.array([curve.x[0], curve.x[-1]]) / theme.TWO_PI
            line = np.full(2, level * factor)
            theme.guide(
                figure,
                place,
                drawn(ends),
                drawn(line),
                color=theme.LIMIT,
                width=1.2,
                dash="7px,4px",
            )
            theme.note(
                figure,
                place,
                words,
                float(ends[-1]),
                level * factor,
                "right",
                "bottom",
                colour=theme.LIMIT,
            )


# The page of synchronous blocks: what they change over speed, their margin, and every check.


_WORDS = (
    "A synchronous block takes one signal of the unbalance to zero while the rotor turns. "
    "Without the block: the loop as on the other pages. With the block: after it has converged. "
    "Between two pieces of a line the block is off.\n\n"
    "Unbalance is what the balance grade leaves, in the bearing planes, shared as is worst; of "
    "all seal pressures the worst one is drawn. The margin has a line for every pressure: it is "
    "the angle by which all phases of the loop may be off before a block of small gain "
    "diverges. The tables state the range of the proof, and what was only sampled."
)


def synchronous_section(blocks: Sequence[Checks]) -> Section:
    """A section for any page. blocks: the checks of each."""
    with_curves = [block for block in blocks if block.curves]
    figures: tuple[Figure, ...] = ()
    if with_curves:
        words = (
            "Top to bottom: current, force, orbit and sensitivity before and after, and the margin "
            "of convergence."
        )
        figures = (Figure("Over speed, before and after", synchronous_figure(with_curves), words),)
    check_tables = tuple(tables.checks_table(block) for block in blocks if block.checks)
    return Section("Synchronous blocks", _WORDS, figures, check_tables)


def synchronous_page(
    machine: Machine,
    blocks: Sequence[Checks],
    *,
    left_out: Sequence[str] = (),
    loop: str = "",
    controller: str = "",
    date: str = "",
) -> Page:
    """A page of its own. left_out: bands in which no block may be on, each with its reason; loop,
    controller: which one was judged.
    """
    facts = (
        ("Controller", controller),
        ("Loop judged", loop),
        ("Left out", "; ".join(left_out)),
    )
    title = "Synchronous unbalance control"
    verdicts = tuple(map(tables.verdict, blocks))
    passed = all(block.passed for block in blocks)
    result = Verdict(
        "",
        passed,
        "every synchronous block passes" if passed else "not every synchronous block passes",
    )
    return Page(
        title, machine, (synchronous_section(blocks),), verdicts, facts, date, result=result
    )


# The page of a controller over its whole range: poles over speed and pressure, Campbell, pulse and
# unbalance families.
#
# write(exploration_page(explore(machine, controller)), "map.html")


_POLES = (
    "Left: poles of the closed loop, coloured by {over}; right of the line at zero the loop is "
    "unstable. Right: the largest real part of all poles over {over}; where it passes zero, "
    "stability ends (dashed, by bisection)."
)
_CAMPBELL = (
    "Damped natural frequencies of the closed loop over speed, every mode followed by its shape, "
    "and their damping. Crossings with the dotted line, once per revolution, are critical speeds."
)
_PULSES = (
    "Every member of the tolerances (nominal, corners, samples) after 100 N for 2 ms at {port}. "
    "Pale: what the stable "
    "ones fill; dark: nominal; dashed: the stable member that swings longest."
)
_UNBALANCE = (
    "Largest orbit at a bearing over speed, for the worst distribution of the residual unbalance: "
    "nominal, and the worst found "
    "over the tolerances. Found by search; the upper bound, if requested, is proved at these "
    "speeds."
)
_BAR = 0.24  # of the width, between the two pictures: the bar, its numbers, the right one's axis
_SCALE = ((0.0, "#56b4e9"), (0.5, "#009e73"), (1.0, "#d55e00"))
_BAND, _HEIGHT_EXPLORATION = "rgba(130,89,174,0.25)", 190


def exploration_page(exploration: Exploration, *, date: str = "") -> Page:
    """The page of an exploration; date: ISO (today if empty)."""
    sections = []
    for item in exploration.maps:
        title = f"Poles over {item.over}"
        sections.append(
            Section(
                title,
                "",
                (Figure(title, pole_picture(item), _POLES.format(over=item.over)),),
                (_ends(item),),
                folded=True,
            )
        )
    if exploration.campbell:
        pictures = [
            Figure(curve.title, figure([("closed loop", curve)]), "")
            for curve in exploration.campbell
        ]
        sections.append(Section("Modes over speed", _CAMPBELL, tuple(pictures)))
    if exploration.pulses is not None:
        caption = _PULSES.format(port=theme.axis_name(exploration.port))
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
        ("Controller", exploration.controller),
        ("Operating point", exploration.point.label),
        ("Loop", timing_in_words(exploration.timing)),
        ("How", theme.prose(tables.capitalised(exploration.notes, ". ", ""))),
    )
    if exploration.assumed:
        worst = max(exploration.assumed, key=lambda item: item.abscissa)
        late = f"{DEFAULT.rate:g} Hz and one sample late, as virtual rig and export assume"
        lost = (
            f"unstable at {late}: {', '.join(item.label for item in exploration.assumed)} (at most "
            f"{worst.abscissa:+.4g} 1/s); no sample rate is stated, and the continuous loop was "
            f"checked; {STATE_RATE}"
        )
        verdicts.insert(0, Verdict("As it would run", False, lost))
    word = "STABLE" if exploration.stable else "UNSTABLE"
    words = f"{word} in the machine's own range: {describe(exploration.standing)}."
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


def _words(item: PoleMap) -> str:
    if not item.ends:
        return f"{'everywhere' if item.stable.all() else 'nowhere'} on the map"
    parts = [
        f"{'gains' if above else 'loses'} stability at {theme.quantity(at, item.unit, 4)}"
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
            theme.quantity(value, item.unit, 4),
            theme.quantity(real, "1/s"),
            f"{100 * ratio:.3g} %",
        )
        rows.append((*numbers(*cells), verdict))
    columns = (item.over.capitalize(), "Largest real part", "Least damping ratio", "")
    return Table(f"By {item.over}", columns, tuple(rows), _words(item) if item.ends else "")


def pole_picture(item: PoleMap) -> Any:
    """The poles coloured by value, and the largest real part over the value."""
    picture = theme.subplots(rows=1, cols=2, column_widths=[0.6, 0.4], horizontal_spacing=_BAR)
    factor, unit = theme.scale(item.unit, float(item.values.max()))
    x = np.concatenate([p.real for p in item.poles])
    y = np.concatenate([p.imag for p in item.poles]) / theme.TWO_PI
    shade = np.concatenate(
        [np.full(len(p), v * factor) for p, v in zip(item.poles, item.values, strict=True)]
    )
    bar = {
        "title": {"text": f"[{unit}]", "side": "top"},
        "thickness": 10,
        "x": 0.6 * (1 - _BAR)
        + 0.01,  # beside the left picture, clear of the title of the right one
        "xanchor": "left",
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
    top = float(y[x >= -reach].max()) or 1.0
    heights = [-0.05 * top, 1.1 * top]
    picture.update_yaxes(title_text="Imaginary part [Hz]", range=heights, **first)
    picture.update_xaxes(title_text=f"{item.over.capitalize()} [{unit}]", **second)
    picture.update_yaxes(title_text="Largest real part [1/s]", **second)
    return picture


def pulse_picture(family: PulseFamily) -> Any:
    """Every output over time: the band of the stable members, the nominal one, the one that settles
    last.
    """
    count, columns = len(family.outputs), 2
    titles = [f"<b>{theme.plain(theme.axis_name(name))}</b>" for name in family.outputs]
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
        factor, unit = theme.scale(
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
    theme.dress(picture, _HEIGHT_EXPLORATION * rows, legend=True)
    picture.update_xaxes(title_text="Time [ms]", row=rows)
    return picture


def unbalance_picture(curve: BoxUnbalance, limit: float | None) -> Any:
    """Orbits over speed: nominal, worst found, upper bound."""
    picture = theme.subplots(rows=1, cols=1)
    factor, unit = theme.scale("m", float(curve.found.max()))
    x = curve.speeds * theme.RPM
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
