"""An FMU with synchronous blocks beside its controller: told the rotor's angle once a sample, it
does what the twin does with the key phasor's pulses.
"""

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from ambrose import StateSpace
from ambrose.annexes.synchronous.block_code import RunUnit, run_unit
from ambrose.code.block.block import build_block
from ambrose.code.fmu import FAULTS, generate_fmu
from ambrose.code.interface import AllAxes
from ambrose.code.sampled import deploy
from ambrose.law.synchronous_block import BlockLaw, SynchronousLaw
from fmu_player import Player
from needs import needs

pytestmark = [
    needs("gcc or clang"),
]
COUNT, DT = 6000, 1e-4


def unit(delay=1):
    A, B = np.diag([0.0, 0.0, -500.0]), [[30.0, 5.0], [0.0, 40.0], [2e3, 1e3]]
    C, D = [[400.0, 20.0, 50.0], [0.0, 600.0, -30.0]], 1.5e3 * np.eye(2)
    pd = StateSpace(A, B, C, D, ["err_x", "err_y"], ["u_x", "u_y"])
    base = build_block(deploy(pd, DT, delay * DT, force=True), "unit", 1e-3, 2.0)
    n = len(base.inputs)
    law = BlockLaw(
        np.array([150.0, 400.0]),
        np.stack([np.eye(n, 2 * n), (1 + 0.4j) * np.eye(n, 2 * n)]),
        (160.0, 390.0),
        10.0,
        0.1 * base.error_limit,
        1,
        0.0,
        4.0,
        0.02,
        0.01,
        0.05,
    )
    return RunUnit(base, SynchronousLaw((law,), base.sample_time, 3000.0))


def run_up(base):
    """Angles of a run-up through the band, errors that turn with it, contact and blocks off for a
    while; the pulses as a key phasor gives them.
    """
    dt = base.sample_time
    t = dt * np.arange(COUNT)
    angle = 140 * t + 0.5 * 260 * t**2 / t[-1]
    whole = np.floor(angle / (2 * np.pi))
    gone, before = np.diff(angle, prepend=0.0), np.concatenate([[0.0], whole[:-1]])
    pulses = np.full(COUNT, -1.0)
    passed = whole > before
    pulses[passed] = dt * ((angle - 2 * np.pi * whole) / np.where(gone > 0, gone, 1))[passed]
    shape = np.arange(len(base.inputs))
    errors = 0.2 * base.error_limit * np.cos(angle[:, None] - shape)
    s = t / t[-1]
    return angle, pulses, errors, (s > 0.5) & (s < 0.52), (s > 0.7) & (s < 0.75)


@pytest.mark.parametrize(
    ("version", "arithmetic", "apart"),
    [
        pytest.param("2.0", "double", 1e-9, marks=pytest.mark.study),
        ("3.0", "double", 1e-9),
        ("2.0", "fixed32", 1e-6),
    ],
)
def test_it_is_the_twin_over_a_run_up(version, arithmetic, apart, tmp_path):
    law = unit()
    base = law.base
    angle, pulses, errors, contact, off = run_up(base)
    twin = run_unit(law, pulses, errors, contact=contact, enabled=~off)
    path = tmp_path / "unit.fmu"
    path.write_bytes(generate_fmu(law, version, arithmetic))
    assert validate_fmu(str(path)) == []
    player = Player(path, tmp_path / "opened")
    player.begin()
    currents, faults = np.zeros_like(twin.currents), np.zeros(COUNT, int)
    bits = 1 << np.arange(len(FAULTS))
    for k in range(COUNT):
        player.set([*base.inputs, "angle"], [*errors[k], angle[k]])
        player.set_flags(["contact", "blocks_off"], [contact[k], off[k]])
        player.step(base.sample_time)
        currents[k] = player.get(list(base.outputs))
        faults[k] = np.dot(bits, player.get_flags([name for name, _ in FAULTS]))
    assert np.abs(currents - twin.currents).max() <= apart * np.abs(twin.currents).max()
    assert (faults == twin.faults).all()
    assert {int(bits[2]), int(bits[6])} <= set((faults & (bits[2] | bits[6])).tolist())
    without = run_unit(law, np.full(COUNT, -1.0), errors)
    assert np.abs(without.currents - twin.currents).max() > 0.01 * np.abs(twin.currents).max()


def test_synchronous_blocks_are_told_the_angle_beside_the_axial_part(tmp_path):
    """The radial part does what it does without the axis along the shaft."""
    law = unit()
    dt = law.base.sample_time
    pd = StateSpace([[-900.0]], [[1e3]], [[-300.0]], [[800.0]], ["err_z"], ["u_z"])
    axial = build_block(deploy(pd, dt, dt, force=True), "unit_axial", 1e-3, 2.0)
    angle, _, errors, contact, off = (rows[:2000] for rows in run_up(law.base))
    shown = []
    for whole in (law, AllAxes(law, axial)):
        path = tmp_path / f"{len(shown)}.fmu"
        path.write_bytes(generate_fmu(whole, "3.0"))
        player = Player(path, tmp_path / f"opened{len(shown)}")
        player.begin()
        rows = []
        for k, row in enumerate(errors):
            player.set([*law.base.inputs, "angle"], [*row, angle[k]])
            player.set_flags(["contact", "blocks_off"], [contact[k], off[k]])
            player.step(law.base.sample_time)
            rows.append(player.get(list(law.base.outputs)))
        shown.append(np.array(rows))
    assert (shown[0] == shown[1]).all() and shown[0].any()


def test_one_sample_a_step(tmp_path):
    """The angle between communication points is not told."""
    law = unit()
    path = tmp_path / "unit.fmu"
    path.write_bytes(generate_fmu(law, "3.0"))
    player = Player(path, tmp_path / "opened")
    player.begin()
    player.step(law.base.sample_time)
    with pytest.raises(Exception, match=r"doStep|fmi3Error|status"):
        player.step(2 * law.base.sample_time)


def test_outputs_that_answer_at_once_show_the_blocks(tmp_path):
    law = unit(0)
    path = tmp_path / "unit.fmu"
    path.write_bytes(generate_fmu(law, "2.0", "float"))
    assert validate_fmu(str(path)) == []
