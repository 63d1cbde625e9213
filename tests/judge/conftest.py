"""Machines and plants for the verification tests: a rig with a flexible shaft, and single masses
with closed forms.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ambrose.core.statespace import StateSpace
from ambrose.law.pid import pid_controller
from ambrose.machine.description import (
    Amplifier,
    Coupling,
    MagneticBearing,
    OperatingPoint,
    Operation,
    Requirements,
)
from ambrose.machine.machine import Machine
from ambrose.machine.part import PidSettings, Seal, Sensor, ShaftSection
from ambrose.model.assemble import assemble
from ambrose.model.plant import Plant

AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
PID = PidSettings(gain=(18250.0,), integral_time=0.2, derivative_time=3.5e-3, derivative_filter=0.1)


def make_rig() -> Machine:
    """A 69 kg rotor on two magnetic bearings with a destabilising seal in the middle (the thesis'
    test rig, by hand).
    """
    lengths = (0.05, 0.054, 0.116, 0.15, 0.12, 0.15, 0.116, 0.054, 0.05)
    outer = (0.08, 0.0854, 0.0854, 0.0854, 0.14, 0.0854, 0.0854, 0.0854, 0.08)
    starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
    points = (("nominal", 2.04e5), ("zero", 0.0), ("twice", 4.08e5))
    return Machine(
        "rig",
        tuple(
            ShaftSection(float(s), n, d, mass_diameter=0.15 if i in {2, 6} else None, elements=1)
            for i, (s, n, d) in enumerate(zip(starts, lengths, outer, strict=True))
        ),
        tuple(
            MagneticBearing(
                name,
                x,
                4.0,
                np.pi / 4,
                k_i,
                k_s,
                gap=5e-4,
                touchdown_gap=2.5e-4,
                max_current=4.0,
                max_force=7500.0,
            )
            for name, x, k_i, k_s in (
                ("A", 0.162, (144.34, 139.44), (0.863e6, 0.871e6)),
                ("B", 0.698, (163.75, 163.48), (1.226e6, 1.215e6)),
            )
        ),
        (Sensor("A", 0.0813), Sensor("B", 0.7787)),
        amplifier=Amplifier("second", natural_frequency=1360.0, damping=1590.5),
        seals=(Seal("center", 0.43, 0.43e6, 3.203e6, 2.524e3, -2.554e3, 0.0, 2.04e5, ("k",)),),
        couplings=(Coupling("coupling", 0.0, (0.4e6, 0.42e6)),),
        controller=PID,
        operation=Operation(tuple(OperatingPoint(0.0, p, label=label) for label, p in points)),
        requirements=Requirements(
            balance_grade=2.5e-3,
            balance_speed=2 * np.pi * 500,
            unbalance_orbit=8e-6,
            unbalance_to=2 * np.pi * 200,
        ),
        assumed=(("seal.center.scales_with_pressure", "P5 section 4.1 varies k alone"),),
    )


@pytest.fixture(scope="session")
def rig() -> Machine:
    return make_rig()


@pytest.fixture(scope="session")
def rig_plants(rig: Machine) -> dict[str, Plant]:
    return {point.label: assemble(rig, point) for point in rig.operation.points}


@pytest.fixture(scope="session")
def rig_controller(rig: Machine) -> StateSpace:
    return pid_controller(PID, rig)


def make_single_masses(mass=2.0, k_i=100.0, k_s=2e5, damping=0.0, requirements=None) -> Plant:
    """Four equal, uncoupled masses m q'' + d q' - k_s q = k_i u + f on ideal amplifiers: every axis
    has a closed form.
    """
    machine = replace(
        make_rig(),
        bearings=tuple(
            replace(b, force_per_current=(k_i, k_i), negative_stiffness=(k_s, k_s))
            for b in make_rig().bearings
        ),
        seals=(),
        couplings=(),
        amplifier=Amplifier("none"),
        requirements=requirements or Requirements(),
    )
    eye, zero = np.eye(4), np.zeros((4, 4))
    A = np.block([[zero, eye], [k_s / mass * eye, -damping / mass * eye]])
    B = np.block([[zero, zero], [k_i / mass * eye, eye / mass]])
    C = np.block([[eye, zero], [zero, zero], [eye, zero], [zero, eye]])
    D = np.zeros((16, 8))
    D[4:8, :4] = eye
    system = StateSpace(
        A,
        B,
        C,
        D,
        [f"{kind}_{a}" for kind in "uf" for a in AXES],
        [f"{kind}_{a}" for kind in ("y", "i", "q", "qdot") for a in AXES],
    )
    return Plant(machine, OperatingPoint(label="single masses"), system, system, AXES)


def make_pd(gain: float, derivative: float, time_constant: float) -> StateSpace:
    """gain + derivative s/(time_constant s + 1) on every axis."""
    eye = np.eye(4)
    return StateSpace(
        -eye / time_constant,
        eye / time_constant,
        -derivative / time_constant * eye,
        (gain + derivative / time_constant) * eye,
    )


@pytest.fixture(scope="session", name="single_masses")
def _single_masses():
    return make_single_masses


@pytest.fixture(scope="session", name="pd_controller")
def _pd_controller():
    return make_pd
