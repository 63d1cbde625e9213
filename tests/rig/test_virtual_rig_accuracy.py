"""Is the virtual rig right: order of the integrator, energy, the linear simulation, the magnets'
coefficients.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.sampling import c2d
from ambrose.law.loop import closed_loop
from ambrose.law.pid import pid_controller
from ambrose.machine.description import Amplifier, Coupling, OperatingPoint
from ambrose.machine.part import CasingMode, PidSettings, Support
from ambrose.model.assemble import assemble
from ambrose.model.effects import magnet
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.rig import linear, virtual_rig
from ambrose.rig.engine.controller import NO_PROGRAM, sampled_law
from ambrose.rig.engine.equilibrium import propagator, state_at_rest
from ambrose.rig.engine.inputs import plan, stretch
from ambrose.rig.engine.state import build, compiled
from ambrose.rig.scenario import Prbs, Pulse, Scenario, Unbalance
from run_ups import RUN_UP

RIG = load_machine("seal-rig")
WEIGHTLESS = replace(RIG, gravity_direction=None)
PID = pid_controller(RIG.controller, RIG)
EXPANDER = load_machine("turboexpander")


def largest(record, reference, names):
    """Largest difference over the largest value, per kind of signal."""
    found = {}
    for kind in names:
        signals = [
            name
            for name in reference.signals
            if name.startswith(f"{kind}_") and name in record.signals
        ]
        a, b = record.select(signals).values, reference.select(signals).values
        found[kind] = np.abs(a - b).max() / np.abs(b).max()
    return found


def test_third_order_convergence():
    """Errors fall as the third power of the step; one step per sample stays below 1e-7 at
    amplitudes of 50 um.
    """
    scenario = Scenario(
        "x", 0.3, sequences=(Prbs("e_A_zeta", 0.5, 1e-3, 7), Prbs("e_B_eta", 0.5, 1e-3, 7, 1))
    )

    def apart(modes, steps):
        fine = virtual_rig.run(RIG, PID, scenario, dt=2e-6, bending_modes=modes).record
        runs = [
            virtual_rig.run(RIG, PID, scenario, dt=n and 1e-4 / n, bending_modes=modes).record
            for n in steps
        ]
        assert np.abs(runs[0]["y_A_zeta"]).max() > 2e-5
        return [max(largest(run, fine, "yiq").values()) for run in runs]

    errors = apart(1, (1, 2, 4, 8))  # measured: 3.5, 3.3, 3.2
    np.testing.assert_allclose(np.log2(errors[1:3]) - np.log2(errors[2:]), 3.0, atol=0.4)
    assert max(errors[0], *apart(3, (None,))) < 1e-7


@pytest.mark.parametrize(
    "point", [OperatingPoint(), OperatingPoint(speed=300.0, seal_pressure=1e5)]
)
def test_contact_at_the_default_step(point):
    """1e-8 of the largest motion within 5 ms of the first touch, 2e-7 after 140 ms and many impacts
    (measured: 5e-9 and 1.2e-7; 1.4e-3 and 2e-2 where steps took no notice of where a contact
    begins, 3e-4 where they took none of an amplifier's stop).
    """
    pulses = (Pulse("f_A_zeta", 2500.0, 5e-3, 8e-3), Pulse("f_B_eta", 1800.0, 5e-3, 8e-3))
    scenario = Scenario(
        "x", 0.15, pulses=pulses[: 2 if point.speed else 1], speed=point.speed or None
    )
    default, fine = (virtual_rig.run(RIG, PID, scenario, point=point, dt=dt) for dt in (None, 1e-6))
    assert fine.touchdown_at is not None and fine.touchdown_at == default.touchdown_at
    end = round((fine.touchdown_at + 5e-3) / 1e-4)
    signals = [name for name in fine.record.signals if name.startswith("q_")]
    a, b = (run.record.select(signals).values for run in (default, fine))
    assert np.abs(a - b)[:, :end].max() < 1e-8 * np.abs(b).max()
    assert np.abs(a - b).max() < 2e-7 * np.abs(b).max()


def test_energy_without_damping_is_kept():
    """Undamped rotor on stiff springs, turning, magnets at constant bias: the drift falls as the
    third power of the step.
    """
    springs = tuple(Coupling(f"s{i}", x, (2e7, 3e7)) for i, x in enumerate((0.1, 0.75)))
    machine = replace(
        WEIGHTLESS, seals=(), tolerances=(), couplings=springs, modal_damping=0.0, controller=None
    )
    no_iron = tuple(replace(b, iron=None) for b in RIG.bearings)
    machine = replace(machine, amplifier=Amplifier(), bearings=no_iron)
    rig = build(machine, OperatingPoint(speed=500.0), 1)
    k, p = rig.constants, rig.modes
    task = plan(rig, Scenario("x", 0.5, sample_time=1e-4), 1e-4, 0)
    law = sampled_law(pid_controller(PidSettings(gain=(0.0,)), RIG), RIG, 1e-4, 0.0, 1)

    def energy(z):
        q, v = z[: 2 * p].reshape(p, 2), z[2 * p : 4 * p].reshape(p, 2)
        places = k.shape @ q
        total = 0.5 * (v**2).sum() + 0.5 * (k.stiffness[:, None] * q**2).sum()
        for s, (row, (c, d)) in enumerate(zip(places, k.direction, strict=True)):
            zeta, eta = c * row[0] + d * row[1], c * row[1] - d * row[0]
            if s < 2:
                for x, factor, gap in (
                    (zeta, k.magnet[s, 4], k.magnet[s, 5]),
                    (eta, k.magnet[s, 7], k.magnet[s, 8]),
                ):
                    total -= (
                        factor * k.magnet[s, 0] ** 2 * (1 / (gap - x) + 1 / (gap + x) - 2 / gap)
                    )
            elif s < 4:
                stiff = springs[s - 2].stiffness
                total += 0.5 * (stiff[0] * zeta**2 + stiff[1] * eta**2)
        return total

    drift = []
    for steps in (1, 2):
        z = state_at_rest(rig, np.tile([0.3e-4, 0.15e-4], p) * np.sqrt(70), np.zeros(4))
        z[4:6] *= 0.05
        drive = stretch(task, 0, 5000)
        before = energy(z)
        log, errors = np.empty((5000, 16 + len(rig.port_names))), np.empty((5000, 4))
        ahead = propagator(
            rig, drive, drive, steps, state_at_rest(rig, np.zeros(2 * p), np.zeros(4))
        )
        done = compiled()[0](
            k,
            law,
            NO_PROGRAM,
            drive,
            ahead,
            steps,
            z,
            np.zeros(0),
            np.zeros(4),
            rig.work(),
            log,
            errors,
            None,
        )
        assert (
            done == 5000
            and np.hypot(log[:, 16], log[:, 17]).max() < 0.4 * RIG.bearings[0].touchdown_gap
        )
        drift.append(abs(energy(z) / before - 1))
    assert drift[0] < 1e-8 and 6 < drift[0] / drift[1] < 10


_PAIRS = tuple(
    replace(s, position=s.position + side * 0.01, angle=0.2 * side + 0.5, weight=2.0 + side)
    for s in WEIGHTLESS.sensors
    for side in (1, -1)
)
_SUPPORTS = (
    Support("A", (80.0, 95.0), (6e7, 9e7), (3e3, 4e3), seals=("center",)),
    Support("B", (120.0, 120.0), (2e8, 1.2e8), (5e3, 5e3), angle=0.3, sensor="ground"),
)
_CASING = CasingMode(450.0, 200.0, ("A", "B"), (1.0, 0.5), (0.0, 0.3))
STOOD = replace(
    WEIGHTLESS,
    sensors=_PAIRS,
    supports=_SUPPORTS,
    casing_modes=(_CASING,),
    seals=(replace(RIG.seals[0], M=4.0),),
)
CASES = {
    "seal rig, nominal pressure": (WEIGHTLESS, None, 1),
    "two bending modes, no pressure": (WEIGHTLESS, OperatingPoint(), 2),
    "turning, added mass": (
        replace(WEIGHTLESS, seals=(replace(RIG.seals[0], M=4.0),)),
        OperatingPoint(speed=1200.0, seal_pressure=1e5),
        1,
    ),
    "turboexpander at full speed": (
        replace(load_machine("turboexpander"), gravity_direction=None),
        None,
        1,
    ),
    "its seal with states": (
        replace(EXPANDER, seals=(replace(EXPANDER.seals[0], frequency_dependence="states"),)),
        EXPANDER.operation.points[4],
        1,
    ),
    "turned sensors in pairs, on supports": (
        STOOD,
        OperatingPoint(speed=300.0, seal_pressure=1e5),
        1,
    ),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("drive", ["e_A_zeta", "f_B_eta"])
def test_small_motion_is_that_of_the_linear_simulation(case, drive):
    """The linear loop with the same sampled, delayed controller: equal to 1e-6 for small
    amplitudes.
    """
    machine, point, modes = CASES[case]
    point = machine.operation.nominal if point is None else point
    K = pid_controller(machine.controller, machine)
    amplitude = 1e-4 if drive.startswith("e") else 1e-2
    scenario = Scenario("x", 0.05, pulses=(Pulse(drive, amplitude, 2e-3, 5e-3),))
    step = 5e-6 if modes == 1 else 2.5e-6
    rig = virtual_rig.run(machine, K, scenario, point=point, bending_modes=modes, dt=step)
    plant = free_mode_reduction(assemble(machine, point), modes)
    expected = linear.run(
        closed_loop(plant, c2d(K, 1e-4, "tustin", delay=1e-4)), scenario, point=point
    )
    assert max(largest(rig.record, expected.record, "yuiq").values()) < 1e-6
    assert rig.pole == pytest.approx(expected.pole, rel=1e-3, abs=0.5)
    assert rig.stable == expected.stable


def test_run_up_is_that_of_the_linear_simulation():
    """Gyroscopic moments, unbalance and its angular acceleration; the linear run-up is good to its
    own estimate.
    """
    scenario = RUN_UP
    point = OperatingPoint(speed=scenario.speed)

    def loop_at(speed):
        plant = free_mode_reduction(assemble(WEIGHTLESS, OperatingPoint(speed=speed)), 1)
        return closed_loop(plant, c2d(PID, 1e-4, "tustin", delay=1e-4))

    expected = linear.run(loop_at, scenario, mass=68.9758)
    rig = virtual_rig.run(WEIGHTLESS, PID, scenario, point=point, bending_modes=1)
    assert max(largest(rig.record, expected.record, "yuiq").values()) < 5e-3


def test_unbalance_by_amount_and_phase():
    """Constant speed, small amount: steady amplitude and phase of the linear loop."""
    scenario = Scenario(
        "x",
        0.4,
        unbalances=(Unbalance("A", 1e-6, phase=0.7), Unbalance("center", 2e-6)),
        speed=900.0,
    )
    point = OperatingPoint(speed=900.0)
    rig = virtual_rig.run(WEIGHTLESS, PID, scenario, point=point, dt=1e-5)
    plant = free_mode_reduction(assemble(WEIGHTLESS, point), 3)
    expected = linear.run(
        closed_loop(plant, c2d(PID, 1e-4, "tustin", delay=1e-4)), scenario, point=point
    )
    # a sampled loop sees forces averaged over samples
    assert max(largest(rig.record, expected.record, "yuiq").values()) < 2e-3


@pytest.mark.parametrize("bias", [6.0, 8.0, 10.0])
def test_magnet_coefficients_from_loads_and_displacements(bias):
    """K_i from a load that the integrator carries at the centre, K_s from a commanded displacement
    (P2), within 0.1 %.
    """
    bare = replace(WEIGHTLESS, seals=(), couplings=(), tolerances=(), amplifier=Amplifier())
    point = OperatingPoint(bias_current=bias)
    known = [magnet.linearised(b, bias) for b in RIG.bearings]
    gain = tuple(
        2 * k_s / k_i
        for c in known
        for k_i, k_s in zip(c.force_per_current, c.negative_stiffness, strict=True)
    )
    K = pid_controller(PidSettings(gain, integral_time=0.05, derivative_time=1e-3), bare)
    load, shift = 20.0, 2e-6
    loaded = virtual_rig.run(
        bare, K, Scenario("load", 2.0, pulses=(Pulse("f_A_zeta", load, 0.0),)), point=point
    )
    moved = Scenario(
        "move", 2.0, pulses=(Pulse("r_A_zeta", shift, 0.0), Pulse("r_B_zeta", shift, 0.0))
    )
    moved = virtual_rig.run(bare, K, moved, point=point)
    assert loaded.outcome == moved.outcome == "completed" and loaded.stable
    k_i = -load / loaded.record["i_A_zeta"][-1]
    k_s = -k_i * moved.record["i_A_zeta"][-1] / moved.record["q_A_zeta"][-1]
    assert k_i == pytest.approx(known[0].force_per_current[0], rel=1e-3)
    assert k_s == pytest.approx(known[0].negative_stiffness[0], rel=1e-3)
    slope = magnet.linearised(RIG.bearings[0], 6.0).force_per_current[0] / 6.0
    assert (k_i < 0.9 * slope * bias) == (bias == 10.0)  # the iron saturates at 10 A


def test_a_magnet_with_iron_loses_force_at_large_currents():
    """The same coefficients at the bias; the iron then limits what a large current adds."""
    from ambrose.machine.description import MagnetIron

    air, iron = (
        replace(
            RIG,
            bearings=tuple(replace(b, iron=kind, coefficients_at="no-load") for b in RIG.bearings),
        )
        for kind in (None, MagnetIron(200.0, 1.6, 5e-5))
    )
    load = Scenario("load", 1.0, pulses=(Pulse("f_A_zeta", 150.0, 0.0),))
    currents = [
        virtual_rig.run(m, PID, load, point=OperatingPoint()).record["i_A_zeta"][-1]
        for m in (air, iron)
    ]
    small = Scenario("load", 1.0, pulses=(Pulse("f_A_zeta", 0.1, 0.0),))
    no_weight = [replace(m, gravity_direction=None) for m in (air, iron)]
    little = [
        virtual_rig.run(m, PID, small, point=OperatingPoint()).record["i_A_zeta"][-1]
        for m in no_weight
    ]
    assert abs(currents[1]) > 1.001 * abs(currents[0])
    assert little[1] == pytest.approx(little[0], rel=1e-5)
