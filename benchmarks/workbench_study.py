"""How quick the workbench is in a browser: its first page, from a slider to redrawn curves, frames
of the live rig at rest and knocked.

python -m benchmarks.workbench_study [MACHINE ...]

Needs chromium and playwright; half a minute for each machine, outside CI.
"""

from __future__ import annotations

import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from ambrose.annexes.workbench.project import Project, begin
from ambrose.machine.file.toml import bundled_machines

SLIDES = 12
SECONDS = 8  # of the live rig, at rest and knocked
_SLIDE = """async (i) => {
  const input = document.querySelector('input[type=range]');
  const begun = performance.now();
  input.value = Number(input.value) + 0.01 * (i % 2 ? 1 : -1);
  input.dispatchEvent(new Event('input'));
  await new Promise((done) => {
    const watch = new MutationObserver(() => {
      watch.disconnect();
      requestAnimationFrame(() => requestAnimationFrame(done));
    });
    watch.observe(document.querySelector('main'), { childList: true, subtree: true });
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
        found["slider, median [ms]"] = statistics.median(slides)
        found["slider, worst [ms]"] = max(slides[1:])
        page.evaluate("location.hash = '#live'")
        page.wait_for_selector("canvas", timeout=120_000)
        page.wait_for_timeout(3000)
        for state in ("rest", "knocked"):
            found |= _live(page, server.pid, state)
        page.close()
        server.terminate()
    return found


def _live(page: Any, pid: int, state: str) -> dict[str, float]:
    """Frames a second, share of real time, share of a processor that the server takes."""
    frames, pace = [], []
    begun, used = time.monotonic(), _processor(pid)
    for _ in range(SECONDS):
        if state == "knocked":
            page.locator("canvas").first.press("ArrowUp")
        page.wait_for_timeout(1000)
        text = page.locator(".facts").text_content()
        frames.append(float(re.findall(r"frames (\d+)", text)[0]))
        pace.append(float(re.findall(r"real time ([\d.]+)", text)[0]))
    share = (_processor(pid) - used) / (time.monotonic() - begun)
    return {
        f"frames/s, {state}": statistics.median(frames),
        f"real time, {state}": min(pace),
        f"processor, {state}": share,
    }


def _processor(pid: int) -> float:
    """Processor time of a process [s] (Linux)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    """A row of a table for each machine."""
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
