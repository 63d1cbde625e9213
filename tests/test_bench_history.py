"""The history of `make bench`: what fell against its peer is named, whatever the computer; growth
as an exponent.
"""

import sys
import xml.etree.ElementTree as ET
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks import history
from benchmarks.__main__ import main


def rows(slow=1.0, computer=1.0):
    """Two figures on a computer that takes ``computer`` times as long; the first ``slow`` times as
    long as it should.
    """
    return [
        {
            "module": "bench_norms",
            "name": "norm, n = 8",
            "ours": 1e-3 * slow * computer,
            "peer": 2e-3 * computer,
        },
        {
            "module": "bench_rig",
            "name": "  with 3 modes: 120 s/s",
            "ours": 0.1 * computer,
            "peer": None,
        },
    ]


def run(slow=1.0, computer=1.0):
    return history.entry(rows(slow, computer), 0.01 * computer)


def test_what_fell_is_named_and_a_slow_computer_is_not():
    past = [run(), run(computer=1.3), run(slow=1.1)]
    assert history.falls(past, run(computer=5.0)) == []
    assert history.falls(past, run(slow=1.15)) == []
    ((name, share),) = history.falls(past, run(slow=1.5, computer=0.5))
    assert name == "norms: norm, n = 8" and share == pytest.approx(1 / 1.5)
    assert history.falls([], run(slow=9.0)) == []


def test_names_stay_when_speeds_change():
    assert set(run()["ratios"]) == {"norms: norm, n = 8", "rig: with 3 modes"}


@pytest.mark.parametrize("power", [0.5, 1.0, 3.0])
def test_exponent_of_a_series(power):
    series = [{"ours": 2e-3 * n**power, "series": "over n", "size": n} for n in (10, 40, 90)]
    others = [
        {"ours": 1.0, "series": "two only", "size": 1},
        {"ours": 2.0, "series": "two only", "size": 2},
        {"ours": 1.0},
    ]
    assert history.exponents([*series, *others]) == {"over n": pytest.approx(power)}


def test_runs_are_kept_and_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(history, "yardstick", lambda: 0.01)
    path = tmp_path / "benchmarks.jsonl"
    assert history.keep(rows(), path) == history.keep(rows(), path) == []
    assert len(history.keep(rows(slow=2.0), path)) == 1
    assert len(history.read(path)) == 3
    picture = ET.parse(path.with_suffix(".svg")).getroot()
    lines = picture.findall("{*}polyline")
    assert len(lines) == 2 and lines[0].get("stroke") == "#a3341f" != lines[1].get("stroke")
    heights = [float(point.split(",")[1]) for point in lines[0].get("points").split()]
    assert heights[0] == heights[1] < heights[2]  # drawn lower where it is slower


def test_make_bench_names_a_made_up_fall(tmp_path, monkeypatch, capsys):
    """The whole of `python -m benchmarks norms` with given figures: in the third run one takes 1.4
    times as long.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(history, "yardstick", lambda: 0.01)
    for slow in (1.0, 1.1, 1.4):
        given = SimpleNamespace(run=lambda slow=slow: rows(slow=slow, computer=1 / slow))
        monkeypatch.setitem(sys.modules, "benchmarks.bench_norms", given)
        assert main(["norms"]) == 0
        named = [
            line
            for line in capsys.readouterr().out.splitlines()
            if line.startswith("slower against its peer")
        ]
        assert len(named) == (slow == 1.4)
    assert named[0].endswith("norms: norm, n = 8") and "the factor 0.7" in named[0]
    runs = history.read(tmp_path / "benchmarks.jsonl")
    assert len(runs) == 3 and all(run["commit"] is not None and run["when"] for run in runs)


def test_the_yardstick_is_a_time():
    assert 0 < history.yardstick(1) < 10 and np.isfinite(history.yardstick(1))
