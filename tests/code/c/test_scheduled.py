"""The C code of a scheduled controller against the block in Python, under the address and
undefined-behaviour sanitizers.
"""

import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest

import code_driver as driver
import example_blocks as example
from ambrose import StateSpace
from ambrose.code.block.block import build_block
from ambrose.code.block.run import (
    BEHIND,
    CLAMPED,
    FAULT,
    HELD,
    LIMITED,
    TOLD,
    run_of,
)
from ambrose.code.c.code import generate, write_code
from ambrose.code.sampled import deploy
from ambrose.core.checks import InvalidInput
from ambrose.core.scheduled import ScheduledSystem
from needs import needs
from schedule_driver import (
    CURRENT,
    DT,
    ERROR,
    GRID,
    adversarial_speeds,
    block_of,
    gain_schedule,
    pressure_schedule,
    replay,
    small_schedule,
    two_states,
)

SAMPLES = 100_000
compiler = needs("gcc or clang")


def adversarial(block, count, seed=0):
    """Errors, flags and speeds of every kind; the errors' worst case is that of a grid point."""
    frozen = build_block(deploy(block.at(block.grid[1]), DT, DT, force=True), "k", ERROR, CURRENT)
    errors, valid = driver.adversarial(frozen, count, seed)
    return errors, valid, adversarial_speeds(block, count, seed)


@compiler
@pytest.mark.parametrize(
    ("make", "rate"),
    [
        (small_schedule, None),
        (small_schedule, 5e4),
        (two_states, 5e4),
        (gain_schedule, None),
        (pressure_schedule, 5e6),
    ],
)
def test_double_agrees_with_python(make, rate, tmp_path):
    block = block_of(make(), rate_limit=rate)
    count = SAMPLES if make is small_schedule and rate else SAMPLES // 10
    e, valid, v = adversarial(block, count)
    expected = run_of(block, e, v, valid)
    found, status = replay(
        driver.compiled(block, "double", tmp_path / "c", "gcc"),
        "double",
        e,
        v,
        valid,
        outputs=len(block.outputs),
    )
    assert np.abs(found - expected.currents).max() <= 1e-12 * CURRENT
    assert (status == expected.status).all()
    # the samples did meet every branch
    for bit in (HELD, FAULT, LIMITED, CLAMPED, TOLD, *([BEHIND] if rate else [])):
        assert 0.01 < ((status & bit) > 0).mean() < 0.9


@needs("clang")
def test_clang_agrees_with_python(tmp_path):
    block = block_of(small_schedule(), rate_limit=5e4)
    e, valid, v = adversarial(block, SAMPLES // 10, seed=1)
    expected = run_of(block, e, v, valid)
    for flags in (None, ["-O3"]):
        found, status = replay(
            driver.compiled(block, "double", tmp_path / "c", "clang", flags), "double", e, v, valid
        )
        assert np.abs(found - expected.currents).max() <= 1e-12 * CURRENT
        assert (status == expected.status).all()


@compiler
def test_single_precision_stays_close(tmp_path):
    block = block_of(small_schedule()).single()
    with np.errstate(all="ignore"):
        e, valid, v = adversarial(block, SAMPLES // 5)
        e, v = e.astype(np.float32).astype(float), v.astype(np.float32).astype(float)
    expected = run_of(block, e, v, valid)
    found, status = replay(
        driver.compiled(block, "float", tmp_path / "c", "gcc"), "float", e, v, valid
    )
    # stated in docs/reference/c-code.md; limiting included
    assert np.abs(found - expected.currents).max() <= 1e-4 * CURRENT
    assert (status == expected.status).all()


@compiler
def test_a_block_as_large_as_the_machines(tmp_path):
    """24 states, four errors, four currents: integrators, oscillations, real poles, whose couplings
    move with speed.
    """
    K = example.rig_controller()
    turn = np.random.default_rng(8).normal(0, 1, (24, 24))
    turn = 0.02 * (turn - turn.T) * np.sqrt(np.outer(size := np.abs(K.A).max(axis=1), size))
    systems = [
        StateSpace(K.A + s * turn, K.B, (1 + s) * K.C, K.D, K.inputs, K.outputs)
        for s in (0.0, 0.3, 1.0)
    ]
    schedule = ScheduledSystem([100.0, 250.0, 600.0], systems)
    block = block_of(schedule)
    e, valid, v = adversarial(block, SAMPLES // 10)
    expected = run_of(block, e, v, valid)
    found, status = replay(
        driver.compiled(block, "double", tmp_path / "c", "gcc"), "double", e, v, valid, outputs=4
    )
    assert np.abs(found - expected.currents).max() <= 1e-12 * CURRENT
    assert (status == expected.status).all()


@compiler
def test_the_code_is_continuous_at_the_grid_points_and_clamps_at_the_ends(tmp_path):
    block = block_of(small_schedule())
    program = driver.compiled(block, "double", tmp_path / "c", "gcc")
    e = np.random.default_rng(2).uniform(-1, 1, (200, 2)) * 1e-2 * ERROR

    def at(speed):
        return replay(program, "double", e, np.full(200, speed))

    for speed in GRID:
        sides = [at(np.nextafter(speed, side)) for side in (0.0, 1e4)]
        for found, _ in sides:
            assert np.abs(found - at(speed)[0]).max() <= 1e-12 * np.abs(found).max()
    assert (at(np.nextafter(GRID[-1], 1e4))[1] == CLAMPED).all()
    assert (at(-700.0)[0] == at(GRID[0])[0]).all()
    assert (at(GRID[0])[1] == 0).all()
    assert (at(GRID[-1])[1] == 0).all()


@compiler
@pytest.mark.parametrize("name", driver.compilers())
@pytest.mark.parametrize(
    ("make", "arithmetic"),
    [
        (small_schedule, "double"),
        (small_schedule, "float"),
        (two_states, "float"),
        (gain_schedule, "double"),
        (pressure_schedule, "float"),
    ],
)
def test_compiles_clean_and_passes_its_own_vectors(make, arithmetic, name, tmp_path):
    write_code(tmp_path / "code", block_of(make(), rate_limit=1e5), arithmetic, ["A */ comment"])
    files = [str(tmp_path / "code" / f) for f in ("lpv.c", "lpv_test.c")]
    for flags in (driver.sanitizers(name), ["-O3"])[: 2 if make is small_schedule else 1]:
        program = tmp_path / "selftest"
        driver.build(name, [*flags, *files, "-o", str(program)])
        done = subprocess.run([str(program)], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout
        assert "116 samples, 0 wrong" in done.stdout


@needs("clang")
@pytest.mark.parametrize(
    ("make", "arithmetic"),
    [
        (small_schedule, "float"),
        (two_states, "double"),
        (gain_schedule, "double"),
        (pressure_schedule, "double"),
    ],
)
def test_every_warning_of_clang_but_two(make, arithmetic, tmp_path):
    """But padding, which no target's layout can avoid, and arrays by pointer, which C has no other
    way to hand over.
    """
    for name, text in generate(block_of(make(), rate_limit=1e5), arithmetic).items():
        (tmp_path / name).write_text(text)
    silent = [
        "-Wno-padded",
        "-Wno-unknown-warning-option",
        "-Wno-unsafe-buffer-usage",
    ]
    sources = [str(tmp_path / f"lpv{end}") for end in (".c", "_test.c")]
    driver.build("clang", ["-Weverything", *silent, "-O2", *sources, "-o", str(tmp_path / "t")])


@compiler
@pytest.mark.parametrize(
    ("pattern", "change"),
    [
        (r"(static const real increment_own\[NX\] = [^{]*\{)", r"\g<1>1e-3 + "),
        (r"(static const real core\[NG\]\[NQ\]\[NR\] =\s*\{\s*\{\s*\{)", r"\g<1>1e-3 + "),
        (r"(static const real on_current\[NR\]\[NO\] = \{\s*\{)", r"\g<1>1e-3 + "),
        (r"(static const real unwind\[NG\]\[NO\]\[NX\] =\s*\{\s*\{\s*\{)", r"\g<1>1e-3 + "),
        (r"target >= grid\[i \+ 1\]", "target > grid[i + 1] + 50"),
        (r"at->share\[1\] = far", "at->share[1] = 0.999 * far"),
        (r"(target = grid\[[1-9]\];)", r"\g<1> target *= 0.99;"),
        (r"block->speed = speed;", "block->speed = speed + 0.5;"),
        (r"real sum = x\[i\] \+ step;", "real sum = x[i] + step + 1e-6;"),
    ],
)
def test_selftest_notices(pattern, change, tmp_path):
    files = generate(block_of(small_schedule()))
    broken = re.sub(pattern, change, files["lpv.c"], count=1)
    assert broken != files["lpv.c"]
    for name, text in {**files, "lpv.c": broken}.items():
        (tmp_path / name).write_text(text)
    driver.build(
        "gcc", [str(tmp_path / "lpv.c"), str(tmp_path / "lpv_test.c"), "-o", str(tmp_path / "t")]
    )
    assert subprocess.run([str(tmp_path / "t")], capture_output=True, check=False).returncode == 1


@compiler
@pytest.mark.parametrize(
    ("make", "arithmetic"),
    [(small_schedule, "double"), (small_schedule, "float"), (two_states, "double")],
)
def test_transfer_without_a_bump(make, arithmetic, tmp_path):
    """At grid points and between them: the step after a track gives the currents that were
    tracked.
    """
    block = block_of(make())
    program = driver.compiled(block, arithmetic, tmp_path / "c", "gcc")
    m, p = len(block.inputs), len(block.outputs)
    for speed in (GRID[0], GRID[1], 175.0, 275.0, 450.0, 700.0):
        e = np.tile(np.array([1e-5, -2e-5])[:m], (4, 1))
        given = np.tile(np.array([1.0, -0.5])[:p], (4, 1))
        op = np.array([driver.STEP, driver.RESET, driver.TRACK, driver.STEP])
        found, _ = replay(program, arithmetic, e, np.full(4, speed), op=op, given=given, outputs=p)
        assert np.abs(found[-1] - given[-1]).max() <= (1e-12 if arithmetic == "double" else 1e-5)


@compiler
def test_reset_forgets_the_states_and_not_the_speed(tmp_path):
    block = block_of(small_schedule(), rate_limit=1e5)
    program = driver.compiled(block, "double", tmp_path / "c", "gcc")
    e = np.full((6, 2), 1e-5)
    v = np.array([300.0, 300.0, np.nan, np.nan, np.nan, np.nan])
    op = np.array([0, 0, driver.RESET, 0, 0, 0])
    found, status = replay(program, "double", e, v, op=op)
    fresh = run_of(block, e[:3], np.full(3, 300.0)).currents
    assert np.abs(found[3:] - fresh).max() <= 1e-15
    assert (status[3:] == HELD | TOLD).all()


def test_header_and_report_say_what_matters():
    block = block_of(small_schedule(), rate_limit=2500.0)
    files = generate(block, provenance=["Verified nowhere"])
    header, report = files["lpv.h"], files["lpv_report.md"]
    for text in (
        "Verified nowhere",
        "4 grid points from 100 to 600 rad/s (15.92 to 95.49 Hz)",
        "#define LPV_SPEED_LOWEST 100.0",
        "#define LPV_SPEED_HIGHEST 600.0",
        "#define LPV_SPEED_LIMIT 1200.0",
        "#define LPV_SPEED_RATE 2500",
        "LPV_CLAMPED 8u",
        "LPV_ERR_Y = 1 /* within +-0.001 m */",
        "LPV_U_X = 0, /* within +-2 A */",
        "set 1 sample after",
        "proved, conservative",
        "follows at 2500 rad/s^2 at most",
    ):
        assert text in header
    cost = block.cost("double")
    assert (
        f"{cost.multiplications} multiplications, {cost.additions} additions and 1 division"
        in header
    )
    assert f"| {cost.state_bytes}, {cost.table_bytes} bytes |" in report
    row = next(line for line in report.splitlines() if line.startswith("| 100 |"))
    assert 1e-9 < float(row.split("|")[-2]) < 1e-4  # what single precision does to the gain
    assert "SPEED_RATE" not in generate(block_of(small_schedule()))["lpv.h"]
    unproved = replace(block, motion=replace(block.motion, contraction=1.2))
    assert "While the speed moves no bound is proved" in generate(unproved)["lpv.h"]


def test_over_pressure_the_code_speaks_of_pressure_alone():
    files = generate(block_of(pressure_schedule(), rate_limit=4e6, told_limit=1e5))
    header = files["lpv.h"]
    for text in (
        "scheduled over pressure",
        "pressure [Pa]",
        "Pressure   the law is that of 4 grid points from 10000 to",
        "10000 to 60000 Pa (0.1 to 0.6 bar)",
        "#define LPV_PRESSURE_LOWEST 10000.0",
        "#define LPV_PRESSURE_LIMIT 100000.0",
        "#define LPV_PRESSURE_RATE 4000000 /* Pa/s",
        "double pressure, double current[LPV_OUTPUTS]",
        "follows at 4e+06 Pa/s at most",
        "LPV_PRESSURE 16u",
    ):
        assert text in header
    for name, text in files.items():
        assert not re.search(
            "speed|rad/s|Hz",
            text.replace(" Hz)", "", 1) if name == "lpv.h" else text,
            re.IGNORECASE,
        ), name
    assert files["lpv_vectors.csv"].splitlines()[0].split(",")[4] == "pressure"


@compiler
def test_the_stated_memory_is_that_of_the_compiler(tmp_path):
    for arithmetic in ("double", "float"):
        block = block_of(small_schedule())
        for name, text in generate(block, arithmetic).items():
            (tmp_path / name).write_text(text)
        (tmp_path / "size.c").write_text(
            '#include <stdio.h>\n#include "lpv.h"\nint main(void) { printf("%d", '
            "(int)sizeof(lpv_block)); return 0; }\n"
        )
        driver.build("gcc", [str(tmp_path / "size.c"), "-o", str(tmp_path / "size")])
        size = int(subprocess.run([str(tmp_path / "size")], capture_output=True, check=True).stdout)
        assert 0 <= size - block.cost(arithmetic).state_bytes < 8  # padding at the end


@pytest.mark.parametrize(
    ("arithmetic", "whose"),
    [
        ("fixed32", " of a scheduled controller"),
        ("fixed16", " of a scheduled controller"),
        ("half", ""),
    ],
)
def test_other_arithmetic_is_refused(arithmetic, whose):
    words = f"arithmetic{whose} is '{arithmetic}', but must be double or float"
    with pytest.raises(InvalidInput, match=words):
        generate(block_of(small_schedule()), arithmetic)
