"""What the program says, every number of it: every command, compared before and after a change.

    python -m benchmarks.snapshot -o before.json [--quick]    # minutes; the runs: benchmarks/snapshot_runs.txt
    python -m benchmarks.snapshot --compare before.json after.json
    python -m benchmarks.snapshot --commands                  # what both levels run

It sees the command line only, so that it outlives any move of the code behind it: every run is
``python -m ambrose ...`` in a process of its own, with the interpreter and the PYTHONPATH of this
one, in a folder that holds ``snapshot_files``. Of every run it keeps the exit status, standard
output, standard error and the files that it wrote, taken apart to their leaves: JSON and TOML by
key, records and MAT-files by signal, code by its numbers and its words, pages by their text and by
the numbers of every figure. An array is kept as its hash, shape, range and a sample. Paths, dates,
versions and elapsed times are left out; what else differs between two runs of the same code stands
in ``UNREPEATABLE``.

--compare lists every leaf that differs, with the relative difference, by command; exit status 1
where one does.
"""

from __future__ import annotations

import argparse
import base64
import difflib
import gzip
import hashlib
import html
import importlib.metadata
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat

from benchmarks.snapshot_runs import Run, runs

FILES = Path(__file__).with_name("snapshot_files")
FIVE_AXES = Path(__file__).parents[1] / "examples" / "expander-five-axes.toml"
ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "COLUMNS": "160",
    "NO_COLOR": "1",
    "TERM": "dumb",
}
SAMPLE = 24  # values of an array that are kept, evenly spaced, so that a difference has a size
SHORT = 12  # a list of at most so many numbers is kept number by number

# What differs between two runs of the same code: pattern of the leaf's name, and why.
UNREPEATABLE: dict[str, str] = {}

_UNSTABLE_KEYS = {"date", "package_version", "created"}
_DATE = re.compile(r"\d{4}-\d\d-\d\d(?:[T ]\d\d:\d\d(?::\d\d)?(?:\.\d+)?(?:Z|\+00:00| UTC)?)?")
_NUMBER = re.compile(r"[-−+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
# Messages that come by the clock, whole lines and parts of lines: they say how busy the computer
# was.
_TIMED_LINE = re.compile(r"^\s*(simulated .* s of .* s|.*: since \d+ s)$")
_ELAPSED = re.compile(r"\(\d+\.\d s\)")
_DIGEST = re.compile(r"\b[0-9a-f]{12,64}\b")


# ---- taking
# ----------------------------------------------------------------------------------------------------------


def take(path: Path, *, quick: bool, only: Sequence[str] = ("*",)) -> None:
    """Run all of a level and write {"about": ..., "runs": {name: {leaf: value}}} to ``path``, which
    grows run by run.
    """
    environment = os.environ | ENVIRONMENT | absolute_python_path()
    chosen = [
        run for run in runs(quick=quick) if any(fnmatchcase(run.name, pattern) for pattern in only)
    ]
    taken: dict[str, dict[str, Any]] = {}
    seconds: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name).resolve()
        source = source_of(environment, folder)
        print(f"sources: {source}", file=sys.stderr, flush=True)
        shutil.copytree(FILES, folder, dirs_exist_ok=True)
        shutil.copy(FIVE_AXES, folder)
        for run in chosen:
            taken[run.name], seconds[run.name] = leaves_of(run, folder, environment, source)
            status = taken[run.name]["exit"]
            print(
                f"{run.name}: exit {status}, {seconds[run.name]:.1f} s", file=sys.stderr, flush=True
            )
            about = {
                "level": "quick" if quick else "full",
                "complete": len(taken) == len(runs(quick=quick)),
                "source": str(source),
                "python": platform.python_version(),
                "machine": platform.machine(),
                "packages": {
                    name: importlib.metadata.version(name)
                    for name in ("numpy", "scipy", "numba", "click")
                },
                "processor_seconds": {name: round(value, 2) for name, value in seconds.items()},
            }
            partial = path.with_name(f"{path.name}.partial")
            partial.write_text(
                json.dumps({"about": about, "runs": taken}, indent=0, sort_keys=True),
                encoding="utf-8",
            )
            partial.replace(path)
    leaves = sum(map(len, taken.values()))
    print(
        f"{len(taken)} runs, {leaves} leaves, {sum(seconds.values()):.0f} s of processor time: "
        f"{path}",
        file=sys.stderr,
    )


def absolute_python_path() -> dict[str, str]:
    """PYTHONPATH with absolute places, for the runs work in another folder."""
    given = os.environ.get("PYTHONPATH", "")
    places = [str(Path(place).resolve()) for place in given.split(os.pathsep) if place]
    return {"PYTHONPATH": os.pathsep.join(places)} if places else {}


def source_of(environment: dict[str, str], folder: Path) -> Path:
    """The folder of the package that the runs will use."""
    words = [sys.executable, "-c", "import ambrose; print(ambrose.__file__)"]
    answer = subprocess.run(
        words, cwd=folder, env=environment, capture_output=True, text=True, check=True
    )
    return Path(answer.stdout.strip()).parent


def leaves_of(
    run: Run, folder: Path, environment: dict[str, str], source: Path
) -> tuple[dict[str, Any], float]:
    """Run one command; {leaf: value} of all that it said and wrote, and the processor time that it
    took [s].
    """
    before = state_of(folder)
    start = os.times()
    done = subprocess.run(
        [sys.executable, "-m", "ambrose", *run.arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        stdin=subprocess.DEVNULL,
        encoding="utf-8",
    )
    end = os.times()
    seconds = end.children_user + end.children_system - start.children_user - start.children_system
    places = {str(folder): "FOLDER", str(source): "SOURCE", sys.prefix: "PYTHON"}
    leaves: dict[str, Any] = {"exit": done.returncode}
    try:
        leaves |= dict(of_data("stdout", json.loads(done.stdout)))
    except ValueError:
        leaves |= dict(of_message("stdout", done.stdout, places))
    leaves |= dict(of_message("stderr", done.stderr, places))
    for name, state in sorted(state_of(folder).items()):
        if before.get(name) != state:
            leaves[f"{name}/written"] = True
            leaves |= dict(of_file(name, folder / name))
    return leaves, seconds


def state_of(folder: Path) -> dict[str, tuple[int, int]]:
    """Time and size of every file below a folder."""
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {
        path.relative_to(folder).as_posix(): (path.stat().st_mtime_ns, path.stat().st_size)
        for path in files
    }


# ---- leaves
# ----------------------------------------------------------------------------------------------------------


def of_message(name: str, text: str, places: dict[str, str]) -> Iterator[tuple[str, Any]]:
    """What a command said: its lines without paths and dates."""
    for place, word in places.items():
        text = text.replace(place, word)
    lines = [line.rstrip() for line in plain(text).splitlines() if line.strip()]
    if lines:
        yield name, {"lines": lines}


def plain(text: str) -> str:
    """A text without dates."""
    return _DATE.sub("DATE", text)


def of_data(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Nested data as (path, leaf); long number lists and matrices as arrays."""
    if isinstance(value, dict):
        for key, item in value.items():
            if key not in _UNSTABLE_KEYS:
                yield from of_data(f"{name}/{key}", item)
    elif isinstance(value, list):
        array = as_array(value)
        if array is not None and array.size > SHORT:
            yield from of_array(name, array)
            return
        yield f"{name}/length", len(value)
        for i, item in enumerate(value):
            yield from of_data(f"{name}/{i}", item)
    else:
        yield name, plain(value) if isinstance(value, str) else value


def as_array(value: list[Any]) -> np.ndarray | None:
    """A list, or rectangular lists of lists, of numbers alone as an array."""
    try:
        array = np.array(value)
    except (ValueError, TypeError):
        return None
    return array.astype(float) if array.dtype.kind in "iuf" else None


def of_array(name: str, values: np.ndarray) -> Iterator[tuple[str, Any]]:
    """An array as hash, shape, range, root mean square, and a sample."""
    if values.dtype.kind == "c":
        values = np.stack([values.real, values.imag])
    data = np.ascontiguousarray(values, dtype=float)
    flat = data.ravel()
    leaf: dict[str, Any] = {
        "hash": hashlib.sha256(data.tobytes()).hexdigest()[:16],
        "shape": list(data.shape),
    }
    if flat.size:
        chosen = np.unique(
            np.linspace(0, flat.size - 1, min(flat.size, SAMPLE)).round().astype(int)
        )
        leaf["sample"] = flat[chosen].tolist()
        finite = flat[np.isfinite(flat)]
        if finite.size:
            leaf["range"] = [
                float(finite.min()),
                float(finite.max()),
                float(np.sqrt(np.mean(finite**2))),
            ]
    yield name, leaf


def of_file(name: str, path: Path) -> Iterator[tuple[str, Any]]:
    """The leaves of a file, by its suffix."""
    kind = path.suffix.lower()
    if kind == ".json":
        yield from of_data(name, json.loads(path.read_text(encoding="utf-8")))
    elif kind == ".jsonl":
        for i, line in enumerate(path.read_text(encoding="utf-8").splitlines()):
            yield from of_data(f"{name}/{i}", json.loads(line))
    elif kind == ".toml":
        yield from of_data(name, tomllib.loads(path.read_text(encoding="utf-8")))
    elif kind in {".h5", ".nc"}:
        yield from of_hdf5(name, path)
    elif kind == ".mat":
        for key, data in loadmat(path).items():
            if not key.startswith("__") and np.asarray(data).dtype.kind in "iufcb":
                yield from of_array(f"{name}/{key}", np.asarray(data))
    elif kind == ".fmu":
        with zipfile.ZipFile(path) as archive:
            for member in sorted(archive.namelist()):
                yield from of_text(
                    f"{name}/{member}", archive.read(member).decode(errors="replace")
                )
    elif kind == ".html":
        yield from of_page(name, path.read_text(encoding="utf-8"))
    else:
        yield from of_text(name, path.read_text(encoding="utf-8", errors="replace"))


def of_hdf5(name: str, path: Path) -> Iterator[tuple[str, Any]]:
    """Every data set and attribute of a file."""
    members: dict[str, Any] = {}
    with h5py.File(path) as file:

        def keep(key: str, item: Any) -> None:
            members.update(
                {
                    f"{key}@{label}": value
                    for label, value in item.attrs.items()
                    if label not in _UNSTABLE_KEYS
                }
            )
            if isinstance(item, h5py.Dataset):
                members[key] = item[()]

        keep("", file)
        file.visititems(keep)
    for key, value in sorted(members.items()):
        data = np.asarray(value)
        if data.dtype.kind in "iufcb" and data.size > 1:
            yield from of_array(f"{name}/{key}", data)
        elif data.dtype.kind in "iufb" and data.size == 1:
            yield f"{name}/{key}", data.ravel()[0].item()
        elif isinstance(value, str | bytes):
            yield (
                f"{name}/{key}",
                plain(value if isinstance(value, str) else value.decode(errors="replace")),
            )


def of_page(name: str, text: str) -> Iterator[tuple[str, Any]]:
    """A page by what is read in it, and every figure by its numbers and its words; the plotting
    library is left out.
    """
    packed = re.findall(r'<script type="text/plain" id="(data-[^"]*)">([^<]*)</script>', text)
    yield f"{name}/figures", len(packed)
    yield f"{name}/tables", text.count("<table")
    for label, content in packed:
        numbers: list[float] = []
        words: list[str] = []
        collect(json.loads(gzip.decompress(base64.b64decode(content))), numbers, words)
        yield from of_array(f"{name}/{label}/numbers", np.array(numbers))
        yield f"{name}/{label}/words", digest("\n".join(words))
    visible = re.sub(r"<(script|style)\b.*?</\1>", " ", text, flags=re.DOTALL)
    lines = [
        " ".join(html.unescape(line).split())
        for line in re.sub(r"<[^>]+>", "\n", visible).splitlines()
    ]
    yield f"{name}/text", {"lines": [_DIGEST.sub("DIGEST", plain(line)) for line in lines if line]}


def collect(value: Any, numbers: list[float], words: list[str]) -> None:
    """All numbers and all words of a figure, in their order; typed arrays (dtype and base64 bytes)
    unpacked.
    """
    if isinstance(value, dict) and {"dtype", "bdata"} <= set(value):
        numbers += (
            np.frombuffer(base64.b64decode(value["bdata"]), dtype=value["dtype"])
            .astype(float)
            .tolist()
        )
    elif isinstance(value, dict):
        for key, item in value.items():
            words.append(key)
            collect(item, numbers, words)
    elif isinstance(value, list):
        for item in value:
            collect(item, numbers, words)
    elif isinstance(value, bool) or value is None or isinstance(value, str):
        words.append(plain(str(value)))
    else:
        numbers.append(float(value))


def of_text(name: str, text: str) -> Iterator[tuple[str, Any]]:
    """A text by its numbers, which must not change, and by the hash of its words, which may."""
    text = _DIGEST.sub("DIGEST", plain(re.sub(r"\b0\.\d+\.\d+\b", "VERSION", text)))
    numbers = [float(number.replace("−", "-")) for number in _NUMBER.findall(text)]
    yield from of_array(f"{name}/numbers", np.array(numbers))
    yield f"{name}/words", digest(" ".join(_NUMBER.sub("#", text).split()))


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:16]


# ---- comparing
# -------------------------------------------------------------------------------------------------------


def compare(before: Path, after: Path) -> int:
    """Print every leaf that differs, by command, with its relative difference; the number of them.

    Two complete snapshots of one level must have the same runs; all others are compared in the runs
    that both have.
    """
    old, new = (json.loads(path.read_text(encoding="utf-8")) for path in (before, after))
    for key in ("python", "machine", "packages"):
        if old["about"][key] != new["about"][key]:
            print(f"note: {key} differs: {old['about'][key]} -> {new['about'][key]}")
    same = (
        old["about"]["level"] == new["about"]["level"]
        and old["about"]["complete"]
        and new["about"]["complete"]
    )
    names = {*old["runs"], *new["runs"]} if same else old["runs"].keys() & new["runs"].keys()
    excused = dict.fromkeys(UNREPEATABLE, 0)
    total = different = 0
    by_command: dict[str, list[str]] = {}
    for name in sorted(names):
        command = name.partition(":")[0]
        rows = by_command.setdefault(command, [])
        was, now = old["runs"].get(name), new["runs"].get(name)
        if was is None or now is None:
            rows.append(f"{name}: {'not run before' if was is None else 'not run after'}")
            different += 1
            continue
        for leaf in sorted({*was, *now}):
            total += 1
            text = difference(was.get(leaf, ABSENT), now.get(leaf, ABSENT))
            pattern = next((p for p in UNREPEATABLE if fnmatchcase(f"{name}/{leaf}", p)), None)
            if text and pattern:
                excused[pattern] += 1
            elif text:
                rows.append(f"{name}/{leaf}: {text}")
                different += 1
    for command, texts in sorted(by_command.items()):
        if texts:
            print(f"\n{command} ({len(texts)} different)")
            print(*(f"  {text}" for text in texts), sep="\n")
    print()
    for pattern, count in excused.items():
        if count:
            print(
                f"not repeatable, {count} different, not counted: {pattern} "
                f"({UNREPEATABLE[pattern]})"
            )
    if not same:
        print(
            f"not of one level, or one not complete: compared in the {len(names)} runs that both "
            "have"
        )
    print(f"{total - different} leaves of {len(names)} runs equal, {different} different")
    return different


ABSENT = {"absent": True}


def difference(was: Any, now: Any) -> str:
    """How two leaves differ, in words with the relative difference; empty where they do not."""
    if was == now or (
        isinstance(was, float) and isinstance(now, float) and np.isnan([was, now]).all()
    ):
        return ""
    if was is ABSENT or now is ABSENT:
        return f"{shown(was)} -> {shown(now)}"
    numbers = (int, float)
    if (
        isinstance(was, numbers)
        and isinstance(now, numbers)
        and not isinstance(was, bool)
        and not isinstance(now, bool)
    ):
        return f"{was!r} -> {now!r} (relative {relative([was], [now]):.1e})"
    if isinstance(was, dict) and isinstance(now, dict) and "hash" in was and "hash" in now:
        if was["hash"] == now["hash"] and was["shape"] == now["shape"]:
            return ""  # equal but for NaN in the sample, which differs from itself
        if was["shape"] != now["shape"]:
            return f"shape {was['shape']} -> {now['shape']}"
        size = relative(was["sample"], now["sample"])
        sizes = f"relative {size:.1e} in its sample" if size else "not in its sample"
        return (
            f"array {was['shape']} differs, {sizes}; min, max, rms {was.get('range')} -> "
            f"{now.get('range')}"
        )
    if isinstance(was, dict) and isinstance(now, dict) and "lines" in was and "lines" in now:
        rows = difflib.unified_diff(untimed(was["lines"]), untimed(now["lines"]), n=0, lineterm="")
        changed = [row for row in rows if row[:2] not in ("--", "++", "@@")]
        return "text\n" + "\n".join(f"      {row}" for row in changed) if changed else ""
    return f"{shown(was)} -> {shown(now)}"


def untimed(lines: list[str]) -> list[str]:
    """Lines of a message without what says how long something took."""
    return [_ELAPSED.sub("(TIME)", line) for line in lines if not _TIMED_LINE.match(line)]


def relative(was: list[float], now: list[float]) -> float:
    """max |b - a| / max |a, b| over all values; infinite where only one is finite."""
    a, b = np.array(was, dtype=float), np.array(now, dtype=float)
    finite = np.isfinite(a) & np.isfinite(b)
    if not np.array_equal(a[~finite], b[~finite], equal_nan=True):
        return float("inf")
    scale = max(np.abs(a[finite]).max(initial=0.0), np.abs(b[finite]).max(initial=0.0))
    return float(np.abs(b - a)[finite].max(initial=0.0) / scale) if scale else 0.0


def shown(value: Any) -> str:
    if value is ABSENT:
        return "absent"
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) < 200 else f"{text[:200]} ..."


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", type=Path, default=Path("snapshot.json"))
    parser.add_argument(
        "--quick",
        action="store_true",
        help="what is rerun after each step: every command, on cheap machines",
    )
    parser.add_argument(
        "--only",
        nargs="+",
        default=["*"],
        metavar="PATTERN",
        help='runs of these patterns alone, such as "check: *", with those whose files they take',
    )
    parser.add_argument("--compare", type=Path, nargs=2, metavar=("BEFORE", "AFTER"))
    parser.add_argument("--commands", action="store_true", help="list the runs of both levels")
    options = parser.parse_args()
    if options.commands:
        for run in runs(quick=False):
            print(f"{'quick' if run.quick else 'full ':5}  ambrose {' '.join(run.arguments)}")
    elif options.compare:
        sys.exit(compare(*options.compare) > 0)
    else:
        take(options.output, quick=options.quick, only=options.only)


if __name__ == "__main__":
    main()
