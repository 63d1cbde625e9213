"""Synchronous blocks on bundled machines: borders, forbidden bands, design, proof, refusals, and
what they cost.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose.annexes.synchronous.block_checks import (
    block_loops,
    check_block,
    forbidden_bands,
    orbit_limit,
    unbalance_of,
    worst_orbits,
)
from ambrose.annexes.synchronous.block_design import design_synchronous
from ambrose.annexes.synchronous.block_loop import (
    BlockTable,
    Condition,
    conditions,
    forward_patterns,
    loop_pencils,
    prove_interval,
    running_table,
    synchronous_loop,
)
from ambrose.annexes.synchronous.speeds import frozen, resonator, sensitivity
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import StateSpace, select
from ambrose.core.synchronous import (
    borders,
    convergence,
    sector_angle,
    slowest_pole,
    with_resonator,
)
from ambrose.judge.controller_file import read_controller, write_controller
from ambrose.judge.result import Synthesis
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Tolerance
from ambrose.machine.file.toml import load_machine
from ambrose.machine.part import Synchronous

REST = Condition(0.0)


def controlled(name):
    machine = load_machine(name)
    return machine, pid_controller(machine.reference, machine)


@pytest.fixture(scope="module")
def flywheel():
    return controlled("flywheel")


@pytest.fixture(scope="module")
def loop(flywheel):
    return synchronous_loop(*flywheel)


@pytest.fixture(scope="module")
def designed(flywheel):
    return design_synchronous(*flywheel, band=(330.0, 650.0))


def outermost(loop, speed, condition=REST, T=None, eps=1e-3):
    closed = select(loop.sampled(speed, condition), None, loop.reads("current-free"))
    return slowest_pole(closed, np.eye(len(loop.axes)) if T is None else T, speed, eps)


def test_the_plain_notch_begins_to_be_stable_where_the_exact_poles_do(loop):
    """By root finding on Re lambda(T S); by bisection on the sampled loop's poles with a small
    gain: within 1 %.
    """
    one = np.eye(4)
    found = borders(
        lambda w: float(convergence(one, loop.response("current-free", w, REST))),
        np.linspace(20, 940, 20),
    )
    (border,) = found
    assert border.stable_above
    low, high = 300.0, 700.0
    while high - low > 0.5:
        middle = (low + high) / 2
        low, high = (low, middle) if outermost(loop, middle) < 0 else (middle, high)
    assert border.value == pytest.approx((low + high) / 2, rel=0.01)
    assert border.value == pytest.approx(437.5, abs=1)


@pytest.mark.golden
def test_the_published_borders_are_those_of_the_loop_without_sampling():
    """Issue figures: 426 rad/s of the flywheel; sampling and delay move it by 3 %."""
    machine, law = controlled("flywheel")
    fine = synchronous_loop(machine, law, rate=1e6, delay_samples=0)
    one = np.eye(4)
    (border,) = borders(
        lambda w: float(convergence(one, fine.response("current-free", w, REST))),
        np.linspace(300, 600, 7),
    )
    assert border.value == pytest.approx(425.5, abs=1)


def test_the_enclosure_is_the_sampled_loop_but_for_aliasing(loop):
    pencils = loop_pencils(loop, REST, 500.0, 900.0)
    cell = pencils.pencil(610.0, 610.0 + 1e-6)
    S = cell.D + cell.C @ np.linalg.solve(cell.P0, cell.Q)
    speed = 610.0 + 5e-7
    assert pytest.approx(loop.base_band(speed, REST), abs=1e-11) == S
    exact = loop.response("current-free", speed, REST)
    assert 0 < np.linalg.norm(S - exact, 2) <= pencils.aliasing(610.0, 610.1)


@pytest.mark.parametrize("mode", ["force-free", "vibration-free", "damping"])
def test_the_enclosure_of_every_mode_is_its_response_but_for_aliasing(loop, mode):
    pencils, speed = loop_pencils(loop, REST, 500.0, 900.0, mode=mode), 610.0 + 5e-7
    cell, units = pencils.pencil(610.0, 610.0 + 1e-6), pencils.units[:, None]
    R = cell.D + cell.C @ np.linalg.solve(cell.P0, cell.Q)
    assert pytest.approx(units * loop.base_band(speed, REST, mode), abs=1e-11) == R
    exact = units * loop.signals(mode, speed, REST)
    assert 0 < np.linalg.norm(R - exact, 2) <= pencils.aliasing(610.0, 610.1)
    weighed = loop.weights(mode, speed, REST) @ loop.signals(mode, speed, REST)
    assert pytest.approx(weighed, rel=1e-12) == loop.response(mode, speed, REST)


def test_the_proof_is_of_the_table_that_runs_and_not_of_t_between_its_speeds(flywheel):
    """Two knots far apart and a late loop: D = T Z is linear between them, T Z is not."""
    machine, law = flywheel
    loop = replace(synchronous_loop(machine, law, delay_samples=3), harmonic=4)
    low, high = 600.0, 940.0
    knots = np.array([low, high])
    T = np.array([np.linalg.inv(loop.response("force-free", w, REST)) for w in knots])
    table = BlockTable(knots, T)
    running = running_table(table, loop, "force-free")
    speeds = np.linspace(low, high, 41)
    signals = [loop.signals("force-free", w, REST) for w in speeds]
    true = min(sector_angle(running.at(w) @ R) for w, R in zip(speeds, signals, strict=True))
    other = min(
        sector_angle(table.at(w) @ loop.weights("force-free", w, REST) @ R)
        for w, R in zip(speeds, signals, strict=True)
    )
    pencils = loop_pencils(loop, REST, low, high, mode="force-free")
    proof = prove_interval(pencils, running.at, knots.tolist(), low, high)
    assert proof.proved
    assert other > true + np.radians(1.0)
    assert true - np.radians(1.0) < proof.angle <= true


@pytest.mark.parametrize("mode", ["force-free", "vibration-free"])
def test_what_is_proved_of_other_modes_has_stable_poles(loop, mode):
    """Random T in two intervals: none is proved and unstable at a speed and member in it."""
    rng = np.random.default_rng(5)
    spans = [(480.0, 510.0), (800.0, 830.0)]
    pencils = [loop_pencils(loop, REST, *span, None, mode=mode) for span in spans]
    names = [t.parameter for t in pencils[0].tolerances]
    proved = unstable = 0
    for k in range(24):
        low, high = spans[k % 2]
        noise = rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4))
        inverse = np.linalg.inv(loop.response(mode, (low + high) / 2, REST))
        T = inverse @ (np.eye(4) + rng.uniform(0, 1.5) * noise / 2)
        D = T @ loop.weights(mode, (low + high) / 2, REST)
        shown = prove_interval(pencils[k % 2], lambda w, D=D: D, (), low, high).proved
        member = tuple(zip(names, rng.uniform(-1, 1, len(names)).tolist(), strict=True))
        speed = rng.uniform(low, high)
        closed = select(loop.sampled(speed, Condition(0.0, member)), None, loop.reads(mode))
        stable = slowest_pole(closed, D, speed, 1e-3) < 0
        proved, unstable = proved + shown, unstable + (not stable)
        assert stable or not shown
    assert min(proved, unstable) > 1


def test_force_free_is_proved_over_tolerances_of_the_amplifier_too(flywheel):
    """The block weighs its signals as in the file, the members have other amplifiers."""
    machine, law = flywheel
    band = Tolerance("amplifier.bandwidth", 0.1)
    loop = synchronous_loop(replace(machine, tolerances=(*machine.tolerances, band)), law)
    low, high = 700.0, 720.0
    pencils = loop_pencils(loop, REST, low, high, None, mode="force-free")
    assert "amplifier.bandwidth" in {item.parameter for item in pencils.tolerances}
    D = np.linalg.pinv(loop.signals("force-free", 710.0, REST))
    proof = prove_interval(pencils, lambda w: D, (), low, high)
    assert proof.proved
    for size in (-1.0, 1.0):
        member = Condition(0.0, (("amplifier.bandwidth", size),))
        assert sector_angle(D @ loop.signals("force-free", low, member)) >= proof.angle


def test_every_member_of_the_box_lies_in_the_enclosure(loop):
    from ambrose.core.interval_proof import enclose

    pencils = loop_pencils(loop, REST, 600.0, 700.0, None)
    low, high = 640.0, 642.0
    cell = enclose(pencils.pencil(low, high))
    names = [t.parameter for t in pencils.tolerances]
    rng = np.random.default_rng(1)
    for _ in range(10):
        t, p = rng.uniform(), rng.uniform(-1, 1, len(names))
        member = Condition(0.0, tuple(zip(names, p.tolist(), strict=True)))
        S = loop.base_band(low + t * (high - low), member)
        weights = np.array([(1 - t) ** 2, 2 * t * (1 - t), t**2])
        middle = np.einsum("k,kij->ij", weights, cell.corners) + np.einsum(
            "j,jik->ik", p, cell.slopes
        )
        assert (np.abs(S - middle) <= cell.tail + 1e-9).all()


def test_a_current_free_rotor_has_a_speed_at_which_no_orbit_is_bounded(loop):
    (band,) = forbidden_bands(loop, "current-free", (94.0, 942.0), (REST,))
    assert band.worst == pytest.approx(425.5, abs=0.5)
    assert band.orbit > 1.0  # m: without bound
    force = float(unbalance_of(loop.machine).force(band.low))
    values = loop.converged("current-free", band.low, REST, forward_patterns(loop.machine))
    assert worst_orbits(values.q, force) == pytest.approx(
        orbit_limit(loop.machine, band.low), rel=1e-4
    )
    assert forbidden_bands(loop, "force-free", (94.0, 942.0), (REST,)) == ()


def test_the_modes_drive_to_zero_what_they_promise(loop):
    speed, f = 700.0, forward_patterns(loop.machine)
    alone = loop.converged(None, speed, REST, f)
    assert (
        np.abs(loop.converged("current-free", speed, REST, f).u).max()
        < 1e-12 * np.abs(alone.u).max()
    )
    assert (
        np.abs(loop.converged("vibration-free", speed, REST, f).y).max()
        < 1e-12 * np.abs(alone.y).max()
    )
    force_free = loop.converged("force-free", speed, REST, f)
    assert (
        np.abs(force_free.force).max() < 0.02 * np.abs(alone.force).max()
    )  # but for bending between sensor and bearing
    D = 0.01j * np.eye(4)
    damped = loop.converged("damping", speed, REST, f, D)
    assert damped.c == pytest.approx(D @ damped.y)


def test_what_is_converged_is_where_the_resonator_ends(loop, designed):
    """The phasors of ``converged`` against the sampled loop with the resonator, run in time until
    it has settled.
    """
    speed = 600.0
    block = next(b for b in designed.blocks if b.band[0] < speed < b.band[1])
    from ambrose.annexes.synchronous.block_loop import block_table

    T = block_table(block, loop.machine).at(speed)
    closed = loop.sampled(speed, REST)
    e = select(closed, None, loop.reads("current-free"))
    A = with_resonator(e, T, speed, 20.0)
    n = e.n_states
    # a disturbance d of y enters as -c does
    B = np.vstack([-e.B, 0 * np.eye(4), 0 * np.eye(4)])
    turn, dt = speed * e.dt, e.dt
    rotation = np.kron([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]], np.eye(4))
    B[n:] = rotation @ (20.0 * dt * np.vstack([T.real, T.imag])) @ (-e.D)
    # d_k = cos(w t + k) um by two states more: 1.5 s are a power of the whole matrix
    d = 1e-6 * np.array([[np.cos(k), -np.sin(k)] for k in range(4)])
    spin = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    whole = np.block([[A, B @ d], [np.zeros((2, len(A))), np.array(spin)]])
    x = np.linalg.matrix_power(whole, int(1.5 / dt) - 2000) @ np.eye(len(whole))[-2]
    for _ in range(2000):
        # e = S(d - c) = 0 where c = d
        assert np.abs(x[n : n + 4] - d @ x[-2:]).max() < 2e-3 * 1e-6
        x = whole @ x


def own_sensitivity(loop, speed, T, eps):
    """The largest sensitivity of an axis with a block of mode current-free on, over a fine grid."""
    e = select(loop.sampled(speed, REST), None, loop.reads("current-free"))
    turn, n, one = speed * e.dt, e.n_states, np.eye(4)
    A = with_resonator(e, T, speed, eps)
    # a disturbance d of y enters as -c does: e = C x + D (Re w - d)
    rotation = np.kron([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]], one)
    B = np.vstack([-e.B, rotation @ (eps * e.dt * np.vstack([T.real, T.imag])) @ -e.D])
    C = np.hstack([e.C, e.D, 0 * one])
    assert len(B) == n + 8
    beside = speed + eps * np.linspace(-40, 40, 401)
    omega = np.unique([*np.geomspace(3.0, 0.98 * np.pi / e.dt, 1500), *beside])
    S = frequency_response(StateSpace(A, B, C, -e.D, dt=e.dt), omega).values
    return np.abs(np.einsum("waa->wa", S)).max()


def test_a_design_is_proved_and_leaves_the_forbidden_band_out(designed, flywheel):
    bands = [block.band for block in designed.blocks]
    assert len(bands) == 2
    assert bands[0][1] < 404  # over the tolerances of k_s, too
    assert bands[1][0] > 447
    (left,) = designed.forbidden
    assert left.replacement == "off"
    assert "without bound" in str(left) or "um" in str(left)
    assert np.degrees(designed.angle) > 80
    checks = check_block(block_loops(*flywheel, designed.blocks[1:])[0])
    assert checks.passed
    assert "proved at every speed" in checks["synchronous.margin"].detail
    assert "whole box" in checks["synchronous.margin.box"].detail
    assert checks["synchronous.current"].value < -100
    assert checks["synchronous.time"].value == pytest.approx(
        designed.blocks[1].time_constant, rel=0.05
    )
    assert checks["synchronous.sensitivity"].value < 1.7
    curves = {curve.name.removeprefix("synchronous."): curve for curve in checks.curves}
    assert set(curves) == {"margin", "orbit_0p", "current_0p", "force_0p", "sensitivity"}
    # what it costs in S beside the speed: before, after, and the largest is what is judged
    _, on = curves["sensitivity"].y
    assert on.max() == checks["synchronous.sensitivity"].value
    # against the exact loop at even speeds between those that were looked at
    block = designed.blocks[1]
    (item,) = block_loops(*flywheel, (block,))
    own = []
    for w in np.linspace(*block.band, 21):
        T, eps = item.table.at(w), block.gain
        own.append(own_sensitivity(item.loop, w, T, eps))
    drawn = np.interp(np.linspace(*block.band, 21), curves["sensitivity"].x, on)
    assert drawn == pytest.approx(own, rel=0.01)
    assert on.max() >= max(own) * (1 - 1e-3)
    assert curves["sensitivity"].limits == (("limit", checks["synchronous.sensitivity"].limit),)


def test_a_leak_leaves_what_the_exact_loop_leaves(loop, designed):
    """e with the block settled over e without, from the converged phasors and from the exact
    sampled loop at the speed itself.
    """
    from ambrose.annexes.synchronous.block_loop import block_table

    speed, eps, leak = 600.0, 2.0, 0.05
    T = block_table(designed.blocks[1], loop.machine).at(speed)
    leaking = replace(designed.blocks[1], leak=leak, time_constant=2 / eps)
    item = next(iter(block_loops(loop.machine, loop.law, (leaking,))))
    settled, alone = (
        item.converged(speed, REST),
        loop.converged(None, speed, REST, forward_patterns(loop.machine)),
    )
    before, after = alone.y, settled.y - settled.c
    blocks = (resonator(loop, "current-free", T, speed, eps, leak),)
    on, off = (
        sensitivity(frozen(loop, speed, REST), some, np.array([speed]))[0] for some in (blocks, ())
    )
    expected = on @ np.linalg.solve(off, before)
    assert np.linalg.norm(after - expected) < 0.01 * np.linalg.norm(after)
    assert 0.01 < np.linalg.norm(after) / np.linalg.norm(before) < 0.2
    assert np.linalg.norm(settled.u) > 0.01 * np.linalg.norm(alone.u)


def test_the_plain_notch_is_refused_with_where_it_is_unstable_and_what_would_be_stable(flywheel):
    item = block_loops(*flywheel, (Synchronous("current-free", (400.0, 520.0), 1.0),))[0]
    checks = check_block(item)
    margin = checks["synchronous.margin"]
    assert margin.passed is False
    assert "unstable for every gain at 400" in margin.detail
    assert "stable 437.55 to 520 rad/s" in margin.detail
    assert "S^-1" in margin.detail
    assert "contains a forbidden speed" in checks["synchronous.orbit_0p"].detail


def test_a_gain_beyond_the_exact_poles_is_refused(flywheel, designed):
    with pytest.raises(InvalidInput, match="too near to instability with the block"):
        design_synchronous(*flywheel, band=(600.0, 640.0), time_constant=1e-3)
    hot = replace(designed.blocks[1], time_constant=1e-3)
    checks = check_block(block_loops(*flywheel, (hot,))[0])
    assert checks["synchronous.gain"].passed is False


def test_a_band_in_which_nothing_is_left_and_an_unstable_loop_are_refused(flywheel):
    machine, law = flywheel
    with pytest.raises(InvalidInput, match="no band is left"):
        design_synchronous(machine, law, band=(420.0, 430.0))
    lazy = StateSpace(law.A, law.B, 0.05 * law.C, 0.05 * law.D, law.inputs, law.outputs)
    with pytest.raises(InvalidInput, match="without a synchronous block"):
        design_synchronous(machine, lazy, band=(600.0, 640.0))
    with pytest.raises(InvalidInput, match="must be one of current-free"):
        design_synchronous(machine, law, "loud")


def test_the_sensitivity_with_the_block_has_a_zero_at_the_speed_and_is_that_of_the_closed_loop(
    loop, designed
):
    from ambrose.annexes.synchronous.block_loop import block_table

    speed, eps = 600.0, 12.0
    T = block_table(designed.blocks[1], loop.machine).at(speed)
    omega = np.array([100.0, speed - 3.0, speed, speed + 5.0, 2500.0])
    blocks = (resonator(loop, "current-free", T, speed, eps),)
    on = sensitivity(frozen(loop, speed, REST), blocks, omega)
    assert np.abs(on[2]).max() < 1e-9
    e = select(loop.sampled(speed, REST), None, loop.reads("current-free"))
    A, n = with_resonator(e, T, speed, eps), e.n_states
    turn = speed * e.dt
    rotation = np.kron([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]], np.eye(4))
    B = np.vstack([-e.B, rotation @ (eps * e.dt * np.vstack([T.real, T.imag])) @ -e.D])
    C = np.hstack([e.C, e.D, np.zeros((4, 4))])
    for k, w in enumerate(omega):
        exact = C @ np.linalg.solve(np.exp(1j * w * e.dt) * np.eye(n + 8) - A, B) - e.D
        assert on[k] == pytest.approx(exact, abs=1e-8)


def test_blocks_survive_a_controller_file_and_are_verified_from_it(flywheel, designed, tmp_path):
    _, law = flywheel
    path = write_controller(tmp_path / "c.json", Synthesis(law, synchronous=designed.blocks))
    again = read_controller(path)
    assert again.synchronous == designed.blocks
    text = path.read_text().replace('"mode": "current-free"', '"mode": "loud"', 1)
    (tmp_path / "bad.json").write_text(text)
    with pytest.raises(InvalidInput, match="loud"):
        read_controller(tmp_path / "bad.json")


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "expected"),
    [("overhung-blower", 637.6), ("turbomolecular-pump", 1481.7), ("process-compressor", 210.9)],
)
def test_borders_of_the_plain_notch_on_other_machines_against_exact_poles(name, expected):
    machine, law = controlled(name)
    loop, at = synchronous_loop(machine, law), conditions(machine)[0]
    top, one = machine.operation.design.speed, np.eye(len(machine.axes))
    value = lambda w: float(convergence(one, loop.response("current-free", w, at)))  # noqa: E731
    border = borders(value, np.linspace(0.02, 1, 25) * top)[-1]
    assert border.value == pytest.approx(expected, rel=1e-3)
    assert outermost(loop, 1.01 * border.value, at) < 0 < outermost(loop, 0.99 * border.value, at)


@pytest.mark.study
def test_attack_on_the_proof_with_random_tables_gains_and_members(loop):
    """10^3 random T, eps and members: none is proved over its interval and unstable at a speed in
    it.
    """
    rng = np.random.default_rng(11)
    spans = [(a, a + 30.0) for a in np.linspace(480, 900, 8)]
    pencils = [loop_pencils(loop, REST, *span, None) for span in spans]
    names = [t.parameter for t in pencils[0].tolerances]
    proved = unstable = 0
    for k in range(1000):
        low, high = spans[k % len(spans)]
        inverse = np.linalg.inv(loop.response("current-free", (low + high) / 2, REST))
        spread = rng.uniform(0, 1.2)
        T = inverse @ (
            np.eye(4)
            + spread * (rng.standard_normal((4, 4)) + 1j * rng.standard_normal((4, 4))) / 2
        )
        shown = prove_interval(pencils[k % len(spans)], lambda w, T=T: T, (), low, high).proved
        member = Condition(
            0.0, tuple(zip(names, rng.uniform(-1, 1, len(names)).tolist(), strict=True))
        )
        stable = outermost(loop, rng.uniform(low, high), member, T, 10 ** rng.uniform(-3, -1)) < 0
        proved, unstable = proved + shown, unstable + (not stable)
        assert stable or not shown
    assert proved > 100
    assert unstable > 100
