"""The figure of the residual system holds what was measured and what was identified, in um/A."""

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.frequency import frequency_response
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification import youla
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop
from ambrose.machine.description import Tolerance
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction, perturbed
from ambrose.record.record import Record
from ambrose.report.figures.bode import residual_figure

PATH = "bearing.A.negative_stiffness.zeta"


def test_identified_curve_lies_in_the_measured_band():
    machine = load_machine("seal-rig")
    plant = free_mode_reduction(assemble(machine), 1)
    controller, dt = pid_synthesis(plant).controller, 1e-4
    moved = perturbed(plant, {PATH: -1.0}, [Tolerance(PATH, relative=0.3)])
    loop = closed_loop(moved, c2d(controller, dt, "tustin", delay=dt))
    y, u, e, d = ([f"{kind}_{axis}" for axis in plant.axes] for kind in "yued")
    rng = np.random.default_rng(0)
    waves, noise = (
        0.3 * np.sign(rng.standard_normal((4, 8000))),
        1e-7 * rng.standard_normal((4, 8000)),
    )
    values = simulate(select(loop, [*e, *d], [*y, *u]), np.vstack([waves, noise]))
    record = Record(
        "seal-rig",
        1 / dt,
        (*y, *u, *e),
        ("m",) * 4 + ("A",) * 8,
        np.vstack([values, waves]),
        plant.point,
    )
    result = youla.identify(machine, record, controller, [PATH])
    figure = residual_figure(result)
    band, measured, model = figure.data[:3]
    f = np.asarray(model.x, float)
    expected = 1e6 * np.abs(frequency_response(result.residual, 2 * np.pi * f).values[:, 0, 0])
    np.testing.assert_allclose(model.y, expected, rtol=1e-3)
    k = len(f)
    strong = expected > 0.3 * expected.max()
    inside = (np.asarray(model.y) <= np.asarray(band.y)[:k]) & (
        np.asarray(model.y) >= np.asarray(band.y)[k:][::-1]
    )
    assert strong.sum() > 5 and inside[strong].mean() > 0.8
    assert np.asarray(measured.y)[strong] == pytest.approx(expected[strong], rel=0.35)
    assert [trace.showlegend for trace in figure.data[3:]] == [False] * 9
    assert figure.layout.yaxis.title.text == "|S| [µm/A]"
