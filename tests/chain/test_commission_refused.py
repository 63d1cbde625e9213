"""Commissioning designs nothing for values that are not the best ones."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose import load_machine
from ambrose.chain.commissioning import identified
from ambrose.core.checks import NumericalFailure
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.output_error import closed_loop
from ambrose.law.loop import closed_loop as loop_of, match_controller
from ambrose.law.pid import pid_controller
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record

DT = 1e-4


def test_a_fit_that_does_not_converge_ends_the_commissioning(tmp_path, monkeypatch):
    machine = load_machine("seal-rig")
    machine = replace(machine, shaft=tuple(replace(part, elements=1) for part in machine.shaft))
    bearings = tuple(
        replace(b, negative_stiffness=tuple(1.1 * k for k in b.negative_stiffness))
        for b in machine.bearings
    )
    plant = free_mode_reduction(assemble(replace(machine, bearings=bearings)), 1)
    controller = pid_controller(machine.controller, machine)
    loop = loop_of(plant, c2d(match_controller(controller, plant), DT, "tustin", delay=DT))
    e = np.stack([0.1 * waveforms.prbs(9, 10, 6000, shift=127 * i) for i in range(4)])
    names = [[f"{kind}_{axis}" for axis in plant.axes] for kind in "yue"]
    values = np.vstack([simulate(select(loop, names[2], names[0] + names[1]), e), e])
    record = Record(
        machine.name,
        1 / DT,
        (*names[0], *names[1], *names[2]),
        ("m",) * 4 + ("A",) * 8,
        values,
        plant.point,
    )

    fit = closed_loop.fit

    def lame(experiment, start=None):
        return fit(
            replace(experiment, options=replace(experiment.options, max_iterations=1)), start
        )

    monkeypatch.setattr(closed_loop, "fit", lame)
    with pytest.raises(
        NumericalFailure, match=r"NOT CONVERGED.*no controller is designed for them"
    ):
        identified(machine, record, controller, tmp_path, lambda stage: None)
    assert "NOT converged" in (tmp_path / "identified.html").read_text()  # to see why
