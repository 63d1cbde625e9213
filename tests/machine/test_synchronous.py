"""[[controller.synchronous]]: what a file may say, and one sentence for each thing that is
wrong.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import dumps_machine, load_machine
from ambrose.machine.part import PidSettings, Synchronous

ONE = tuple(tuple(tuple(row) for row in np.eye(4).tolist()) for _ in range(2))


def block(**changes):
    return replace(Synchronous("current-free", (500.0, 900.0), 0.5, (500.0, 900.0), ONE), **changes)


def with_blocks(*blocks):
    machine = load_machine("flywheel")
    return replace(machine, controller=replace(machine.controller, synchronous=blocks))


def test_a_block_survives_the_file(tmp_path):
    machine = with_blocks(block(), block(harmonic=2, mode="damping", leak=2.0, limit=2e-5))
    path = tmp_path / "m.toml"
    path.write_text(dumps_machine(machine))
    assert load_machine(path).controller.synchronous == machine.controller.synchronous


def test_a_vendors_phases_are_a_table():
    speeds, T = block(real=None, phase=(0.1, 0.3)).table(4)
    assert speeds.tolist() == [500.0, 900.0]
    assert T[1] == pytest.approx(np.exp(0.3j) * np.eye(4))
    _, one = Synchronous("vibration-free", (1.0, 2.0), 1.0).table(2)
    assert one[0] == pytest.approx(np.eye(2))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"speeds": (600.0, 900.0)}, "covers the band of 500 to 900"),
        ({"real": ONE[:1]}, "real is 1 x 4 x 4, but must be 2 x 4 x 4"),
        ({"real": tuple(tuple(row[:3] for row in m) for m in ONE)}, "real is 2 x 4 x 3"),
        ({"real": ((1.0, 2.0), (1.0,))}, "real is ragged"),
        ({"imaginary": ONE[:1]}, "imaginary is 1 x 4 x 4"),
        ({"speeds": (900.0, 500.0)}, "not ascending"),
        ({"phase": (0.0, 0.0)}, "phase and matrices are both given"),
        ({"real": None, "phase": (0.1,)}, "a list of 1, but must be one per speed, 2"),
        ({"real": None}, "real is missing"),
        ({"speeds": None}, "speeds are missing"),
        ({"band": (900.0, 500.0)}, "band is"),
        ({"time_constant": 0.0}, "time_constant"),
        ({"hysteresis": 300.0}, "below half of the band's width"),
        ({"mode": "damping"}, 'positive with mode "damping"'),
        ({"harmonic": 0}, "harmonic is 0"),
        ({"limit": -1e-5}, "limit"),
    ],
)
def test_what_is_wrong_with_a_block_is_one_sentence(changes, words):
    with pytest.raises(InvalidInput) as error:
        with_blocks(block(**changes))
    lines = str(error.value).splitlines()
    assert len(lines) == 1
    assert words in lines[0]
    assert "[[controller.synchronous]] 1" in lines[0]


def test_blocks_of_one_harmonic_must_not_overlap():
    with pytest.raises(InvalidInput, match="overlaps that of entry 1"):
        with_blocks(block(), block(band=(850.0, 900.0)))
    assert len(with_blocks(block(), block(harmonic=2)).controller.synchronous) == 2


def test_a_machine_may_have_blocks_and_no_reference_controller():
    machine = replace(
        load_machine("flywheel"), controller=PidSettings(sample_time=1e-4, synchronous=(block(),))
    )
    assert machine.reference is None
