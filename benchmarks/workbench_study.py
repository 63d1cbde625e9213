"""How quick the workbench is in a browser: its first page, from a handle to redrawn curves, frames
of the live rig at rest and knocked; and what a frame takes of a processor, in the server and in all
processes of the browser, which holds on a busy computer as well.

python -m benchmarks.workbench_study [MACHINE ...]
python -m benchmarks.workbench_study --hour [MACHINE]

The first needs chromium and playwright; half a minute for each machine, outside CI. With --hour: the
memory of a live rig that is pushed, turned, broken and recorded every second of an hour of its own
time, about five minutes of a processor.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from ambrose.annexes.workbench.project import Project, begin
from ambrose.machine.file.toml import bundled_machines

SLIDES = 12
_FRAMES = 40  # a second, as the server asks for
SECONDS = 8  # of the live rig, at rest and knocked
_SLIDE = """async (i) => {
  const dot = document.querySelector('.handle');
  const begun = performance.now();
  dot.dispatchEvent(new KeyboardEvent('keydown', { key: i % 2 ? 'ArrowUp' : 'ArrowDown' }));
  await new Promise((done) => {
    const watch = new MutationObserver(() => {
      watch.disconnect();
      requestAnimationFrame(() => requestAnimationFrame(done));
    });
    watch.observe(document.querySelector('.blocks'), { childList: true, subtree: true });
  });
  return performance.now() - begun;
}"""


def measure(machine: str, browser: Any, folder: Path) -> dict[str, float]:
    """All figures of one machine."""
    begin(Project(folder), machine)
    words = [sys.executable, "-m", "ambrose", "workbench", str(folder), "--no-browser"]
    begun = time.monotonic()
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as server:
        address = re.search(r"http\S+", server.stdout.readline() if server.stdout else "")
        assert address is not None
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(address.group() + "#controllers")
        page.wait_for_selector("nav a")
        found = {"first page [s]": time.monotonic() - begun}
        page.wait_for_selector("figure svg", timeout=120_000)
        slides = []
        for i in range(SLIDES):
            slides.append(page.evaluate(_SLIDE, i))
            page.wait_for_timeout(200)
        found["handle, median [ms]"] = statistics.median(slides)
        found["handle, worst [ms]"] = max(slides[1:])
        page.evaluate("location.hash = '#live'")
        page.wait_for_selector("canvas", timeout=120_000)
        page.wait_for_timeout(3000)
        for state in ("rest", "knocked"):
            found |= _live(page, server.pid, state)
        page.close()
        server.terminate()
    return found


def _live(page: Any, server: int, state: str) -> dict[str, float]:
    """Frames a second, share of real time, share of a processor that the server takes, processor
    time of a frame.
    """
    frames, pace = [], []
    begun, used = time.monotonic(), _processor(server)
    drawn_by = _browser_processes()
    before = sum(map(_processor, drawn_by))
    for _ in range(SECONDS):
        if state == "knocked":
            page.locator("canvas").first.press("ArrowUp")
        page.wait_for_timeout(1000)
        text = page.locator(".facts").text_content()
        frames.append(float(re.findall(r"frames (\d+)", text)[0]))
        pace.append(float(re.findall(r"real time ([\d.]+)", text)[0]))
    gone = time.monotonic() - begun
    served, drawn = _processor(server) - used, sum(map(_processor, drawn_by)) - before
    count = max(statistics.fmean(frames) * gone, 1)
    return {
        f"frames/s, {state}": statistics.median(frames),
        f"real time, {state}": min(pace),
        f"processor, {state}": served / gone,
        f"server [ms/frame], {state}": 1e3 * served / count,
        f"browser [ms/frame], {state}": 1e3 * drawn / count,
    }


def _browser_processes() -> list[int]:
    """All processes that this one started, and theirs, which are a browser's (Linux)."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = path.read_text().rpartition(")")[2].split()
            parents[int(path.parent.name)] = int(fields[1])
    found, ours = [], {os.getpid()}
    for _ in range(6):  # generations
        ours |= {child for child, parent in parents.items() if parent in ours}
    for number in ours:
        with suppress(OSError):
            if b"chromium" in Path(f"/proc/{number}/cmdline").read_bytes().split(b"\0")[0]:
                found.append(number)
    return found


def _processor(pid: int) -> float:
    """Processor time of a process [s] (Linux), 0 where it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def hour(machine: str, folder: Path) -> None:
    """The memory [MB] every five minutes of an hour of the rig's time, as it is printed."""
    from ambrose.annexes.workbench import live

    rng = random.Random(1)
    begin(Project(folder), machine)
    now = 0.0
    clock = SimpleNamespace(perf_counter=lambda: now, thread_time=time.thread_time)
    vars(live)["time"] = clock
    session = live.LiveSession(Project(folder))
    session.frame()
    used, drawn = time.process_time(), 0
    for second in range(3600):
        for order in _orders(session, rng, second):
            session.do(order)
        for _ in range(_FRAMES):
            now += 1.0 / _FRAMES
            drawn += len(live.packed(*session.frame()))
        if session.rig.ended or second % 300 == 0:
            size = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
            spent = time.process_time() - used
            print(
                f"{session.rig.time:7.1f} s: {size / 1e6:.1f} MB, {drawn / 1e6:.0f} MB of frames, "
                f"{spent:.1f} s of a processor, {session.rig.ended or 'floats or lies'}",
                flush=True,
            )
        for kept in (folder / "records").glob("*.h5"):
            kept.unlink()
        if session.rig.ended:
            session = live.LiveSession(Project(folder))


def _orders(session: Any, rng: random.Random, second: int) -> list[dict[str, Any]]:
    """What a restless hand does in a second."""
    ranges, stations, axes = session.ranges, session.rig.stations, session.rig.axes
    push = 0.5 * ranges.impulse
    knock = {"do": "knock", "station": rng.choice(stations)}
    turned = [
        {**knock, "x": rng.uniform(-push, push), "y": rng.uniform(-push, push)},
        {"do": "speed", "value": rng.uniform(0, 0.1) * ranges.speed},
        {"do": "gain", "value": rng.uniform(0.9, 1.1)},
        {"do": "unbalance", "station": rng.choice(stations), "value": 0.1 * ranges.unbalance},
        {"do": "excite", "value": rng.choice([0.0, ranges.excitation])},
        {"do": "switch", "controller": session.controller},
        {"do": rng.choice(["record", "stop"])},
    ]
    if second % 600 == 550:  # a rotor that touches takes two to three seconds for one
        return [{"do": "fail", "what": "sensor", "axis": rng.choice(axes)}, {"do": "drop"}]
    if second % 600 == 551:
        return [{"do": "lift"}, {"do": "stop"}]
    return [turned[second % len(turned)]]


def main() -> None:
    """A row of a table for each machine, or the memory of an hour."""
    if sys.argv[1:2] == ["--hour"]:
        with tempfile.TemporaryDirectory() as folder:
            hour((sys.argv[2:] or ["seal-rig"])[0], Path(folder))
        return
    from playwright.sync_api import sync_playwright

    chromium = shutil.which("chromium")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for machine in sys.argv[1:] or bundled_machines():
            with tempfile.TemporaryDirectory() as folder:
                found = measure(machine, browser, Path(folder))
            print(machine, {name: round(value, 2) for name, value in found.items()}, flush=True)


if __name__ == "__main__":
    main()
