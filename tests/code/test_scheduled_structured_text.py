"""Structured text of scheduled controllers, parsed by blark and run in Python, against the
block.
"""

from __future__ import annotations

import numpy as np
import pytest

import code_driver as driver
from ambrose.code.block.block import build_block
from ambrose.code.block.run import (
    BEHIND,
    CLAMPED,
    FAULT,
    HELD,
    LIMITED,
    TOLD,
    run_of,
    vectors_of,
)
from ambrose.code.sampled import deploy
from ambrose.code.structured_text import generate_structured_text
from ambrose.core.checks import InvalidInput
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import StateSpace
from schedule_driver import (
    CURRENT,
    DT,
    ERROR,
    adversarial_speeds,
    block_of,
    gain_schedule,
    pressure_schedule,
    small_schedule,
    two_states,
)
from st_machine import FunctionBlock, lean, parsed


def play(block, e, told, valid=None):
    """Currents (k, p) and status (k,) of the function block."""
    read = lean if block.n_states else parsed  # tables of their form are those of a gain, too
    fb = FunctionBlock(read(generate_structured_text(block)["lpv.st"]))
    name = block.along.name
    currents = []
    status = []
    for k, row in enumerate(e):
        inputs = dict(zip(block.inputs, row.tolist(), strict=True)) | {name: float(told[k])}
        if valid is not None:
            inputs |= {f"valid_{x}": bool(v) for x, v in zip(block.inputs, valid[k], strict=True)}
        v = fb(**inputs)
        currents.append([v[x] for x in block.outputs])
        flags = ("held", "fault", "limited", "clamped", f"{name}_held", "behind")
        status.append(sum(bool(v[flag]) << bit for bit, flag in enumerate(flags)))
    return np.array(currents), np.array(status)


@pytest.mark.parametrize(
    ("make", "rate"),
    [
        pytest.param(small_schedule, None, marks=pytest.mark.study),
        (small_schedule, 5e4),
        pytest.param(two_states, 5e4, marks=pytest.mark.study),
        (gain_schedule, None),
        pytest.param(pressure_schedule, 5e6, marks=pytest.mark.study),
    ],
)
def test_agrees_with_the_block_in_python(make, rate):
    block = block_of(make(), rate_limit=rate)
    frozen = build_block(deploy(block.at(block.grid[1]), DT, DT, force=True), "k", ERROR, CURRENT)
    e, valid = driver.adversarial(frozen, 1000)
    told = adversarial_speeds(block, 1000)
    expected = run_of(block, e, told, valid)
    found, status = play(block, e, told, valid)
    assert np.abs(found - expected.currents).max() <= 1e-12 * CURRENT
    assert (status == expected.status).all()
    for bit in (HELD, FAULT, LIMITED, CLAMPED, TOLD, *([BEHIND] if rate else [])):
        assert (status & bit).any()


@pytest.mark.study
def test_the_vectors_without_a_value_are_those_of_an_implausible_one():
    """What is no number has no literal: the test program takes twice the limit in its place, with
    the same answers.
    """
    block = block_of(small_schedule(), rate_limit=5e4)
    run = vectors_of(block)
    assert np.isnan(run.told).sum() > 10
    told = np.nan_to_num(run.told, nan=2 * block.told_limit)
    found, status = play(block, run.errors, told, run.valid)
    assert np.abs(found - run.currents).max() <= 1e-12 * CURRENT and (status == run.status).all()
    text = generate_structured_text(block)["lpv_test.st"]
    assert (
        "nan" not in text.lower()
        and "speed := speeds[sample]" in text
        and "block.speed_held" in text
    )


@pytest.mark.parametrize(
    "make", [pytest.param(small_schedule, marks=pytest.mark.study), two_states]
)
def test_tracking_goes_on_without_a_bump(make):
    block = block_of(make())
    assert block.transfers
    fb = FunctionBlock(lean(generate_structured_text(block)["lpv.st"]))
    errors = dict.fromkeys(block.inputs, 1e-6)
    given = {f"given_{name}": 0.3 for name in block.outputs}
    for speed in (100.0, 270.0, 431.0):  # at a grid point and between
        assert all(
            fb(track=True, speed=speed, **errors, **given)[name] == 0.3 for name in block.outputs
        )
        v = fb(track=False, speed=speed, **errors)
        assert all(v[name] == pytest.approx(0.3, abs=1e-9) for name in block.outputs)


def test_a_signal_may_not_be_called_like_the_parameter():
    made = small_schedule()
    systems = [StateSpace(s.A, s.B, s.C, s.D, ["err_x", "speed"], s.outputs) for s in made.systems]
    with pytest.raises(InvalidInput, match="a signal's name is 'speed'"):
        generate_structured_text(block_of(ScheduledSystem(made.grid, systems)))


def test_single_precision_is_written_too():
    text = generate_structured_text(block_of(pressure_schedule(), rate_limit=5e6), "float")[
        "lpv.st"
    ]
    assert "pressure : REAL := 10000.0; (* Pa *)" in text and "LREAL" not in text
