"""The page of static loads: values, curvature and levels, from a record of known magnets."""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.identification.findings import Code
from ambrose.identification.pipeline import Provenance, identify
from ambrose.identification.validation.plausibility import compare
from ambrose.record.record import Record
from ambrose.report.identification import line_figure, static_page, static_table
from ambrose.report.page import render

RIG = load_machine("seal-rig")
BARE = replace(
    RIG,
    couplings=(),
    seals=tuple(replace(s, K=0.0, k=0.0, C=0.0, c=0.0) for s in RIG.seals),
    tolerances=(),
)
K_I = np.array([150.0, 140.0, 160.0, 165.0])
AXES = RIG.axes
RATE = 500.0
HOLD = 400


def held(curve=0.0, seed=0, sides=(1, -1)):
    """Loads of 50 to 200 N on the actuators' own axes; the position is held, so that the current
    alone answers: f = k_i (i - curve i^3).
    """
    rng, parts = np.random.default_rng(seed), []
    for axis in range(4):
        for side in sides:
            for size in (0.0, 50.0, 100.0, 150.0, 200.0):
                force = np.zeros(4)
                force[axis] = side * size
                wanted = -force / K_I
                current = wanted.copy()
                for _ in range(60):
                    current = wanted + curve * current**3
                rows = np.vstack(
                    [
                        np.zeros((4, HOLD)),
                        np.tile(current[:, None], HOLD),
                        np.tile(force[:, None], HOLD),
                    ]
                )
                rows[4:8] += 1e-4 * rng.standard_normal((4, HOLD))
                parts.append(rows)
    names = tuple(f"{kind}_{axis}" for kind in "yif" for axis in AXES)
    return Record(
        "seal-rig",
        RATE,
        names,
        ("m",) * 4 + ("A",) * 4 + ("N",) * 4,
        np.hstack(parts),
        RIG.operation.points[1],
    )


@pytest.fixture(scope="module")
def straight():
    return identify(BARE, [held()], method="static", provenance=Provenance(("loads.h5",)))


@pytest.fixture(scope="module")
def bent():
    return identify(
        BARE, [held(0.05)], method="static", provenance=Provenance(("loads.h5",), "", "2026-11-21")
    )


def test_values_stand_beside_the_machines(straight):
    result = straight.result
    np.testing.assert_allclose(result.values, K_I, rtol=1e-3)
    own = np.concatenate([item.force_per_current for item in BARE.bearings])
    np.testing.assert_array_equal(straight.result.start, own)
    rows = static_table(straight).cells
    assert rows[0][1].text.startswith(f"{own[0]:.4g}") and rows[0][6].text == "straight"
    assert float(rows[0][3].text.split()[0]) == pytest.approx(
        100 * (result.values[0] / own[0] - 1), abs=0.01
    )
    report = static_page(straight, compared=compare(result, BARE))
    assert report.result.passed and all(verdict.passed for verdict in report.verdicts)
    assert [table.title for table in report.sections[0].tables] == [
        "Force per current",
        "Beside the other file",
    ]
    levels = report.sections[-1].tables[0]
    assert len(levels.cells) == len(result.levels.loads)
    page = render(report)
    assert "loads.h5" in page and "Force beyond the straight line" in page


def test_curved_iron_is_doubted_and_drawn(bent):
    result = bent.result
    assert not bent.passed and any(finding.code == Code.CURVED for finding in bent.findings)
    report = static_page(bent)
    assert report.sections[0].title == "What makes this doubtful" and not report.result.passed
    assert report.verdicts[0].passed is False
    part = static_table(bent).cells[0][6].text
    assert float(part.replace("−", "-").split()[0]) == pytest.approx(
        100 * (result.values[0] / result.at_rest[0] - 1), abs=0.05
    )
    points = [trace for trace in line_figure(result).data if trace.mode == "markers"]
    assert len(points) == 4
    x, y = np.array(points[0].x), np.array(points[0].y)
    at = np.argsort(x)
    assert abs(y.mean()) < 1e-9 and abs(y[at[0]] - y[at[-1]]) > 1.0  # N at both ends, of 200


def test_repeats_widen_what_their_scatter_asks_for(straight):
    louder = replace(
        held(seed=1),
        values=held(seed=1).values * np.r_[np.ones(4), np.full(4, 0.98), np.ones(4)][:, None],
    )
    both = identify(BARE, [held(), louder], method="static", repeats=True)
    assert both.repeats.count == 2
    assert (both.result.standard_deviations > 3 * straight.result.standard_deviations).all()
    assert "Repeats" in render(static_page(both))
    data = both.to_dict()
    assert (
        data["repeats"]["count"] == 2 and data["method"] == "static" and data["good"] is both.passed
    )
    with pytest.raises(InvalidInput, match="at least 2 for repeats"):
        identify(BARE, [held()], method="static", repeats=True)


def test_where_the_values_are_from(bent):
    origin, comment = bent.origin, bent.comment
    assert origin == "4 values of K_i identified 2026-11-21 by static loads from loads.h5"
    assert all(row.startswith("#") for row in comment.strip().splitlines())
    assert "Warning: force over current of A_zeta is curved" in comment and "at rest" in comment
