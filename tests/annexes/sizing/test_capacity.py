"""Loads of the machine file as a verdict of a size."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.sizing import least as guarantee
from ambrose.annexes.sizing.least import CAPACITY, Size, attempt, resized
from ambrose.judge.result import Certificate, Status, Synthesis
from ambrose.judge.unbalance import capacity_margin
from ambrose.law.pid import first_settings, pid_controller
from ambrose.model.effects.stations import Load
from ambrose.synthesis.fixed_order import tuning
from ambrose.synthesis.methods import Tuned, with_capacity
from coarse import coarse


def loaded(machine, force):
    load = Load("knock", 0.5 * machine.length, "surge", force, frequency=2 * math.pi * 20)
    own = [part for part in machine.effects if not isinstance(part, Load)]
    return replace(machine, effects=(*own, load))


def test_the_margin_goes_with_the_force_and_with_the_bias():
    machine = amb.load_machine("turboexpander")
    rest = replace(machine.operation.nominal, speed=0.0, label="rest")
    assert capacity_margin(machine, amb.design(machine, "pid", rate=None), None)[0] > 1
    machine = replace(
        machine,
        effects=tuple(part for part in machine.effects if not isinstance(part, Load)),
        tolerances=(),
        operation=replace(machine.operation, points=(rest,), design_point=None, ranges=()),
    )
    controller = amb.design(machine, "pid", rate=None).controller
    one, words = capacity_margin(loaded(machine, 100.0), controller, None)
    two, _ = capacity_margin(loaded(machine, 200.0), controller, None)
    assert two == pytest.approx(one / 2)
    assert words.startswith("knock, axis")
    assert capacity_margin(machine, controller, None) == (math.inf, "")


def test_a_size_that_cannot_carry_its_loads_fails_for_them(monkeypatch):
    rig = coarse("seal-rig-k-only")
    point = rig.operation.nominal
    rig = replace(rig, operation=replace(rig.operation, points=(point,), ranges=()))
    rig = replace(rig, operation=replace(rig.operation, design_point=None))
    method = Tuned(rate=10_000, order=8)
    heavy = loaded(rig, 1e5)
    # no controller has force that the magnets lack: few steps of the search show it
    monkeypatch.setattr(tuning, "_ITERATIONS", 3)
    found = attempt(heavy, Size(), method.on(heavy))
    # without the load it meets all: test_size.py
    assert not found.met and found.binding == CAPACITY
    assert found.capacity == pytest.approx(1 / found.ratios[CAPACITY])
    assert resized(heavy, Size()).bearings == resized(rig, Size()).bearings


@pytest.mark.parametrize(("guards", "met"), [({}, False), ({"guard_gain": 1.4}, True)])
def test_a_guard_of_the_search_is_no_requirement_of_a_size(monkeypatch, guards, met):
    """A size was "not enough", for 1.35 of a gain that its file does not limit."""
    rig = coarse("seal-rig-k-only")
    point = rig.operation.nominal
    operation = replace(rig.operation, points=(point,), ranges=(), design_point=None)
    rig = replace(rig, operation=operation)
    margins = {"ratio_sensitivity": 0.9, "ratio_gain": 1.4, **guards}
    shown = Certificate(True, -1.0, margins=margins)

    def searched(job, law, structure, **more):
        controller = pid_controller(first_settings(rig), rig)
        return Synthesis(controller, "tuned", 1.4, Status.VERIFIED, shown)

    monkeypatch.setattr(guarantee, "tuned", searched)
    found = attempt(rig, Size(), Tuned(rate=10_000, order=8).on(rig))
    assert found.met is met
    assert (found.binding == "gain") is not met
    assert ("gain" in found.ratios) is not met
    assert np.isfinite(found.gain)


@pytest.mark.parametrize("force", [100.0, 1e6])
def test_a_design_counts_the_load_capacity_as_a_size_does(force):
    """synthesize held a machine at 0.943 that size marked as failed, 1.016 of its load capacity."""
    machine = amb.load_machine("turboexpander")
    rest = replace(machine.operation.nominal, speed=0.0, label="rest")
    operation = replace(machine.operation, points=(rest,), design_point=None, ranges=())
    machine = loaded(replace(machine, tolerances=(), operation=operation), force)
    controller = amb.design(machine, "pid", rate=None).controller
    shown = Certificate(True, -1.0, 1.0, 1.0, {"ratio_orbit": 0.943})
    made = Synthesis(controller, "tuned", 0.943, Status.VERIFIED, shown)
    found = with_capacity(made, machine, None)
    ratio = 1 / capacity_margin(machine, controller, None)[0]
    assert found.certificate.margins["ratio_load_capacity"] == pytest.approx(ratio)
    assert found.gamma == pytest.approx(max(0.943, ratio))
    assert found.missed == (ratio > 1) == any("load capacity" in note for note in found.notes)
    assert (force > 1e3) == found.missed
