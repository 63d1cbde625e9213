"""Records at several operating points in one fit, and the eight entries of a seal's matrices each
on its own.
"""

from functools import cache

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.output_error.closed_loop import identify
from ambrose.identification.parameters import nominal_values
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop
from ambrose.machine.description import OperatingPoint, Tolerance
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.record.record import Record

DT, NOMINAL = 1e-4, 2.04e5
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
Y, E = tuple(f"y_{a}" for a in AXES), tuple(f"e_{a}" for a in AXES)
ENTRIES = tuple(
    f"seal.center.{name}"
    for name in ("K_xx", "K_yy", "k_xy", "k_yx", "C_xx", "C_yy", "c_xy", "c_yx")
)


@cache
def rig():
    machine = load_machine("seal-rig")
    return machine, pid_synthesis(free_mode_reduction(assemble(machine), 0)).controller


def plant_at(pressure, bias=None):
    return free_mode_reduction(
        assemble(rig()[0], OperatingPoint(seal_pressure=pressure, bias_current=bias)), 0
    )


def record(plant, k=2500, noise=0.0, seed=0, axes=(0, 1, 2, 3)):
    e = np.zeros((4, k))
    for i in axes:
        e[i] = 0.1 * waveforms.prbs(9, 10, k, shift=127 * i)
    y = simulate(select(closed_loop(plant, c2d(rig()[1], DT, "tustin", delay=DT)), E, Y), e)
    y = y + noise * np.random.default_rng(seed).standard_normal(y.shape)
    return Record(
        "seal-rig", 1 / DT, (*Y, *E), ("m",) * 4 + ("A",) * 4, np.vstack([y, e]), plant.point
    )


def test_one_fit_over_pressures():
    machine, controller = rig()
    paths = (
        "seal.center.k",
        "seal.center.C",
        "bearing.A.force_per_current.zeta",
        "amplifier.natural_frequency",
    )
    records = [record(plant_at(p)) for p in (0.0, NOMINAL / 2, NOMINAL)]
    truth = nominal_values(plant_at(NOMINAL), paths)
    begin = dict(zip(paths, truth * np.array([0.7, 0.8, 1.1, 0.9]), strict=True))
    found = identify(machine, records, controller, paths, start=begin, bending_modes=0)
    assert found.point.seal_pressure == NOMINAL  # where the values belong to
    np.testing.assert_allclose(found.values, truth, rtol=1e-6)
    # k follows the pressure
    assert truth[0] == pytest.approx(2 * nominal_values(plant_at(NOMINAL / 2), paths)[0])


def test_points_together_tell_what_each_tells():
    machine, controller = rig()
    paths = ("seal.center.k", "bearing.A.negative_stiffness.zeta")
    noisy = [record(plant_at(p), noise=1e-7, seed=i) for i, p in enumerate((0.0, NOMINAL))]
    alone = identify(machine, noisy[1], controller, paths, bending_modes=0)
    both = identify(machine, noisy, controller, paths, bending_modes=0)
    # nothing of k without pressure
    other = identify(machine, noisy[0], controller, paths[1:], bending_modes=0)
    expected = np.linalg.inv(
        np.linalg.inv(alone.covariance) + np.diag([0.0, 1 / other.covariance[0, 0]])
    )
    np.testing.assert_allclose(both.standard_deviations, np.sqrt(np.diag(expected)), rtol=0.1)
    truth = nominal_values(plant_at(NOMINAL), paths)
    assert (np.abs(both.values - truth) < 4 * both.standard_deviations).all()


def test_bearings_at_two_biases_are_refused():
    machine, controller = rig()
    records = [record(plant_at(NOMINAL, bias), 600) for bias in (None, 4.5)]
    with pytest.raises(
        InvalidInput,
        match=r"at the bias .* A is another number.*identify each bias current on its own",
    ):
        identify(machine, records, controller, ["bearing.*.negative_stiffness.*"], bending_modes=0)
    found = identify(machine, records, controller, ["amplifier.natural_frequency"], bending_modes=0)
    np.testing.assert_allclose(found.values, 1360.0, rtol=1e-6)


@pytest.mark.parametrize("axes", [(0, 1, 2, 3), (0, 1)])
def test_eight_entries_of_a_seal(axes):
    machine, controller = rig()
    plant = plant_at(NOMINAL)
    nominal = nominal_values(plant, ENTRIES)
    changed = dict(zip(ENTRIES, (1.0, -1.0, 1.0, 0.5, -0.5, 1.0, 1.0, -1.0), strict=True))
    other = perturbed(
        plant,
        changed,
        [Tolerance(p, absolute=0.2 * abs(v)) for p, v in zip(ENTRIES, nominal, strict=True)],
    )
    data = record(other, axes=axes)
    found = identify(machine, data, controller, ENTRIES, bending_modes=0)
    truth = nominal + 0.2 * np.abs(nominal) * np.array(list(changed.values()))
    np.testing.assert_allclose(found.values, truth, rtol=1e-5, atol=0)
    every = identify(
        machine,
        data,
        controller,
        ["seal.*.K_*", "seal.center.k_*", "seal.center.C_*", "seal.*.c_*"],
        bending_modes=0,
    )
    assert every.paths == ENTRIES
    np.testing.assert_allclose(every.values, found.values, rtol=1e-9)


def test_one_direction_does_not_tell_the_eight_entries():
    machine, controller = rig()
    plant = plant_at(NOMINAL)
    two = identify(machine, record(plant, noise=1e-7), controller, ENTRIES, bending_modes=0)
    one = identify(
        machine, record(plant, noise=1e-7, axes=(0,)), controller, ENTRIES, bending_modes=0
    )
    assert one.standard_deviations.max() > 3 * two.standard_deviations.max()
    assert one.condition > 3 * two.condition
