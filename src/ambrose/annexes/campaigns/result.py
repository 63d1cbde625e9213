"""What a campaign gave: its rows as columns, as an xarray Dataset, as a table."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.annexes.campaigns.plan import Plan, Value, number_of
from ambrose.annexes.campaigns.run import ROWS, rows_of
from ambrose.annexes.campaigns.tasks import PEAK
from ambrose.annexes.campaigns.variance import main_effects
from ambrose.core.checks import InvalidInput
from ambrose.core.presentation import Presented, data_frame
from ambrose.machine.atomic_write import draft_of, write_text

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
