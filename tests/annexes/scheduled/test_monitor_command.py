"""`ambrose monitor`: records of the nonlinear rig on machines of two and three bearings, its page,
its table, its refusals.
"""

import csv
import json
from dataclasses import replace

import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.record.files import read_record, write_record
from coarse import coarse_file

BRIEF = """
name = "brief"
duration = "2.2 s"
[[prbs]]
signal = "e_every_zeta"
amplitude = "0.05 A"
bit_time = "1 ms"
[[prbs]]
signal = "e_every_eta"
amplitude = "0.05 A"
bit_time = "1 ms"
seed = 1
"""


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(
    scope="module",
    params=[
        ("seal-rig", "nominal"),
        pytest.param(("three-bearing-train", "half speed"), marks=pytest.mark.study),
    ],
)
def place(request, tmp_path_factory):
    """A machine, a point, and a folder with a PID and a record of the nonlinear rig."""
    name, point = coarse_file(request.param[0]), request.param[1]
    folder = tmp_path_factory.mktemp("monitor")
    (folder / "brief.toml").write_text(BRIEF)
    made = call("synthesize", name, "--method", "pid", "-o", folder / "pid.json", "--json")
    # the rig's own PID loses twice nominal pressure, which is told by the status
    assert made.exit_code == (1 if request.param[0] == "seal-rig" else 0), made.stderr
    done = call(
        "simulate",
        name,
        "--controller",
        folder / "pid.json",
        "--scenario",
        folder / "brief.toml",
        "--rate-hz",
        "10000",
        "--point",
        point,
        "-o",
        folder / "r.h5",
        "--json",
    )
    assert done.exit_code == 0, done.stderr
    return name, folder


@pytest.mark.parametrize(
    "place", [("seal-rig", "nominal"), ("three-bearing-train", "half speed")], indirect=True
)
def test_the_pressure_is_found_and_shown(place):
    name, folder = place
    done = call(
        "monitor",
        name,
        folder / "pid.json",
        folder / "r.h5",
        "--json",
        "--csv",
        folder / "t.csv",
        "-o",
        folder / "p.html",
        "--code",
        folder / "code",
        "--bending-modes",
        1,
    )
    assert done.exit_code == 0, done.stdout + done.stderr
    told = json.loads(done.stdout)
    pressure = read_record(folder / "r.h5").point.seal_pressure
    (value,), (half,) = ([told[key][0][-1]] for key in ("values", "half_widths"))
    assert (
        abs(value - pressure) < half < 0.2 * amb.load_machine(name).operation.nominal.seal_pressure
    )
    assert told["limits"][0][0] < pressure < told["limits"][0][1] and told["findings"] == []
    rows = list(csv.reader((folder / "t.csv").read_text().splitlines()))
    assert len(rows) == len(told["time_s"]) + 1 and float(rows[-1][1]) == pytest.approx(
        value, rel=1e-4
    )
    assert "Cost:" in (folder / "code" / "seal_monitor.h").read_text() and told["code"]
    page = (folder / "p.html").read_text()
    assert told["paths"][0] in page and "The seal is within its range: " in page


def test_the_library_says_what_the_command_says(place):
    name, folder = place
    found = amb.monitor(name, folder / "pid.json", folder / "r.h5", bending_modes=1)
    done = call(
        "monitor", name, folder / "pid.json", folder / "r.h5", "--json", "--bending-modes", 1
    )
    told = json.loads(done.stdout)
    assert list(found.paths) == told["paths"] and list(found.findings) == told["findings"]
    assert (
        found.values[-1, 0] == told["values"][0][-1]
        and found.half_widths[-1, 0] == told["half_widths"][0][-1]
    )
    with pytest.raises(amb.InvalidInput, match=r"missing\.h5"):
        amb.monitor(name, folder / "pid.json", folder / "missing.h5")


def test_a_wrong_pressure_is_seen(place):
    """The same record, said to be taken at a pressure a third lower: the seal contradicts it, in
    words.
    """
    name, folder = place
    record = read_record(folder / "r.h5")
    wrong = replace(
        record,
        point=replace(record.point, seal_pressure=0.67 * record.point.seal_pressure, label=""),
    )
    write_record(wrong, folder / "wrong.h5")
    done = call("monitor", name, folder / "pid.json", folder / "wrong.h5", "--details")
    assert done.exit_code == 1 and "outside the estimate" in done.stdout, done.stdout


def test_refusals(place, tmp_path):
    name, folder = place
    record = read_record(folder / "r.h5")
    write_record(record.select([n for n in record.signals if n[:2] != "u_"]), tmp_path / "bare.h5")
    done = call("monitor", name, folder / "pid.json", tmp_path / "bare.h5")
    assert done.exit_code == 2 and "has no u_" in done.stderr
    done = call("monitor", name, folder / "pid.json", folder / "r.h5", "--seal", "none")
    assert done.exit_code == 2 and "correct the name" in done.stderr
    two = ("--unknown", "k", "--unknown", "C", "--code", tmp_path / "code")
    done = call("monitor", name, folder / "pid.json", folder / "r.h5", *two)
    assert (
        done.exit_code == 2 and "one parameter" in done.stderr and not (tmp_path / "code").exists()
    )
    write_record(record.select([n for n in record.signals if n[:2] != "e_"]), tmp_path / "still.h5")
    done = call("monitor", name, folder / "pid.json", tmp_path / "still.h5", "--details")
    assert done.exit_code == 1 and "nothing can be said" in done.stdout
