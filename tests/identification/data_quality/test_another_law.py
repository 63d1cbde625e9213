"""The recorded u is the controller's, or it is another controller's: told from the noise of recorders
and the steps of converters, on a rig that shares nothing with the package.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import ambrose as amb
import independent_rig as own
from ambrose.identification.data_quality.controller import controller_match, of_another_law
from ambrose.identification.data_quality.diagnosis import diagnose_records
from ambrose.identification.findings import Code
from ambrose.identification.output_error.problem import deployed_controller
from ambrose.model.assemble import assemble
from ambrose.record.record import Record

MACHINES = Path(amb.__file__).parent / "machines"


@cache
def machine():
    found = replace(amb.load_machine("seal-rig"), tolerances=())
    return replace(found, controller=replace(found.controller, sample_time=1e-4))


@cache
def law(**changes):
    settings = replace(machine().controller, **changes)
    made = amb.design(replace(machine(), controller=settings), "pid")
    K = deployed_controller(assemble(machine()), made, 1e-4, 0)
    return made, (K.A, K.B, K.C, K.D)


@cache
def signals(**changes):
    """Two seconds with binary sequences of 0.1 A; converters of 10 nm and 0.2 mA."""
    numbers = own.numbers_of(MACHINES / "seal-rig.toml", 2.04e5)
    rig = own.Rig(numbers, noise=3e-8, hum=2e-8, step_y=1e-8, step_u=2e-4)
    e = own.binary(4, 20_000, 0.1, 4, np.random.default_rng(3))
    return rig.axes, rig.run(law(**changes)[1], e, seed=5)


def recorded(noise_y=0.0, noise_u=0.0, step_y=0.0, **changes):
    axes, found = signals(**changes)
    rng = np.random.default_rng(8)
    y = found["y"] + noise_y * rng.standard_normal(found["y"].shape)
    y = np.round(y / step_y) * step_y if step_y else y
    u = found["u"] + noise_u * rng.standard_normal(found["u"].shape)
    names = tuple(f"{kind}_{axis}" for kind in "yue" for axis in axes)
    point = replace(machine().operation.nominal, label="")
    units = ("m",) * 4 + ("A",) * 8
    return Record("seal-rig", 1e4, names, units, np.vstack([y, u, found["e"]]), point)


def by_another_law(record):
    sampled = deployed_controller(assemble(machine()), law()[0], 1e-4, 0)
    return of_another_law(record, controller_match(machine(), record, sampled)).max()


RECORDERS = [
    {},
    {"noise_y": 1e-7},
    {"noise_y": 3e-8, "noise_u": 3e-3},
    {"noise_u": 2e-2},
    {"step_y": 1e-7},
]
OTHERS = [{"derivative_filter": 0.13}, {"derivative_time": 3.4e-3}, {"integral_time": 0.14}]


@pytest.mark.parametrize("recorder", RECORDERS)
def test_noise_and_steps_are_no_other_controller(recorder):
    assert by_another_law(recorded(**recorder)) < 1e-3


@pytest.mark.parametrize("changes", OTHERS)
def test_another_controller_is_told(changes):
    """Also where u differs by a percent, and from what the excitation makes by less."""
    assert by_another_law(recorded(**changes)) > 5e-3


@pytest.mark.parametrize(
    ("recorder", "changes", "told"),
    [({"noise_u": 2e-2}, {}, []), ({}, OTHERS[2], [Code.OTHER_CONTROLLER])],
)
def test_what_is_said(recorder, changes, told):
    """A recorder's noise of 9 % of u is no finding; another integral time is one."""
    found = diagnose_records(machine(), recorded(**recorder, **changes), law()[0])
    assert [item.code for item in found] == told
