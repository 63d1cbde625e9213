"""What is judged over a range of speeds against fine grids of this file's own: poles, and the
unbalance response of the rotor assembled anew.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.synchronous.block_checks import block_loops, check_block
from ambrose.chain.check import facts
from ambrose.core.statespace import StateSpace, spectral_abscissa, static_gain
from ambrose.judge import nominal
from ambrose.judge.campbell import follow, threshold_check
from ambrose.judge.plants import judge_stability, plants_along_speed, small_along_speed
from ambrose.judge.sampled import of_whole
from ambrose.law.law import law_of
from ambrose.law.loop import (
    Timing,
    closed_loop,
    loop_alone,
    machine_timing,
    match_controller,
    running_law,
)
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, Operation, Requirements
from ambrose.machine.file.toml import load_machine
from ambrose.machine.part import Seal, SealTable, Synchronous
from ambrose.model.assemble import assemble
from ambrose.model.effects.stations import JournalBearing
from ambrose.model.static_load import unbalance
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.report.tables import deciding_verdict
from coarse import coarse

TOP = 1000.0
OPEN = static_gain(np.zeros((4, 4)))
J = np.array([[0.0, 1.0], [-1.0, 0.0]])


class Discs:
    """Two discs of one kilogram on springs k, each z'' + (d - j W r) z' + k z = f: forward modes
    rise with the speed; c couples the discs, +c one way and -c the other: they flutter where their
    frequencies meet.
    """

    def __init__(self, stiffness, ratio, damping, coupling=0.0):
        one = np.eye(2)
        self.K = np.kron(np.diag(stiffness), one) + coupling * np.kron(J, one)
        self.D, self.G = np.kron(np.diag(damping), one), np.kron(np.diag(ratio), J)

    def matrix(self, speed):
        return np.block([[np.zeros((4, 4)), np.eye(4)], [-self.K, -self.D - speed * self.G]])

    def growth(self, speeds):
        return np.array([np.linalg.eigvals(self.matrix(w)).real.max() for w in speeds])

    def orbits(self, speeds):
        """Largest singular value of the compliance times W^2."""
        q = np.array(
            [
                np.linalg.inv(self.K + 1j * w * (self.D + w * self.G) - w * w * np.eye(4))
                for w in speeds
            ]
        )
        return np.linalg.norm(q, 2, axis=(1, 2)) * speeds**2

    def plant_at(self, template, wanted=None):
        machine = replace(
            template.machine,
            operation=Operation((OperatingPoint(),), (0.0, TOP)),
            requirements=wanted or Requirements(),
        )
        old = template.system
        B = np.vstack([np.zeros((4, 8)), np.hstack([np.eye(4), np.eye(4)])])

        def at(speed):
            system = StateSpace(self.matrix(speed), B, old.C, old.D, old.inputs, old.outputs)
            return replace(template, machine=machine, system=system)

        return at


def judged(discs, template, wanted=None):
    """The rows over the speed range, residual unbalance 1 kg m where orbits are wanted."""
    plant_at = discs.plant_at(template, wanted)
    residual = None if wanted is None else unbalance(1.0, 1.0, 1.0)
    plant = plant_at(0.0)
    span, asked = plant.machine.operation.speed_range, plant.machine.requirements
    checks, _ = nominal._assembled(plant_at, plant, OPEN, lambda _: OPEN, span, asked, residual)
    return checks


def random_discs(rng):
    """Forward modes that cross within the range, damped by 0.2 to 2 rad/s, coupled by about as
    much.
    """
    slow, fast = sorted(rng.uniform(200, 450, 2))
    decay = 10 ** rng.uniform(-0.7, 0.3)
    stiffness, ratio = (slow**2, fast**2), (rng.uniform(0.3, 0.9), rng.uniform(0, 0.1))
    coupling = decay * slow * 10 ** rng.uniform(0, 0.8)
    return Discs(stiffness, ratio, (2 * decay, 2 * decay), coupling)


def stability_of(seed, template):
    discs = random_discs(np.random.default_rng([49, seed]))
    (check,) = judged(discs, template)
    return check, discs.growth(np.linspace(0, TOP, 4001)).max()


@pytest.mark.parametrize("seed", range(12))
def test_the_worst_speed_is_found_between_even_ones(seed, single_masses):
    check, own = stability_of(seed, single_masses())
    assert check.value >= own - 2e-3 * abs(own)
    assert "speeds, refined at the worst" in check.title


@pytest.mark.study
def test_the_worst_speed_of_three_hundred_random_rotors(single_masses):
    template = single_masses()
    found = [stability_of(seed, template) for seed in range(300)]
    lost = sum(own > 0 for _, own in found)
    assert 100 < lost < 300
    assert not [seed for seed, (check, own) in enumerate(found) if check.passed and own > 0]
    assert max((own - check.value) / abs(own) for check, own in found) < 2e-3


def test_a_speed_at_which_a_table_bends_is_looked_at(rig, rig_controller):
    """A film that drives whirl at 455 rad/s alone, in a table, between speeds of an even grid."""
    film = JournalBearing(
        "film",
        0.43,
        *((0.0,) * 5 for _ in range(4)),
        speed=(0.0, 440.0, 455.0, 470.0, TOP),
        K_xy=(0.0, 0.0, 2e7, 0.0, 0.0),
        K_yx=(0.0, 0.0, -2e7, 0.0, 0.0),
    )
    still = replace(rig.operation.points[1], label="")
    machine = replace(rig, effects=(*rig.effects, film), operation=Operation((still,), (0.0, TOP)))

    def plant_at(speed):
        return assemble(machine, replace(still, speed=speed))

    law_at = partial(match_controller, rig_controller)
    plant, asked = plant_at(0.0), machine.requirements
    found, _ = nominal._assembled(plant_at, plant, rig_controller, law_at, (0.0, TOP), asked, None)
    assert found[0].passed is False
    assert "largest at 72.42 Hz" in found[0].detail
    assert "unstable from 7" in found[0].detail


def narrow_discs(rng):
    """A light critical speed beside, or beneath, a broad one."""
    light, broad = rng.uniform(60, 600), rng.uniform(200, 900)
    ratio = rng.uniform(-0.1, 0.1, 2)
    damping = (2 * light * 10 ** rng.uniform(-4, -2), 2 * broad * rng.uniform(0.05, 0.3))
    return Discs((light**2, broad**2), ratio, damping), light


def orbit_of(seed, template):
    rng = np.random.default_rng([50, seed])
    discs, light = narrow_discs(rng)
    to = float(rng.uniform(light, TOP))
    wanted = Requirements(unbalance_orbit=1e-3, unbalance_to=to)
    _, check = judged(discs, template, wanted)
    # and finer around every critical speed, W^2 (1 -+ r) = k
    own = np.diag(discs.K)[::2], discs.G[::2, 1::2].diagonal(), np.diag(discs.D)[::2]
    packed = [
        np.sqrt(k / (1 + sign * r)) + d * np.linspace(-5, 5, 1001)
        for k, r, d in zip(*own, strict=True)
        for sign in (-1, 1)
    ]
    speeds = np.concatenate([np.linspace(0.02 * TOP, to, 4001), *packed])
    return check, discs.orbits(speeds[(speeds >= 0.02 * TOP) & (speeds <= to)]).max()


@pytest.mark.parametrize("seed", range(12))
def test_the_largest_orbit_is_found_between_even_speeds(seed, single_masses):
    check, own = orbit_of(seed, single_masses())
    assert check.value >= own * (1 - 1e-3)
    assert "speeds, refined at peaks" in check.title


@pytest.mark.study
def test_the_largest_orbit_of_three_hundred_random_rotors(single_masses):
    template = single_masses()
    found = [orbit_of(seed, template) for seed in range(300)]
    assert max(own / check.value - 1 for check, own in found) < 1e-3


RPM = np.pi / 30


def pump(speeds, k=0.0, stated=(0.0, 0.0), at=(1000, 2000, 3000)):
    """A pump with one seal whose k [N/m] is that at the middle one of three speeds [rpm]."""
    machine = coarse("vertical-pump")
    over = (("speed", tuple(RPM * rpm for rpm in (0, *at, 4000))),)
    table = SealTable(over, (("k", np.array([0.0, 0.0, k, 0.0, 0.0])),))
    points = tuple(OperatingPoint(rpm * RPM, 1e5, label=f"{rpm} rpm") for rpm in speeds)
    return replace(
        machine,
        seals=(Seal("ring", machine.seals[1].position, table=table),),
        tolerances=(),
        operation=Operation(points, stated),
        requirements=Requirements(sensitivity_peak=10.0),
    )


def verified(machine):
    return amb.verify(machine, pid_controller(machine.reference, machine))


def test_between_points_of_two_speeds_the_machine_runs():
    """Stable at both points, lost between them: PASSED without a word."""
    machine = pump((1000, 3000), 2e7)
    found = verified(machine)
    assert all(checks.checks[0].passed for checks in found.points)
    (check,) = (c for checks in found.points for c in checks.checks if c.name == "stability.speeds")
    middle = replace(machine.operation.points[0], speed=2000 * RPM)
    law, timing = pid_controller(machine.reference, machine), machine_timing(machine)
    own = judge_stability(assemble(machine, middle), law, timing)
    assert not check.passed and not found.passed and not found.stable
    assert check.value == pytest.approx(own.abscissa, rel=0.05) and own.abscissa > 100
    assert "speeds from 1,000 to 3,000 rpm (searched)" in deciding_verdict(found)


def test_the_verdict_says_where_nothing_was_looked_at():
    """At rest and at speed: how it gets there is not stated."""
    found = verified(pump((0, 3000)))
    assert found.passed and found.to_dict()["between"].startswith("nothing between")
    words = "PASSED: 2 operating points, nothing between their speeds (state speed_range), sampled"
    assert deciding_verdict(found).startswith(words)


@pytest.mark.parametrize(
    ("speeds", "stated", "running"),
    [
        ((0, 3000), (0.0, 0.0), (0.0, 0.0)),
        ((3000, 1000, 0), (0.0, 0.0), (1000 * RPM, 3000 * RPM)),
        ((3000, 1000), (0.0, 400.0), (0.0, 400.0)),
        ((3000, 3000.0), (0.0, 0.0), (0.0, 0.0)),
    ],
)
def test_the_running_range(speeds, stated, running):
    points = tuple(OperatingPoint(rpm * RPM) for rpm in speeds)
    assert Operation(points, stated).running == running


def test_a_loop_that_is_unstable_without_the_block_is_named_not_the_block():
    """Between the three speeds that are looked at first: T was called unstable for every gain."""
    machine = pump((1000, 3000), 2e7, at=(1000, 1300, 1700))
    law = pid_controller(machine.reference, machine)
    block = Synchronous("current-free", (1000 * RPM, 3000 * RPM), 1.0)
    (item,) = block_loops(machine, law, (block,))
    growth = [spectral_abscissa(item.loop.sampled(w, item.conditions[0])) for w in item.speeds(3)]
    assert max(growth) < 0
    checks = check_block(item)
    (check,) = checks.checks
    assert not checks.stable and checks.label.startswith("the loop alone")
    assert check.name == "stability.abscissa" and not check.passed and check.value > 0
    own = spectral_abscissa(item.loop.sampled(1300 * RPM, item.conditions[0]))
    assert 0 < check.value <= 1.02 * own
    assert "stabilise the loop" in check.detail


def test_a_range_that_is_stated_is_not_asked_for():
    """Of an unstable loop nothing is checked between the points; the file states its range."""
    machine = amb.load_machine("turboexpander")
    K = amb.design(machine, "pid").controller
    lost = replace(K, C=-K.C, D=-K.D)
    found = amb.verify(machine, lost, tolerances=False)
    assert not found.stable and machine.operation.speed_range[1] > 0
    assert found.between == "nothing between their speeds"


def test_check_and_verify_tell_the_threshold_speed_of_rotating_damping():
    """Of the same loop, within what the reduction of check leaves; without a share neither does."""
    machine = load_machine("munich-rig")
    tops = OperatingPoint(3000.0, label="top"), OperatingPoint(0.0, label="standstill")
    machine = replace(
        machine, rotating_share=1.0, tolerances=(), operation=Operation(tops, (0.0, 3000.0))
    )
    told = facts(machine)
    found = told["threshold_speed_rad_s"]
    assert 2700 < found < 3000
    assert any("the threshold speed of the rotating damping" in doubt for doubt in told["doubts"])
    law = pid_controller(machine.controller, machine)
    plant = amb.assemble(machine, "top")

    def loop_at(speed):
        at = free_mode_reduction(replace(plant, point=replace(plant.point, speed=speed)), 20)
        return closed_loop(at, running_law(law_of(law), at, machine_timing(machine)))

    row = threshold_check(loop_at, 0.8 * found, 0.6 * found)
    assert row.value == pytest.approx(found, rel=2e-3) and row.limit is None
    still = facts(replace(machine, rotating_share=0.0))
    assert "threshold_speed_rad_s" not in still


def test_the_loop_alone_has_the_poles_of_the_closed_loop():
    machine = coarse("seal-rig")
    plant = assemble(machine)
    law = pid_controller(machine.reference, machine)
    for running in (match_controller(law, plant), running_law(law, plant, Timing(1e-4))):
        alone, whole = loop_alone(plant, running), closed_loop(plant, running)
        assert alone.dt == whole.dt
        np.testing.assert_allclose(alone.A, whole.A, rtol=1e-10, atol=1e-10 * abs(whole.A).max())


@pytest.mark.parametrize("name", ["overhung-blower", "vertical-pump"])
def test_a_smaller_plant_finds_the_worst_speed_of_the_full_one(name):
    """The full plant followed over the speed by itself, and where a smaller one adds the speeds at
    which it is asked.
    """
    machine = coarse(name)
    plant, law = assemble(machine), law_of(pid_controller(machine.reference, machine))
    timing = machine_timing(machine) or Timing(1e-4)
    asked = []

    def loop_at(plants, w):
        at = plants(w)
        asked.append(at.bending_modes is None)
        return loop_alone(at, running_law(law, at, timing))

    whole, small = (partial(loop_at, at(plant)) for at in (plants_along_speed, small_along_speed))
    speeds = np.linspace(*machine.operation.running, 11)
    alone = follow(whole, speeds).abscissa.max()
    asked.clear()
    found = follow(small, speeds, critical=True, whole_at=whole)
    assert found.abscissa.max() == pytest.approx(alone, rel=1e-6)
    assert sum(asked) == len(found.speeds) >= len(speeds)
    exact = follow(whole, speeds, critical=True).critical
    assert [w for w, _ in found.critical] == pytest.approx([w for w, _ in exact], rel=1e-2)


@pytest.mark.parametrize("seed", range(20))
def test_no_whole_loop_that_may_be_the_outermost_is_left_out(seed):
    rng = np.random.default_rng([54, seed])
    whole = rng.uniform(-10, 0.5 if seed % 2 else -1, 60)
    small = whole - rng.uniform(0, 0.2, 60)
    small[[0, 59]] = whole[[0, 59]] - 0.2  # nothing rises by more than what is known
    found = small.copy()
    asked = of_whole(found, (0, 59), lambda k: float(whole[k]))
    assert asked < 40 and found.max() >= whole.max() - 1e-3 * abs(whole.max())
    assert (found >= 0).sum() == (whole >= 0).sum()
