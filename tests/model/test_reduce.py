"""Reduction: poles, frequency response, subspace, error bound; the figures quoted in
docs/theory/linear-model.md.
"""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla

import ambrose.model.uncertainty
from ambrose import load_machine
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import close_uncertainty
from ambrose.core.statespace import poles, select
from ambrose.machine.description import OperatingPoint
from ambrose.model.assemble import assemble
from ambrose.model.effects.rotor import finite_element_rotor, free_bending_frequencies
from ambrose.model.plant import top_speed
from ambrose.model.uncertainty import (
    default_bending_modes,
    free_mode_reduction,
    modal_reduction,
    reduce,
    reduce_from,
    split_slow,
    uncertain,
)

MACHINES = {"seal-rig": None, "turboexpander": None}


@pytest.fixture(scope="module", params=list(MACHINES))
def plant(request):
    return assemble(load_machine(request.param))


def distance(some, among):
    return max(np.abs(among - value).min() for value in some)


@pytest.mark.parametrize("bending_modes", [0, 1, 2, 4])
def test_poles_are_those_of_the_full_rotor(plant, bending_modes):
    reduction = modal_reduction(plant, bending_modes)
    assert reduction.plant.rotor.n_states == 8 + 4 * bending_modes
    ours, full = poles(reduction.plant.rotor), poles(plant.rotor)
    # rad/s; 6e-5 (seal rig) and 3e-4 (turboexpander at speed) measured
    assert distance(ours[:8], full) < 1e-3
    # 1.05e-6, of the turboexpander's 904 rad/s
    assert max(np.abs(full - value).min() / abs(value) for value in ours) < 1.2e-6


def test_transforms_are_inverse_and_decouple(plant):
    reduction = modal_reduction(plant, 1)
    T_L, T_R = reduction.T_L, reduction.T_R
    assert T_L @ T_R == pytest.approx(np.eye(12), abs=1e-9)
    A = plant.rotor.A
    assert T_L @ A @ T_R == pytest.approx(
        reduction.plant.rotor.A, abs=1e-5 * np.abs(reduction.plant.rotor.A).max()
    )


def test_transforms_with_a_seal_that_has_inertia():
    """Added mass couples the free modes; T_L and T_R still take the full plant's state to the
    reduced one and back.
    """
    machine = load_machine("seal-rig")
    full = assemble(replace(machine, seals=(replace(machine.seals[0], M=8.0),)))
    reduction = modal_reduction(full, 1)
    T_L = reduction.T_L
    T_R = reduction.T_R
    small = reduction.plant.rotor
    whole = full.rotor
    assert T_L @ T_R == pytest.approx(np.eye(12), abs=1e-9)
    assert T_L @ whole.A @ T_R == pytest.approx(small.A, abs=1e-5 * np.abs(small.A).max())
    assert T_L @ whole.B == pytest.approx(small.B, abs=1e-6 * np.abs(small.B).max())
    assert whole.C @ T_R == pytest.approx(small.C, abs=1e-6 * np.abs(small.C).max())


def test_spans_the_subspace_of_the_complex_route(plant):
    """The thesis takes complex eigenvectors of the 320-state matrix (P1, eqs. 18-42): the same
    column space.

    The angle is that of the intermediate model's truncation: 2e-5 with 24 extra modes, 2e-6 with
    40.
    """
    values, vectors = np.linalg.eig(plant.rotor.A)
    slow = vectors[:, np.argsort(np.abs(values))[:8]]
    thesis = sla.orth(np.hstack([slow.real, slow.imag]), rcond=1e-8)
    assert thesis.shape[1] == 8
    ours = sla.orth(modal_reduction(plant).T_R)
    assert np.sin(sla.subspace_angles(thesis, ours)).max() < 5e-5


def test_frequency_response_and_static_correction():
    """Seal rig, currents to sensors: 0.04 % at DC and 4.7 % at 200 Hz when truncated, 7e-10 and 0.7
    % corrected.
    """
    plant = assemble(load_machine("seal-rig"))
    w = 2 * np.pi * np.array([0.01, 50.0, 100.0, 200.0])

    def response(p):
        return frequency_response(select(p.system, p.named("u"), p.named("y")), w).values

    full = response(plant)
    size = np.linalg.norm(full, 2, axis=(1, 2))
    plain = np.linalg.norm(response(reduce(plant, 0, False)) - full, 2, axis=(1, 2)) / size
    corrected = np.linalg.norm(response(reduce(plant)) - full, 2, axis=(1, 2)) / size
    print("truncated", plain, "corrected", corrected)
    assert plain[0] > 1e-4
    assert corrected[0] < 1e-8
    assert plain[3] < 0.05
    assert corrected[3] < 0.008


@pytest.mark.parametrize("static", [False, True])
@pytest.mark.parametrize("bending_modes", [0, 1])
def test_error_bound_holds(plant, bending_modes, static):
    reduction = modal_reduction(plant, bending_modes, static)
    keep = [f"q_{p}" for p in plant.ports] + [f"s_{a}" for a in plant.axes]
    w = np.geomspace(1.0, 2e4, 120)

    def response(p):
        return frequency_response(select(p.rotor, outputs=keep), w).values

    full = response(plant)
    error = np.linalg.norm(response(reduction.plant) - full, 2, axis=(1, 2))
    bound = reduction.error_bound(w)
    slack = 1e-4 * np.linalg.norm(full, 2, axis=(1, 2))  # the intermediate model's own pole error
    assert (error <= bound * (1 + 1e-3) + slack).all()
    low = w < 2 * np.pi * 200
    # and it says something there
    assert (bound[low] < np.linalg.norm(full[low], 2, axis=(1, 2))).all()


@pytest.mark.parametrize("delta", [-1.0, *(d for d in (-0.5, 0.5)), 1.0])
@pytest.mark.parametrize(
    ("name", "path", "plain", "static", "one_mode"),
    [
        ("seal-rig-k-only", "seal.center.k", 1.6, 0.005, 0.005),
        ("seal-rig", "seal.center.pressure", 1.0, 0.32, 0.02),
    ],
)
def test_seal_over_its_whole_tolerance(name, path, plain, static, one_mode, delta):
    """k alone, and all that follows the pressure, moved by up to +-100 % through the nominal T_L,
    T_R; poles [rad/s] compared with the full model reassembled there.

    Plain truncation errs by up to 1.6 rad/s (at -100 %, where two pairs nearly meet), in k with
    static correction by 0.004. Damping forces are not corrected, for what the static correction
    adds has no velocity: without C and c the pressure's 0.31 is 0.004. The first bending mode makes
    it 0.016.
    """
    plant = assemble(load_machine(name))
    full = assemble(plant.machine, OperatingPoint(seal_pressure=2.04e5 * (1 + delta)))
    for small, error in (
        (reduce(plant, 0, False), plain),
        (reduce(plant), static),
        (reduce(plant, 1), one_mode),
    ):
        assert (
            distance(
                poles(close_uncertainty(uncertain(small), {path: delta}))[:16], poles(full.system)
            )
            < error
        )


def test_speed_independent_basis():
    """free_mode_reduction: same basis at every speed, so states may be carried from one speed to
    the next.
    """
    machine = load_machine("turboexpander")
    slow, fast = (
        free_mode_reduction(assemble(machine, OperatingPoint(speed=s)), 2) for s in (0.0, 1000.0)
    )
    assert slow.rotor.B == pytest.approx(fast.rotor.B, rel=1e-12)
    assert slow.rotor.C == pytest.approx(fast.rotor.C, rel=1e-12)


def test_refuses_what_cannot_be_done():
    plant = assemble(load_machine("seal-rig"))
    with pytest.raises(InvalidInput, match="bending_modes is 99"):
        reduce(plant, 99)
    with pytest.raises(NumericalFailure, match="cannot be parted"):
        split_slow(np.diag([-1.0, -2.0, -2.0, -3.0]), 2)


def test_reduction_at_speed():
    machine = load_machine("turboexpander")
    plant = assemble(machine, replace(machine.operation.nominal, speed=31500 * np.pi / 30))
    assert distance(poles(reduce(plant).rotor), poles(plant.rotor)) < 5e-2


def test_default_number_of_bending_modes_covers_speed_and_amplifier(plant):
    kept = default_bending_modes(plant)
    machine = plant.machine
    lags = (
        machine.amplifier.bandwidth,
        machine.amplifier.eddy_bandwidth,
        machine.amplifier.natural_frequency,
    )
    highest = max(2 * top_speed(machine), *(lag for lag in lags if lag))
    frequencies = free_bending_frequencies(plant.rotor_model, kept)
    assert frequencies[-1] > highest
    assert (frequencies[:-1] <= highest).all()


def test_the_rotor_is_assembled_once():
    machine = load_machine("seal-rig")
    other = replace(
        machine,
        modal_damping=0.01,
        seals=tuple(replace(seal, k=0.0) for seal in machine.seals),
        tolerances=(),
    )
    assert assemble(machine).rotor_model is assemble(other).rotor_model
    assert finite_element_rotor(
        replace(machine, beam_theory="rayleigh")
    ) is not finite_element_rotor(machine)
    with pytest.raises(ValueError, match="read-only"):
        finite_element_rotor(machine).plane_mass[0, 0] = 0.0


def test_modes_that_coincide_are_kept_together():
    """One bending mode more, up to three: a symmetric rotor at speed has whirling modes that
    cross.
    """
    machine = load_machine("seal-rig")
    small = reduce_from(assemble(machine), 1)
    assert small.bending_modes == 1
    with pytest.MonkeyPatch.context() as patch:
        parted = ambrose.model.uncertainty.reduce

        def coincide(plant, count):
            if count < 3:
                raise NumericalFailure("cannot be parted")
            return parted(plant, count)

        patch.setattr(ambrose.model.uncertainty, "reduce", coincide)
        assert reduce_from(assemble(machine), 1).bending_modes == 3
        # where every cut parts them, the free modes and the compliance of the others
        patch.setattr(ambrose.model.uncertainty, "reduce", lambda plant, count: coincide(plant, 0))
        free = reduce_from(assemble(machine), 1)
    own = free_mode_reduction(assemble(machine), 1, residual=True)
    assert free.bending_modes == 1 and np.array_equal(free.system.A, own.system.A)
