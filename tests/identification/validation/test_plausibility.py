"""Values found against what the machine file itself allows, and which unknowns a delay joins."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.statespace import StateSpace
from ambrose.identification import pipeline
from ambrose.identification.findings import Code
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.output_error.statistics import ResidualTest
from ambrose.identification.validation.plausibility import _bursts, _tone, diagnose_result
from ambrose.identification.validation.repeatability import SimulatedOutput
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.record.record import Record


def estimate(path, factor, deviation=0.001):
    one, zero = np.eye(1), OperatingPoint(seal_pressure=2.04e5)
    values = np.array([factor]), np.array([1.0])
    return ParameterEstimate(
        "m", zero, (path,), *values, deviation**2 * one, one, one, (), (), 1.0, True, 1, (), ""
    )


# a tolerance of the pressure, and one of k itself
@pytest.mark.parametrize("name", ("seal-rig", "seal-rig-k-only"))
@pytest.mark.parametrize(("factor", "told"), [(2.46, True), (1.9, False), (0.2, False)])
def test_a_seal_beyond_its_stated_tolerance_is_told(name, factor, told):
    """6 bar told as 3 bar: k at 2.46 times the file's, without a word before."""
    found = diagnose_result(load_machine(name), estimate("seal.center.k", factor), ())
    assert [item.code for item in found] == [Code.FAR_FROM_FILE] * told
    if told:
        assert (
            "2.46 times its start, beyond its tolerance of 100 %" in found[0].evidence
            and "seal pressure" in found[0].remedy
        )


def test_a_bearing_beyond_its_stated_tolerance_is_told_once_noise_cannot_make_it():
    machine = replace(
        load_machine("seal-rig"),
        tolerances=(Tolerance("bearing.A.negative_stiffness", relative=0.1),),
    )
    path = "bearing.A.negative_stiffness.zeta"
    assert diagnose_result(machine, estimate(path, 1.12), ()) and not diagnose_result(
        machine, estimate(path, 1.12, 0.02), ()
    )
    assert not diagnose_result(machine, estimate(path, 1.09), ())


# by hand: 1/w = 63.7 us of the file's 2.5 kHz, 15.9 us of its sensors' 10 kHz; 0.62 of that
# bandwidth is 39.0 us more, sqrt(2)/39.0 us = 2 pi 5.77 kHz, 1/(39.0 + 15.9 us) = 2 pi 2.9 kHz
@pytest.mark.parametrize(
    ("factor", "deviation", "words"),
    [
        (0.62, 0.002, ["lag of the whole chain", "anti-alias", "5.77 kHz", '"2.9 kHz"']),
        (1.6, 0.002, ["lag of the whole chain", "states and the machine does not have"]),
        (0.7, 0.002, []),
        (1.45, 0.002, []),
        (0.62, 0.3, []),
    ],
)
def test_a_lag_far_from_the_file_s_names_the_filter_that_the_file_lacks(factor, deviation, words):
    """A filter of 2 kHz moved the bandwidth by 38 to 49 %, and nothing was said below a factor 2."""
    given = estimate("amplifier.bandwidth", factor, deviation)
    w = 2 * np.pi * 2500
    scaled = replace(
        given, values=w * given.values, start=w * given.start, covariance=w**2 * given.covariance
    )
    found = diagnose_result(load_machine("overhung-blower"), scaled, ())
    assert [item.code for item in found] == [Code.FAR_FROM_FILE] * bool(words)
    assert all(word in str(found[0]) for word in words)


def magnets(ki, ks, deviation=0.002, machine="three-bearing-train"):
    """K_i and K_s of every bearing and axis as multiples of the file's, in its order."""
    paths = load_machine(machine).magnet_paths
    values = np.array([*ki, *ks], float)
    one = np.eye(len(paths))
    return ParameterEstimate(
        machine, OperatingPoint(), tuple(paths), values, np.ones(len(paths)), deviation**2 * one,
        one, one, (), (), 1.0, True, 1, (), "",
    )  # fmt: skip


SCATTER = np.array([1.02, 0.98, 1.03, 0.97, 1.0, 1.0])


def test_a_stiffness_that_moves_alone_is_named_beside_what_no_record_tells_from_it():
    """A coupling that the model lacks: K_s of the train's DE bearing 27 % off, exit status 0."""
    machine = load_machine("three-bearing-train")
    found = diagnose_result(machine, magnets(SCATTER, SCATTER * [0.73, 0.72, 1, 1, 1, 1]), ())
    assert [item.code for item in found] == [Code.FAR_FROM_FILE]
    assert "bearing.DE: K_s is 0.725 times its start" in found[0].evidence
    assert "coupling, seal or other spring" in found[0].remedy

    # what the scatter of magnets makes, or noise, is none; a stated tolerance is the file's word
    assert not diagnose_result(machine, magnets(SCATTER, SCATTER[::-1]), ())
    noisy = magnets(SCATTER, SCATTER * [0.73, 0.72, 1, 1, 1, 1], 0.1)
    assert not diagnose_result(machine, noisy, ())
    wide = replace(machine, tolerances=(Tolerance("bearing.DE.negative_stiffness", relative=0.4),))
    assert not diagnose_result(wide, magnets(SCATTER, SCATTER * [0.73, 0.72, 1, 1, 1, 1]), ())


def test_a_common_factor_is_seen_through_the_scatter_of_the_magnets():
    """A rotor 7 % heavier than drawn among magnets that scatter by 3 %: exit status 0 before."""
    machine = replace(load_machine("three-bearing-train"), tolerances=())
    found = diagnose_result(machine, magnets(SCATTER / 1.07, SCATTER[::-1] / 1.07), ())
    assert [item.code for item in found] == [Code.COMMON_FACTOR]
    assert "weigh the rotor" in found[0].remedy

    # more bias moves K_s by its square, and is no mass
    more = diagnose_result(machine, magnets(1.08 * SCATTER, 1.08**2 * SCATTER[::-1]), ())
    assert Code.COMMON_FACTOR not in [item.code for item in more]
    assert not diagnose_result(machine, magnets(SCATTER / 1.02, SCATTER[::-1] / 1.02), ())


@pytest.mark.parametrize("unknown", ("delay", ("controller.delay",), ("delay", "excitation.delay")))
def test_a_delay_alone_adds_to_the_usual_unknowns(unknown, monkeypatch):
    """It replaced them: gains and stiffnesses were then taken as known, and the delay made up for
    them.
    """
    asked = []
    monkeypatch.setattr(
        pipeline,
        "identify_loop",
        lambda machine, records, law, unknown, **rest: asked.append(unknown) or 1 / 0,
    )
    machine, law = (
        load_machine("seal-rig"),
        StateSpace(np.zeros((0, 0)), np.zeros((0, 4)), np.zeros((4, 0)), np.eye(4)),
    )
    record = Record("seal-rig", 1e4, ("e_A_zeta",), ("A",), np.ones((1, 9)))
    with pytest.raises(ZeroDivisionError):
        pipeline.identify(machine, record, law, unknown=unknown)
    given = (unknown,) if isinstance(unknown, str) else unknown
    assert asked[0][-len(given) :] == given and "bearing.A.force_per_current.zeta" in asked[0]


def test_forces_that_were_recorded_are_no_excitation():
    """A record of the rig holds the magnets' forces: they turn as all else does, and an untold
    speed went unnoticed.
    """
    wave, noise = (
        np.sin(0.3 * np.arange(2000)),
        0.1 * np.random.default_rng(0).standard_normal((2, 2000)),
    )
    for name, told in (("f_magnet_A_zeta", True), ("f_center_x", False), ("e_A_zeta", False)):
        units = "A" if name == "e_A_zeta" else "N", "m"
        record = Record("m", 1e4, (name, "y_A_zeta"), units, wave + noise)
        output = SimulatedOutput(record, ("y_A_zeta",), np.zeros((1, 2000)))
        assert [item.code for item in _tone(output, 1)] == [Code.TONE] * told


@pytest.mark.parametrize(("visible", "told"), [(0.013, False), (0.03, True)])
def test_a_tone_is_told_where_it_hides_something(visible, told):
    """20 nm of hum on a quiet seal rig were 67 % of what was left, and the tests saw 1.3 % all the
    same: a false alarm.
    """
    tones = np.array([[0.0], [1.0]]) * np.sin(0.3 * np.arange(2000))
    noise = 0.1 * np.random.default_rng(0).standard_normal((2, 2000))
    record = Record("seal-rig", 1e4, ("e_A_zeta", "y_A_zeta"), ("A", "m"), noise + tones)
    output = SimulatedOutput(record, ("y_A_zeta",), np.zeros((1, 2000)))
    test = ResidualTest("y_A_zeta", "e_A_zeta", 0.0, 1.0, 0, True, visible)
    result = replace(estimate("seal.center.k", 1.0), tests=(test,))
    found = diagnose_result(load_machine("seal-rig"), result, [output])
    assert (Code.TONE in {item.code for item in found}) is told


def test_a_record_that_begins_before_the_machine_has_settled_holds_no_burst():
    """What decays from its beginning on is no knock; a knock at its beginning, or after it, is."""
    rng = np.random.default_rng(3)
    quiet = 1e-8 * rng.standard_normal(5000)
    t = np.arange(5000)
    start = 1e-6 * np.exp(-t / 80) * np.cos(t / 15)
    knock = 1e-6 * ((t >= 3000) & (t < 3004)) + 1e-6 * ((t >= 40) & (t < 44))

    def bursts(row):
        model = 1e-6 * np.sin(t)[None]
        output = SimulatedOutput(
            Record("m", 1e4, ("y_A_zeta",), ("m",), model + row), ("y_A_zeta",), model
        )
        return [finding.evidence for finding in _bursts(output, 1)]

    assert bursts(quiet) == [] and bursts(quiet + start) == []
    assert "t = 0.004 s, 0.3 s" in bursts(quiet + knock)[0]
    assert "t = 0.3 s" in bursts(quiet + start + knock)[0]
