"""The rig of the axis along the shaft: against closed forms, the linear loop and an integration of
the test's own; the whole chain from a record to the machine file and to C in the loop.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.statespace import StateSpace
from ambrose.identification.findings import Code
from ambrose.machine.file.toml import dumps_machine, load_machine
from ambrose.machine.file.update import save_machine
from ambrose.model.axial import at_point, core_lags, loaded, sides
from ambrose.rig.scenario import Failure, Pulse, Scenario, load_scenario

sys.path.insert(0, str(Path(__file__).parent))
from rotor import machine

EXAMPLE = Path(__file__).parents[2] / "examples" / "expander-five-axes.toml"
IDEAL = {
    "conductivity = 4e6": 'conductivity = 4e6\ncore = "laminated"\nstop_damping = 0',
    'order = "first"\nbandwidth = "1.5 kHz"': 'order = "none"',
}
SATURATING = {"permeability = 600": 'permeability = 600\nflux_density = "0.7 T"'}


def mass_of(axial):
    return math.pi / 4 * 0.048**2 * 0.4 * axial.shaft[0].material.density


def test_a_collar_without_power_strikes_its_stop_as_a_mass_on_a_spring():
    """Undamped, from rest: t = sqrt(2 c m/F), largest force F (1 + sqrt(1 + 2 k c/F)); the bias has
    a lag of 0.2 ms, and the collar begins at the centre.
    """
    axial = machine(IDEAL).axial
    drop = Scenario("drop", 0.02, failures=(Failure(0.0),))
    run = amb.simulate(axial, amb.design(axial, "pid"), drop, point="rated", dt=2e-6)
    c, k, thrust = 0.25e-3, axial.thrust.stop_stiffness, 120.0
    assert run.outcome == "touchdown"
    assert run.touchdown_at == pytest.approx(math.sqrt(2 * c * mass_of(axial) / thrust), rel=0.02)
    deepest = run.record["q_T_z"].max() - c
    assert k * deepest == pytest.approx(thrust * (1 + math.sqrt(1 + 2 * k * c / thrust)), rel=0.02)


def test_small_motion_is_that_of_the_linear_loop():
    axial = machine().axial
    law = amb.design(axial, "pid")
    push = Scenario("push", 0.1, pulses=(Pulse("f_T_z", 1.0, 0.01, 0.02),))
    curved, straight = (
        amb.simulate(axial, law, push, point="rated", linear=linear).record["y_T_z"]
        for linear in (False, True)
    )
    moved = curved - curved[50]
    assert np.abs(moved - straight).max() < 2e-3 * np.abs(straight).max()


def test_large_motion_is_that_of_an_integration_of_the_equations():
    """A proportional controller, sampled and one sample late, and a pulse of 2.5 A into iron that
    saturates: the cores' lags, the iron and the gaps bend the force.
    """
    axial, gain = machine(SATURATING).axial, 1.5e4
    law = StateSpace(
        np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[gain]], ["err_T_z"], ["u_T_z"]
    )
    pulse = Scenario("pulse", 6e-3, pulses=(Pulse("e_T_z", 2.5, 0.0),))
    run = amb.simulate(axial, law, pulse, point="rest", dt=1e-6).record
    parts = [*zip(sides(axial.thrust), core_lags(axial.thrust), (-1.0, 1.0), strict=True)]
    mass, lag = mass_of(axial), 2 * math.pi * 1500

    def slope(t, z, told):
        result, force, at = [z[1], 0.0, lag * (told - z[2])], 0.0, 3
        for side, model, way in parts:
            own = z[at : at + len(model.poles)]
            phi = model.weights @ own
            gap, limit = side.gap - way * z[0], side.flux_limit
            short = side.slope * gap * phi + side.iron * phi * limit / (limit - phi)
            met = side.slope * side.gap + side.iron
            w = (side.turns * max(side.bias + way * z[2], 0.0) - short + met * phi) / met
            result += list(model.poles * (w - own))
            force += way * side.slope * phi**2 / 2
            at += len(own)
        result[1] = force / mass
        return result

    z = [0.0, 0.0, 0.0]
    for side, model, _ in parts:
        z += [side.flux(side.bias, side.gap)] * len(model.poles)
    acting, own = 0.0, []
    for _ in run.time:
        own.append(z[0])
        told = min(max(acting + 2.5, -3.0), 3.0)
        acting = min(max(-gain * z[0], -3.0), 3.0)
        z = solve_ivp(slope, (0, 1e-4), z, "Radau", args=(told,), rtol=1e-7, atol=1e-12).y[:, -1]
    free = np.array(own) < 0.24e-3  # of its stop
    assert free.sum() > 40
    assert np.abs(run["q_T_z"] - own)[free].max() < 1e-3 * 0.24e-3


def test_scenarios_of_the_radial_rig_act_along_the_shaft():
    axial = machine().axial
    names = {item.signal for item in load_scenario("prbs").on(axial).sequences}
    assert names == {"e_T_z"}
    assert load_scenario("surge").on(axial).sines[0].amplitude == 60.0
    assert load_scenario("thrust-reversal").on(axial).pulses[0].amplitude == -240.0
    with pytest.raises(InvalidInput, match=r"thrust range.*thrust_bearing.load"):
        load_scenario("surge").on(machine())


def test_a_record_tells_the_magnets_and_the_file_takes_them(tmp_path):
    """Faces 10 % larger, gaps 5 % smaller, the core's corner as measured; with the controller of
    all axes, of which that of this one ran.
    """
    corner = 'permeability = 600\ncore_corner = "18 Hz"'
    scaled = f"{corner}\nface_scale = 1.1\ngap_scale = 0.95"
    real, known = (machine({"permeability = 600": text}).axial for text in (scaled, corner))
    law = amb.design(known.whole, "pid")
    run = amb.simulate(real, law, "prbs", point="rated")
    path = tmp_path / "expander.toml"
    path.write_text(dumps_machine(known.whole))
    found = amb.identify(f"{path}#axial", run.record, law).updated().machine
    at, wanted = (at_point(item, item.operation.points[3]) for item in (found, real))
    assert at.force_per_current == pytest.approx(wanted.force_per_current, rel=2e-3)
    assert at.stiffness == pytest.approx(wanted.stiffness, rel=2e-3)
    assert found.thrust.face_scale == pytest.approx(1.1, rel=0.01)
    assert found.thrust.gap_scale == pytest.approx(0.95, rel=0.01)
    save_machine(found, path)
    assert load_machine(f"{path}#axial") == found
    assert load_machine(path).bearings == known.whole.bearings


@pytest.mark.parametrize("amplitude", [pytest.param(0.1, marks=pytest.mark.study), 0.3])
def test_a_collar_that_the_thrust_holds_off_centre_is_identified_where_it_stands(amplitude):
    """Without integral action; the magnets' own bend, which goes with the square of the excitation,
    is taken out. Against the slopes of the rig's circuit at the collar's mean place.
    """
    corner = 'permeability = 600\ncore_corner = "18 Hz"'
    axial = machine({"permeability = 600": corner}).axial
    law = amb.design(
        replace(axial, controller=replace(axial.controller, integral_time=None)), "pid"
    )
    prbs = load_scenario("prbs")
    sequences = tuple(replace(item, amplitude=amplitude) for item in prbs.sequences)
    run = amb.simulate(axial, law, replace(prbs, sequences=sequences), point="rated")
    place = float(run.record["q_T_z"].mean())
    assert abs(place) > 5e-6
    done = amb.identify(axial, run.record, law)
    at, load = at_point(axial, axial.operation.points[3]), axial.conditions[3].load
    wanted = loaded(axial.thrust, load, place)
    found = dict(zip(done.result.paths, done.result.values, strict=True))
    k_i, k_s = (
        found["thrust_bearing.T.force_per_current"],
        found["thrust_bearing.T.negative_stiffness"],
    )
    assert abs(wanted.stiffness / at.stiffness - 1) > 0.005  # what the place makes
    assert k_i == pytest.approx(wanted.force_per_current, rel=1e-3)
    assert k_s == pytest.approx(wanted.stiffness, rel=1e-3)
    assert not done.findings


def test_a_record_under_another_thrust_than_its_point_states_is_told():
    corner = 'permeability = 600\ncore_corner = "18 Hz"'
    axial = machine({"permeability = 600": corner}).axial
    law = amb.design(axial, "pid")
    run = amb.simulate(axial, law, "prbs", point="rated")
    conditions = tuple(replace(item, load=0.5 * item.load) for item in axial.conditions)
    done = amb.identify(replace(axial, conditions=conditions), run.record, law)
    assert Code.OTHER_LOAD in [item.code for item in done.findings]
    assert not done.passed


def test_the_example_lifts_off_and_stands_its_worst_day():
    axial = load_machine(f"{EXAMPLE}#axial")
    law = amb.design(axial, "pid")
    for name in ("levitation", "surge", "thrust-step", "thrust-reversal"):
        assert amb.simulate(axial, law, name, point="rated").outcome == "completed", name
    assert amb.simulate(axial, law, "power-loss", point="rated").outcome == "touchdown"


def test_its_code_is_exported_and_tests_itself(tmp_path):
    axial = machine().axial
    made = amb.export(amb.design(axial, "pid"), tmp_path / "code", to="c", machine=axial)
    assert made.verified
    text = (tmp_path / "code" / "controller.h").read_text()
    assert "CONTROLLER_INPUTS 1" in text
    assert "CONTROLLER_ERR_T_Z" in text
