"""identify(): what it takes, what it gives, what it refuses in one sentence."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from benchmarks import waveforms

import ambrose
from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification import loop
from ambrose.identification.findings import Code
from ambrose.identification.pipeline import Provenance, identify
from ambrose.law.loop import closed_loop, match_controller
from ambrose.law.pid import pid_controller
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.files import write_record
from ambrose.record.record import Record

DT = 1e-4
FOUR = ("bearing.*.negative_stiffness.*",)


@cache
def setting():
    """The rig with coarse shaft sections, its controller, and 0.6 s of its linear loop with stiffer
    magnets.
    """
    machine = load_machine("seal-rig")
    machine = replace(machine, shaft=tuple(replace(part, elements=1) for part in machine.shaft))
    bearings = tuple(
        replace(b, negative_stiffness=tuple(1.1 * k for k in b.negative_stiffness))
        for b in machine.bearings
    )
    plant = free_mode_reduction(assemble(replace(machine, bearings=bearings)), 1)
    controller = pid_controller(machine.controller, machine)
    whole = closed_loop(plant, c2d(match_controller(controller, plant), DT, "tustin", delay=DT))
    e = np.stack([0.1 * waveforms.prbs(9, 10, 6000, shift=127 * i) for i in range(4)])
    names = [[f"{kind}_{axis}" for axis in plant.axes] for kind in "yue"]
    values = np.vstack([simulate(select(whole, names[2], names[0] + names[1]), e), e])
    values[:4] += 1e-9 * np.random.default_rng(0).standard_normal((4, 6000))
    record = Record(
        machine.name,
        1 / DT,
        (*names[0], *names[1], *names[2]),
        ("m",) * 4 + ("A",) * 8,
        values,
        plant.point,
    )
    return machine, record, controller


@cache
def done():
    machine, record, controller = setting()
    return identify(
        machine,
        record,
        controller,
        unknown=FOUR,
        provenance=Provenance(("run.h5",), "pid.json", "2026-11-22"),
    )


def test_one_result_holds_machine_parameters_and_findings():
    machine, *_ = setting()
    result = done()
    assert result.method == "closed-loop" and result.passed and result.findings == ()
    for row, before in zip(result.parameters, result.result.start, strict=True):
        assert (
            row.value == pytest.approx(1.1 * before, rel=0.01)
            and row.start == before
            and row.unit == "N/m"
        )
        assert row.interval[0] < row.value < row.interval[1]
    assert result.machine.bearings[1].negative_stiffness[1] == result.parameters[3].value
    assert result.given is machine and "from run.h5 with pid.json" in result.machine.source
    assert (
        result.comment.startswith("# Identified 2026-11-22 by ambrose")
        and result.verdict in result.comment
    )


def test_it_shows_itself_and_gives_plain_data():
    result = done()
    assert (
        len(repr(result)) < 200 and "parameters=4" in repr(result) and "passed=True" in repr(result)
    )
    assert "bearing.A.negative_stiffness.zeta" in result._repr_html_()
    plain = json.loads(json.dumps(result.to_dict()))
    assert plain["good"] is True and [row["path"] for row in plain["parameters"]] == list(
        result.result.paths
    )
    pandas = pytest.importorskip("pandas")
    frame = result.to_frame()
    assert (
        isinstance(frame, pandas.DataFrame)
        and frame.loc["bearing.A.negative_stiffness.zeta", "unit"] == "N/m"
    )


def test_the_experiment_is_built_once(monkeypatch):
    machine, record, controller = setting()
    built = []
    build = loop.build_experiment
    monkeypatch.setattr(
        loop, "build_experiment", lambda *arguments: built.append(1) or build(*arguments)
    )
    identify(machine, record, controller, unknown=FOUR)
    assert len(built) == 1


def test_a_part_of_a_record():
    machine, record, controller = setting()
    end = float(record.time[-1])
    result = identify(
        machine, record, controller, unknown=FOUR[0], between=(0.25 * end, 0.75 * end)
    )
    taken = result.outputs[0].record
    assert taken.start_time == pytest.approx(0.25 * end, abs=record.dt)
    assert taken.time[-1] == pytest.approx(0.75 * end, abs=2 * record.dt)
    assert not any("settled" in remark for remark in result.remarks)
    assert "s of record 1 was taken" in result.remarks[0] and "was taken." in result.comment
    with pytest.raises(InvalidInput, match="time window"):
        identify(machine, record, controller, unknown=FOUR[0], between=(end + 1, end + 2))
    for wrong in ((2.0, 1.0), (float("nan"), 1.0)):
        with pytest.raises(InvalidInput, match="give the beginning first"):
            identify(machine, record, controller, unknown=FOUR[0], between=wrong)


def test_a_beginning_that_has_not_settled_is_left_out():
    """The rotor comes from 60 um off; seen in the values as well as told."""
    machine, record, controller = setting()
    values = record.values.copy()
    rows = [j for j, name in enumerate(record.signals) if name.startswith("y_")]
    values[rows] += 60e-6 * np.exp(-(record.time - record.time[0]) / (0.02 * record.time[-1]))
    result = identify(machine, replace(record, values=values), controller, unknown=FOUR)
    assert any("had not settled" in remark for remark in result.remarks)
    assert 0 < result.outputs[0].record.start_time < 0.3 * record.time[-1]
    whole = done().parameters
    for row, before in zip(result.parameters, whole, strict=True):
        assert abs(row.value - before.value) < 3 * row.standard_deviation
        assert row.value == pytest.approx(before.value, rel=1e-2)


def test_records_may_be_files_and_controllers_anything_with_a_state_space(tmp_path):
    machine, record, controller = setting()
    path = write_record(record, tmp_path / "run.h5")
    foreign = SimpleNamespace(
        A=controller.A, B=controller.B, C=controller.C, D=controller.D, dt=None
    )
    result = identify(machine, path, foreign, unknown=FOUR[0])
    np.testing.assert_array_equal(result.result.values, done().result.values)
    assert result.provenance.records == ("run.h5",)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"machine": "seal-rig"},
            "the machine is str, but must be a Machine; load it with load_machine",
        ),
        ({"records": []}, r"records is \[\], but must be a Record or a file"),
        ({"records": [7]}, "record 1 is a int, but must be a Record or the path of one"),
        ({"controller": None}, "controller is missing"),
        (
            {"controller": "pid.json"},
            "the controller is 'pid.json', but must be a StateSpace or a Synthesis",
        ),
        ({"controller": object()}, "must be something with matrices A, B, C and D"),
        ({"unknown": "bearing.C.force_per_current.zeta"}, 'unknown bearing "C"'),
        ({"unknown": [3]}, "an unknown is 3, but must be a path"),
        ({"start": [1.0]}, "start is .*, but must be a mapping"),
        ({"start": {FOUR[0]: "much"}}, "the start value of .* is not numeric"),
        ({"method": "magic"}, "method is 'magic', but must be one of closed-loop, youla, static"),
        ({"colour": 1}, "there is no option 'colour'; known: average"),
        (
            {"method": "youla", "signals": ["y_A_zeta"]},
            "signals is given, but must be left out with method youla; it goes with closed-loop",
        ),
        ({"average": 1.0}, "average is given, .* goes with static: the closed loop is fitted"),
        ({"seal": "center"}, "seal names the seal of seal_form"),
        ({"seal_form": "line", "repeats": True}, "repeats does not go with seal_form"),
        ({"repeats": True}, "at least 2 for repeats"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(change, words):
    machine, record, controller = setting()
    arguments = {
        "machine": machine,
        "records": record,
        "controller": controller,
        "unknown": FOUR,
    } | change
    with pytest.raises(InvalidInput, match=words) as caught:
        identify(**arguments)
    assert "\n" not in str(caught.value)


def test_findings_are_told_apart_by_code():
    machine, record, controller = setting()
    result = identify(machine, record, controller, unknown=FOUR, computing_delay=0)
    assert not result.passed
    assert Code.OTHER_DELAY in {finding.code for finding in result.findings}
    assert "other-delay" in {row["code"] for row in result.to_dict()["findings"]}


def test_every_code_is_given_somewhere():
    folder = Path(ambrose.__file__).parent
    used = {
        name
        for path in folder.rglob("*.py")
        for name in re.findall(r"\bCode\.([A-Z_]+)", path.read_text("utf-8"))
    }
    assert used == {code.name for code in Code}
