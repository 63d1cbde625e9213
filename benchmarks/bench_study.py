"""`ambrose study` of both machines of the thesis and `ambrose verify` of two large ones, each in a
process of its own: processor time, memory, size of the page.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_TARGETS = {"seal-rig": "< 40 s, page < 5 MB", "turboexpander": "< 90 s, page < 5 MB"}
_VERIFIED = {"three-bearing-train": "< 20 s", "process-compressor": "< 20 s"}


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """One row per machine: name, ours [CPU s, user and system], no peer, and the page's size in
    words.
    """
    if smoke:  # the same measurement of a command that takes a second
        seconds, memory = _spent("check", "seal-rig")
        yield _row("check of seal-rig", seconds, f"{memory:.0f} MB of memory at most")
        return
    for name in _TARGETS:
        yield _study(name)
    for name in _VERIFIED:
        yield _verify(name)


def _study(name: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as folder:
        seconds, memory = _spent("study", name, "-o", folder)
        size = (Path(folder) / "report.html").stat().st_size / 1e6
    error = f"page {size:.2f} MB, {memory:.0f} MB of memory at most"
    return _row(f"study of {name}", seconds, error, _TARGETS[name])


def _verify(name: str) -> dict[str, Any]:
    """The machine's PID at 10 kHz, on the full plants and over the tolerances."""
    with tempfile.TemporaryDirectory() as folder:
        controller = str(Path(folder) / "pid.json")
        _spent("synthesize", name, "--method", "pid", "-o", controller)
        seconds, memory = _spent("verify", name, controller, "--rate-hz", "10000")
    error = f"{memory:.0f} MB of memory at most"
    return _row(f"verify of {name}, PID at 10 kHz", seconds, error, _VERIFIED[name])


def _spent(*arguments: str) -> tuple[float, float]:
    """Processor time [s] of a command in a process of its own, and its largest memory [MB].

    A failed check (status 1) is a result; raises RuntimeError with the message for status 2.
    """
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "ambrose", *arguments]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode not in {0, 1}:
        raise RuntimeError(
            f"ambrose {' '.join(arguments)} ended with {done.returncode}: "
            f"{done.stderr.strip()[-300:]}"
        )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return seconds, after.ru_maxrss / 1024


def _row(name: str, seconds: float, error: str, target: str = "") -> dict[str, Any]:
    return {
        "name": name,
        "ours": seconds,
        "peer": None,
        "peer_name": "",
        "error": error,
        "target": target,
    }
