"""C code of a controller scheduled over speed and pressure: against its twin in Python, the
interpolation, and the rig.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import code_driver as driver
from ambrose.code.block.run import BEHIND, CLAMPED, FAULT, TOLD, TOLD_SECOND, run_of
from ambrose.code.block.scheduled import build_scheduled_block, neighbours
from ambrose.code.c.code import generate, write_code
from ambrose.code.c.compiled import CompiledSchedule, read_law
from ambrose.code.fmu import generate_fmus
from ambrose.code.sampled import deploy_scheduled
from ambrose.core.checks import InvalidInput
from ambrose.core.scheduled import ScheduledSystem
from ambrose.law.law import BOTH
from ambrose.rig import virtual_rig
from needs import needs
from rig.test_two_parameters import TURNING, WEIGHTLESS, ZERO, apart, product
from schedule_driver import (
    DT,
    ERROR,
    GRID,
    PRESSURES,
    adversarial_speeds,
    block_of,
    both_schedule,
    small_schedule,
)

compiler = needs("gcc or clang")


def told_of(block, count, seed=0):
    return np.stack([adversarial_speeds(block, count, seed + i, axis=i) for i in range(2)], axis=1)


def test_the_block_is_linear_in_each_parameter():
    """scipy's multilinear interpolation of the sampled matrices, clamped, knows nothing of corners
    and shares.
    """
    block = block_of(both_schedule())
    table = np.concatenate([block.C, block.D], axis=2).reshape(
        len(GRID), len(PRESSURES), len(block.outputs), -1
    )
    oracle = RegularGridInterpolator((GRID, PRESSURES), table)
    rng = np.random.default_rng(0)
    for value in rng.uniform([50.0, -1e4], [700.0, 2.5e5], (30, 2)):
        inside = np.clip(value, [GRID[0], PRESSURES[0]], [GRID[-1], PRESSURES[-1]])
        law = block.at(tuple(inside))
        np.testing.assert_allclose(np.hstack([law.C, law.D]), oracle(inside)[0], rtol=1e-12)


def test_a_parameter_that_stands_still_is_the_schedule_over_the_other():
    """At the lowest pressure the block is that of the schedule over speed alone, in its currents
    and flags.

    Nothing is limited: the anti-windup is chosen for all points together.
    """
    both, alone = block_of(both_schedule()), block_of(small_schedule())
    rng = np.random.default_rng(1)
    e, speeds = rng.uniform(-ERROR, ERROR, (3000, 2)) / 1e3, adversarial_speeds(alone, 3000)
    one = run_of(alone, e, speeds)
    two = run_of(both, e, np.stack([speeds, np.zeros(3000)], axis=1))
    np.testing.assert_allclose(two.currents, one.currents, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(two.status, one.status)


def test_neighbours_are_all_pairs_of_a_cell():
    axes = (np.arange(3.0), np.arange(2.0))
    cells = [{0, 1, 2, 3}, {2, 3, 4, 5}]
    expected = {(i, j) for cell in cells for i in cell for j in cell if i < j}
    assert set(neighbours(axes)) == expected
    assert neighbours((np.arange(4.0),)) == [(0, 1), (1, 2), (2, 3)]


def test_states_stay_within_the_bound_proved_for_any_motion():
    block = block_of(both_schedule())
    assert block.motion.proved
    rng = np.random.default_rng(5)
    told = np.stack([rng.choice(GRID, 8000), rng.choice(PRESSURES, 8000)], axis=1)
    run = run_of(block, rng.choice([-ERROR, ERROR], (8000, 2)), told)
    assert (run.largest <= block.motion.states).all()


@compiler
@pytest.mark.parametrize("rates", [None, (5e4, None), (5e4, 2e7)])
def test_the_code_is_its_twin(rates):
    """Adversarial speeds, pressures and errors; flags equal in every sample."""
    block = block_of(both_schedule(), rate_limit=rates)
    code, rng = CompiledSchedule(block), np.random.default_rng(3)
    told, e = (
        told_of(block, 3000),
        rng.uniform(-1.2, 1.2, (3000, 2)) * ERROR * np.exp2(-rng.integers(0, 9, (3000, 1))),
    )
    e[rng.random(e.shape) < 0.01] = np.nan
    meant = run_of(block, e, told)
    for k in range(len(e)):
        code.schedule(tuple(told[k]))
        found = code.step(e[k])
        assert code.status == meant.status[k], k
        np.testing.assert_allclose(
            found, meant.currents[k], rtol=0, atol=1e-12 * block.raw_limit.max()
        )
    seen = np.bitwise_or.reduce(meant.status)
    assert seen & (TOLD | TOLD_SECOND | CLAMPED | FAULT) == TOLD | TOLD_SECOND | CLAMPED | FAULT
    assert bool(seen & BEHIND) is (rates is not None)


@compiler
@pytest.mark.parametrize("name", driver.compilers())
@pytest.mark.parametrize("arithmetic", ["double", "float"])
def test_compiles_clean_and_passes_its_own_vectors(arithmetic, name, tmp_path):
    write_code(tmp_path, block_of(both_schedule(), rate_limit=(1e5, 4e7)), arithmetic)
    files = [str(tmp_path / f) for f in ("lpv.c", "lpv_test.c")]
    driver.build(name, [*driver.sanitizers(name), *files, "-o", str(tmp_path / "selftest")])
    done = subprocess.run([str(tmp_path / "selftest")], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "0 wrong" in done.stdout, done.stdout + done.stderr


@compiler
@pytest.mark.parametrize(
    ("pattern", "change"),
    [
        (r"at->share\[2\] = far", "at->share[2] = 0.999 * far"),
        (r"at->at\[1\] = low \+ 1", "at->at[1] = low"),
        (r"block->pressure = pressure;", "block->pressure = pressure + 200;"),
        (r"(target = grid_pressure\[2\];)", r"\g<1> target *= 0.99;"),
        (r"LPV_HELD \| LPV_PRESSURE", "LPV_HELD"),
    ],
)
def test_the_selftest_notices(pattern, change, tmp_path):
    files = generate(block_of(both_schedule()))
    broken = re.sub(pattern, change, files["lpv.c"], count=1)
    assert broken != files["lpv.c"]
    for file, text in {**files, "lpv.c": broken}.items():
        (tmp_path / file).write_text(text)
    program = tmp_path / "selftest"
    driver.build(
        driver.compilers()[0],
        [str(tmp_path / f) for f in ("lpv.c", "lpv_test.c")] + ["-o", str(program)],
    )
    assert subprocess.run([str(program)], capture_output=True, check=False).returncode == 1


@compiler
def test_a_transfer_continues_with_the_currents_that_act():
    block = block_of(both_schedule())
    code = CompiledSchedule(block)
    e = np.array([2e-4, -1e-4])
    u = np.array([0.7, -0.4])
    code.schedule((180.0, 1.2e5))
    code.track(e, u)
    np.testing.assert_allclose(code.step(e), u, atol=1e-9)


@compiler
def test_the_law_read_back_from_the_code_is_the_block_s():
    block = block_of(both_schedule())
    for value in ((100.0, 0.0), (275.0, 1e5), (600.0, 2e5)):
        found, meant = read_law(CompiledSchedule(block), value), block.at(value)
        np.testing.assert_allclose(found.D, meant.D, rtol=1e-9)
        np.testing.assert_allclose(
            found.C @ found.B,
            meant.C @ meant.B,
            rtol=1e-6,
            atol=1e-6 * np.abs(meant.C @ meant.B).max(),
        )


@compiler
def test_the_code_runs_on_the_rig_while_speed_and_pressure_change():
    law = product(True, True)
    deployment = deploy_scheduled(law, 1e-4, 1e-4, force=True)
    limits = [b.max_current or 10.0 for b in WEIGHTLESS.bearings for _ in range(2)]
    code = CompiledSchedule(build_scheduled_block(deployment, "rig", 5e-4, limits))
    assert code.parameter == BOTH.name
    ran, held = (
        virtual_rig.run(WEIGHTLESS, item, TURNING, point=ZERO).record for item in (code, law)
    )
    assert apart(held, ran) < 0.01
    assert code.told == pytest.approx((100.0, 2e5))
    slow = replace(law, systems=(law.systems[0],) * 4)
    assert apart(virtual_rig.run(WEIGHTLESS, slow, TURNING, point=ZERO).record, ran) > 0.02


def test_what_cannot_be_is_refused(tmp_path):
    block = block_of(both_schedule())
    with pytest.raises(InvalidInput, match=r"speed and pressure is written as C"):
        generate_fmus(block, "double", [], sources_only=True)
    with pytest.raises(
        InvalidInput, match=r"pressure_limit is 100000 Pa, but must be at least 200000 Pa"
    ):
        block_of(both_schedule(), told_limit=(None, 1e5))
    with pytest.raises(
        InvalidInput,
        match=r"shape of the measured parameters \(speed, pressure\) is \(3,\), but must be \(3, 2\)",
    ):
        run_of(block, np.zeros((3, 2)), np.zeros(3))
    axes = (np.array([100.0, 100.0 + 1e-6]), np.array(PRESSURES))
    close = ScheduledSystem(axes, both_schedule().systems[:6], BOTH.name, BOTH.unit)
    with pytest.raises(InvalidInput, match=r"apart in single precision"):
        generate(block_of(close), "float")
    assert DT == block.sample_time
