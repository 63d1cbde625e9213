"""A rotor by its modes: the same plant as the drawing's in as many modes, at its speed and at no other."""

from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.core.checks import InvalidInput
from ambrose.core.frequency import frequency_response
from ambrose.machine.attachment import stations
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.machine.part import BendingMode, MeasuredRotor
from ambrose.model.assemble import assemble, in_plane
from ambrose.model.effects.rotor import (
    finite_element_rotor,
    free_modes,
    mass_properties,
    mesh_error,
    plane_rows,
)
from ambrose.model.uncertainty import free_mode_reduction


def measured(name, speed, count):
    """A bundled machine, its rotor told by mass, inertias and its lowest modes alone."""
    machine = amb.load_machine(name)
    rotor, places = finite_element_rotor(machine), stations(machine)
    own, modes = mass_properties(rotor), free_modes(rotor, count)
    plane = in_plane(modes)
    shapes = plane_rows(rotor, places)[0] @ plane[:, 2:]
    whole = plane.T @ rotor.plane_gyroscopic @ plane
    whirl = zip(whole[1, 2:].tolist(), np.diag(whole)[2:].tolist(), strict=True)
    ratios = modes.damping_ratios(machine)[4::2]
    rows = zip(modes.frequencies[4::2], ratios, shapes.T, whirl, strict=True)
    body = MeasuredRotor(
        own.mass, own.diametral_inertia, own.centre, own.polar_inertia, speed, places
    )
    return replace(
        machine,
        measured_rotor=body,
        bending_modes=tuple(
            BendingMode(k, float(w), float(zeta), tuple(phi), g)
            for k, (w, zeta, phi, g) in enumerate(rows, 1)
        ),
        operation=replace(
            machine.operation,
            points=(OperatingPoint(speed, label="as measured"),),
            ranges=(),
            speed_range=(0.0, 0.0),
            design_point="",
        ),
        tolerances=tuple(one for one in machine.tolerances if not one.around),
    )


def apart(one, other, hertz=3000, controlled=False):
    omega = 2 * np.pi * np.geomspace(1, hertz, 60)
    a = len(one.axes) if controlled else None
    A, B = (frequency_response(plant.system, omega).values[:, :a, :a] for plant in (one, other))
    return np.abs(A - B).max(axis=(1, 2)) / np.abs(A).max(axis=(1, 2))


@pytest.mark.parametrize("name", ["seal-rig", "flywheel", "outboard-sensor-rotor"])
def test_it_is_the_drawings_plant_in_as_many_modes(name):
    told = measured(name, 0.0, 3)
    drawn = free_mode_reduction(assemble(amb.load_machine(name), told.operation.nominal), 3)
    # what is left is the static load, which an elastic rotor shares out a little differently
    assert apart(drawn, assemble(told)).max() < 1e-6 * (
        1 + 1e4 * (told.gravity_direction is not None)
    )
    body = told.measured_rotor
    found = mass_properties(finite_element_rotor(told))
    assert (found.mass, found.centre) == pytest.approx((body.mass, body.centre), rel=1e-12)
    assert found.diametral_inertia == pytest.approx(body.diametral_inertia, rel=1e-12)
    assert found.polar_inertia == pytest.approx(body.polar_inertia, rel=1e-12)
    frequencies, error = mesh_error(told, 3)
    assert error.size == 0 and frequencies == pytest.approx(
        [mode.frequency for mode in told.bending_modes]
    )


def test_turning_it_lacks_only_what_parts_modes_from_one_another():
    told = measured("flywheel", 900.0, 3)
    drawn = free_mode_reduction(assemble(amb.load_machine("flywheel"), told.operation.nominal), 3)
    # its two lowest modes lie 3 % apart, at 3.7 kHz
    assert apart(drawn, assemble(told), 1000).max() < 1e-4
    assert apart(drawn, assemble(told)).max() < 5e-3


def test_two_places_tell_any_number_of_modes():
    """At two places every bending shape is a rigid motion's, and yet another mode."""
    told = measured("flywheel", 0.0, 2)
    ends = (told.bearings[0].position, told.bearings[1].position)
    at = [told.measured_rotor.places.index(place) for place in ends]
    sensors = tuple(
        replace(sensor, position=bearing.position)
        for sensor, bearing in zip(told.sensors, told.bearings, strict=True)
    )
    few = replace(
        told,
        sensors=sensors,
        measured_rotor=replace(told.measured_rotor, places=ends),
        bending_modes=tuple(
            replace(mode, shape=tuple(mode.shape[k] for k in at)) for mode in told.bending_modes
        ),
    )
    many = replace(told, sensors=sensors)
    assert apart(assemble(few), assemble(many), controlled=True).max() < 1e-9


def test_the_file_holds_it():
    told = measured("turbomolecular-pump", 900.0, 2)
    assert loads_machine(dumps_machine(told)) == told
    bare = replace(
        told,
        measured_rotor=MeasuredRotor(3.0, speed=900.0),
        bending_modes=(),
    )
    found = mass_properties(finite_element_rotor(bare))
    assert found.centre == pytest.approx(bare.length / 2)
    assert found.diametral_inertia == pytest.approx(3 * bare.length**2 / 12)
    assert loads_machine(dumps_machine(bare)) == bare


@pytest.mark.parametrize(
    "change, words",
    [
        ({"measured_rotor": None}, "are a \\[measured_rotor\\]'s"),
        ({"mass": -1.0}, "weigh the rotor"),
        ({"speed": 10.0}, "as measured is at 900 rad/s; measure there"),
        ({"places": (0.02, 9.0)}, "on the shaft"),
        ({"places": (0.2, 0.1)}, "do not ascend"),
        ({"number": 3}, "not numbered 1, 2, 3"),
        ({"frequency": None}, "has a frequency and one deflection"),
        ({"shape": (1.0,)}, "has a frequency and one deflection"),
    ],
)
def test_refusals(change, words):
    told = measured("turbomolecular-pump", 900.0, 2)
    first, second = told.bending_modes
    key = next(iter(change))
    with pytest.raises(InvalidInput, match=words):
        if key == "measured_rotor":
            replace(told, measured_rotor=None)
        elif key in {"number", "frequency", "shape"}:
            replace(told, bending_modes=(first, replace(second, **change)))
        else:
            replace(told, measured_rotor=replace(told.measured_rotor, **change))


def test_no_other_speed_is_told():
    told = measured("turbomolecular-pump", 900.0, 2)
    with pytest.raises(InvalidInput, match="at which it was measured; measure there"):
        assemble(told, replace(told.operation.nominal, speed=100.0))
    with pytest.raises(InvalidInput, match="needs the rotor at every speed, but the rotor is as"):
        amb.lateral(told)


def test_a_verdict_says_at_which_speed_it_holds():
    told = measured("flywheel", 900.0, 2)
    found = amb.verify(told, amb.design(told, "pid"), tolerances=False)
    assert found.rotor == "the rotor is as measured at 8,594.37 rpm and holds there alone"
