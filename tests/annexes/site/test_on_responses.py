"""Acceptance and retuning from frequency responses alone, of the tests' own rig."""

import json
import time
from dataclasses import replace
from functools import cache
from pathlib import Path as FilePath
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.site.acceptance import accept
from ambrose.annexes.site.pages import acceptance_page
from ambrose.annexes.site.retuning import Retuning, at_point
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace
from ambrose.judge.controller_file import write_controller
from ambrose.judge.measured import check_measured
from ambrose.judge.plants import full_plants
from ambrose.law.loop import timing_of
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint
from ambrose.record.response_files import write_response
from ambrose.report.page import render
from ambrose.synthesis.methods import as_measured
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
        assert checks["sensitivity.output.max"].passed is False  # the file limits it
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


def named(*labels):
    return SimpleNamespace(points=[SimpleNamespace(label=label) for label in labels])


def test_a_point_is_found_whether_it_was_measured_or_not():
    """The measured points come first, and only where the responses told."""
    before = named("zero, measured", "nominal", "twice")
    after = named("nominal", "zero", "twice")
    for old in before.points:
        assert at_point(after, old.label).label == old.label.removesuffix(", measured")
        assert at_point(before, at_point(after, old.label).label) is old


# what runs on each machine: factors of gain, derivative and integral time on the file's
# [controller], its low pass [Hz], and to where is swept [Hz]. No PID of the outboard-sensor-rotor
# has a sensitivity below 6: there runs what was tuned for the file's machine, its gain 1.3 times
FIVE = {
    "seal-rig": (1.0, 0.7, 1.0, None, 2000.0),
    "flywheel": (0.7, 0.3, 1.0, None, 6000.0),
    "turbomolecular-pump": (1.0, 0.3, 1.0, None, 9000.0),
    "outboard-sensor-rotor": (1.3, None, None, None, 5000.0),
    "turboexpander": (1.0, 1.0, 1.0, 2000.0, 3500.0),
}


def ran(known, gain, derivative, integral, low_pass, rate):
    """Holds the machine with K_i 10 % more and K_s 8 % less, S from 3 to 6."""
    if derivative is None:
        K = amb.design(known, "tuned", rate=rate).controller
        return StateSpace(K.A, K.B, gain * K.C, gain * K.D, K.inputs, K.outputs)
    own = known.reference
    changed = replace(
        own,
        gain=tuple(gain * value for value in own.gain),
        derivative_time=derivative * own.derivative_time,
        integral_time=integral * own.integral_time,
        low_pass=None if low_pass is None else 2 * np.pi * low_pass,
    )
    return pid_controller(changed, known)


@pytest.mark.study
@pytest.mark.parametrize("name", FIVE)
def test_a_retuning_from_responses_alone(name, tmp_path):
    """All K_i 10 % more, all K_s 8 % less, half a percent of noise on S and T: the new loop's
    sensitivities on the truth lie within their intervals on the measured plant.
    """
    *factors, top = FIVE[name]
    known = amb.load_machine(name)
    rate = 1 / known.controller.sample_time if known.controller.sample_time else RATE
    true = Truth.of(FILE.with_name(f"{name}.toml"), rate, (0.1, -0.08), modes=16)
    running = ran(known, *factors, rate)

    def peaks(law, high):
        """The true largest sensitivity of all axes together, and of every one."""
        s = true.light_poles(law)
        near = np.outer(np.abs(s), 1 + np.linspace(-0.004, 0.004, 81)).ravel() / (2 * np.pi)
        fine = np.union1d(np.geomspace(3, high, 6000), near[(near > 3) & (near < high)])
        S = true.sensitivity(law, fine)
        diagonal = np.abs(np.einsum("wii->wi", S)).max(axis=0)
        return np.array([np.linalg.norm(S, 2, axis=(1, 2)).max(), *diagonal])

    hertz = true.recommended(matrices(running, rate), 3.0, top)
    sweep = true.sweep(name, matrices(running, rate), hertz, "S+T", noise=0.005)
    began = time.process_time()
    done = amb.retune(known, sweep, running, tmp_path, changed=True)
    seconds = time.process_time() - began
    assert done.outcome == "retuned" and ", measured " in done.text, done.text
    checks = done.after.points[0]
    low, high = (checks.curve(f"sensitivity.output.{end}") for end in ("lower end", "upper end"))
    before = peaks(matrices(running, rate), 0.45 * rate)
    values = peaks(matrices(done.new.controller, rate), low.x[-1] / (2 * np.pi))
    print(
        f"{name}: {len(hertz)} lines, S {before[0]:.3f} to {values[0]:.3f}, "
        f"interval {low.y[0].max():.3f} to {high.y[0].max():.3f}, {seconds:.1f} s of processor time"
    )
    assert 3 < before[0] < 6
    assert ((low.y.max(axis=1) <= values) & (values <= high.y.max(axis=1))).all()
    assert (high.y.max(axis=1) < 1.15 * low.y.max(axis=1)).all()


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("judged by the identified model alone: lines", "on the identified model alone"),
        ("zero, measured: max at 50 Hz", "the measured plant decides"),
    ],
)
def test_the_headline_says_on_which_plant_it_rests(words, told):
    found = {"compared": "from 3 to 2", "new measured": words, "switched": "completed"}
    steps = [SimpleNamespace(name=name, words=said) for name, said in found.items()]
    said = Retuning.decided.fget(SimpleNamespace(steps=steps))
    assert said.startswith("from 3 to 2; ") and told in said and said.endswith("; completed")


def test_what_a_retuning_refuses_of_responses(tmp_path):
    whole = swept()
    slow = type(whole)(MACHINE, whole.omega, whole.paths, whole.point)
    with pytest.raises(InvalidInput, match="state sample_rate_hz"):
        amb.retune(machine(), slow, law(), tmp_path)
    with pytest.raises(InvalidInput, match="given together"):
        amb.retune(machine(), [whole, tmp_path / "record.h5"], law(), tmp_path)


def test_what_is_tuned_is_what_was_measured(tmp_path):
    """Magnets 20 and 15 % off and a casing mode of which no file knows: the design that takes the
    responses in does better on the truth, and says what the measured plant makes of it.
    """
    true = Truth.of(FILE, RATE, (0.2, -0.15), casing=(310.0, 0.02, 0.6))
    hertz = np.union1d(true.hertz(lines=200), np.linspace(285, 335, 50))
    files = [
        str(
            write_response(
                true.sweep(MACHINE, matrices(law(), RATE), hertz, noise=0.003),
                tmp_path / "sweep.json",
            )
        )
    ]
    ran = str(write_controller(tmp_path / "K.json", law(), machine()))
    fine = np.union1d(np.geomspace(4, 1600, 2000), true.hertz(packed=20))

    def reached(done):
        S = true.sensitivity(matrices(done.controller, RATE), fine)
        return np.linalg.norm(S, 2, axis=(1, 2)).max()

    without = amb.design(machine(), "tuned", rate=RATE)
    done = amb.design(machine(), "tuned", rate=RATE, measured=files, running=ran)
    assert reached(done) < 0.95 * reached(without)
    stated = done.provenance.settings
    assert stated["measured"][0][0] == "sweep.json" and stated["running"][0] == "K.json"
    assert len(stated["running"][1]) == 64
    told = done.certificate.margins["measured_sensitivity_peak"]
    assert told >= reached(done) or abs(told / reached(done) - 1) < 0.02


def test_a_running_controller_needs_what_was_measured(tmp_path):
    ran = str(write_controller(tmp_path / "K.json", law(), machine()))
    with pytest.raises(InvalidInput, match="measured"):
        amb.design(machine(), "tuned", rate=RATE, running=ran)
    with pytest.raises(InvalidInput, match=r"sweep\.json"):
        amb.design(machine(), "tuned", rate=RATE, running=ran, measured=["sweep.json"])
    closed = str(write_response(swept(), tmp_path / "closed.json"))
    with pytest.raises(InvalidInput, match="the controller that ran; give it"):
        amb.design(machine(), "tuned", rate=RATE, measured=[closed])


def test_responses_of_another_rate_are_refused_wherever_they_are_judged(tmp_path):
    """10 kHz measured, 20 kHz asked for: the plant came out with the hold of another loop."""
    ran = str(write_controller(tmp_path / "K.json", law(), machine()))
    file = str(write_response(swept(), tmp_path / "sweep.json"))
    with pytest.raises(InvalidInput, match=r"runs at 10000 Hz, and this one runs at 20000 Hz"):
        amb.design(machine(), "tuned", rate=2e4, measured=[file], running=ran)
    with pytest.raises(InvalidInput, match=r"take 10000 Hz"):
        amb.verify(machine(), law(), measured=[file], running=law(), rate=2e4)


def test_a_design_that_the_responses_do_not_tell_is_kept(monkeypatch):
    """After minutes of search it was refused, and nothing was written."""

    def untold(*words):
        raise InvalidInput("the responses do not show whether it is stable; sweep closer")

    monkeypatch.setattr("ambrose.judge.measured.check_measured", untold)
    plant, response = SimpleNamespace(point=OperatingPoint(label="cold")), swept()
    done = as_measured(amb.design(machine(), "pid"), plant, response, None, None)
    assert done.missed and done.status == "verified"
    assert done.notes[-1].startswith("cold, measured: the responses do not show")


@pytest.mark.parametrize("line", ["record check {} seal-rig", "accept seal-rig K.json {}",
                                  "verify seal-rig --measured {}"])  # fmt: skip
def test_the_table_of_frf_is_named_and_what_to_write_instead(tmp_path, monkeypatch, line):
    """Each command took it for something else that was damaged."""
    monkeypatch.chdir(tmp_path)
    write_controller("K.json", law())
    head = "point,response,input,output,frequency_hz,real,imag,magnitude,phase_deg,radius_95"
    FilePath("sweep.csv").write_text(f'{head}\n"zero",motion,e_A_zeta,y_A_zeta,3,1,1,1,0,0\n')
    done = CliRunner().invoke(main, line.format("sweep.csv").split())
    assert done.exit_code == 2 and "with --csv NAME.h5" in done.stderr


def test_a_mode_between_two_lines_is_within_the_interval():
    """Damped by 0.00035 at 245.4 Hz, lines 1.9 Hz apart: the interval ended at 6.2, 10.6 is true."""
    known = amb.load_machine("outboard-sensor-rotor")
    running, rate = amb.design(known, "pid").controller, 1 / known.controller.sample_time
    matrix, file = matrices(running, rate), FILE.with_name("outboard-sensor-rotor.toml")
    true = Truth.of(file, rate, (0.07, -0.05), modes=16)
    fine = np.linspace(244.5, 246.5, 2001)
    S = true.sensitivity(matrix, fine)
    peaks = np.abs(np.einsum("wii->wi", S)).max(axis=0)
    sigma = np.linalg.norm(S, 2, axis=(1, 2)).max()
    assert 10 < peaks.min() < peaks.max() < 12 and sigma > 20
    response = true.sweep(known.name, matrix, np.geomspace(5, 2500, 801), noise=0.005)
    plant = next(plant for plant in full_plants(known) if plant.point.speed == 0)
    judged = check_measured(plant, response, running, running, timing_of(known, running, rate))
    for axis, value in zip(plant.axes, peaks, strict=True):
        check = judged[f"sensitivity.output.{axis}"]
        assert check.value > value and "at 245" in check.detail
    assert judged["sensitivity.output.max"].value > sigma
    done = accept(known, running, response)
    loop = done.points[0]
    assert all(high > value for (_, high), value in zip(loop.peaks, peaks, strict=True))
    (spacing,) = (c for c in loop.checks.checks if c.name == "sensitivity.resolution")
    assert spacing.passed is False and "245" in spacing.detail


@pytest.mark.parametrize(("mode", "packed"), [(0.0, True), (0.0, False), (-0.01, True)])
def test_what_the_model_has_narrows_the_interval_and_what_it_has_elsewhere_does_not(mode, packed):
    """Ten lines per octave about a rigid mode: 3.8 to 28 was told where 3.8 is true. The lines are
    packed about the modes of the file, also where the rotor's are elsewhere.
    """
    known, K = machine(), ran(machine(), 1.0, 0.7, 1.0, None, RATE)
    law, filed = matrices(K, RATE), Truth.of(FILE, RATE, modes=16)
    true = Truth.of(FILE, RATE, (0.03, -0.03), mode=mode, modes=16)
    hertz = filed.recommended(law, 3.0, 2000.0) if packed else np.geomspace(3, 2000, 120)
    plant = next(p for p in full_plants(known) if not p.point.speed and not p.point.seal_pressure)
    response = true.sweep(MACHINE, law, hertz, noise=0.005)
    checks = check_measured(plant, response, K, K, timing_of(known, K, RATE))
    ends = (checks.curve(f"sensitivity.output.{end}") for end in ("lower end", "upper end"))
    low, high = (end.y.max(axis=1) for end in ends)
    near = np.outer(np.abs(true.light_poles(law)), 1 + np.linspace(-0.01, 0.01, 201)).ravel()
    fine = np.union1d(np.geomspace(3, 2000, 4000), near[near < 4000 * np.pi] / (2 * np.pi))
    S = true.sensitivity(law, fine[fine >= 3])
    values = [np.linalg.norm(S, 2, axis=(1, 2)).max(), *np.abs(np.einsum("wii->wi", S)).max(axis=0)]
    assert (low <= values).all() and (values <= high).all()
    assert (high < 1.06 * low).all() == (packed and not mode)


def test_a_sweep_past_the_bending_modes_is_named_before_it_is_used():
    known, law = machine(), matrices(ran(machine(), 1.0, 0.7, 1.0, None, RATE), RATE)
    true = Truth.of(FILE, RATE)
    good = true.sweep(MACHINE, law, true.recommended(law, 3.0, 2000.0))
    wide = true.sweep(MACHINE, law, np.geomspace(3, 2000, 100))
    assert not amb.check_record(good, known).findings
    (finding,) = amb.check_record(wide, known).findings
    assert "551 Hz" in str(finding) and "1340 Hz" in str(finding)
