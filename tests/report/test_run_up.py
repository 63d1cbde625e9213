"""The run-up's section: every step of every controller, late settling marked."""

from dataclasses import dataclass

import numpy as np
import pytest

from ambrose.machine.description import OperatingPoint
from ambrose.record.record import Record
from ambrose.report.comparison import run_up_section
from ambrose.rig.trace import Trace
from ambrose.rig.trial import Step


@dataclass(frozen=True)
class Run:
    name: str
    linear: Trace
    rig: Trace
    linear_steps: tuple[Step, ...]
    rig_steps: tuple[Step, ...]


def run(name, settling):
    time = np.arange(2001) * 5e-4
    values = np.array([1e-6 * np.exp(-((time % 0.05) / 0.005)), 0 * time])
    record = Record(
        "machine", 2000.0, ("y_A_zeta", "u_A_zeta"), ("m", "A"), values, OperatingPoint()
    )
    trace = Trace(record, "spin-up-steps", True, "completed", "completed")
    found = tuple(Step(0.05 * k, 100.0 + k, 1e-6, s, 0) for k, s in enumerate(settling))
    return Run(name, trace, trace, found, found)


@pytest.fixture(scope="module")
def section():
    return run_up_section([run("LPV", (0.01, 0.012)), run("mu", (0.031, np.inf))], 0.02)


def test_every_step_has_its_row_and_late_ones_are_marked(section):
    (table,) = section.tables
    assert len(table.rows) == 2
    marks = [[cell.mark for cell in row[2:]] for row in table.rows]
    assert marks == [["number", "number", "fail", "fail"]] * 2
    assert table.rows[0][2].text.replace("\u00a0", " ") == "10 ms"
    assert table.rows[1][4].text == "not within 50 ms"
    assert "20" in table.note


def test_a_run_that_ended_before_has_its_cells():
    (table,) = run_up_section([run("LPV", (0.01, 0.012)), run("mu", (0.031,))], None).tables
    assert [cell.text for cell in table.rows[1][4:]] == ["ended before", "ended before"]
    assert [cell.mark for cell in table.rows[1][4:]] == ["fail", "fail"]


def test_the_figure_shows_first_and_last_steps_linear_and_on_the_rig(section):
    (figure,) = section.figures
    lines = [trace for trace in figure.picture.data if trace.mode == "lines" and len(trace.y) > 100]
    assert len(lines) == 8  # two controllers in four panels
    assert {line.name for line in lines} == {"LPV", "mu"}
