"""`ambrose study` of both machines of the thesis in a process of its own: processor time, memory,
size of the page.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

_TARGETS = {"seal-rig": "< 40 s, page < 5 MB", "turboexpander": "< 90 s, page < 5 MB"}


def run() -> list[dict[str, Any]]:
    """One row per machine: name, ours [CPU s, user and system], no peer, and the page's size in
    words.
    """
    return [_study(name) for name in _TARGETS]


def _study(name: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(
            [sys.executable, "-m", "ambrose", "study", name, "-o", folder],
            check=False,
            capture_output=True,
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        size = (Path(folder) / "report.html").stat().st_size / 1e6
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    error = f"page {size:.2f} MB, {after.ru_maxrss / 1024:.0f} MB of memory at most"
    return {
        "name": f"study of {name}",
        "ours": spent,
        "peer": None,
        "peer_name": "",
        "error": error,
        "target": _TARGETS[name],
    }
