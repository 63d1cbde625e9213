"""Every kind of uncertain parameter: closing its block equals assembling the changed machine."""

import json
from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.lft import RealBlock, close_uncertainty, upper_lft
from ambrose.core.statespace import StateSpace, select
from ambrose.machine.description import Amplifier, Tolerance
from ambrose.machine.part import SealTable
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction, perturbed, reduce, uncertain
from coarse import coarse

OMEGA = np.array([1.0, 100.0, 500.0, 3000.0, 12000.0])


@pytest.fixture(scope="module")
def machine():
    m = coarse("seal-rig")
    return replace(m, couplings=(replace(m.couplings[0], damping=(100.0, 150.0)),))


def response(plant):
    return frequency_response(plant.system, OMEGA).values


def scaled(pair, index, factor):
    return tuple(value * factor if i in index else value for i, value in enumerate(pair))


def with_bearing(m, name, field, index, factor):
    change = {b.name: b for b in m.bearings}
    change[name] = replace(
        change[name], **{field: scaled(getattr(change[name], field), index, factor)}
    )
    return replace(m, bearings=tuple(change.values()))


def with_seal(m, letters, factor):
    return replace(
        m,
        seals=(
            replace(
                m.seals[0], **{letter: getattr(m.seals[0], letter) * factor for letter in letters}
            ),
        ),
    )


def with_coupling(m, field, index, factor):
    return replace(
        m,
        couplings=(
            replace(
                m.couplings[0], **{field: scaled(getattr(m.couplings[0], field), index, factor)}
            ),
        ),
    )


CASES = {
    "seal.center.K": (2, lambda m, f: with_seal(m, "K", f)),
    "seal.center.k": (2, lambda m, f: with_seal(m, "k", f)),
    "seal.center.C": (2, lambda m, f: with_seal(m, "C", f)),
    "seal.center.c": (2, lambda m, f: with_seal(m, "c", f)),
    "seal.center.pressure": (2, lambda m, f: with_seal(m, "KkCc", f)),
    "bearing.A.negative_stiffness": (
        2,
        lambda m, f: with_bearing(m, "A", "negative_stiffness", (0, 1), f),
    ),
    "bearing.B.negative_stiffness.eta": (
        1,
        lambda m, f: with_bearing(m, "B", "negative_stiffness", (1,), f),
    ),
    "bearing.A.force_per_current": (
        2,
        lambda m, f: with_bearing(m, "A", "force_per_current", (0, 1), f),
    ),
    "bearing.B.force_per_current.zeta": (
        1,
        lambda m, f: with_bearing(m, "B", "force_per_current", (0,), f),
    ),
    "coupling.coupling.stiffness": (2, lambda m, f: with_coupling(m, "stiffness", (0, 1), f)),
    "coupling.coupling.damping.zeta": (1, lambda m, f: with_coupling(m, "damping", (0,), f)),
    "amplifier.natural_frequency": (
        8,
        lambda m, f: replace(
            m, amplifier=replace(m.amplifier, natural_frequency=m.amplifier.natural_frequency * f)
        ),
    ),
    "amplifier.damping": (
        4,
        lambda m, f: replace(m, amplifier=replace(m.amplifier, damping=m.amplifier.damping * f)),
    ),
}


@pytest.mark.parametrize("path", CASES)
@pytest.mark.parametrize("delta", [-1.0, 0.7])
def test_block_equals_changed_machine(machine, path, delta):
    repeat, change = CASES[path]
    plant = assemble(machine)
    tolerance = Tolerance(path, relative=0.3)
    assert uncertain(plant, [tolerance]).blocks == (RealBlock(path, repeat),)
    ours = response(perturbed(plant, {path: delta}, [tolerance]))
    truth = response(assemble(change(machine, 1 + 0.3 * delta)))
    assert ours == pytest.approx(truth, rel=1e-6, abs=1e-9 * np.abs(truth).max())


@pytest.mark.parametrize(
    ("amplifier", "parameter"),
    [
        (Amplifier("first", bandwidth=9000.0), "bandwidth"),
        (Amplifier("twice-first", bandwidth=9000.0, eddy_bandwidth=4000.0), "bandwidth"),
        (Amplifier("twice-first", bandwidth=9000.0, eddy_bandwidth=4000.0), "eddy_bandwidth"),
    ],
)
def test_amplifier_bandwidth(machine, amplifier, parameter):
    m = replace(machine, amplifier=amplifier)
    path = f"amplifier.{parameter}"
    ours = perturbed(assemble(m), {path: -0.5}, [Tolerance(path, relative=0.4)])
    truth = assemble(
        replace(m, amplifier=replace(amplifier, **{parameter: getattr(amplifier, parameter) * 0.8}))
    )
    assert response(ours) == pytest.approx(
        response(truth), rel=1e-6, abs=1e-9 * np.abs(response(truth)).max()
    )


def stiffer(machine, factor):
    """All bending frequencies times ``factor``, their damping coefficients 2 zeta omega kept."""
    shaft = tuple(
        replace(
            s, material=replace(s.material, youngs_modulus=s.material.youngs_modulus * factor**2)
        )
        for s in machine.shaft
    )
    return replace(machine, shaft=shaft, modal_damping=machine.modal_damping / factor)


@pytest.mark.parametrize(
    ("quantity", "change"),
    [
        ("frequency", stiffer),
        ("damping", lambda m, f: replace(m, modal_damping=m.modal_damping * f)),
    ],
)
@pytest.mark.parametrize("delta", [-1.0, 0.7])
@pytest.mark.parametrize("share", [0.0, 0.8])
def test_a_bending_mode_moves_as_a_changed_shaft(machine, quantity, change, delta, share):
    machine = replace(machine, rotating_share=share)
    path = f"rotor.bending_1.{quantity}"
    named = replace(machine, tolerances=(Tolerance(path, relative=0.3),))
    full = assemble(named)
    assert uncertain(full).blocks == (RealBlock(path, 4 if quantity == "frequency" else 2),)
    assert full.ports == assemble(machine).ports
    assert np.array_equal(response(full), response(assemble(machine)))
    ours = response(perturbed(free_mode_reduction(full, 1), {path: delta}))
    truth = response(free_mode_reduction(assemble(change(machine, 1 + 0.3 * delta)), 1))
    assert ours == pytest.approx(truth, rel=1e-6, abs=1e-9 * np.abs(truth).max())
    whole, reduced = (
        response(perturbed(full, {path: delta})),
        response(perturbed(reduce(full, 3), {path: delta})),
    )
    assert (
        np.abs(reduced[:, :4, :4] - whole[:, :4, :4]).max() < 1e-3 * np.abs(whole[:, :4, :4]).max()
    )


def test_a_bending_mode_without_port_is_refused(machine):
    with pytest.raises(
        InvalidInput, match=r"no port in this plant; name it in a \[\[tolerance\]\]"
    ):
        uncertain(assemble(machine), [Tolerance("rotor.bending_1.damping", relative=0.3)])


def test_single_entries_add_up_to_the_repeated_block(machine):
    plant = assemble(machine)
    both = perturbed(plant, {"seal.center.k": 0.4}, [Tolerance("seal.center.k", relative=1.0)])
    single = [Tolerance(f"seal.center.{entry}", relative=1.0) for entry in ("k_xy", "k_yx")]
    entries = perturbed(plant, {t.parameter: 0.4 for t in single}, single)
    assert response(entries) == pytest.approx(response(both), rel=1e-9)


def test_absolute_width_serves_a_zero_nominal(machine):
    m = with_seal(machine, "K", 0.0)
    with pytest.raises(InvalidInput, match=r"seal\.center\.K.*absolute"):
        uncertain(assemble(m), [Tolerance("seal.center.K", relative=0.1)])
    ours = perturbed(
        assemble(m), {"seal.center.K": -1.0}, [Tolerance("seal.center.K", absolute=2e5)]
    )
    truth = assemble(replace(m, seals=(replace(m.seals[0], K=-2e5),)))
    assert response(ours) == pytest.approx(
        response(truth), rel=1e-6, abs=1e-9 * np.abs(response(truth)).max()
    )


def at_pressure(m, pressure):
    return response(assemble(m, replace(m.operation.nominal, seal_pressure=pressure)))


def tabulated(m, pressures, **values):
    """The machine with its seal on a table over the pressure; values: coefficient -> its values."""
    table = SealTable((("pressure", pressures),), tuple(values.items()))
    still = {**dict.fromkeys("KkCc", 0.0), "scales_with_pressure": (), "table": table}
    return replace(m, seals=(replace(m.seals[0], **still),), tolerances=())


def test_the_pressure_moves_what_follows_it_as_one_block(machine):
    """Closed at a pressure, the block gives the plant that is assembled there: of constants, of a
    line, without pressure.
    """
    line = tabulated(machine, (0.0, 5e5), K=(1e5, 2e5), k=(0.0, 8e6), C=(-50.0, 6e3))
    for m, nominal in ((machine, 2.04e5), (line, 2.04e5), (machine, 0.0)):
        plant = assemble(m, replace(m.operation.nominal, seal_pressure=nominal))
        tolerance = Tolerance("seal.center.pressure", absolute=2.04e5)
        assert uncertain(plant, [tolerance]).blocks == (RealBlock("seal.center.pressure", 2),)
        ours, truth = (
            response(perturbed(plant, {tolerance.parameter: 1.0}, [tolerance])),
            at_pressure(m, nominal + 2.04e5),
        )
        assert ours == pytest.approx(truth, rel=1e-6, abs=1e-9 * np.abs(truth).max())


def test_the_pressure_moves_the_states_of_a_seal(machine):
    omega = tuple(np.geomspace(10.0, 2000.0, 12))
    rise = np.array(omega) / (np.array(omega) + 300.0)
    table = SealTable(
        (("frequency", omega),), (("K", tuple(4e5 * rise)), ("k", tuple(3e6 + 1e6 * rise)))
    )
    seal = replace(
        machine.seals[0], K=0.0, k=0.0, table=table, frequency_dependence="states", poles=2
    )
    m = replace(machine, seals=(seal,))
    ours = response(perturbed(assemble(m), {"seal.center.pressure": -0.5}))
    truth = at_pressure(m, 1.02e5)
    assert ours == pytest.approx(truth, rel=1e-6, abs=1e-9 * np.abs(truth).max())
    with pytest.raises(
        InvalidInput, match=r"pressure of seal center with states is 0.*under pressure"
    ):
        uncertain(assemble(m, m.operation.points[1]))
    with pytest.raises(InvalidInput, match=r"states are not proportional.*name all"):
        reason = (("seal.center.scales_with_pressure", "a test"),)
        replace(m, seals=(replace(seal, scales_with_pressure=("K", "k")),), assumed=reason)


def test_a_coefficient_and_the_pressure_add_up(machine):
    """A coefficient's own tolerance says how well it is known at a pressure."""
    plant, both = (
        assemble(machine),
        [Tolerance("seal.center.pressure", relative=1.0), Tolerance("seal.center.k", relative=0.1)],
    )
    ours = response(perturbed(plant, {"seal.center.pressure": 0.5, "seal.center.k": -1.0}, both))
    truth = response(assemble(with_seal(with_seal(machine, "KCc", 1.5), "k", 1.4)))
    assert ours == pytest.approx(truth, rel=1e-6, abs=1e-9 * np.abs(truth).max())


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            lambda m: replace(m.seals[0], scales_with_pressure=()),
            "no coefficient of the seal follows the pressure; name",
        ),
        (
            lambda m: replace(m.seals[0], M=0.1, scales_with_pressure=("K", "k", "C", "c", "M")),
            "added mass.*keep M constant",
        ),
        (
            lambda m: tabulated(m, (0.0, 2e5, 4e5), K=(0.0, 1.0, 3.0), k=(0.0, 2.0, 4.0)).seals[0],
            "not on a straight line over the pressure.*: K; leave",
        ),
        (
            lambda m: coarse("turboexpander").seals[0],
            "flow of .* is not proportional to the pressure; leave",
        ),
    ],
)
def test_a_pressure_that_is_no_straight_line_is_refused(machine, change, reason):
    seal = replace(change(machine), name="center", position=0.43)
    with pytest.raises(
        InvalidInput, match=f'"seal.center.pressure" cannot be uncertain: .*{reason}'
    ):
        replace(machine, seals=(seal,))


def test_a_relative_tolerance_of_no_pressure_is_refused(machine):
    with pytest.raises(
        InvalidInput, match=r"seal\.center\.pressure is 0, but must be non-zero.*absolute"
    ):
        uncertain(assemble(machine, machine.operation.points[1]))


def test_nominal_is_unchanged_and_maps_to_the_reduced_plant(machine):
    plant = reduce(assemble(machine), 1)
    assert response(perturbed(plant, {})) == pytest.approx(response(plant), rel=1e-8)


@pytest.mark.parametrize(
    ("path", "part"),
    [
        ("seal.middle.k", "middle"),
        ("seal.center.q", "q"),
        ("bearing.A.mass", "mass"),
        ("bearing.A.negative_stiffness.x", "zeta"),
        ("amplifier.bandwidth", "amplifier of order"),
        ("seal.center.M", r'acceleration.*give "seal.center.K" or "seal.center.C"'),
        ("rotor.mass", "rotor"),
    ],
)
def test_unknown_paths_name_the_part(machine, path, part):
    with pytest.raises(InvalidInput, match=part):
        uncertain(assemble(machine), [Tolerance(path, relative=0.1)])


def test_no_tolerance_at_all(machine):
    with pytest.raises(InvalidInput, match="has no tolerance"):
        uncertain(assemble(replace(machine, tolerances=())))


# A perturbed plant stays perturbed. Before, its reduction and its uncertainty were silently those
# of the nominal plant.
DELTA = {
    "seal.center.k": 0.8,
    "bearing.A.negative_stiffness": -1.0,
    "amplifier.natural_frequency": 0.5,
}
TOLERANCES = tuple(Tolerance(path, relative=0.3) for path in DELTA)


@pytest.fixture(scope="module")
def plant(machine):
    return assemble(machine)


@pytest.fixture(scope="module")
def moved(plant):
    return perturbed(plant, DELTA, TOLERANCES)


@pytest.fixture(scope="module")
def truth(machine):
    for path, delta in DELTA.items():
        machine = CASES[path][1](machine, 1 + 0.3 * delta)
    return assemble(machine)


@pytest.mark.parametrize("fewer", [lambda p: reduce(p, 2), lambda p: free_mode_reduction(p, 12)])
def test_reduction_of_a_perturbed_plant_is_perturbed(plant, moved, truth, fewer):
    small = fewer(moved)
    assert small.offsets == moved.offsets
    assert response(small) == pytest.approx(
        response(perturbed(fewer(plant), DELTA, TOLERANCES)), rel=1e-9
    )
    slow = slice(0, 3)
    ours, nominal, wanted = (response(fewer(p))[slow, :4, :4] for p in (moved, plant, truth))
    error, shift = (np.abs(x - wanted).max() for x in (ours, nominal))
    assert error < 0.02 * shift


def test_uncertainty_is_centred_on_the_perturbed_plant(plant, moved):
    band = [Tolerance("seal.center.k", relative=0.1)]
    at = perturbed(moved, {}, band)
    assert response(at) == pytest.approx(response(moved), rel=1e-9, abs=1e-18)
    box = uncertain(moved, band)
    assert box.blocks == (RealBlock("seal.center.k", 2),)
    closed = close_uncertainty(box, {"seal.center.k": 1.0})
    ours = frequency_response(
        select(closed, plant.system.inputs, plant.system.outputs), OMEGA
    ).values
    wider = DELTA | {"seal.center.k": 0.8 + 1 / 3}
    truth = response(perturbed(plant, wider, TOLERANCES))
    assert ours == pytest.approx(truth, rel=1e-8, abs=1e-12 * np.abs(truth).max())


def test_perturbing_again_sets_the_parameters_named(plant, moved):
    again = perturbed(moved, {"seal.center.k": -0.2}, TOLERANCES)
    truth = perturbed(plant, DELTA | {"seal.center.k": -0.2}, TOLERANCES)
    assert response(again) == pytest.approx(response(truth), rel=1e-9, abs=1e-18)
    back = perturbed(moved, dict.fromkeys(DELTA, 0.0), TOLERANCES)
    assert back.offsets == ()
    assert response(back) == pytest.approx(response(plant), rel=1e-6, abs=1e-12)


def test_a_perturbed_plant_says_so(moved):
    assert "offsets=[seal.center.k +0.8, bearing.A.negative_stiffness -1" in repr(moved)
    assert len(repr(moved)) < 200
    assert moved.to_dict()["offsets"] == DELTA
    json.dumps(moved.to_dict())


def test_members_do_not_know_of_each_other(plant, moved):
    """Of a plant as it is and of one that is moved already; those of a stack are the same."""
    names = [tolerance.parameter for tolerance in plant.machine.tolerances]
    values = (0.5, -1.0)
    for source in (plant, moved):
        once, other = (perturbed(source, dict.fromkeys(names, value)).system for value in values)
        again = perturbed(source, dict.fromkeys(names, values[0])).system
        np.testing.assert_array_equal(again.A, once.A)
        assert np.abs(once.A - source.system.A).max() > 0
        assert np.abs(once.A - other.A).max() > 0
    model = uncertain(plant)
    A, B, C, D = upper_lft(model.system, np.array(values)[:, None, None] * np.eye(model.n_w_blocks))
    for i, value in enumerate(values):
        alone = perturbed(plant, dict.fromkeys(names, value))
        mine = replace(
            alone,
            system=StateSpace(A[i], B[i], C[i], D[i], plant.system.inputs, plant.system.outputs),
        )
        assert response(mine) == pytest.approx(response(alone), rel=1e-9)
