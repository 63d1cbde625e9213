"""Structured text of a controller with synchronous blocks, parsed by blark and run, against the
twin; compiled by MATIEC where installed.
"""

import subprocess
from dataclasses import replace

import numpy as np
import pytest

import st_compiled
from ambrose import StateSpace
from ambrose.annexes.synchronous.block_code import (
    FAULTS,
    RunUnit,
    generate_run_structured_text,
    run_unit,
)
from ambrose.code.block.block import build_block
from ambrose.code.sampled import deploy
from ambrose.code.targets import Mat, St
from ambrose.core.checks import InvalidInput
from ambrose.law.synchronous_block import (
    BlockFault,
    BlockLaw,
    BlockState,
    SynchronousLaw,
    key_phasor,
)
from needs import needs
from schedule_driver import DT, ERROR, block_of, gain_schedule
from st_machine import FunctionBlock, lean

N = 3600


def base_of(kind):
    if kind == "scheduled":
        return block_of(gain_schedule())
    D = [[1.5e3, 0.0], [0.0, 1.4e3]]
    A, B, C = [[-500.0]], [[2e3, 1e3]], [[50.0], [-30.0]]
    pd = StateSpace(A, B, C, D, ["err_x", "err_y"], ["u_x", "u_y"])
    return build_block(deploy(pd, DT, DT, force=True), "unit", ERROR, 0.8)


def unit_of(kind="fixed", update=False):
    """Two blocks: one reads y - c over three speeds, one y and the currents at 2x."""
    rng = np.random.default_rng(3)
    base = base_of(kind)
    base = replace(base, current_limit=np.full(2, 0.8))
    drive = np.eye(2) + 0.2 * (rng.standard_normal((3, 2, 2)) + 1j * rng.random((3, 2, 2)))
    currents = np.eye(2, 4, dtype=complex)[None] * (1 - 0.3j)
    currents[:, :, 2:] = 1e-5j
    limit, times = np.full(2, 0.04 * float(np.min(ERROR))), (4.0, 0.02, 0.01, 0.05)
    speeds = np.array([150.0, 300.0, 420.0])
    first = BlockLaw(speeds, drive, (160.0, 330.0), 12.0, limit, 1, 0.0, *times)
    second = BlockLaw(speeds[:1], currents, (200.0, 420.0), 8.0, limit, 2, 0.5, *times, False)
    law = SynchronousLaw((replace(first, per_turn=update), second), DT, 3000.0)
    return RunUnit(base, law, np.full(2, 0.9 * float(np.min(ERROR))))


def record(told=False):
    """A run-up with lost pulses, jumps, contact, saturation, lost readings, amplitudes at their
    limit, and switching off.
    """
    t = np.arange(N) * DT
    end = N * DT
    s = t / end
    times, speeds = [0.0, 0.8 * end, end], [140.0, 400.0, 400.0]
    pulses = key_phasor(times, speeds, DT, N)
    pulses[(s > 0.55) & (s < 0.70)] = -1
    pulses[np.flatnonzero(s > 0.80)[:200:37]] = 0.0
    theta = np.cumsum(np.interp(t, times, speeds)) * DT
    errors = 0.2 * float(np.min(ERROR))
    errors = errors * np.column_stack(
        [np.cos(theta - j) + 0.3 * np.cos(2 * theta + j) for j in range(2)]
    )
    errors[(s > 0.42) & (s < 0.47)] *= 4.9
    errors[(s > 0.75) & (s < 0.752), 1] = np.nan
    valid = np.ones((N, 2), bool)
    valid[(s > 0.30) & (s < 0.302), 0] = False
    contact, enabled = (s > 0.34) & (s < 0.345), ~((s > 0.94) & (s < 0.96))
    return pulses, errors, np.linspace(150.0, 550.0, N) if told else None, valid, contact, enabled


def texts(unit, precision="double"):
    files = generate_run_structured_text(unit, precision)
    name = unit.base.name
    return FunctionBlock(lean(files[f"{name}_run.st"]), {name: lean(files[f"{name}.st"])})


@pytest.mark.parametrize(
    ("kind", "update"),
    [
        ("fixed", False),
        pytest.param("fixed", True, marks=pytest.mark.study),
        pytest.param("scheduled", False, marks=pytest.mark.study),
    ],
)
def test_agrees_with_the_twin_over_a_run_up_with_faults(kind, update):
    unit = unit_of(kind, update)
    fb = texts(unit)
    pulses, errors, told, valid, contact, enabled = record(kind == "scheduled")
    expected = run_unit(unit, pulses, errors, told, valid, contact, enabled)
    names, out = unit.base.inputs, unit.base.outputs
    currents, amplitudes = np.zeros((N, 2)), np.zeros((N, 2, 2), complex)
    faults, modes, status = np.zeros(N, int), np.zeros((N, 2), int), np.zeros(N, int)
    for k in range(N):
        given = dict(zip(names, errors[k].tolist(), strict=True))
        given |= {f"valid_{x}": bool(v) for x, v in zip(names, valid[k], strict=True)}
        if told is not None:
            given[unit.base.along.name] = float(told[k])
        v = fb(pulse=pulses[k], contact=bool(contact[k]), off=not enabled[k], **given)
        currents[k] = [v[name] for name in out]
        faults[k] = sum(int(v[name]) << bit for bit, name in enumerate(FAULTS))
        status[k] = v["held"] + 2 * v["fault"] + 4 * v["limited"]
        for b in range(2):
            modes[k, b] = v["mode"][b,]
            amplitudes[k, b] = [complex(v["re"][b, i], v["im"][b, i]) for i in range(2)]
    assert np.array_equal(faults, expected.faults)
    assert np.array_equal(modes, expected.states)
    assert np.array_equal(status, expected.status & 7)
    for found, twin in ((currents, expected.currents), (amplitudes, expected.amplitudes)):
        assert np.abs(found - twin).max() <= 1e-12 * np.abs(twin).max()
    assert np.bitwise_or.reduce(faults) == sum(BlockFault)
    assert set(modes.ravel()) == {int(state) for state in BlockState}


def test_what_cannot_be_written_is_refused():
    unit = unit_of()
    with pytest.raises(InvalidInput, match="structured text has no fixed point"):
        generate_run_structured_text(unit, "fixed32")
    taken = replace(unit, base=replace(unit.base, inputs=("theta", "err_y")))
    with pytest.raises(InvalidInput, match="'theta', but must be no word"):
        generate_run_structured_text(taken)


def test_the_target_takes_blocks_where_a_mat_file_refuses_them():
    target = St(name="unit")
    target.check_beside()
    files = target.files(unit_of(), ())
    assert {"unit.st", "unit_run.st", "unit_run_test.st"} <= files.keys()
    with pytest.raises(
        InvalidInput, match="'c', 'fmu' or 'st'; a MAT-file contains the linear law"
    ):
        Mat(name="unit").check_beside()


@pytest.mark.study
@pytest.mark.parametrize("precision", ["double", "float"])
def test_the_test_program_passes_and_can_fail(precision):
    unit = unit_of()
    files, name = generate_run_structured_text(unit, precision), unit.base.name
    files = {file: text.replace("DINT_TO_REAL", "DINT_TO_LREAL") for file, text in files.items()}
    check = lean(files[f"{name}_run_test.st"])
    run, base = files[f"{name}_run.st"], lean(files[f"{name}.st"])
    for text, passes in ((run, True), (run.replace("+ eps * x[i]", "- eps * x[i]"), False)):
        others = {f"{name}_run": lean(text), name: base}
        fb = FunctionBlock(check, others)
        while not fb.v["done"]:
            fb()
        assert (fb.v["wrong"] == 0) is passes
        assert fb.v["sample"] > 2000


@needs("iec2c", "gcc")
@pytest.mark.parametrize("precision", ["double", "float"])
def test_compiled_by_matiec(precision, tmp_path):
    unit = unit_of()
    files, name = generate_run_structured_text(unit, precision), unit.base.name
    source = tmp_path / "all.st"
    source.write_text("".join(files[f"{name}{end}.st"] for end in ("", "_run", "_run_test")))
    home = st_compiled.HOME
    command = [str(home / "iec2c"), "-I", str(home / "lib"), "-T", str(tmp_path), str(source)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
