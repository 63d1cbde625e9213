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

from ambrose.core.checks import InvalidInput
from ambrose.judge import synchronous
from ambrose.judge.synchronous import block_loops
from ambrose.law.pid import pid_controller
from ambrose.law.synchronous import Condition, synchronous_loop
from ambrose.law.synchronous_table import BlockTable, block_of
from ambrose.machine.file.toml import loads_machine
from ambrose.synthesis.synchronous_design import design_synchronous
from ambrose.synthesis.synchronous_inverse import usable_tables

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

    def matrix(self, speed, D, eps, mode):
        """The whole loop with the block on: states (x, u of the last sample, x_k, Re w, Im w)."""
        n, a = self.B.shape
        held = expm(DT * np.block([[self.A + speed * self.G, self.B], [np.zeros((a, n + a))]]))
        Ak, Bk, Ck, Dk = self.K
        k = len(Ak)
        size = n + a + k + 2 * a
        x, late, inner = slice(0, n), slice(n, n + a), slice(n + a, n + a + k)
        re, im = slice(n + a + k, n + 2 * a + k), slice(n + 2 * a + k, size)
        # rows of signals over the states: y, c, e = y - c, u = K (-e)
        y, c = np.zeros((a, size)), np.zeros((a, size))
        y[:, x], c[:, re] = self.C, np.eye(a)
        u = -Dk @ (y - c)
        u[:, inner] += Ck
        whole = np.zeros((size, size))
        whole[x, x], whole[x, late] = held[:n, :n], held[:n, n:]
        whole[late] = u
        whole[inner] = -Bk @ (y - c)
        whole[inner, inner] += Ak
        read = {"current-free": y - c, "force-free": np.vstack([y, u])}.get(mode, y)
        moved = eps * DT * (D @ read)
        w = np.zeros((a, size), complex)
        w[:, re], w[:, im] = np.eye(a), 1j * np.eye(a)
        after = np.exp(1j * speed * DT) * (w + moved)
        whole[re], whole[im] = after.real, after.imag
        return whole

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
    check = synchronous._gain_check(item, found)
    assert check.passed is False
    place = found.least_stable
    assert "refined" in check.title
    assert f"{found.count} speeds" in check.title
    (own,) = own_growths(machine, law, item, [place.look.speed])
    assert place.growth == pytest.approx(own, rel=1e-5)
    sensitivity = synchronous._sensitivity_check(item, found)
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
        assert synchronous._gain_check(item, found).passed
        assert synchronous._time_check(item, found, None).passed


def test_a_block_that_never_settles_fails(tip):
    machine, law = tip
    block = inverse_block(machine, law, "current-free", (700.0, 800.0), 5, 1e9)
    (item,) = block_loops(machine, law, (block,))
    found = item.survey(item.conditions)
    check = synchronous._time_check(item, found, None)
    assert check.passed is False
    assert check.value == pytest.approx(1e9, rel=0.1)
    quick = replace(item, block=replace(block, time_constant=0.5))
    assert synchronous._time_check(quick, found, None).passed is True
    # 100 rad/s at 100 rad/s^2 leave one second
    assert synchronous._time_check(quick, found, 100.0).passed is False


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
    green = synchronous._gain_check(item, item.survey(item.conditions)).passed
    boxed = item.survey(corners, members=True)
    green_box = synchronous._gain_check(item, boxed, len(corners)).passed
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
