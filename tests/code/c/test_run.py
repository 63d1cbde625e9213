"""Synchronous blocks beside every kind of controller in C: against the twin over a run-up with
faults, and what no fault may reach.
"""

import subprocess
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.compiled_synchronous import CompiledRun

from ambrose import StateSpace, load_machine
from ambrose.annexes.synchronous.block_code import RunUnit, generate_run, in_order, run_unit
from ambrose.code.block.block import build_block
from ambrose.code.block.cascade import build_cascade
from ambrose.code.block.fixed_point import in_words
from ambrose.code.block.run import run_of
from ambrose.code.block.scheduled import supervise
from ambrose.code.c.compiled import find_compiler
from ambrose.code.sampled import deploy
from ambrose.core.checks import InvalidInput
from ambrose.law.pid import pid_controller
from ambrose.law.supervision import Limits
from ambrose.law.synchronous_block import (
    BlockFault,
    BlockLaw,
    BlockState,
    SynchronousLaw,
    key_phasor,
)
from ambrose.machine.part import Channel, PidSettings, Section
from code_driver import sanitizers
from needs import needs
from schedule_driver import CURRENT, DT, ERROR, block_of, gain_schedule, pressure_schedule

compiled = needs("C compiler")
N = 3600
KINDS = ("fixed", "cascade", "scheduled", "supervised")
SOME = ["fixed", *(kind for kind in KINDS[1:])]
LIMIT = 0.04 * float(np.min(ERROR))


def pd():
    A, B = np.diag([0.0, 0.0, -500.0]), [[30.0, 5.0], [0.0, 40.0], [2e3, 1e3]]
    C, D = [[400.0, 20.0, 50.0], [0.0, 600.0, -30.0]], 1.5e3 * np.eye(2)
    return StateSpace(A, B, C, D, ["err_x", "err_y"], ["u_x", "u_y"])


def base_of(kind):
    fixed = build_block(deploy(pd(), DT, DT, force=True), "unit", ERROR, CURRENT)
    if kind == "gain":  # what 16 bits hold without a word about their rounding
        system = StateSpace(*(np.zeros(size) for size in ((0, 0), (0, 2), (2, 0))), pd().D)
        system = replace(system, inputs=pd().inputs, outputs=pd().outputs)
        return build_block(deploy(system, DT, DT, force=True), "unit", ERROR, CURRENT)
    if kind == "cascade":
        machine = load_machine("seal-rig")
        chain = (Section("pid", 0.2, 2e-3, 0.1), Section("low-pass", frequency=9e3, damping=0.7))
        bank = PidSettings(channels=(Channel(machine.axes, 2e3, chain),))
        sampled = deploy(pid_controller(bank, machine), DT, DT, force=True)
        return build_cascade(sampled, bank, machine, "unit", ERROR, CURRENT)
    if kind == "scheduled":
        return block_of(gain_schedule())
    if kind == "supervised":
        watch = Limits(1e4, 6e4, 2e3, rate=2e6, noise=300.0, band=4e3, dwell=0.003, fade=0.002)
        return supervise(block_of(pressure_schedule()), replace(fixed, name="lpv"), watch)
    return fixed


@cache
def unit_of(kind):
    rng = np.random.default_rng(3)
    base = base_of(kind)
    base = replace(base, current_limit=np.full(len(base.inputs), 0.8))
    n = len(base.inputs)
    size = (3, n, 2 * n)
    drive = np.eye(n, 2 * n) + 0.2 * (rng.standard_normal(size) + 1j * rng.random(size))
    drive[:, :, n:] *= 1e-5
    times = (4.0, 0.02, 0.01, 0.05)
    first = BlockLaw(
        np.array([150.0, 300.0, 420.0]), drive, (160.0, 330.0), 12.0, np.full(n, LIMIT), 1, 0.0,
        *times,
    )  # fmt: skip
    second = BlockLaw(
        np.array([150.0]), np.eye(n, dtype=complex)[None], (200.0, 420.0), 8.0, np.full(n, LIMIT),
        2, 0.5, *times, False,
    )  # fmt: skip
    law = SynchronousLaw((first, second), DT, 3000.0)
    return RunUnit(base, law, np.full(n, 0.9 * float(np.min(ERROR))))


def record(kind):
    """A run-up with lost pulses, jumps, contact, saturation, lost readings, amplitudes at their
    limit, switching off, and, for a pressure, a reading that is lost.
    """
    n = len(base_of(kind).inputs)
    t = np.arange(N) * DT
    end = N * DT
    s = t / end
    times, speeds = [0.0, 0.8 * end, end], [140.0, 400.0, 400.0]
    pulses = key_phasor(times, speeds, DT, N)
    pulses[(s > 0.55) & (s < 0.70)] = -1
    pulses[np.flatnonzero(s > 0.80)[:200:37]] = 0.0
    theta = np.cumsum(np.interp(t, times, speeds)) * DT
    size = 0.2 * float(np.min(ERROR))
    errors = size * np.column_stack(
        [np.cos(theta - j) + 0.3 * np.cos(2 * theta + j) for j in range(n)]
    )
    errors[(s > 0.42) & (s < 0.47)] *= 4.9
    errors[(s > 0.75) & (s < 0.752), 1] = np.nan
    errors[(s > 0.76) & (s < 0.762), 0] = 1.0
    valid = np.ones((N, n), bool)
    valid[(s > 0.30) & (s < 0.302), 0] = False
    told = None
    if kind in {"scheduled", "supervised"}:
        told = np.linspace(150.0, 550.0, N)
    if kind == "supervised":
        told = np.column_stack([100 * told, np.full((N, 2), np.nan)])
        told[(s > 0.90) & (s < 0.92), 0] = np.nan
    return pulses, errors, told, valid, (s > 0.34) & (s < 0.345), ~((s > 0.94) & (s < 0.96))


@cache
def twin_of(kind):
    return run_unit(unit_of(kind), *record(kind))


@compiled
@pytest.mark.parametrize("kind", SOME)
def test_the_code_is_its_twin_over_a_run_up_with_faults(kind):
    unit = unit_of(kind)
    run, code = twin_of(kind), CompiledRun(unit).run(*record(kind))
    assert np.array_equal(run.status, code.status)
    assert np.array_equal(run.faults, code.faults)
    for name in ("currents", "c", "amplitudes"):
        twin, other = getattr(run, name), getattr(code, name)
        assert np.abs(twin - other).max() <= 1e-12 * np.abs(twin).max(), name
    every = sum(BlockFault)
    assert np.bitwise_or.reduce(run.faults) == every
    assert set(run.states.ravel()) == {int(state) for state in BlockState}


@pytest.mark.parametrize("kind", ["cascade", "scheduled", "supervised"])
def test_blocks_that_are_off_leave_the_controller_bit_by_bit(kind):
    unit = unit_of(kind)
    _, errors, told, valid, contact, _ = (x[1600:] if x is not None else x for x in record(kind))
    off = run_unit(unit, np.full(N - 1600, -1.0), errors, told, valid, contact)
    assert not off.c.any()
    alone = run_of(unit.base, errors, told, valid)
    assert np.array_equal(off.currents, alone.currents)
    assert np.array_equal(off.status, alone.status)


@pytest.mark.parametrize("kind", ["fixed", "supervised"])
def test_whatever_the_pulses_do_what_is_added_is_bounded(kind):
    unit = unit_of(kind)
    _, errors, told, valid, contact, _ = (x[:1500] if x is not None else x for x in record(kind))
    wild = np.random.default_rng(0).choice([-1.0, 0.0, 0.5 * DT, np.nan, np.inf, 9.0], 1500)
    run = run_unit(unit, wild, errors, told, valid, contact)
    assert np.isfinite(run.currents).all()
    assert (np.abs(run.currents) <= unit.base.current_limit).all()
    assert (np.abs(run.c) <= 2 * LIMIT * (1 + 1e-9)).all()


def test_blocks_are_released_while_the_schedule_is_not_in_charge():
    run = twin_of("supervised")
    waiting = np.flatnonzero(run.status >> 4 & 3) + 1
    waiting = waiting[waiting < N]
    assert len(waiting) > 10
    assert not (run.states[waiting] == BlockState.ON).any()


def counts_of(kind, word):
    """The record in counts: pulses, errors (no reading: beyond the limit), the rest as it is."""
    unit, one = unit_of(kind), 1 << (word - 2)
    pulses, errors, _, *rest = record(kind)
    came = (pulses >= 0) & (pulses < DT)
    ages = np.where(came, np.floor(pulses / DT * one), -1).astype(np.int64)
    shares = np.nan_to_num(errors / unit.base.error_limit, nan=1.5)
    words = np.rint(np.clip(shares, -1.5, 1.5) * one).astype(np.int64)
    return ages, words, *rest


@cache
def fixed_of(kind, word):
    unit = unit_of(kind)
    pulses, errors, *rest = counts_of(kind, word)
    return run_unit(unit, pulses, errors, None, *rest, fixed=in_words(unit.base, word))


@compiled
@pytest.mark.parametrize(("kind", "word"), [("fixed", 32), ("gain", 16), ("cascade", 32)])
def test_fixed_point_is_its_twin_to_the_last_bit(kind, word):
    run = fixed_of(kind, word)
    pulses, errors, *rest = counts_of(kind, word)
    code = CompiledRun(unit_of(kind), f"fixed{word}").run(pulses, errors, None, *rest)
    for name in ("status", "faults", "currents", "c"):
        assert np.array_equal(getattr(run, name), getattr(code, name)), name
    assert np.bitwise_or.reduce(run.faults) == sum(BlockFault)
    assert set(run.states.ravel()) == {int(state) for state in BlockState}


@pytest.mark.parametrize(("kind", "word", "share"), [("fixed", 32, 2e-6), ("gain", 16, 3e-3)])
def test_fixed_point_stays_near_double_over_a_run_up_with_faults(kind, word, share):
    unit, fixed = unit_of(kind), fixed_of(kind, word)
    pulses, errors, *rest = counts_of(kind, word)
    one = 1 << (word - 2)
    exact = run_unit(
        unit, np.where(pulses < 0, -1, pulses * DT / one), errors / one * unit.base.error_limit,
        None, *rest,
    )  # fmt: skip
    assert np.array_equal(fixed.states, exact.states)
    assert np.array_equal(fixed.faults, exact.faults)
    off = np.abs(fixed.c / one * unit.base.error_limit - exact.c).max()
    assert off < share * np.abs(exact.c).max()


@compiled
@pytest.mark.parametrize(
    ("kind", "arithmetic"),
    [
        ("fixed", "double"),
        pytest.param("cascade", "fixed32"),
        pytest.param("gain", "fixed16"),
        pytest.param("scheduled", "float"),
        pytest.param("supervised", "double"),
    ],
)
def test_the_self_test_passes_and_can_fail(kind, arithmetic, tmp_path):
    unit = unit_of(kind)
    files = generate_run(unit, arithmetic)
    name = unit.base.name
    broken = files[f"{name}_sync.c"].replace("b->re[i] + eps", "b->re[i] - eps")
    broken = broken.replace("b->re[i] += count", "b->re[i] -= count")
    for text, status in ((files[f"{name}_sync.c"], 0), (broken, 1)):
        for file, content in {**files, f"{name}_sync.c": text}.items():
            (tmp_path / file).write_text(content)
        for flags in (("-O2",), *([] if status else [sanitizers(find_compiler())])):
            ran = built_and_run(tmp_path, unit, f"{name}_run_test.c", *flags)
            assert ran.returncode == status, (ran.stdout + ran.stderr)[-400:]


def built_and_run(folder, unit, main, *flags):
    """A program beside the unit's files in a folder."""
    name = unit.base.name
    sources = [f"{name}.c", f"{name}_sync.c", f"{name}_run.c", main]
    command = [find_compiler(), "-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror"]
    subprocess.run([*command, *flags, *sources, "-o", "t"], cwd=folder, check=True)
    return subprocess.run([folder / "t"], capture_output=True, text=True, check=False)


WILD = """
#include <stdio.h>
#include "lpv_run.h"
static uint32_t seed = 1;
static uint32_t drawn(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 17;
    seed ^= seed << 5;
    return seed;
}
static word_t any(void)
{
    const int64_t ends[] = {LEAST, -(int64_t)LEAST - 1, LPV_SYNC_ONE, -LPV_SYNC_ONE, LPV_SYNC_ONE + 1, 0, -1};
    const uint32_t which = drawn() % 9u;
    return (word_t)(which < 7u ? ends[which] : (int64_t)(drawn() % (2u * LPV_SYNC_ONE)) - LPV_SYNC_ONE);
}
int main(void)
{
    static lpv_run run;
    word_t error[M], current[M];
    unsigned char valid[M];
    unsigned seen = 0u;
    long k;
    int i, on = 0;
    lpv_run_init(&run);
    for (k = 0; k < 200000; k++) {
        /* runs of plain turns, of pulses at random and of none; readings that are kept to and any */
        const uint32_t kind = (uint32_t)(k / 5000) % 4u;
        const long turn = 205 + k / 20000;
        word_t pulse = k % turn == 0 ? LPV_SYNC_ONE / 3 : (word_t)-1;
        if (kind == 1u) pulse = any();
        if (kind == 3u && k % 5000 > 300) pulse = -1;
        for (i = 0; i < M; i++) {
            error[i] = kind == 0u ? (word_t)((k % turn < turn / 3 ? 1 : -1) * (LPV_SYNC_ONE / 4)) : any();
            valid[i] = (unsigned char)(drawn() % 64u != 0u);
        }
        lpv_run_step(&run, pulse, error, valid, kind == 2u ? drawn() % 256u : 0u, current);
        seen |= run.faults;
        on += run.sync.block[0].state == (int)LPV_SYNC_ON;
        for (i = 0; i < M; i++)
            if (current[i] > LPV_SYNC_ONE || current[i] < -LPV_SYNC_ONE) return 1;
    }
    printf("%u %d", seen, on);
    return 0;
}
"""


@compiled
@pytest.mark.parametrize(("kind", "word"), [("fixed", 32), ("gain", 16), ("cascade", 32)])
def test_no_word_makes_fixed_point_undefined_or_a_current_too_large(kind, word, tmp_path):
    """Pulses, readings and flags at random, the ends of the words among them, under sanitizers."""
    unit = unit_of(kind)
    unit = replace(unit, base=replace(unit.base, name="lpv"))
    for file, content in {**generate_run(unit, f"fixed{word}"), "wild.c": WILD}.items():
        (tmp_path / file).write_text(content)
    facts = (f"-DM={len(unit.base.inputs)}", f"-Dword_t=int{word}_t", f"-DLEAST=INT{word}_MIN")
    ran = built_and_run(tmp_path, unit, "wild.c", *sanitizers(find_compiler()), *facts)
    assert ran.returncode == 0, ran.stderr[-800:]
    seen, on = map(int, ran.stdout.split())
    assert on > 1000
    # the cascade's amplitudes do not reach their limit
    assert seen == sum(BlockFault) - BlockFault.LIMIT * (kind == "cascade")


def test_fixed_point_beside_a_schedule_and_blocks_of_another_loop_are_refused():
    unit = unit_of("fixed")
    with pytest.raises(InvalidInput, match="scheduled"):
        generate_run(unit_of("scheduled"), "fixed32")
    with pytest.raises(InvalidInput, match="sample time"):
        RunUnit(unit.base, replace(unit.law, sample_time=2 * DT))


def test_channels_follow_the_controller_s_order():
    law, base = unit_of("fixed").law, base_of("fixed")
    turned = replace(base, inputs=("err_y", "err_x"))
    drive = law.blocks[0].drive
    moved = in_order(law, ("x", "y"), turned).blocks[0].drive
    assert np.array_equal(moved, drive[:, [1, 0]][:, :, [1, 0, 2, 3]])
    assert np.array_equal(in_order(law, ("x", "y"), base).blocks[0].drive, drive)
