"""docs/reference/records.md: its column map, CSV example and stream work as printed, and the table of names
is complete.
"""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from click.testing import CliRunner

from ambrose.cli import main
from ambrose.machine.description import OperatingPoint
from ambrose.record.files import read_record
from ambrose.record.foreign import read_foreign
from ambrose.record.record import signal_dimension

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "records.md").read_text()


def block(kind: str, word: str) -> str:
    return next(
        text for text in re.findall(rf"```{kind}[^\n]*\n(.*?)```", PAGE, re.DOTALL) if word in text
    )


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    time = np.arange(5000) / 10
    current = np.column_stack([np.sin(time), np.cos(time)])
    scipy.io.savemat(
        "run.mat", {"t": time, "probe1": 0.1 * np.sin(time), "log": {"current": current}}
    )
    Path("map.toml").write_text(block("toml", "[[signal]]"))
    return time


def test_column_map(files):
    record = read_foreign("run.mat", "map.toml")
    assert record["y_A_zeta"] == pytest.approx((20 - 12.7 * np.sin(files)) * 1e-6, rel=1e-12)
    assert record["i_A_zeta"] == pytest.approx(np.sin(files), rel=1e-12)
    assert record.point == OperatingPoint(0.0, 2.04e5, label="nominal pressure")


def test_command(files):
    command, answer = block("console", "convert").strip().splitlines()
    done = CliRunner().invoke(main, command.split()[2:])
    assert done.exit_code == 0 and done.stdout.strip() == answer
    assert np.array_equal(read_record("run.h5").values, read_foreign("run.mat", "map.toml").values)
    refused = CliRunner().invoke(main, ["convert", "run.mat"])
    assert refused.exit_code == 2 and "column map" in refused.stderr


def test_csv(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(block("csv", "ambrose-record"))
    record = read_record(path)
    assert record["y_A_zeta"] == pytest.approx([1.25e-6, 1.5e-6]) and record.sample_rate_hz == 10e3


def test_stream(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = [np.ones((2, 7)), np.zeros((2, 3))]
    exec(block("python", "RecordWriter"), {"point": OperatingPoint(), "blocks": blocks})
    assert read_record("run.h5").values.shape == (2, 10)


def test_names():
    rows = re.findall(
        r"^\| (`[a-z_`, ]+`) \| [^|]* \| ([^|]*) \|$", PAGE.partition("## HDF5")[0], re.MULTILINE
    )
    printed = {}
    for names, units in rows:
        words = [name.strip("` ") for name in names.split(",")]
        printed |= dict(
            zip(words, units.split(", ") * (1 if ", " in units else len(words)), strict=True)
        )
    assert printed == {name: signal_dimension(f"{name.rstrip('_')}_x").unit for name in printed}
    assert set(printed) == {"y_", "q_", "qdot_", "u_", "i_", "e_", "r_", "d_", "f_", "p_", "speed"}
