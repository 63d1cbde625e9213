"""Parts act at their place: every one on a node, against closed forms and meshes that do not need
it; and what the mesh's own error is said to be.
"""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.chain.check import insight
from ambrose.machine.attachment import NEAR, finer, mesh, node_positions, stations
from ambrose.machine.description import MachineDescription
from ambrose.machine.part import BendingMode, Disc, Material, ShaftSection
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import finite_element_rotor, free_bending_frequencies, mesh_error

LIGHT = Material(density=1e-3)
E_I = 2.1e11 * np.pi / 64 * 0.04**4


def bare(sections, discs=(), theory="bernoulli-euler"):
    return MachineDescription("bare", tuple(sections), (), (), discs=discs, beam_theory=theory)


@pytest.mark.parametrize("elements", [1, 4])
def test_a_disc_inside_an_element_does_not_stiffen_the_shaft(elements):
    """Three masses on a shaft without mass: w^2 = 48 E I/L^3 (1/(2 m) + 1/M), a simply supported
    beam under a force in its middle.
    """
    L, end, middle = 1.0, 3.0, 5.0
    sections = (
        ShaftSection(0.0, 0.3, 0.04, elements=1, material=LIGHT),
        ShaftSection(0.3, 0.7, 0.04, elements=elements, material=LIGHT),
    )
    discs = (Disc("a", 0.0, end), Disc("b", L / 2, middle), Disc("c", L, end))
    found = free_bending_frequencies(finite_element_rotor(bare(sections, discs)), 1)[0]
    exact = np.sqrt(48 * E_I / L**3 * (1 / (2 * end) + 1 / middle))
    assert found == pytest.approx(exact, rel=1e-5)  # the shaft weighs 1e-6 kg


@pytest.mark.parametrize("name", sorted(amb.bundled_machines()))
def test_every_part_stands_on_a_node(name):
    machine = amb.load_machine(name)
    pieces = mesh(machine.shaft, stations(machine))
    nodes = np.array(node_positions(pieces))
    assert finite_element_rotor(machine).positions == pytest.approx(nodes)
    parts = (*machine.discs, *machine.bearings, *machine.sensors, *machine.seals)
    for part in (*parts, *machine.couplings):
        assert np.abs(nodes - part.position).min() <= NEAR * machine.length
    # of the sections nothing is lost: their joints are nodes, and so are their equal parts
    for section in machine.shaft:
        own = section.start + section.length * np.arange(section.elements + 1) / section.elements
        assert np.abs(nodes[:, None] - own).min(axis=0) == pytest.approx(0.0, abs=1e-12)
    assert np.diff(nodes).min() > NEAR * machine.length


def test_a_part_at_a_node_leaves_the_mesh_as_it_was_to_the_last_bit():
    section = ShaftSection(0.0, 0.7, 0.05, elements=7)
    assert mesh((section,), [0.0, 0.1, 0.3, 0.7, 0.1 + 0.5e-4 * 0.7, 9.0, -1.0]) == mesh((section,))
    assert [piece.length for piece in mesh((section,))] == [0.7 / 7] * 7
    split = mesh((section,), [0.33])
    assert len(split) == 8 and sum(piece.length for piece in split) == pytest.approx(0.7)


@pytest.mark.parametrize("theory", ["rayleigh", "timoshenko"])
@pytest.mark.parametrize("away", [0.2, 1.01, 3.0, 30.0, 300.0])  # of NEAR times the length
def test_a_piece_however_short_rounds_no_frequency(away, theory):
    """A heavy disc moved along the shaft, up to where a node already is: as on a mesh whose
    elements begin at the disc, none of them short.
    """
    at = 0.3 + away * NEAR
    heavy = (Disc("wheel", at, 10.0, 0.1, 0.06),)
    own = bare((ShaftSection(0.0, 1.0, 0.05, elements=40),), heavy, theory)
    parted = (
        ShaftSection(0.0, at, 0.05, elements=24),
        ShaftSection(at, 1 - at, 0.05, elements=56),
    )
    found, exact = (
        free_bending_frequencies(finite_element_rotor(item), 3)
        for item in (own, bare(parted, heavy, theory))
    )
    # a disc that stays beside its node: 1.4e-4
    near = 6e-4 if theory == "timoshenko" else 2e-4 if away < 1 else 2e-5
    assert found == pytest.approx(exact, rel=near)
    assert (found >= exact * (1 - 1e-9)).all()  # of the coarser mesh, never below


def test_the_error_of_the_mesh_is_that_of_the_closed_form():
    """A uniform free beam as one element: sqrt(720) in place of 4.7300407^2 = 22.3733."""
    own, error = mesh_error(bare((ShaftSection(0.0, 2.0, 0.04),)), 1)
    per_length = 7850 * np.pi / 4 * 0.04**2
    assert own[0] == pytest.approx(np.sqrt(720 * E_I / per_length) / 2.0**2, rel=1e-9)
    assert error[0] == pytest.approx(np.sqrt(720) / 4.73004074**2 - 1, rel=2e-2)


@pytest.mark.parametrize("name", sorted(amb.bundled_machines()))
def test_bundled_machines_are_converged(name):
    """A thousandth in every bending frequency that is judged."""
    machine = amb.load_machine(name)
    found = insight(assemble(machine))
    assert len(found["mesh_error"]) >= 3 and max(found["mesh_error"]) < 1e-3
    assert not any("mesh" in doubt for doubt in found["doubts"])


def test_check_doubts_a_coarse_mesh():
    machine = amb.load_machine("two-disc-rotor")
    coarse = replace(machine, shaft=tuple(replace(item, elements=1) for item in machine.shaft))
    found = insight(assemble(coarse))
    (doubt,) = (line for line in found["doubts"] if "mesh" in line)
    assert "bending mode 7" in doubt and "raise elements" in doubt
    # a measured frequency hides no mesh
    known = replace(coarse, bending_modes=(BendingMode(1, 480.0),))
    assert mesh_error(known, 7)[1] == pytest.approx(mesh_error(coarse, 7)[1])
    assert mesh_error(replace(coarse, shaft=finer(coarse.shaft, 4)), 7)[1].max() < 2e-3
