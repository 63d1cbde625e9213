"""The pictures of the gallery: pages that the commands write, and the figures of the examples, photographed by a browser.

python -m docs_build.thumbnails             all of them anew, into docs/images/gallery/ (some minutes; it needs chromium)
python -m docs_build.thumbnails map 02      some of them, by the name of the picture

The commands run in one folder, in the order of CARDS; what one writes the next ones read.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from docs_build import DOCS, ROOT
from docs_build.gallery import EXAMPLES, plotly_library, run_of
from docs_build.report_picture import PICTURE

FOLDER = DOCS / "images" / "gallery"
SIZE = (480, 320)  # px
WIDTH = 1240  # px, of a page before it is scaled down


@dataclass(frozen=True)
class Card:
    """A page that a command writes: its picture's name, title and a sentence, where to read on, how it is made.

    commands: the last one writes page; top [px]: where the picture begins on a page of 1240 px.
    """

    name: str
    title: str
    text: str
    link: str
    commands: tuple[str, ...]
    page: str
    top: int


PID = "synthesize seal-rig --method pid -o pid.json"
CARDS = (
    Card(
        "study",
        "The report",
        "Every controller at every operating point, on one page.",
        "how-to/report.md",
        (),
        "",
        0,
    ),
    Card(
        "map",
        "Poles over pressure",
        "Where stability ends, and what the tolerances do to a pulse.",
        "how-to/map.md",
        (PID, "map seal-rig --controller pid.json -o map.html"),
        "map.html",
        510,
    ),
    Card(
        "run",
        "A run on the virtual rig",
        "Distance, orbits, waterfall, currents, the rotor in motion.",
        "how-to/simulate.md",
        (
            PID,
            "simulate seal-rig --controller pid.json --scenario levitation -o run.h5 --report run.html",
        ),
        "run.html",
        690,
    ),
    Card(
        "identify",
        "An identification",
        "Values with intervals, measured over model, residual tests.",
        "how-to/identify.md",
        (
            PID,
            "simulate seal-rig --controller pid.json --scenario prbs -o prbs.h5",
            "identify seal-rig prbs.h5 --controller pid.json -o identified.toml --report identify.html",
        ),
        "identify.html",
        860,
    ),
    Card(
        "accept",
        "Acceptance by measurement",
        "Sensitivity with its band and the zones of the standard.",
        "how-to/accept.md",
        (
            PID,
            "simulate seal-rig --controller pid.json --scenario acceptance -o measured.h5",
            "accept seal-rig pid.json measured.h5 -o accept.html",
        ),
        "accept.html",
        470,
    ),
    Card(
        "frf",
        "Frequency responses",
        "Magnitude, phase, error and coherence of every axis.",
        "how-to/frf.md",
        (
            PID,
            "simulate seal-rig --controller pid.json --scenario acceptance -o measured.h5",
            "frf seal-rig measured.h5 --controller pid.json -o frf.html",
        ),
        "frf.html",
        590,
    ),
    Card(
        "monitor",
        "A seal that is watched",
        "Its pressure against time, with an interval.",
        "how-to/monitor.md",
        (
            PID,
            "simulate seal-rig --controller pid.json --scenario monitor -o watched.h5",
            "monitor seal-rig pid.json watched.h5 -o monitor.html",
        ),
        "monitor.html",
        570,
    ),
)


def with_picture():
    """The examples that have a picture."""
    return [
        path
        for path in sorted(EXAMPLES.glob("[0-9]*.py"))
        if "def picture(" in path.read_text(encoding="utf-8")
    ]


def thumbnail(name):
    """The picture's path below docs/."""
    return f"images/gallery/{name}.png"


def number(path):
    """The name of an example's picture: "02"."""
    return path.name.partition("_")[0]


def photograph(page, top, target):
    """A picture of SIZE of a page, from ``top`` [px] on, scaled down so that WIDTH fits."""
    browser = shutil.which("chromium") or shutil.which("chrome") or shutil.which("google-chrome")
    scale = SIZE[0] / WIDTH
    style = f"width:{WIDTH}px;height:4000px;border:0;transform-origin:0 0;transform:scale({scale:.5f}) translateY({-top}px)"
    frame = f'<body style="margin:0;overflow:hidden"><iframe style="{style}" src="{page.resolve().as_uri()}"></iframe></body>'
    with tempfile.TemporaryDirectory() as folder:
        wrapper = Path(folder) / "frame.html"
        wrapper.write_text(f"<!doctype html>{frame}", encoding="utf-8")
        subprocess.run(
            [
                browser,
                "--headless",
                "--no-sandbox",
                "--hide-scrollbars",
                "--virtual-time-budget=5000",
                f"--window-size={SIZE[0]},{SIZE[1]}",
                f"--screenshot={target}",
                wrapper.as_uri(),
            ],
            check=True,
            capture_output=True,
        )


def make(card, folder):
    """The picture of a page; ``folder``: where the commands run, once each."""
    from docs_build.recipes import run

    if card.name == "study":
        page = folder / "study.html"
        page.write_text(
            f'<img src="{PICTURE.resolve().as_uri()}" style="width:{WIDTH}px">', encoding="utf-8"
        )
    else:
        page = folder / card.page
        for command in card.commands:
            done = folder / f".done-{command.replace('/', '-')}"
            if not done.exists():
                run(*command.split(), folder=folder)
                done.touch()
    photograph(page, card.top, FOLDER / f"{card.name}.png")


def make_example(path, folder):
    """The picture of an example's figure."""
    library = folder / "plotly.min.js"
    if not library.exists():
        library.write_text(plotly_library(), encoding="utf-8")
    page = folder / f"{path.stem}.html"
    body = f'<div style="width:{WIDTH - 40}px;height:830px">{run_of(path)["picture"]}</div>'
    page.write_text(
        f'<meta charset="utf-8"><script src="plotly.min.js"></script>{body}', encoding="utf-8"
    )
    photograph(page, 0, FOLDER / f"{number(path)}.png")


def main(names):
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    FOLDER.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(os.environ.get("THUMBNAIL_PAGES", scratch)).resolve()
        for card in CARDS:
            if not names or card.name in names:
                print(card.name, file=sys.stderr)
                make(card, folder)
        for path in with_picture():
            if not names or number(path) in names:
                print(path.relative_to(ROOT), file=sys.stderr)
                make_example(path, folder)


if __name__ == "__main__":
    main(sys.argv[1:])
