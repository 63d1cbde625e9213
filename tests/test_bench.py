"""`make bench`: what fails is a row, what was measured before it is kept, and every module runs."""

import json
import sys
from types import SimpleNamespace

import pytest
from benchmarks import history
from benchmarks.__main__ import main, modules, rows_of
from benchmarks.box_attack import attack
from benchmarks.current_loop import main as current_loop
from benchmarks.target_table import main as target_table

from needs import needs


def row(name):
    return {"name": name, "ours": 1.0, "peer": 2.0, "peer_name": "peer", "error": 0.0}


def failing(smoke):
    yield row("before")
    raise ValueError("no attribute _static")


@pytest.fixture
def two_modules(tmp_path, monkeypatch):
    """norms with rows, response failing after its first one; in an empty folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(history, "yardstick", lambda: 0.01)
    good = SimpleNamespace(run=lambda smoke: [row("first"), row("second")])
    monkeypatch.setitem(sys.modules, "benchmarks.bench_norms", good)
    monkeypatch.setitem(sys.modules, "benchmarks.bench_response", SimpleNamespace(run=failing))
    return tmp_path


@pytest.mark.parametrize("order", [["norms", "response"], ["response", "norms"]])
def test_a_module_that_fails_is_a_row_and_the_others_are_kept(two_modules, capsys, order):
    assert main(order) == 1
    rows = json.loads((two_modules / "benchmarks.json").read_text())["rows"]
    assert {item["name"] for item in rows} == {"first", "second", "before", "bench_response"}
    (failed,) = (item for item in rows if "failed" in item)
    assert (
        failed["name"] == "bench_response"
        and "ValueError: no attribute _static" in failed["failed"]
    )
    assert "no attribute _static" in capsys.readouterr().out  # in the table, too
    (run,) = history.read(two_modules / "benchmarks.jsonl")
    assert len(run["ratios"]) == 3  # a failure is no figure


def test_rows_are_written_as_they_come(two_modules, monkeypatch):
    seen = []

    def looking(smoke):
        seen.append(json.loads((two_modules / "benchmarks.json").read_text())["rows"])
        return []

    monkeypatch.setitem(sys.modules, "benchmarks.bench_response", SimpleNamespace(run=looking))
    assert main(["norms", "response"]) == 0
    assert [item["name"] for item in seen[0]] == ["first", "second"]


def test_a_smoke_run_writes_nothing(two_modules):
    assert main(["norms", "--smoke"]) == 0
    assert list(two_modules.iterdir()) == []


def test_an_unknown_module_is_refused(capsys):
    assert main(["nroms"]) == 2
    assert "no benchmark bench_nroms; there are bench_campaign" in capsys.readouterr().err


@pytest.mark.filterwarnings("default")  # of the peers
@pytest.mark.parametrize("name", modules())
def test_every_module_runs(name):
    rows = list(rows_of(name, smoke=True))
    assert rows and [item["failed"] for item in rows if "failed" in item] == []
    for item in rows:
        assert item["ours"] > 0 and {"name", "peer", "peer_name", "error"} <= set(item)


@pytest.mark.study  # what verify says, against members of its own: tests/judge/test_sampled_box.py
def test_no_member_of_a_box_lies_above_what_verify_says():
    """The attack of benchmarks/box_attack.py, with few members: corners, samples, exact peaks."""
    row = attack("turbomolecular-pump", members=40)
    assert row["above"] == 0 and row["nominal"] < row["worst"] <= row["box"] * (1 + 1e-5)
    assert row["members"] == 1 + 4 + 40


def test_the_circuit_of_the_amplifier_slows_the_unstable_pole(capsys):
    (row,) = current_loop(["--machine", "turboexpander"])
    assert 0.9 * row.pole[0] < row.pole[1] < 0.99 * row.pole[0]
    assert row.damping[1] > row.damping[0]
    assert "| turboexpander | 5.33 |" in capsys.readouterr().out


@needs("cortex-m7")
def test_the_table_of_targets_has_a_row_for_a_law_on_a_processor(capsys):
    row, looped = target_table(["--smoke", "--loop", "--processors", "cortex-m7"])
    assert row.trial.equal and looped.equal
    assert 0 < row.trial.written <= row.trial.footprint.stack
    assert "| fixed | double | cortex-m7 | yes |" in capsys.readouterr().out
