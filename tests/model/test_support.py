"""Supports under bearings and modes of the casing: plant, reduction, uncertainty, rig, and a model
assembled by hand.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.file.update import update_machine_file
from ambrose.machine.part import CasingMode, Support
from ambrose.model.assemble import assemble
from ambrose.model.effects import magnet
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.model.uncertainty import free_mode_reduction, modal_reduction, perturbed, reduce

RIG = load_machine("seal-rig")
STILL = OperatingPoint()
OMEGA = np.geomspace(5.0, 5e3, 40)
PEDESTALS = (
    Support("A", (80.0, 95.0), (6e7, 9e7), (3e3, 4e3)),
    Support("B", (120.0, 120.0), (2e8, 1.2e8), (5e3, 5e3), angle=0.3),
)
STOOD = replace(RIG, supports=PEDESTALS)


def poles(A):
    values = np.linalg.eigvals(A)
    return values[np.lexsort((values.real.round(3), values.imag.round(3)))]


def by_hand(machine, speed, sensors_move=True):
    """The rigid rotor on its magnets' negative stiffness and two pedestals: x, y, tilt about y and
    -x; then the pedestals.

    Newton's and Euler's equations written out: forces at the bearings pull at rotor and pedestal;
    A, C of the displacements of the rotor from its pedestals at the bearings in x and y.
    """
    body = mass_properties(finite_element_rotor(machine))
    arms = [b.position - body.centre for b in machine.bearings]
    # A_x A_y B_x B_y
    rotor = np.array([[1, 0, z, 0] for z in arms] + [[0, 1, 0, z] for z in arms], float)[
        [0, 2, 1, 3]
    ]
    turn = np.zeros((4, 4))
    k_mag = np.zeros((4, 4))
    k_ped = np.zeros((4, 4))
    c_ped = np.zeros((4, 4))
    m_ped = []
    for i, (b, s) in enumerate(zip(machine.bearings, machine.supports, strict=True)):
        own = slice(2 * i, 2 * i + 2)
        R = np.array([[np.cos(b.angle), np.sin(b.angle)], [-np.sin(b.angle), np.cos(b.angle)]])
        turn[own, own] = R
        k_mag[own, own] = R.T @ np.diag(magnet.linearised(b, None).negative_stiffness) @ R
        P = np.array([[np.cos(s.angle), np.sin(s.angle)], [-np.sin(s.angle), np.cos(s.angle)]])
        k_ped[own, own], c_ped[own, own] = (
            P.T @ np.diag(s.stiffness) @ P,
            P.T @ np.diag(s.damping) @ P,
        )
        m_ped.append(P.T @ np.diag(s.mass) @ P)
    N = np.hstack([rotor, -np.eye(4)])
    M = sla.block_diag(
        np.diag([body.mass, body.mass, body.diametral_inertia, body.diametral_inertia]), *m_ped
    )
    G = np.zeros((8, 8))
    G[2, 3], G[3, 2] = body.polar_inertia, -body.polar_inertia
    K = sla.block_diag(np.zeros((4, 4)), k_ped) - N.T @ k_mag @ N
    D = sla.block_diag(np.zeros((4, 4)), c_ped) + speed * G
    A = np.block([[np.zeros((8, 8)), np.eye(8)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    return A, turn @ N, M


def bare(machine):
    return replace(machine, seals=(), couplings=(), tolerances=())


@pytest.mark.parametrize("speed", [0.0, 300.0])
def test_a_rigid_rotor_on_two_pedestals_is_the_model_assembled_by_hand(speed):
    machine = bare(STOOD)
    plant = free_mode_reduction(assemble(machine, OperatingPoint(speed)), 0)
    A, C, M = by_hand(machine, speed)
    found, expected = poles(plant.rotor.A), poles(A)
    assert len(found) == 16
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    # displacement from the pedestal by a force between rotor and pedestal, and by one on the rotor
    # alone
    names = ["A_zeta", "A_eta", "B_zeta", "B_eta"]
    rotor = plant.rotor
    H = frequency_response(rotor, OMEGA).values
    at = [rotor.outputs.index(f"q_{n}") for n in names]
    for kind, rows in (("f", C), ("o", np.hstack([C[:, :4], np.zeros((4, 4))]))):
        B = np.vstack([np.zeros((8, 4)), np.linalg.solve(M, rows.T)])
        wide = np.array(
            [np.hstack([C, 0 * C]) @ np.linalg.solve(1j * w * np.eye(16) - A, B) for w in OMEGA]
        )
        mine = H[:, at][:, :, [rotor.inputs.index(f"{kind}_{n}") for n in names]]
        np.testing.assert_allclose(mine, wide, rtol=0, atol=1e-9 * np.abs(wide).max())


def test_forces_between_rotor_and_stator_are_reciprocal_and_pedestals_only_take_energy():
    machine = replace(STOOD, seals=tuple(replace(s, k=0.0) for s in STOOD.seals), tolerances=())
    rotor = assemble(bare(machine), STILL).rotor
    H = frequency_response(rotor, OMEGA).values
    between = H[:, [rotor.outputs.index(f"q_{n}") for n in ("A_zeta", "A_eta", "B_zeta", "B_eta")]][
        :, :, :4
    ]
    np.testing.assert_allclose(
        between, between.transpose(0, 2, 1), rtol=0, atol=1e-9 * np.abs(between).max()
    )
    power = (1j * OMEGA[:, None, None] * between).real  # of velocity over force
    passive = 0.5 * (power + power.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(passive).min() > -1e-9 * np.abs(passive).max()


def test_rigid_supports_are_none():
    stiff = tuple(replace(s, stiffness=(1e17, 1e17), damping=(1e6, 1e6)) for s in PEDESTALS)
    one, two = (assemble(item).system for item in (RIG, replace(RIG, supports=stiff)))
    H, G = (frequency_response(item, OMEGA).values for item in (two, one))
    np.testing.assert_allclose(H, G, rtol=1e-6, atol=1e-8 * np.abs(G).max())
    small, own = reduce(assemble(replace(RIG, supports=stiff)), 1), reduce(assemble(RIG), 1)
    assert small.rotor.n_states == own.rotor.n_states  # nothing that fast is kept


def test_soft_pedestals_change_the_rotor():
    """The limit above can fail."""
    one, two = (frequency_response(assemble(item).system, OMEGA).values for item in (RIG, STOOD))
    assert np.abs(one - two)[:, :4, :4].max() > 0.05 * np.abs(one[:, :4, :4]).max()


@pytest.mark.parametrize("modes", [0, 1, 3])
def test_the_reduction_keeps_the_supports(modes):
    full = assemble(STOOD)
    reduction = modal_reduction(full, modes)
    small = reduction.plant
    assert small.rotor.n_states == 8 + 4 * modes + 2 * 4
    slow = 2 * np.pi * 60
    omega = OMEGA[slow > OMEGA]
    H, G = (frequency_response(item.system, omega).values for item in (small, full))
    np.testing.assert_allclose(H[:, :4], G[:, :4], rtol=0, atol=2e-2 * np.abs(G[:, :4]).max())
    A = np.linalg.eigvals(small.rotor.A)
    whole = np.linalg.eigvals(full.rotor.A)
    gap = [np.abs(whole - value).min() for value in A]
    assert max(gap) < 1e-3 * np.abs(A).max()
    np.testing.assert_allclose(
        reduction.T_L @ reduction.T_R, np.eye(small.rotor.n_states), atol=1e-9
    )


def test_negative_stiffness_acts_on_the_motion_between_rotor_and_support():
    """A tolerance moves the plant as other coefficients do; with the stator's motion left out it
    would not.
    """
    name, path = "A", "bearing.A.negative_stiffness"
    tolerance = Tolerance(path, relative=0.1)
    moved = perturbed(assemble(STOOD), {path: 1.0}, (tolerance,))
    bearings = tuple(
        replace(
            b, negative_stiffness=tuple(k * (1 + tolerance.relative) for k in b.negative_stiffness)
        )
        if b.name == name
        else b
        for b in STOOD.bearings
    )
    direct = assemble(replace(STOOD, bearings=bearings))
    H, G = (frequency_response(item.system, OMEGA).values for item in (moved, direct))
    np.testing.assert_allclose(H, G, rtol=0, atol=1e-8 * np.abs(G).max())


def test_sensors_on_the_ground_see_the_rotor_and_not_the_gap():
    ground = replace(RIG, supports=tuple(replace(s, sensor="ground") for s in PEDESTALS))
    on, off = (frequency_response(assemble(item).rotor, OMEGA).values for item in (STOOD, ground))
    names = assemble(STOOD).rotor.outputs
    seen = [i for i, name in enumerate(names) if name.startswith("s_")]
    kept = [i for i, name in enumerate(names) if not name.startswith("s_")]
    np.testing.assert_array_equal(on[:, kept], off[:, kept])
    assert np.abs(on[:, seen] - off[:, seen]).max() > 1e-2 * np.abs(on[:, seen]).max()


def test_a_support_is_two_modes_of_a_casing():
    """The same mechanism: given as receptance modes, the pedestals are the same plant; so is a seal
    on them.
    """
    modes = []
    held = tuple(replace(s, seals=("center",) if s.bearing == "A" else ()) for s in PEDESTALS)
    for s in held:
        at = (s.bearing, *s.seals)
        for way in range(2):
            w = np.sqrt(s.stiffness[way] / s.mass[way])
            c, d = np.cos(s.angle + way * np.pi / 2), np.sin(s.angle + way * np.pi / 2)
            ratio = s.damping[way] / (2 * s.mass[way] * w)
            modes.append(
                CasingMode(
                    float(w), s.mass[way], at, (float(c),) * len(at), (float(d),) * len(at), ratio
                )
            )
    one, two = (
        assemble(item).system
        for item in (replace(RIG, supports=held), replace(RIG, casing_modes=tuple(modes)))
    )
    H, G = (frequency_response(item, OMEGA).values for item in (two, one))
    np.testing.assert_allclose(H, G, rtol=0, atol=1e-9 * np.abs(G).max())


def test_files_say_it_and_refusals_say_why():
    machine = replace(STOOD, casing_modes=(CasingMode(500.0, 300.0, ("A", "center"), (1.0, 0.5)),))
    assert loads_machine(dumps_machine(machine)) == machine
    assert loads_machine(update_machine_file("seal-rig", machine)) == machine
    first = PEDESTALS[0]
    for supports, modes, message in (
        ((replace(first, bearing="C"),), (), r'\[\[support\]\] C: bearing "C" is unknown; '),
        (
            (first, first),
            (),
            r'"A" stands on an earlier \[\[support\]\] already; merge the two, or add a '
            r"\[\[casing_mode\]\]",
        ),
        (
            (replace(first, mass=(0.0, 1.0)),),
            (),
            r"mass \(x\) is 0 kg, but must be positive; leave the support out for a rigid",
        ),
        (
            (replace(first, stiffness=(1e7, -1.0)),),
            (),
            r"stiffness \(y\) is -1 N/m, but must be positive",
        ),
        (
            (replace(first, damping=(-1.0, 0.0)),),
            (),
            r"damping \(x\) is -1 .* zero or positive; a support takes energy",
        ),
        (
            (replace(first, sensor="wall"),),
            (),
            'sensor is "?.?wall.*one of support, ground; choose one of them',
        ),
        ((replace(first, seals=("lid",)),), (), r'seals "lid" is unknown; '),
        (
            (),
            (CasingMode(500.0, 300.0, ("A", "B"), (1.0,)),),
            "x is a list of 1, but must be a list of 2, one per name in at",
        ),
        (
            (),
            (CasingMode(500.0, 300.0, ("A", "A"), (1.0, 1.0)),),
            'at names "A" twice; name it once',
        ),
        (
            (),
            (CasingMode(500.0, 300.0, ("A",)),),
            "x and y are zero or missing, so that it moves nothing; give the deflections",
        ),
        (
            (),
            (CasingMode(0.0, 300.0, ("A",), (1.0,)),),
            "frequency is 0 rad/s, but must be positive",
        ),
    ):
        with pytest.raises(InvalidInput, match=message) as caught:
            replace(RIG, supports=supports, casing_modes=modes)
        assert "\n" not in str(caught.value)
    text = dumps_machine(machine).replace("mass = [80.0, 95.0]", 'mass = "80 N"')
    with pytest.raises(InvalidInput, match=r"\[\[support\]\] A: mass .*80 N"):
        loads_machine(text)


def test_the_loop_on_its_supports():
    K = pid_controller(RIG.controller, STOOD)
    full, small = (closed_loop(item, K) for item in (assemble(STOOD), reduce(assemble(STOOD), 2)))
    worst = [np.linalg.eigvals(item.A).real.max() for item in (full, small)]
    assert worst[1] == pytest.approx(worst[0], rel=2e-2, abs=0.5)
