"""Sensors at another angle than the magnets and several pairs at one bearing: plant, reference
controller, virtual rig.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.chain.check import insight, springs
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.core.statespace import select
from ambrose.law.loop import closed_loop
from ambrose.law.pid import mixings, pid_controller
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.part import PidSettings, Runout
from ambrose.model.assemble import assemble
from ambrose.model.effects import sensor
from ambrose.model.plant import measured_ports, sensor_ports, sensor_turn
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Pulse, Scenario
from ambrose.synthesis.fixed_order.structure import axis_groups

RIG = load_machine("seal-rig")
TURN = np.radians([20.0, -70.0])  # of the sensors of A and B from their magnets
OMEGA = np.geomspace(1.0, 1e4, 25)


def turned(machine=RIG):
    """The machine with sensors turned from their bearings' axes."""
    angles = {b.name: b.angle + turn for b, turn in zip(machine.bearings, TURN, strict=True)}
    return replace(
        machine, sensors=tuple(replace(s, angle=angles[s.bearing]) for s in machine.sensors)
    )


def doubled(machine=RIG, apart=0.0, turn=0.0, **changes):
    """Two pairs for every bearing, symmetric about the place of the one."""
    pairs = []
    for s in machine.sensors:
        angle = (
            next(b.angle for b in machine.bearings if b.name == s.bearing)
            if s.angle is None
            else s.angle
        )
        pairs.append(replace(s, position=s.position + apart, angle=angle))
        pairs.append(replace(s, position=s.position - apart, angle=angle + turn, **changes))
    return replace(machine, sensors=tuple(pairs))


def test_the_measured_axes_are_the_sensors():
    machine = turned()
    G, H = (frequency_response(assemble(item).system, OMEGA).values for item in (RIG, machine))
    for k, turn in enumerate(TURN):
        c, s = np.cos(turn), np.sin(turn)
        expected = np.einsum("ij,fjk->fik", np.array([[c, s], [-s, c]]), G[:, 2 * k : 2 * k + 2])
        np.testing.assert_allclose(
            H[:, 2 * k : 2 * k + 2], expected, rtol=1e-9, atol=1e-9 * np.abs(G[:, :4]).max()
        )
    np.testing.assert_array_equal(H[:, 4:], G[:, 4:])  # what the rotor does is the same
    np.testing.assert_array_equal(sensor_turn(RIG), np.eye(4))


@pytest.mark.parametrize("coordinates", ["axes", "tilt-translate"])
def test_a_pid_turns_what_it_reads_to_the_magnets(coordinates):
    settings = replace(
        RIG.controller, coordinates=coordinates, tilt_gain=1.2, gain=RIG.controller.gain[:1]
    )
    poles = [
        np.sort_complex(
            np.linalg.eigvals(closed_loop(assemble(item), pid_controller(settings, item)).A)
        )
        for item in (RIG, turned())
    ]
    slow = np.abs(poles[0]) < 1e4
    np.testing.assert_allclose(poles[1][slow], poles[0][slow], rtol=1e-7)
    assert springs(turned())["B"] == pytest.approx(springs(RIG)["B"], rel=1e-12)


def test_without_the_turn_the_loop_is_another():
    """The check above can fail: a decentralised law straight from turned sensors loses the
    rotor.
    """
    machine = turned()
    straight = closed_loop(assemble(machine), pid_controller(RIG.controller, RIG))
    assert np.linalg.eigvals(straight.A).real.max() > 1


def test_planes_share_nothing_only_where_sensors_and_magnets_are_parallel():
    assert axis_groups(RIG, "plane") == ((0, 2), (1, 3))
    assert axis_groups(turned(), "plane") == ((0, 1, 2, 3),)


@pytest.mark.parametrize("change", [{}, {"turn": 0.7}, {"turn": np.pi / 2}])
def test_a_second_pair_at_the_same_place_changes_nothing(change):
    one, two = (assemble(item).system for item in (turned(), doubled(turned(), **change)))
    np.testing.assert_allclose(
        frequency_response(two, OMEGA).values,
        frequency_response(one, OMEGA).values,
        rtol=1e-9,
        atol=1e-16,
    )


def test_pairs_on_both_sides_read_the_middle_of_a_rotor_that_does_not_bend():
    apart = doubled(apart=0.01)
    assert [port.name for port in sensor_ports(apart)][:4] == [
        "A_zeta",
        "A_eta",
        "A_zeta.2",
        "A_eta.2",
    ]
    np.testing.assert_allclose(
        [port.position for port in measured_ports(apart)],
        [port.position for port in measured_ports(RIG)],
        rtol=1e-14,
    )
    found, expected = (
        frequency_response(assemble(item).system, np.array([5.0])).values[0, :4]
        for item in (apart, RIG)
    )
    assert np.abs(found - expected).max() < 2e-4 * np.abs(expected).max()  # by static bending alone
    # each pair on its own; their meshes differ by the nodes of the other one
    both = assemble(apart, every_mode=True).rotor
    for k, name in enumerate(("s_A_zeta", "s_A_zeta.2")):
        alone = assemble(replace(RIG, sensors=apart.sensors[k::2]), every_mode=True).rotor
        read = [
            frequency_response(select(rotor, ["f_A_zeta", "f_B_eta"], [signal]), OMEGA).values
            for rotor, signal in ((both, name), (alone, "s_A_zeta"))
        ]
        np.testing.assert_allclose(*read, rtol=1e-6)


def test_weights_gains_and_lags_belong_to_each_pair():
    pairs = (
        replace(RIG.sensors[0], weight=3.0, bandwidth=4000.0),
        replace(RIG.sensors[0], gain=(1.1, 0.9), bandwidth=None),
    )
    system = sensor.linearised(
        replace(RIG, sensors=(*pairs, RIG.sensors[1])).sensor_pairs, RIG.axes
    )
    values = frequency_response(system, OMEGA).values
    lag = 4000 / (1j * OMEGA + 4000)
    assert system.inputs[:4] == ("s_A_zeta", "s_A_eta", "s_A_zeta.2", "s_A_eta.2")
    np.testing.assert_allclose(values[:, 0, 0], 0.75 * lag, rtol=1e-12)
    np.testing.assert_allclose(values[:, 1, 3], 0.25 * 0.9, rtol=1e-12)


def quiet(machine):
    sensors = (
        replace(s, noise=0.0, resolution=0.0, runout=(), offset=(0.0, 0.0)) for s in machine.sensors
    )
    return replace(machine, sensors=tuple(sensors))


def trace(machine, **keys):
    push = Pulse(f"f_{machine.bearings[0].name}_zeta", 50.0, 0.005, 0.002)
    return virtual_rig.run(
        machine, pid_controller(RIG.controller, machine), Scenario("push", 0.03, (push,)), **keys
    ).record


def test_the_rig_reads_along_its_sensors_and_takes_their_mean():
    base = quiet(RIG)
    plain = trace(base)
    round_about = trace(turned(base))
    twice = trace(doubled(turned(base), turn=0.7))
    for name in (*(f"q_{a}" for a in RIG.axes), *(f"u_{a}" for a in RIG.axes)):
        size = np.abs(plain[name]).max()
        np.testing.assert_allclose(round_about[name], plain[name], rtol=0, atol=1e-7 * size)
        np.testing.assert_allclose(twice[name], plain[name], rtol=0, atol=1e-7 * size)
    c, s = np.cos(TURN[0]), np.sin(TURN[0])
    zeta, eta = plain["y_A_zeta"], plain["y_A_eta"]
    np.testing.assert_allclose(
        round_about["y_A_zeta"], c * zeta + s * eta, rtol=0, atol=1e-7 * np.abs(zeta).max()
    )
    np.testing.assert_allclose(
        twice["y_A_eta"], c * eta - s * zeta, rtol=0, atol=1e-7 * np.abs(zeta).max()
    )


def test_noise_offset_and_run_out_of_every_sensor_of_its_own():
    """Two pairs halve the variance; opposite offsets cancel; run-out turns with the sensor that
    reads it.
    """
    pair = tuple(replace(s, noise=1e-6, offset=(5e-6, 0.0)) for s in quiet(RIG).sensors)
    second = tuple(replace(s, offset=(-5e-6, 0.0)) for s in pair)
    one, two = (
        virtual_rig.run(item, pid_controller(RIG.controller, item), Scenario("still", 0.06)).record
        for item in (replace(RIG, sensors=pair), replace(RIG, sensors=(*pair, *second)))
    )
    spread = [np.std(np.diff(item[f"y_{a}"])) for a in RIG.axes for item in (one, two)]
    ratio = np.sqrt(np.mean(np.square(spread[1::2])) / np.mean(np.square(spread[0::2])))
    assert ratio == pytest.approx(2**-0.5, rel=0.1)
    track = tuple(
        replace(s, runout=(Runout(1, 2e-6, 0.3),), bandwidth=None) for s in quiet(RIG).sensors
    )
    machine = turned(replace(RIG, sensors=track, gravity_direction=None))
    still = replace(machine, sensors=tuple(replace(s, runout=()) for s in machine.sensors))
    speed = replace(RIG.operation.points[0], speed=200.0)
    law = pid_controller(PidSettings(RIG.controller.gain, derivative_time=2e-3), machine)
    runs = [
        virtual_rig.run(item, law, Scenario("still", 0.001), point=speed, computing_delay=1).record[
            "y_A_eta"
        ][0]
        for item in (machine, still)
    ]
    assert runs[0] - runs[1] == pytest.approx(
        2e-6 * np.cos(-(machine.sensors[0].angle + np.pi / 2) + 0.3), rel=1e-6
    )


def test_files_checks_and_refusals():
    machine = doubled(turned(), apart=0.004, weight=2.0)
    assert loads_machine(dumps_machine(machine)) == machine
    remarks = insight(assemble(machine))["remarks"]
    assert any("sensors of A, B at another angle than the magnets" in line for line in remarks)
    np.testing.assert_allclose(mixings(RIG.controller, machine)[0], sensor_turn(machine))
    for changes, message in (
        (
            {"weight": 0.0},
            "weight is 0, but must be positive for one pair of the bearing; leave it out for "
            "equal shares",
        ),
        ({"weight": -1.0}, "weight is -1, but must be zero or positive; 1 is an equal share"),
    ):
        with pytest.raises(InvalidInput, match=message):
            replace(RIG, sensors=(replace(RIG.sensors[0], **changes), RIG.sensors[1]))
    text = dumps_machine(machine).replace(
        f"angle = {float(machine.sensors[0].angle)!r}", 'angle = "left"', 1
    )
    with pytest.raises(InvalidInput, match=r"\[\[sensor\]\] A: angle .*left"):
        loads_machine(text)
