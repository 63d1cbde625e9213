"""Synchronous blocks in whole numbers: equal to their twin to the last bit over a run-up with
faults, no sum beyond 64 bits, and what rounding does against the bounds that are stated.
"""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from benchmarks.compiled_synchronous import CompiledWords

from ambrose.annexes.synchronous.block_code import generate_words, table_found
from ambrose.code.block.synchronous_twin import ONE, SynchronousTwin, to_words
from ambrose.code.c.compiled import find_compiler
from ambrose.core.checks import InvalidInput
from ambrose.law.synchronous_block import (
    BlockFault,
    BlockLaw,
    BlockState,
    SynchronousBlock,
    SynchronousLaw,
    key_phasor,
)
from needs import needs

sys.path.append(str(Path(__file__).parent))
from test_synchronous import DT, law, record

compiled = needs("C compiler")
ERROR, CURRENT = np.full(4, 6e-4), np.full(4, 1.0)


def scaled(currents=False, per_turn=False):
    """The blocks of the other tests; currents of amperes do what readings of micrometres do."""
    wanted = law(currents, per_turn)
    first = wanted.blocks[0]
    if currents:
        drive = first.drive.copy()
        drive[:, :, 4:] *= 1e-5
        first = replace(first, drive=drive)
    return replace(wanted, blocks=(first, wanted.blocks[1]))


def counted(samples=None):
    """The record in counts: pulse, errors, currents, flags."""
    for pulse, error, current, flags in list(zip(*record(), strict=True))[:samples]:
        usable = np.abs(error) <= ERROR
        words = np.rint(np.where(usable, error, 0) / ERROR * ONE).astype(int).tolist()
        age = int(pulse / DT * ONE) if 0 <= pulse < DT else -1
        amps = np.rint(current / CURRENT * ONE).astype(int).tolist()
        yield age, words, amps, {**flags, "unusable": not usable.all()}


@compiled
@pytest.mark.parametrize(
    ("currents", "per_turn"),
    [
        (False, True),
        (True, False),
        *(pytest.param(same, same, marks=pytest.mark.study) for same in (False, True)),
    ],
)
def test_code_is_its_twin_to_the_last_bit_and_near_double(currents, per_turn):
    wanted = scaled(currents, per_turn)
    words = to_words(wanted, ERROR, CURRENT)
    twin, code, double = SynchronousTwin(words), CompiledWords(words), SynchronousBlock(wanted)
    off = largest = 0.0
    states, faults = set(), BlockFault.NONE
    for pulse, error, current, flags in counted():
        found = twin.step(pulse, error, current, **flags)
        assert found == code.step(pulse, error, current, **flags)
        exact = double.step(
            pulse * DT / ONE,
            np.array(error) * ERROR / ONE,
            np.array(current) * CURRENT / ONE,
            **flags,
        )
        assert twin.states == code.states == double.states
        assert tuple(int(run.fault) for run in twin.running) == code.faults
        off = max(off, np.abs(np.array(found) * ERROR / ONE - exact).max())
        largest = max(largest, np.abs(exact).max())
        states |= set(twin.states)
        for run in twin.running:
            faults |= run.fault
    assert [run.re + run.im for run in twin.running] == code.stored
    assert off < 1e-6 * largest
    assert largest > 2e-6
    assert states == set(BlockState)
    assert faults == BlockFault(sum(BlockFault))


def test_cosine_and_sine_are_within_the_bound_that_is_stated():
    words = to_words(scaled(), ERROR, CURRENT)
    found = table_found(words)
    assert 1e-10 < found <= words.table_error < 3e-9


@pytest.mark.parametrize("currents", [False, True])
def test_a_sample_does_what_the_formula_does_within_the_bound(currents):
    """a + eps Ts D exp(-j theta) s of Python's complex numbers, from the twin's own state."""
    words = to_words(scaled(currents), ERROR, CURRENT)
    twin = SynchronousTwin(words)
    block = words.blocks[0]
    at = block.law
    units = np.concatenate([ERROR, CURRENT]) if currents else ERROR
    stored = 2.0**-block.amplitude_bits
    worst = 0.0
    for pulse, error, current, flags in counted(4600):
        run = twin.running[0]
        before = np.array(run.re) * stored + 1j * np.array(run.im) * stored
        c = twin.step(pulse, error, current, **flags)
        if twin.states[0] is not BlockState.ON or run.fault & BlockFault.LIMIT:
            continue
        s = -(np.array(error) + np.array(c)) / ONE
        s = np.concatenate([s, np.array(current) / ONE]) if currents else s
        speed = twin.angle.now * 2.0**-31 * 2 * math.pi / DT
        drive = [
            [np.interp(speed, at.speeds, at.drive[:, i, j]) for j in range(at.drive.shape[2])]
            for i in range(4)
        ]
        D = np.array(drive) * units / ERROR[:, None]
        turn = np.exp(-2j * np.pi * twin.angle.theta / 2**32)
        gain = run.ramp / ONE * at.gain * DT
        after = np.array(run.re) * stored + 1j * np.array(run.im) * stored
        off = np.abs(after - before - gain * (D @ s) * turn).max()
        # rounding of x and y, of D, of the angle's cosine and sine, and of the stored sum
        size = np.linalg.norm(D, 2) * np.linalg.norm(s)
        smallest = np.linalg.svd(D, compute_uv=False)[-1]
        bound = gain * (words.reading_error(block) * smallest + 3 * words.table_error * size)
        bound += gain * block.relative * smallest * np.linalg.norm(s) + 4 * stored
        bound += 2.0**-29 * gain * size  # ramp eps Ts
        worst = max(worst, off / bound)
    assert 1e-3 < worst <= 1


def test_an_error_of_one_count_moves_the_amplitude():
    """No dead zone: a thousandth of a count a sample is kept below the signal's last bit."""
    one = BlockLaw(
        np.array([100.0]), np.eye(1, dtype=complex)[None], (60.0, 900.0), 0.02, np.array([5e-5]),
        ramp=0.01,
    )  # fmt: skip
    words = to_words(SynchronousLaw((one,), DT), np.array([1e-4]), np.array([1.0]))
    twin = SynchronousTwin(words)
    pulses = key_phasor([0.0, 0.6], [200.0, 200.0], DT, 6000)
    for pulse in pulses:
        age = int(pulse / DT * ONE) if 0 <= pulse < DT else -1
        c = twin.step(age, [1 if twin.angle.theta < 2**31 else -1], [0])
    assert c == [0]
    assert abs(twin.running[0].im[0]) > 2 ** (words.blocks[0].amplitude_bits - 30 - 12)


@compiled
def test_no_sum_leaves_its_word_under_the_hardest_signals():
    """Full errors and currents, pulses at random: the twin's integers have no end, the code's do."""
    words = to_words(scaled(currents=True), ERROR, CURRENT)
    twin, code = SynchronousTwin(words), CompiledWords(words)
    rng = np.random.default_rng(2)
    pulses = key_phasor([0.0, 0.4], [200.0, 300.0], DT, 3000)
    for k in range(3000):
        wild = k % 1000 > 700
        pulse = int(rng.integers(-ONE, ONE)) if wild else int(max(pulses[k], -DT) / DT * ONE)
        error = (ONE * rng.choice([-1, 1], 4)).tolist()
        current = (ONE * rng.choice([-1, 1], 4)).tolist()
        assert twin.step(pulse, error, current) == code.step(pulse, error, current)
    assert [run.re + run.im for run in twin.running] == code.stored


@compiled
@pytest.mark.parametrize("bits", [16, 32])
def test_the_c_converts_nothing_in_silence(tmp_path, bits):
    """-Wconversion of whole numbers: a word that is cut off without being asked for."""
    for name, text in generate_words(to_words(scaled(), ERROR, CURRENT), bits, "unbalance").items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror"]
    command = [find_compiler(), *flags, "-c", "unbalance.c", "-o", "unbalance.o"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_report_states_the_bounds_and_what_cannot_be_held_is_refused():
    wanted = scaled()
    files = generate_words(to_words(wanted, ERROR, CURRENT), 16, "unbalance")
    assert set(files) == {"unbalance.h", "unbalance.c", "unbalance_report.md"}
    assert "cosine and sine of an angle: 2.4e-09" in files["unbalance_report.md"]
    assert "int16_t" in files["unbalance.h"]
    with pytest.raises(InvalidInput, match="error limit"):
        to_words(wanted, np.full(4, 1e-6), CURRENT)
    slow = replace(wanted.blocks[0], band=(0.01, 300.0))
    with pytest.raises(InvalidInput, match=r"from 0\.\d+ rad/s at least"):
        to_words(replace(wanted, blocks=(slow,)), ERROR, CURRENT)
    close = replace(wanted.blocks[0], speeds=150 + 1e-9 * np.arange(5))
    with pytest.raises(InvalidInput, match="further apart"):
        to_words(replace(wanted, blocks=(close,)), ERROR, CURRENT)
