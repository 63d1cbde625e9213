"""The exponential step against the Runge-Kutta method of order four with fine steps, on all kinds
of machines.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Amplifier
from ambrose.machine.part import CasingMode, Runout, Support
from ambrose.rig import virtual_rig
from ambrose.rig.engine import equilibrium as propagator
from ambrose.rig.engine.state import compiled
from ambrose.rig.scenario import (
    Failure,
    Prbs,
    PressureChange,
    Pulse,
    Scenario,
    Sine,
    SpeedChange,
    Unbalance,
)

RIG = load_machine("seal-rig")
EXPANDER = load_machine("turboexpander")
SEQUENCES = (Prbs("e_A_zeta", 0.5, 1e-3, 7), Prbs("e_B_eta", 0.5, 1e-3, 7, 1))
SHAKEN = Scenario("x", 0.03, sequences=SEQUENCES)
TURNING = replace(SHAKEN, speed=900.0, unbalances=(Unbalance("A", 1e-4, phase=0.7),))
RUN_UP = replace(TURNING, speed=300.0, speed_changes=(SpeedChange(0.005, 500.0, 0.02),))
PRESSURE = replace(SHAKEN, pressures=(PressureChange(0.01, 1.2e5, 0.02),))
DRIVEN = replace(
    SHAKEN,
    sines=(Sine("f_A_zeta", 200.0, 2000.0, 0.3),),
    pulses=(Pulse("f_B_eta", 100.0, 0.01, 0.01),),
)
SEEN = replace(
    RIG,
    sensors=tuple(
        replace(
            s, bandwidth=2e4, offset=(1e-6, 2e-6), runout=(Runout(1, 3e-6, 0.2), Runout(5, 1e-6))
        )
        for s in RIG.sensors
    ),
)
SUPPORTS = (
    Support("A", (80.0, 95.0), (6e7, 9e7), (3e3, 4e3), seals=("center",)),
    Support("B", (120.0, 120.0), (2e8, 1.2e8), (5e3, 5e3), angle=0.3, sensor="ground"),
)
CASING = CasingMode(450.0, 200.0, ("A", "B"), (1.0, 0.5), (0.0, 0.3))
HEAVY = replace(RIG, seals=(replace(RIG.seals[0], M=4.0),))
STATES = replace(EXPANDER, seals=(replace(EXPANDER.seals[0], frequency_dependence="states"),))
CASES = {
    "rigid": (RIG, SHAKEN, 0),
    "one mode, driven": (RIG, DRIVEN, 1),
    "turning": (RIG, TURNING, 1),
    "run-up": (RIG, RUN_UP, 1),
    "run-up, rotating damping": (
        replace(RIG, rayleigh_beta=1e-5, loss_factor=0.1, rotating_share=0.7),
        RUN_UP,
        1,
    ),
    "pressure": (RIG, PRESSURE, 1),
    "added mass": (HEAVY, replace(RUN_UP, pressures=PRESSURE.pressures), 1),
    "run-out before the sensors' lag": (SEEN, replace(RUN_UP, sequences=()), 1),
    "supports": (replace(HEAVY, supports=SUPPORTS, casing_modes=(CASING,)), RUN_UP, 1),
    "ideal amplifier": (replace(RIG, amplifier=Amplifier()), DRIVEN, 1),
    "twice first": (
        replace(RIG, amplifier=Amplifier("twice-first", bandwidth=2e3, eddy_bandwidth=9e3)),
        TURNING,
        1,
    ),
    "seal with states": (
        STATES,
        replace(SHAKEN, sequences=(), pulses=(Pulse("f_B_eta", 20.0, 2e-3, 5e-3),)),
        1,
    ),
}
LIMITED = {
    "voltage limit": (
        replace(
            RIG, amplifier=Amplifier("first", bandwidth=2e3, max_voltage=100.0, inductance=0.1)
        ),
        TURNING,
    ),
    "a failure": (RIG, replace(SHAKEN, failures=(Failure(0.015, "A_zeta"),), duration=0.02)),
    "a stop of the slope": (
        replace(RIG, amplifier=replace(RIG.amplifier, max_voltage=100.0, inductance=0.1)),
        TURNING,
    ),
    "a stop of the current, contact": (
        RIG,
        replace(SHAKEN, pulses=(Pulse("f_B_eta", 1500.0, 0.005, 0.003),)),
    ),
}


def apart(record, reference):
    """Largest difference of measurements and displacements over the largest value."""
    signals = [name for name in reference.signals if name.startswith(("y_", "q_"))]
    a, b = record.select(signals).values, reference.select(signals).values
    return np.abs(a - b).max() / np.abs(b).max()


@pytest.fixture
def runge_kutta(monkeypatch):
    """Runs with the Runge-Kutta method alone, in these steps [s]."""
    found = virtual_rig.propagator

    def run(machine, scenario, modes, dt):
        with monkeypatch.context() as patch:
            patch.setattr(virtual_rig, "propagator", lambda *of: found(*of)._replace(usable=False))
            return virtual_rig.run(
                machine,
                pid_controller(machine.controller, machine),
                scenario,
                bending_modes=modes,
                dt=dt,
            )

    return run


@pytest.mark.parametrize("case", CASES)
def test_one_step_per_sample_is_good_to_1e_7(case, runge_kutta):
    machine, scenario, modes = CASES[case]
    fine = runge_kutta(machine, scenario, modes, 5e-6)
    fast = virtual_rig.run(
        machine, pid_controller(machine.controller, machine), scenario, bending_modes=modes
    )
    assert fine.outcome == fast.outcome
    assert np.abs(fine.record["q_A_zeta"]).max() > 1e-6
    assert apart(fast.record, fine.record) < 1e-7


def test_no_kind_of_machine_or_scenario_is_compiled_anew():
    """A matrix in columns where others are in rows cost 17 s: rotating damping's."""

    def compiled_for(case):
        machine, scenario, modes = CASES[case]
        law = pid_controller(machine.controller, machine)
        virtual_rig.run(machine, law, scenario, bending_modes=modes)
        return [len(function.signatures) for function in compiled()]

    first = compiled_for("rigid")
    assert {case: compiled_for(case) for case in CASES} == dict.fromkeys(CASES, first)


@pytest.mark.parametrize("case", LIMITED)
def test_where_an_amplifier_is_limited_it_is_as_good_as_runge_kutta(case, runge_kutta):
    """Samples in which a limit acts are those of the Runge-Kutta method; stops at which a state
    stays (amplifiers of order two) are located (1.4e-5 and 2.2e-7; before 2.8e-3 and 4.6e-3), kinks
    are not (5.7e-5).
    """
    machine, scenario = LIMITED[case]
    fine = runge_kutta(machine, scenario, 1, 1e-6)
    fast = virtual_rig.run(
        machine, pid_controller(machine.controller, machine), scenario, bending_modes=1
    )
    assert (
        apart(fast.record, fine.record)
        < 2 * apart(runge_kutta(machine, scenario, 1, None).record, fine.record)
        < 2e-4
    )


def test_a_propagator_is_kept_while_it_holds(monkeypatch):
    """At constant speed one for all stretches; along a run-up one for each of 4000 samples."""
    made = []
    found = propagator._built
    monkeypatch.setattr(propagator, "_built", lambda *of: made.append(1) or found(*of))
    pid = pid_controller(RIG.controller, RIG)
    virtual_rig.run(RIG, pid, replace(TURNING, duration=1.0))
    assert len(made) == 2  # the first is that of the start, without unbalance
    made.clear()
    virtual_rig.run(
        RIG,
        pid,
        replace(TURNING, duration=1.0, speed=0.0, speed_changes=(SpeedChange(0.0, 600.0, 1.0),)),
    )
    assert len(made) == 4
