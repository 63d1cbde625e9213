"""A rotor that its controller holds off the sensors' zero: the coefficients are those at the zero."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.statespace import StateSpace
from ambrose.identification.output_error.problem import FitOptions
from ambrose.identification.parameters import plant_at
from ambrose.identification.seal import pipeline as time_domain
from ambrose.identification.seal.by_pressure import COEFFICIENTS
from ambrose.identification.validation.places import standing
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint
from ambrose.model.effects.seal import coefficients
from ambrose.model.static_load import operating_magnets
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import load_scenario
from coarse import coarse

RIG = coarse("seal-rig")
UNKNOWN = ("bearing.*.force_per_current.*", "bearing.*.negative_stiffness.*")


def leaking(leak: float) -> StateSpace:
    """The file's PID with an integral part that forgets: 1/(T_i (s + leak)) instead of 1/(T_i s)."""
    pid = RIG.controller
    direct = pid_controller(replace(pid, integral_time=None), RIG)
    gain = np.broadcast_to(pid.gain, 4) / pid.integral_time
    n, a = len(direct.A), len(gain)
    return StateSpace(
        np.block([[direct.A, np.zeros((n, a))], [np.zeros((a, n)), -leak * np.eye(a)]]),
        np.vstack([direct.B, np.eye(a)]),
        np.hstack([direct.C, np.diag(gain)]),
        direct.D,
        direct.inputs,
        direct.outputs,
    )


@pytest.mark.usefixtures("values_alone")
def test_values_are_carried_from_where_the_rotor_stood_to_the_sensors_zero():
    """Against the rig's own coefficients, which the machine file states there."""
    law = leaking(1.0)
    record = virtual_rig.run(RIG, law, replace(load_scenario("prbs"), duration=1.2)).record
    noise = 5e-8 * np.random.default_rng(1).standard_normal(record.values.shape)
    noise[[name[0] != "y" for name in record.signals]] = 0.0
    record = replace(record, values=record.values + noise)
    found = amb.identify(RIG, record, law, unknown=UNKNOWN)
    truth = np.array(
        [
            value
            for name in ("force_per_current", "negative_stiffness")
            for item in operating_magnets(RIG)
            for value in getattr(item.coefficients, name)
        ]
    )
    stood = found.result.values / found.standing.ratios
    assert np.abs(stood / truth - 1).max() > 0.008  # what the place makes
    off = np.abs(found.result.values - truth)
    assert (off < 3 * found.result.standard_deviations).all()
    assert (off / truth).max() < 0.002
    assert "um off the sensors' zero" in " ".join(found.remarks)

    own = [float(record[f"q_{axis}"].mean()) for axis in RIG.axes]  # the rig's, at the magnets
    assert list(found.standing.places.values()) == pytest.approx(own, rel=0.1)


@pytest.mark.usefixtures("values_alone")
def test_a_rotor_at_the_zero_keeps_its_values():
    plant = plant_at(RIG, RIG.operation.nominal, {})
    k = 200
    signals = tuple(f"y_{axis}" for axis in plant.axes)
    rows = 1e-6 * np.random.default_rng(0).standard_normal((4, k))
    record = amb.Record("seal-rig", 1e4, signals, ("m",) * 4, rows - rows.mean(axis=1)[:, None])
    estimate = type("Estimate", (), {"paths": (), "values": np.zeros(0)})()
    assert standing(RIG, [record], estimate, {}, FitOptions().bending_modes) is None


@pytest.mark.usefixtures("values_alone")
def test_a_seal_is_found_beside_magnets_at_the_place_of_the_record():
    """Under pressure, the rotor off the zero: magnets as there, their nonlinearity taken out."""
    law, point = leaking(0.25), OperatingPoint(seal_pressure=1e5)
    record = virtual_rig.run(
        RIG, law, replace(load_scenario("prbs"), duration=1.2), point=point
    ).record
    fit = time_domain.identify(RIG, [record], law)
    known = coefficients(RIG.seals[0], 1e5)
    truth = np.array([getattr(known, name) for name in COEFFICIENTS])
    off = np.abs(fit.values[0] - truth)
    assert (off < 4 * fit.deviations[0]).all()
    stiffness = fit.deviations[0][[COEFFICIENTS.index(name) for name in "kK"]]
    assert stiffness.max() < 2000  # N/m; 4 standard deviations of 2500 to 3900 before
