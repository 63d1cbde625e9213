"""Damping as people state it, and materials by name, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import poles
from ambrose.judge.campbell import threshold_speed
from ambrose.machine.file.toml import dumps_machine, load_machine, loads_machine
from ambrose.machine.file.update import machine_text
from ambrose.machine.part import MATERIALS, BendingMode
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_modes,
    rotating_force,
    turn_over_speeds,
)
from ambrose.rig.engine.state import build
from coarse import coarse

RIG = coarse("overhung-blower")


def soft(**damping):
    """The rotor all but free: magnets a millionth as strong, so that poles are those of free
    modes.
    """
    bearings = tuple(
        replace(
            b,
            geometry=None,
            magnet=None,
            force_per_current=(1e-3,) * 2,
            negative_stiffness=(1e-3,) * 2,
        )
        for b in RIG.bearings
    )
    whole = replace(RIG, bearings=bearings, seals=(), couplings=(), tolerances=(), bending_modes=())
    return replace(whole, gravity_direction=None, **damping)


@pytest.mark.parametrize(
    ("damping", "ratio"),
    [
        ({}, lambda w: 0.005 + 0 * w),
        ({"rayleigh_alpha": 3.0}, lambda w: 3.0 / (2 * w)),
        ({"rayleigh_beta": 4e-6}, lambda w: 4e-6 * w / 2),
        (
            {"rayleigh_alpha": 2.0, "rayleigh_beta": 1e-6, "loss_factor": 0.006},
            lambda w: 2.0 / (2 * w) + 1e-6 * w / 2 + 0.003,
        ),
    ],
)
def test_poles_of_the_plant_and_of_the_rig_have_the_ratio_of_the_closed_form(damping, ratio):
    machine = soft(**damping)
    rotor = finite_element_rotor(machine)
    w = free_modes(rotor, 3).frequencies[4::2]
    plant = amb.assemble(machine, replace(machine.operation.nominal, speed=0.0))
    found = poles(plant.rotor)
    for frequency, zeta in zip(w, ratio(w), strict=True):
        near = found[np.argmin(abs(abs(found) - frequency) + 1e9 * (found.imag <= 0))]
        # zeta = alpha/2w + beta w/2; half a loss factor
        assert -near.real / abs(near) == pytest.approx(zeta, rel=2e-4)
    constants = build(machine, bending_modes=3).constants
    np.testing.assert_allclose(constants.damping[2:], 2 * ratio(w) * w, rtol=1e-12)
    assert not constants.damping[:2].any()


# A light shaft on rigid bearings with a disc in its middle: Jeffcott's rotor, c_i = beta k inside.
LENGTH, DIAMETER, MASS = 1.0, 0.02, 5.0
STIFFNESS = 48 * 210e9 * np.pi * DIAMETER**4 / 64 / LENGTH**3
NATURAL = np.sqrt(STIFFNESS / MASS)


def jeffcott(outside, **damping):
    ends = [
        f"[[journal_bearing]]\nname = '{name}'\nposition = {at}\nK_xx = {k}\nK_yy = {k}\n"
        f"C_xx = {c}\nC_yy = {c}\n"
        for name, at, k, c in (("a", 0, 1e12, 0), ("b", LENGTH, 1e12, 0), ("c", 0.5, 0, outside))
    ]
    machine = loads_machine(
        f"""[machine]
schema = 1
name = "jeffcott"
[material.light]
density = 1.0
youngs_modulus = "210 GPa"
[[shaft]]
length = {LENGTH}
outer_diameter = {DIAMETER}
elements = 8
material = "light"
[[disc]]
name = "disc"
position = {LENGTH / 2}
mass = {MASS}
polar_inertia = 1e-6
diametral_inertia = 1e-6
{"".join(ends)}
[[operation.point]]
label = "turning"
speed = 100
"""
    )
    return replace(machine, **damping)


def whirl(machine, speed, near):
    """The pole of the plant's rotor that grows most, of those around a frequency [rad/s]."""
    plant = amb.assemble(machine, replace(machine.operation.nominal, speed=speed))
    found = poles(plant.rotor)
    found = found[(found.imag > near / 2) & (found.imag < 2 * near)]
    return found[found.real.argmax()]


@pytest.mark.parametrize("share", [1.0, 0.5])
@pytest.mark.parametrize(("beta", "outside"), [(1e-4, 0.0), (1e-4, 10.0), (2e-4, 30.0)])
def test_the_threshold_speed_of_a_jeffcott_rotor_is_that_of_the_closed_form(beta, outside, share):
    """w (1 + c_e/c_i), Genta, Dynamics of Rotating Systems, 2005, sec. 3.3: what does not turn of
    beta K is outside, too.
    """
    machine = jeffcott(outside, rayleigh_beta=beta, rotating_share=share)
    inside, outside = share * beta * STIFFNESS, outside + (1 - share) * beta * STIFFNESS
    expected = NATURAL * (1 + outside / inside)
    found, _ = threshold_speed(
        lambda w: amb.assemble(machine, replace(machine.operation.nominal, speed=w)).rotor,
        0.0,
        2 * expected,
    )
    assert found == pytest.approx(expected, rel=1e-4)
    pole = whirl(machine, 3 * expected, NATURAL)
    # z = x + j y: m s^2 + (c_e + c_i) s + k - j W c_i = 0
    equation = [MASS, outside + inside, STIFFNESS - 3j * expected * inside]
    exact = np.roots(equation)
    np.testing.assert_allclose(pole, exact[exact.imag.argmax()], rtol=1e-4)
    # without it no speed is unstable, and at rest nothing changes
    still = replace(machine, rotating_share=0.0)
    assert whirl(still, 3 * expected, NATURAL).real < 0
    np.testing.assert_allclose(whirl(machine, 0.0, NATURAL), whirl(still, 0.0, NATURAL), rtol=1e-9)


def test_hysteretic_damping_that_turns_drives_what_whirls_slower_than_the_spin():
    """+eta/2 of the mode below its frequency, -eta/2 above, at any speed, +eta/2 backward."""
    machine = replace(soft(loss_factor=0.01, rotating_share=1.0), discs=())
    w = free_modes(finite_element_rotor(machine), 1).frequencies[-1]
    for speed, forward in ((0.0, 0.005), (0.9 * w, 0.005), (1.1 * w, -0.005), (2.0 * w, -0.005)):
        plant = amb.assemble(machine, replace(machine.operation.nominal, speed=speed))
        found = poles(plant.rotor)
        first = found[(found.imag > 0.7 * w) & (found.imag < 1.4 * w)]
        # parted by the gyroscopic moments, s^2 - j W g s + w^2 = 0 at s = j v: what eta w s and
        # -+ j eta w^2 add, over 2 s - j W g = j (v^2 + w^2)/v and over v
        first = first[first.imag.argsort()]
        v = first.imag
        expected = np.array([0.005, forward]) * 2 * w * (w if forward < 0 else v) / (v**2 + w**2)
        np.testing.assert_allclose(-first.real / np.abs(first), expected, rtol=0.01)
    knots = np.array(sorted(turn_over_speeds(machine, 1.5 * w)))
    np.testing.assert_allclose(knots / w, np.repeat([0.98, 1.0, 1.02], 2)[::2], rtol=1e-12)


def test_rig_and_plant_have_the_same_circulatory_force():
    machine = soft(rayleigh_beta=2e-6, loss_factor=0.004, rotating_share=0.6)
    modes = free_modes(finite_element_rotor(machine), 3)
    rotating = build(machine, bending_modes=3).constants.rotating
    w, place, velocity = modes.frequencies[4::2], (1e-6, -2e-6), (3e-3, 1e-3)
    for speed in (0.0, 500.0, w[0], 1.01 * w[0], 2 * w[0], 3 * w[2]):
        c, k = modes.damping(machine, speed)
        still, _ = modes.damping(machine, 0.0)
        for i, known in enumerate(rotating[2:]):
            fx, fy = rotating_force(place, velocity, speed, w[i], tuple(known))
            j = 4 + 2 * i
            expected = (still - c)[j] * np.array(velocity) - k[j] * np.array([place[1], -place[0]])
            np.testing.assert_allclose([fx, fy], expected, rtol=1e-12)
            assert still[j] == pytest.approx(2e-6 * w[i] ** 2 + 0.004 * w[i], rel=1e-12)
            # by hand: viscous W c, hysteretic eta w^2 from 1.02 w on
            turned = np.clip((speed / w[i] - 0.98) / 0.04, 0, 1)
            drives = 0.6 * (speed * 2e-6 * w[i] ** 2 + turned * 0.004 * w[i] ** 2)
            assert k[j] == pytest.approx(drives, rel=1e-9, abs=1e-12)


def test_a_measured_mode_keeps_its_own_damping():
    machine = replace(soft(loss_factor=0.01), bending_modes=(BendingMode(2, damping=0.02),))
    ratios = free_modes(finite_element_rotor(machine), 3).damping_ratios(machine)
    np.testing.assert_allclose(ratios[4:], [0.005, 0.005, 0.02, 0.02, 0.005, 0.005])


def test_the_file_keeps_it_and_says_what_cannot_be():
    machine = soft(rayleigh_alpha=2.0, rayleigh_beta=1e-6)
    assert loads_machine(dumps_machine(machine)) == machine
    with pytest.raises(InvalidInput, match=r"modal_damping is 0\.01, but must be left out beside"):
        replace(machine, modal_damping=0.01)
    with pytest.raises(InvalidInput, match=r"loss_factor is -0\.1, but must be 0 or more"):
        replace(machine, loss_factor=-0.1)
    with pytest.raises(InvalidInput, match=r"rotating_share is 1\.5, but must be from 0 to 1"):
        replace(machine, rotating_share=1.5)
    with pytest.raises(
        InvalidInput, match=r"rotating_share is 0\.5, .*rayleigh_alpha acts against"
    ):
        replace(machine, rayleigh_beta=0.0, rotating_share=0.5)
    with pytest.raises(InvalidInput, match=r"rotating_share is 1, but must be 0 where no damping"):
        soft(modal_damping=0.0, rotating_share=1.0)
    with pytest.raises(InvalidInput, match=r"loss_factor is 0\.01, .*state rayleigh_beta"):
        jeffcott(0.0, loss_factor=0.01, rotating_share=1.0)
    # of all that is not stated nothing changes: the text, and so the hash, of a file is the old one
    assert "rayleigh" not in dumps_machine(load_machine("seal-rig"))


def test_materials_by_name(tmp_path):
    assert MATERIALS["steel"] == load_machine("overhung-blower").shaft[0].material
    text = dumps_machine(RIG)
    head, _, rest = text.partition("[[shaft]]")
    named = loads_machine(f'{head}[[shaft]]\nmaterial = "Inconel 718"\n{rest.lstrip()}')
    material = named.shaft[0].material
    assert (material.density, material.youngs_modulus, material.poisson_ratio) == (8220, 2e11, 0.29)
    assert loads_machine(dumps_machine(named)) == named
    # a cantilever of it: w = (1.8751)^2 sqrt(E I/(m l^4)) scales with sqrt(E/rho)
    whole = replace(
        named, shaft=tuple(replace(s, material=material) for s in named.shaft), discs=()
    )
    steel = replace(
        whole, shaft=tuple(replace(s, material=MATERIALS["steel"]) for s in whole.shaft)
    )
    whole, steel = (
        free_modes(finite_element_rotor(replace(m, beam_theory="bernoulli-euler")), 1).frequencies[
            -1
        ]
        for m in (whole, steel)
    )
    assert whole / steel == pytest.approx(np.sqrt(200 / 8220 / (210 / 7850)), rel=1e-9)
    # an update keeps the name, and adds no table
    (tmp_path / "m.toml").write_text(f'{head}[[shaft]]\nmaterial = "Inconel 718"\n{rest.lstrip()}')
    kept = machine_text(replace(load_machine(tmp_path / "m.toml"), name="other"))
    assert 'material = "Inconel 718"' in kept and "[material" not in kept
    with pytest.raises(InvalidInput, match='did you mean "Inconel 718"'):
        loads_machine(f'{head}[[shaft]]\nmaterial = "Inconel718"\n{rest.lstrip()}')
