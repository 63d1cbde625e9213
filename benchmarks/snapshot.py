"""What the program says, every number of it: both bundled machines through every command, compared
before and after a change.

python -m benchmarks.snapshot -o before.json [--quick]    # minutes; --quick leaves the studies out
python -m benchmarks.snapshot --compare before.json after.json

It sees the command line only, so that it outlives any move of the code behind it. Files are taken
apart to their leaves: JSON and TOML by key, records by signal (hash, range, mean), code by the
numbers in it, pages by their count. Dates and versions are left out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat

_DATES = re.compile(r"\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d)?(?:\.\d+)?(?:Z|\+00:00| UTC)?)?")
_NUMBER = re.compile(r"-?\d+\.?\d*(?:[eE][-+]?\d+)?")
_UNSTABLE_KEYS = {"date", "package_version", "created"}
_ENVIRONMENT = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

STUDIES = [
    ["study", name, "-o", f"{name}-study", "--json"] for name in ("seal-rig", "turboexpander")
]


def commands(*, quick: bool) -> Iterator[tuple[str, list[str]]]:
    """(name, arguments) of every run; later ones take what earlier ones left in the working
    folder.
    """
    yield "machines", ["machines", "--json"]
    for machine in ("seal-rig", "turboexpander"):
        yield f"{machine} check", ["check", machine, "--json"]
        yield f"{machine} pid", ["synthesize", machine, "-o", f"{machine}-pid.json", "--json"]
        yield (
            f"{machine} hinf",
            ["synthesize", machine, "--method", "hinf", "-o", f"{machine}-hinf.json", "--json"],
        )
        yield (
            f"{machine} verify",
            ["verify", machine, "--controller", f"{machine}-pid.json", "--json"],
        )
        yield (
            f"{machine} verify hinf",
            ["verify", machine, "--controller", f"{machine}-hinf.json", "--json"],
        )
        for scenario in ("levitation", "impulse-parallel"):
            run = [
                "simulate",
                machine,
                "--controller",
                f"{machine}-pid.json",
                "--scenario",
                scenario,
                "--json",
            ]
            yield (
                f"{machine} {scenario}",
                [*run, "-o", f"{machine}-{scenario}.h5", "--report", f"{machine}-{scenario}.html"],
            )
            if scenario != "levitation":
                yield (
                    f"{machine} {scenario} linear",
                    [*run, "--linear", "-o", f"{machine}-{scenario}-linear.csv"],
                )
        for target in ("c", "mat", "fmu", "st"):
            options = ["--sources-only"] if target == "fmu" else []
            export = [
                "export",
                f"{machine}-pid.json",
                "--to",
                target,
                "-o",
                f"{machine}-{target}",
                "--force",
                "--json",
            ]
            yield f"{machine} export {target}", [*export, *options]
        fixed = [
            "export",
            f"{machine}-pid.json",
            "--to",
            "c",
            "--arithmetic",
            "fixed32",
            "-o",
            f"{machine}-fixed",
            "--force",
            "--json",
        ]
        yield f"{machine} export fixed", ["export", f"{machine}-pid.json", *fixed]
    rig = ["simulate", "seal-rig", "--controller", "seal-rig-pid.json", "--json"]
    learn = ["identify", "seal-rig", "--json"]
    yield "prbs", [*rig, "--scenario", "prbs", "-o", "prbs.h5"]
    yield "convert", ["convert", "prbs.h5", "-o", "prbs.csv", "--json"]
    for method in ("closed-loop", "youla"):
        found = [
            *learn,
            "prbs.h5",
            "--method",
            method,
            "--controller",
            "seal-rig-pid.json",
            "-o",
            f"{method}.toml",
        ]
        yield f"identify {method}", [*found, "--report", f"{method}.html"]
    yield "static loads", [*rig, "--scenario", "static-loads-both", "-o", "static.h5"]
    yield (
        "identify static",
        [*learn, "static.h5", "--method", "static", "-o", "static.toml", "--report", "static.html"],
    )
    if quick:
        return
    for study in STUDIES:
        yield " ".join(study[:2]), study
    yield (
        "verify lpv",
        [
            "verify",
            "turboexpander",
            "--controller",
            "turboexpander-study/controller-lpv.json",
            "--json",
        ],
    )
    lpv = [
        "export",
        "turboexpander-study/controller-lpv.json",
        "--to",
        "c",
        "-o",
        "lpv-c",
        "--force",
        "--json",
    ]
    yield "export lpv", lpv
    yield (
        "lowered",
        [
            "synthesize",
            "seal-rig",
            "--method",
            "hinf",
            "--rate-hz",
            "10000",
            "--loss",
            "5",
            "-o",
            "low.json",
            "--json",
        ],
    )
    again = [*STUDIES[0][:3], "seal-rig-study", "--json"]
    yield "study seal-rig, resumed", again


def take(path: Path, *, quick: bool) -> None:
    """Run all, write {leaf: value} to ``path``."""
    leaves: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in commands(quick=quick):
            begin = time.perf_counter()
            done = subprocess.run(
                [str(Path(sys.executable).with_name("ambrose")), *arguments],
                cwd=folder,
                env=os.environ | _ENVIRONMENT,
                capture_output=True,
                text=True,
                check=False,
            )
            print(
                f"{name}: exit {done.returncode}, {time.perf_counter() - begin:.1f} s",
                file=sys.stderr,
                flush=True,
            )
            leaves[f"{name}/exit"] = done.returncode
            answer = (
                json.loads(done.stdout) if done.returncode != 2 else done.stderr.splitlines()[-1]
            )
            leaves |= dict(flattened(f"{name}/stdout", answer))
            if "resumed" in name:
                for file in sorted(Path(folder, "seal-rig-study").glob("*.json")):
                    leaves |= dict(of_file(f"{name}/{file.name}", file))
        for file in sorted(Path(folder).rglob("*")):
            if file.is_file():
                leaves |= dict(of_file(str(file.relative_to(folder)), file))
    path.write_text(json.dumps(leaves, indent=0, sort_keys=True))
    print(f"{len(leaves)} leaves: {path}", file=sys.stderr)


def flattened(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Nested data as (path, leaf); floats by their shortest exact text, long number rows by their
    hash and range.
    """
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in _UNSTABLE_KEYS:
                yield from flattened(f"{name}/{key}", item)
    elif (
        isinstance(value, list)
        and len(value) > 40
        and all(isinstance(item, int | float) for item in value)
    ):
        yield from of_array(name, np.array(value, dtype=float))
    elif isinstance(value, list):
        yield f"{name}/length", len(value)
        for i, item in enumerate(value):
            yield from flattened(f"{name}/{i}", item)
    else:
        yield (
            name,
            repr(value)
            if isinstance(value, float)
            else _DATES.sub("DATE", value)
            if isinstance(value, str)
            else value,
        )


def of_array(name: str, values: np.ndarray) -> Iterator[tuple[str, Any]]:
    data = np.ascontiguousarray(values, dtype=float)
    yield f"{name}/hash", hashlib.sha256(data.tobytes()).hexdigest()[:16]
    if data.size:
        yield f"{name}/range", [repr(float(x)) for x in (np.min(data), np.max(data), np.mean(data))]


def of_file(name: str, path: Path) -> Iterator[tuple[str, Any]]:
    kind = path.suffix.lower()
    if kind == ".json":
        yield from flattened(name, json.loads(path.read_text()))
    elif kind == ".toml":
        yield from flattened(name, tomllib.loads(path.read_text()))
    elif kind == ".h5":
        with h5py.File(path) as record:
            for key, data in record["signals"].items():
                yield from of_array(f"{name}/{key}", data[...])
    elif kind == ".mat":
        for key, data in loadmat(path).items():
            if not key.startswith("__") and np.issubdtype(np.asarray(data).dtype, np.number):
                yield from of_array(f"{name}/{key}", np.asarray(data))
    elif kind == ".fmu":
        with zipfile.ZipFile(path) as archive:
            for member in sorted(archive.namelist()):
                yield from of_text(
                    f"{name}/{member}", archive.read(member).decode(errors="replace")
                )
    elif kind == ".html":  # the numbers of a page, without the plotting library
        text = re.sub(
            r"<script[^>]*>[^<]{200000,}</script>", "", _DATES.sub("DATE", path.read_text())
        )
        numbers = _NUMBER.findall(text)
        yield f"{name}/numbers", len(numbers)
    else:
        yield from of_text(name, path.read_text(errors="replace"))


def of_text(name: str, text: str) -> Iterator[tuple[str, Any]]:
    """A text by its numbers: names and comments may change, vectors and matrices may not."""
    numbers = [
        float(number)
        for number in _NUMBER.findall(
            _DATES.sub("DATE", re.sub(r"[0-9a-f]{12,}|0\.\d+\.\d+", "", text))
        )
    ]
    yield from of_array(name, np.array(numbers))


def compare(before: Path, after: Path) -> int:
    """Print every leaf that differs; the number of them."""
    old, new = json.loads(before.read_text()), json.loads(after.read_text())
    rows = [(key, old.get(key, "absent"), new.get(key, "absent")) for key in sorted({*old, *new})]
    different = [row for row in rows if row[1] != row[2]]
    for key, was, now in different:
        print(f"{key}: {was} -> {now}")
    print(f"{len(rows) - len(different)} leaves equal, {len(different)} different")
    return len(different)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("snapshot.json"))
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("BEFORE", "AFTER"))
    options = parser.parse_args()
    if options.compare:
        sys.exit(compare(*options.compare) > 0)
    take(options.output, quick=options.quick)


if __name__ == "__main__":
    main()
