"""One FMU of all axes: radial and axial controller together, as FMPy plays it, against the twins of
both parts.
"""

from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu

import ambrose as amb
from ambrose import StateSpace
from ambrose.code.block.block import build_block
from ambrose.code.block.run import run_of
from ambrose.code.fmu import axial_flags, references, variables
from ambrose.code.interface import AllAxes
from ambrose.code.sampled import deploy
from fmu_player import Player
from needs import needs

EXAMPLE = Path(__file__).parents[3] / "examples" / "expander-five-axes.toml"
COUNT = 400
compiled = needs("C compiler")


@pytest.fixture(scope="module")
def laws():
    machine = amb.load_machine(EXAMPLE)
    return machine, amb.design(machine, "pid", axes="radial"), amb.design(machine.axial, "pid")


def block_of(axes, name):
    """A block with a lag in every axis."""
    n, unit = len(axes), np.eye(len(axes))
    law = StateSpace(
        -900 * unit,
        1e3 * unit,
        -300 * unit,
        800 * unit,
        [f"err_{axis}" for axis in axes],
        [f"u_{axis}" for axis in axes],
    )
    return build_block(deploy(law, 1e-4, 1e-4, force=True), name, 1e-3, np.full(n, 2.0))


def played(path, folder, block, axial, errors, valid):
    """Currents and the flags of both parts, sample by sample."""
    player = Player(path, folder)
    player.begin()
    names = [*block.inputs, *axial.inputs]
    currents, flags = np.zeros_like(errors), np.zeros((len(errors), 6), bool)
    parts = ("held", "fault", "limited", "axial_held", "axial_fault", "axial_limited")
    for k, row in enumerate(errors):
        player.set(names, row)
        player.set_flags([f"valid_{name}" for name in names], valid[k])
        player.step(block.sample_time)
        currents[k] = player.get([*block.outputs, *axial.outputs])
        flags[k] = player.get_flags(parts)
    return currents, flags


@compiled
@pytest.mark.parametrize(
    ("arithmetic", "within"),
    [("double", 1e-12), pytest.param("fixed32", 1e-5, marks=pytest.mark.study)],
)
def test_one_fmu_of_all_axes_is_both_twins(arithmetic, within, laws, tmp_path):
    machine, radial, axial = laws
    done = amb.export(
        radial, tmp_path, to="fmu", machine=machine, axial=axial, arithmetic=arithmetic, force=True
    )
    assert [path.name for path in done.paths] == ["controller_fmi2.fmu", "controller_fmi3.fmu"]
    block, along = done.block, done.axial.block
    n = len(block.inputs) + 1
    rng = np.random.default_rng(7)
    limits = np.concatenate([block.error_limit, along.error_limit])
    errors = 0.02 * limits * rng.standard_normal((COUNT, n))
    valid = np.ones((COUNT, n), bool)
    # a lost axial reading, then a lost radial one: each part holds its own
    valid[100:140, -1], valid[200:230, 0] = False, False
    for path in done.paths:
        assert validate_fmu(str(path)) == []
        currents, flags = played(path, tmp_path / path.stem, block, along, errors, valid)
        for one, part in ((block, slice(0, n - 1)), (along, slice(n - 1, n))):
            twin = run_of(one, errors[:, part], valid=valid[:, part]).currents
            assert one.delay == 1  # what is read after a step are the currents of its errors
            assert np.abs(currents[:, part] - twin).max() <= within * np.abs(twin).max()
            assert (np.abs(twin) < 0.9 * one.current_limit).mean() > 0.5
        assert (flags[:, 0] == ~valid[:, 0]).all() and (flags[:, 3] == ~valid[:, -1]).all()
        assert flags[110:140, 4].any() and not flags[100:140, 1].any()


def test_the_variables_of_all_axes_stand_in_their_groups():
    """Errors, flags and currents of the axial part follow those of the radial one; its status has
    flags of its own; there is no bumpless transfer of all axes.
    """
    law = block_of(("x", "y"), "unit")
    whole = AllAxes(law, block_of(("z",), "unit_axial"))
    names, at = [v.name for v in variables(whole)], references(whole)
    errors = [*law.inputs, *whole.axial.inputs]
    assert names[at["ERROR"] :][: len(errors)] == errors
    assert names[at["VALID"] :][: len(errors)] == [f"valid_{name}" for name in errors]
    currents = [*law.outputs, *whole.axial.outputs]
    assert names[at["CURRENT"] :][: len(currents)] == currents
    assert names[at["AXIAL"] : at["AXIAL_LAST"] + 1] == [name for name, _ in axial_flags(whole)]
    assert len(set(names)) == len(names) and "tracking" not in names
