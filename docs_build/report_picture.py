"""``python -m docs_build.report_picture out/seal-rig/report.html``: the picture of the report on
the first page.

It carries the stored figures that it shows in a text chunk of the PNG: tests/docs/test_figures.py
notices when it is stale.
"""

import json
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

from docs_build import DOCS
from docs_build.figures import stored

PICTURE = DOCS / "images" / "report.png"
SIZE = "1060,735"  # the verdict, the map, the head
KEYWORD = b"figures\0"


def shown():
    """{controller: its worst sensitivity as the report prints it}, of the stored study."""
    study = stored()["study"]
    worst = {
        key.removesuffix(".worst"): value for key, value in study.items() if key.endswith(".worst")
    }
    return {
        name: value if isinstance(value, str) else f"{value:.3g}" for name, value in worst.items()
    }


def chunks(data):
    """(kind, content) of every chunk of a PNG (ISO 15948, section 5)."""
    at = 8
    while at < len(data):
        size, kind = struct.unpack(">I4s", data[at : at + 8])
        yield kind, data[at + 8 : at + 8 + size]
        at += size + 12


def carried(path=PICTURE):
    """What a picture says that it shows; {} where it says nothing."""
    texts = (
        content
        for kind, content in chunks(path.read_bytes())
        if kind == b"tEXt" and content.startswith(KEYWORD)
    )
    return json.loads(next(texts, KEYWORD + b"{}").removeprefix(KEYWORD))


def stamped(data, figures):
    """A PNG with the figures in a text chunk, before its last chunk."""
    body = b"tEXt" + KEYWORD + json.dumps(figures).encode("ascii")
    return (
        data[:-12]
        + struct.pack(">I", len(body) - 4)
        + body
        + struct.pack(">I", zlib.crc32(body))
        + data[-12:]
    )


def main(report):
    html, figures = Path(report).read_text(encoding="utf-8"), shown()
    missing = [f"{name} {value}" for name, value in figures.items() if value not in html]
    if missing:
        remedy = "run python -m docs_build.figures --write study"
        sys.exit(f"{report} does not show the stored figures {', '.join(missing)}; {remedy}")
    browser = shutil.which("chromium") or shutil.which("chrome") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder:
        raw = Path(folder) / "report.png"
        subprocess.run(
            [
                browser,
                "--headless",
                "--no-sandbox",
                "--hide-scrollbars",
                "--virtual-time-budget=3000",
                f"--window-size={SIZE}",
                f"--screenshot={raw}",
                Path(report).resolve().as_uri(),
            ],
            check=True,
            capture_output=True,
        )
        PICTURE.write_bytes(stamped(raw.read_bytes(), figures))


if __name__ == "__main__":
    main(*sys.argv[1:])
