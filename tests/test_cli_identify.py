"""`ambrose identify`: from a record of the rig to a machine file that the other commands take; refusals, exit status, JSON."""

import json
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose import load_machine
from ambrose.cli import main
from ambrose.machine.config import machine_hash
from ambrose.machine.record import read_record, write_record

RIG = "seal-rig"
NINE = ("--unknown", "bearing.*.force_per_current.*", "--unknown", "bearing.*.negative_stiffness.*")
QUICK = """
name = "short"
duration = "1.2 s"
""" + "".join(
    f'\n[[prbs]]\nsignal = "e_{axis}"\namplitude = "0.1 A"\nbit_time = "1 ms"\norder = 9\nseed = {seed}\n'
    for seed, axis in enumerate(("A_zeta", "A_eta", "B_zeta", "B_eta"))
)


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with the bundled PID and two records of the rig that it levitated."""
    folder = tmp_path_factory.mktemp("identify")
    (folder / "short.toml").write_text(QUICK)
    assert call("synthesize", RIG, "-o", folder / "pid.json", "--json").exit_code == 0
    done = call(
        "simulate",
        RIG,
        "--controller",
        folder / "pid.json",
        "--scenario",
        folder / "short.toml",
        "-o",
        folder / "one.h5",
        "--json",
    )
    assert done.exit_code == 0, done.stderr
    record = read_record(folder / "one.h5")
    rng = np.random.default_rng(0)
    again = record.values.copy()
    again[:4] += 2e-9 * rng.standard_normal(again[:4].shape)
    write_record(replace(record, values=again), folder / "two.h5")
    return folder


@pytest.fixture(scope="module")
def identified(place):
    out = place / "identified.toml"
    page = place / "page.html"
    done = call("identify", RIG, place / "one.h5", "--controller", place / "pid.json", "-o", out, "--report", page)
    return done, out, page


def test_the_chain_from_a_record_to_a_controller(identified, tmp_path):
    done, out, page = identified
    assert done.exit_code in {0, 1}, done.stderr  # 1: the magnets' curvature may show in the residuals
    assert (done.exit_code == 0) == ("Warning" not in done.stdout and "still follows" not in done.stdout)
    assert "unknown: bearing.A.force_per_current.zeta" in done.stderr and "seal.center.k" in done.stderr
    assert "bearing.A.negative_stiffness.zeta" in done.stdout and "95 % interval" in done.stdout and "Verdict" in done.stdout
    before, after = load_machine(RIG), load_machine(out)
    assert machine_hash(after) != machine_hash(before)
    assert after.bearings[0].force_per_current == pytest.approx(before.bearings[0].force_per_current, rel=0.03)
    assert 1.05 < after.bearings[0].negative_stiffness[0] / before.bearings[0].negative_stiffness[0] < 1.2  # the weight's shift
    assert "identified" in after.source and "from one.h5 with pid.json" in after.source
    assert out.read_text().startswith("# Identified ")
    assert len(after.tolerances) == 10
    text = page.read_text()
    assert "<html" in text and "Correlation of the parameters" in text and "http" not in text.split("<script")[0]
    assert call("check", out).exit_code == 0
    made = call("synthesize", out, "-o", tmp_path / "again.json", "--json")
    assert made.exit_code == 0 and json.loads(made.stdout)["status"] == "verified"


def test_json_and_repeats(place, tmp_path):
    done = call(
        "identify", RIG, place / "one.h5", place / "two.h5", "--controller", place / "pid.json", *NINE, "--repeats", "--json",
        "-o", tmp_path / "m.toml",
    )  # fmt: skip
    found = json.loads(done.stdout)
    assert done.exit_code == (0 if found["good"] else 1)
    assert len(found["parameters"]) == 8 and found["parameters"][0]["unit"] == "N/A"
    assert {item["record"] for item in found["fit_percent"]} == {1, 2}
    assert found["repeats"]["count"] == 2 and found["machine_file"] == str(tmp_path / "m.toml") and found["report"] is None
    assert np.array(found["correlation"]).shape == (8, 8)


def swapped(record):
    values = record.values.copy()
    values[[0, 1]] = values[[1, 0]]
    return replace(record, values=values)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (swapped, "channels are mixed up: y_A_zeta and y_A_eta are swapped"),
        (lambda r: replace(r, sample_rate_hz=5000.0), "not sampled at 5000 Hz, as they say, but at about 10000 Hz"),
        (lambda r: r.select([name for name in r.signals if name[0] != "e"]), "holds no excitation"),
        (lambda r: replace(r, machine="other"), "the machine of record 1 is 'other'"),
    ],
)
def test_records_that_are_refused(place, tmp_path, change, words):
    write_record(change(read_record(place / "one.h5")), tmp_path / "bad.h5")
    done = call("identify", RIG, tmp_path / "bad.h5", "--controller", place / "pid.json", "-o", tmp_path / "m.toml")
    assert done.exit_code == 2 and words in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "m.toml").exists()


def test_gaps_and_uneven_times_are_refused_when_reading(place, tmp_path):
    record = read_record(place / "one.h5").between(0, 0.02)
    path = write_record(record, tmp_path / "uneven.csv")
    lines = path.read_text().splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith("time"))
    gap = "\n".join([*lines[: first + 50], *lines[first + 53 :]]).replace("# samples: 200", "# samples: 197")
    path.write_text(gap + "\n")
    done = call("identify", RIG, path, "--controller", place / "pid.json", "-o", tmp_path / "m.toml")
    assert done.exit_code == 2 and "uneven.csv" in done.stderr and "time" in done.stderr
    cells = lines[first + 60].split(",")
    cells[3] = "nan"
    lines[first + 60] = ",".join(cells)
    path.write_text("\n".join(lines) + "\n")
    done = call("identify", RIG, path, "--controller", place / "pid.json", "-o", tmp_path / "m.toml")
    assert done.exit_code == 2 and "y_B_zeta at sample 59" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--unknown", "bearing.C.force_per_current.zeta"), 'unknown bearing "C"'),
        (("--start", "seal.center.k"), "--start is 'seal.center.k', but must be PATH=VALUE"),
        (("--start", "seal.center.k=much"), "PATH=VALUE with a number"),
        (("--start", "bearing.A.negative_stiffness.zeta=9e6"), "the loop at the start values is unstable"),
        (("--signals", "y_C"), "a fitted signal is 'y_C'"),
        (("--delay-samples", "-1"), "computing_delay is -1"),
        (("--bending-modes", "-1"), "bending"),
        (("--repeats",), "at least 2 for repeats"),
        (("-o", "missing/m.toml"), "missing is not a directory"),
    ],
)
def test_arguments_that_are_refused(place, arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = call("identify", RIG, place / "one.h5", "--controller", place / "pid.json", *NINE, *arguments)
    assert done.exit_code == 2 and words in done.stderr and "Traceback" not in done.stderr, done.stderr


def test_interruption_leaves_no_file(place, tmp_path):
    out = tmp_path / "m.toml"
    command = "from ambrose.cli import main; main()"
    arguments = ["identify", RIG, place / "one.h5", "--controller", place / "pid.json", "-o", out]
    run = subprocess.Popen(
        [sys.executable, "-c", command, *map(str, arguments)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    seen = run.stderr.readline()
    while seen and "checking the records" not in seen:
        seen = run.stderr.readline()
    time.sleep(0.2)
    run.send_signal(signal.SIGINT)
    _, rest = run.communicate(timeout=60)
    assert run.returncode == 130 and "interrupted" in rest and "Traceback" not in rest
    assert list(tmp_path.iterdir()) == []
