"""What a file holds too much of is refused before anything is built from it: at once, in one
sentence, in little memory.
"""

import os
import random
import re
import signal
import struct
import subprocess
import sys
import time
import zlib
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io
from benchmarks import fuzz_files
from docs_build import machine_file

from ambrose.core.checks import InvalidInput
from ambrose.judge.controller_file import read_controller
from ambrose.machine import ordinary_file as limits
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.toml import loads_machine
from ambrose.machine.part import ShaftSection
from ambrose.record import apart, files as csv_file, hdf5_file
from ambrose.record.files import read_record, write_record
from ambrose.record.foreign import Column, ColumnMap, load_columns, read_foreign
from ambrose.record.record import Record
from ambrose.rig.scenario import load_scenario

HERE = Path(__file__)
SMALL = HERE.with_name("small.toml").read_text()
SECTION = '[[shaft]]\nlength = "10 mm"\nouter_diameter = "60 mm"\n'
SHAFT = SMALL[SMALL.index("[[shaft]]\nlabel") : SMALL.index("[[disc]]")]


def sections(count, elements=1):
    return SMALL.replace(SHAFT, f"{SECTION}elements = {elements}\n" * count)


def several(table, count, rest):
    return SMALL + "".join(f"[[{table}]]\n{rest.format(i)}\n" for i in range(count))


LARGE = {
    "sections": (lambda: sections(801), "801 entries of [[shaft]], but at most 800"),
    "elements in all": (lambda: sections(81, 10), "810 elements in all, but at most 800"),
    "discs": (
        lambda: several("disc", 9000, 'name = "d{}"\nposition = 0.1\nmass = 1'),
        "[[disc]], but at most 100",
    ),
    "empty discs": (lambda: several("disc", 20_000, ""), "[[disc]], but at most 100"),
    "bearings": (
        lambda: several("bearing", 9000, 'name = "b{}"\nposition = 0.1\nbias_current = 1'),
        "[[bearing]], but at",
    ),
    "tolerances": (
        lambda: several("tolerance", 9000, 'parameter = "seal.center.C"\nrelative = 0.1'),
        "[[tolerance]], but",
    ),
    "points": (
        lambda: several("operation.point", 9000, 'label = "p{}"'),
        "[[operation.point]], but at most 50",
    ),
    "notches": (
        lambda: several("controller.notch", 30, "frequency = {}"),
        "[[controller.notch]], but at most 20",
    ),
    "labels": (
        lambda: SMALL.replace('["standstill"]', "[" + '"a",' * 1001 + "]"),
        "1001 entries in tolerance.around",
    ),
    "name": (
        lambda: SMALL.replace('"wheel"', "'" + "w" * 101 + "'"),
        "disc.name has 101 characters, but at most 100",
    ),
    "text": (
        lambda: SMALL.replace('"made up"', "'" + "w" * 10_001 + "'"),
        "has 10001 characters, but at most 10000",
    ),
    "key": (lambda: SMALL + "x" * 101 + " = 1", "has 101 characters, but at most 100"),
    "unit": (
        lambda: SMALL.replace('"3 kg"', "'3 kg" + "*kg/kg" * 1000 + "'"),
        "but must be a mass",
    ),
    "entries": (lambda: SMALL + "x = [" + "1," * 100_001 + "]", "entries, but at most 100000"),
    "bytes": (lambda: SMALL + "#" * 1_000_000, "characters, but at most 1000000"),
    "count": (lambda: SMALL.replace("order = 2\namp", f"order = {2**70}\namp"), "at most 1000000"),
    "poles": (lambda: SMALL.replace("poles = 2", "poles = 61"), "61 poles in all, but at most 60"),
    "delay": (lambda: SMALL.replace('delay = "100 us"', "delay = 1e9"), "at most 100 sample times"),
    "rate": (
        lambda: SMALL.replace('sample_time = "100 us"', "sample_time = 1e-300"),
        "sample_time is 1e-300 s",
    ),
    "deep key": (lambda: "a" + ".a" * 100_000 + " = 1\n" + SMALL, "a key is nested too deeply"),
    "deep key of strings": (
        lambda: "a" + ' . "a.b"' * 12 + " = 1\n" + SMALL,
        "a key is nested too deeply",
    ),
    "deep table": (lambda: SMALL + "[" + "a." * 50_000 + "a]", "a key is nested too deeply"),
    "deep reasons": (
        lambda: SMALL.replace("bearing.A.gap", "b" + ".A" * 5000),
        "a key is nested too deeply",
    ),
    "deep lists": (lambda: SMALL + "x = " + "[" * 13 + "]" * 13, "brackets are nested too deeply"),
    "deep behind a string": (
        lambda: SMALL + 'x = {y = """"a"""", z' + ".a" * 12 + " = 1}",
        "a key is nested too deeply",
    ),
}


@pytest.mark.parametrize("name", LARGE)
def test_a_machine_file_with_too_much_is_refused_at_once(name):
    make, message = LARGE[name]
    text = make()
    begun = time.process_time()
    with pytest.raises(InvalidInput) as caught:
        loads_machine(text, "large.toml")
    assert time.process_time() - begun < 2
    assert message in str(caught.value)
    assert len(str(caught.value)) < 300 and "\n" not in str(caught.value)


def test_a_machine_made_in_code_has_the_same_limits():
    machine = loads_machine(SMALL)
    long = tuple(ShaftSection(0.001 * i, 0.001, 0.06, elements=2) for i in range(450))
    with pytest.raises(InvalidInput, match="900 elements in all, but at most 800"):
        replace(machine, shaft=long)
    with pytest.raises(InvalidInput, match=r"200 entries of \[\[disc\]\]"):
        replace(machine, discs=machine.discs * 200)


def test_marks_within_texts_and_comments_are_no_nesting():
    deep = "a.b.c.d.e.f.g.h.i.j.k.l.m.n" + "[{" * 30
    text = SMALL.replace('"made up"', f'"""{deep}\n\\"" {deep}""""') + f"# {deep}\n"
    assert loads_machine(
        text.replace('description = "Two', f"description = '{deep} Two").replace(
            'coupling"\n', "coupling'\n", 1
        )
    )


def test_of_many_problems_the_first_are_told():
    with pytest.raises(InvalidInput) as caught:
        loads_machine(SMALL + "".join(f"k{i} = 1\n" for i in range(900)))
    lines = str(caught.value).splitlines()
    assert "has 900 problems" in lines[0] and len(lines) == 22 and "880 more" in lines[-1]


def test_a_scenario_and_a_column_map_have_the_limits_of_a_file(tmp_path):
    path = tmp_path / "x.toml"
    for text, message in (
        ("#" * 1_000_001, "1000000 bytes"),
        ("a" + ".a" * 50_000 + " = 1", "nested"),
        ("\xff", "UTF-8"),
    ):
        path.write_bytes(text.encode("latin-1"))
        for load in (load_scenario, load_columns):
            with pytest.raises(InvalidInput, match=rf"x\.toml.*{message}"):
                load(path)


@pytest.mark.parametrize(
    "page, numbers",
    [
        (
            "reference/machine-file.md",
            [
                limits.ELEMENTS,
                limits.SEAL_POLES,
                limits.DELAY_SAMPLES,
                limits.TEXT,
                limits.NAME,
                limits.TOML_BYTES,
                limits.TOML_ENTRIES,
                limits.TOML_DEPTH,
                limits.ENTRIES_EACH,
            ],
        ),
        (
            "reference/records.md",
            [
                limits.NUMBERS,
                limits.FOREIGN_NUMBERS,
                limits.SIGNALS,
                limits.PACKED,
                limits.CHUNK_BYTES,
                limits.BESIDE,
                limits.UNPACKED,
            ],
        ),
    ],
)
def test_the_limits_are_documented(page, numbers):
    text = (HERE.parents[2] / "docs" / page).read_text(encoding="utf-8")
    text = machine_file.render(text) if page == "reference/machine-file.md" else text
    assert [
        number
        for number in numbers
        if f" {number:,} ".replace(",", " ") not in text.replace("|", " ").replace("\n", " ")
    ] == []
    if page == "reference/machine-file.md":
        missing = [
            key for key, most in limits.TABLES.items() if f"tables `{key}` | {most} |" not in text
        ]
        assert missing == ["signal"]  # of a column map


# records


def hdf5(path, signals=("y_A_zeta",), attributes=(), libver="", **layout):
    """A record; of another program, with texts of variable length, where libver is given."""
    stored = (lambda value: value) if libver else hdf5_file.fixed
    with h5py.File(path, "w", libver=libver or hdf5_file.LIBVER, track_order=True) as file:
        known = {"format": "ambrose-record", "version": 1, "machine": "m", "sample_rate_hz": 1e4}
        given = {**known, "speed_rad_s": 0.0, "seal_pressure_pa": 0.0, **dict(attributes)}
        file.attrs.update({key: stored(value) for key, value in given.items()})
        group = file.create_group("signals")
        for name in signals:
            group.create_dataset(name, **{"shape": (2,), "dtype": "f8", **layout}).attrs["unit"] = (
                stored("m")
            )
    return path


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (
            {"shape": (20_000_000,), "chunks": (1000,), "compression": "gzip"},
            "160000000 bytes in .* at most 100 times the file",
        ),
        (
            {"shape": (130_000_000,), "chunks": (1000,)},
            "the number of values is 130000000, but must be at most 125000000",
        ),
        (
            {"maxshape": (None,), "chunks": (9_000_000,), "compression": "gzip"},
            "a chunk is 72000000 bytes",
        ),
        (
            {"signals": [f"y_{i}" for i in range(1001)]},
            "the number of signals is 1001, but must be at most 1000",
        ),
        (
            {"attributes": [(f"k{i}", "x") for i in range(1001)]},
            "the number of attributes is 1007, but must be at most 1000",
        ),
        ({"attributes": [("k", "x" * 10_001)], "libver": "latest"}, "k is 'xx"),
        ({"attributes": [("k", np.zeros(3))]}, "the attribute 'k' is an array"),
    ],
)
def test_an_hdf5_record_with_too_much_is_refused(tmp_path, given, message):
    with pytest.raises(InvalidInput, match=message):
        read_record(hdf5(tmp_path / "r.h5", **given))


def test_what_an_hdf5_record_holds_beside_its_signals_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setattr(hdf5_file, "BESIDE", 100_000)
    with pytest.raises(InvalidInput, match="size of the file's attributes"):
        read_record(hdf5(tmp_path / "r.h5", attributes=[("k", "x" * 100_000)]))


def test_a_long_hdf5_record_is_checked_before_memory_is_taken(tmp_path, monkeypatch):
    record = Record("m", 100.0, ("y_A",), ("m",), np.arange(50.0)[None])
    path = write_record(record, tmp_path / "r.h5")
    for name, value in {"CHECKED_FIRST": 40, "_BLOCK": 7}.items():
        monkeypatch.setattr(hdf5_file, name, value)
    assert (read_record(path).values == record.values).all()
    with h5py.File(path, "r+") as file:
        file["signals/y_A"][33] = np.nan
    monkeypatch.delattr(hdf5_file, "_read")
    with pytest.raises(InvalidInput, match=r"y_A at sample 33 \(t = 0\.33 s\) is nan"):
        read_record(path)


@pytest.mark.parametrize("libver", ["earliest", "latest"])
def test_an_hdf5_file_whose_texts_are_read_without_end_is_refused(tmp_path, monkeypatch, libver):
    path = hdf5(tmp_path / "r.h5", libver=libver)
    assert read_record(path).machine == "m"
    data = path.read_bytes()
    # where texts of variable length stand, each behind its length; of 0 here
    heap = data.index(b"GCOL") + 16
    path.write_bytes(data[:heap] + bytes(16) + data[heap + 16 :])
    monkeypatch.setattr(apart, "_SECONDS", 2.0)
    with pytest.raises(InvalidInput, match=r"r\.h5: it cannot be read within 2 s"):
        read_record(path)


def test_a_record_of_its_own_needs_no_process_apart(tmp_path, monkeypatch):
    monkeypatch.setattr(apart, "try_record", None)
    record = Record("m", 100.0, ("y_A",), ("m",), np.arange(50.0)[None])
    assert read_record(write_record(record, tmp_path / "r.h5")).machine == "m"
    for libver in ("earliest", "latest"):
        with pytest.raises(InvalidInput, match="NoneType"):
            read_record(hdf5(tmp_path / "other.h5", libver=libver))


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX systems")
# as another program does it, and as a terminal does
@pytest.mark.parametrize("send", ["kill", "killpg"])
def test_ctrl_c_ends_the_process_apart_as_well(tmp_path, send):
    path = hdf5(tmp_path / "r.h5", libver="earliest")
    data = path.read_bytes()
    heap = data.index(b"GCOL") + 16
    path.write_bytes(data[:heap] + bytes(16) + data[heap + 16 :])
    (tmp_path / "tmp").mkdir()
    # it may be ignored by inheritance
    start = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    start += "from ambrose.__main__ import main; main()"
    command = subprocess.Popen(
        [sys.executable, "-c", start, "convert", str(path), "-o", str(tmp_path / "r.csv")],
        env={**os.environ, "TMPDIR": str(tmp_path / "tmp")},
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
    )
    try:
        deadline = time.monotonic() + 300
        while not list((tmp_path / "tmp").glob("ambrose-*")):
            assert time.monotonic() < deadline and command.poll() is None
            time.sleep(0.05)
        getattr(os, send)(command.pid, signal.SIGINT)  # within the child's start or its reading
        told = command.communicate(timeout=300)[1]
        assert command.returncode == 130 and len(told.strip().splitlines()) == 1
        with pytest.raises(ProcessLookupError):
            while time.monotonic() < deadline:  # nobody is left in its session, nor to be buried
                os.killpg(command.pid, 0)
                time.sleep(0.05)
        assert not list((tmp_path / "tmp").iterdir())
    finally:
        with suppress(ProcessLookupError):
            os.killpg(command.pid, signal.SIGKILL)
        command.communicate()


HEAD = (
    "# format: ambrose-record\n# version: 1\n# machine: m\n# speed_rad_s: 0\n# seal_pressure_pa: "
    "0\n"
)
ROWS = "time [s],y_A [m]\n0,1\n0.1,2\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            HEAD + "".join(f"# k{i}: x\n" for i in range(1001)) + ROWS,
            "the number of notes is 1001, but must be at most 1000",
        ),
        (HEAD + "# no colon\n" * 100_000 + ROWS, "lines that begin with # is larger"),
        (HEAD + "# k: " + "x" * 300_000 + "\n" + ROWS, "the length of a line is larger"),
        (HEAD + "# k: " + "x" * 10_001 + "\n" + ROWS, "k is 'xx"),
        (
            HEAD + "time [s]," + ",".join(f"y_{i} [m]" for i in range(1001)) + "\n",
            "the number of signals is 1001",
        ),
        (HEAD + ROWS + "0" * 10_000_000, "the length of a line is larger, but must be at most 200"),
        (HEAD + ROWS + "\n" * 10_000 + "0.2,1\n", "the number of blank lines is larger"),
        (HEAD + "time [s],y_A [" + "m*m/m*" * 5000 + "m]\n0,1\n", "the header cell is"),
        (HEAD + ROWS.replace("0.1", "1e-300") + "1e300,2\n", "a time step is"),
        (HEAD + ROWS.replace("0.1", "1e-9") + "2e-9,1\n1e308,1\n-1e308,1\n", "a time step is"),
    ],
)
def test_a_csv_record_with_too_much_is_refused_at_once(tmp_path, text, message):
    path = tmp_path / "r.csv"
    path.write_text(text)
    begun = time.process_time()
    with pytest.raises(InvalidInput, match=message) as caught:
        read_record(path)
    assert time.process_time() - begun < 2 and len(str(caught.value)) < 400


@pytest.mark.parametrize("checked_first", [10, 10_000])
def test_a_csv_record_is_read_in_blocks(tmp_path, monkeypatch, checked_first):
    record = Record(
        "m", 100.0, ("y_A", "y_B"), ("m", "m"), np.random.default_rng(0).standard_normal((2, 50))
    )
    path = write_record(record, tmp_path / "r.csv")
    for name, value in {"CHECKED_FIRST": checked_first, "_BLOCK": 21}.items():
        monkeypatch.setattr(csv_file, name, value)
    lines = path.read_text().splitlines(keepends=True)
    body = len(lines) - 50
    path.write_text("".join([*lines[: body + 20], "\n", *lines[body + 20 :]]))  # a blank line
    assert (read_record(path).values == record.values).all()
    for row, message in (
        ("0.33,1\n", "columns"),
        ("0.33,x,1\n", "'x'"),
        ("nan,1,1\n", "data row 34"),
        ("0.33,nan,1\n", "sample 33"),
    ):
        path.write_text("".join([*lines[: body + 33], row, *lines[body + 34 :]]))
        with pytest.raises(InvalidInput, match=message):
            read_record(path)


# files of MATLAB, in a process apart

COLUMNS = ColumnMap("m", (Column("y_A", "y", "m"),), OperatingPoint(), sample_rate_hz=1e3)


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(size, kind, name, body):
    head = (
        element(6, struct.pack("<II", kind, 0))
        + element(5, struct.pack("<2i", *size))
        + element(1, name)
    )
    return element(14, head + body)


def nested_cells(depth):
    """y = {{{...}}}, put together from the outside: the heads, each with the length of all that
    follows.
    """
    inner = matrix((1, 1), 6, b"", element(9, bytes(8)))
    head = matrix((1, 1), 1, b"", b"")[8:]
    named = matrix((1, 1), 1, b"y", b"")[8:]
    lengths = [len(inner) + (len(head) + 8) * i for i in range(depth)]
    heads = [
        struct.pack("<II", 14, n + len(h)) + h
        for n, h in zip(lengths, [head] * (depth - 1) + [named], strict=True)
    ]
    return b"".join(reversed(heads)) + inner


def liar():
    head = (
        element(6, struct.pack("<II", 6, 0))
        + element(5, struct.pack("<2i", 1, 3))
        + element(1, b"y")
    )
    return struct.pack("<II", 14, 64) + head + struct.pack("<II", 9, 0xFFFFFFF0) + bytes(100)


def mat(path, content):
    packed = zlib.compress(content, 9)
    path.write_bytes(
        b"MATLAB 5.0".ljust(124)
        + struct.pack("<HH", 0x0100, 0x4D49)
        + struct.pack("<II", 15, len(packed))
        + packed
    )
    return path


@pytest.mark.skipif(
    not hasattr(__import__("os"), "fork"),
    reason="memory is limited and crashes have signals on POSIX systems",
)
@pytest.mark.parametrize(
    ("content", "message"),
    [
        (lambda: nested_cells(100_000), "its reader came to a sudden end|takes too much memory"),
        (
            lambda: matrix((40_000_000, 1), 6, b"y", b""),
            "y has 40000000 numbers, but at most 30000000",
        ),
    ],
)
def test_a_matlab_file_made_to_do_harm_is_refused(tmp_path, content, message):
    with pytest.raises(InvalidInput, match=rf"run\.mat: .*({message})"):
        read_foreign(mat(tmp_path / "run.mat", content()), COLUMNS)


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="only Linux limits a process's memory")
def test_a_matlab_file_that_says_too_much_gets_no_memory(tmp_path):
    with pytest.raises(InvalidInput, match=r"run\.mat: it takes too much memory"):
        read_foreign(mat(tmp_path / "run.mat", liar()), COLUMNS)


def test_the_process_apart_gives_the_numbers_and_has_its_time(tmp_path, monkeypatch):
    path = tmp_path / "run.mat"
    values = np.random.default_rng(1).standard_normal(500)
    scipy.io.savemat(path, {"y": values, "t": np.arange(500)})
    columns = replace(COLUMNS, time=Column("time", "t", "ms"))
    assert (read_foreign(path, columns).values == values).all()
    monkeypatch.setattr(apart, "_SECONDS", 0.01)
    with pytest.raises(InvalidInput, match=r"run\.mat: it cannot be read within 0 s"):
        read_foreign(path, columns)


# a small sample of the campaign in benchmarks/fuzz_files.py


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz")
    return folder, fuzz_files.prepare(folder)


@pytest.mark.parametrize(
    "kind",
    [
        *("machine", "every table", "bundled", "plan", "scenario", "controller"),
        *("log", "csv", "hdf5", "mat", "columns", "table", "unv"),
    ],
)
def test_damaged_files_are_read_or_refused(workshop, kind):
    folder, kinds = workshop
    assert kind in kinds
    files = [path.read_bytes() for path in sorted(folder.glob(f"{kind}.*.original"))]
    path = fuzz_files.place(kind, folder)
    for _, data in zip(range(4), fuzz_files.cases(kind, files, seed=5), strict=False):
        path.write_bytes(data)
        assert fuzz_files.judge(kind, path, folder) in {"read", "refused"}


def test_damaged_controllers_are_read_or_refused(workshop):
    folder, _ = workshop
    files = [path.read_bytes() for path in sorted(folder.glob("controller.*.original"))]
    path, refused = fuzz_files.place("controller", folder), 0
    for _, data in zip(range(60), fuzz_files.cases("controller", files, seed=5), strict=False):
        path.write_bytes(data)
        try:
            read_controller(path)
        except InvalidInput:
            refused += 1
    assert 20 < refused < 60


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "[" * 1_000_000, "nested more than 20 times"),
        (
            lambda text: "[" + "[]," * 1_000_001 + "]",
            "the count of numbers is about 1000001, but must be at most 1000000",
        ),
        (
            lambda text: "{" + ",".join(f'"k{i}": 0' for i in range(1001)) + "}",
            "keys of a table is 1001",
        ),
        (
            lambda text: re.sub('"delay_samples": [^,}]+', '"delay_samples": 1000000', text),
            "delay_samples is 1000000",
        ),
        (lambda text: re.sub('"rate": [^,}]+', '"rate": "x"', text), "settings.rate is 'x'"),
        (
            lambda text: re.sub(
                r'"A": \[.*?\n \]', f'"A": {[[0.0]] * 501}', text, count=1, flags=re.S
            ),
            "states is 501",
        ),
    ],
)
def test_a_controller_file_with_too_much_is_refused_at_once(workshop, tmp_path, change, message):
    path = tmp_path / "k.json"
    sound = (workshop[0] / "controller.0.original").read_text()
    path.write_text(change(sound))
    begun = time.process_time()
    with pytest.raises(InvalidInput, match=message) as caught:
        read_controller(path)
    assert time.process_time() - begun < 2 and len(str(caught.value)) < 400


def test_the_campaign_sees_a_breach(workshop, monkeypatch):
    folder, _ = workshop
    monkeypatch.setattr(csv_file, "read_csv", lambda path: 1 / 0)
    path = fuzz_files.place("csv", folder)
    path.write_bytes((folder / "csv.0.original").read_bytes())
    assert fuzz_files.judge("csv", path, folder).startswith("traceback: ZeroDivisionError")


def test_the_campaign_damages_reproducibly():
    sound = SMALL.encode()
    first, again = (fuzz_files.mutated(sound, random.Random(3), text=True) for _ in range(2))
    assert first == again != sound


@pytest.mark.study
@pytest.mark.timeout(7200)
def test_a_thousand_damaged_files_of_each_kind():
    assert fuzz_files.run(1000, 0) == 0


def test_some_damaged_files_of_each_kind():
    """Those above in this process; the others, as the campaign has them, in one of their own."""
    others = ("csv", "foreign", "tdms", "lateral", "their table", "rows", "calls", "absurd")
    assert fuzz_files.run(1, 1, others) == 0
