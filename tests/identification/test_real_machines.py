"""Identification with turned sensors in pairs and bearings on supports: what follows from the
plant, and from statics.
"""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.frequency import frequency_response
from ambrose.identification.findings import Code
from ambrose.identification.seal.by_frequency import _Model
from ambrose.identification.static_load import Levels, bearing_forces
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.part import CasingMode, Support
from ambrose.model.assemble import assemble
from ambrose.model.static_load import magnet_coefficients, operating_magnets
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import load_scenario
from coarse import coarse

RIG = coarse("seal-rig")
PAIRS = tuple(
    replace(s, position=s.position + side * 0.01, angle=0.4 + 0.3 * side, weight=2.0 + side)
    for s in RIG.sensors
    for side in (1, -1)
)
REAL = replace(
    RIG,
    sensors=PAIRS,
    casing_modes=(CasingMode(900.0, 900.0, ("A", "B"), (1.0, 0.5)),),
    supports=(
        Support("A", (80.0, 95.0), (6e7, 9e7), seals=("center",)),
        Support("B", (120.0, 120.0), (2e8, 1.2e8), sensor="ground"),
    ),
)
POINT = replace(RIG.operation.points[0], seal_pressure=0.0)


def test_static_loads_give_the_magnets_forces():
    """Loads from outside act on the rotor alone, the magnets' on the supports, too; sensors read
    along their own angles.
    """
    law = pid_controller(replace(REAL.controller, integral_time=None), REAL)
    loop = closed_loop(assemble(REAL, POINT), law)
    names, ports = REAL.axes, ("A_zeta", "B_eta", "center_x")
    at = (
        frequency_response(loop, np.zeros(1))
        .values[0]
        .real[:, [loop.inputs.index(f"f_{p}") for p in ports]]
    )
    loads = 100 * np.vstack([np.eye(3), [1.0, -1.0, 0.5]])
    y, i, q = (loads @ at[[loop.outputs.index(f"{kind}_{a}") for a in names]].T for kind in "yiq")
    levels = Levels(ports, loads, y, i, np.zeros_like(i), np.ones(4), np.zeros(4))
    found, places = bearing_forces(REAL, POINT, levels)
    k_i, k_s = magnet_coefficients(REAL, POINT)
    np.testing.assert_allclose(places, q, rtol=0, atol=2e-4 * np.abs(q).max())
    np.testing.assert_allclose(found, k_i * i + k_s * q, rtol=0, atol=2e-4 * np.abs(found).max())


def test_the_rotor_between_seal_and_sensors():
    """What a stepped sine is read with: forces of magnets and seal between rotor and stator, to the
    mean of the sensors.
    """
    machine = replace(
        REAL, seals=(replace(REAL.seals[0], K=0.0, k=0.0, C=0.0, c=0.0),), tolerances=()
    )
    omega = np.array([30.0, 200.0])
    model = _Model(REAL, "center", POINT, omega, 1e-4)
    plant = assemble(machine, POINT)
    G = frequency_response(plant.system, omega).values
    currents = frequency_response(plant.system, omega).values[
        :, [plant.system.outputs.index(f"i_{a}") for a in REAL.axes]
    ]
    y = [plant.system.outputs.index(f"y_{a}") for a in REAL.axes]
    u = [plant.system.inputs.index(f"u_{a}") for a in REAL.axes]
    expected = G[:, y][:, :, u] @ np.linalg.inv(currents[:, :, u]) / model.k_i
    np.testing.assert_allclose(
        model.measured_by_force, expected, rtol=0, atol=1e-9 * np.abs(expected).max()
    )


@pytest.mark.usefixtures("values_alone")
def test_magnets_stated_without_load_are_found_at_it():
    """A rotor that hangs through, on magnets of a data sheet: the file that identify writes holds
    the same magnets.
    """
    machine = coarse("two-disc-rotor")
    law = amb.design(machine, "pid")
    record = virtual_rig.run(
        machine, law.controller, replace(load_scenario("prbs"), duration=0.6), bending_modes=2
    ).record
    done = amb.identify(machine, record, controller=law, bending_modes=2)
    assert {bearing.coefficients_at for bearing in done.machine.bearings} == {"static-load"}
    here, found = operating_magnets(machine), operating_magnets(done.machine)
    for bearing, own, other in zip(machine.bearings, here, found, strict=True):
        assert other.coefficients.negative_stiffness == pytest.approx(
            own.coefficients.negative_stiffness, rel=0.01
        )
        # what the load makes
        assert (
            min(np.divide(own.coefficients.negative_stiffness, bearing.negative_stiffness)) > 1.15
        )
        assert [other.parameters[k] for k in (4, 5, 7, 8)] == pytest.approx(
            [own.parameters[k] for k in (4, 5, 7, 8)], rel=0.01
        )
    assert not any(finding.code is Code.FAR_FROM_FILE for finding in done.findings)
