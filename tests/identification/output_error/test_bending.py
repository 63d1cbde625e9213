"""Frequency and damping of bending modes among the unknowns of a closed-loop identification."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import waveforms

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.findings import Code
from ambrose.identification.output_error import closed_loop as whole_loop
from ambrose.identification.output_error.problem import FitOptions, build_experiment
from ambrose.identification.parameters import (
    COVERAGE,
    expand,
    nominal_values,
    plant_at,
    update_machine,
)
from ambrose.identification.validation.suspects import suspects
from ambrose.law.loop import closed_loop, match_controller
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.part import BendingMode
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import finite_element_rotor, free_modes
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record
from whole_records import simulate_derivative

DT = 1e-4
NINE = (
    "bearing.*.force_per_current.*",
    "bearing.*.negative_stiffness.*",
    "amplifier.natural_frequency",
)
MODE = ("rotor.bending_1.frequency", "rotor.bending_1.damping")


@cache
def machine():
    given = amb.load_machine("seal-rig")
    return replace(
        given, shaft=tuple(replace(part, elements=1) for part in given.shaft), tolerances=()
    )


@cache
def law():
    return pid_controller(machine().controller, machine())


def stiffer(factor, damping=0.005):
    """The machine with another modulus, by which all bending frequencies are ``factor`` times as
    high.
    """
    shaft = tuple(
        replace(
            s, material=replace(s.material, youngs_modulus=factor**2 * s.material.youngs_modulus)
        )
        for s in machine().shaft
    )
    return replace(machine(), shaft=shaft, modal_damping=damping)


@cache
def record(factor=1.0, damping=0.005, speed=0.0, k=8000, noise=1e-8, seed=0, modes=3):
    point = OperatingPoint(speed=speed)
    plant = free_mode_reduction(assemble(stiffer(factor, damping), point), modes)
    e = np.stack([0.1 * waveforms.prbs(9, 10, k, shift=127 * i) for i in range(4)])
    names = [f"{kind}_{axis}" for kind in "ey" for axis in plant.axes]
    loop = closed_loop(plant, c2d(match_controller(law(), plant), DT, "tustin", delay=DT))
    y = simulate(select(loop, names[:4], names[4:]), e)
    y = y + noise * np.random.default_rng(seed).standard_normal(y.shape)
    return Record(
        "seal-rig", 1 / DT, tuple(names), ("A",) * 4 + ("m",) * 4, np.vstack([e, y]), point
    )


def first_mode():
    return float(free_modes(finite_element_rotor(machine()), 1).frequencies[-1])


@pytest.mark.parametrize(
    "unknown",
    [MODE, MODE[:1], MODE[1:], ("bending", "bending_2", "bearing.A.force_per_current.eta")],
)
def test_the_model_is_the_loop_of_that_machine_and_its_derivative_exact(unknown):
    """Against a machine file with other modes, simulated anew, and against a difference of the
    loop's own matrices.
    """
    experiment = build_experiment(machine(), record(), law(), unknown, FitOptions(signals=None))
    theta = experiment.nominal * (
        1.03 if len(unknown) < 3 else np.array([1.02, 1.5, 0.99, 0.7, 1.1])
    )
    model = experiment.models[0]
    loop, directions = model.loop(theta)
    values = dict(zip(experiment.paths, theta.tolist(), strict=True))
    plant = plant_at(machine(), record().point, values)
    names = [f"e_{axis}" for axis in plant.axes], [f"y_{axis}" for axis in plant.axes]
    e = np.stack([0.1 * waveforms.prbs(9, 10, 600, shift=127 * i) for i in range(4)])
    expected = simulate(
        select(
            closed_loop(plant, c2d(match_controller(law(), plant), DT, "tustin", delay=DT)), *names
        ),
        e,
    )
    y, J = simulate_derivative(loop, directions, e)
    np.testing.assert_allclose(y, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
    for j, value in enumerate(theta):
        h = 1e-5 * value
        step = h * (np.arange(len(theta)) == j)
        difference = (
            simulate(model.loop(theta + step)[0], e) - simulate(model.loop(theta - step)[0], e)
        ) / (2 * h)
        np.testing.assert_allclose(J[j], difference, rtol=0, atol=2e-5 * np.abs(difference).max())


def test_another_bending_frequency_is_found_and_the_rest_within_its_intervals():
    """With what the second mode, 2 % off as well and taken as known, makes of them in the
    intervals.
    """
    held, truth = [], nominal_values(assemble(machine(), record().point), expand(machine(), NINE))
    for seed in range(4):
        found = amb.identify(
            machine(), record(1.02, 0.008, noise=1e-7, seed=seed), law(), unknown=[*NINE, "bending"]
        ).result
        assert found.converged and found.paths[-2:] == MODE
        mode, sd = found.values[-2:], found.standard_deviations[-2:]
        assert np.all(np.abs(mode - [1.02 * first_mode(), 0.008]) < 4 * sd)
        assert sd[0] < 1e-3 * mode[0] and sd[1] < 0.2 * mode[1]
        held += list(np.abs(found.values[:9] - truth) < COVERAGE * found.standard_deviations[:9])
    assert np.mean(held) > 0.85


def test_the_file_gets_them_and_every_step_uses_them():
    done = amb.identify(machine(), record(0.97, 0.01), law(), unknown=[*NINE, "bending"])
    assert done.passed, done.findings
    made = loads_machine(dumps_machine(done.machine))
    (mode,) = made.bending_modes
    assert mode.number == 1 and mode.frequency == pytest.approx(0.97 * first_mode(), rel=1e-3)
    assert free_modes(finite_element_rotor(made), 1).frequencies[-1] == pytest.approx(
        mode.frequency, rel=1e-9
    )
    assert {item.parameter for item in made.tolerances} >= set(MODE)
    # what the file calls uncertain is asked for
    again = amb.identify(made, record(0.97, 0.01, seed=5), law())
    assert set(MODE) <= set(again.result.paths)
    assert np.all(np.abs(again.result.values / again.result.start - 1)[-2:] < [1e-3, 0.1])
    assert "rotor.bending_1.frequency" in done.comment


@pytest.mark.parametrize(
    ("factor", "cause"),
    [(1.002, "rotor.bending_1.frequency +"), (1.02, "rotor.bending_1.damping +")],
)
def test_a_wrong_bending_mode_that_was_not_asked_for_is_named(factor, cause):
    """Far off, its peak must go before another one can grow: the first step is to damp it."""
    done = amb.identify(machine(), record(factor), law(), unknown=NINE)
    assert f"likeliest first: {cause}" in done.verdict
    truth = nominal_values(assemble(machine(), record().point), done.result.paths)
    np.testing.assert_allclose(done.result.values, truth, rtol=1e-3)


def test_a_mode_that_drowns_in_noise_is_said_to():
    done = amb.identify(
        machine(), record(1.02, noise=3e-7), law(), unknown=[*NINE, "bending", "bending_2"]
    )
    hidden = [
        item
        for item in done.findings
        if item.code == Code.HARDLY_VISIBLE and "rotor.bending_2" in item.what
    ]
    assert hidden and "a peak of the noise" in hidden[0].remedy and not done.passed


def test_by_the_youla_residual_too():
    plant = free_mode_reduction(assemble(stiffer(1.01), record().point), 3)
    loop = closed_loop(plant, c2d(match_controller(law(), plant), DT, "tustin", delay=DT))
    data = record(1.01, noise=0.0)
    e = data.values[:4]
    shown = [f"{kind}_{axis}" for kind in "yu" for axis in plant.axes]
    values = simulate(select(loop, data.signals[:4], shown), e)
    full = replace(
        data,
        signals=(*data.signals[:4], *shown),
        units=("A",) * 4 + ("m",) * 4 + ("A",) * 4,
        values=np.vstack([e, values]),
    )
    done = amb.identify(machine(), full, law(), method="youla", unknown=["bending"])
    assert len(done.result.paths) == 11  # beside what is usual
    np.testing.assert_allclose(done.result.values[-2:], [1.01 * first_mode(), 0.005], rtol=1e-3)


@pytest.mark.parametrize(
    ("unknown", "words"),
    [
        (["bending_4"], "not in a model of 3 bending modes; take 4 bending modes"),
        (["bending_999"], "names no bending mode of this mesh"),
        (["bending", "rotor.bending_1.damping"], "are the same number"),
        (["bendings"], "bendings"),
    ],
)
def test_what_is_refused(unknown, words):
    with pytest.raises(InvalidInput, match=words):
        whole_loop.identify(machine(), record(), law(), unknown)


def test_a_result_changes_its_mode_alone():
    given = replace(
        machine(), bending_modes=(BendingMode(1, first_mode(), 0.004), BendingMode(2, None, 0.01))
    )
    found = whole_loop.identify(given, record(1.01), law(), [MODE[0]])
    made = update_machine(given, found)
    assert made.bending_modes[0] == BendingMode(1, float(found.values[0]), 0.004)
    assert made.bending_modes[1] == given.bending_modes[1]
    assert made.tolerances == (Tolerance(MODE[0], relative=made.tolerances[0].relative),)


def test_modes_beyond_the_model_are_named_and_their_effect_is_in_the_intervals():
    data = record(noise=1e-7, modes=8)
    truth = nominal_values(assemble(machine(), data.point), expand(machine(), NINE))
    bare = whole_loop.identify(machine(), data, law(), NINE, bending_modes=1)
    assert np.mean(np.abs(bare.values - truth) < COVERAGE * bare.standard_deviations) < 0.7
    done = amb.identify(machine(), data, law(), unknown=NINE, bending_modes=1)
    assert "4 bending modes instead of 1" in done.verdict
    assert np.all(np.abs(done.result.values - truth) < COVERAGE * done.result.standard_deviations)
    (cut,) = [
        item
        for item in suspects(machine(), [data], law(), bare, FitOptions(bending_modes=1))
        if "modes" in item.path
    ]
    more = whole_loop.identify(machine(), data, law(), NINE, bending_modes=4)
    np.testing.assert_allclose(
        bare.values + cut.shift, more.values, rtol=0, atol=0.2 * np.abs(cut.shift).max()
    )
    enough = amb.identify(machine(), data, law(), unknown=NINE)
    assert "instead of" not in enough.verdict
