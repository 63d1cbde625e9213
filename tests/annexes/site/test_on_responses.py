"""Acceptance and retuning from frequency responses alone, of the tests' own rig."""

import json
from functools import cache
from pathlib import Path as FilePath

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.site.acceptance import accept
from ambrose.annexes.site.pages import acceptance_page
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.judge.controller_file import write_controller
from ambrose.record.response_files import write_response
from ambrose.report.page import render
from analyser import Truth, matrices

MACHINE, RATE = "seal-rig", 1e4
FILE = FilePath(amb.__file__).parent / "machines" / f"{MACHINE}.toml"


@cache
def machine():
    return amb.load_machine(MACHINE)


@cache
def law():
    return amb.design(machine(), "pid").controller


@cache
def truth():
    return Truth.of(FILE, RATE, (0.03, -0.03))


def swept(kind="T", **options):
    return truth().sweep(MACHINE, matrices(law(), RATE), truth().hertz(), kind, **options)


def largest():
    """The true largest sensitivity of every axis, and of all together."""
    fine = np.union1d(np.geomspace(4, 1600, 3000), truth().hertz(packed=30))
    S = truth().sensitivity(matrices(law(), RATE), fine)
    return np.abs(np.einsum("wii->wi", S)).max(axis=0), np.linalg.norm(S, 2, axis=(1, 2)).max()


@pytest.mark.parametrize(
    ("kind", "options"),
    [("T", {}), ("T", {"stated": False}), ("S+L", {"diagonal": True}), ("motion", {})],
    ids=str,
)
def test_the_accepted_sensitivity_holds_the_true_one(kind, options):
    done = accept(machine(), law(), swept(kind, **options))
    loop, (values, sigma) = done.points[0], largest()
    for (low, high), value in zip(loop.peaks, values, strict=True):
        assert low <= value <= high and high - low < 0.2 * value
    checks = {check.name: check for check in loop.checks.checks}
    assert "margin.phase.output.A_zeta" in checks and checks["sensitivity.told"].passed is not False
    if options.get("diagonal"):
        assert "not measured between" in checks["sensitivity.output.max"].detail
    else:
        assert loop.low.max() - 1e-9 <= sigma <= 1.05 * loop.high.max()
    json.dumps(done.to_dict(), allow_nan=False)
    assert "Acceptance" in render(acceptance_page(done))
    assert any("no time signal" in note for note in loop.checks.notes)


def test_what_cannot_be_accepted_from_responses_is_refused():
    whole = swept()
    twice = [type(p)(p.quantity, p.read, p.injected, 2 * p.values) for p in whole.paths]
    alone = tuple(p for p in whole.paths if p.read == p.injected)[:3]
    for words, given in (
        ("same operating point", [whole, whole]),
        ("times what the machine file", type(whole)(
            MACHINE, whole.omega, tuple(twice), whole.point, sample_rate_hz=RATE)),
        ("13 of 16 responses", type(whole)(
            MACHINE, whole.omega, alone, whole.point, sample_rate_hz=RATE)),
        ("the machine of responses 1", type(whole)(
            "other", whole.omega, whole.paths, whole.point, sample_rate_hz=RATE)),
    ):  # fmt: skip
        with pytest.raises(InvalidInput, match=words) as error:
            accept(machine(), law(), given)
        assert "; " in str(error.value)


def test_the_command_takes_an_analysers_file(tmp_path):
    write_controller(tmp_path / "K.json", law())
    write_response(swept(), tmp_path / "sweep.csv")
    words = ["accept", MACHINE, tmp_path / "K.json", tmp_path / "sweep.csv", "-o",
             tmp_path / "page.html", "--json"]  # fmt: skip
    done = CliRunner().invoke(main, [str(word) for word in words])
    assert done.exit_code in {0, 1}, done.stderr
    told = json.loads(done.stdout)
    assert told["records"][0]["name"] == "sweep.csv" and (tmp_path / "page.html").exists()
