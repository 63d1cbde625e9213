"""Filter banks in the machine file: every kind of section is its formula, channels are axes or
modes, errors are said.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.law.pid import chain, filter_rows, modes, pid_controller, section_matrix, theta_system
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.file.update import update_machine_file
from ambrose.machine.part import Channel, PidSettings, Section

RIG = amb.load_machine("seal-rig")
COMPRESSOR = (
    Path(__file__).parents[1] / "synthesis" / "fixed_order" / "flexible_compressor.toml"
).read_text()
OMEGA = np.geomspace(0.1, 1e5, 40)
S = 1j * OMEGA


def biquad(z, dz, p, dp):
    return (S**2 / z**2 + 2 * dz * S / z + 1) / (S**2 / p**2 + 2 * dp * S / p + 1)


SECTIONS = {
    "pid": (Section("pid", 0.2, 3e-3, 0.05), 1 + 1 / (0.2 * S) + 3e-3 * S / (0.05 * 3e-3 * S + 1)),
    "pd, eps by default": (
        Section("pid", derivative_time=3e-3),
        1 + 3e-3 * S / (0.1 * 3e-3 * S + 1),
    ),
    "notch": (
        Section(
            "notch",
            zero_frequency=900.0,
            zero_damping=0.05,
            pole_frequency=1100.0,
            pole_damping=0.4,
        ),
        biquad(900.0, 0.05, 1100.0, 0.4),
    ),
    "lead": (
        Section("lead-lag", zero_frequency=200.0, pole_frequency=3e3),
        (S / 200 + 1) / (S / 3e3 + 1),
    ),
    "lag": (
        Section("lead-lag", zero_frequency=3e3, pole_frequency=200.0),
        (S / 3e3 + 1) / (S / 200 + 1),
    ),
    "low pass": (
        Section("low-pass", frequency=2e3, damping=0.6),
        1 / (S**2 / 4e6 + 1.2 * S / 2e3 + 1),
    ),
    "biquad": (
        Section("sos", numerator=(2.0, 30.0, 5e5), denominator=(4.0, 90.0, 3e6)),
        (2 * S**2 + 30 * S + 5e5) / (4 * S**2 + 90 * S + 3e6),
    ),
    "double integrator": (
        Section("sos", numerator=(1.0, 2.0), denominator=(1.0, 0.0, 0.0)),
        (S + 2) / S**2,
    ),
    "first order": (
        Section("sos", numerator=(3.0, 4.0), denominator=(0.0, 2.0, 50.0)),
        (3 * S + 4) / (2 * S + 50),
    ),
    "gain": (Section("sos", numerator=(3.0,), denominator=(2.0,)), 1.5 + 0 * S),
}


def response(*sections, gain=1.0):
    return frequency_response(
        theta_system(chain(gain, [section_matrix(s) for s in sections]), ("A",)), OMEGA
    ).values[:, 0, 0]


@pytest.mark.parametrize("name", SECTIONS)
def test_a_section_is_its_formula(name):
    section, formula = SECTIONS[name]
    np.testing.assert_allclose(response(section), formula, rtol=1e-9)


def test_a_chain_is_the_product_of_its_sections():
    expected = 7.0 * np.prod([formula for _, formula in SECTIONS.values()], axis=0)
    np.testing.assert_allclose(
        response(*(section for section, _ in SECTIONS.values()), gain=7.0), expected, rtol=1e-7
    )


@pytest.mark.parametrize("phase", [0.6, -0.6, 0.0, 2.9])
def test_a_phase_bump_turns_its_frequency_by_its_phase(phase):
    bump = Section("phase-bump", frequency=900.0, phase=phase, damping=0.3)
    system = theta_system(chain(1.0, [section_matrix(bump)]), ("A",))
    low, middle = frequency_response(system, [1e-3, 900.0]).values[:, 0, 0]
    assert np.angle(middle) == pytest.approx(phase, abs=1e-12)
    assert low == pytest.approx(1.0, abs=1e-5)
    if phase == 0:
        np.testing.assert_allclose(response(bump), 1.0, rtol=1e-12)


CHAIN = """
[controller]
gain = "18 A/mm"
derivative_time = "3 ms"
[[controller.channel]]
names = ["DE_eta", "NDE_zeta"]
gain = "22 A/mm"
[[controller.channel.section]]
kind = "pid"
integral_time = "0.2 s"
derivative_time = "2 ms"
[[controller.channel.section]]
kind = "notch"
zero_frequency = "150 Hz"
zero_damping = 0.05
pole_frequency = "170 Hz"
pole_damping = 0.4
"""


def test_channels_in_a_machine_file_run_their_own_chain():
    machine = loads_machine(COMPRESSOR + CHAIN)
    values = frequency_response(pid_controller(machine.controller, machine), OMEGA).values
    hz = 2 * np.pi
    common = 18e3 * (1 + 3e-3 * S / (3e-4 * S + 1))
    own = (
        22e3
        * (1 + 1 / (0.2 * S) + 2e-3 * S / (2e-4 * S + 1))
        * biquad(150 * hz, 0.05, 170 * hz, 0.4)
    )
    for i, wanted in enumerate((common, own, own, common)):
        np.testing.assert_allclose(values[:, i, i], wanted, rtol=1e-9)
    assert not np.any(values[:, ~np.eye(4, dtype=bool)])
    assert loads_machine(dumps_machine(machine)) == machine
    slower = replace(
        machine.controller.channels[0],
        gain=25e3,
        sections=machine.controller.channels[0].sections[::-1],
    )
    changed = replace(machine, controller=replace(machine.controller, channels=(slower,)))
    text = update_machine_file(COMPRESSOR + CHAIN, changed)
    assert loads_machine(text) == changed and 'gain = "25 A/mm"' in text


@pytest.mark.parametrize("tilt_gain", [1.0, 1.4])
def test_modes_have_chains_of_their_own(tilt_gain):
    """With the same dynamics in all four, the bank is the [controller] with a tilt_gain; with
    others, modes do not mix.
    """
    plain = replace(RIG.controller, coordinates="tilt-translate", tilt_gain=tilt_gain)
    pid = (Section("pid", plain.integral_time, plain.derivative_time, plain.derivative_filter),)
    gain = plain.gain[0]
    channels = (
        Channel(("translate_x", "translate_y"), gain, pid),
        Channel(("tilt_x", "tilt_y"), tilt_gain * gain, pid),
    )
    one, other = (
        frequency_response(pid_controller(item, RIG), OMEGA).values
        for item in (plain, PidSettings(channels=channels, coordinates="tilt-translate"))
    )
    np.testing.assert_allclose(other, one, rtol=1e-9, atol=1e-9 * np.abs(one).max())
    low = (*pid, Section("low-pass", frequency=2e3, damping=0.7))
    mixed = PidSettings(
        channels=(channels[0], replace(channels[1], sections=low)), coordinates="tilt-translate"
    )
    into, out = modes(RIG)
    K = (
        np.linalg.inv(out)
        @ frequency_response(pid_controller(mixed, RIG), OMEGA).values
        @ np.linalg.inv(into)
    )
    assert np.abs(K[:, ~np.eye(4, dtype=bool)]).max() < 1e-9 * np.abs(K).max()
    np.testing.assert_allclose(K[:, 3, 3], tilt_gain * gain * response(*low), rtol=1e-9)


def test_the_table_tells_everyday_units():
    machine = loads_machine(COMPRESSOR + CHAIN)
    rows = filter_rows(machine.controller)
    assert rows[0] == ("DE_eta, NDE_zeta", "gain", "22 A/mm")
    assert rows[1] == ("", "pid", "integral time 200 ms, derivative time 2 ms")
    assert "zero frequency 150 Hz, zero damping 0.05" in rows[2][2]


WRONG = {
    "unknown channel": (
        '"DE_eta", ',
        '"DE_theta", ',
        r'"DE_theta", which is no channel of axes; did you mean "DE_eta"',
    ),
    "named twice": ('"DE_eta", ', '"NDE_zeta", ', '"NDE_zeta" has its chain in entry 1 already'),
    "no channel": (
        'names = ["DE_eta", "NDE_zeta"]',
        "names = []",
        "names is empty, but must be one channel at least",
    ),
    "unknown kind": ('"notch"', '"nodge"', r'kind is "nodge", but must be one of "pid", "notch"'),
    "key of another kind": (
        "zero_damping = 0.05",
        "zero_damping = 0.05\nphase = 1",
        "phase is no key of this kind",
    ),
    "key missing": (
        "pole_damping = 0.4",
        "",
        "pole_damping missing; it takes zero_frequency, zero_damping",
    ),
    "undamped poles": (
        "pole_damping = 0.4",
        "pole_damping = 0",
        "pole_damping is 0, but must be positive",
    ),
    "negative frequency": (
        '"170 Hz"',
        '"-170 Hz"',
        r"pole_frequency is -1068.14 rad/s, but must be positive",
    ),
    "pure derivative": (
        '"2 ms"',
        '"2 ms"\nderivative_filter = 0',
        "derivative_filter is 0.*cannot be realised",
    ),
    "empty pid": (
        'integral_time = "0.2 s"\nderivative_time = "2 ms"\n',
        "",
        "neither integral_time nor derivative_time",
    ),
    "no gain for the rest": (
        'gain = "18 A/mm"\n',
        "",
        r"gain .* is missing; .*, or a chain for DE_zeta",
    ),
    "gains for three axes": (
        'gain = "18 A/mm"',
        "gain = [1, 2, 3]",
        r"one value or 4, one per axis \(DE_zeta",
    ),
    "gain of a chain": ('gain = "22 A/mm"\n', "", r"\[\[controller.channel\]\].*gain is missing"),
    "negative gain": ('"22 A/mm"', "-22", "gain is -22 A/m, but must be positive"),
    "serves none": (
        '["DE_eta", "NDE_zeta"]',
        '["DE_zeta", "DE_eta", "NDE_zeta", "NDE_eta"]',
        "derivative_time serves none",
    ),
    "modes by axes": (
        "[controller]",
        '[controller]\ncoordinates = "tilt-translate"',
        "no channel of tilt-translate; known",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_said_in_a_sentence(name):
    old, new, message = WRONG[name]
    assert old in CHAIN
    with pytest.raises(InvalidInput, match=message):
        loads_machine(COMPRESSOR + CHAIN.replace(old, new, 1))


IMPROPER = {
    "improper": ((1.0, 0.0, 0.0), (1.0, 2.0), "degree is above the denominator's"),
    "no denominator": ((1.0,), (0.0, 0.0), "denominator is zero"),
    "third order": ((1.0,), (1.0, 2.0, 3.0, 4.0), "4 coefficients, but must be three at most"),
    "not finite": ((float("nan"),), (1.0,), "numerator"),
}


@pytest.mark.parametrize("name", IMPROPER)
def test_coefficients_that_are_no_filter(name):
    numerator, denominator, message = IMPROPER[name]
    channels = (
        Channel(RIG.axes, 1e4, (Section("sos", numerator=numerator, denominator=denominator),)),
    )
    with pytest.raises(InvalidInput, match=message):
        pid_controller(PidSettings(channels=channels), RIG)


def test_gains_of_axes_do_not_fit_chains_of_modes():
    channels = (Channel(("tilt_x",), 1e4, (Section("pid", derivative_time=1e-3),)),)
    settings = PidSettings(
        (1e4, 1e4, 1e4, 1e4), derivative_time=1e-3, coordinates="tilt-translate", channels=channels
    )
    with pytest.raises(InvalidInput, match="must be one value beside"):
        pid_controller(settings, RIG)
