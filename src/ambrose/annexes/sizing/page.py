"""The page of a sizing: which magnets guarantee what is asked, what binds, and what a size smaller
lacks.

write(sizing_page(size(machine)), "size.html")
"""

from typing import Any

import numpy as np

from ambrose.annexes.sizing.least import Size, Sizing, Trial, drives
from ambrose.judge.checks import Verification
from ambrose.report import tables, theme
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers

_MET, _NOT = "#009e73", "#d55e00"
_SHADES = (
    (0.8, "meets-1"),
    (0.9, "meets-2"),
    (1.0, "meets-3"),
    (1.1, "fails-1"),
    (1.3, "fails-2"),
    (np.inf, "fails-3"),
)
_MAP = (
    "The requirement nearest to its limit, as a share of it: at most 1 where a controller meets "
    "all requirements at every operating point on the full plants, as the loop runs, and at the "
    "worst corners found of the tolerances. Grey: no "
    "controller can, for the reason stated. None was found by search; that is not a proof that "
    "none exists."
)
_COSTS = (
    "Copper loss of all coils over the volume of the magnets, both over the machine file's own. "
    "Circle: meets every requirement; ring: the least product of the two."
)
_CROSS = " Cross: a requirement is not met."
_FRONT = " The line joins the sizes of which no other has both less."
_CONTOURS = (
    "Axes: pole area and bias current, relative to the machine file. {solid}Dotted: voltage for "
    "the largest control current at top speed [V], with the machine file's turns. Circle: meets "
    "every requirement.{cross}"
)
_SOLID = "Solid: largest singular value of S_o; its limit {limit} {where}. "
_DRIVE = ("Turns", "Bias current", "Largest control current", "Inductance", "Voltage at top speed")
_SOURCES = (
    "scaled from the machine file's with area and turns",
    "of the air gaps alone, without leakage (assumed)",
)
_ASSUMED = (
    "Load capacity: force within the limits of bias, current, force and voltage over residual "
    "unbalance, and over "
    "each load of the machine file on top of it; below 1 the size fails. "
    "The magnet grows along the shaft: pole area, volume and inductance with it; gap, turns, "
    "pole width and amplifier bandwidth do not change. Copper loss: from the squares of the "
    "static coil currents; the pole is taken as square at the machine file's size. "
    "Volt-amperes: inductance, bandwidth and the square of the current."
)
_TURNS = (
    "Fewer turns take more current and less voltage for the same flux, force and loop; the "
    "controller's gains go with 1/turns. "
    "Voltage: of the largest control current as a sine at top speed (or at the suspension's own "
    "frequency, where that is "
    "higher), without the motion's share. Inductance of a coil: {source}."
)


def sizing_page(sizing: Sizing, verified: Verification | None = None, *, date: str = "") -> Page:
    """The report; verified: what verification said of the knee's machine and controller; date: ISO
    (today if empty).
    """
    knee = sizing.knee
    pictures = []
    if any(t.met for t in sizing.trials):
        pictures.append(Figure("What it costs", cost_figure(sizing), costs_caption(sizing)))
    if (
        len({t.size.area for t in sizing.trials if t.synthesis})
        > 1
        < len({t.size.bias for t in sizing.trials if t.synthesis})
    ):
        pictures.append(
            Figure("Sensitivity and voltage", contour_figure(sizing), contour_caption(sizing))
        )
    sections = [Section("Which sizes are enough", _MAP, tuple(pictures))]
    if knee is not None:
        rows = [_row("taken", knee), *(_row("one size smaller", trial) for trial in sizing.smaller)]
        rows_of_turns = tuple(
            numbers(
                _share(d.turns),
                *(
                    f"{v:.3g} {u}"
                    for v, u in (
                        (d.bias_current, "A"),
                        (d.current, "A"),
                        (1e3 * d.inductance, "mH"),
                        (d.voltage, "V"),
                    )
                ),
            )
            for d in drives(sizing.machine, knee.size)
        )
        told = _TURNS.format(source=_SOURCES[sizing.machine.amplifier.inductance is None])
        turns = Table(
            "Turns for the amplifier, over the machine file's", _DRIVE, rows_of_turns, told
        )
        columns = (
            "",
            "Area",
            "Bias",
            "Ratio",
            "S_o",
            "K S_o",
            "Copper loss",
            "Volt-amperes",
            "Force over load",
            "Load capacity",
            "What binds",
        )
        sections.append(
            Section(
                "The knee, and one size smaller",
                "",
                (),
                (Table("Over the machine file's", columns, tuple(rows), _ASSUMED), turns),
            )
        )
    if verified is not None:
        sections.append(
            Section(
                "Verification of the knee",
                "",
                (),
                tuple(tables.checks_table(point) for point in verified.points),
                folded=True,
            )
        )
    count = f"{sum(t.met for t in sizing.trials)} of {len(sizing.trials)} sizes"
    words = (
        "No size that was tried meets every requirement."
        if knee is None
        else f"{count} meet every requirement. Least copper and iron: {_share(knee.size.area)} × "
        f"pole area, {_share(knee.size.bias)} × bias current of the machine file."
    )
    words += " No smaller size or lower bias was tried." if sizing.at_edge else ""
    verdicts = []
    if verified is not None:
        told = (
            "every check passed"
            if verified.passed
            else f"fails: {', '.join(verified.facts()['failed'])}"
        )
        verdicts.append(Verdict("Verification of the knee", verified.passed, told))
    facts = (("Force over static load", f"{sizing.reserve:g} at least"),)
    return Page(
        "Size of the magnetic bearings",
        sizing.machine,
        tuple(sections),
        tuple(verdicts),
        facts,
        date,
        result=Verdict("Result", knee is not None and (verified is None or verified.passed), words),
        opening=Section("", tables=(map_table(sizing),)),
    )


def map_table(sizing: Sizing) -> Table:
    """Ratio and what binds, by area (rows) and bias (columns)."""
    by = {(t.size.area, t.size.bias): t for t in sizing.trials}
    biases = sorted({t.size.bias for t in sizing.trials})
    rows: list[Row] = []
    for area in sorted({t.size.area for t in sizing.trials}, reverse=True):
        rows.append(
            (Cell(_share(area)), *(_cell(by.get((area, bias)), sizing.knee) for bias in biases))
        )
    return Table(
        "Pole area (down) and bias current (across), over the machine file's",
        ("Area", *map(_share, biases)),
        tuple(rows),
        by_cell=True,
    )


def cost_figure(sizing: Sizing) -> Any:
    """Copper loss over volume of every size, the front and the knee."""
    figure, place = theme.subplots(rows=1, cols=1), {"row": 1, "col": 1}
    for met, colour, name in ((False, _NOT, "not enough"), (True, _MET, "meets all")):
        some = [t for t in sizing.trials if t.met is met]
        mark = {
            "size": 9,
            "color": colour,
            "symbol": "circle" if met else "x-thin",
            "line": {"width": 2, "color": colour},
        }
        told = [f"{_of(t)}: {t.binding.partition(':')[0]}, {_ratio(t)}" for t in some]
        theme.scatter(
            figure,
            place,
            [t.costs.volume for t in some],
            [t.costs.copper_loss for t in some],
            name,
            mode="markers",
            marker=mark,
            customdata=told,
            hovertemplate="%{customdata}<extra></extra>",
        )
    front = sizing.front
    if len(front) > 1:
        theme.guide(
            figure,
            place,
            [t.costs.volume for t in front],
            [t.costs.copper_loss for t in front],
            color=_MET,
            width=1.2,
        )
    if (knee := sizing.knee) is not None:
        ring = {
            "size": 17,
            "color": "rgba(0,0,0,0)",
            "symbol": "circle",
            "line": {"width": 2, "color": theme.INK},
        }
        theme.scatter(
            figure,
            place,
            [knee.costs.volume],
            [knee.costs.copper_loss],
            mode="markers",
            marker=ring,
            hoverinfo="skip",
        )
    theme.dress(figure, 300, legend=False)
    figure.update_xaxes(title_text="Volume of the magnets [-]", rangemode="tozero")
    figure.update_yaxes(title_text="Copper loss [-]", rangemode="tozero")
    return figure


def costs_caption(sizing: Sizing) -> str:
    """What ``cost_figure`` draws of these sizes, and nothing else."""
    crosses = any(not t.met for t in sizing.trials)
    return _COSTS + _CROSS * crosses + _FRONT * (len(sizing.front) > 1)


def _sensitivities(sizing: Sizing) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bias (x,), area (y,), largest singular value of S_o (y, x), NaN where there is none."""
    x, y = (
        np.array(sorted({getattr(t.size, name) for t in sizing.trials}))
        for name in ("bias", "area")
    )
    z = np.full((len(y), len(x)), np.nan)
    for t in sizing.trials:
        if np.isfinite(t.sensitivity):
            z[np.searchsorted(y, t.size.area), np.searchsorted(x, t.size.bias)] = t.sensitivity
    return x, y, z


def _levels(sizing: Sizing, z: np.ndarray) -> tuple[tuple[float, ...], float, bool]:
    """Levels of S_o that have a line, the limit, and whether it has one: a line needs values on
    both sides, at four sizes around a point.
    """
    limit = next((t.sensitivity / t.ratios["sensitivity"] for t in sizing.trials if t.ratios), 3.0)
    corners = np.stack([z[:-1, :-1], z[1:, :-1], z[:-1, 1:], z[1:, 1:]])
    whole = corners[:, np.isfinite(corners).all(axis=0)]
    if not whole.size or whole.min() == whole.max():
        return (), limit, False
    levels = np.geomspace(whole.min(), whole.max(), 5)[1:-1]
    return tuple(float(f"{v:.3g}") for v in levels), limit, bool(whole.min() < limit < whole.max())


def contour_caption(sizing: Sizing) -> str:
    """What ``contour_figure`` draws of these sizes, and nothing else."""
    levels, limit, drawn = _levels(sizing, _sensitivities(sizing)[2])
    words = {"limit": f"{limit:.3g}", "where": "in red" if drawn else "is not reached"}
    if levels and not drawn and limit < min(levels):
        words["where"] = "is exceeded everywhere"
    crosses = any(not t.met and t.synthesis is not None for t in sizing.trials)
    solid = _SOLID.format(**words) if levels else ""
    return _CONTOURS.format(solid=solid, cross=_CROSS * crosses)


def contour_figure(sizing: Sizing) -> Any:
    """Lines of equal sensitivity and of equal voltage over bias (x) and area (y)."""
    import plotly.graph_objects as go

    figure = theme.subplots(rows=1, cols=1)
    x, y, z = _sensitivities(sizing)
    within, limit, drawn = _levels(sizing, z)
    shown = {"size": 1, "showlabels": True}
    fine = np.geomspace(x[0], x[-1], 60), np.geomspace(y[0], y[-1], 60)
    # inductance a, current b
    volts = fine[1][:, None] * fine[0][None] * drives(sizing.machine, Size(), (1.0,))[0].voltage
    for at, values, levels, colour, dash in (
        (
            (x, y),
            z,
            within,
            "#0072b2",
            "solid",
        ),
        ((x, y), z, (limit,) * drawn, theme.LIMIT, "solid"),
        (
            fine,
            volts,
            tuple(float(f"{v:.2g}") for v in np.geomspace(volts.min(), volts.max(), 6)[1:-1]),
            theme.MUTED,
            "dot",
        ),
    ):
        font = {"size": 11, "color": colour}
        for level in levels:
            figure.add_trace(
                go.Contour(
                    x=at[0],
                    y=at[1],
                    z=values,
                    showscale=False,
                    contours_coloring="lines",
                    colorscale=[[0, colour], [1, colour]],
                    contours={**shown, "start": level, "end": level, "labelfont": font},
                    line={"dash": dash, "width": 1.6},
                    hoverinfo="skip",
                    connectgaps=False,
                    showlegend=False,
                )
            )
    for met in (False, True):
        some = [t for t in sizing.trials if t.met is met and t.synthesis is not None]
        mark = {
            "size": 8,
            "color": _MET if met else _NOT,
            "symbol": "circle" if met else "x-thin",
            "line": {"width": 2, "color": _MET if met else _NOT},
        }
        told = [f"{_of(t)}: {t.binding}, {_ratio(t)}; S_o {t.sensitivity:.3g}" for t in some]
        theme.scatter(
            figure,
            {"row": 1, "col": 1},
            [t.size.bias for t in some],
            [t.size.area for t in some],
            mode="markers",
            marker=mark,
            customdata=told,
            hovertemplate="%{customdata}<extra></extra>",
        )
    theme.dress(figure, 320, legend=False)
    figure.update_xaxes(
        title_text="Bias current [-]",
        type="log",
        tickvals=x.tolist(),
        ticktext=[_share(v) for v in x],
    )
    figure.update_yaxes(
        title_text="Pole area [-]", type="log", tickvals=y.tolist(), ticktext=[_share(v) for v in y]
    )
    return figure


def _cell(trial: Trial | None, knee: Trial | None) -> Cell:
    if trial is None:
        return Cell("not tried", shade="free")
    word = trial.binding.partition(":")[0]
    if trial.synthesis is None:
        return Cell("–", shade="absent", detail=word)
    shade = next(shade for limit, shade in _SHADES if trial.ratio <= limit)
    return Cell(_ratio(trial) + (" ◎" if trial is knee else ""), shade=shade, detail=word)


def _row(what: str, trial: Trial) -> Row:
    price, tuned = trial.costs, trial.synthesis is not None
    gain = theme.quantity(trial.gain, "A/m") if tuned else "–"
    return (
        Cell(what, "pass" if trial.met else "fail"),
        *numbers(
            _share(trial.size.area),
            _share(trial.size.bias),
            _ratio(trial),
            f"{trial.sensitivity:.3g}" if tuned else "–",
            gain,
            f"{price.copper_loss:.3g}",
            f"{price.volt_amperes:.3g}",
            f"{price.reserve:.3g}" if np.isfinite(price.reserve) else "–",
            f"{trial.capacity:.3g}" if np.isfinite(trial.capacity) else "–",
        ),
        trial.binding,
    )


def _ratio(trial: Trial) -> str:
    return f"{trial.ratio:.2f}" if np.isfinite(trial.ratio) else "–"


def _of(trial: Trial) -> str:
    return f"{_share(trial.size.area)} of the area at {_share(trial.size.bias)} of the bias"


def _share(value: float) -> str:
    return f"{value:.3g}"
