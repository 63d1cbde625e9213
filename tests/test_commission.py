"""Commissioning on the rig, the study's last stage: what it leaves, what it refuses, what its
section of the page says.

The robust design takes half a minute and has its own tests; here the PID stands in for it, on a
machine whose seal varies by so little that the PID holds it. Everything else is real: record,
identification, code, compiler, rig.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.chain import commissioning as stage
from ambrose.chain.commissioning import commission, compile_controller
from ambrose.core.checks import InvalidInput, UnstableSystem
from ambrose.judge.controller_file import read_controller
from ambrose.judge.plants import full_plants
from ambrose.judge.result import pid_synthesis
from ambrose.judge.verdict import verify_points
from ambrose.machine.description import Tolerance
from ambrose.machine.file.toml import machine_hash
from ambrose.model.uncertainty import reduce
from ambrose.record.files import read_record
from ambrose.report import page as document
from ambrose.report.comparison import commissioning_section
from ambrose.report.page import Page
from ambrose.rig.trial import evaluate
from coarse import coarse
from needs import needs

LABELS = ("nominal pressure", "zero pressure")


@pytest.fixture(scope="module")
def machine():
    """The seal rig without its highest pressure, the seal's stiffness known to 20 %."""
    rig = coarse("seal-rig")
    points = tuple(point for point in rig.operation.points if point.label in LABELS)
    return replace(
        rig,
        operation=replace(rig.operation, points=points),
        tolerances=(Tolerance("seal.center.k", relative=0.2),),
    )


def small_plants(machine):
    """With one bending mode per plane: quicker where only the outcome counts."""
    return tuple(reduce(plant, 1) for plant in full_plants(machine))


@pytest.fixture(scope="module")
def plants(machine):
    return full_plants(machine)


@pytest.fixture(scope="module")
def reference(plants):
    return pid_synthesis(plants[0])


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    return tmp_path_factory.mktemp("commissioned")


@pytest.fixture(scope="module")
def commissioned(plants, reference, directory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stage, "METHOD", "pid")
        # what the model may lack is looked for in tests of its own
        patch.setattr("ambrose.identification.loop.suspects", lambda *given, **how: ())
        return commission(plants, reference, directory, lambda text: None)


def test_every_file_is_left_and_can_be_read(commissioned, directory):
    left = {path.name for path in directory.iterdir()}
    assert left == {"record.h5", "identified.toml", "identified.html", "controller.json", "code"}
    assert {path.name for path in commissioned.files} == {
        path.name for path in (directory / "code").iterdir()
    }
    record = read_record(directory / "record.h5")
    assert record.time[-1] == pytest.approx(2.0, abs=1e-3)
    found = load_machine(directory / "identified.toml")
    assert machine_hash(found) == machine_hash(commissioned.machine)
    file = read_controller(directory / "controller.json")
    # for the machine that was identified
    assert file.provenance.machine_hash == machine_hash(found)
    assert "<html" in (directory / "identified.html").read_text()


def test_the_update_machine_is_the_rig(commissioned, machine):
    """The seal as it is, with its stated range kept; the magnets stiffer than the unloaded ones of
    the file.
    """
    found = commissioned.machine
    assert found.seals[0].k == pytest.approx(machine.seals[0].k, rel=0.01)
    stated = {item.parameter: item.relative for item in found.tolerances}
    assert stated["seal.center.k"] == pytest.approx(0.2, rel=0.05)
    assert len(stated) == 10 and sorted(stated.values())[-2] < 0.05


@needs("C compiler")
def test_the_compiled_code_holds_the_rig_at_every_point(commissioned, machine):
    assert commissioned.from_code and commissioned.apart < 1e-14
    rig = {
        label: trace for label, trace in commissioned.candidate.traces if "rig" in trace.scenario
    }
    assert set(rig) == set(LABELS)
    for trace in rig.values():
        assert trace.outcome == "completed"
        assert 1e-6 < np.abs(trace.record.values).max() < 1e-5
    assert ("Runs on the rig as", "the compiled C code") in commissioned.in_words


def test_the_code_takes_the_rig_from_rest_to_pressure_and_back(commissioned):
    cycle = commissioned.cycle
    assert (cycle.scenario, cycle.outcome) == (
        "operating-cycle",
        "completed",
    ) and "levitated since" in cycle.text
    record = cycle.record
    # of its points, the nominal one
    assert record["p_seal"].max() == pytest.approx(2.04e5) and record["p_seal"][-1] == 0
    late = (
        record.select([name for name in record.signals if name.startswith("q_")])
        .between(4.5, 5.0)
        .values
    )
    assert np.ptp(late, axis=1).max() < 1e-6
    assert (
        "From rest through run-up, top pressure and trip back to rest",
        cycle.text,
    ) in commissioned.in_words


def test_it_is_judged_as_it_runs(commissioned):
    """The checks are of the sampled loop with its delay, not of the continuous design, whose
    sensitivity is lower.
    """
    continuous = verify_points(
        full_plants(commissioned.machine), commissioned.candidate.synthesis.controller
    )
    for found, sampled, other in zip(
        commissioned.candidate.checks, commissioned.deployment.checks, continuous, strict=True
    ):
        value = found["sensitivity.output.max"].value
        assert value == pytest.approx(sampled["sensitivity.output.max"].value, rel=1e-9)
        assert value > 1.01 * other["sensitivity.output.max"].value
    assert commissioned.deployment.problems == ()


@pytest.mark.usefixtures("values_alone")
def test_a_second_run_takes_the_controller_up(
    commissioned, plants, reference, directory, monkeypatch
):
    def never(*arguments, **options):
        raise AssertionError("designed again")

    monkeypatch.setattr(stage, "METHOD", "pid")
    monkeypatch.setattr("ambrose.chain.stages.design", never)
    monkeypatch.setattr(
        stage,
        "compile_controller",
        lambda known, place, progress: (commissioned.deployment, known[0], ()),
    )
    monkeypatch.setattr(
        stage, "read_running_law", lambda program, deployment: (deployment.controller, None)
    )
    monkeypatch.setattr(stage, "evaluate", lambda name, synthesis, *rest, **options: synthesis)
    monkeypatch.setattr(
        stage, "simulate_scenario", lambda *arguments, **options: commissioned.cycle
    )
    again = commission(plants, reference, directory, lambda text: None)
    assert machine_hash(again.machine) == machine_hash(commissioned.machine)
    np.testing.assert_array_equal(
        again.candidate.controller.A, commissioned.candidate.synthesis.controller.A
    )


def test_without_a_compiler_the_law_runs_in_python(commissioned, directory, monkeypatch):
    monkeypatch.setattr(stage, "has_compiler", lambda: False)
    deployment, program, files = compile_controller(
        small_plants(commissioned.machine), directory, lambda text: None
    )
    law, apart = stage.read_running_law(program, deployment)
    assert apart is None and law is program
    # written all the same
    assert [path.name for path in files] == [path.name for path in commissioned.files]
    words = dict(replace(commissioned, apart=None).in_words)
    assert words["Runs on the rig as"].startswith("its law in Python")


def test_a_reference_that_does_not_hold_the_plant_is_refused(plants, reference, tmp_path):
    law = reference.controller
    wrong = replace(reference, controller=replace(law, C=-law.C, D=-law.D))
    with pytest.raises(
        InvalidInput, match="reference controller does not stabilise the nominal plant"
    ):
        commission(plants, wrong, tmp_path / "none", lambda text: None)
    assert not (tmp_path / "none").exists()


def test_a_record_of_a_run_into_the_bearings_is_refused(plants, reference, tmp_path):
    weak = replace(
        reference.controller, C=0.2 * reference.controller.C, D=0.2 * reference.controller.D
    )
    with pytest.raises(InvalidInput, match=r"no record to identify from: .*touchdown"):
        stage.recorded(plants, weak, tmp_path, lambda text: None)


def test_a_controller_unstable_over_the_tolerances_is_not_run(commissioned, directory):
    """On the whole range of the seal the PID's sampled loop is unstable: no code, and the message
    says where.
    """
    wide = replace(commissioned.machine, tolerances=(Tolerance("seal.center.k", relative=1.0),))
    before = {path: path.read_bytes() for path in (directory / "code").iterdir()}
    with pytest.raises(UnstableSystem, match=r"unstable at \d+ points of the tolerances"):
        compile_controller(small_plants(wide), directory, lambda text: None)
    assert {path: path.read_bytes() for path in (directory / "code").iterdir()} == before


@pytest.fixture(scope="module")
def section(commissioned, plants, reference):
    exact = tuple(replace(plant, machine=replace(plant.machine, tolerances=())) for plant in plants)
    candidate = evaluate("PID", reference, exact)
    return commissioning_section(
        commissioned.identification,
        candidate,
        commissioned.candidate,
        LABELS,
        commissioned.in_words,
        commissioned.cycle,
        from_code=commissioned.from_code,
    )


def test_section_says_what_was_found(section, commissioned, machine):
    tables = {table.title: table for table in section.tables}
    rig = next(table for title, table in tables.items() if title.startswith("On the nonlinear rig"))
    assert [row[0].text for row in rig.cells] == list(LABELS)
    assert all(row[1].mark == row[3].mark == "pass" for row in rig.cells)
    assert rig.groups[2][0] == "commissioned, compiled C code"
    code = {row[0].text: row[1].text for row in tables["The code"].cells}
    worst = commissioned.deployment.box[0]["sampled.sensitivity.box"].value
    assert code["Worst sampled sensitivity"].startswith(f"{worst:.3g} at seal.center.k")
    assert code["Sampled loop"].startswith("0 unstable")
    # the PID: 7.1
    assert (
        "nominal pressure: Peak output sensitivity" in code["Limits that the sampled loop misses"]
    )
    assert len(tables["Parameters"].rows) == 10
    page = document.render(Page("Commissioning", machine, (section,)))
    assert "Commissioned on the rig" in page and "What the record changed" in page
    assert not re.search(r"\bnan\b", re.sub(r"<script.*?</script>", "", page, flags=re.S))


def test_results_are_plain_data(commissioned):
    found = json.loads(json.dumps(commissioned.to_dict()))
    assert found["compiled"] is commissioned.from_code
    assert found["rig"] == dict.fromkeys(LABELS, "completed")
    assert [point["label"] for point in found["sampled"]] == [
        *LABELS,
        f"over all tolerances around {LABELS[0]}, sampled",
    ]
