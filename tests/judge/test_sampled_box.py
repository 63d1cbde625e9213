"""The sampled loop over its tolerances, on the full plant: what the box says is never below a
member of it.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla
from tests.pole_sets import matched

from ambrose.core.checks import NumericalFailure
from ambrose.core.frequency import frequency_response
from ambrose.core.sampling import c2d
from ambrose.core.statespace import StateSpace, feedback, poles, select, series, static_gain
from ambrose.core.worst_case_loop import box_points
from ambrose.judge.result import certify
from ambrose.judge.sampled import SampledBox, _first_peaks, check_over_box, sampled_box
from ambrose.law.loop import Timing, match_controller
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Tolerance
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import perturbed, tolerances_around
from coarse import coarse

TIMING = Timing(5e-5)
DAMPING = Tolerance("rotor.bending_5.damping", 0.6)  # of a mode that a reduced plant had cut


def machine(*more):
    rig = coarse("two-disc-rotor")
    return replace(rig, tolerances=(*rig.tolerances, *more))


@pytest.fixture(scope="module")
def loop():
    described = machine(DAMPING)
    plant = assemble(described)
    law = match_controller(pid_controller(described.reference, described), plant)
    return plant, TIMING.in_loop(law), tolerances_around(plant)


def test_aliases_give_the_plant_behind_its_hold(loop):
    """Against the matrix exponential, nominal and at a corner."""
    plant, controller, held = loop
    box = sampled_box(plant, controller, held)
    omega = np.geomspace(1.0, box.nyquist, 60)
    corner = np.array([1.0, -1.0, 1.0])[: len(held)]
    for delta in (np.zeros(len(held)), corner):
        member = perturbed(plant, box.named(delta), held)
        exact = c2d(select(member.system, member.named("u"), member.named("y")), 5e-5)
        wanted = frequency_response(exact, omega).values
        found = box.plant_response(omega, delta[None])[0]
        error = np.abs(found - wanted).max(axis=(1, 2)) / np.abs(wanted).max(axis=(1, 2))
        assert error.max() < 1e-4
        assert error[omega < 0.1 * box.nyquist].max() < 1e-7


def test_the_box_is_not_below_its_nominal_point_nor_any_member(loop):
    plant, controller, held = loop
    box = check_over_box(plant, controller, held)
    value = box["sampled.sensitivity.box"].value
    nominal = certify(plant, controller, margins=False).closed_loop_norm
    assert value >= nominal * (1 - 1e-6)
    found = sampled_box(plant, controller, held)
    rng = np.random.default_rng(11)
    members = rng.uniform(-1, 1, (200, len(held)))
    members[::2] = np.sign(members[::2])
    resonances = found.beside(found.closed_loop_poles(members[0]))
    grid = np.union1d(found.base_grid(), resonances)
    assert value >= found.gains(grid, members).max() * (1 - 1e-6)


def test_what_a_gain_cannot_exceed_and_no_start_is_lost_by_it(loop, monkeypatch):
    plant, controller, held = loop
    box = sampled_box(plant, controller, held)
    members = np.vstack([box_points(len(held)), 0.3 * box_points(len(held))])
    light = box.beside(box.closed_loop_poles(members[0]))
    grid = np.union1d(box.base_grid(), light)
    limit, gain = box.gain_limit(grid, 2), box.sensitivity(grid, members, 2)
    assert (np.linalg.norm(gain, 2, axis=(2, 3)) <= limit * (1 + 1e-9)).all()
    left_out = limit < np.linalg.norm(gain[0], 2, axis=(1, 2)).max()
    assert 0.2 < left_out.mean() < 1  # sharp enough to be of use
    assert box.gain_limit(grid[:0], 2).shape == (0,)  # no resonance beside the common grid

    poles = [box.light(row) for row in box.closed_loop_poles(members)]
    for few in (members, members[:3]):
        part = few, poles[: len(few)], np.zeros(len(few), bool)
        peaks = _first_peaks(box, *part)
        with monkeypatch.context() as patched:
            patched.setattr(
                SampledBox, "gain_limit", lambda self, omega, aliases: np.full(len(omega), np.inf)
            )
            whole = _first_peaks(box, *part)
        highest = [sorted(found, key=lambda peak: -peak.value)[:4] for found in (peaks, whole)]
        for one, other in zip(*highest, strict=True):
            assert one.value == pytest.approx(other.value, rel=1e-12)
            assert one.meets(other)


def test_the_worst_member_is_confirmed_by_its_own_norm(loop):
    """The member that the box names, assembled and sampled by itself."""
    plant, controller, held = loop
    box = sampled_box(plant, controller, held)
    check = check_over_box(plant, controller, held)["sampled.sensitivity.box"]
    worst = 0.0
    for corner in np.array(np.meshgrid(*[(-1.0, 1.0)] * len(held))).reshape(len(held), -1).T:
        member = perturbed(plant, box.named(corner), held)
        worst = max(worst, certify(member, controller, margins=False).closed_loop_norm)
    assert check.value == pytest.approx(worst, rel=1e-4)


def test_poles_of_all_members_are_those_of_each(loop):
    """The stack against every member assembled, sampled and closed by itself."""
    plant, controller, held = loop
    box = sampled_box(plant, controller, held)
    members = np.random.default_rng(3).uniform(-1, 1, (4, len(held)))
    stack = np.exp(5e-5 * box.closed_loop_poles(members))
    for delta, found in zip(members, stack, strict=True):
        member = perturbed(plant, box.named(delta), held)
        sampled = c2d(select(member.system, member.named("u"), member.named("y")), 5e-5)
        unit = static_gain(np.eye(len(plant.axes)), dt=5e-5)
        z = poles(feedback(series(controller, sampled), unit))
        np.testing.assert_allclose(matched(found, z), z, rtol=1e-9, atol=1e-9)


def random_box(rng, n, r, a, direct):
    """A box of r parameters, of which the first has two channels; everything of D filled."""
    channels = r + 1
    system, law = (
        StateSpace(
            rng.normal(size=(states, states)) * scale,
            rng.normal(size=(states, m)),
            rng.normal(size=(p, states)),
            direct * rng.normal(size=(p, m)),
            dt=dt,
        )
        for states, m, p, scale, dt in (
            (n, channels + a, channels + a, 0.3 / 1e-3 / np.sqrt(n), None),
            (3, a, a, 0.4, 1e-3),
        )
    )
    return SampledBox(law, (), system, np.array([0, *range(r)]), None, None, None)


@pytest.mark.parametrize("seed", range(8))
def test_poles_of_random_loops_against_matrices_closed_one_by_one(seed):
    """Own formulas: the parameters, the hold and the controller closed member by member."""
    rng = np.random.default_rng(seed)
    n, r, a = rng.integers(2, 30), rng.integers(1, 5), rng.integers(1, 4)
    box = random_box(rng, n, r, a, 0.15)
    members = rng.uniform(-1, 1, (5, r))
    s, K, c = box.system, box.controller, r + 1
    for delta, found in zip(members, box.closed_loop_poles(members), strict=True):
        gain = np.diag(delta[box.owner])
        inner = np.linalg.solve(np.eye(c) - gain @ s.D[:c, :c], gain)
        A = s.A + s.B[:, :c] @ inner @ s.C[:c]
        B = s.B[:, c:] + s.B[:, :c] @ inner @ s.D[:c, c:]
        C = s.C[c:] + s.D[c:, :c] @ inner @ s.C[:c]
        D = s.D[c:, c:] + s.D[c:, :c] @ inner @ s.D[:c, c:]
        E = sla.expm(1e-3 * np.block([[A, B], [np.zeros((a, n + a))]]))
        # x+ = Ad x + Bd u, e = -C x - D u, u = Ck xk + Dk e
        M = np.linalg.inv(np.block([[np.eye(a), D], [-K.D, np.eye(a)]]))
        eu = M @ np.block([[np.zeros((a, 3)), -C], [K.C, np.zeros((a, n))]])
        whole = sla.block_diag(K.A, E[:n, :n]) + sla.block_diag(K.B, E[:n, n:]) @ eu
        z = np.linalg.eigvals(whole)
        np.testing.assert_allclose(matched(np.exp(1e-3 * found), z), z, rtol=1e-9, atol=1e-9)


def test_a_member_with_an_algebraic_loop_is_refused():
    box = random_box(np.random.default_rng(0), 3, 1, 1, 0.0)
    D = box.system.D.copy()
    D[0, 0] = 2.0  # 1 - 2 delta = 0
    s = box.system
    box = replace(box, system=StateSpace(s.A, s.B, s.C, D, s.inputs, s.outputs))
    with pytest.raises(NumericalFailure, match="algebraic"):
        box.closed_loop_poles(np.array([[0.1], [0.5]]))


def test_the_outermost_pole_over_the_box_is_that_of_all_members_on_the_full_plant(loop):
    """Every corner and sample on the full plant, against the few that the check looks at."""
    plant, controller, held = loop
    check = check_over_box(plant, controller, held)["sampled.abscissa.box"]
    box = sampled_box(plant, controller, held)
    every = box.closed_loop_poles(box_points(len(held), 32)).real.max()
    assert check.value >= every - 1e-9 * abs(every)
    assert check.value == pytest.approx(every, rel=1e-3)  # or that of a reduced plant
