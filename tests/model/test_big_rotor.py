"""The modes that stand for all of the mesh, and how they are found where it is very fine."""

import time
from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.chain.check import facts
from ambrose.core import mechanical
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.mechanical import undamped_modes
from ambrose.core.statespace import poles, select
from ambrose.machine.description import MachineDescription
from ambrose.machine.ordinary_file import FINE_MESH_MODES
from ambrose.machine.parameters import find_parameter
from ambrose.model import assemble as assembly
from ambrose.model.assemble import bending_modes_of
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_bending_frequencies,
    free_modes,
    plane_rows,
    residual_modes,
)

OMEGA = np.geomspace(1.0, 2e4, 24)
MODES = FINE_MESH_MODES


def refined(name, factor):
    machine = amb.load_machine(name)
    return replace(
        machine,
        shaft=tuple(replace(item, elements=factor * item.elements) for item in machine.shaft),
    )


def figures(machine, every_mode):
    plant = assembly.assemble(machine, every_mode=every_mode)
    slow = np.sort_complex(poles(plant.rotor)[np.abs(poles(plant.rotor)) < 1e4])
    axes = plant.axes
    loop = select(plant.system, [f"u_{axis}" for axis in axes], [f"y_{axis}" for axis in axes])
    return plant.rotor.n_states, slow, frequency_response(loop, OMEGA).values


@pytest.mark.parametrize(
    ("name", "factor", "of_poles", "of_responses"),
    [
        ("seal-rig", 1, 1e-10, 4e-9),
        ("seal-rig", 2, 5e-10, 6e-9),
        ("turboexpander", 1, 1e-10, 2e-7),
        ("turboexpander", 2, 1e-10, 4e-7),
    ],
)
def test_what_is_left_out_does_not_show(name, factor, of_poles, of_responses):
    """Against all 88 or 166 modes per plane of the same mesh; measured 5e-11 and 6e-10,
    turboexpander 5e-12 and 5e-8.
    """
    machine = refined(name, factor)
    states, slow, response = figures(machine, False)
    every, exact, whole = figures(machine, True)
    assert every == 4 * 2 * finite_element_rotor(machine).n_nodes and states < 150
    assert len(slow) == len(exact) and np.abs(slow / exact - 1).max() <= of_poles
    size = np.linalg.norm(whole, 2, axis=(1, 2))
    error = np.linalg.norm(response - whole, 2, axis=(1, 2)) / np.maximum(size, 1e-6 * size.max())
    assert error.max() <= of_responses


@pytest.mark.parametrize(
    "name", ["seal-rig", pytest.param("turboexpander", marks=pytest.mark.study)]
)
def test_check_design_and_verification_say_what_every_mode_says(name, monkeypatch):
    """Every figure at the operating points to 1e-6 (measured: 4e-10, 9e-9 on the seal rig with 101
    elements).
    """
    machine = amb.load_machine(name)

    def said():
        pid = amb.design(machine, "pid")
        return (
            facts(machine),
            pid.certificate,
            [point.to_dict() for point in amb.verify(machine, pid).points],
        )

    kept = said()
    attached = assembly.attached_statespace
    every = 2 * finite_element_rotor(machine).n_nodes - 2
    monkeypatch.setattr(
        assembly, "attached_statespace", lambda *of: attached(*of[:3], of[3] or every)
    )
    all_facts, certificate, points = said()
    assert all_facts["rotor_states"] == 8 * (every // 2 + 1) > 2 * kept[0]["rotor_states"]
    for key in ("unstable_poles_rad_s", "bending_rad_s", "critical_speeds_rad_s"):
        assert np.array(kept[0][key]) == pytest.approx(np.array(all_facts[key]), rel=1e-6)
    assert kept[1].closed_loop_norm == pytest.approx(certificate.closed_loop_norm, rel=1e-6)
    assert len(points[0]["checks"]) > 20
    for ours, theirs in zip(kept[2], points, strict=True):
        values, exact = ([check["value"] for check in point["checks"]] for point in (ours, theirs))
        assert values == pytest.approx(exact, rel=1e-6)


def test_residual_modes_hold_the_static_compliance_of_all_others():
    """Against the sum over all modes of the mesh, for loads at any place; a load that repeats
    another adds no mode.
    """
    rotor = finite_element_rotor(amb.load_machine("turboexpander"))
    length = rotor.positions[-1]
    loads = plane_rows(rotor, [0.1 * length, 0.4 * length, 0.4 * length, 0.95 * length])[0]
    own, shapes = residual_modes(rotor, 24, loads)
    every = free_modes(rotor, 2 * rotor.n_nodes - 2)
    rest = every.shapes[0::4, 52::2], every.frequencies[52::2]
    seen, all_seen = (
        loads @ shapes,
        loads[:, 0::2] @ rest[0] + loads[:, 1::2] @ every.shapes[3::4, 52::2],
    )
    exact = (all_seen / rest[1] ** 2) @ all_seen.T
    assert len(own) == 3 and own[0] > rest[1][0]
    assert np.abs((seen / own**2) @ seen.T - exact).max() <= 1e-11 * np.abs(exact).max()
    assert np.abs(shapes.T @ rotor.plane_mass @ shapes - np.eye(3)).max() <= 1e-10


def test_loads_that_leave_nothing_in_the_residual_modes_give_none():
    """None where all modes are kept, and none of a load of zeros (moments of a rotor that has no
    polar inertia).
    """
    rotor = finite_element_rotor(amb.load_machine("two-disc-rotor"))
    loads = plane_rows(rotor, [rotor.positions[0], rotor.positions[3]])[0]
    frequencies, shapes = residual_modes(rotor, 2 * rotor.n_nodes - 2, loads)
    assert frequencies.shape == (0,) and shapes.shape == (2 * rotor.n_nodes, 0)
    both = residual_modes(rotor, 5, np.vstack([loads, np.zeros(loads.shape[1])]))
    np.testing.assert_array_equal(both[0], residual_modes(rotor, 5, loads)[0])


def test_modes_up_to_100_khz_are_kept():
    kept = {
        name: bending_modes_of(finite_element_rotor(amb.load_machine(name)))
        for name in ("seal-rig", "process-compressor")
    }
    # from 58 and from 9 kHz at the sixteenth and twenty-fourth
    assert kept == {"seal-rig": 24, "process-compressor": MODES}
    small = finite_element_rotor(amb.load_machine("flywheel"))
    assert bending_modes_of(small) == 2 * small.n_nodes - 2


def test_many_modes_of_a_fine_mesh(monkeypatch):
    """Subspace iteration with so many vectors, unless they are kept orthogonal, ends in a singular
    projection.
    """
    rotor = finite_element_rotor(refined("turboexpander", 10))
    M = rotor.plane_mass
    K = (
        rotor.plane_stiffness
        + 1e-10 * float((np.diag(rotor.plane_stiffness) / np.diag(M)).max()) * M
    )
    frequencies, shapes = undamped_modes(M, K, MODES + 2)
    assert np.abs(shapes.T @ M @ shapes - np.eye(MODES + 2)).max() < 1e-9
    monkeypatch.setattr(mechanical, "_DENSE_LIMIT", 1000)
    assert frequencies[2:] == pytest.approx(undamped_modes(M, K, MODES + 2)[0][2:], rel=1e-7)


@pytest.mark.parametrize(
    ("theory", "order", "elements"), [("timoshenko", 2, 400), ("bernoulli-euler", 4, 200)]
)
def test_eight_hundred_elements_do_not_round_the_frequencies(theory, order, elements):
    """They lie where the error of coarser meshes, which falls with the square or the fourth power
    of the length, leads to.
    """
    section = replace(amb.load_machine("seal-rig").shaft[0], length=1.2, outer_diameter=0.04)

    def frequencies(count):
        return free_bending_frequencies(
            finite_element_rotor(
                MachineDescription(
                    "bare", (replace(section, elements=count),), (), (), beam_theory=theory
                )
            ),
            3,
        )

    coarse, fine, finest = (frequencies(count) for count in (elements // 2, elements, 800))
    error = (fine - coarse) / (1 - 2.0**order)  # of the finer one
    assert (np.abs(error / fine) > 1e-10).all()
    assert finest == pytest.approx(fine - error * (1 - (elements / 800) ** order), rel=2e-9)


def test_the_finest_mesh_takes_a_second():
    """`check` and the design of a PID with 780 elements; both figures are those of a mesh five
    times as coarse.
    """
    machine, coarser = refined("seal-rig", 20), facts(refined("seal-rig", 4))
    begun = time.process_time()
    found = facts(machine)
    pid = amb.design(machine, "pid")
    assert time.process_time() - begun < 10  # half a second each on an idle processor
    assert pid.certificate.stable
    for name in ("unstable_poles_rad_s", "bending_rad_s", "critical_speeds_rad_s"):
        assert np.array(found[name]) == pytest.approx(np.array(coarser[name]), rel=2e-5)


def test_tolerances_name_only_modes_that_the_model_has():
    machine = refined("seal-rig", 2)
    with pytest.raises(
        InvalidInput, match="names no bending mode of this mesh; write bending_1 to bending_24"
    ):
        find_parameter(machine, "rotor.bending_25.frequency")
    assert find_parameter(machine, "rotor.bending_24.frequency").name == "bending_24"
