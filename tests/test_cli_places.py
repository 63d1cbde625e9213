"""Where commands write: refused before the work begins if it cannot be written, and what fails at
the end loses no result.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose.annexes.site import acceptance
from ambrose.annexes.site.balancing_vectors import read_amplitudes
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import static_gain
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.result import Synthesis
from ambrose.machine import ordinary_file as atomic_write, ordinary_file as claim
from ambrose.machine.file.toml import bundled_machines
from ambrose.machine.ordinary_file import claimed
from ambrose.record import foreign

AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture
def law(tmp_path):
    gain = [[1e4 * (i == j) for i in range(4)] for j in range(4)]
    system = static_gain(gain, [f"err_{axis}" for axis in AXES], [f"u_{axis}" for axis in AXES])
    return write_controller(tmp_path / "law.json", system)


@pytest.fixture
def never(monkeypatch):
    """The work must not begin."""

    def begun(*arguments, **options):
        raise AssertionError("begun")

    for place in (
        "rig.trial.simulate_scenario",
        "synthesis.design.design",
        "judge.plants.plant_at",
        "identification.pipeline.identify",
        "record.files.read_record",
    ):
        monkeypatch.setattr(f"ambrose.{place}", begun)


SIMULATE = [
    "simulate",
    "seal-rig",
    "--controller",
    "{tmp}/law.json",
    "--scenario",
    "impulse-parallel",
]
BAD = {
    "a controller that is a machine file": (
        ["synthesize", "seal-rig", "-o", "{tmp}/m.toml"],
        "must be a file *.json",
    ),
    "a report that is a machine file": (
        [*SIMULATE, "-o", "{tmp}/r.h5", "--report", "{tmp}/m.toml"],
        "must be a file *.html",
    ),
    "a report in no folder": (
        [*SIMULATE, "-o", "{tmp}/r.h5", "--report", "{tmp}/none/r.html"],
        "not a directory",
    ),
    "a report that is a folder": (
        [*SIMULATE, "-o", "{tmp}/r.h5", "--report", "{tmp}"],
        "path of the report",
    ),
    "a report over the record": (
        [*SIMULATE, "-o", "{tmp}/r.h5", "--report", "{tmp}/x/../r.h5"],
        "another name",
    ),
    "a record of no known kind": ([*SIMULATE, "--linear", "-o", "{tmp}/r.txt"], "suffix"),
    "a controller in no folder": (
        ["synthesize", "seal-rig", "-o", "{tmp}/none/c.json"],
        "not a directory",
    ),
    "a machine file in no folder": (
        ["identify", "seal-rig", "r.h5", "--method", "static", "-o", "{tmp}/none/m.toml"],
        "not a directory",
    ),
    "an identification's report in no folder": (
        [
            "identify",
            "seal-rig",
            "r.h5",
            "--method",
            "static",
            "-o",
            "{tmp}/m.toml",
            "--report",
            "{tmp}/none/r.html",
        ],
        "not a directory",
    ),
    "a converted record in no folder": (
        ["convert", "r.h5", "-o", "{tmp}/none/r.csv"],
        "not a directory",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(case, law, never, tmp_path):
    """A simulation, an identification ran to its end first; a report replaced the record of its own
    run.
    """
    arguments, words = BAD[case]
    (tmp_path / "x").mkdir()
    before = sorted(tmp_path.iterdir())
    done = call(*(argument.format(tmp=tmp_path) for argument in arguments))
    assert done.exit_code == 2 and words in done.stderr, done.stderr
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "arguments",
    [
        [*SIMULATE, "-o", "{tmp}/out"],
        ["synthesize", "seal-rig", "-o", "{tmp}/out"],
        ["identify", "seal-rig", "r.h5", "--method", "static", "-o", "{tmp}/out"],
    ],
)
def test_what_another_run_writes_is_refused_before_the_work(arguments, law, never, tmp_path):
    """Both ran; the last one to end was what remained."""
    place = tmp_path / ("out.h5" if arguments[0] == "simulate" else "out")
    with claimed(place, "file"):
        done = call(
            *(
                argument.format(tmp=tmp_path).replace("/out", f"/{place.name}")
                for argument in arguments
            )
        )
    assert done.exit_code == 2 and "another run is writing" in done.stderr


def test_a_controller_that_cannot_be_written_in_the_end_is_written_elsewhere(tmp_path, monkeypatch):
    """The design, perhaps of an hour, was lost."""
    made = Synthesis(static_gain([[2.0]], ["err_A"], ["u_A"]), "pid")
    path, real = tmp_path / "c.json", write_controller

    def full(place, result):
        if Path(place) == path:
            raise InvalidInput("cannot write the controller file: No space left on device")
        return real(place, result)

    monkeypatch.setattr("ambrose.synthesis.design.design", lambda *arguments, **options: made)
    monkeypatch.setattr("ambrose.judge.controller_file.write_controller", full)
    done = call("synthesize", "seal-rig", "--method", "pid", "-o", path, "--json")
    assert done.exit_code == 2 and json.loads(done.stdout)["method"] == "pid"
    elsewhere = Path(done.stderr.split("it was written to ")[1].split(" instead")[0])
    assert read_controller(elsewhere) == made
    elsewhere.unlink()
    elsewhere.parent.rmdir()


@pytest.mark.parametrize("text", ["zero pressure ", "\\tzero", "two\\nlines", "a\\u001b[31mb"])
def test_labels_that_no_record_takes_are_refused_with_the_machine_file(text, tmp_path):
    """The study of such a machine ended at its first record, after the design."""
    content = Path(bundled_machines()["seal-rig"]).read_text(encoding="utf-8")
    for old in ('label = "zero pressure"', 'name = "seal-rig"'):
        assert old in content
        (tmp_path / "m.toml").write_text(
            content.replace(old, f'{old.split(" = ")[0]} = "{text}"'), encoding="utf-8"
        )
        done = call("check", tmp_path / "m.toml")
        assert done.exit_code == 2 and "one line of text without outer spaces" in done.stderr


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        (lambda: 1 / 0, "overflows or is undefined"),
        (lambda: np.float64(1e300) * np.float64(1e300), "overflows or is undefined"),
        (lambda: {}["key"], r"broke down (KeyError)"),
    ],
)
def test_what_nothing_refused_ends_in_one_sentence(monkeypatch, fault, words):
    """No traceback, no warning with a place in the source."""
    monkeypatch.setattr("ambrose.machine.file.toml.bundled_machines", lambda: [fault()])
    result = call("machines", "--json")
    assert result.exit_code == 2 and words in json.loads(result.stdout)["error"]
    assert "Traceback" not in result.output and ".py" not in result.output
    monkeypatch.setenv("AMBROSE_TRACEBACK", "1")
    assert not isinstance(call("machines").exception, SystemExit)


@pytest.mark.parametrize(
    "call_with",
    [
        claim.claimed("a\0b", "folder").__enter__,
        lambda: atomic_write.check_place("a\0b"),
        lambda: read_amplitudes("a\0b", AXES),
        lambda: foreign.variables_in_words("a\0b"),
        lambda: acceptance._named("a\0b", 1),
    ],
)
def test_a_path_with_a_null_character_is_refused(call_with):
    """Each ended in a ValueError of the system's: embedded null byte."""
    with pytest.raises(InvalidInput, match="free of null characters; give the name of a file"):
        call_with()


@pytest.mark.parametrize("words", [["study", "seal-rig", "-o", "a\0b"], ["check", "a\0b"]])
def test_an_argument_with_a_null_character_is_refused(words):
    done = call(*words)
    assert done.exit_code == 2 and "an argument contains a null character" in done.stderr
