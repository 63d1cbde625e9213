"""python fault_driver.py FOLDER [KIND ...], with faults.c preloaded: all ways of writing, failed
and killed at each operation; of the kinds that are named only killed, at every third operation.

Prints a line for each: what was written, how it failed, at which operation, how the writer ended,
what stands there afterwards.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
from pathlib import Path

import numpy as np

from ambrose.core.checks import InvalidInput
from ambrose.machine.ordinary_file import INTERRUPTED, write_files, write_text
from ambrose.record.files import read_record, write_record
from ambrose.record.record import Record
from ambrose.record.stream import RecordWriter, partial_path

FAULTS = ctypes.CDLL(None)
MODES = ("once", "from there on", "killed")
SIGNALS = ("y_A", "i_B")
UNITS = ("m", "A")
CHUNK = 8
SETS = {
    "old": {"a.c": "old a", "b.h": "old b"},
    "new": {"a.c": b"new a", "b.h": "new b", "c.txt": "new c"},
}


def values(tag):
    return np.arange(2.0 * 20).reshape(2, 20) + {"old": 0.0, "new": 0.5}[tag]


def text(folder, tag):
    write_text(folder / "file.txt", f"all of the {tag}\n" * 1000, "text")


def text_state(folder):
    words = set((folder / "file.txt").read_text().splitlines())
    return words.pop().removeprefix("all of the ") if len(words) == 1 else f"mixed {words}"


def record(suffix):
    def write(folder, tag):
        write_record(Record("m", 1e3, SIGNALS, UNITS, values(tag)), folder / f"run{suffix}")

    return write, lambda folder: record_state(folder / f"run{suffix}")


def record_state(path):
    found = read_record(path).values
    return next((tag for tag in SETS if np.array_equal(found, values(tag))), "neither")


def stream(folder, tag):
    with RecordWriter(
        folder / "run.h5",
        "m",
        1e3,
        SIGNALS,
        UNITS,
        notes=tuple((f"n{i}", "x") for i in range(9)),
        chunk=CHUNK,
    ) as w:
        for start in range(0, 20, 5):
            w.append(values(tag)[:, start : start + 5])
        w.note("outcome", "completed")


def stream_state(folder):
    state, partial = record_state(folder / "run.h5"), partial_path(folder / "run.h5")
    if state != "old" or not partial.exists():
        return state
    try:
        found = read_record(partial).values
    except InvalidInput as error:
        return "old, 0" if "before" in str(error) else f"lost: {error}"
    n = found.shape[1]
    return f"old, {n}" if np.array_equal(found, values("new")[:, :n]) else "wrong samples"


def new_folder(folder, tag):
    if tag == "new":
        write_files(folder / "code", SETS["new"])


def some_folder(folder, tag):
    write_files(folder / "code", SETS[tag])


def folder_state(folder):
    """old, new or none; marked: neither, and the next write makes it new."""
    if not (folder / "code").exists():
        return "none"
    first = set_there(folder / "code")
    marked = (folder / "code" / INTERRUPTED).exists()
    write_files(folder / "code", {"other": ""})
    then = set_there(folder / "code")
    if first == then:
        return first
    return "marked" if marked and then == "new" else f"{first}, then {then}"


def set_there(code):
    there = {
        path.name: path.read_bytes()
        for path in code.iterdir()
        if path.is_file() and path.name != "other"
    }
    wanted = {
        tag: {name: c if isinstance(c, bytes) else c.encode() for name, c in files.items()}
        for tag, files in SETS.items()
    }
    return next((tag for tag in SETS if there == wanted[tag]), f"mixed {sorted(there)}")


KINDS = {
    "text": (text, text_state),
    "csv": record(".csv"),
    "hdf5": record(".h5"),
    "stream": (stream, stream_state),
    "new folder": (new_folder, folder_state),
    "folder": (some_folder, folder_state),
}


def attempt(write, folder, n, mode):
    """In another process; how it ended, and how many operations there were (0: killed)."""
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        FAULTS.fault_arm(ctypes.c_long(n), MODES.index(mode))
        try:
            write(folder, "new")
            ended = "done"
        except Exception as error:
            ended = type(error).__name__
        count = FAULTS.fault_count()
        os.write(writing, f"{ended} {count}".encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as answer:
        words = answer.read().split()
    status = os.waitpid(child, 0)[1]
    return (words[0], int(words[1])) if words else (f"signal {status & 127}", 0)


def main(root, *kinds):
    for kind in kinds or KINDS:
        write, state = KINDS[kind]
        base, folder = root / "base", root / "now"
        shutil.rmtree(base, ignore_errors=True)
        base.mkdir()
        write(base, "old")
        ended, total = attempt(write, shutil.copytree(base, folder, dirs_exist_ok=True), -1, "once")
        if ended != "done":
            raise SystemExit(f"{kind} fails without a fault: {ended}")
        for mode, n in (
            (mode, n)
            for mode in (MODES[-1:] if kinds else MODES)
            for n in range(0, total, 3 if kinds else 1)
        ):
            shutil.rmtree(folder)
            shutil.copytree(base, folder)
            ended, _ = attempt(write, folder, n, mode)
            print("\t".join((kind, mode, str(n), ended, state(folder))), flush=True)
        shutil.rmtree(folder)


main(Path(sys.argv[1]), *sys.argv[2:])
