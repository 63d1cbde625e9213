"""`make bench`: every bench_*.py in this folder, side by side with its peer in one run; a table and
benchmarks.json.

A module has ``run() -> list[dict]`` with the keys name, ours [s], peer [s] or None, peer_name,
error (accuracy in words or a number) and optionally target; series and size, where a time grows
with a number. Name modules to run only those: ``python -m benchmarks norms response``. Every run is
appended to benchmarks.jsonl, and what fell against its peer is named (history.py).
"""

from __future__ import annotations

import importlib
import json
import os
import platform
import resource
import sys
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one thread: figures that compare

from benchmarks import history


def main(names: list[str]) -> int:
    here = Path(__file__).parent
    found = sorted(path.stem for path in here.glob("bench_*.py"))
    wanted = [name if name.startswith("bench_") else f"bench_{name}" for name in names] or found
    unknown = sorted(set(wanted) - set(found))
    if unknown:
        print(f"no benchmark {', '.join(unknown)}; there are {', '.join(found)}", file=sys.stderr)
        return 2
    rows: list[dict[str, Any]] = []
    for name in wanted:
        print(f"{name} ...", file=sys.stderr)
        rows += [
            {"module": name, **row} for row in importlib.import_module(f"benchmarks.{name}").run()
        ]
    show(rows)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"largest memory {memory:.0f} MB")
    result = {
        "python": platform.python_version(),
        "machine": platform.machine(),
        "memory_mb": memory,
        "rows": rows,
    }
    Path("benchmarks.json").write_text(json.dumps(result, indent=1, default=str) + "\n")
    for series, power in history.exponents(rows).items():
        print(f"{series}: time grows with the power {power:.2f}")
    for name, share in history.keep(rows, Path("benchmarks.jsonl")):
        print(f"slower against its peer than in the last runs, by the factor {share:.2f}: {name}")
    return 0


def show(rows: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Seconds, medians of repeated runs, one thread")
    for column in ("what", "ours", "peer", "ratio", "peer is", "accuracy", "target"):
        table.add_column(column, overflow="fold")
    for row in rows:
        ours, peer = row["ours"], row.get("peer")
        ratio = f"{peer / ours:.3g}x" if peer and ours else ""
        peer_text = "" if peer is None else f"{peer:.4g}"
        accuracy = row.get("error")
        shown = f"{accuracy:.2g}" if isinstance(accuracy, float) else str(accuracy or "")
        name = str(row.get("peer_name") or "")
        table.add_row(
            row["name"], f"{ours:.4g}", peer_text, ratio, name, shown, str(row.get("target", ""))
        )
    Console(width=160).print(table)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
