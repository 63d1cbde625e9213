"""Damping as people state it, and materials by name, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import poles
from ambrose.machine.file.toml import dumps_machine, load_machine, loads_machine
from ambrose.machine.file.update import machine_text
from ambrose.machine.part import MATERIALS, BendingMode
from ambrose.model.effects.rotor import finite_element_rotor, free_modes
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
