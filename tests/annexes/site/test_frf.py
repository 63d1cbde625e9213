"""`ambrose frf`: every kind of record of the rig on machines of two and three bearings, its page,
its table, its refusals.
"""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.site.frf import respond
from ambrose.annexes.site.pages import frf_page
from ambrose.cli import main
from ambrose.judge.controller_file import read_controller
from ambrose.record.files import read_record, write_record
from ambrose.record.response_files import read_response
from ambrose.report.page import render
from coarse import coarse_file

CHIRP = """
name = "sweep"
duration = "6 s"
[[chirp]]
signal = "e_first_zeta"
amplitude = "0.05 A"
frequency = "5 Hz"
to_frequency = "200 Hz"
"""


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(
    scope="module",
    params=["seal-rig", pytest.param("three-bearing-train", marks=pytest.mark.study)],
)
def place(request, tmp_path_factory):
    """A machine, a folder with its PID and a sweep of the nonlinear rig, without pressure."""
    folder, name = tmp_path_factory.mktemp("frf"), coarse_file(request.param)
    (folder / "sweep.toml").write_text(CHIRP)
    made = call("synthesize", name, "--method", "pid", "-o", folder / "pid.json", "--json")
    # the rig's own PID loses twice nominal pressure, which is told by the status
    assert made.exit_code == (1 if request.param == "seal-rig" else 0), made.stderr
    point = {"seal-rig": "zero pressure", "three-bearing-train": "rest"}[request.param]
    done = call(
        "simulate",
        name,
        "--controller",
        folder / "pid.json",
        "--scenario",
        folder / "sweep.toml",
        "--rate-hz",
        "10000",
        "--point",
        point,
        "-o",
        folder / "sweep.h5",
        "--json",
    )
    assert done.exit_code == 0, done.stderr
    return name, folder


@pytest.mark.parametrize("place", ["seal-rig", "three-bearing-train"], indirect=True)
def test_a_clean_sweep_is_measured_without_a_doubt(place):
    name, folder = place
    done = call(
        "frf",
        name,
        folder / "sweep.h5",
        "--controller",
        folder / "pid.json",
        "--to-hz",
        "180",
        "--json",
        "--csv",
        folder / "table.csv",
        "-o",
        folder / "page.html",
    )
    assert done.exit_code == 0, done.stdout + done.stderr
    point = json.loads(done.stdout)["points"][0]
    axis = amb.load_machine(name).axes[0]
    assert (
        point["findings"] == []
        and point["excitations"] == [[f"e_{axis}"]]
        and point["method"] == "polynomials"
    )
    motion = point["responses"][0]
    own = motion["outputs"].index(f"y_{axis}")
    assert np.median(np.array(motion["coherence"])[:, own]) > 0.9
    assert motion["model_agrees"][own][0] > 0.95
    row = point["axes"][0]
    assert (
        row["axis"] == axis
        and row["peak_95"][0] <= row["predicted"] * 1.03
        and row["peak_95"][1] >= row["predicted"] * 0.97
    )
    rows = list(csv.DictReader((folder / "table.csv").read_text().splitlines()))
    assert {item["response"] for item in rows} == {"motion", "sensitivity"}
    first = next(item for item in rows if item["output"] == f"y_{axis}")
    assert float(first["magnitude"]) == pytest.approx(
        abs(complex(motion["real"][0][own][0], motion["imag"][0][own][0])), rel=1e-6
    )
    page = (folder / "page.html").read_text()
    assert (
        "Sensitivity" in page
        and "Agreement of model and measurement" in page
        and "Coherence" not in page.split("<body")[0]
    )


def test_a_wrong_model_is_seen(place):
    """The same record beside a machine whose magnets pull a fifth less: the model agrees at fewer
    lines.
    """
    name, folder = place
    machine, record = amb.load_machine(name), read_record(folder / "sweep.h5")
    law = read_controller(folder / "pid.json")
    weak = tuple(
        replace(b, force_per_current=tuple(0.8 * k for k in b.force_per_current))
        for b in machine.bearings
    )
    models = (machine, replace(machine, bearings=weak))
    right, wrong = (
        respond(model, record, law).points[0].of("sensitivity")[0].agreement[0, 0]
        for model in models
    )
    assert right > 0.95 and wrong < 0.8


def test_terminal_and_page_without_controller_or_currents(place):
    name, folder = place
    record = read_record(folder / "sweep.h5")
    write_record(record.select([n for n in record.signals if n[:2] != "u_"]), folder / "bare.h5")
    done = call("frf", name, folder / "bare.h5")
    assert done.exit_code == 0 and "no u_<axis>" in done.stdout, done.stdout
    found = respond(amb.load_machine(name), folder / "bare.h5")
    assert [item.what for item in found.points[0].responses] == ["motion"]
    assert "not measured" in render(frf_page(found, date="2026-01-01"))


def test_refusals(place, tmp_path):
    name, folder = place
    record = read_record(folder / "sweep.h5")
    still = record.select([n for n in record.signals if n[:2] != "e_"])
    write_record(still, tmp_path / "still.h5")
    done = call("frf", name, tmp_path / "still.h5")
    assert done.exit_code == 2 and "have no excitation" in done.stderr
    write_record(record.select(record.signals[1:]), tmp_path / "lacks.h5")
    done = call("frf", name, tmp_path / "lacks.h5")
    assert done.exit_code == 2 and "lacks y_" in done.stderr
    weak = read_record(folder / "sweep.h5")
    rows = np.array([n[:2] == "y_" for n in weak.signals])[:, None]
    noisy = weak.values + rows * 3e-5 * np.random.default_rng(0).standard_normal(weak.values.shape)
    write_record(replace(weak, values=noisy), tmp_path / "noisy.h5")
    done = call("frf", name, tmp_path / "noisy.h5", "--details")
    assert done.exit_code == 1 and "poorly known" in done.stdout


def test_its_responses_are_what_identify_reads(place, tmp_path):
    name, folder = place
    options = ("--to-hz", "180", "--csv", tmp_path / "own.h5", "--json")
    done = call("frf", name, folder / "sweep.h5", *options)
    assert done.exit_code == 0, done.stderr
    kept = read_response(tmp_path / "own.h5")
    (point,) = respond(amb.load_machine(name), folder / "sweep.h5", band=(0, 360 * np.pi)).points
    frf = point.loop.motion
    for path in kept.paths:
        one = frf.select(f"e_{path.injected}", f"y_{path.read}")
        np.testing.assert_allclose(path.values, one.values[:, 0, 0])
        np.testing.assert_allclose(path.variance, one.variance[:, 0, 0])
    checked = call("record", "check", tmp_path / "own.h5", "--json")
    assert json.loads(checked.stdout)["uses"][0]["usable"] == bool(kept.paths)
