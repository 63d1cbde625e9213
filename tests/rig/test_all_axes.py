"""The rig of all axes: equal to its parts where nothing joins them, one C function in the loop
equal to its twins, and what cannot run together is refused.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

import ambrose as amb
from ambrose.code.block.run import run_of
from ambrose.code.c.compiled import CompiledAxes
from ambrose.core.checks import InvalidInput
from ambrose.model.effects.rotor import finite_element_rotor, mass_properties
from ambrose.report.record import record_page
from ambrose.rig.scenario import Failure, Pulse, Scenario, SpeedChange, Unbalance
from needs import needs

EXAMPLE = Path(__file__).parents[2] / "examples" / "expander-five-axes.toml"
LIFT = Scenario(
    "lift",
    0.3,
    pulses=(Pulse("f_thrust_z", -120.0, 0.15), Pulse("e_first_zeta", 0.2, 0.2, 0.01)),
    unbalances=(Unbalance("every", grade=2.5e-3, grade_speed=3000.0),),
    speed=0.0,
    speed_changes=(SpeedChange(0.1, 300.0, 0.1),),
    initial="resting",
)


@cache
def machine():
    return amb.load_machine(EXAMPLE)


@cache
def laws():
    return amb.design(machine(), "pid", axes="radial"), amb.design(machine().axial, "pid")


@cache
def lifted():
    radial, axial = laws()
    return amb.simulate(machine(), radial, LIFT, axial=axial, point="standstill", seed=4)


def test_each_part_moves_as_by_itself():
    """To the last bit: the radial axes by themselves, and the one along the shaft with the next
    seed.
    """
    radial, axial = laws()
    across, along = LIFT.parted(machine())
    alone = amb.simulate(machine(), radial, across, point="standstill", seed=4, axes="radial")
    thrust = amb.simulate(machine().axial, axial, along, point="standstill", seed=5)
    run = lifted()
    assert run.outcome == "completed", run.text
    for record in (alone.record, thrust.record):
        for name in record.signals:
            assert np.array_equal(run.record[name], record[name]), name
    assert np.abs(run.record["q_T_z"][-1]) < 1e-4 < np.abs(run.record["q_T_z"][0])
    page = record_page(run, machine())
    (section,) = (part for part in page.sections if part.title == "Along the shaft")
    assert len(section.figures) == 4  # between the stops, outputs, currents, forces


def test_a_controller_of_both_groups_and_the_file_s_own_pids_run_all_axes():
    """As the two controllers given one by one; what takes the radial axes alone is said."""
    radial, axial = laws()
    both = replace(radial, thrust=axial)
    short = Scenario("short", 0.02, pulses=(Pulse("f_thrust_z", -60.0, 0.0),))
    runs = [
        amb.simulate(machine(), law, short, point="standstill", seed=4, **given)
        for law, given in ((radial, {"axial": axial}), (both, {}), (None, {}))
    ]
    for run in runs:
        assert np.array_equal(run.record.values, runs[0].record.values)
        assert "q_T_z" in run.record.signals and "alone" not in run.text
        assert [part for part, _ in run.laws] == ["Controller", "Axial controller"]
    narrow = {"point": "standstill", "seed": 4}
    thrust = amb.simulate(machine(), both, short, axes="thrust", **narrow)
    assert np.array_equal(
        thrust.record["q_T_z"],
        amb.simulate(machine().axial, axial, short, **narrow).record["q_T_z"],
    )
    push = Scenario("push", 0.02, pulses=(Pulse("e_first_zeta", 0.2, 0.0),))
    alone = amb.simulate(machine(), both, push, linear=True)
    assert "q_T_z" not in alone.record.signals
    assert alone.text.endswith("radial axes alone: the linear model is of one group of axes")
    assert [part for part, _ in alone.laws] == ["Controller"]


@needs("C compiler")
def test_one_c_function_holds_all_axes(tmp_path):
    """Lift-off, run-up, surge, trip, landing; what it did in the loop is what the twins of both
    blocks do with the same readings.
    """
    radial, axial = laws()
    folder = tmp_path / "c"
    done = amb.export(radial, folder, machine=machine(), axial=axial, to="c", force=True)
    assert done.axial is not None
    code = CompiledAxes(done.block, done.axial.block)
    run = amb.simulate(machine(), code, "five-axes", point="standstill")
    time, record = run.record.time, run.record
    assert run.outcome == "touchdown" and 3.506 < run.touchdown_at < 3.508, run.text
    gaps = {axis: 0.2e-3 for axis in "AB"}
    for axis, gap in gaps.items():
        r = np.hypot(record[f"q_{axis}_zeta"], record[f"q_{axis}_eta"])
        assert r[(time > 0.1) & (time < 3.5)].max() < 0.2 * gap
        assert gap < r[time > 4.5].mean() and r.max() < 2 * gap
    # landing goes on where the run was when its magnets had let go: the same blow
    fallen = amb.landing(machine(), "rated", record=record, trip=3.503, duration=0.02)
    first = fallen.fall.figures[0]
    r = np.hypot(record["q_A_zeta"], record["q_A_eta"])
    assert 3.503 + first[0] == pytest.approx(time[np.argmax((r > 0.2e-3) & (time > 3.5))], abs=1e-4)
    blow = (time > 3.5) & (time < 3.523)
    assert first[5] == pytest.approx(r[blow].max(), rel=0.02)
    z = record["q_T_z"]
    assert np.abs(z[(time > 0.1) & (time < 3.5)]).max() < 0.5 * 0.25e-3
    assert z[time > 3.6].max() < -0.25e-3  # on the stop to which the thrust pulls
    for block, axes in ((done.block, machine().axes), (done.axial.block, ("T_z",))):
        errors = -np.column_stack([record[f"y_{axis}"] for axis in axes])
        twin = run_of(block, errors).currents
        acted = np.column_stack([record[f"u_{axis}"] for axis in axes])
        assert np.abs(acted[1:] - twin[:-1]).max() <= 1e-12 * np.abs(twin).max()
    steady = replace(LIFT, speed_changes=(), speed=200.0)
    still = replace(steady, initial="levitated", duration=0.05, pulses=())
    counted = CompiledAxes(done.block, done.axial.block, "fixed32")
    for program in (code, counted):  # begun with the states that hold the weight
        run = amb.simulate(machine(), program, still, point="rated")
        assert run.outcome == "completed", run.text
        assert np.abs(run.record["q_A_eta"]).max() < 5e-6


def test_the_power_of_all_axes_fails_at_once():
    radial, axial = laws()
    trip = Scenario("trip", 0.1, failures=(Failure(0.02),))
    run = amb.simulate(machine(), radial, trip, axial=axial, point="rated")
    assert run.outcome == "touchdown"
    gone = run.record.time > 0.05
    assert np.abs(run.record["i_T_z"][gone]).max() < 1e-3
    assert run.record["q_T_z"][gone].min() < -0.2e-3  # the rated thrust pulls to the left
    assert "T_z: touchdown" in run.text


def test_a_rotor_at_rest_lies_on_contact_elements_and_mount_in_series():
    """N/k_c, the elements' deflection from K d^1.5 of both rows, N/k_m: under half the weight."""
    radial, _ = laws()
    rest = Scenario("rest", 0.4, failures=(Failure(0.0),), initial="resting", speed=0.0)
    run = amb.simulate(machine(), radial, rest, point="standstill", axes="radial")
    late = run.record.time > 0.35
    K, p = 1e3 / 1e-5**1.5, (100 / (1e3 / 1e-5**1.5)) ** (2 / 3)
    total = 0.0
    for name in "AB":
        r = np.hypot(run.record[f"q_{name}_zeta"], run.record[f"q_{name}_eta"])[late].mean()
        depth = r - 0.2e-3

        def under(N, depth=depth):
            d = brentq(lambda d: K * ((p + d) ** 1.5 - max(p - d, 0) ** 1.5) - N, 0, 1e-4)
            return N / 1e8 + d + N / 5e6 - depth

        total += brentq(under, 0.0, 1e3)
    assert total == pytest.approx(
        9.80665 * mass_properties(finite_element_rotor(machine())).mass, rel=2e-3
    )


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"machine": "seal-rig"}, "no thrust bearing"),
        (
            {"axial": None, "axes": "radial", "scenario": "five-axes"},
            r"acts along the shaft; give its axial.*--axial",
        ),
        ({"linear": True}, "axial is given, but must be left out with linear"),
        ({"rate": 1e4, "axial": "late"}, "one processor runs both"),
    ],
)
def test_what_cannot_run_together_is_refused(how, words):
    radial, axial = laws()
    target = amb.load_machine(how["machine"]) if "machine" in how else machine()
    if how.get("axial") == "late":
        slow = machine().axial
        axial = amb.design(
            replace(slow, controller=replace(slow.controller, sample_time=2e-4)), "pid"
        )
    if how.get("axial", "") is None:
        axial = None
    rest = {name: how[name] for name in ("linear", "rate", "axes") if name in how}
    with pytest.raises(InvalidInput, match=words):
        amb.simulate(target, radial, how.get("scenario", LIFT), axial=axial, **rest)
