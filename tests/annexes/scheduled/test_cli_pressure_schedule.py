"""The commands on a controller scheduled over pressure: designed, judged, run with a bad sensor,
and what they say.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose.cli import main
from ambrose.machine.file.update import save_machine
from ambrose.record.files import read_record
from coarse import coarse

SCENARIO = """name = "surge"
duration = "60 ms"
[[pressure]]
time = "5 ms"
pressure = "100 % of top pressure"
ramp = "40 ms"
[[pressure_sensor]]
offset = "20 mbar"
lag = "2 ms"
[[pressure_sensor]]
time = "30 ms"
fault = "lost"
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("pressure")
    save_machine(replace(coarse("seal-rig"), tolerances=()), place / "rig.toml")
    (place / "surge.toml").write_text(SCENARIO)
    done = call(
        place,
        "synthesize",
        "rig.toml",
        "--method",
        "lpv",
        "--pressures-bar",
        "0",
        "4.08",
        "--rate-hz",
        "10000",
        "--json",
    )
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["certificate"]["margins"]["worst_pressure"] in np.linspace(
        0, 4.08e5, 8
    ).round(9)
    return place


def call(place, *arguments):
    words = [
        str(place / word) if word.endswith((".toml", ".json", ".h5")) else word
        for word in arguments
    ]
    target = ["-o", str(place / "lpv.json")] if arguments[0] == "synthesize" else []
    return CliRunner().invoke(main, [*words, *target])


def test_verify_judges_each_point_at_its_own_pressure(folder):
    done = call(folder, "verify", "rig.toml", "--controller", "lpv.json", "--json")
    found = json.loads(done.stdout)
    assert (
        done.exit_code == 0
        and found["passed"]
        and not found["left_out"]
        and len(found["points"]) == 3
    )


def test_simulate_falls_back_where_the_reading_is_lost(folder):
    made = CliRunner().invoke(
        main,
        ["synthesize", str(folder / "rig.toml"), "--method", "pid", "-o", str(folder / "pid.json")],
    )
    assert made.exit_code == 1, made.stderr  # twice nominal pressure is lost
    words = (
        "simulate",
        "rig.toml",
        "--controller",
        "lpv.json",
        "--scenario",
        "surge.toml",
        "-o",
        "fallen.h5",
        "--json",
    )
    done = call(folder, *words, "--fallback", "pid.json", "--pressure-rate", "200 bar/s")
    assert "fixed from 0.03 s (the reading is lost)" in json.loads(done.stdout)["text"]
    for alone in (
        ("--pressure-rate", "200 bar/s"),
        ("--pressure-error", "0.4 bar"),
        ("--estimate", "beside"),
    ):
        refused = call(folder, *words, *alone)
        assert refused.exit_code == 2 and "--fallback" in refused.stderr
    lifted = [*words, "--fallback", "pid.json"]
    # currents are cut until the rotor is free of its touchdown bearings
    lifted[5], lifted[7] = "levitation", "lifted.h5"
    assert "levitated since" in json.loads(call(folder, *lifted).stdout)["text"]
    done = call(
        folder,
        *words,
        "--fallback",
        "pid.json",
        "--estimate",
        "beside",
        "--pressure-error",
        "0.4 bar",
    )
    assert "the monitor saw no excitation and said nothing" in json.loads(done.stdout)["text"]


def test_export_writes_the_fallback_beside_the_schedule(folder):
    """One controller with both; a fallback for another rate is refused before anything is
    verified.
    """
    pid = folder / "slow.json"
    words = ["synthesize", str(folder / "rig.toml"), "--method", "pid", "-o", str(pid)]
    assert CliRunner().invoke(main, [*words, "--rate-hz", "5000"]).exit_code == 1  # as above
    code = (
        "export",
        "lpv.json",
        "--to",
        "c",
        "--machine",
        "rig.toml",
        "-o",
        str(folder / "code"),
        "--name",
        "rig",
        "--json",
    )
    refused = call(folder, *code, "--fallback", "slow.json")
    assert refused.exit_code == 2 and "--rate-hz 10000" in refused.stderr
    assert CliRunner().invoke(main, [*words, "--rate-hz", "10000"]).exit_code == 1
    code += ("--fallback", "slow.json", "--pressure-rate", "80 bar/s", "--stuck-after", "0.01")
    refused = call(folder, *code)
    # the PID whirls there
    assert (
        refused.exit_code == 2 and "the fallback: this controller is not deployed" in refused.stderr
    )
    done = call(folder, *code, "--force")
    found, unstable = (
        json.loads(done.stdout),
        "of the fallback: the sampled loop is unstable at twice nominal pressure",
    )
    assert done.exit_code == 1 and not found["verified"] and unstable in found["problems"]
    header = (folder / "code" / "rig.h").read_text()
    for text in (
        "Fallback:",
        "Controller pid",
        "the very same value for 0.01 s",
        "8e+06 Pa/s",
        "#define RIG_LATCHED",
    ):
        assert text in header


def test_simulate_takes_the_sensor_of_the_scenario(folder):
    done = call(
        folder,
        "simulate",
        "rig.toml",
        "--controller",
        "lpv.json",
        "--scenario",
        "surge.toml",
        "-o",
        "run.h5",
    )
    assert done.exit_code == 0, done.stderr
    record = read_record(folder / "run.h5")
    told, true = record["p_measured"], record["p_seal"]
    assert (
        np.ptp(told[301:]) == 0
        and np.abs(told - true)[:300].max() < 3e4 < np.abs(told - true).max()
    )
    linear = call(
        folder,
        "simulate",
        "rig.toml",
        "--controller",
        "lpv.json",
        "--scenario",
        "surge.toml",
        "--linear",
        "-o",
        "x.h5",
    )
    assert (
        linear.exit_code == 2
        and "a pressure sensor, which a linear model does not have" in linear.stderr
    )


def test_a_point_beyond_the_schedule_is_left_out_and_fails(folder):
    content = json.loads((folder / "lpv.json").read_text())
    content["scheduling"]["grid"] = [value / 2 for value in content["scheduling"]["grid"]]
    (folder / "half.json").write_text(json.dumps(content))
    done = call(folder, "verify", "rig.toml", "--controller", "half.json", "--details")
    assert done.exit_code == 1
    assert (
        "Not checked, which does not pass: twice nominal pressure; the schedule does not cover them"
        in done.stdout
    )


@pytest.fixture(scope="module")
def both(folder):
    words = ("--method", "lpv", "--speeds-hz", "0", "30", "--pressures-bar", "0", "4.08", "--json")
    done = CliRunner().invoke(
        main, ["synthesize", str(folder / "rig.toml"), *words, "-o", str(folder / "both.json")]
    )
    assert done.exit_code == 0, done.stderr
    return json.loads(done.stdout)["certificate"]


def test_over_speed_and_pressure_at_once(folder, both):
    margins = both["margins"]
    assert margins["grid_points"] == 9 and {"worst_speed", "worst_pressure"} <= set(margins)
    verdict = json.loads(
        call(folder, "verify", "rig.toml", "--controller", "both.json", "--json").stdout
    )
    assert len(verdict["points"]) == 3 and not verdict["left_out"]
    done = call(
        folder,
        "simulate",
        "rig.toml",
        "--controller",
        "both.json",
        "--scenario",
        "surge.toml",
        "-o",
        "both.h5",
    )
    assert done.exit_code == 0 and "completed without contact" in done.stdout + done.stderr
    moving = ("--pressure-rate", "20 bar/s", "--pressure-error", "0.1 bar")
    refused = call(folder, "verify", "rig.toml", "--controller", "both.json", *moving)
    assert refused.exit_code == 2 and "over pressure alone" in refused.stderr
    refused = call(
        folder,
        "synthesize",
        "rig.toml",
        "--method",
        "lpv",
        "--speeds-hz",
        "0",
        "30",
        "--pressure-rate",
        "1 bar/s",
    )
    assert refused.exit_code == 2 and "give the pressures" in refused.stderr
