"""The run-up on the comparison's page: what follows every step on the way up, and the first and the
last of them in time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ambrose.judge.checks import Curve
from ambrose.report import theme, units
from ambrose.report.figures.panels import Panel, panel_figure
from ambrose.report.page import Cell, Figure, Row, Section, Table, numbers
from ambrose.rig.run_up import Step
from ambrose.rig.trace import Trace
from ambrose.rig.trial import RunUp

_SPAN = 0.1  # s, of the first and the last panel
_WORDS = (
    "The machine runs up while a force or the set point steps every 50 ms. A scheduled controller "
    "changes with the speed, a "
    "fixed one was designed for one speed. Speeds are those at the start of a step; settling is "
    "to 5 % of its own peak."
)


def run_up_section(
    runs: Sequence[RunUp], limit: float | None, order: Sequence[str] = ()
) -> Section:
    """runs: one per controller, in order; limit [s]: the settling time asked for (None: no
    verdict).
    """
    return Section("Run-up", _WORDS, (run_up_figure(runs, order),), (_table(runs, limit),))


def _table(runs: Sequence[RunUp], limit: float | None) -> Table:
    rows: list[Row] = []
    every = [steps for run in runs for steps in (run.linear_steps, run.rig_steps)]
    longest = max(every, key=lambda run: run[-1].start if run else 0.0)
    for k, step in enumerate(longest):
        cells = [
            _settling(steps[k], limit) if k < len(steps) else Cell("ended before", "fail")
            for steps in every
        ]
        rows.append(
            (*numbers(units.quantity(step.start, "s"), units.quantity(step.speed, "rad/s")), *cells)
        )
    columns = ("Step at", "Speed", *("Linear", "Rig") * len(runs))
    groups = (("", 2), *((f"{run.name}, settles in", 2) for run in runs))
    note = "" if limit is None else f"Asked for: {units.quantity(limit, 's')}."
    return Table(
        "Settling after every step", columns, tuple(rows), note, groups=groups, by_cell=True
    )


def _settling(step: Step, limit: float | None) -> Cell:
    if not np.isfinite(step.settling):
        return Cell("not within 50 ms", "fail")
    return Cell(
        units.quantity(step.settling, "s"),
        "fail" if limit is not None and step.settling > limit else "number",
    )


def run_up_figure(runs: Sequence[RunUp], order: Sequence[str] = ()) -> Figure:
    """The first and the last 100 ms on the linear loop and on the rig, the controllers overlaid.

    order: the names of all controllers of the page, which fixes their colours.
    """
    names = [run.name for run in runs]
    last = min(run.linear.record.time[-1] for run in runs)
    rows = []
    for where in ("linear", "rig"):
        panels = []
        for words, start in (("first 100 ms", 0.0), ("last 100 ms", float(last) - _SPAN)):
            curves = tuple((run.name, _piece(getattr(run, where), start)) for run in runs)
            panels.append(
                Panel(f"{'Virtual rig' if where == 'rig' else 'Linear loop'}, {words}", curves)
            )
        rows.append(panels)
    picture, hidden = panel_figure(rows, theme.candidate_styles([*order, *names]))
    words = (
        "Displacement at the first sensor, from the start of the shown piece: low speed on the "
        "left, high speed on the right."
    )
    return Figure("Steps at the lowest and the highest speed", picture, f"{words} {hidden}".strip())


def _piece(trace: Trace, start: float) -> Curve:
    name = next(signal for signal in trace.record.signals if signal.startswith("y_"))
    time, values = trace.record.time, trace.record[name]
    inside = (time >= start - 1e-9) & (time <= start + _SPAN + 1e-9)
    x = time[inside] - start
    level = values - np.mean(values)  # the rig's rotor rests where its weight leaves it
    return Curve(
        "run-up", "displacement", "time", x, level[inside][None], (units.axis_name(name),), "s", "m"
    )
