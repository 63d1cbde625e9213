"""Filter banks tuned: exact gradients, chains that machine files and controller files give back,
told on the command line.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.law.loop import Timing
from ambrose.law.pid import first_settings, pid_controller
from ambrose.machine.part import Channel, PidSettings, Section
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import reduce
from ambrose.synthesis import design
from ambrose.synthesis.fixed_order import tuning
from ambrose.synthesis.fixed_order.bank import at_limits, filter_bank, first_bank
from ambrose.synthesis.fixed_order.channels import aims_of, loop_model
from ambrose.synthesis.fixed_order.objective import Objective
from ambrose.synthesis.fixed_order.tuning import tune_controller

FILE = Path(__file__).parent / "flexible_compressor.toml"
MACHINE = amb.load_machine(FILE)
RUNS = Timing(5e-5, 1)
FIRST = first_settings(MACHINE)
FASTEST = 0.95 * np.pi / RUNS.sample_time
EVERY = (
    Section("phase-bump", frequency=2e3, phase=0.4, damping=0.3),
    Section("lead-lag", zero_frequency=300.0, pole_frequency=900.0),
    Section("sos", numerator=(1.0, 200.0), denominator=(1.0, 300.0)),
)


def every_kind(coordinates, alike=False):
    """The chains of structure "filters" and a section of every other kind, off any symmetry; the
    unknowns.
    """
    settings = first_bank(
        replace(FIRST, coordinates=coordinates), MACHINE, "filters", None, FASTEST
    )
    channels = tuple(
        replace(
            item, gain=item.gain * (1 if alike else 1 + 0.1 * c), sections=(*item.sections, *EVERY)
        )
        for c, item in enumerate(settings.channels)
    )
    bank, x = filter_bank(replace(settings, channels=channels), MACHINE, FASTEST)
    return bank, x + 0.1 * np.random.default_rng(0).normal(size=len(x))


def differences(function, x, direction, step=1e-5):
    """Central differences of fourth order."""
    return (
        np.array([function(x + k * step * direction) for k in (-2, -1, 1, 2)])
        @ [1, -8, 8, -1]
        / (12 * step)
    )


@pytest.mark.parametrize("alike", [False, True])
@pytest.mark.parametrize("coordinates", ["axes", "tilt-translate"])
def test_the_slope_goes_back_through_every_kind_of_section(coordinates, alike):
    bank, x = every_kind(coordinates, alike)
    theta = bank.theta(x)
    slope = np.random.default_rng(1).normal(size=theta.shape) / (np.abs(theta) + 1)
    exact = bank.gradient(x, slope)
    assert len(exact) == (2 if alike else 4) * (1 + 3 + 2 + 4 + 3 + 2) and np.abs(exact).min() > 0
    first = [k for k, item in enumerate(bank.unknowns) if {0, 3} & {*item.channels}]
    found = [
        differences(lambda v: (slope * bank.theta(v)).sum(), x, np.eye(len(x))[k]) for k in first
    ]
    assert found == pytest.approx(exact[first], abs=1e-8 * np.abs(exact).max())


def test_the_gradient_of_the_objective_is_that_of_finite_differences():
    bank, x = filter_bank(first_bank(FIRST, MACHINE, "filters", None, FASTEST), MACHINE, FASTEST)
    x = x + 1e-2 * np.random.default_rng(0).normal(size=len(x))
    models = [
        loop_model(reduce(assemble(MACHINE, point), 1), RUNS)
        for point in MACHINE.operation.points[::2]
    ]
    cost = Objective(
        bank, models, np.geomspace(1, 2e4, 30), aims_of(MACHINE, pid_controller(FIRST, MACHINE))
    )
    direction = np.random.default_rng(1).normal(size=len(x))
    for function in (lambda v: cost(v, 12.0), cost.unstable):
        gradient = function(x)[1]
        found = differences(lambda v, f=function: f(v)[0], x, direction)
        scale = np.linalg.norm(gradient) * np.linalg.norm(direction)
        assert found == pytest.approx(gradient @ direction, abs=1e-6 * scale)


@pytest.mark.parametrize("coordinates", ["axes", "tilt-translate"])
def test_axes_on_like_magnets_share_their_numbers(coordinates):
    settings = first_bank(replace(FIRST, coordinates=coordinates), MACHINE, "pid", None, FASTEST)
    bank, x = filter_bank(settings, MACHINE, FASTEST)
    found = bank.settings(x + 0.1 * np.random.default_rng(0).normal(size=len(x))).channels
    for one, other in zip(found[::2], found[1::2], strict=True):
        assert (one.gain, one.sections) == (other.gain, other.sections)
    soft, other = MACHINE.bearings[0].negative_stiffness
    stiffer = replace(MACHINE.bearings[0], negative_stiffness=(1.5 * soft, other))
    apart = filter_bank(
        settings, replace(MACHINE, bearings=(stiffer, *MACHINE.bearings[1:])), FASTEST
    )[0]
    assert {item.channels for item in bank.unknowns} == {(0, 1), (2, 3)}
    assert {item.channels for item in apart.unknowns} == (
        {(0,), (1,), (2, 3)} if coordinates == "axes" else {(c,) for c in range(4)}
    )


def test_what_is_found_is_always_a_machine():
    bank, x = every_kind("axes")
    for far in (-400.0, -1.0, 1.0, 400.0):
        found = replace(MACHINE, controller=bank.settings(np.full(len(x), far)))
        assert np.isfinite(pid_controller(found.controller, found).A).all()


def test_magnets_without_stiffness_need_a_whole_controller():
    soft = replace(
        MACHINE,
        bearings=tuple(replace(item, negative_stiffness=(0.0, 0.0)) for item in MACHINE.bearings),
    )
    assert first_bank(FIRST, soft, "pid", None, FASTEST).channels[0].gain == pytest.approx(
        FIRST.gain[0]
    )
    pair = Section("pid", 0.1, None, 0.1), Section("pid", None, 1e-3)  # as others write a PID
    chains = (Channel(MACHINE.axes, 2e4, pair),)
    bank, x = filter_bank(
        first_bank(PidSettings(channels=chains), MACHINE, "pid", None, FASTEST), MACHINE, FASTEST
    )
    assert (
        np.isfinite(bank.gradient(x, bank.theta(x))).all()
        and len(bank.settings(x).channels[0].sections) == 3
    )
    with pytest.raises(InvalidInput, match="magnets without force or stiffness"):
        first_bank(replace(FIRST, integral_time=None), soft, "pid", None, FASTEST)


def test_values_keep_within_their_limits():
    bank, x = filter_bank(first_bank(FIRST, MACHINE, "filters", None, FASTEST), MACHINE, FASTEST)
    for far in (-400.0, 400.0):
        for channel in bank.settings(np.full(len(x), far)).channels:
            assert (
                channel.sections[0].integral_time <= 1
                and 0.5 <= channel.sections[1].damping <= 1
                and channel.sections[1].frequency <= FASTEST
            )
            assert all(
                0.1 <= item.pole_damping <= 1 and item.pole_frequency <= FASTEST
                for item in channel.sections[2:]
            )
            assert all(item.zero_damping >= 0.01 for item in channel.sections[2:])
    for values in (x, x + 30.0):  # a round begins where the last one ended, at a limit too
        settings = bank.settings(values)
        again, there = filter_bank(settings, MACHINE, FASTEST)
        np.testing.assert_allclose(again.theta(there), bank.theta(values), rtol=1e-6)


def test_what_ended_at_a_limit_is_told():
    bank, x = filter_bank(first_bank(FIRST, MACHINE, "filters", None, FASTEST), MACHINE, FASTEST)
    assert not at_limits(bank.settings(x), MACHINE, FASTEST)
    for k, item in enumerate(bank.unknowns):
        if item.channels[0] < 2 and (item.section, item.key) in {
            (0, "integral_time"),
            (1, "frequency"),
            (2, "zero_damping"),
        }:
            x[k] = -30.0 if item.key == "zero_damping" else 30.0
    names = f"({', '.join(MACHINE.axes[:2])})"
    assert at_limits(bank.settings(x), MACHINE, FASTEST) == [
        f"pid integral time 1000 ms {names}",
        f"low-pass frequency 9500 Hz {names}",
        f"notch zero damping 0.01 {names}",
    ]


def test_a_notch_without_damping_leaves_its_limit():
    notch = Section(
        "notch", zero_frequency=2e3, zero_damping=0.0, pole_frequency=2e3, pole_damping=0.3
    )
    given = PidSettings(channels=(Channel(MACHINE.axes, 2e4, (Section("pid", 0.1, 1e-3), notch)),))
    found = first_bank(given, MACHINE, "pid", None, FASTEST)
    assert found.channels[0].sections[1].zero_damping == pytest.approx(0.015)
    bank, x = filter_bank(found, MACHINE, FASTEST)
    slope = bank.gradient(x, np.ones_like(bank.theta(x)))
    k = next(k for k, item in enumerate(bank.unknowns) if item.key == "zero_damping")
    assert abs(slope[k]) > 1e-6 * np.abs(slope).max()


@pytest.mark.parametrize(
    ("structure", "order", "states"),
    [
        ("pid", None, 16),
        ("pid", 16, 16),
        ("filters", None, 24),
        ("filters", 16, 16),
        ("filters", 32, 32),
    ],
)
def test_the_order_says_how_many_notches(structure, order, states):
    settings = first_bank(FIRST, MACHINE, structure, order, FASTEST)
    assert pid_controller(settings, MACHINE).n_states == states


@pytest.mark.parametrize(
    ("structure", "order"), [("pid", 12), ("pid", 24), ("filters", 20), ("filters", 8)]
)
def test_an_order_that_no_chain_has(structure, order):
    with pytest.raises(
        InvalidInput,
        match=rf"order is {order}, but must be 16.* with structure '{structure}'; leave it out",
    ):
        first_bank(FIRST, MACHINE, structure, order, FASTEST)


def test_what_stands_in_the_file_is_kept_and_tuned():
    """Notches, modes and chains of a [controller]; a start faster than the sample rate shows begins
    within it.
    """
    settings = replace(
        FIRST,
        coordinates="tilt-translate",
        tilt_gain=1.5,
        derivative_filter=1e-4,
        lead=(400.0, 2e3),
    )
    found = first_bank(settings, MACHINE, "pid", None, FASTEST)
    assert [item.names for item in found.channels] == [
        ("translate_x",),
        ("translate_y",),
        ("tilt_x",),
        ("tilt_y",),
    ]
    assert [item.kind for item in found.channels[0].sections] == ["pid", "lead-lag", "low-pass"]
    assert found.channels[2].gain == pytest.approx(1.5 * found.channels[0].gain)
    assert np.abs(np.linalg.eigvals(pid_controller(found, MACHINE).A)).max() < FASTEST


@pytest.fixture(scope="module")
def found():
    """Three steps, at standstill."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(tuning, "_POWERS", (10.0,))
        patch.setattr(tuning, "_ITERATIONS", 3)
        patch.setattr(tuning, "_JUDGED", 12)
        patch.setattr(tuning, "_TUNED", 12)
        return tune_controller(
            [assemble(MACHINE, MACHINE.operation.points[-1])],
            FIRST,
            RUNS,
            structure="pid",
            bending_modes=1,
        )


def test_the_filters_found_are_a_controller_table(found, tmp_path):
    machine = replace(MACHINE, controller=found.filters)
    again = amb.load_machine(amb.save_machine(machine, tmp_path / "tuned.toml"))
    assert again == machine
    K, same = found.controller, pid_controller(again.controller, again)
    for letter in "ABCD":
        np.testing.assert_allclose(getattr(same, letter), getattr(K, letter), rtol=1e-12, atol=0)
    assert any(
        "choose structure 'filters' or 'free', or relax a requirement" in note
        for note in found.notes
    )
    assert found.status == "verified" and found.certificate.fastest_pole < np.pi / RUNS.sample_time
    assert amb.read_controller(amb.write_controller(tmp_path / "tuned.json", found)) == found
    content = json.loads((tmp_path / "tuned.json").read_text())
    content["filters"]["channel"][0]["gain"] = "loud"
    (tmp_path / "wrong.json").write_text(json.dumps(content))
    with pytest.raises(InvalidInput, match=r"channel.*gain is \"loud\""):
        amb.read_controller(tmp_path / "wrong.json")


def test_the_command_line_tells_the_chains_and_writes_the_machine(found, monkeypatch, tmp_path):
    asked = []
    monkeypatch.setattr(
        design, "design", lambda plant, method, progress: asked.append(method) or found
    )
    words = ["synthesize", FILE, "--method", "tuned", "--structure", "pid", "--rate-hz", 20000]
    words += ["-o", tmp_path / "k.json", "--machine-file", tmp_path / "with.toml"]
    done = CliRunner().invoke(main, [str(word) for word in words])
    assert found.gamma > 1 and done.exit_code == 1, done.output  # after a few rounds
    assert "certified as stable, but not every requirement is met" in " ".join(done.output.split())
    assert "NDE_eta" in done.output and "low-pass" in done.output and "integral time" in done.output
    assert asked[0].structure == "pid"
    machine, text = amb.load_machine(tmp_path / "with.toml"), (tmp_path / "with.toml").read_text()
    # nothing of the first [controller], and numbers with units
    chains = text.partition("[controller]")[2]
    assert 'sample_time = "50 us"' in chains and re.search(
        r'^gain = ".* A/mm"', chains, re.MULTILINE
    )
    assert "derivative_filter" not in chains.partition("[[controller.channel")[0]
    assert machine.controller.sample_time == pytest.approx(
        5e-5
    ) and machine.controller.delay == pytest.approx(5e-5)
    np.testing.assert_allclose(
        pid_controller(machine.controller, machine).A, found.controller.A, rtol=1e-12
    )


def test_only_a_filter_bank_is_written_into_a_machine_file(tmp_path):
    words = [
        "synthesize",
        FILE,
        "--method",
        "tuned",
        "--machine-file",
        tmp_path / "m.toml",
        "-o",
        tmp_path / "k.json",
    ]
    done = CliRunner().invoke(main, [str(word) for word in words])
    assert (
        done.exit_code == 2
        and "must be given with a filter bank; add --method tuned --structure pid" in done.output
    )


def test_a_bank_starts_from_settings():
    with pytest.raises(
        InvalidInput,
        match=r"must be PidSettings with structure 'pid'; give the \[controller\] table",
    ):
        tune_controller([assemble(MACHINE)], pid_controller(FIRST, MACHINE), RUNS, structure="pid")


@pytest.mark.parametrize(
    ("structure", "peak"),
    [
        pytest.param("pid", 2.8),
        pytest.param("filters", 2.4, marks=pytest.mark.study),
    ],
)
def test_a_bank_meets_every_requirement(structure, peak):
    machine = MACHINE
    if structure == "pid":  # at one point, or it takes three times as long
        points = MACHINE.operation.points[-1:]
        machine = replace(MACHINE, operation=replace(MACHINE.operation, points=points))
    result = amb.design(machine, "tuned", rate=RUNS.rate, structure=structure)
    verdict = amb.verify(machine, result)
    assert verdict.passed and len(verdict.boxes) == len(machine.operation.points)
    assert max(point["sensitivity.output.max"].value for point in verdict.points) < peak
