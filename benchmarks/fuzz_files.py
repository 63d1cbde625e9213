"""Random damage to every kind of file that the command line reads, and to the arguments of public
functions: refused with exit status 2 (InvalidInput and its like) and a message, or read.

    python -m benchmarks.fuzz_files [number of each kind, 1000] [seed, 0] [kinds, all]

A kind's files are read in a worker, so that a crash, a hang and memory without end are seen as
such; the worker goes on behind them. Counted as a breach of the contract: a traceback, an exit
status other than 0 and 2 (1 of verify and check), the end of the process by a signal, more than 30
s, a sentence that speaks of the source (a path, an entry of a matrix). "bundled" are the bundled
machines; "lateral" (lateral.json), "their table" (of compare) and "rows" (rows.jsonl of a campaign)
are made where they are asked for; "calls" gives public functions what they do not expect; "absurd"
sets one number of a machine file to what no machine has, or takes it times a million: one that
neither check nor the reader says a word about is counted as silent. What kills the reader of a
MATLAB, LabVIEW or HDF5 file in the worker is tried again the way the command does it, in a process
of its own.
"""

from __future__ import annotations

import inspect
import json
import random
import re
import subprocess
import sys
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import chdir, nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest import mock

SECONDS = 30
EVERY_TABLE = Path("tests", "machine", "small.toml")
# made by runs of their own, where they are asked for
MADE = ("lateral", "their table", "rows")
TEXTS = {"machine", "bundled", "every table", "controller", "csv", "plan", "scenario", "log", *MADE}
TEXTS |= {"table", "unv", "columns", "responses csv", "responses json"}
NOTHING_HAS = ("1e300", "-1e300", "1e-300", "-1e-300", "1e70", "-1e70")
MILLION = (1e6, 1e-6)  # as of a unit that was left out, twice
# what no sentence says: a place in the source, an entry of a matrix; to a user no type of Python
INTERNAL = re.compile(
    r"\.py\b|Traceback|site-packages|RuntimeWarning|calculation broke down"
    r"|\b[A-Z]\w?\[\d+(?:, \d+)*\] is nan"
)
OF_PYTHON = re.compile(rf"{INTERNAL.pattern}|NoneType|ndarray| at 0x[0-9a-f]{{8}}|np\.float64")
VENDOR = """Messung 17; Pruefstand
Zeit;Weg A;Strom A;
s;um;A;
0,0000;1,5;0,25;
0,0001;2,5;-0,25;
0,0002;-1,5;0,5;
0,0003;0;1e-1;
"""
UNIVERSAL = """    -1
    58
y
NONE
NONE
NONE
NONE
    1         0    0         0                    1   1                    1   1
         4         5         1  0.00000e+00  1.00000e-04  0.00000e+00
        17    0    0    0 Time                 s
         8    0    0    0 NONE                 um
         0    0    0    0 NONE                 NONE
         0    0    0    0 NONE                 NONE
   1.50000000000e+00  -2.25000000000e+00   3.00000000000e-03   0.00000000000e+00
   7.00000000000e+00
    -1
"""
THEIRS = """kind;speed [rpm];amplitude [um p-p];amplification [-];log_decrement [-];whirl;label
critical;5230;34.1;6.2;;;first
mode;5411;;;0.34;forward;
mode;2000;;;1.2;backward;rigid
response;4000;12.5;;;;
response;5000;10;;;;
"""
MACHINE = """[machine]
schema = 1
name = "tiny"
[[shaft]]
length = "100 mm"
outer_diameter = "40 mm"
[[shaft]]
length = "200 mm"
outer_diameter = "50 mm"
[[bearing]]
name = "A"
position = "50 mm"
bias_current = "2 A"
force_per_current = [100, 100]
negative_stiffness = "0.5 N/um"
max_current = "2 A"
[[sensor]]
bearing = "A"
position = "50 mm"
[[bearing]]
name = "B"
position = 0.25
bias_current = "2 A"
force_per_current = 100
negative_stiffness = "0.5 N/um"
[[sensor]]
bearing = "B"
position = 0.25
[amplifier]
order = "first"
bandwidth = "1 kHz"
[[seal]]
name = "s"
position = 0.15
reference_pressure = "2 bar"
scales_with_pressure = ["k", "C"]
k = 1e5
C = 1e2
[controller]
gain = "20 A/mm"
derivative_time = "2 ms"
sample_time = "100 us"
[operation]
speed_range = [0, "12000 rpm"]
[[operation.point]]
label = "nominal"
speed = "6000 rpm"
seal_pressure = "1 bar"
[[tolerance]]
parameter = "bearing.A.negative_stiffness"
relative = "10 %"
"""
PLAN = """[campaign]
task = "screen"
machine = "tiny.toml"
controller = "k.json"
plan = "grid"
[options]
delay_samples = 1
[vary]
"point.speed" = {from = "0 Hz", to = "100 Hz", count = 2}
"point.seal_pressure" = ["0 bar", "1 bar"]
"machine.bearing.*.negative_stiffness" = {from = 0.9, to = 1.1, count = 2, times = true}
"tolerance.bearing.A.negative_stiffness" = [-1.0, 1.0]
"controller.gain" = [1.0, 1.1]
"""
SCENARIO = """name = "knocks"
duration = "20 ms"
speed = "50 Hz"
to_speed = "60 Hz"
ramp = "10 ms"
[[pulse]]
signal = "e_first_zeta"
amplitude = "0.1 A"
start = "5 ms"
duration = "2 ms"
[[sine]]
signal = "d_last_eta"
amplitude = "1 um"
frequency = "100 Hz"
[[unbalance]]
port = "A"
amount = "1 g mm"
"""
COLUMNS = """machine = "tiny"
sample_rate_hz = 1000
point = {speed = 0, seal_pressure = 0}
signal = [{name = "y_A_zeta", source = "SOURCE", unit = "m"}]
"""
OF_TABLE = """machine = "tiny"
[point]
speed = "3000 rpm"
seal_pressure = "2 bar"
[time]
source = "Zeit"
unit = "s"
[[signal]]
name = "y_A_zeta"
source = "Weg A"
unit = "um"
scale = -1.5
offset = 2.0
[[signal]]
name = "i_A_zeta"
source = "Strom A"
"""
VALUES = (
    "0",
    "-1",
    "1",
    "2",
    "7",
    "0.3",
    "1e3",
    "-1e-3",
    "1e308",
    "-1e308",
    "1e-300",
    "1e15",
    "400",
    "1e-9",
    "60",
    "12345678901",
)
TOKENS = (
    *(
        "0",
        "-1",
        "1e308",
        "-1e308",
        "1e-320",
        "nan",
        "inf",
        "9" * 400,
        "1" * 5000,
        "0x" + "f" * 300,
        "2147483648",
        "1e9",
        '""',
    ),
    *(
        '"5 kg"',
        '"1e99 mm"',
        '"nan"',
        "true",
        "null",
        "[]",
        "{}",
        "[[",
        "]]",
        "{",
        '"',
        "'''",
        "\\u0000",
        "\x1b[31m",
        "\0",
        "\ud7ff",
    ),
    *(
        "a.b.c.d.e.f.g.h.i.j.k.l.m.n = 1\n",
        "[" * 50,
        "{a=" * 50,
        "=",
        ",",
        "\n",
        "#",
        "é",
        "﻿",
        "1979-05-27",
        "a" * 300,
    ),
)


def originals(folder: Path) -> dict[str, list[bytes]]:
    """Sound files of every kind."""
    import h5py
    import numpy as np
    import scipy.io

    import ambrose as amb
    from ambrose.core.scheduled import ScheduledSystem
    from ambrose.judge.controller_file import write_controller
    from ambrose.judge.result import Synthesis
    from ambrose.record.files import write_record
    from ambrose.record.record import Record

    machine = folder / "tiny.toml"
    machine.write_text(MACHINE)
    found: dict[str, list[bytes]] = {"machine": [MACHINE.encode()]}
    pid = amb.design(amb.load_machine(machine), "pid")
    law = pid.controller
    scheduled = ScheduledSystem([0.0, 500.0, 1000.0], [law] * 3)
    laws = [pid, Synthesis(law, "lpv", scheduled=scheduled)]
    found["controller"] = [write_controller(folder / "k.json", item).read_bytes() for item in laws]
    write_controller(folder / "k.json", pid)
    # every table that a machine file can hold, five axes and synchronous blocks among them
    found["every table"] = [(Path(__file__).parent.parent / EVERY_TABLE).read_bytes()]
    found["bundled"] = [path.read_bytes() for path in amb.bundled_machines().values()]
    found["table"], found["unv"] = [VENDOR.encode()], [UNIVERSAL.encode()]
    found["columns"] = [OF_TABLE.encode()]
    found["plan"] = [PLAN.encode()]
    found["scenario"] = [SCENARIO.encode()]
    found["log"] = [logged(machine, pid, folder)]
    wave = np.sin(np.arange(50.0))
    record = Record(
        "tiny",
        1e3,
        ("y_A_zeta", "i_A_zeta"),
        ("m", "A"),
        np.array([wave, wave]),
        notes=(("by", "x"),),
    )
    found["csv"] = [write_record(record, folder / "r.csv").read_bytes()]
    old = folder / "old.h5"
    with h5py.File(old, "w", libver="earliest") as file:
        file.attrs.update(
            {key: value for key, value in record.attributes.items() if value is not None}
        )
        for name, unit, row in zip(record.signals, record.units, record.values, strict=True):
            data = file.create_dataset(
                f"signals/{name}", data=row, chunks=(16,), compression="gzip", shuffle=True
            )
            data.attrs["unit"] = unit
    for suffix, data in measured(amb.load_machine(machine), law, folder).items():
        found[f"responses {suffix}"] = [data]
    found["hdf5"] = [write_record(record, folder / "r.h5").read_bytes(), old.read_bytes()]
    variables = {
        "y": wave,
        "log": {"a": wave, "c": np.array([wave, "text"], object)},
        "z": np.eye(3),
        "t": "text",
    }
    for name, packed in (("a", False), ("b", True)):
        scipy.io.savemat(folder / f"{name}.mat", variables, do_compression=packed)
    scipy.io.savemat(folder / "c.mat", {"y": wave}, format="4")
    with h5py.File(folder / "d.mat", "w", userblock_size=512) as file:
        file["y"] = wave[None]
    found["mat"] = [(folder / f"{name}.mat").read_bytes() for name in "abcd"]
    with h5py.File(folder / "foreign.h5", "w") as file:
        file["y"] = wave
        file["y"].attrs.update(units="um", scale_factor=0.5, add_offset=1.0)
    found["foreign"] = [(folder / "foreign.h5").read_bytes()]
    try:
        from nptdms import ChannelObject, TdmsWriter
    except ImportError:
        return found
    with TdmsWriter(folder / "r.tdms") as writer:
        for _ in range(2):
            writer.write_segment(
                [ChannelObject("g", "y", wave, {"wf_increment": 1e-3, "unit_string": "m"})]
            )
    found["tdms"] = [(folder / "r.tdms").read_bytes()]
    return found


def measured(machine: Any, law: Any, folder: Path) -> dict[str, bytes]:
    """The sensitivity of every axis, as an analyser would export it, in every own format."""
    import numpy as np

    import ambrose as amb
    from ambrose.core.frequency import frequency_response
    from ambrose.record.response import Path as Measured, Response
    from ambrose.record.response_files import write_response

    plant = amb.reduce(amb.assemble(machine))
    omega = np.geomspace(10.0, 3e3, 40)
    axes = machine.axes
    G = frequency_response(plant.system, omega)
    K = frequency_response(law, omega)
    G = G.values[:, : len(axes), : len(axes)]
    S = np.linalg.inv(np.eye(len(axes)) + G @ K.values)  # size and shape of one, no more
    paths = [Measured("S", axis, axis, values=S[:, k, k]) for k, axis in enumerate(axes)]
    point = amb.OperatingPoint(speed=0.0, seal_pressure=1e5)
    found = Response(machine.name, omega, tuple(paths), point, sample_rate_hz=1e4)
    return {
        suffix: write_response(found, folder / f"responses.{suffix}").read_bytes()
        for suffix in ("csv", "json", "h5")
    }


def logged(machine: Path, law: object, folder: Path) -> bytes:
    """A text record of the closed loop, as a data logger writes it: what a user reads back."""
    import ambrose as amb
    from ambrose.record.files import write_record

    scenario = folder / "excited.toml"
    scenario.write_text(
        'name = "excited"\nduration = "60 ms"\n[[prbs]]\nsignal = "e_first_zeta"\n'
        'amplitude = "50 mA"\nbit_time = "1 ms"\n'
    )
    plant = amb.reduce(amb.assemble(amb.load_machine(machine)))
    trace = amb.simulate(plant, law, scenario, linear=True)
    return write_record(trace.record, folder / "log.csv").read_bytes()


def mutated(data: bytes, chance: random.Random, *, text: bool) -> bytes:
    """The same with one to six random changes: bits, slices and numbers, and in a text tokens,
    lines and values.
    """
    for _ in range(chance.choice((1, 1, 1, 2, 3, 6))):
        at, size = chance.randrange(len(data) + 1), chance.choice((1, 2, 4, 8, 60, 400))
        other = chance.randrange(len(data) + 1)
        way = chance.randrange(10 if text else 5)
        if text and chance.random() < 0.6:  # another number: the form stays, the physics may not
            numbers = [*re.finditer(rb"(?<![\w.])-?\d[\d.]*(?:e[+-]?\d+)?(?![\w.])", data)]
            place = chance.choice(numbers) if numbers else re.search(rb"$", data)
            value = chance.choice(
                (chance.choice(VALUES).encode(), chance.choice(numbers)[0] if numbers else b"1")
            )
            data = data[: place.start()] + value + data[place.end() :]  # type: ignore[union-attr]
        elif way == 0 and data:
            at = min(at, len(data) - 1)
            data = data[:at] + bytes([data[at] ^ (1 << chance.randrange(8))]) + data[at + 1 :]
        elif way == 1:
            data = data[:at] + data[at + size :]
        elif way == 2:
            data = data[:at] + data[other : other + size] + data[at:]
        elif way == 3:
            data = data[:at] + data[other : other + size] + data[at + size :]
        elif way == 4 and not text:
            number = chance.choice(
                (
                    0,
                    1,
                    255,
                    2**31 - 1,
                    2**31,
                    2**32 - 1,
                    2**40,
                    2**63,
                    2**64 - 1,
                    chance.getrandbits(64),
                )
            )
            data = (
                data[:at]
                + number.to_bytes(8, "little")[: chance.choice((1, 2, 4, 8))]
                + data[at + chance.choice((1, 4, 8)) :]
            )
        elif way == 4 and chance.random() < 0.2:
            data = data[:at]
        elif text:
            token = chance.choice(TOKENS).encode("utf-8", "surrogatepass")
            places = list(
                re.finditer(rb'-?\d[\d.eE+-]*|"[^"\n]*"|\w+' if way < 8 else rb"[^\n]*\n", data)
            )
            if places:
                place = chance.choice(places)
                swap = chance.choice(places)[0] if way in {5, 8} else token
                data = (
                    data[: place.start()]
                    + swap
                    + data[place.end() if way != 9 else place.start() :]
                )
    return data


def cases(kind: str, files: list[bytes], seed: int) -> Iterator[bytes]:
    """Damaged files of a kind, without end."""
    number = 0
    while True:
        chance = random.Random(f"{kind} {seed} {number}")
        yield (
            f"{seed} {number}".encode()
            if kind == "calls"
            else mutated(chance.choice(files), chance, text=kind in TEXTS)
        )
        number += 1


def judge(kind: str, path: Path, folder: Path, *, apart: bool = False) -> str:
    """ "read", "refused", or what breaks the contract."""
    from click.testing import CliRunner

    from ambrose.cli import main
    from ambrose.record import apart as process, foreign
    from ambrose.record.apart import read_variables

    tiny = str(folder / "tiny.toml")
    running = ["--controller", str(folder / "k.json")]
    out = ["-o", str(folder / "out.h5")]
    commands = {
        **{key: ["check", str(path)] for key in ("machine", "bundled", "every table")},
        "columns": ["convert", str(folder / "table.0.original.csv"), "--columns", str(path), *out],
        "controller": random.Random(path.read_bytes()).choice(
            [
                ["verify", tiny, "--controller", str(path)],
                [
                    *("export", str(path), "--to", "mat", "--machine", tiny),
                    *("--error-limit", "3e-4", "--current-limit", "2", *out_folder(folder)[:2]),
                ],
            ]
        ),
        "plan": ["campaign", str(path), "--workers", "1", "--most", "2", *out_folder(folder)],
        "lateral": ["compare", str(path), str(folder / "lateral.0.original.json")],
        "their table": ["compare", str(folder / "lateral.0.original.json"), str(path)],
        "rows": ["campaign", str(folder / "rows.toml"), *rows_taken(kind, path, folder)],
        "scenario": ["simulate", tiny, *running, "--scenario", str(path), "--linear", *out],
        "log": random.Random(path.read_bytes()).choice(
            [
                ["record", "check", str(path), tiny],
                ["balance", tiny, str(path), "--plane", "A=20 mm", *running],
                ["accept", tiny, running[1], str(path)],
                ["calibrate", tiny, "--levitated", str(path)],
                ["frf", tiny, str(path), *running],
                ["retune", tiny, str(path), *running, *out_folder(folder)[:2]],
            ]
        ),
    }
    if kind.startswith("responses "):
        commands[kind] = random.Random(path.read_bytes()).choice(
            [
                ["record", "check", str(path), tiny],
                ["verify", tiny, *running, "--measured", str(path), "--running", running[1]],
                ["accept", tiny, running[1], str(path)],
                ["identify", tiny, str(path), *running, *out_folder(folder)[:2]],
            ]
        )
    if kind == "calls":
        with chdir(out_folder(folder)[1]):
            return called(path.read_bytes())
    columns = folder / f"{kind}.map.toml"
    given = ["--columns", str(columns)] if columns.exists() else []
    arguments = commands.get(kind, ["convert", str(path), *given, "-o", str(folder / "out.h5")])
    here = mock.patch.object(
        foreign, "variables_of", lambda path, names: nullcontext(list(read_variables(path, names)))
    )
    untried = mock.patch.object(process, "try_record", lambda path: None)
    with nullcontext() if apart else here, nullcontext() if apart else untried:
        result = CliRunner(env={"AMBROSE_TRACEBACK": "1"}).invoke(main, arguments)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        return f"traceback: {result.exception!r:.150}"
    if found := OF_PYTHON.search(result.output):
        return f"speaks of the source: {result.output[max(found.start() - 90, 0) :]:.200}"
    if result.exit_code == 2:
        return (
            "refused"
            if "ambrose: " in result.output
            else f"status 2 without a message: {result.output:.150}"
        )
    return (
        "read"
        if result.exit_code in ({0} if arguments[0] == "convert" else {0, 1})
        else f"status {result.exit_code}"
    )


def out_folder(folder: Path) -> list[str]:
    """A folder of its own for every plan: rows of an earlier one would be taken up."""
    return ["-o", tempfile.mkdtemp(dir=folder), "--pages", "0"]


def rows_taken(kind: str, path: Path, folder: Path) -> list[str]:
    """A folder of its own that holds the damaged rows, for the campaign to take up."""
    if kind != "rows":
        return []
    out = out_folder(folder)
    (Path(out[1]) / "rows.jsonl").write_bytes(path.read_bytes())
    return [*out, "--workers", "1", "--most", "2"]


def made(kind: str, folder: Path) -> None:
    """The sound files of a kind that a run makes."""
    from click.testing import CliRunner

    from ambrose.cli import main

    def run(*words: str) -> None:
        done = CliRunner().invoke(main, list(words))
        assert done.exit_code in {0, 1}, done.output

    tiny, law = str(folder / "tiny.toml"), str(folder / "k.json")
    data = folder / "lateral.0.original.json"
    if kind in {"lateral", "their table"} and not data.exists():
        run("lateral", tiny, "--controller", law, "--data", str(data))
        (folder / "lateral.0.original").write_bytes(data.read_bytes())
    if kind == "their table":
        (folder / f"{kind}.0.original").write_text(THEIRS)
    if kind == "rows":
        (folder / "rows.toml").write_text(PLAN)
        out = out_folder(folder)
        run("campaign", str(folder / "rows.toml"), *out, "--workers", "1", "--most", "2")
        rows = (Path(out[1]) / "rows.jsonl").read_bytes()
        (folder / f"{kind}.0.original").write_bytes(rows)


@cache
def hostile() -> list[Any]:
    """What is given to an argument in place of what it expects."""
    import numpy as np

    numbers = [-3, 0, 10**6, 10**400, 1e300, float("nan")]
    texts = ["no", "", "\0", b"x"]
    arrays = [np.zeros((0, 0)), np.full((2, 2), np.nan), np.array("x")]
    return [None, *numbers, *texts, [], {}, [None], ["a"], object(), int, *arrays]


@cache
def sensible() -> Mapping[str, dict[str, Any]]:
    """Calls that succeed, of functions that take milliseconds: keyword arguments by name."""
    import numpy as np

    import ambrose as amb

    rig = amb.load_machine("seal-rig")
    shaft = tuple(replace(section, elements=1) for section in rig.shaft)
    machine = replace(rig, shaft=shaft, tolerances=())
    whole = amb.assemble(machine)
    plant, law = amb.reduce(whole, 0), amb.design(machine, "pid")
    one = amb.StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    two = amb.StateSpace(
        -np.eye(2), np.eye(2), np.eye(2), np.zeros((2, 2)), inputs=("w", "u"), outputs=("z", "y")
    )
    signals = tuple(f"y_{axis}" for axis in machine.axes)
    record = amb.Record(
        "m", 1e4, signals, ("m",) * 4, np.random.default_rng(0).normal(0, 1e-6, (4, 500))
    )
    block, plan = (
        amb.RealBlock("a", 2),
        {"campaign": {"task": "screen", "machine": "seal-rig", "controller": "pid"}},
    )
    return {
        "poles": {"system": one},
        "select": {"system": one, "inputs": one.inputs, "outputs": one.outputs},
        "spectral_abscissa": {"system": one},
        "delayed": {
            "system": amb.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], dt=1e-3),
            "samples": 2,
        },
        "hinf_norm": {"system": one},
        "frequency_response": {"system": one, "omega": [1.0, 2.0]},
        "time_response": {"system": one, "u": np.ones((1, 5)), "dt": 1e-3},
        "minimal": {"system": one},
        "lft": {
            "plant": amb.GeneralizedPlant(two, ("w",), ("u",), ("z",), ("y",)),
            "controller": one,
        },
        "mu_bounds": {"M": 0.5 * np.eye(2) + 0j, "blocks": [block]},
        "mu_peak": {"system": two, "blocks": [block], "omega": [1.0]},
        "assemble": {"machine": machine},
        "reduce": {"plant": plant},
        "design": {"machine": plant, "method": "pid"},
        "verify": {"machine": plant, "controller": law, "tolerances": False},
        "simulate": {
            "machine": plant,
            "controller": law,
            "scenario": "impulse-parallel",
            "linear": True,
        },
        "closed_loop": {"plant": plant},
        "free_mode_reduction": {"plant": whole, "bending_modes": 1},
        "perturbed": {"plant": plant, "delta": {}},
        "Tolerance": {"parameter": "seal.center.k", "relative": 0.1},
        "OperatingPoint": {},
        "RealBlock": {"name": "a"},
        "Record": {
            "machine": "m",
            "sample_rate_hz": 1e3,
            "signals": ("y_A",),
            "units": ("m",),
            "values": np.ones((1, 3)),
        },
        "Scenario": {"name": "s", "duration": 0.1},
        "load_scenario": {},
        "save_machine": {"machine": machine, "path": "machine.toml"},
        "write_record": {"record": record, "path": "record.h5"},
        "plot": {"item": machine},
        "C": {},
        "StateSpace": {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]]},
        "calibrate": {"machine": machine, "circle": record},
        "campaign": {"plan": {**plan, "vary": {"point.speed": ["5 kg"]}}},
    }


def called(case: bytes) -> str:
    """A public function with one to three arguments that it does not expect, some of them what
    other functions take: "read", "refused", or what breaks the contract.
    """
    import ambrose as amb

    chance, calls = random.Random(case), sensible()
    others = [value for call in calls.values() for value in call.values()]
    name = chance.choice([name for name in sorted(amb.__all__) if _is_called(name)])
    known = [
        item
        for item in inspect.signature(getattr(amb, name)).parameters.values()
        if item.kind not in (item.VAR_KEYWORD, item.VAR_POSITIONAL) and item.name != "progress"
    ]
    needed = [item.name for item in known if item.default is item.empty]
    call = dict(calls.get(name, {}))
    # one without a call that is sensible otherwise would take minutes if it began
    pool = [*hostile(), *(others if name in calls else ())]
    call |= {key: chance.choice(pool) for key in needed if key not in call}
    for _ in range(chance.choice((1, 1, 2, 3)) if known else 0):
        call[chance.choice(known).name] = chance.choice(pool)
    shown = ", ".join(f"{key}={value!r:.40}" for key, value in call.items())
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            getattr(amb, name)(**call)
            verdict, said = "read", ""
        except amb.AmbroseError as error:
            verdict, said = "refused", str(error)
        except Exception as error:
            return f"traceback: {name}({shown}): {error!r:.150}"
    if (found := INTERNAL.search(said)) and found[0].partition("[")[0] not in call:
        return f"speaks of the source: {name}({shown}): {said[max(found.start() - 90, 0) :]:.200}"
    if warned:
        return f"warns: {name}({shown}): {verdict}: {warned[0].message}: {warned[0].filename[-40:]}"
    return verdict


def _is_called(name: str) -> bool:
    import ambrose as amb

    item = getattr(amb, name)
    error = isinstance(item, type) and issubclass(item, Exception)
    return callable(item) and not error and name != "Identification"


def absurd(text: str, chance: random.Random) -> tuple[str, str]:
    """The machine file with one number that nothing has, and its line."""
    lines = text.splitlines()
    from ambrose.machine.validation.ranges import ranges

    rows = ranges()[0].items()
    keys = {path.rpartition(".")[2] for path, _ in rows}
    # those of which a number near zero is as good as none
    signed = {path.rpartition(".")[2] for path, row in rows if str(row[0])[0] in "-0p"}
    number = re.compile(r"(?<![\w.^])-?\d[\d.]*(?:e[+-]?\d+)?(?![\w.])")
    places = [
        (i, match)
        for i, line in enumerate(lines)
        if line.partition(" =")[0] in keys and not line.startswith("number")
        for match in number.finditer(line.partition("#")[0])
        if "degC" not in line  # 1e-300 of it are 273.15 K
    ]
    i, match = chance.choice(places)
    value = chance.choice(NOTHING_HAS)
    if float(match[0]) and chance.random() < 0.5:
        key = lines[i].partition(" =")[0]
        value = f"{float(match[0]) * chance.choice(MILLION[: 1 + (key not in signed)]):.6g}"
    lines[i] = lines[i][: match.start()] + value + lines[i][match.end() :]
    return "\n".join(lines), lines[i]


def unnoticed(count: int, seed: int) -> tuple[Counter[str], list[str]]:
    """How many numbers that no machine has are refused and doubted, and the lines of the others."""
    from ambrose.chain.check import entry_doubts
    from ambrose.core.checks import InvalidInput
    from ambrose.machine.file.toml import loads_machine

    text = (Path(__file__).parent.parent / EVERY_TABLE).read_text()
    tally: Counter[str] = Counter()
    lines: list[str] = []
    sound = set(entry_doubts(loads_machine(text)))
    for k in range(count):
        other, line = absurd(text, random.Random(f"absurd {seed} {k}"))
        try:
            told = set(entry_doubts(loads_machine(other))) - sound
            verdict = "doubted" if told else "silent"
        except InvalidInput:
            verdict = "refused"
        except Exception as error:
            verdict = f"traceback: {error!r:.80}"
        tally[verdict if verdict in {"refused", "doubted", "silent"} else "breach"] += 1
        lines += [f"{k}: {verdict}: {line:.120}"] if verdict not in {"refused", "doubted"} else []
    return tally, lines


def place(kind: str, folder: Path) -> Path:
    """Where the damaged file goes."""
    suffixes = {"machine": "toml", "every table": "toml", "plan": "toml", "scenario": "toml"}
    suffixes |= {"controller": "json", "hdf5": "h5", "log": "csv", "bundled": "toml"}
    suffixes |= {"table": "csv", "foreign": "h5", "columns": "toml", "calls": "txt"}
    suffixes |= {"lateral": "json", "their table": "csv", "rows": "jsonl"}
    return folder / f"damaged.{suffixes.get(kind, kind).removeprefix('responses ')}"


def work(kind: str, folder: Path, seed: int, first: int, last: int) -> None:
    """What a worker does: judge one case after the other, and tell each."""
    from ambrose.record.apart import _MEMORY, _limit

    if kind in {"mat", "tdms"}:
        _limit(_MEMORY, 7200)
    files = [path.read_bytes() for path in sorted(folder.glob(f"{kind}.*.original"))]
    path = place(kind, folder)
    out = sys.stdout
    for number, data in zip(range(last), cases(kind, files, seed), strict=False):
        if number >= first:
            path.write_bytes(data)
            print(number, json.dumps(judge(kind, path, folder)), file=out, flush=True)


def campaign(kind: str, folder: Path, seed: int, count: int) -> tuple[Counter[str], list[str]]:
    """How many were read and refused, and the breaches."""
    tally: Counter[str] = Counter()
    breaches, number = [], 0
    while number < count:
        command = [
            sys.executable,
            "-W",
            "ignore",
            "-m",
            __name__ if __name__ != "__main__" else "benchmarks.fuzz_files",
        ]
        worker = subprocess.Popen(
            [*command, "work", kind, str(folder), str(seed), str(number), str(count)],
            stdout=subprocess.PIPE,
            text=True,
        )
        words = ""
        while number < count:
            words = _line(worker)
            if not words.partition(" ")[2]:
                break
            verdict = json.loads(words.partition(" ")[2])
            tally[verdict if verdict in {"read", "refused"} else "breach"] += 1
            breaches += (
                [f"{kind} {number}: {verdict}"] if verdict not in {"read", "refused"} else []
            )
            number += 1
        worker.kill()
        worker.communicate()  # waits, and closes the pipe
        status = worker.returncode
        if number < count:
            verdict = f"the process ended with {status}, or took more than {SECONDS} s"
            if kind in {"mat", "tdms", "hdf5", "foreign"}:
                verdict = judge(kind, place(kind, folder), folder, apart=True)
            tally["refused apart" if verdict == "refused" else "breach"] += 1
            breaches += [f"{kind} {number}: {verdict}"] if verdict != "refused" else []
            number += 1
    return tally, breaches


def _line(worker: subprocess.Popen[str]) -> str:
    import threading

    assert worker.stdout is not None
    found: list[str] = []
    reader = threading.Thread(target=lambda: found.append(worker.stdout.readline()), daemon=True)  # type: ignore[union-attr]
    reader.start()
    reader.join(SECONDS + 20)  # and the start of the worker
    return found[0] if found else ""


def prepare(folder: Path) -> list[str]:
    """The sound files, for the workers; the kinds."""
    found = originals(folder)
    for kind, files in found.items():
        for i, data in enumerate(files):
            (folder / f"{kind}.{i}.original").write_bytes(data)
    for kind, source in (("mat", "y"), ("tdms", "g/y"), ("foreign", "y")):
        (folder / f"{kind}.map.toml").write_text(COLUMNS.replace("SOURCE", source))
    (folder / "unv.map.toml").write_text(COLUMNS.replace("SOURCE", "y").replace("1000", "1e4"))
    (folder / "table.map.toml").write_text(OF_TABLE)
    (folder / "table.0.original.csv").write_text(VENDOR)
    return list(found)


def run(count: int, seed: int, kinds: Sequence[str] = ()) -> int:
    """All kinds, or those named; the number of breaches."""
    total = 0
    with tempfile.TemporaryDirectory() as name:
        every = prepare(Path(name))
        for kind in kinds or (*every, *MADE, "calls", "absurd"):
            if kind in MADE:
                made(kind, Path(name))
            if kind == "absurd":
                tally, breaches = unnoticed(count, seed)
                print(f"{kind:12s}", dict(tally), *breaches, sep="\n  ", flush=True)
                total += len(breaches)
                continue
            tally, breaches = campaign(kind, Path(name), seed, count)
            print(f"{kind:12s}", dict(tally), flush=True)
            print("".join(f"  {line}\n" for line in breaches), end="", flush=True)
            total += len(breaches)
    return total


if __name__ == "__main__":
    if sys.argv[1:2] == ["work"]:
        work(sys.argv[2], Path(sys.argv[3]), *map(int, sys.argv[4:]))
    else:
        given = [*sys.argv[1:], *["1000", "0"][len(sys.argv) - 1 :]]
        sys.exit(bool(run(int(given[0]), int(given[1]), given[2:])))
