"""The snapshot runs every command of `ambrose --help`, and names what differs between two of them.
Nothing is computed.
"""

from __future__ import annotations

import gzip
import json
from base64 import b64encode
from itertools import pairwise

import click
import numpy as np
import pytest
from benchmarks.snapshot import FILES, compare, of_array, of_data, of_message, of_page, of_text
from benchmarks.snapshot_runs import every_run, runs

from ambrose.cli import main

CHOICES = [
    ("synthesize", "--method"),
    ("map", "--what"),
    ("export", "--to"),
    ("export", "--arithmetic"),
    ("export", "--form"),
    ("identify", "--method"),
    ("convert controller", "--sampling"),
]
OPTIONS = [
    ("verify", "--pressure-rate"),
    ("verify", "--pressure-error"),
    ("verify", "--speed-rate"),
    ("simulate", "--fallback"),
    ("simulate", "--estimate"),
    ("simulate", "--second"),
    ("simulate", "--linear"),
    ("export", "--fallback"),
    ("export", "--stuck-after"),
    ("synthesize", "--loss"),
    ("synthesize", "--envelope"),
    ("size", "--least"),
]


@pytest.mark.parametrize("quick", [True, False])
def test_every_command_is_run(quick):
    assert {run.command for run in runs(quick=quick)} == set(main.commands)


def words_of(command):
    return [word for run in every_run() if run.command == command for word in run.words]


def option_of(command, name):
    (option,) = (item for item in main.commands[command].params if name in item.opts)
    return option


@pytest.mark.parametrize(("command", "option"), CHOICES)
def test_every_choice_is_taken(command, option):
    """Every value of these options, the default where none is given included."""
    chosen = option_of(command, option)
    assert isinstance(chosen.type, click.Choice)
    words = words_of(command)
    given = {after for word, after in pairwise(words) if word == option}
    assert given | {chosen.default} >= set(chosen.type.choices)


@pytest.mark.parametrize(("command", "option"), OPTIONS)
def test_what_changes_a_command_most_is_run(command, option):
    assert option_of(command, option) and option in words_of(command)


def test_both_thesis_machines_and_two_of_the_fleet():
    for command in ("check", "synthesize", "verify", "simulate"):
        assert {"seal-rig", "turboexpander", "two-disc-rotor", "turbomolecular-pump"} <= set(
            words_of(command)
        )


def test_every_run_parses():
    """No run fails for an unknown option or a missing argument, which would look the same before
    and after.
    """
    for run in every_run():
        command = main.commands[run.command]
        command.make_context(run.command, list(run.words), resilient_parsing=False)


def test_runs_have_names_and_files():
    names = [run.name for run in every_run()]
    assert len(names) == len(set(names))
    bundled = {path.name for path in FILES.iterdir()}
    written = {word for run in every_run() for word in run.words if not word.startswith("-")}
    assert bundled <= written | {"sequence.toml"}, "a file that no run takes"


def snapshot(tmp_path, name, leaves, level="quick"):
    about = {"level": level, "complete": True, "python": "3", "machine": "x", "packages": {}}
    (tmp_path / name).write_text(json.dumps({"about": about, "runs": leaves}))
    return tmp_path / name


def kept(*parts):
    return {key: value for part in parts for key, value in part}


def test_what_differs_is_named_with_its_size(tmp_path, capsys):
    """One number, one sample of a signal, one line of a message, one exit status."""
    signal = np.linspace(0.0, 2.0, 500)
    moved = signal.copy()
    moved[-1] *= 1 + 1e-9
    said = "fine, 3 s\n  stage: since 30 s\nsmall (1.2 s)\nsecond"
    before = {
        "verify: a": kept(
            of_data("stdout", {"peak": 2.0, "date": "2026-01-01"}),
            of_array("r.h5/y", signal),
            [("exit", 0)],
        ),
        "check: b": kept(of_message("stderr", f"/tmp/x/m.toml: {said}", {"/tmp/x": "FOLDER"})),
    }
    after = {
        "verify: a": kept(
            of_data("stdout", {"peak": 2.0 + 2e-12, "date": "1"}),
            of_array("r.h5/y", moved),
            [("exit", 1)],
        ),
        "check: b": kept(
            of_message(
                "stderr", "/tmp/y/m.toml: fine, 3 s\nsmall (2.2 s)\nthird", {"/tmp/y": "FOLDER"}
            )
        ),
    }
    assert compare(snapshot(tmp_path, "a", before), snapshot(tmp_path, "same", before)) == 0
    assert compare(snapshot(tmp_path, "a", before), snapshot(tmp_path, "b", after)) == 4
    shown = capsys.readouterr().out
    for text in (
        "verify (3 different)",
        "verify: a/stdout/peak: 2.0 -> 2.000000000002 (relative 1.0e-12)",
        "verify: a/r.h5/y: array [500] differs, relative 1.0e-09 in its sample",
        "verify: a/exit: 0 -> 1",
        "check (1 different)",
        "-second",
        "+third",
    ):
        assert text in shown
    assert (
        "date" not in shown
        and "m.toml" not in shown
        and "small" not in shown
        and "stage" not in shown
    )


def test_a_run_or_a_leaf_that_is_gone_differs(tmp_path):
    both = {"check: a": {"x": 1, "y": None}, "check: b": {"x": 1}}
    path = snapshot(tmp_path, "both", both)
    assert compare(path, snapshot(tmp_path, "run", {"check: a": both["check: a"]})) == 1
    assert compare(path, snapshot(tmp_path, "leaf", both | {"check: a": {"x": 1}})) == 1
    assert (
        compare(
            path,
            snapshot(tmp_path, "full", {"check: a": both["check: a"], "map: c": {}}, level="full"),
        )
        == 0
    )


def test_nan_equals_itself_and_a_sign_is_seen(tmp_path):
    def of(value):
        return {"a: b": kept(of_array("x", np.array([1.0, np.nan, value])), [("z", float("nan"))])}

    path = snapshot(tmp_path, "nan", of(np.inf))
    assert compare(path, snapshot(tmp_path, "same", of(np.inf))) == 0
    assert compare(path, snapshot(tmp_path, "sign", of(-np.inf))) == 1


def test_a_page_is_its_text_and_its_figures():
    figure = {
        "data": [
            {
                "x": [1, 2],
                "y": {"dtype": "f8", "bdata": b64encode(np.array([3.0, 4.0]).tobytes()).decode()},
            }
        ]
    }
    packed = b64encode(gzip.compress(json.dumps(figure).encode())).decode()
    page = (
        f'<p>Peak <b>2.5</b></p><script type="text/plain" id="data-1">{packed}</script><script>x = '
        "1</script><table></table>"
    )
    leaves = dict(of_page("p", page))
    assert leaves["p/figures"] == leaves["p/tables"] == 1
    assert leaves["p/data-1/numbers"]["sample"] == [1, 2, 3, 4]
    assert leaves["p/text"] == {"lines": ["Peak", "2.5"]}


def test_code_is_its_numbers_and_its_words():
    texts = ("x = 1.5e-3; /* gain */", "x = 1.6e-3; /* gain */", "x = 1.5e-3;")
    one, other, reworded = (dict(of_text("c", text)) for text in texts)
    assert one["c/numbers"] != other["c/numbers"] and one["c/words"] == other["c/words"]
    assert one["c/numbers"] == reworded["c/numbers"] and one["c/words"] != reworded["c/words"]
