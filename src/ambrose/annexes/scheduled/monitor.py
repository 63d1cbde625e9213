"""The page of a seal monitor: each parameter against time with its interval, the width of that by
its parts, and what it says.

write(monitor_page(monitor(machine, controller, record), machine), "page.html")
"""

from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.scheduled.seal_monitor import Direction, SealHistory
from ambrose.annexes.scheduled.seal_watch import OLD, WIDE, SealMonitor, monitor as watch
from ambrose.api import controller_of, machine_of
from ambrose.code.block.block import as_comment, render
from ambrose.code.c.code import integer_table, real_table
from ambrose.core.checks import InvalidInput
from ambrose.core.realisation import modal_form
from ambrose.core.statespace import StateSpace
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import write_files
from ambrose.report import tables, theme
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict, numbers


def monitor(machine: Machine | str, controller: Any, record: Any, **options: Any) -> SealHistory:
    """A seal's coefficients against time from one record of the running loop, with intervals and
    what they say.

    controller: the one that ran. record: a Record or a path, with y_<axis> [m], u_<axis> [A] and a
    small excitation e_<axis> [A]. options, see ``annexes.scheduled.seal_watch.monitor``:
    seal (None: the only one); unknown, such as ("pressure",) or ("k",); window [s]; rate [share of
    the file's value per s]; doubts; bending_modes; harmonics; computing_delay; progress. Raises
    InvalidInput.
    """
    from ambrose.record.files import read_record

    watched = machine_of(machine)
    loaded = controller_of(controller, watched)
    measured = read_record(record)
    law = loaded if loaded.nominal is None else loaded.nominal
    return watch(watched, law, measured, **options)


# The seal monitor as C99: one parameter of one seal, no heap, no library; what it does:
# identification/seal_monitor.
#
# The observer's filters run in modal coordinates, and what a parameter changes enters through the
# few directions it has.


_RANK = 1e-9  # of the largest: directions that are no more are left out
_TABLE = real_table("double")


def generate_monitor(following: SealMonitor, name: str = "seal_monitor") -> dict[str, str]:
    """The files <name>.h and <name>.c of a monitor of one parameter. Raises InvalidInput."""
    model = following.model
    if len(model.unknown) != 1:
        raise InvalidInput(
            f"the C code watches one parameter, not {len(model.unknown)}; name one unknown"
        )
    n, m = model.B.shape
    p, c = len(model.C), len(model.doubts)
    family = modal_form(_states(model.observer))
    into, back = family.system.B, family.system.C
    law = model.law
    A, B = model.loop
    seen = np.vstack([np.eye(n, len(A)), np.hstack([-law.D @ model.C, law.C])])
    loop = modal_form(StateSpace(A, B, seen, np.zeros((n + m, m)), dt=model.dt)).system
    rows: list[dict[str, Any]] = []
    for label, direction in [
        ("linear", model.unknown[0]),
        ("square", model.squares[0]),
        *((f"doubt{i}", d) for i, d in enumerate(model.doubts)),
    ]:
        U, V = _factors(direction)
        rows.append(
            {
                "label": label,
                "rank": U.shape[1],
                "U": _TABLE(into @ U),
                "Vx": _TABLE(V[:, :n] @ back),
                "Vv": _TABLE(V[:, n:]),
                "size": U.shape[1] * (2 * n + m),
            }
        )
    U, V = _factors(model.unknown[0])
    H = V @ loop.C
    own, ends = _rows(family.system.A)
    looped, loop_ends = _rows(loop.A)
    sections, filters = following.filters.sections, 2 * m + p
    kinds = np.unique(model.kinds, return_inverse=True)[1]
    cost = (
        5 * len(sections) * filters
        + (4 + c) * len(own)
        + len(looped)
        + n * (m + p)
        + 3 * n * p
        + sum(row["size"] for row in rows)
        + 2 * rows[0]["size"]
        + len(loop.A) * (m + len(U.T))
        + (4 + c) * p * p
    )
    values = {
        "name": name,
        "prefix": name.upper(),
        "n": n,
        "m": m,
        "p": p,
        "c": c,
        "nl": len(loop.A),
        "sections": _TABLE(sections),
        "ns": len(sections),
        "filters": filters,
        "rows": rows,
        "doubts": rows[2:],
        "rank": len(H),
        "observer": _TABLE(own),
        "observer_size": len(own),
        "observer_columns": integer_table(ends),
        "loop": _TABLE(looped),
        "loop_size": len(looped),
        "loop_columns": integer_table(loop_ends),
        "into": _TABLE(into @ np.hstack([model.B, model.L])),
        "out": _TABLE(model.C @ back),
        "white": _TABLE(model.W),
        "loop_in": _TABLE(loop.B),
        "H": _TABLE(H),
        "loop_U": _TABLE(into @ U),
        "loop_V": _TABLE(V[:, n:]),
        "kinds": integer_table(kinds),
        "nk": int(kinds.max(initial=-1)) + 1,
        "block": following.block,
        "wait": round(following.settling / model.dt),
        "step": following.block * model.dt,
        "rate": following.rate,
        "windows": _TABLE(np.array(following.windows)),
        "reference": float(model.reference[0]),
        "fade": _TABLE(np.exp(-following.block * model.dt / np.array(following.windows))),
        "dt": model.dt,
        "wide": WIDE,
        "oldest": OLD * following.window,
        "path": as_comment(model.paths[0]),
        "axes": as_comment(", ".join(model.axes)),
        "cost": int(cost),
        "bytes": 8
        * (
            filters * (1 + 2 * len(sections))
            + (4 + c) * n
            + len(loop.A)
            + 4
            + c
            + 2 * (3 + 6 + c + 3)
        ),
    }
    return {f"{name}{end}": render(f"monitor{end}.j2", values) for end in (".h", ".c")}


def write_monitor(
    directory: str | Path, following: SealMonitor, name: str = "seal_monitor"
) -> list[Path]:
    """Generate the code and write it to ``directory`` (made if absent). Returns the files' paths.
    Raises InvalidInput.
    """
    return write_files(directory, generate_monitor(following, name))


def _states(A: np.ndarray) -> StateSpace:
    return StateSpace(A, np.eye(len(A)), np.eye(len(A)), np.zeros(A.shape), dt=1.0)


def _factors(direction: Direction) -> tuple[np.ndarray, np.ndarray]:
    """U (n, r) and V (r, n + m) of [D N], each state and input scaled to the same size first."""
    whole = np.hstack([direction.D, direction.N])
    size = np.maximum(np.abs(whole).max(axis=0), 1e-12 * max(float(np.abs(whole).max()), 1e-300))
    U, s, V = np.linalg.svd(whole / size, full_matrices=False)
    rank = max(1, int((s > _RANK * s[0]).sum()))
    return U[:, :rank] * s[:rank], V[:rank] * size


def _rows(A: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of every row of A (n, n) the entries from its first to its last that is not zero, and where
    they begin and end (n, 2).
    """
    at = [np.flatnonzero(row) for row in A]
    ends = np.array([(int(k[0]), int(k[-1]) + 1) if len(k) else (0, 0) for k in at])
    return np.concatenate(
        [row[first:last] for row, (first, last) in zip(A, ends, strict=True)]
    ), ends


_LINE = "#0072b2"
_BAND = "rgba(0,114,178,0.22)"
_LIMIT = "#d55e00"
_CAPTION = (
    "The estimate over a fading window, with its 95 % interval; dashed: the range of the machine "
    "file's tolerances. Below, the "
    "half width of the interval by its parts: noise, what the model takes as known (magnets, "
    "amplifiers), the seal's change."
)


def monitor_page(history: SealHistory, machine: Machine, *, date: str = "") -> Page:
    """The page; date: ISO (today if empty)."""
    pictures = tuple(
        Figure(path, _figure(history, i), _CAPTION if i == 0 else "")
        for i, path in enumerate(history.paths)
        if history.known_at.any()
    )
    notes = tables.capitalised((*history.findings, *history.notes), ". ", "") + "."
    facts = (
        ("Controller", history.controller),
        ("Seal", history.seal),
        ("Memory", theme.quantity(history.window, "s")),
        ("Changes followed", f"up to {history.rate:g} of the reference per second"),
    )
    verdicts = (tables.without_findings("Seal", history.findings, "nothing to report", see=", "),)
    section = Section(
        "The seal against time", theme.prose(notes), pictures, (monitor_table(history),)
    )
    found = "; ".join(
        f"{path.text} {last.text}" + f" (range {limit.text})" * bool(limit.text)
        for path, last, *_, limit in monitor_table(history).cells
    )
    word = "Doubtful" if history.findings else "The seal is within its range"
    result = Verdict("Result", not history.findings, f"{word}: {found}.")
    return Page("Seal monitor", machine, (section,), verdicts, facts, date, result=result)


def monitor_table(history: SealHistory) -> Table:
    """Every parameter: last estimate, lowest and highest, trend, range."""
    rows: list[Row] = []
    known = np.flatnonzero(history.known_at)
    for i, (path, unit, limit) in enumerate(
        zip(history.paths, history.units, history.limits, strict=True)
    ):
        texts = ["nothing can be said", "", ""]
        if len(known):
            x = history.values[known, i]
            half = history.half_widths[known, i]
            trend = history.trend(i)
            ends = [
                f"{theme.quantity(float(v), unit)} ± {theme.quantity(float(h), unit, 2)}"
                for v, h in ((x[k], half[k]) for k in (-1, int(np.argmin(x)), int(np.argmax(x))))
            ]
            slope = (
                ""
                if trend is None
                else f"{theme.quantity(trend[0], unit)}/s ± {theme.quantity(trend[1], unit, 2)}/s"
            )
            texts = [ends[0], f"{ends[1]} … {ends[2]}", slope]
        texts.append(
            ""
            if limit is None
            else f"{theme.quantity(limit[0], unit)} … {theme.quantity(limit[1], unit)}"
        )
        rows.append((Cell(path), *numbers(*texts)))
    columns = ("Parameter", "Last", "Lowest … highest", "Trend", "Range")
    return Table("Estimates", columns, tuple(rows), "Intervals of 95 %.")


def _figure(history: SealHistory, i: int) -> Any:
    figure = theme.subplots(
        rows=2, cols=1, row_heights=[0.66, 0.34], shared_xaxes=True, vertical_spacing=0.06
    )
    known, unit = history.known_at, history.units[i]
    factor, shown_unit = theme.scale(unit, float(np.nanmax(np.abs(history.values[:, i]))))
    x = history.values[known, i] * factor
    half = history.half_widths[known, i] * factor
    t = history.time[known]
    top, below = {"row": 1, "col": 1}, {"row": 2, "col": 1}
    theme.band(figure, top, t, x - half, x + half, _BAND)
    figure.add_scatter(
        x=t, y=x, name="estimate, with 95 %", line={"color": _LINE, "width": 1.6}, **top
    )
    if history.paths[i].endswith(".pressure") and history.measured is not None:
        style = {"color": theme.INK, "width": 1.2, "dash": "dot"}
        figure.add_scatter(
            x=history.time, y=history.measured * factor, name="measured pressure", line=style, **top
        )
    for level in history.limits[i] or ():
        figure.add_hline(
            y=level * factor, line={"dash": "dash", "color": _LIMIT, "width": 1.2}, **top
        )
    for instant in history.restarts:
        figure.add_vline(x=instant, line={"dash": "dot", "color": theme.MUTED, "width": 1}, **top)
    parts = (
        ("whole", history.half_widths, _LINE),
        ("noise", history.noise, "#009e73"),
        ("known", history.known, "#e69f00"),
        ("change", history.change, "#cc79a7"),
    )
    for name, rows, colour in parts:
        figure.add_scatter(
            x=t, y=rows[known, i] * factor, name=name, line={"color": colour, "width": 1.3}, **below
        )
    theme.dress(figure, 480, legend=True)
    low, high = float((x - half).min()), float((x + half).max())
    room = [level * factor for level in history.limits[i] or ()]
    low, high = min([low, *room]), max([high, *room])
    figure.update_yaxes(
        title_text=shown_unit, range=[low - 0.06 * (high - low), high + 0.06 * (high - low)], **top
    )
    figure.update_yaxes(title_text=f"± {shown_unit}", rangemode="tozero", **below)
    figure.update_xaxes(title_text="time [s]", **below)
    return figure
