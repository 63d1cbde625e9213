"""A controller that holds nothing, or a design that found none, says cause and remedy in one
sentence.
"""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import NumericalFailure
from ambrose.judge.nominal import stiffness_margin
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import Timing
from ambrose.law.pid import common_sections, pid_controller
from ambrose.machine.part import Channel, PidSettings, ShaftSection
from ambrose.synthesis.design import explained, why_none, why_unstable
from coarse import coarse


@pytest.fixture(scope="module")
def slender():
    """The seal rig with a shaft of 60 mm, which bends at 374 Hz; its PID holds the rigid rotor, as
    long as it is not late.
    """
    machine = coarse("seal-rig")
    shaft = (ShaftSection(0.0, 0.86, 0.06, elements=16),)
    settings = replace(
        machine.controller, sample_time=1e-4, delay=0.0, derivative_time=2e-3, gain=(15000.0,)
    )
    points = replace(machine.operation, points=machine.operation.points[1:2])
    return replace(
        machine,
        shaft=shaft,
        seals=(),
        couplings=(),
        tolerances=(),
        operation=points,
        controller=settings,
    )


def test_a_mode_beyond_the_design_model_is_named_with_its_option(slender):
    plant = amb.assemble(slender)
    law = pid_controller(slender.controller, slender)
    timing = Timing(1e-4, 0)
    said = why_unstable(plant, law, timing, 0, "hinf")
    assert (
        said.startswith("the first bending mode (373.5 Hz)")
        and "is not in the design model; design with --bending-modes 1" in said
    )
    inside = why_unstable(plant, law, timing, 1, "hinf")
    assert "although it is in the design model" in inside
    own = amb.design(plant, "pid")
    assert (
        own.status == "unstable"
        and "add a [[controller.notch]] there" in own.notes[-1]
        and "\n" not in own.notes[-1]
    )

    # a file of chains has no notches of its own
    chain = Channel(slender.axes, slender.controller.gain[0], common_sections(slender.controller))
    chained = replace(slender, controller=PidSettings((), channels=(chain,)))
    again = amb.design(amb.assemble(chained), "pid")
    assert "a section of kind notch to its [[controller.channel]]" in again.notes[-1]


def test_a_gain_below_the_negative_stiffness_is_said(slender):
    weak = replace(slender, controller=replace(slender.controller, gain=(3000.0,)))
    assert (
        stiffness_margin(weak) == pytest.approx(3000 * 163.48 / 1.226e6, rel=0.2)
        and stiffness_margin(weak) < 1
    )
    notes = amb.design(weak, "pid").notes
    assert notes[-1].startswith("K_p k_i is below k_s (0.4") and "raise gain" in notes[-1]


def test_what_holds_gets_no_note(slender):
    machine = coarse("seal-rig")
    machine = replace(
        machine,
        operation=replace(machine.operation, points=machine.operation.points[1:2]),
        tolerances=(),
    )
    made = amb.design(machine, "pid")
    assert (
        made.status == "verified"
        and made.notes == ()
        and why_none(amb.assemble(slender), None) == ""
    )


def test_a_point_that_is_lost_is_named_with_the_note():
    """The PID of the seal rig whirls at twice the nominal pressure, and was "verified" with S_o 7
    at the nominal one.
    """
    made = amb.design("seal-rig", "pid")
    assert made.notes[-1].startswith("at twice nominal pressure: ") and "; " in made.notes[-1]
    assert (
        made.verdict.startswith("certified as stable at 2 of 3")
        and made.certificate.closed_loop_norm > 3
    )
    assert (
        made.notes[0].startswith("sigma_max(S_o) of 7.1 is above the machine's limit of 3;")
        and len(made.notes) == 2
    )


def test_a_delay_that_nothing_can_beat_is_named_by_the_failed_design(slender, monkeypatch):
    late = replace(slender, controller=replace(slender.controller, sample_time=1e-3, delay=2e-2))
    assert why_none(amb.assemble(late), None).startswith("no controller can: the unstable pole at ")

    def nothing(*_, **__):
        raise NumericalFailure("no controller of order 12 was found; allow a higher order")

    monkeypatch.setattr("ambrose.synthesis.fixed_order.tuning.tune_controller", nothing)
    with pytest.raises(
        NumericalFailure,
        match=r"allow a higher order; no controller can: .* keep S above .*; sample faster",
    ):
        amb.design(late)
    with pytest.raises(NumericalFailure, match=r"allow a higher order$"):
        amb.design(slender)


def test_a_continuous_loop_that_is_lost_tells_its_pole(slender):
    away = replace(
        slender.controller, sample_time=None, delay=None, derivative_time=None, integral_time=1e-3
    )
    machine = replace(slender, controller=away)
    plant = amb.assemble(machine)
    assert not pid_synthesis(plant).certificate.stable
    said = why_unstable(plant, pid_controller(away, machine), None, 0, "tuned")
    assert said.startswith("the loop has a pole at +") and "Hz" in said


def test_what_only_a_continuous_controller_holds_is_said_with_the_remedy():
    """The published PID of the turboexpander: its second bending mode is lost at the rate that the
    virtual rig assumes.
    """
    machine = coarse("turboexpander")
    found = amb.design(machine, "pid")
    assert found.status == "verified"
    # as verify's check timing.assumed, whose pole is that of the judge
    assert found.missed and found.verdict.endswith("but only as a continuous loop")
    assumed = [
        check.value
        for point in amb.verify(machine, found, tolerances=False).points
        for check in point.failed
        if check.name == "timing.assumed"
    ]
    assert found.certificate.margins["assumed_abscissa"] == pytest.approx(max(assumed), rel=1e-9)
    assert any(
        "checked as continuous; at 10000 Hz" in note and "--rate-hz" in note for note in found.notes
    )
    assert not any(
        "judged as continuous" in note for note in amb.design(coarse("seal-rig"), "pid").notes
    )
    fast = amb.design(machine, "pid", rate=200_000)
    assert not any("judged as continuous" in note for note in fast.notes) and not fast.missed


def test_of_one_point_that_was_asked_for_the_loss_at_another_is_told_only(tmp_path):
    """At zero pressure the sampled loop holds as well; at nominal only the continuous one does."""
    machine = amb.load_machine("seal-rig")
    settings = machine.controller
    slack = replace(settings, derivative_time=0.8 * settings.derivative_time)
    path = tmp_path / "slack.toml"
    amb.save_machine(replace(machine, controller=slack), path)
    of_point = amb.design(amb.load_machine(path), "pid", point="zero pressure")
    assert of_point.lost_as_assumed and of_point.lost_elsewhere
    assert "unstable at nominal pressure" in " ".join(of_point.notes)
    assert of_point.verdict.endswith("only as a continuous loop at other operating points")
    out = tmp_path / "k.json"
    words = ["synthesize", str(path), "--method", "pid", "-o", str(out)]
    runner = CliRunner()
    assert runner.invoke(main, [*words, "--point", "zero pressure"]).exit_code == 0
    assert runner.invoke(main, [*words, "--point", "nominal pressure"]).exit_code == 1


def test_a_tuned_loop_says_which_checks_of_verify_it_fails():
    """Gamma 0.91 and "verified", and verify then failed on the amplification factor of a mode."""
    rig = coarse("seal-rig")
    speed = 2 * np.pi * 45
    point = replace(rig.operation.nominal, speed=speed)
    machine = replace(
        rig,
        tolerances=(),
        operation=replace(rig.operation, points=(point,), speed_range=(0.0, speed)),
        requirements=replace(rig.requirements, running_speeds=(speed, speed)),
    )
    plant = amb.assemble(machine)
    made = replace(amb.design(plant, "pid"), method="tuned", gamma=0.91)
    assert not made.missed
    found = explained(plant, made, None, 0)
    failed = {c.name: c for c in amb.verify(machine, made, tolerances=False).points[0].failed}
    told = [note for note in found.notes if note.startswith("verify fails")]
    assert len(told) == len(failed) and found.missed and "not every requirement" in found.verdict
    (said,) = (note for note in told if "amplification" in note)
    separation = failed["unbalance.separation"]
    assert f"{separation.value:.4g}, not <= 1" in said and point.label in said
    assert "42.93 Hz has 3.51, allowed 2.87" in said and "far enough" not in said
