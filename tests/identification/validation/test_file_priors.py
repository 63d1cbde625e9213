"""Numbers of the machine file that are a few per cent off are found beside those asked for, and
what is more than that stays a finding.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose.core.response import simulate
from ambrose.identification.findings import Code
from ambrose.identification.loop import identify_loop, usual_unknowns
from ambrose.identification.output_error.loop_model import loop_model, timed
from ambrose.identification.output_error.problem import FitOptions, build_experiment
from ambrose.identification.parameters import nominal_values, plant_at
from ambrose.identification.validation import plausibility as file_priors, suspects as tried
from ambrose.record.record import Record
from linear_rig import DT, E, Y, rig

SAMPLES = 4000


@pytest.fixture(autouse=True)
def rigid(monkeypatch):
    """The recorded rotor is rigid, which no rotor is: bending modes beyond the model are not looked
    for.
    """
    monkeypatch.setattr(tried, "FURTHER_MODES", 0)


@cache
def record(**off):
    """The linear loop of a machine whose numbers (path with _ for .) are off by a share."""
    machine, plant, _, law = rig()
    paths = tuple(path.replace("__", ".") for path in off)
    values = nominal_values(plant, paths) * (1 + np.array([*off.values()]))
    true = plant_at(machine, plant.point, dict(zip(paths, values, strict=True)), 0)
    loop, _ = timed(loop_model(true, law, (), np.zeros(0), E, Y), 1.0, ()).loop(np.zeros(0))
    e = np.stack([0.1 * waveforms.prbs(9, 10, SAMPLES, shift=127 * i) for i in range(4)])
    y = simulate(loop, e)[:4] + 2e-8 * np.random.default_rng(0).standard_normal((4, SAMPLES))
    names, units = (*Y, *E), ("m",) * 4 + ("A",) * 4
    return Record("seal-rig", 1 / DT, names, units, np.vstack([y, e]), plant.point)


def identified(data, along=True):
    machine, _, controller, _ = rig()
    unknown = usual_unknowns(machine, [data])
    how = FitOptions(bending_modes=0)
    return identify_loop(machine, [data], controller, unknown, along=along, options=how)


def test_numbers_of_the_file_a_few_per_cent_off_are_found_along():
    off = {"amplifier__damping": 0.04, "seal__center__C": -0.05}
    alone, done = identified(record(**off), along=False), identified(record(**off))
    assert [item.code for item in alone.findings] == [Code.RESIDUALS] and not alone.found_along

    # magnets and seal as they are, the numbers of the file as they were made, all in their intervals
    assert done.passed and "amplifier.damping" in done.remarks[0]
    truth = {path: 1 + off.get(path.replace(".", "__"), 0.0) for path in done.result.paths}
    assert {"amplifier.damping", "seal.center.C"} < truth.keys()
    for row in done.parameters:
        miss = row.value - truth[row.path] * row.start
        assert abs(miss) < 3 * row.standard_deviation, row.path
        assert row.standard_deviation < 0.035 * abs(row.start)
    machine = done.updated().machine
    assert machine.amplifier.damping == pytest.approx(1.04 * 1590.5, rel=0.005)


def test_a_number_of_the_file_far_off_stays_a_finding():
    done = identified(record(amplifier__damping=0.3))
    assert Code.RESIDUALS in [item.code for item in done.findings] and not done.found_along
    assert "amplifier.damping" not in done.result.paths


def test_what_no_record_tells_apart_the_file_does():
    """Bayes' rule in its other form, the gain P E (S + P_ff)^-1 of a least-squares estimate with the
    covariance P on the file's numbers as measurements.
    """
    machine, _, controller, _ = rig()
    data, how = record(), FitOptions(bending_modes=0)
    paths = (
        "bearing.A.force_per_current.zeta",
        "seal.center.K",
        "coupling.coupling.stiffness.zeta",
    )
    experiment = build_experiment(machine, data, controller, paths, how)
    begin = experiment.nominal * np.array([1.01, 0.98, 1.02])
    found = file_priors._posterior(experiment, begin, 1)
    H, g, _, middle = tried.equations_at(experiment, found.theta, coloured=True)
    free, P = found.theta + np.linalg.solve(H, g), np.linalg.inv(H) @ middle @ np.linalg.inv(H)
    S = np.diag((tried.FILE * experiment.nominal[1:]) ** 2)
    gain = P[:, 1:] @ np.linalg.inv(S + P[1:, 1:])
    expected = free + gain @ (experiment.nominal - free)[1:]
    assert (np.abs(found.theta - expected) < 0.05 * found.deviations).all()
    np.testing.assert_allclose(found.covariance, P - gain @ P[1:], rtol=1e-3)
    assert (found.deviations[1:] <= tried.FILE * experiment.nominal[1:]).all()


def test_with_bounds_of_the_file_s_own_a_number_is_an_unknown_and_not_found_along():
    machine, _, _, _ = rig()
    stated = replace(machine.tolerances[0], parameter="amplifier.damping", relative=0.05, around=())
    machine = replace(machine, tolerances=(*machine.tolerances, stated))
    unknown = usual_unknowns(machine, [record()])
    assert "amplifier.damping" in unknown
    assert "amplifier.damping" not in tried.file_numbers(machine, unknown)
