"""A very fine mesh: the lowest 64 bending modes per plane stand for all, and the modes themselves are found."""

import time
from collections import namedtuple
from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core import mechanical
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.mechanical import undamped_modes
from ambrose.core.statespace import poles, select
from ambrose.machine.parameters import find_parameter
from ambrose.physics.rotor import finite_element_rotor, free_bending_frequencies
from ambrose.plant import assemble as assembly
from ambrose.plant.reduce import reduce
from ambrose.stages.plants import facts

Bare = namedtuple("Bare", "shaft discs beam_theory bending_modes", defaults=((),))
OMEGA = np.geomspace(1.0, 2e4, 24)
MODES = assembly.FINE_MESH_MODES


def refined(name, factor):
    machine = amb.load_machine(name)
    return replace(machine, shaft=tuple(replace(item, elements=factor * item.elements) for item in machine.shaft))


def figures(machine):
    plant = assembly.assemble(machine)
    slow = [np.sort_complex(values[np.abs(values) < 1e4]) for values in (poles(plant.rotor), poles(reduce(plant, 1).rotor))]
    axes = plant.axes
    loop = select(plant.system, [f"u_{axis}" for axis in axes], [f"y_{axis}" for axis in axes])
    return plant.rotor.n_states, slow, frequency_response(loop, OMEGA).values


@pytest.mark.parametrize("name", ["seal-rig", "turboexpander"])
def test_what_is_left_out_does_not_show(name, monkeypatch):
    """Against all 158 modes per plane of the same mesh, whose eigenvalues take fifteen times as long."""
    machine = refined(name, 2)
    states, slow, response = figures(machine)
    monkeypatch.setattr(assembly, "FINE_MESH_MODES", 1000)
    every, exact, whole = figures(machine)
    assert states == every - 4 * (2 * finite_element_rotor(machine).n_nodes - 2 - MODES)
    for found, right in zip(slow, exact, strict=True):
        assert len(found) == len(right) and np.abs(found / right - 1).max() <= 1e-7
    size = np.linalg.norm(whole, 2, axis=(1, 2))
    error = np.linalg.norm(response - whole, 2, axis=(1, 2)) / np.maximum(size, 1e-6 * size.max())
    assert error.max() <= 5e-6


def test_meshes_of_ordinary_size_keep_all_modes():
    for name in ("seal-rig", "turboexpander"):
        rotor = finite_element_rotor(amb.load_machine(name))
        assert assembly.bending_modes_of(rotor) == 2 * rotor.n_nodes - 2


def test_many_modes_of_a_fine_mesh(monkeypatch):
    """Subspace iteration with so many vectors, unless they are kept orthogonal, ends in a singular projection."""
    rotor = finite_element_rotor(refined("turboexpander", 10))
    M = rotor.plane_mass
    K = rotor.plane_stiffness + 1e-10 * float((np.diag(rotor.plane_stiffness) / np.diag(M)).max()) * M
    frequencies, shapes = undamped_modes(M, K, MODES + 2)
    assert np.abs(shapes.T @ M @ shapes - np.eye(MODES + 2)).max() < 1e-9
    monkeypatch.setattr(mechanical, "_DENSE_LIMIT", 1000)
    assert frequencies[2:] == pytest.approx(undamped_modes(M, K, MODES + 2)[0][2:], rel=1e-7)


@pytest.mark.parametrize(("theory", "order", "elements"), [("timoshenko", 2, 400), ("bernoulli-euler", 4, 200)])
def test_eight_hundred_elements_do_not_round_the_frequencies(theory, order, elements):
    """They lie where the error of coarser meshes, which falls with the square or the fourth power of the length, leads to."""
    section = replace(amb.load_machine("seal-rig").shaft[0], length=1.2, outer_diameter=0.04)

    def frequencies(count):
        return free_bending_frequencies(finite_element_rotor(Bare((replace(section, elements=count),), (), theory)), 3)

    coarse, fine, finest = (frequencies(count) for count in (elements // 2, elements, 800))
    error = (fine - coarse) / (1 - 2.0**order)  # of the finer one
    assert (np.abs(error / fine) > 1e-10).all()
    assert finest == pytest.approx(fine - error * (1 - (elements / 800) ** order), rel=2e-9)


def test_the_finest_mesh_takes_a_second():
    """`check` and the design of a PID with 780 elements; both figures are those of a mesh five times as coarse."""
    machine, coarser = refined("seal-rig", 20), facts(refined("seal-rig", 4))
    begun = time.process_time()
    found = facts(machine)
    pid = amb.design(machine, "pid")
    assert time.process_time() - begun < 4  # half a second each on a processor of its own
    assert pid.certificate.stable
    for name in ("unstable_poles_rad_s", "bending_rad_s", "critical_speeds_rad_s"):
        assert np.array(found[name]) == pytest.approx(np.array(coarser[name]), rel=2e-5)


def test_tolerances_name_only_modes_that_the_model_has():
    machine = refined("seal-rig", 2)
    with pytest.raises(InvalidInput, match="names no bending mode of this mesh; write bending_1 to bending_64"):
        find_parameter(machine, "rotor.bending_65.frequency")
    assert find_parameter(machine, "rotor.bending_64.frequency").name == "bending_64"
