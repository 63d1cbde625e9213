"""What a campaign gave: its rows as columns, as an xarray Dataset, as a table."""

import csv
import io
import math
import os
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ambrose.annexes.campaigns.plan import Plan, Subject, Value, number_of, plan_of, read_plan
from ambrose.annexes.campaigns.run import PEAK, ROWS, checks_of, executors, rows_of, run, run_plan
from ambrose.core.checks import InvalidInput, check_shape, invalid
from ambrose.core.presentation import Presented, data_frame, in_words
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import draft_of, write_text
from ambrose.report import theme
from ambrose.report.figures.curves import drawn
from ambrose.report.page import Cell, Figure, Page, Row, Section, Table, Verdict
from ambrose.report.record import record_page
from ambrose.report.verification import verification_page

# What a result depends on: variance-based sensitivity indices from samples that are there, without
# further runs.
#
# Main effect of an input x_i: S_i = Var(E[y | x_i]) / Var(y), the share of the variance that goes
# when x_i is known (Sobol 1993; Saltelli et al. 2008, sec. 1.2.8). Conditional means are those of
# classes: the values themselves where they are few, else classes of equally many samples (the
# correlation ratio of Pearson 1905).


_MOST_LEVELS = 40  # values up to which each is a class of its own
_CLASSES = 100  # at most, and as many as leave ten samples to each
_LEAST = 10  # cases in a class, so that its mean says something


def main_effects(x: ArrayLike, y: ArrayLike, *, complete: bool = False) -> np.ndarray:
    """S (v,) of the inputs x (c, v) on y (c,), each 0 to 1.

    complete: x is a full grid, on which class means are exact; else what the scatter of means of
    few samples adds is taken off (Kelley 1935). A constant y gives zeros. Raises InvalidInput for
    arrays that do not fit.
    """
    x = check_shape(x, "x", "(c, v)").astype(float)
    y = check_shape(y, "y", "(c)", c=len(x)).astype(float)
    total = y.var()
    if len(y) < 2 or total <= 1e-24 * np.square(y).mean():
        return np.zeros(x.shape[1])
    return np.array([_share(_classes(column), y, total, complete) for column in x.T])


def _classes(x: np.ndarray) -> np.ndarray:
    levels, which = np.unique(x, return_inverse=True)
    if len(levels) <= min(_MOST_LEVELS, max(2, len(x) // 2)):
        return which
    count = max(2, min(_CLASSES, len(x) // _LEAST))
    rank = np.empty(len(x), dtype=int)
    rank[np.argsort(x, kind="stable")] = np.arange(len(x))
    return rank * count // len(x)


def _share(which: np.ndarray, y: np.ndarray, total: float, complete: bool) -> float:
    sizes = np.bincount(which)
    kept = sizes > 0
    means = np.bincount(which, y)[kept] / sizes[kept]
    share = float((sizes[kept] * (means - y.mean()) ** 2).sum() / len(y) / total)
    if not complete and kept.sum() < len(y):
        share = 1 - (1 - share) * (len(y) - 1) / (len(y) - kept.sum())
    return min(max(share, 0.0), 1.0)


_MEASURES = {"design": "norm", "simulate": "displacement.max"}
_NUMBERS = {"inf": math.inf, "-inf": -math.inf, "nan": math.nan}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Campaign(Presented):
    """The cases of a plan with what is there of them, in the plan's order.

    settings and values: columns (c,) by path and by name, numbers as floats (NaN: not there,
    infinite: there is none, as of a loop that is unstable), words as texts. units: of the settings,
    as written in the plan. failures (c,): why a case has no values, "" where it has. keys (c,): of
    the cases; missing: how many are not computed yet.
    """

    plan: Plan
    keys: tuple[str, ...]
    settings: Mapping[str, np.ndarray]
    units: Mapping[str, str]
    values: Mapping[str, np.ndarray]
    failures: tuple[str, ...]
    missing: int = 0

    @property
    def measure(self) -> str:
        """The value by which cases are worst: of the sensitivity, else what the task is about."""
        wanted = _MEASURES.get(self.plan.task, PEAK)
        if wanted in self.values:
            return wanted
        return next(
            (
                name
                for name, column in self.values.items()
                if column.dtype.kind == "f" and name not in {"stable", "passed"}
            ),
            "",
        )

    @property
    def worst_first(self) -> np.ndarray:
        """The computed cases (c',) by their numbers, the largest measure first; failures left
        out.
        """
        if not self.measure:
            return np.zeros(0, dtype=int)
        column = self.values[self.measure]
        evaluated = np.flatnonzero(~np.isnan(column))
        return evaluated[np.argsort(-column[evaluated], kind="stable")]

    @property
    def lost(self) -> np.ndarray:
        """Which cases (c,) the judge called unstable; none where the task does not ask it."""
        return self.values.get("stable", np.ones(len(self.keys))) == 0

    @property
    def failed(self) -> int:
        return sum(bool(text) for text in self.failures)

    def effects(self) -> dict[str, float]:
        """The main effect of every path on the measure (its logarithm where it is positive), over
        its finite values.
        """
        y = self.values[self.measure] if self.measure else np.zeros(0)
        kept = np.isfinite(y)
        if kept.sum() < 2:
            return {}
        x = np.column_stack([_levels(column)[kept] for column in self.settings.values()])
        y = np.log(y[kept]) if (y[kept] > 0).all() else y[kept]
        shares = main_effects(x, y, complete=self.plan.plan == "grid" and bool(kept.all()))
        return dict(
            sorted(zip(self.settings, shares.tolist(), strict=True), key=lambda pair: -pair[1])
        )

    def facts(self) -> dict[str, Any]:
        """Cases, failures, the worst."""
        order = self.worst_first
        worst = (
            {f"worst {self.measure}": float(self.values[self.measure][order[0]])}
            if len(order)
            else {}
        )
        unstable = {"unstable": int(self.lost.sum())} if "stable" in self.values else {}
        return {
            "task": self.plan.task,
            "cases": len(self.keys),
            "missing": self.missing,
            "failed": self.failed,
            **unstable,
            **worst,
        }

    def to_dict(self) -> dict[str, Any]:
        """The facts, what drives the measure, and the ten worst cases, ready for JSON."""
        ten_worst = self.worst_first[:10].tolist()
        worst = [
            {
                "key": self.keys[i],
                **{p: _plain(c[i]) for p, c in (*self.settings.items(), *self.values.items())},
            }
            for i in ten_worst
        ]
        facts = {name: _plain(value) for name, value in self.facts().items()}
        return {
            **facts,
            "measure": self.measure,
            "main_effects": self.effects(),
            "worst_cases": worst,
        }

    def to_frame(self) -> Any:
        """A pandas.DataFrame with a row for each case. Raises InvalidInput without pandas."""
        return data_frame(self._columns())

    def _columns(self) -> dict[str, Any]:
        named = {
            f"{path} [{self.units[path]}]" if self.units[path] else path: column
            for path, column in self.settings.items()
        }
        return {"key": self.keys, **named, **self.values, "failure": self.failures}

    def to_xarray(self) -> Any:
        """An xarray.Dataset: a grid has a dimension for each path, else all is over the cases.
        Raises InvalidInput.
        """
        try:
            import xarray as xr
        except ImportError:
            raise InvalidInput(
                "to_xarray() needs xarray, which is not installed; pip install 'ambrose[campaign]'"
            ) from None
        columns: dict[str, Any] = {
            **self.values,
            "failure": np.array(self.failures, dtype=object),
            "key": np.array(self.keys, dtype=object),
        }
        names = {path: path.replace("*", "all") for path in self.settings}
        units = {names[path]: {"units": unit} if unit else {} for path, unit in self.units.items()}
        attributes = {
            "task": self.plan.task,
            "plan": self.plan.plan,
            "model": self.plan.model,
            "missing": self.missing,
        }
        if self.plan.plan != "grid":
            coordinates = {
                names[path]: ("case", column, units[names[path]])
                for path, column in self.settings.items()
            }
            return xr.Dataset(
                {name: ("case", column) for name, column in columns.items()},
                coordinates,
                attributes,
            )
        shape = [len(variable.values) for variable in self.plan.variables]
        axes, start = {}, 1
        for path, size in reversed(list(zip(self.settings, shape, strict=True))):
            axes[names[path]] = (
                names[path],
                self.settings[path][::start][:size],
                units[names[path]],
            )
            start *= size
        ordered = [names[path] for path in self.settings]
        return xr.Dataset(
            {name: (ordered, column.reshape(shape)) for name, column in columns.items()},
            axes,
            attributes,
        )

    def write(self, directory: str | Path) -> list[Path]:
        """``table.csv``, and with xarray and h5netcdf ``results.nc`` (netCDF 4). Returns the paths.
        Raises InvalidInput.
        """
        folder, text = Path(directory), io.StringIO()
        columns = self._columns()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(zip(*(map(_plain, column) for column in columns.values()), strict=True))
        paths = [write_text(folder / "table.csv", text.getvalue(), "table")]
        try:
            import h5netcdf  # noqa: F401
            import xarray  # noqa: F401
        except ImportError:
            return paths
        with draft_of(folder / "results.nc", "result file") as draft:
            self.to_xarray().to_netcdf(draft, engine="h5netcdf")
        return [*paths, folder / "results.nc"]


def read_campaign(plan: Plan, directory: str | Path) -> Campaign:
    """What the folder of a campaign holds of a plan. Raises InvalidInput."""
    cases = list(plan.drawn())
    wanted = {case.key for case in cases}
    stored = (
        {row["key"]: row for row in rows_of(Path(directory) / ROWS) if row["key"] in wanted}
        if (Path(directory) / ROWS).exists()
        else {}
    )
    settings, units = {}, {}
    for i, variable in enumerate(plan.variables):
        settings[variable.path], units[variable.path] = _setting(
            [case.settings[i][1] for case in cases]
        )
    names = dict.fromkeys(name for row in stored.values() for name in row["values"])
    columns = {"key", "failure", "case", *settings, *(p.replace("*", "all") for p in settings)}
    if twice := columns & names.keys():
        raise invalid(
            f"a name in {Path(directory) / ROWS}",
            sorted(twice)[0],
            "the name of a result",
            "it is one of the plan's columns; move the file away to begin anew",
        )
    rows = [stored.get(case.key) for case in cases]
    values = {
        name: _value([None if row is None else row["values"].get(name) for row in rows])
        for name in names
    }
    failures = tuple("" if row is None else row["failure"] for row in rows)
    return Campaign(
        plan,
        tuple(c.key for c in cases),
        settings,
        units,
        values,
        failures,
        sum(row is None for row in rows),
    )


def _setting(values: list[Value]) -> tuple[np.ndarray, str]:
    """A column of numbers and their unit, or of texts."""
    parsed = [number_of(value) for value in values]
    if all(one is not None for one in parsed) and len({one[1] for one in parsed if one}) == 1:
        return np.array([one[0] for one in parsed if one]), next(one[1] for one in parsed if one)
    return np.array([str(value) for value in values], dtype=object), ""


def _value(values: list[Any]) -> np.ndarray:
    """Numbers and truth values as floats, as soon as one is a word all as texts."""
    numbers = [_NUMBERS.get(value, value) if isinstance(value, str) else value for value in values]
    if any(isinstance(value, str) for value in numbers):
        return np.array(["" if value is None else str(value) for value in values], dtype=object)
    return np.array([math.nan if value is None else float(value) for value in numbers])


def _levels(column: np.ndarray) -> np.ndarray:
    return (
        column
        if column.dtype.kind == "f"
        else np.unique(column.astype(str), return_inverse=True)[1].astype(float)
    )


def _plain(value: Any) -> Any:
    value = value.item() if hasattr(value, "item") else value
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


Progress = Callable[[str], None]


def _quiet(stage: str) -> None:
    """Progress that nobody watches."""


def campaign(
    plan: Any,
    directory: str | os.PathLike[str] = "campaign",
    *,
    engine: str = "processes",
    workers: int | None = None,
    progress: Progress = _quiet,
) -> Campaign:
    """A plan of many cases computed, and what it gave; what ``directory`` holds of it already is
    not computed again.

    plan: the path of a plan file, its content as a dict, or a Plan. engine: "processes" on this
    computer, "dask" for a Dask cluster on it, or the address of a running scheduler, which must be
    one that you trust. workers: 1 or more; None: one for each processor. A case whose worker
    process dies is none of the results: ``missing`` counts it, and the next call computes it.
    Raises InvalidInput, and NumericalFailure where the workers die before they return anything.
    """
    from ambrose.core.processes import processors

    if isinstance(plan, Plan):
        wanted = plan
    else:
        wanted = plan_of(plan) if isinstance(plan, dict) else read_plan(plan)
    with executors(engine, processors() if workers is None else workers) as (make, count):
        run_plan(wanted, Path(directory), make=make, workers=count, progress=progress)
    result = read_campaign(wanted, Path(directory))
    result.write(Path(directory))
    return result


# The page of a campaign: the worst cases first, what drives them, maps, all cases side by side; and
# a page for a single case.
#
# write(campaign_page(result, machine), "campaign/report.html")


_WORST = 12  # rows of each table
_LINES = 1500  # drawn; of more, the best half and the worst half
_BINS = 10  # classes of a parameter that has more than three times as many values
_MAPS = 3  # pairs of parameters that are mapped
_SCALE = ((0.0, "#d5efe8"), (0.5, "#f7bd80"), (1.0, "#d55e00"))
_DARK = "#4a1626"
_MAP = (
    "Each cell shows the worst of all cases that fall into it, whatever else is varied. Dark "
    "cells: unstable loop. "
    "Drawn over the settings that matter most; the tenth of the cells that is worst has one colour."
)
_SHARES = (
    "Share of the variance of the measure (of its logarithm) that goes when one setting alone is "
    "known: first-order indices of "
    "Sobol, from the cases themselves; unstable cases are left out. What is missing to 100 % is "
    "due to settings together."
)
_PARALLEL = (
    "Every line is a case; drag along an axis to keep those that pass there. Shown are the worst "
    "and an even choice of others."
)
_HOW = {
    "screen": "Stability and the largest singular value of the output sensitivity of the "
    "continuous loop, with the mean delay "
    "of the sampled one, on a frequency grid refined around its peak: a screening, not a "
    "verification.",
    "verify": "Every nominal check on the full plant, of the loop as it runs.",
    "design": "A design for each case, certified on the full plants.",
    "simulate": "The scenario on the nonlinear virtual rig.",
    "identify": "A run of the case's machine, identified from the machine of the file.",
}


def campaign_page(
    campaign: Campaign, machine: Machine, pages: Collection[str] = (), *, date: str = ""
) -> Page:
    """The page of a campaign; machine: the one it began with; pages: the cases (keys) that have a
    page of their own.
    """
    effects = campaign.effects()
    worst = _worst_tables(campaign, pages)
    sections = [Section("Worst cases", "", (), worst[1:])] if worst[1:] else []
    sections += [
        Section("Maps", "", tuple(maps), ()) for maps in [_maps(campaign, effects)] if maps
    ]
    if effects:
        pictures = (
            Figure("What drives it", _shares(effects), _SHARES),
            Figure("Distribution", _distribution(campaign, machine)),
        )
        sections.append(Section("What drives it", "", pictures))
        sections.append(
            Section(
                "All cases", "", (Figure("Cases side by side", _parallel(campaign), _PARALLEL),)
            )
        )
    seed = f", seed {campaign.plan.seed}" if campaign.plan.plan != "grid" else ""
    facts = (
        ("Task", campaign.plan.task),
        ("Plan", f"{campaign.plan.plan}, {len(campaign.keys)} cases{seed}"),
        (
            "How",
            _HOW[campaign.plan.task]
            + (" On the reduced plant." if campaign.plan.model == "reduced" else ""),
        ),
        ("Not computed yet", str(campaign.missing) if campaign.missing else ""),
    )
    verdicts = [Verdict(name.capitalize(), passed, text) for name, passed, text in counts(campaign)]
    bad = [verdict.text for verdict in verdicts if verdict.passed is False]
    words = f"Nothing failed in {len(campaign.keys) - campaign.missing} cases."
    if bad:
        words = f"{'. '.join(bad)}."
    words += "".join(
        f" Worst case: {text}." for name, _, text in counts(campaign) if name == "worst"
    )
    result = Verdict("Result", not bad, words)
    verdicts = [verdict for verdict in verdicts if verdict.text not in words]  # each is said once
    return Page(
        "Campaign",
        machine,
        tuple(sections),
        tuple(verdicts),
        facts,
        date,
        result=result,
        opening=Section("", tables=worst[:1]),
    )


def counts(campaign: Campaign) -> list[tuple[str, bool | None, str]]:
    """What is to be said in words of all cases together: about what, whether it is good, how
    many.
    """
    done = len(campaign.keys) - campaign.missing
    rows: list[tuple[str, bool | None, str]] = []
    for name, bad in (
        ("stable", "unstable"),
        ("passed", "do not pass"),
        ("completed", "not completed"),
    ):
        if name in campaign.values and (evaluated := int((~np.isnan(campaign.values[name])).sum())):
            count = int((campaign.values[name] == 0).sum())
            rows.append(
                (
                    name,
                    count == 0,
                    f"{count} of {evaluated} cases {bad}" if count else f"all {evaluated} cases",
                )
            )
    order = campaign.worst_first
    if len(order) and math.isfinite(value := float(campaign.values[campaign.measure][order[0]])):
        rows.append(("worst", None, f"{campaign.measure} {value:.4g}"))
    if campaign.failed:
        rows.append(
            ("without values", False, f"{campaign.failed} of {done} cases could not be computed")
        )
    return rows


def _told(campaign: Campaign, path: str, i: int) -> str:
    value = campaign.settings[path][i]
    return (
        f"{value:.4g} {campaign.units[path]}".rstrip() if isinstance(value, float) else str(value)
    )


def _worst_tables(campaign: Campaign, pages: Collection[str]) -> tuple[Table, ...]:
    order = campaign.worst_first[: max(_WORST, len(pages))].tolist()
    paths, tables = list(campaign.settings), []
    rows: list[Row] = []
    for i in order:
        key, value = campaign.keys[i], float(campaign.values[campaign.measure][i])
        words = "unstable" if campaign.lost[i] else f"{value:.4g}"
        link = f"cases/{key}.html" if key in pages else ""
        rows.append(
            (
                Cell(key[:8], link=link),
                Cell(words, "number"),
                *(Cell(_told(campaign, p, i), "number") for p in paths),
            )
        )
    if rows:
        note = "A case's name leads to its own page." if pages else ""
        tables.append(
            Table(f"By {campaign.measure}", ("Case", "Measure", *paths), tuple(rows), note)
        )
    reasons = Counter(text for text in campaign.failures if text)
    if reasons:
        reason_rows = tuple(
            (reason, Cell(str(count), "number")) for reason, count in reasons.most_common(_WORST)
        )
        tables.append(Table("Why cases have no values", ("Reason", "Cases"), reason_rows))
    return tuple(tables)


def _axis(campaign: Campaign, path: str) -> tuple[np.ndarray, list[str]]:
    """In which class of a setting each case falls (c,), and the classes' names."""
    column = campaign.settings[path]
    unit = campaign.units[path]
    if column.dtype.kind != "f":
        names, which = np.unique(column.astype(str), return_inverse=True)
        return which, list(map(str, names))
    levels, which = np.unique(column, return_inverse=True)
    if len(levels) > 3 * _BINS:
        edges = np.linspace(column.min(), column.max(), _BINS + 1)
        which = np.clip(np.digitize(column, edges) - 1, 0, _BINS - 1)
        levels = (edges[1:] + edges[:-1]) / 2
    return which, [f"{level:.4g} {unit}".rstrip() for level in levels]


def _maps(campaign: Campaign, effects: Mapping[str, float]) -> list[Figure]:
    """The worst over pairs of the settings that matter most."""
    chosen = [
        path
        for path in (effects or campaign.settings)
        if len(np.unique(campaign.settings[path].astype(str))) > 1
    ][:_MAPS]
    return [
        Figure(f"Worst over {a} and {b}", picture, _MAP if n == 0 else "")
        for n, (a, b) in enumerate(combinations(chosen, 2))
        if (picture := _map(campaign, a, b)) is not None
    ]


def _map(campaign: Campaign, a: str, b: str) -> Any:
    import plotly.graph_objects as go

    if not campaign.measure:
        return None
    values = campaign.values[campaign.measure]
    x, across = _axis(campaign, a)
    y, down = _axis(campaign, b)
    worst = np.full((len(down), len(across)), np.nan)
    unstable = worst.copy()
    evaluated = ~np.isnan(values)
    np.fmax.at(worst, (y[evaluated], x[evaluated]), values[evaluated])
    unstable[y[campaign.lost], x[campaign.lost]] = 1.0  # one case is enough for a cell
    finite = np.where(np.isfinite(worst) & np.isnan(unstable), worst, np.nan)
    picture = theme.subplots(rows=1, cols=1)
    hover = f"{theme.plain(a)} %{{x}}<br>{theme.plain(b)} %{{y}}<br>"
    bar = {
        "title": {"text": theme.plain(campaign.measure), "side": "right"},
        "thickness": 10,
        "outlinewidth": 0,
    }
    if np.isfinite(finite).any():
        # cells next to instability would take all the colours
        highest = float(np.nanpercentile(finite, 90))
        picture.add_trace(
            go.Heatmap(
                x=across,
                y=down,
                z=_none(finite),
                zmin=float(np.nanmin(finite)),
                zmax=highest,
                colorscale=_SCALE,
                colorbar=bar,
                xgap=1,
                ygap=1,
                hovertemplate=f"{hover}worst %{{z:.4g}}<extra></extra>",
            )
        )
    if np.isfinite(unstable).any():
        picture.add_trace(
            go.Heatmap(
                x=across,
                y=down,
                z=_none(unstable),
                colorscale=((0, _DARK), (1, _DARK)),
                showscale=False,
                xgap=1,
                ygap=1,
                hovertemplate=f"{hover}unstable<extra></extra>",
            )
        )
    theme.dress(picture, max(220, 24 * len(down) + 60), legend=False)
    picture.update_xaxes(title_text=theme.plain(a), type="category")
    picture.update_yaxes(title_text=theme.plain(b), type="category")
    return picture


def _none(values: np.ndarray) -> list[list[float | None]]:
    return [[float(f"{v:.5g}") if np.isfinite(v) else None for v in row] for row in values]


def _shares(effects: Mapping[str, float]) -> Any:
    picture = theme.subplots(rows=1, cols=1)
    names = list(effects)[::-1]
    shares = [100 * effects[name] for name in names]
    picture.add_trace(
        {
            "type": "bar",
            "orientation": "h",
            "x": shares,
            "y": [theme.plain(name) for name in names],
            "marker": {"color": "#0072b2"},
            "text": [f"{share:.3g} %" for share in shares],
            "textposition": "auto",
            "hovertemplate": "%{y}: %{x:.3g} %<extra></extra>",
        }
    )
    theme.dress(picture, 28 * len(names) + 70, legend=False)
    picture.update_xaxes(
        title_text=f"Share of the variance [%], together {sum(shares):.3g} %", rangemode="tozero"
    )
    return picture


def _distribution(campaign: Campaign, machine: Machine) -> Any:
    """How many cases have which measure, and where the requirement is."""
    values = campaign.values[campaign.measure]
    finite = values[np.isfinite(values)]
    positive = bool((finite > 0).all()) and finite.max() > 3 * finite.min()
    edges = (np.geomspace if positive else np.linspace)(
        finite.min(), finite.max() * (1 + 1e-12) + (finite.max() == 0), 41
    )
    count, _ = np.histogram(finite, edges)
    picture = theme.subplots(rows=1, cols=1)
    picture.add_trace(
        {
            "type": "bar",
            "x": drawn((edges[1:] + edges[:-1]) / 2),
            "y": count.tolist(),
            "width": drawn(np.diff(edges)),
            "marker": {"color": "#0072b2"},
            "hovertemplate": "%{x:.4g}: %{y} cases<extra></extra>",
        }
    )
    limit = machine.requirements.sensitivity_peak if campaign.measure == PEAK else None
    if limit is not None:
        picture.add_vline(
            x=math.log10(limit) if positive else limit,
            line={"dash": "dash", "color": theme.LIMIT, "width": 1.2},
        )
    theme.dress(picture, 240, legend=False)
    unstable = int(campaign.lost.sum())
    beside = f" ({unstable} unstable cases beside)" if unstable else ""
    axis = theme.decades(float(edges[0]), float(edges[-1])) if positive else {}
    picture.update_xaxes(title_text=f"{theme.plain(campaign.measure)}{beside}", **axis)
    picture.update_yaxes(title_text="Cases", rangemode="tozero")
    return picture


def _parallel(campaign: Campaign) -> Any:
    import plotly.graph_objects as go

    order = campaign.worst_first
    if len(order) > _LINES:
        half = _LINES // 2
        order = np.concatenate(
            [order[:half], order[np.linspace(half, len(order) - 1, half).astype(int)]]
        )
    values = campaign.values[campaign.measure][order]
    finite = values[np.isfinite(values)]
    highest = float(finite.max())
    colour = np.where(np.isfinite(values), values, 1.1 * highest)
    columns: list[dict[str, Any]] = []
    for path, column in campaign.settings.items():
        label = (
            f"{theme.plain(path)} [{campaign.units[path]}]"
            if campaign.units[path]
            else theme.plain(path)
        )
        if column.dtype.kind == "f":
            columns.append({"label": label, "values": drawn(column[order])})
        else:
            which, names = _axis(campaign, path)
            columns.append(
                {
                    "label": label,
                    "values": which[order].tolist(),
                    "tickvals": list(range(len(names))),
                    "ticktext": names,
                }
            )
    end = " (unstable: at the top)" if campaign.lost[order].any() else ""
    columns.append({"label": f"{theme.plain(campaign.measure)}{end}", "values": drawn(colour)})
    for i, entry in enumerate(columns):  # long names would cover their neighbours
        entry["label"] = f"{i + 1}. {str(entry['label'])[-22:]}"
    picture = theme.subplots(rows=1, cols=1)
    picture.add_trace(
        go.Parcoords(
            dimensions=columns,
            labelside="bottom",
            line={"color": drawn(colour), "colorscale": _SCALE, "cmin": float(finite.min())},
            labelfont={"size": 11},
            tickfont={"size": 10},
        )
    )
    theme.dress(picture, 420, legend=False)
    picture.update_xaxes(visible=False)
    picture.update_yaxes(visible=False)
    picture.update_layout(margin={"t": 30, "b": 60, "l": 60, "r": 60})
    return picture


def case_page(task: str, key: str, settings: Mapping[str, Any], item: Subject) -> Page:
    """The page of one case, computed anew: its checks and curves, or its run."""
    facts = tuple(
        (path, in_words(value) if isinstance(value, float) else str(value))
        for path, value in settings.items()
    )
    if task in {"simulate", "identify"}:
        return record_page(
            run(item),
            item.machine,
            title=f"Case {key[:8]}: " + ", ".join(" ".join(pair) for pair in facts),
        )
    return verification_page(
        item.machine, [checks_of(item)], facts=facts, title=f"Case {key[:8]} of a campaign"
    )
