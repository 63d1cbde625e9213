"""amb.plot: every result has a figure, which shows its numbers in the units of the page; anything
else is refused in words.
"""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import FrequencyResponse, frequency_response
from ambrose.core.lft import RealBlock
from ambrose.core.mu.bounds import mu_bounds
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.judge.checks import Checks, Verification
from ambrose.judge.result import Certificate, Status, Synthesis
from ambrose.machine.description import OperatingPoint
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.record.record import Record
from ambrose.report.figures.bode import entries, grid_of, phase
from ambrose.report.plot import plot
from ambrose.rig.trace import Trace
from ambrose.rig.trial import Candidate

AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")


def controller(gains: tuple[float, ...] = (1e4, 2e4, 1e4, 3e4), cross: float = 0.0) -> StateSpace:
    """One lag at 100 Hz per axis [A/m]."""
    n, rate = len(gains), 2 * np.pi * 100
    C = np.diag(gains) * rate + cross * rate * (1 - np.eye(n))
    names = [f"err_{axis}" for axis in AXES[:n]], [f"u_{axis}" for axis in AXES[:n]]
    return StateSpace(-rate * np.eye(n), np.eye(n), C, np.zeros((n, n)), *names)


def record(signals: tuple[str, ...] = ("y_A_zeta", "y_A_eta", "u_A_zeta", "u_A_eta")) -> Record:
    t = np.arange(2000) / 1e4
    values = np.array([1e-5 * np.cos(300 * t + i) * np.exp(-9 * t) for i in range(len(signals))])
    units = tuple("m" if name.startswith("y") else "A" for name in signals)
    return Record("sample", 1e4, signals, units, values, OperatingPoint(label="half <pressure>"))


def identification() -> ParameterEstimate:
    covariance = np.diag([1.0, 4e8])
    return ParameterEstimate(
        "sample",
        OperatingPoint(),
        ("bearing.A.force_per_current", "seal.center.k"),
        np.array([110.0, 3.1e6]),
        np.array([100.0, 3.0e6]),
        covariance,
        np.eye(2),
        np.eye(2),
        ((1, "y_A_zeta", 98.0),),
        (),
        3.0,
        True,
        5,
        (),
        "white",
    )


def made(system: StateSpace, scheduled: ScheduledSystem | None = None) -> Synthesis:
    return Synthesis(
        system, "pid", 2.0, Status.VERIFIED, Certificate(True, -1.0, 2.0, 10.0), scheduled=scheduled
    )


def text_of(figure: Any) -> str:
    """Everything that the figure says; proves too that it can be written."""
    return (
        " ".join([figure.layout.title.text, *(note.text for note in figure.layout.annotations)])
        + figure.to_json()[:0]
    )


def line(figure: Any, name: str) -> Any:
    return next(trace for trace in figure.data if trace.name == name)


def test_a_controller_is_drawn_in_its_units_with_its_phase() -> None:
    figure = plot(controller())
    gain, turn = [trace for trace in figure.data if trace.name == "B η"]
    i = int(np.argmin(np.abs(np.array(gain.x) - 100.0)))
    assert gain.y[0] == pytest.approx(30.0, rel=1e-3)  # 3e4 A/m as A/mm
    assert gain.y[i] == pytest.approx(30.0 / np.sqrt(2), rel=2e-2)
    assert turn.y[i] == pytest.approx(-45.0, abs=1.0)
    assert figure.layout.yaxis.title.text == "Magnitude [A/mm]"
    # equal axes are one line
    assert [trace.name for trace in figure.data if trace.showlegend] == ["A ζ, B ζ", "A η", "B η"]
    assert figure.layout.title.text == "Controller: 4 states, continuous"


def test_cross_coupling_has_a_line_of_its_own() -> None:
    figure = plot(made(controller(cross=500.0)))
    assert line(figure, "largest cross coupling").y[0] == pytest.approx(0.5, rel=1e-3)
    assert figure.layout.title.text.startswith("Controller (pid)")


def test_a_sampled_controller_says_its_rate_and_ends_below_half_of_it() -> None:
    figure = plot(c2d(controller(), 1e-3, "tustin"))
    assert "sampled at 1\u202f000\xa0Hz" in figure.layout.title.text
    assert max(max(trace.x) for trace in figure.data) < 500.0
    assert figure.layout.shapes[0].x0 == 500.0


def test_several_systems_by_name_are_a_map_of_poles_and_zeros() -> None:
    figure = plot({"one": controller(), "two": controller(cross=10.0)})
    assert sorted(trace.name for trace in figure.data if trace.showlegend) == ["poles", "zeros"]


def test_a_schedule_shows_its_members() -> None:
    systems = [controller((gain,) * 4) for gain in (1e4, 2e4, 4e4)]
    figure = plot(
        made(systems[0], ScheduledSystem(2 * np.pi * np.array([10.0, 20.0, 30.0]), systems))
    )
    shown = [trace for trace in figure.data if trace.showlegend]
    assert [trace.name for trace in shown] == ["10\xa0Hz", "20\xa0Hz", "30\xa0Hz"]
    assert shown[2].y[0] / shown[0].y[0] == pytest.approx(4.0, rel=1e-6)


def test_systems_of_python_control_are_drawn() -> None:
    control = pytest.importorskip("control")
    figure = plot(control.ss([[-1.0]], [[1.0]], [[1.0]], [[0.0]]))
    assert figure.data[0].y[0] == pytest.approx(1 / np.hypot(1, 0.2 * np.pi), rel=1e-4)


def test_a_response_that_is_not_square_names_its_entries() -> None:
    response = FrequencyResponse(
        np.ones((5, 1, 2), complex), np.arange(1.0, 6.0), ("u_a", "u_b"), ("y_a",)
    )
    assert [item.name for item in entries(response)] == ["u a → y a", "u b → y a"]
    many = FrequencyResponse(
        np.ones((5, 3, 4), complex), np.arange(1.0, 6.0), tuple("abcd"), tuple("efg")
    )
    assert entries(many)[0].gain == pytest.approx(np.sqrt(12.0) * np.ones(5))
    assert len({trace.yaxis for trace in plot(many).data}) == 1  # no phase
    with pytest.raises(InvalidInput, match="stack"):
        plot(FrequencyResponse(np.ones((2, 5, 1, 1), complex), np.arange(1.0, 6.0), ("u",), ("y",)))


def test_the_grid_of_a_system_holds_its_resonances() -> None:
    sharp = StateSpace([[0.0, 1.0], [-1e6, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    peak = np.abs(frequency_response(sharp, grid_of(sharp)).values).max()
    assert peak == pytest.approx(1 / (0.2 * 1e3), rel=1e-3)


def test_phases_begin_within_a_turn() -> None:
    assert phase(np.array([-1.0 - 1e-3j, -1.0 + 1e-3j]))[0] == pytest.approx(-180.0, abs=0.1)
    assert phase(np.array([1j, -1 + 0j]))[1] == pytest.approx(180.0)


def test_verifications_show_the_sensitivity_and_name_what_is_unstable(
    verifications: list[Checks],
) -> None:
    lost = replace(verifications[2], stable=False, curves=verifications[2].curves[-1:])
    figure = plot(Verification((*verifications[:2], lost), (), ("standstill",)))
    words = text_of(figure)
    assert "unstable at twice nominal &lt;pressure&gt;" in words.replace("<br>", " ")
    assert "not passed" in words and "left out: standstill" in words.replace("<br>", " ")
    assert "zone C/D 5" in words
    one = plot(verifications[0])
    curve = verifications[0].curve("sensitivity.output")
    assert max(
        max(trace.y) for trace in one.data if trace.mode == "lines" and len(trace.x) > 2
    ) == pytest.approx(curve.y.max(), rel=1e-6)
    poles = plot(replace(verifications[0], curves=(verifications[0].curve("poles"),)))
    assert "poles" in poles.layout.title.text.lower()
    with pytest.raises(InvalidInput, match="no curves"):
        plot(replace(verifications[0], curves=()))


def test_every_curve_has_a_title(verifications: list[Checks]) -> None:
    for curve in verifications[0].curves:
        assert plot(curve).layout.title.text


def test_a_machine_and_its_plant(machine: Machine) -> None:
    figure = plot(machine)
    assert "sample &lt;rig&gt;" in figure.layout.title.text
    assert "bending 2" in text_of(figure)
    plant = reduce(assemble(machine), 1)
    curve = plot(plant)
    at = frequency_response(plant.system, [2 * np.pi]).select(plant.named("u"), plant.named("y"))
    assert curve.data[0].y[0] == pytest.approx(1e6 * at.max_singular_value()[0], rel=1e-5)  # µm/A
    assert "1 bending modes" in curve.layout.title.text.replace("<br>", " ")


def test_a_record_shows_its_signals_and_orbits() -> None:
    figure = plot(record())
    words = text_of(figure)
    assert (
        "half &lt;pressure&gt;" in words
        and "<b>Displacement</b> [µm]" in words
        and "<b>Current</b> [A]" in words
    )
    assert max(figure.data[0].y) == pytest.approx(10.0, rel=1e-3)
    assert figure.layout.yaxis3.scaleanchor == "x3"  # both directions of the orbit to one scale
    alone = plot(record(("y_A_zeta", "u_A_zeta")))
    assert len(alone.data) == 2  # no orbit of one direction
    assert plot(record(("u_A_zeta",))).layout.title.text


def test_a_trace_says_how_it_ended() -> None:
    trace = Trace(record(), "levitation", True, "touchdown", "it fell")
    assert plot(trace).layout.title.text == "levitation, half &lt;pressure&gt;: touchdown"


def test_an_identification_shows_its_intervals() -> None:
    figure = plot(identification())
    assert list(figure.data[0].x) == pytest.approx([10.0, 10 / 3])
    assert list(figure.data[0].error_x.array) == pytest.approx([1.96, 1.96 * 2e4 / 3e4], rel=1e-3)


def test_candidates_are_compared(verifications: list[Checks], machine: Machine) -> None:
    system = controller()
    candidates = (
        Candidate("PID", made(system), tuple(verifications)),
        Candidate("mu", made(system), (verifications[0],)),
    )
    figure = plot(SimpleNamespace(candidates=candidates, machine=machine))
    assert "<b>PID</b>" in text_of(figure) and "<b>mu</b>" in text_of(figure)
    assert "no controller meets every requirement" in figure.layout.title.text.replace("<br>", " ")
    assert plot(candidates[1]).layout.title.text.startswith("Output sensitivity: not passed")


def test_bounds_of_mu() -> None:
    bounds = mu_bounds(np.array([[[0.5]], [[2.0]]]), [RealBlock("k")])
    figure = plot(bounds)
    assert list(line(figure, "upper bound").y) == pytest.approx([0.5, 2.0])
    with pytest.raises(InvalidInput, match="one matrix per frequency"):
        plot(mu_bounds(np.array([[0.5]]), [RealBlock("k")]))


def test_figures_can_be_written_and_stay_within_the_page(
    verifications: list[Checks], machine: Machine
) -> None:
    for thing in (machine, verifications[0], record(), controller(), identification()):
        figure = plot(thing)
        layout = json.loads(figure.to_json())["layout"]
        assert layout["height"] > layout["margin"]["t"] + layout["margin"]["b"] + 100
        assert layout["title"]["text"]


@pytest.mark.parametrize("thing", [3, "seal-rig", None, [controller()], {"a": 1}], ids=str)
def test_anything_else_is_refused_in_one_sentence(thing: Any) -> None:
    with pytest.raises(InvalidInput, match=r"cannot draw .*; give a Machine, Plant, controller"):
        plot(thing)
