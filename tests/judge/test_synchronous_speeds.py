"""Synchronous blocks between the speeds of a grid: the judge's search against sampled loops of this
file's own, on random rotors.

The own loop has the matrices of the plant, affine in the speed, and nothing else of the product:
the hold by ``expm`` of the augmented matrix, the PID by Tustin's rule, one sample of delay as
states, and every block as (Re w, Im w), w+ = exp(j W Ts) (w + eps Ts D s), written out here.
"""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.linalg import expm

from ambrose.annexes.synchronous import block_checks
from ambrose.annexes.synchronous.block_checks import block_loops, member_margins
from ambrose.annexes.synchronous.block_design import design_synchronous
from ambrose.annexes.synchronous.block_gain import usable_tables
from ambrose.annexes.synchronous.block_loop import BlockTable, Condition, block_of, synchronous_loop
from ambrose.annexes.synchronous.speeds import Resonator, growth
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace
from ambrose.law.pid import pid_controller
from ambrose.machine.file.toml import loads_machine

REST = Condition(0.0)
DT = 2.5e-5

MACHINE = """
[machine]
schema = 1
name = "tip"
description = "A rotor with an overhung tip"
beam_theory = "timoshenko"
modal_damping = {damping}
[machine.assumed]
"bearing" = "made up"
[material.steel]
density = 7810
youngs_modulus = "211 GPa"
poisson_ratio = 0.3
[[shaft]]
length = "{length} mm"
outer_diameter = "{diameter} mm"
elements = 2
material = "steel"
[[shaft]]
length = "{neck} mm"
outer_diameter = "{thin} mm"
elements = 1
material = "steel"
[[disc]]
name = "tip"
position = "{end} mm"
mass = {mass}
polar_inertia = {polar}
diametral_inertia = {diametral}
[[bearing]]
name = "A"
position = "{a} mm"
bias_current = "3 A"
force_per_current = "200 N/A"
negative_stiffness = "0.5 N/um"
gap = "0.6 mm"
touchdown_gap = "0.3 mm"
[[bearing]]
name = "B"
position = "{b} mm"
bias_current = "3 A"
force_per_current = "200 N/A"
negative_stiffness = "0.5 N/um"
gap = "0.6 mm"
touchdown_gap = "0.3 mm"
[[sensor]]
bearing = "A"
position = "{sensor_a} mm"
bandwidth = "20 kHz"
[[sensor]]
bearing = "B"
position = "{sensor_b} mm"
bandwidth = "20 kHz"
[amplifier]
order = "first"
bandwidth = "4 kHz"
[controller]
gain = "{gain} A/mm"
integral_time = "200 ms"
derivative_time = "3 ms"
derivative_filter = 0.05
sample_time = "25 us"
[operation]
speed_range = ["0 rad/s", "1000 rad/s"]
[[operation.point]]
label = "full speed"
speed = "1000 rad/s"
[[tolerance]]
parameter = "bearing.A.negative_stiffness"
relative = "10 %"
[requirements]
sensitivity_peak = 3.0
balance_grade = "2.5 mm/s"
balance_speed = "1000 rad/s"
unbalance_orbit = "100 um"
unbalance_to = "1000 rad/s"
"""

# 17 kg between the bearings and 1.5 kg on a thin neck: antiresonances at 676 and 719 rad/s
TIP = dict(
    damping=0.003, length=500, diameter=74, neck=180, thin=19.9, end=680, mass=1.5,
    polar=0.0015, diametral=0.0008, a=60, b=440, sensor_a=60, sensor_b=440, gain=8,
)  # fmt: skip


def random_rotor(rng):
    """A rotor with random journals, sensors off the magnets, and a tip that may be heavy or
    stiff.
    """
    length, neck = int(rng.integers(350, 600)), int(rng.integers(60, 240))
    inertia = float(10 ** rng.uniform(-3.2, -2))
    a, b = int(rng.integers(30, 90)), length - int(rng.integers(30, 90))
    return dict(
        damping=round(float(10 ** rng.uniform(-2.8, -2)), 4), length=length,
        diameter=int(rng.integers(50, 80)), neck=neck, thin=int(rng.integers(14, 40)),
        end=length + neck, mass=round(float(rng.uniform(0.3, 3.0)), 2),
        polar=round(float(rng.uniform(0.5, 1.9) * inertia), 6), diametral=round(inertia, 6),
        a=a, b=b, sensor_a=a - int(rng.integers(0, 25)), sensor_b=b + int(rng.integers(0, 25)),
        gain=round(float(rng.uniform(6, 12)), 1),
    )  # fmt: skip


def rotor(values):
    machine = loads_machine(MACHINE.format(**values))
    return machine, pid_controller(machine.reference, machine)


@dataclass
class OwnLoop:
    """Plant matrices A + W G, B, C of u and y, and the PID's, for the loop that is built here."""

    A: np.ndarray
    G: np.ndarray
    B: np.ndarray
    C: np.ndarray
    K: tuple

    @classmethod
    def of(cls, machine, law, condition=REST):
        loop = synchronous_loop(machine, law)
        first, second, third = (loop.plant(w, condition) for w in (100.0, 1000.0, 550.0))
        u, y = first.named("u"), first.named("y")
        system = first.system
        columns = [system.inputs.index(name) for name in u]
        rows = [system.outputs.index(name) for name in y]
        G = (second.system.A - system.A) / 900.0
        A = system.A - 100.0 * G
        assert np.abs(A + 550.0 * G - third.system.A).max() <= 1e-9 * np.abs(A).max()
        # Tustin: x+ = (1 - A h)^-1 (1 + A h) x + ..., h = Ts/2
        h, one = DT / 2, np.eye(len(law.A))
        inverse = np.linalg.inv(one - h * law.A)
        K = (
            inverse @ (one + h * law.A),
            inverse @ law.B * DT,
            law.C @ inverse,
            law.D + law.C @ inverse @ law.B * h,
        )
        return cls(A, G, system.B[:, columns], system.C[rows], K)

    def from_c(self, speed, mode):
        """The loop without the block, from c to what it reads: A, B, C, D, of the states (x, u of
        the last sample, x_k).
        """
        n, a = self.B.shape
        held = expm(DT * np.block([[self.A + speed * self.G, self.B], [np.zeros((a, n + a))]]))
        Ak, Bk, Ck, Dk = self.K
        k = len(Ak)
        x, late, inner = slice(0, n), slice(n, n + a), slice(n + a, n + a + k)
        A, B = np.zeros((n + a + k, n + a + k)), np.zeros((n + a + k, a))
        # y = C x, e = y - c, u = K (-e)
        y, u = np.zeros((a, n + a + k)), np.zeros((a, n + a + k))
        y[:, x] = self.C
        u[:, x], u[:, inner] = -Dk @ self.C, Ck
        A[x, x], A[x, late] = held[:n, :n], held[:n, n:]
        A[late], B[late] = u, Dk
        A[inner, x], A[inner, inner], B[inner] = -Bk @ self.C, Ak, Bk
        nothing, one = np.zeros((a, a)), np.eye(a)
        C, D = {
            "current-free": (y, -one),
            "force-free": (np.vstack([y, u]), np.vstack([nothing, Dk])),
        }.get(mode, (y, nothing))
        return A, B, C, D

    def signals(self, speed, mode):
        """From c to minus what the block reads, at 1x."""
        A, B, C, D = self.from_c(speed, mode)
        z = np.exp(1j * speed * DT)
        return -(C @ np.linalg.solve(z * np.eye(len(A)) - A, B) + D)

    def matrix(self, speed, D, eps, mode):
        """The whole loop with the block on: those states, then Re w, Im w."""
        A, B, C, through = self.from_c(speed, mode)
        m, a = B.shape
        # c = Re w,  w+ = exp(j W Ts) (w + eps Ts D s)
        w = np.hstack([np.zeros((a, m)), np.eye(a), 1j * np.eye(a)])
        read = np.hstack([C, through, np.zeros((len(C), a))])
        after = np.exp(1j * speed * DT) * (w + eps * DT * (D @ read))
        return np.vstack([np.hstack([A, B, np.zeros((m, a))]), after.real, after.imag])

    def growth(self, speed, D, eps, mode):
        z = np.linalg.eigvals(self.matrix(speed, D, eps, mode))
        return float(np.log(np.abs(z).max()) / DT)


def inverse_block(machine, law, mode, band, knots, time_constant):
    """T = R^-1 at a few speeds, unit convergence there: what a design that looks at them makes."""
    loop = synchronous_loop(machine, law)
    speeds = np.linspace(*band, knots)
    T = np.array([np.linalg.inv(loop.response(mode, float(w), REST)) for w in speeds])
    return block_of(mode, band, time_constant, BlockTable(speeds, T))


def own_growths(machine, law, item, speeds, condition=REST):
    own = OwnLoop.of(machine, law, condition)
    eps = item.block.gain
    return np.array(
        [own.growth(float(w), item.running.at(float(w)), eps, item.mode) for w in speeds]
    )


@pytest.fixture(scope="module")
def tip():
    return rotor(TIP)


def test_an_antiresonance_between_the_speeds_of_a_table_is_found(tip):
    """The design's own T over the antiresonances at 676 and 719 rad/s: unstable between the speeds
    that were looked at before.
    """
    machine, law = tip
    band = (600.0, 800.0)
    loop = synchronous_loop(machine, law)
    ((_, table, refused),) = usable_tables(loop, "vibration-free", band, (REST,))
    assert refused is None
    block = block_of("vibration-free", band, 0.1, table)
    (item,) = block_loops(machine, law, (block,))
    few = own_growths(machine, law, item, np.linspace(600, 800, 4))
    fine = own_growths(machine, law, item, np.linspace(600, 800, 61))
    assert few.max() < 0
    assert fine.max() > 10
    found = item.survey(item.conditions)
    check = block_checks._gain_check(item, found)
    assert check.passed is False
    place = found.least_stable
    assert "refined" in check.title
    assert f"{found.count} speeds" in check.title
    (own,) = own_growths(machine, law, item, [place.look.speed])
    assert place.growth == pytest.approx(own, rel=1e-5)
    sensitivity = block_checks._sensitivity_check(item, found)
    assert sensitivity.passed is False


def test_a_band_of_antiresonances_is_refused_with_cause_and_remedy(tip):
    cause = "antiresonance at the sensors at 67.*use current-free there, or no block"
    with pytest.raises(InvalidInput, match=cause):
        design_synchronous(*tip, "vibration-free", band=(640.0, 715.0))


@pytest.mark.study
def test_a_design_leaves_the_antiresonances_out_and_passes(tip):
    machine, law = tip
    design = design_synchronous(machine, law, "vibration-free", band=(400.0, 1000.0))
    assert sum("antiresonance at the sensors" in item.reason for item in design.forbidden) == 2
    assert len(design.blocks) >= 2
    for item in block_loops(machine, law, design.blocks):
        speeds = np.linspace(*item.block.band, 41)
        assert own_growths(machine, law, item, speeds).max() < 0
        for corner in item.corners():
            assert own_growths(machine, law, item, speeds, corner).max() < 0
        found = item.survey(item.conditions)
        assert block_checks._gain_check(item, found).passed
        assert block_checks._time_check(item, found, None).passed


def test_a_block_that_never_settles_fails(tip):
    machine, law = tip
    block = inverse_block(machine, law, "current-free", (700.0, 800.0), 5, 1e9)
    (item,) = block_loops(machine, law, (block,))
    found = item.survey(item.conditions)
    check = block_checks._time_check(item, found, None)
    assert check.passed is False
    assert check.value == pytest.approx(1e9, rel=0.1)
    quick = replace(item, block=replace(block, time_constant=0.5))
    assert block_checks._time_check(quick, found, None).passed is True
    # 100 rad/s at 100 rad/s^2 leave one second
    assert block_checks._time_check(quick, found, 100.0).passed is False


def test_a_block_that_moves_once_a_turn_beside_another_is_judged_as_it_runs():
    """At 1x once a turn, at 2x with every sample, run sample by sample: what would settle if both
    moved with every sample grows.
    """
    rng = np.random.default_rng(3)
    A = rng.standard_normal((5, 5))
    A *= 0.8 / np.abs(np.linalg.eigvals(A)).max()
    system = StateSpace(
        A, rng.standard_normal((5, 2)), rng.standard_normal((2, 5)), 0.3 * np.eye(2), dt=1e-3
    )
    samples, dt = 40, 1e-3
    speed = 2 * np.pi / (samples * dt)

    def inverse(n):
        inner = np.exp(1j * n * speed * dt) * np.eye(5) - A
        return -np.linalg.inv(system.C @ np.linalg.solve(inner, system.B) + system.D)

    D1, D2 = inverse(1), inverse(2)
    for gain, settles in ((10.0, True), (100.0, False)):
        x, w = np.zeros(5), np.array([1.0, 1j])
        a, m, sizes = np.array([1.0, 0.5j]), np.zeros(2, complex), []
        for _ in range(600):
            a, total = a + gain * samples * dt * m, np.zeros(2, complex)
            for k in range(samples):
                turn = np.exp(1j * speed * dt * k)
                c = (turn * a).real + w.real
                s = system.C @ x + system.D @ c
                total += D1 @ s / turn
                w = np.exp(2j * speed * dt) * (w + 5.0 * dt * (D2 @ s))
                x = A @ x + system.B @ c
            m = total / samples
            sizes.append(np.abs(a).max() + np.abs(w).max())
        own = np.log(max(sizes[550:]) / max(sizes[250:300])) / (300 * samples * dt)
        assert (own < 0) == settles
        blocks = (
            Resonator(D1, speed, gain, turn=samples * dt),
            Resonator(D2, 2 * speed, 5.0),
        )
        for order in (blocks, blocks[::-1]):
            assert growth(system, order) == pytest.approx(own, abs=0.01)
        assert growth(system, (replace(blocks[0], turn=0.0), blocks[1])) < 0


def random_item(seed, mode):
    """A random rotor with a stable loop, its own loop, and a block of a table with few speeds."""
    rng = np.random.default_rng([51, seed])
    while True:
        machine, law = rotor(random_rotor(rng))
        own = OwnLoop.of(machine, law)
        nothing = np.zeros((4, 4))
        if max(own.growth(w, nothing, 0.0, "current-free") for w in (1.0, 500.0, 1000.0)) < 1e-6:
            break
    low = float(rng.uniform(150, 800))
    band = (low, low + float(rng.uniform(60, 200)))
    block = inverse_block(machine, law, mode, band, int(rng.integers(2, 9)), 0.5)
    return machine, law, block_loops(machine, law, (block,))[0]


def angle_and_pace(own, item, speeds):
    """The smallest angle [rad] and real part of the eigenvalues of D R at speeds."""
    found = [
        np.linalg.eigvals(item.running.at(float(w)) @ own.signals(float(w), item.mode))
        for w in speeds
    ]
    return np.pi / 2 - np.abs(np.angle(found)).max(), np.real(found).min()


def judged_angle_and_pace(seed):
    """What the judge finds and what a fine grid finds: the angle of the worst of two members, and
    how slow the slowest direction is, over the size of D R.
    """
    machine, law, item = random_item(seed, MODES[seed % 3])
    speeds = np.linspace(*item.block.band, 401)
    member = member_margins(item, 2, seed)
    angle, _ = angle_and_pace(OwnLoop.of(machine, law, member.condition), item, speeds)
    slowest = item.survey(item.conditions).slowest
    _, pace = angle_and_pace(OwnLoop.of(machine, law), item, speeds)
    return member.value, angle, slowest.value, pace


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_members_and_the_slowest_direction_are_worst_over_the_whole_band(seed):
    found, angle, slowest, pace = judged_angle_and_pace(seed)
    assert found <= angle + np.radians(0.2)
    assert slowest <= pace + 1e-3


@pytest.mark.study
def test_members_and_the_slowest_direction_of_sixty_random_rotors():
    found = np.array([judged_angle_and_pace(seed) for seed in range(60)])
    print(np.degrees(found[:, 0] - found[:, 1]).max(), (found[:, 2] - found[:, 3]).max())
    assert (found[:, 0] <= found[:, 1] + np.radians(0.2)).all()
    assert (found[:, 2] <= found[:, 3] + 1e-3).all()


MODES = "vibration-free", "current-free", "force-free", "damping"


def greens_and_reds(seed):
    """(green by the judge, red by the own loop on a fine grid), each without tolerances and over
    them; None where the rotor has no stable loop to begin with.
    """
    rng = np.random.default_rng([49, seed])
    while True:
        machine, law = rotor(random_rotor(rng))
        own = OwnLoop.of(machine, law)
        nothing = np.zeros((4, 4))
        growths = [own.growth(w, nothing, 0.0, "current-free") for w in (1.0, 500.0, 1000.0)]
        if max(growths) < 1e-6:  # the resonators of a block that does nothing stay on the circle
            break
    mode = MODES[seed % 4]
    low = float(rng.uniform(150, 800))
    band = (low, low + float(rng.uniform(60, 200)))
    eps = float(low * 10 ** rng.uniform(-2.5, -0.7))
    block = inverse_block(machine, law, mode, band, int(rng.integers(2, 18)), 2 / eps)
    if mode == "damping":
        block = replace(block, leak=1e-12)
    (item,) = block_loops(machine, law, (block,))
    speeds = np.linspace(*band, 121)
    corners = item.corners()
    green = block_checks._gain_check(item, item.survey(item.conditions)).passed
    boxed = item.survey(corners, members=True)
    green_box = block_checks._gain_check(item, boxed, len(corners)).passed
    red = own_growths(machine, law, item, speeds).max() > 0
    red_box = max(own_growths(machine, law, item, speeds, c).max() for c in corners) > 0
    return bool(green), bool(red), bool(green_box), bool(red_box)


@pytest.mark.parametrize("seed", [10, 11])  # a green one and a red one
def test_no_random_rotor_is_green_where_a_fine_grid_is_not(seed):
    green, red, green_box, red_box = greens_and_reds(seed)
    assert not (green and red)
    assert not (green_box and red_box)


@pytest.mark.study
def test_two_hundred_random_rotors():
    found = np.array([greens_and_reds(seed) for seed in range(200)])
    green, red, green_box, red_box = found.T
    print(f"green {green.sum()}, red {red.sum()}; box {green_box.sum()}, {red_box.sum()}")
    assert not (green & red).any()
    assert not (green_box & red_box).any()
    assert red.sum() > 5
    assert green.sum() > 50
