"""What goes wrong between a machine and a record, by what is computed from records with the
controller's file: every mistake is refused or a finding, and a good record has none.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.scheduled.seal_watch import monitor
from ambrose.annexes.site.acceptance import accept
from ambrose.annexes.site.balancing import balance
from ambrose.core.checks import InvalidInput
from ambrose.core.sampling import delayed
from ambrose.identification.data_quality.controller import fit_excitation
from ambrose.identification.data_quality.diagnosis import screened
from ambrose.identification.output_error.problem import deployed_controller
from ambrose.identification.parameters import plant_at
from ambrose.rig.scenario import Prbs, Scenario, Unbalance
from coarse import coarse

SPEED, NOISE = 2 * np.pi * 50, 1e-8


@cache
def machine():
    found = coarse("seal-rig")
    runs = replace(found.controller, sample_time=1e-4)
    return replace(found, controller=runs, tolerances=())


@cache
def law():
    return amb.design(machine(), "pid")


def scaled(factor):
    K = law().controller
    return replace(law(), controller=replace(K, C=factor * K.C, D=factor * K.D))


@cache
def recorded(excited, controller=1.0):
    """Two seconds of the linear loop, excited at rest or turning with unbalance; a recorder's noise
    in y that the controller has not seen.
    """
    axes = machine().axes
    point = replace(machine().operation.design, label="", speed=0.0 if excited else SPEED)
    driven = tuple(
        Prbs(f"e_{axis}", 0.1, 2e-4, order=15, seed=i) for i, axis in enumerate(axes) if excited
    )
    heavy = () if excited else (Unbalance(machine().bearings[0].name, 1e-4),)
    scenario = Scenario(
        "s", 3.0, sequences=driven, unbalances=heavy, speed=point.speed, sample_time=1e-4
    )
    found = amb.simulate(machine(), scaled(controller), scenario, linear=True, point=point).record
    names = [name for name in found.signals if name[:2] in ("y_", "u_", "e_")[: 2 + excited]]
    found = found.select(names)
    shown = np.array([name[:2] == "y_" for name in names])[:, None]
    noise = NOISE * np.random.default_rng(0).standard_normal(found.values.shape)
    return replace(found, values=found.values + shown * noise)


def changed(record, kind, change):
    """The record with the rows (a, k) of a kind of signals changed."""
    values = record.values.copy()
    rows = [i for i, name in enumerate(record.signals) if name[:2] == f"{kind}_"]
    values[rows] = change(values[rows])
    return replace(record, values=values)


def late(rows):
    return np.roll(rows, 1, axis=1)


def clipped(rows):
    level = 0.6 * np.abs(rows).max(axis=1, keepdims=True)
    return np.clip(rows, -level, level)


MISTAKES = {
    "e times 1.5": lambda r: changed(r, "e", lambda e: 1.5 * e),
    "e a sample late": lambda r: changed(r, "e", late),
    "y clipped": lambda r: changed(r, "y", clipped),
    "u a sample late": lambda r: changed(r, "u", late),
    "y swapped": lambda r: changed(r, "y", lambda y: y[[1, 0, 2, 3]]),
    "y times 1.3": lambda r: changed(r, "y", lambda y: 1.3 * y),
    "another controller": lambda r: recorded("e_A_zeta" in r.signals, 1.15),
}


def said_by_accept(record):
    checks = accept(machine(), law(), record).points[0].checks.checks
    return [c.name for c in checks if c.name.startswith("record.") and not c.passed]


def said_by_monitor(record):
    found = monitor(machine(), law(), record).findings
    of_the_seal = ("nothing can be said", "the pressure given", "seal.", "at ")
    return [text for text in found if not text.startswith(of_the_seal)]


def said_by_balance(record):
    result = balance(
        machine(), [record], {machine().bearings[0].name: 0.05}, controller=law(), settle=1.0
    )
    found = [note for note in result.notes if note.startswith("finding: ")]
    assert not (found and result.passed)
    return found


def said_by_identify(record):
    """What identify begins with, after which it refuses or goes on with the findings."""
    return [str(item.code) for item in screened(machine(), [record], law())]


COMMANDS = {
    "accept": said_by_accept,
    "monitor": said_by_monitor,
    "balance": said_by_balance,
    "identify": said_by_identify,
}


def good(command):
    return recorded(command != "balance")


@pytest.mark.parametrize("command", COMMANDS)
def test_a_good_record_has_no_finding(command):
    assert COMMANDS[command](good(command)) == []


@pytest.mark.parametrize("mistake", MISTAKES)
@pytest.mark.parametrize("command", COMMANDS)
def test_no_mistake_is_silent(command, mistake):
    if command == "balance" and mistake.startswith("e "):
        pytest.skip("nothing excites a rotor that is balanced")
    try:
        said = COMMANDS[command](MISTAKES[mistake](good(command)))
    except InvalidInput as error:
        said = [str(error)]
    assert said
    if mistake.startswith("e "):
        assert any("excitation" in item for item in said)


@pytest.mark.parametrize("factor", [1.03, 1.5])
def test_the_excitation_s_scale_is_measured(factor):
    """To the percent, beside magnets that are 10 % off the machine file's."""
    bearings = tuple(
        replace(b, force_per_current=tuple(1.1 * k for k in b.force_per_current))
        for b in machine().bearings
    )
    wrong, record = replace(machine(), bearings=bearings), recorded(True)
    plant = plant_at(wrong, record.point, {}, 3)
    runs = delayed(deployed_controller(plant, law(), record.dt, 0), 1)
    fit = fit_excitation(plant, runs, [changed(record, "e", lambda e: factor * e)])
    np.testing.assert_allclose(1 / (1 + fit.delta), factor, rtol=0.02)
    assert (np.abs(1 + fit.delta - 1 / factor) < 1.5 * fit.delta_half).all()
