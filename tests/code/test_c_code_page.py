"""docs/reference/c-code.md: its C compiles against the generated header, and its software in the loop
runs as printed.
"""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.code.block.block import build_block
from ambrose.code.c.code import generate
from ambrose.code.sampled import deploy
from ambrose.judge.controller_file import write_controller
from ambrose.judge.result import pid_synthesis
from ambrose.law.law import ControlProgram
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.synthesis.design import design
from needs import needs

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "c-code.md").read_text()
FLAGS = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-fsyntax-only"]


def block(kind, word):
    return next(
        text for text in re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL) if word in text
    )


@needs("cc")
def test_the_interrupt_compiles_as_printed(tmp_path):
    plant = assemble(load_machine("seal-rig"))
    deployment = deploy(pid_synthesis(plant), 1e-4, 1e-4, plants=[], force=True)
    for name, text in generate(build_block(deployment, "seal_rig", 0.5e-3, 4.0)).items():
        (tmp_path / name).write_text(text)
    (tmp_path / "main.c").write_text(block("c", '"seal_rig.h"'))
    done = subprocess.run(
        ["cc", *FLAGS, "main.c"], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@needs("C compiler")
def test_software_in_the_loop_runs_as_printed(tmp_path, monkeypatch, capsys):
    """With an H-infinity controller; plants with one bending mode, where the page takes the full
    ones, are quicker.
    """
    machine = load_machine("seal-rig")
    write_controller(
        tmp_path / "controller.json", design(assemble(machine), "hinf", rate=1e4), machine
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "ambrose.model.assemble.assemble", lambda *arguments: reduce(assemble(*arguments), 1)
    )
    names = {}
    exec(block("python", "CompiledBlock"), names)
    said = capsys.readouterr().out.splitlines()
    assert [line.split(" completed")[0] for line in said] == [
        point.label for point in machine.operation.points
    ]
    checks = names["checks"]  # of the last operating point
    meant = names["deployment"].checks[-1]
    assert checks["sensitivity.output.max"].value == pytest.approx(
        meant["sensitivity.output.max"].value, rel=1e-9
    )

    exec(block("python", "class Converter"), names)
    assert isinstance(names["Converter"](names["code"].system, 1e-9), ControlProgram)
    assert names["trace"].outcome == "completed"
    fine = names["virtual_rig"].run(
        machine,
        names["Converter"](names["code"].system, 1e-15),
        names["load_scenario"]("impulse-parallel"),
    )
    y, exact = (
        np.array([run.record[f"y_{axis}"] for axis in machine.axes])
        for run in (names["trace"], fine)
    )
    code = names["virtual_rig"].run(
        machine, names["code"], names["load_scenario"]("impulse-parallel")
    )
    plain = np.array([code.record[f"y_{axis}"] for axis in machine.axes])
    assert np.abs(exact - plain).max() < 1e-12  # a converter without steps is the code itself
    assert 1e-10 < np.abs(y - plain).max() < 1e-6  # steps of 50 nm are seen
