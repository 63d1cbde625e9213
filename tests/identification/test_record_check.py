"""Whether a record can be used, and for what."""

import json
import re

import numpy as np
import pytest
from click.testing import CliRunner
from docs_build import DOCS

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.identification.findings import Code
from one_axis_loop import levitate

AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")


def record(kinds="yue", axes=AXES, speed=0.0, change=None, count=20_000):
    """Noise under the names of a machine with two bearings."""
    rng = np.random.default_rng(0)
    names = [f"{kind}_{axis}" for kind in kinds for axis in axes]
    units = ["m" if name[0] == "y" else "A" for name in names]
    values = 1e-5 * rng.standard_normal((len(names), count))
    for name, row in (change or {}).items():
        values[names.index(name)] = row
    point = amb.OperatingPoint(speed=speed, seal_pressure=0.0)
    return amb.Record("seal-rig", 10e3, tuple(names), tuple(units), values, point)


def usable(check):
    return {use.command for use in check.uses if use.usable}


@pytest.mark.parametrize(
    ("kinds", "speed", "commands"),
    [
        ("yue", 0.0, {"identify", "identify --method youla", "frf", "accept", "retune"}),
        ("ye", 0.0, {"identify", "frf", "accept", "retune"}),
        ("yu", 500.0, {"balance"}),
        ("u", 0.0, set()),
    ],
)
def test_what_a_record_is_good_for(kinds, speed, commands):
    check = amb.check_record(record(kinds, speed=speed), "seal-rig")
    assert usable(check) == commands and check.passed == bool(commands)


def test_a_record_written_by_hand_as_the_protocol_says_serves(tmp_path):
    """The page's own head, columns in another order, rows by numpy: nothing of the package."""
    page = (DOCS / "research" / "protocol.md").read_text(encoding="utf-8")
    *head, names, row = re.search(r"```csv\n(# format.*?)\n```", page, re.S)[1].splitlines()
    columns = np.array(names.split(","))
    assert len(row.split(",")) == len(columns)
    order = [0, *(1 + np.random.default_rng(1).permutation(len(columns) - 1))]
    time = np.arange(20_000) / 10_000
    waves = np.random.default_rng(0).standard_normal((len(columns) - 1, len(time)))
    path = tmp_path / "by-hand.csv"
    top = "\n".join([*head, ",".join(columns[order])])
    rows = np.column_stack([time, waves.T])[:, order]
    np.savetxt(path, rows, header=top, comments="", delimiter=",", fmt="%.7g")
    check = amb.check_record(path)
    assert check.passed and {"identify", "identify --method youla", "frf"} <= usable(check)
    assert "314.2 rad/s" in dict(check.contents)["point"]


def test_where_it_ran_is_said_in_words():
    contents = dict(amb.check_record(record("ye", speed=500.0)).contents)
    assert contents["point"] == "without label (500 rad/s, 0 Pa)"


def test_a_logger_s_table_of_several_axes_is_sent_to_the_column_map(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("Zeit;Kanal 1;Kanal 2\n" + "".join(f"{k};1,5;2,5\n" for k in range(20)))
    with pytest.raises(InvalidInput, match=r"several axes of a machine .*convert --columns"):
        amb.check_record(path)


def test_a_missing_axis_and_a_silent_excitation_are_named():
    check = amb.check_record(record("ye", AXES[:3]), "seal-rig")
    (use,) = (use for use in check.uses if use.command == "identify")
    assert not use.usable and "(B_eta)" in use.reason
    quiet = {f"e_{axis}": 0.0 for axis in AXES}
    check = amb.check_record(record(change=quiet))
    (use,) = (use for use in check.uses if use.command == "identify")
    assert "never change" in use.reason and not usable(check) & {"frf", "accept"}


@pytest.mark.parametrize("machine", [None, "seal-rig"])
def test_what_is_wrong_with_a_signal(machine):
    check = amb.check_record(record(change={"y_A_eta": 3e-6}), machine)
    assert Code.DEAD_CHANNEL in {finding.code for finding in check.findings}
    assert not check.passed
    waves = 1e-4 * np.sin(np.arange(20_000) / 30)
    check = amb.check_record(record(change={"y_A_eta": np.clip(waves, -9e-5, 9e-5)}), machine)
    assert Code.CLIPPED in {finding.code for finding in check.findings}


def test_axes_of_another_machine():
    check = amb.check_record(record("ye", ("C_zeta", "C_eta")), "seal-rig")
    assert "none of the machine's" in str(check.findings[0])


def test_one_axis_is_tried(tmp_path):
    time, y, u, r = levitate(seed=2)
    path = tmp_path / "axis.txt"
    np.savetxt(path, np.column_stack([time, y, u, r]), header="t y u r", fmt="%.9g")
    run = CliRunner().invoke(main, ["record", "check", str(path), "--json"])
    said = json.loads(run.stdout)
    assert run.exit_code == 0 and said["uses"][0]["usable"]
    assert said["uses"][0]["reason"].startswith("identified: pole")
    time, y, u, _ = levitate(kind="none")
    np.savetxt(path, np.column_stack([time, y, u]), header="t y u", fmt="%.9g")
    run = CliRunner().invoke(main, ["record", "check", str(path)])
    assert run.exit_code == 1 and "drives the loop" in run.output


def test_a_file_that_cannot_be_read(tmp_path):
    with pytest.raises(InvalidInput):
        amb.check_record(tmp_path / "nothing.h5")
