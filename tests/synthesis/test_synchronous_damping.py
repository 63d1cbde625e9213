"""Damping blocks: 1x divided by 1 + g, at a price in current that (1) of their module foretells; on
the rig as in the model; taken where neither block nor loop keeps the orbit.
"""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.synchronous.block_checks import (
    block_loops,
    check_block,
    converged_at,
    unbalance_of,
    worst_orbits,
)
from ambrose.annexes.synchronous.block_design import design_synchronous
from ambrose.annexes.synchronous.block_loop import Condition, running_law, synchronous_loop
from ambrose.annexes.synchronous.running import synchronous_program
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.law.pid import pid_controller
from ambrose.machine.file.toml import load_machine
from ambrose.rig.scenario import Scenario, Unbalance
from ambrose.rig.virtual_rig import run

REST = Condition(0.0)
BAND = (700.0, 740.0)


@pytest.fixture(scope="module")
def flywheel():
    machine = load_machine("flywheel")
    return machine, pid_controller(machine.reference, machine)


def orbit_alone(machine, law, speed):
    loop = synchronous_loop(machine, law)
    force = float(unbalance_of(machine).force(speed))
    return worst_orbits(converged_at(loop, None, speed, REST).q, force)


def limited(machine, law, share):
    """The machine with a limit of its orbit below what the loop alone has in BAND."""
    most = share * orbit_alone(machine, law, BAND[1])
    wanted = replace(machine.requirements, unbalance_orbit=most, unbalance_to=None)
    return replace(machine, requirements=wanted), most


@pytest.fixture(scope="module")
def damped(flywheel):
    machine, law = flywheel
    tight, limit = limited(machine, law, 0.6)
    return tight, limit, design_synchronous(tight, law, "damping", band=BAND)


def test_the_orbit_falls_as_one_over_one_plus_g(damped, flywheel):
    """g = eps/(2 leak) of the block in the file; the measured displacement is divided by 1 + g."""
    machine, limit, design = damped
    loop = synchronous_loop(machine, flywheel[1])
    (block,) = design.blocks
    g = block.gain / (2 * block.leak)
    (item,) = block_loops(machine, flywheel[1], design.blocks)
    for speed in BAND:
        alone = converged_at(loop, None, speed, REST).y
        with_block = item.converged(speed, REST).y
        assert np.abs(with_block * (1 + g) - alone).max() < 0.02 * np.abs(alone).max()
    checks = check_block(item)
    assert all(check.passed is not False for check in checks.checks)
    assert checks["synchronous.orbit_0p"].value <= 0.91 * limit


def test_the_smallest_g_that_keeps_the_orbit_is_taken(damped, flywheel):
    _, law = flywheel
    block = damped[2].blocks[0]
    tighter, _ = limited(flywheel[0], law, 0.3)
    (more,) = design_synchronous(tighter, law, "damping", band=BAND).blocks
    assert more.gain / more.leak > 2 * block.gain / block.leak


def test_what_cannot_be_damped_is_refused(flywheel):
    machine, law = flywheel
    with pytest.raises(InvalidInput, match="give them as its band"):
        design_synchronous(machine, law, "damping")
    for method, options in (("pid", {}), ("tuned", {"order": 12})):
        with pytest.raises(InvalidInput, match="give them with synchronous_band"):
            amb.design(machine, method, synchronous="damping", **options)
    line = ["synthesize", "flywheel", "--method", "pid", "--synchronous", "damping"]
    told = CliRunner().invoke(main, line)
    assert told.exit_code == 2
    assert "give them with synchronous_band (--synchronous-band)" in told.output


@pytest.mark.parametrize("band", [(350.0, 1200.0), (1100.0, 1200.0)])
@pytest.mark.parametrize("mode", ["damping", "current-free"])
def test_a_band_above_the_top_speed_is_refused_before_the_design(flywheel, band, mode):
    """The flywheel turns at 9000 rpm at most, 942 rad/s; above, the loop had been called unstable,
    and a band that reached there had been taken.
    """
    machine, law = flywheel
    with pytest.raises(InvalidInput, match=r"at most the top speed of 942\.478 rad/s"):
        design_synchronous(machine, law, mode, band=band)
    with pytest.raises(InvalidInput, match=r"the band of the synchronous block is .* 942\.478"):
        amb.design(machine, "mu", synchronous=mode, synchronous_band=band, progress=_never)


def _never(stage):
    raise AssertionError(stage)


def test_no_pressure_is_named_on_a_machine_without_seals(damped):
    assert not damped[2].machine.seals
    assert "falls to" in damped[2].notes[0] and "pressure" not in damped[2].notes[0]


def test_what_cannot_keep_the_orbit_is_refused(flywheel):
    machine, law = flywheel
    impossible, _ = limited(machine, law, 1e-3)
    with pytest.raises(InvalidInput, match=r"does not keep the orbit|takes .* A at 1x"):
        design_synchronous(impossible, law, "damping", band=BAND)


def test_damping_takes_over_where_neither_block_nor_loop_keeps_the_orbit(flywheel):
    """current-free is forbidden by its orbit; the loop alone breaks a tight limit further up."""
    machine, law = flywheel
    tight, _ = limited(machine, law, 0.9)
    design = design_synchronous(tight, law, "current-free", band=(100.0, BAND[1]))
    assert {block.mode for block in design.blocks} >= {"damping"}
    damping = [item for item in design.forbidden if item.replacement == "damping"]
    off = [item for item in design.forbidden if item.replacement == "off"]
    assert damping and off
    for item in off:  # "off there" is true all over the piece
        for speed in np.linspace(item.low, item.high, 7)[1:-1]:
            assert orbit_alone(tight, law, float(speed)) <= item.limit * 1.01


def test_the_rig_has_the_orbit_that_the_model_has(damped, flywheel):
    machine, _, design = damped
    law = flywheel[1]
    loop = synchronous_loop(machine, law)
    speed = 720.0
    sampled = loop.controller(loop.plant(speed, REST))
    scenario = Scenario("hold", 1.5, unbalances=(Unbalance("upper", 40e-6),), speed=speed)

    def orbit(switched_off):
        blocks = running_law(design.blocks, loop)
        program = synchronous_program(machine, sampled, blocks, scenario, switched_off=switched_off)
        record = run(machine, program, scenario, every=2).record
        time = record.time
        late = time > 1.5 - 60 * 2 * np.pi / speed
        turn = np.exp(-1j * speed * time[late])
        return abs(2 * np.mean(record["q_upper_zeta"][late] * turn))

    g = design.blocks[0].gain / (2 * design.blocks[0].leak)
    change = orbit(()) / orbit(((0.0, 1.5),))
    assert change == pytest.approx(1 / (1 + g), rel=0.1)
