"""A second run takes up the very controller of the first, and only that."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from ambrose.annexes.scheduled.lpv.method import Lpv
from ambrose.chain import stages as control
from ambrose.chain.stages import resume_or_design
from ambrose.core.scheduled import ScheduledSystem
from ambrose.judge.controller_file import write_controller
from ambrose.judge.result import (
    Certificate,
    Status,
    Synthesis,
    certify_on_full_plant,
    pid_synthesis,
)
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.synthesis.design import provenance
from ambrose.synthesis.methods import Hinf
from coarse import coarse

OWN_GAIN = Hinf(match_reference=False, rate=1e4)


@pytest.fixture(scope="module")
def plant():
    return reduce(assemble(coarse("seal-rig")), 1)  # the full one says the same, later


@pytest.fixture(scope="module")
def first(plant, tmp_path_factory):
    """The H-infinity controller of a first run, and the text of its file."""
    path = tmp_path_factory.mktemp("first") / "controller-hinf.json"
    return resume_or_design(plant, OWN_GAIN, path, lambda text: None), path.read_text(
        encoding="utf-8"
    )


@pytest.fixture
def kept(first, tmp_path):
    path = tmp_path / "controller-hinf.json"
    path.write_text(first[1], encoding="utf-8")
    return path


@pytest.fixture
def designs(monkeypatch, first):
    """The designs that were asked for, none of them made."""
    asked = []

    def stand_in(plant, method, *, progress):
        asked.append(method)
        return first[0]

    monkeypatch.setattr(control, "design", stand_in)
    return asked


def test_the_very_synthesis_comes_back(plant, first, kept, designs):
    """History, notes and weights were lost: of H-infinity's rows none was left."""
    again = resume_or_design(plant, OWN_GAIN, kept, lambda text: None)
    assert not designs
    assert again == first[0]
    assert len(again.history) == len(first[0].history) > 5
    assert kept.read_text(encoding="utf-8") == first[1]


CHANGES = {
    "another package version": lambda made: made.update(package_version="0.0.9"),
    "another machine": lambda made: made.update(machine_hash="0" * 64),
    "another rate": lambda made: made["settings"].update(rate=2e4),
    "another delay": lambda made: made["settings"].update(delay_samples=2),
    "another order": lambda made: made["settings"].update(order=12),
    "another gain": lambda made: made["settings"].update(match_reference=True),
    "another operating point": lambda made: made["settings"]["point"].update(seal_pressure=1.0),
    "a controller from elsewhere": lambda made: made.update(settings=None),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_another_design_made_is_not_taken_up(name, plant, kept, designs):
    """Only the machine and the method counted: a controller for another rate or of an older package
    was taken up.
    """
    content = json.loads(kept.read_text(encoding="utf-8"))
    CHANGES[name](content["provenance"])
    kept.write_text(json.dumps(content), encoding="utf-8")
    resume_or_design(plant, OWN_GAIN, kept, lambda text: None)
    assert designs == [OWN_GAIN]


def test_a_file_that_says_other_than_its_controller_is_designed_anew(plant, kept, designs):
    """The margins of a kept controller were written over with the recomputed ones, whatever they
    were.
    """
    content = json.loads(kept.read_text(encoding="utf-8"))
    content["D"][0][0] += 0.01 * np.abs(content["D"]).max() + 100.0
    kept.write_text(json.dumps(content), encoding="utf-8")
    lines = []
    resume_or_design(plant, OWN_GAIN, kept, lines.append)
    assert designs == [OWN_GAIN]
    assert (
        "controller-hinf.json is not taken up: full_s" in lines[0]
        and "designing it anew" in lines[0]
    )


@pytest.mark.parametrize("content", ["", "{}", '{"format": "ambrose-controller", "version": 1}'])
def test_what_cannot_be_read_is_designed_anew(content, plant, kept, designs):
    kept.write_text(content, encoding="utf-8")
    resume_or_design(plant, OWN_GAIN, kept, lambda text: None)
    assert len(designs) == 1


def test_a_file_that_was_changed_is_not_taken_up_and_kept_aside(plant, kept, designs):
    """A gamma, a note and a last digit written into the file by hand stood in the next report."""
    content = json.loads(kept.read_text(encoding="utf-8"))
    content["A"][0][0] *= 1 + 1e-12
    content["gamma"] = 0.1
    kept.write_text(json.dumps(content), encoding="utf-8")
    lines = []
    resume_or_design(plant, OWN_GAIN, kept, lines.append)
    assert designs == [OWN_GAIN]
    assert "controller-hinf.json is not taken up: it was changed after it was written" in lines[0]
    assert (
        json.loads((kept.parent / "earlier-controller-hinf.json").read_text(encoding="utf-8"))[
            "gamma"
        ]
        == 0.1
    )


@pytest.mark.parametrize("name", ["another package version", "another delay"])
def test_why_a_file_is_not_taken_up_is_said(name, plant, kept, designs):
    content = json.loads(kept.read_text(encoding="utf-8"))
    CHANGES[name](content["provenance"])
    kept.write_text(json.dumps(content), encoding="utf-8")
    lines = []
    resume_or_design(plant, OWN_GAIN, kept, lines.append)
    words = {"another package version": "package version", "another delay": "delay_samples"}[name]
    assert lines == [
        f"controller-hinf.json is not taken up: it was made for another {words}; designing it anew"
    ]


def test_the_first_run_goes_on_with_what_the_second_will_read(plant, first, tmp_path, monkeypatch):
    """It went on with what it had designed, undated and perhaps in another order in memory: last
    digits were left to chance.
    """
    law = first[0].controller
    turned = replace(
        first[0],
        controller=replace(law, A=np.asfortranarray(law.A)),
        provenance=provenance(plant, OWN_GAIN),
    )
    monkeypatch.setattr(control, "design", lambda *arguments, **options: turned)
    path = tmp_path / "controller-hinf.json"
    made, again = (resume_or_design(plant, OWN_GAIN, path, lambda text: None) for _ in range(2))
    assert made.provenance == again.provenance and made.provenance.digest
    assert made.controller.A.flags.c_contiguous == again.controller.A.flags.c_contiguous
    assert made == again == turned


def test_a_schedule_is_certified_again_at_every_speed(tmp_path, designs):
    """It was taken up as it was; of the fixed ones at least the margins were recomputed."""
    machine = coarse("turboexpander")
    plant = assemble(machine, machine.operation.design)
    law = pid_synthesis(plant).controller
    schedule = ScheduledSystem([0.9 * plant.point.speed, 1.1 * plant.point.speed], [law, law])
    bare = Synthesis(
        law,
        "lpv",
        2.0,
        Status.VERIFIED,
        Certificate(True, -1.0, 2.0, 1e4, {}, "a family"),
        scheduled=schedule,
    )
    method = Lpv(speeds=schedule.range)
    made = replace(certify_on_full_plant(plant, bare), provenance=provenance(plant, method))
    path = write_controller(tmp_path / "controller-lpv.json", made)
    assert resume_or_design(plant, method, path, lambda text: None) == made
    assert not designs
    weaker = [law, replace(law, C=0.9 * law.C, D=0.9 * law.D)]
    write_controller(path, replace(made, scheduled=ScheduledSystem(schedule.grid, weaker)))
    lines = []
    resume_or_design(plant, method, path, lines.append)
    assert designs == [method] and "full_s" in lines[0]
