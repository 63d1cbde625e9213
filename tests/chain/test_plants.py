"""Which plant designs are made for, and which a schedule covers."""

from dataclasses import replace

import numpy as np

from ambrose import load_machine
from ambrose.chain.study import study_methods
from ambrose.core.scheduled import ScheduledSystem
from ambrose.core.statespace import static_gain
from ambrose.judge.plants import full_plants, plant_at
from ambrose.law.law import law_of

MACHINE = load_machine("turboexpander")


def test_the_design_point_comes_first_and_every_point_once():
    plants = full_plants(MACHINE)
    assert plants[0].point == MACHINE.operation.design != MACHINE.operation.nominal
    assert sorted(p.point.label for p in plants) == sorted(
        p.label for p in MACHINE.operation.points
    )
    assert plant_at(MACHINE, None).point == MACHINE.operation.design
    plain = replace(MACHINE, operation=replace(MACHINE.operation, design_point=""))
    assert plain.operation.design == plain.operation.nominal


def test_a_schedule_covers_its_speeds_at_its_pressure_only():
    law = ScheduledSystem(2 * np.pi * np.array([20.0, 300.0]), [static_gain(np.eye(4))] * 2)
    covered = {plant.point.label for plant in full_plants(MACHINE) if law_of(law).covers(plant)}
    assert covered == {"20 Hz (P3)", "140 Hz (P3)", "300 Hz (P3)"}
    assert all(law_of(law.at(900.0)).covers(plant) for plant in full_plants(MACHINE))


def test_a_schedule_over_pressure_covers_its_pressures_at_every_speed():
    law = ScheduledSystem([0.0, 1e6], [static_gain(np.eye(4))] * 2, "pressure", "Pa")
    covered = {plant.point.label for plant in full_plants(MACHINE) if law_of(law).covers(plant)}
    assert (
        covered == {p.label for p in MACHINE.operation.points if p.seal_pressure <= 1e6}
        and len(covered) == 2
    )


def test_only_a_machine_with_several_speeds_is_scheduled():
    assert "lpv" in study_methods(plant_at(MACHINE, "140 Hz"))
    assert "lpv" not in study_methods(plant_at(load_machine("seal-rig"), None))
