"""What `make bench` keeps of every run: one line of JSON per run in benchmarks.jsonl, drawn in
benchmarks.svg.

Computers differ, and one computer differs from hour to hour, so that a figure is compared by its
ratio to the peer of the same run; a figure without a peer has as its peer a fixed piece of linear
algebra, timed in the same run. A ratio that is more than 20 % below the median of the last five
runs that knew the figure is named. Figures of one ``series``, each with its ``size``, give the
exponent with which the time grows.
"""

from __future__ import annotations

import html
import json
import re
import subprocess
import time
from collections import defaultdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

FALL = 0.2  # of a ratio to the peer, from which on it is named
_LAST = 5  # runs that a figure is compared with
# of the picture [px]
_WIDTH = 900
_LINE = 22
_NAME = 560


def yardstick(repeats: int = 9) -> float:
    """The least time [s] of a fixed piece of linear algebra: eigenvalues, a product, small
    factorisations.
    """
    rng = np.random.default_rng(0)
    A, small = rng.standard_normal((120, 120)), rng.standard_normal((2000, 4, 4))
    best = np.inf
    for _ in range(repeats):
        start = time.perf_counter()
        np.linalg.eigvals(A)
        np.linalg.inv(small)
        A @ A
        best = min(best, time.perf_counter() - start)
    return float(best)


def exponents(rows: list[dict[str, Any]]) -> dict[str, float]:
    """{series: p} where the time grows as size^p, by least squares on logarithms; series of three
    sizes or more.
    """
    series = defaultdict(list)
    for row in rows:
        if row.get("series") and row["ours"] > 0:
            series[row["series"]].append((np.log(row["size"]), np.log(row["ours"])))
    return {
        name: float(np.polyfit(*np.array(points).T, 1)[0])
        for name, points in series.items()
        if len(points) > 2
    }


def entry(rows: list[dict[str, Any]], unit: float) -> dict[str, Any]:
    """One run: commit, time, {figure: ratio of its peer's time to its own} and the exponents. unit
    [s]: of ``yardstick``.
    """
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    )
    ratios = {
        key(row): float((row.get("peer") or unit) / row["ours"]) for row in rows if row["ours"]
    }
    when = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "commit": commit.stdout.strip(),
        "when": when,
        "ratios": ratios,
        "exponents": exponents(rows),
    }


def key(row: dict[str, Any]) -> str:
    """What a figure is called in every run: its name without a speed that it may tell."""
    module, name = (
        row["module"].removeprefix("bench_"),
        re.sub(r": [0-9.]+ s/s", "", row["name"]).strip(),
    )
    return name if name.startswith(module) else f"{module}: {name}"


def falls(past: list[dict[str, Any]], new: dict[str, Any]) -> list[tuple[str, float]]:
    """(figure, its ratio over the median of the last runs) of those that fell by more than 20 %."""
    found = []
    for name, ratio in new["ratios"].items():
        known = [run["ratios"][name] for run in past if name in run["ratios"]][-_LAST:]
        if known and ratio < (1 - FALL) * np.median(known):
            found.append((name, float(ratio / np.median(known))))
    return found


def keep(rows: list[dict[str, Any]], path: Path) -> list[tuple[str, float]]:
    """Append a run to the history at ``path``, draw it beside that as .svg, and return what
    fell.
    """
    past = read(path)
    new = entry(rows, yardstick())
    with path.open("a", encoding="utf-8") as file:
        file.write(json.dumps(new) + "\n")
    path.with_suffix(".svg").write_text(drawn([*past, new]), encoding="utf-8")
    return falls(past, new)


def read(path: Path) -> list[dict[str, Any]]:
    """The runs of a history, the oldest first; none where there is no file yet."""
    return (
        [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        if path.exists()
        else []
    )


def drawn(runs: list[dict[str, Any]]) -> str:
    """A line per figure: its ratio to the peer over the runs, from half to twice the median, and
    the last one in numbers.
    """
    names = sorted({name for run in runs for name in run["ratios"]})
    step = (_WIDTH - _NAME - 90) / max(1, len(runs) - 1)
    parts = []
    for i, name in enumerate(names):
        values = [(j, run["ratios"][name]) for j, run in enumerate(runs) if name in run["ratios"]]
        middle, base = np.median([value for _, value in values]), 60 + i * _LINE
        shown = [
            (_NAME + j * step, base - 8 * np.clip(np.log2(value / middle), -1, 1))
            for j, value in values
        ]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in shown)
        x, y = shown[-1]
        fallen = values[-1][1] < (1 - FALL) * middle
        ink = "#a3341f" if fallen else "#1c2329"
        parts += [
            f'<text x="10" y="{base + 4}" fill="{ink}">{html.escape(name)}</text>',
            f'<polyline points="{line}" fill="none" stroke="{ink}"/><circle cx="{x:.1f}" '
            f'cy="{y:.1f}" r="2.5" fill="{ink}"/>',
            f'<text x="{_WIDTH - 10}" y="{base + 4}" fill="{ink}" '
            f'text-anchor="end">{values[-1][1]:.3g}</text>',
        ]
    height, span = (
        80 + len(names) * _LINE,
        f"{runs[0]['commit']} to {runs[-1]['commit']}, {len(runs)} runs",
    )
    title = (
        f"Time of the peer over ours, {html.escape(span)}; each line from half to twice its median"
    )
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{height}" '
        'font-family="Helvetica" font-size="11">'
    )
    ground = '<rect width="100%" height="100%" fill="white"/>'
    return (
        head
        + ground
        + f'<text x="10" y="28" font-size="14">{title}</text>'
        + "".join(parts)
        + "</svg>\n"
    )
