"""The C code of synchronous blocks against its twin over a whole run-up with faults, and what it
refuses.
"""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.compiled_synchronous import CompiledSynchronous

from ambrose.annexes.synchronous.block_code import (
    generate_synchronous,
)
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

DT, N = 1e-4, 20000
compiled = needs("C compiler")


def law(currents=False, per_turn=False):
    rng = np.random.default_rng(5)
    m = 8 if currents else 4
    size = (5, 4, m)
    drive = np.eye(4, m) + 0.2 * (rng.standard_normal(size) + 1j * rng.standard_normal(size))
    first = BlockLaw(
        np.linspace(150, 420, 5),
        drive,
        (160.0, 300.0),
        12.0,
        np.full(4, 8e-6),
        1,
        0.0,
        4.0,
        0.04,
        0.02,
        0.1,
    )
    second = BlockLaw(
        np.array([150.0]),
        np.eye(4, dtype=complex)[None],
        (200.0, 420.0),
        8.0,
        np.full(4, 2e-5),
        2,
        0.5,
        4.0,
        0.04,
        0.02,
        0.1,
        False,
    )
    if per_turn:
        first = replace(first, per_turn=True)
    return SynchronousLaw((first, second), DT, 2000.0)


def record():
    """Pulses, errors, currents and flags of a run-up with every fault in it."""
    t = np.arange(N) * DT
    times, speeds = [0, 1.6, 2], [100.0, 400.0, 400.0]
    pulses = key_phasor(times, speeds, DT, N)
    pulses[(t > 0.5) & (t < 0.53)] = -1
    pulses[(t > 1.0) & (t < 1.3)] = -1
    pulses[np.flatnonzero(t > 1.5)[:400:37]] = 0.0  # spurious ones
    theta = np.cumsum(np.interp(t, times, speeds)) * DT
    rng = np.random.default_rng(0)
    errors = 4e-6 * np.column_stack(
        [np.cos(theta + k) + 0.3 * np.cos(2 * theta - k) for k in range(4)]
    )
    errors += 1e-7 * rng.standard_normal((N, 4))
    errors[(t > 0.8) & (t < 0.85)] *= 100
    errors[(t > 0.9) & (t < 0.903), 2] = np.nan
    pulses[np.flatnonzero(t > 1.4)[:3]] = [np.inf, np.nan, 0.5]  # no ages of a pulse
    flags = [
        {
            "contact": bool(0.6 < x < 0.61),
            "saturated": bool(0.7 < x < 0.705),
            "enabled": not 1.75 < x < 1.8,
        }
        for x in t
    ]
    return pulses, errors, 0.1 * rng.standard_normal((N, 4)), flags


@compiled
@pytest.mark.parametrize(
    ("currents", "per_turn"),
    [
        (False, True),
        (True, False),
        *(pytest.param(same, same, marks=pytest.mark.study) for same in (False, True)),
    ],
)
def test_code_is_its_twin_to_1e12_over_a_run_up_with_faults(currents, per_turn):
    wanted = law(currents, per_turn)
    twin, code = SynchronousBlock(wanted), CompiledSynchronous(wanted)
    farthest = largest = 0.0
    states, faults = set(), BlockFault.NONE
    for pulse, error, current, flags in zip(*record(), strict=True):
        expected, given = (
            twin.step(pulse, error, current, **flags),
            code.step(pulse, error, current, **flags),
        )
        farthest, largest = (
            max(farthest, np.abs(expected - given).max()),
            max(largest, np.abs(expected).max()),
        )
        assert twin.states == code.states
        states |= set(twin.states)
        for run in twin.running:
            faults |= run.fault
    assert farthest <= 1e-12 * largest
    assert largest > 5e-6
    assert states == set(BlockState)
    every = BlockFault(0)
    for one in BlockFault:
        every |= one
    assert faults == every  # nothing of the state machine was left out
    assert np.abs(twin.amplitudes() - code.amplitudes()).max() <= 1e-12 * largest
    assert code.speed == pytest.approx(twin.speed, rel=1e-12)


@compiled
def test_single_precision_stays_near():
    twin, code = SynchronousBlock(law()), CompiledSynchronous(law(), "float")
    off = largest = 0.0
    for k, (pulse, error, current, _) in enumerate(zip(*record(), strict=True)):
        if k == 4500:
            break
        expected, given = twin.step(pulse, error, current), code.step(pulse, error, current)
        off, largest = (
            max(off, np.abs(expected - given).max()),
            max(largest, np.abs(expected).max()),
        )
    assert off < 5e-3 * largest


def test_the_files_say_what_a_step_costs_and_need_no_library(tmp_path):
    files = generate_synchronous(law(), "unbalance", provenance=["machine: flywheel */ evil"])
    assert set(files) == {"unbalance.h", "unbalance.c"}
    assert "math.h" not in files["unbalance.c"]
    assert "malloc" not in files["unbalance.c"]
    assert "*/ evil" not in files["unbalance.h"]
    assert "multiplications" in files["unbalance.h"]
    assert sorted(files) == ["unbalance.c", "unbalance.h"]


def test_a_name_that_is_none_is_refused():
    with pytest.raises(InvalidInput, match="a name in C"):
        generate_synchronous(law(), "no name")
