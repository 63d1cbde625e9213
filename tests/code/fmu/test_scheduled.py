"""FMUs of scheduled controllers by FMPy, compared with the block in Python."""

from __future__ import annotations

import numpy as np
import pytest
from fmpy.validation import validate_fmu

import code_driver as driver
from ambrose.code.block.block import build_block
from ambrose.code.block.run import BEHIND, CLAMPED, FAULT, HELD, LIMITED, TOLD, run_of
from ambrose.code.fmu import generate_fmu, model_description
from ambrose.code.sampled import deploy
from ambrose.core.checks import InvalidInput
from fmu_player import Player
from needs import needs
from schedule_driver import (
    CURRENT,
    DT,
    ERROR,
    adversarial_speeds,
    block_of,
    pressure_schedule,
    small_schedule,
)

compiler = needs("gcc or clang")
VERSIONS = ("2.0", "3.0")


@compiler
@pytest.mark.parametrize(
    ("version", "make", "rate"),
    [
        (VERSIONS[0], small_schedule, 5e4),
        (VERSIONS[1], pressure_schedule, 5e6),
        pytest.param(VERSIONS[0], pressure_schedule, 5e6, marks=pytest.mark.study),
        pytest.param(VERSIONS[1], small_schedule, 5e4, marks=pytest.mark.study),
    ],
)
def test_agrees_with_the_block_in_python(version, make, rate, tmp_path):
    block = block_of(make(), rate_limit=rate)
    path = tmp_path / "x.fmu"
    path.write_bytes(generate_fmu(block, version))
    assert validate_fmu(str(path)) == []
    frozen = build_block(deploy(block.at(block.grid[1]), DT, DT, force=True), "k", ERROR, CURRENT)
    e, valid = driver.adversarial(frozen, 4000)
    told = adversarial_speeds(block, 4000)
    expected = run_of(block, e, told, valid)
    player = Player(path, tmp_path / "opened")
    player.begin()
    assert player.get([block.along.name]) == [block.range[0]]
    found, status = player.play(block, e, valid, told=told)
    assert np.abs(found - expected.currents).max() <= 1e-12 * CURRENT
    assert (status == expected.status).all()
    for bit in (HELD, FAULT, LIMITED, CLAMPED, TOLD, BEHIND):
        assert 0.01 < ((status & bit) > 0).mean() < 0.95


@pytest.mark.parametrize(
    ("make", "name", "unit"),
    [(small_schedule, "speed", "rad/s"), (pressure_schedule, "pressure", "Pa")],
)
def test_the_description_names_the_parameter_with_its_unit(make, name, unit):
    for version in VERSIONS:
        text = model_description(block_of(make()), version, "{x}", "x")
        assert (
            f'name="{name}"' in text
            and f'unit="{unit}"' in text
            and f'<Unit name="{unit}">' in text
        )


def test_fixed_point_is_refused():
    with pytest.raises(InvalidInput, match="arithmetic of a scheduled controller"):
        generate_fmu(block_of(small_schedule()), "2.0", "fixed32", sources_only=True)
