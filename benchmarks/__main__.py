"""`make bench`: every bench_*.py in this folder, side by side with its peer in one run; a table and
benchmarks.json.

A module has ``run(smoke: bool) -> Iterable[dict]`` with the keys name, ours [s], peer [s] or None,
peer_name, error (accuracy in words or a number) and optionally target; series and size, where a
time grows with a number. With ``smoke`` the same code runs on sizes so small that all modules
together take a minute or two: that they run is tested, their figures mean nothing. Name modules to
run only those: ``python -m benchmarks norms response``.

A module that fails is a row that says why ("failed"), and the exit status is 1; the rows that it
gave before, and those of the other modules, are kept: benchmarks.json is written anew after each
row. Every run is appended to benchmarks.jsonl, and what fell against its peer is named
(history.py). A smoke run writes no file.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import platform
import resource
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread: figures that compare

from benchmarks import history

RESULT, HISTORY = Path("benchmarks.json"), Path("benchmarks.jsonl")


def modules() -> list[str]:
    """The names of all benchmark modules in this folder."""
    return sorted(path.stem for path in Path(__file__).parent.glob("bench_*.py"))


def main(arguments: list[str]) -> int:
    """Runs what ``arguments`` name; the exit status: 0, 1 where a module failed, 2 for a wrong
    name.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Speed beside peers.")
    parser.add_argument(
        "names", nargs="*", metavar="MODULE", help="run only these; all without one"
    )
    parser.add_argument("--smoke", action="store_true", help="tiny sizes, no files: does it run?")
    options = parser.parse_args(arguments)
    known = modules()
    wanted = [name if name.startswith("bench_") else f"bench_{name}" for name in options.names]
    if unknown := sorted(set(wanted) - set(known)):
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(known)}", file=sys.stderr)
        return 2
    rows: list[dict[str, Any]] = []
    for name in wanted or known:
        print(f"{name} ...", file=sys.stderr)
        for row in rows_of(name, options.smoke):
            rows.append(row)
            if not options.smoke:
                write(rows)
    show(rows)
    print(f"largest memory {largest_memory():.0f} MB")
    timed = [row for row in rows if "failed" not in row]
    if not options.smoke:
        for series, power in history.exponents(timed).items():
            print(f"{series}: time grows with the power {power:.2f}")
        for name, share in history.keep(timed, HISTORY):
            print(
                f"slower against its peer than in the last runs, by the factor {share:.2f}: {name}"
            )
    return int(len(timed) < len(rows))


def rows_of(name: str, smoke: bool = False) -> Iterator[dict[str, Any]]:
    """The rows of a module as they come; where it fails, those before, then one with the reason."""
    try:
        for row in importlib.import_module(f"benchmarks.{name}").run(smoke=smoke):
            yield {"module": name, **row}
    except Exception as error:  # the other modules run on
        traceback.print_exc()
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = f"{type(error).__name__}: {error} ({Path(place.filename).name}:{place.lineno})"
        yield {"module": name, "name": name, "failed": reason}


def largest_memory() -> float:
    """The largest memory [MB] of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def write(rows: list[dict[str, Any]]) -> None:
    """benchmarks.json with the rows so far."""
    head = {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "memory_mb": largest_memory(),
    }
    RESULT.write_text(json.dumps({**head, "rows": rows}, indent=1, default=str) + "\n")


def show(rows: list[dict[str, Any]]) -> None:
    """All rows as a table."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Seconds, medians of repeated runs, one thread")
    for column in ("what", "ours", "peer", "ratio", "peer is", "accuracy", "target"):
        table.add_column(column, overflow="fold")
    for row in rows:
        if "failed" in row:
            table.add_row(row["name"], "failed", "", "", "", row["failed"], "", style="red")
            continue
        ours, peer = row["ours"], row.get("peer")
        ratio = f"{peer / ours:.3g}x" if peer and ours else ""
        peer_text = "" if peer is None else f"{peer:.4g}"
        accuracy = row.get("error")
        shown = f"{accuracy:.2g}" if isinstance(accuracy, float) else str(accuracy or "")
        name, target = str(row.get("peer_name") or ""), str(row.get("target", ""))
        table.add_row(row["name"], f"{ours:.4g}", peer_text, ratio, name, shown, target)
    Console(width=160).print(table)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
