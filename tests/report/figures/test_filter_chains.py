"""A filter bank as a picture: every section in its channel's chain, and what the chain does."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.frequency import frequency_response
from ambrose.judge.result import Synthesis
from ambrose.law.pid import pid_controller
from ambrose.machine.part import MODES, Channel, PidSettings, Section
from ambrose.report.figures.bode import filter_figure

HZ = 2 * np.pi
EVERY = (
    Section("pid", 0.2, 2e-3, 0.1),
    Section(
        "notch",
        zero_frequency=HZ * 210,
        zero_damping=0.02,
        pole_frequency=HZ * 230,
        pole_damping=0.3,
    ),
    Section("phase-bump", frequency=HZ * 95, phase=0.5, damping=0.3),
    Section("lead-lag", zero_frequency=HZ * 200, pole_frequency=HZ * 1000),
    Section("low-pass", frequency=HZ * 1500, damping=0.7),
    Section("sos", numerator=(1.0, 100.0, 1e6), denominator=(1.0, 1000.0, 1e6)),
    Section("sos", numerator=(2.0,), denominator=(1.0,)),
)


def words(picture):
    return [item.text for item in picture.layout.annotations if item.xref == "paper"]


def test_every_section_stands_in_its_chain():
    bank = PidSettings(
        channels=(Channel(MODES[:2], 20e3, EVERY), Channel(MODES[2:], 15e3, EVERY[:1])),
        coordinates="tilt-translate",
    )
    picture = filter_figure(bank, ("A_zeta", "A_eta", "B_zeta", "B_eta"))
    found = [text for text in words(picture) if text != "→"]
    assert found[:3] == [
        "<b>translate x, translate y</b>",
        "<b>gain</b><br>20\u00a0A/mm",
        ("<b>pid</b><br>T<sub>i</sub> 200\u00a0ms<br>T<sub>d</sub> 2\u00a0ms<br>× 796\u00a0Hz"),
    ]
    assert found[3:9] == [
        "<b>notch</b><br>○ 210\u00a0Hz, 0.02<br>× 230\u00a0Hz, 0.3",
        "<b>phase-bump</b><br>28.6°<br>at 95\u00a0Hz, 0.3",
        "<b>lead-lag</b><br>○ 200\u00a0Hz<br>× 1\u202f000\u00a0Hz",
        "<b>low-pass</b><br>× 1\u202f500\u00a0Hz, 0.7",
        "<b>sos</b><br>○ 159\u00a0Hz, 0.05<br>× 159\u00a0Hz, 0.5",
        "<b>sos</b><br>times 2",
    ]
    assert found[9] == "<b>tilt x, tilt y</b>"
    boxes = picture.layout.shapes
    assert len(boxes) == len(EVERY) + 1 + 2
    # above the axes, and apart:
    assert all(0 <= box.x0 < box.x1 <= 1 + 1e-12 and box.y1 > 1 for box in boxes)
    assert not any(
        a.x0 < b.x1 and b.x0 < a.x1 and a.y1 < b.y0 and b.y1 < a.y0
        for i, a in enumerate(boxes)
        for b in boxes[:i]
    )
    top = (boxes[0].y0 - 1) * (
        picture.layout.height - picture.layout.margin.t - picture.layout.margin.b
    )
    assert top < picture.layout.margin.t


def test_the_response_is_the_controllers():
    """Equal channels are one line; its gain is that of the controller that runs."""
    machine = amb.load_machine("seal-rig")
    bank = PidSettings(channels=(Channel(machine.axes, 20e3, EVERY),))
    system = pid_controller(bank, machine)
    picture = amb.plot(Synthesis(system, "tuned", filters=bank))
    magnitude = picture.data[0]
    assert magnitude.name == "A ζ, A η, B ζ, B η"
    exact = np.abs(frequency_response(system, HZ * np.array(magnitude.x)).values[:, 2, 2]) / 1e3
    assert np.array(magnitude.y) == pytest.approx(exact, rel=1e-5)
    assert picture.layout.title.text.startswith("Controller (tuned)")


def test_what_is_no_bank_is_drawn_as_before():
    system = pid_controller(amb.load_machine("seal-rig").controller, amb.load_machine("seal-rig"))
    assert not amb.plot(Synthesis(system, "hinf")).layout.shapes
    assert amb.plot(
        replace(Synthesis(system, "pid"), filters=amb.load_machine("seal-rig").controller)
    ).layout.shapes
