"""Records of the linear loop at several pressures: bearings from those without, the seal at each,
the machine that results.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks import waveforms

from ambrose import load_machine
from ambrose.core.checks import InvalidInput, NumericalFailure
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.identification.findings import Code
from ambrose.identification.output_error import closed_loop as whole_loop
from ambrose.identification.parameters import update_machine
from ambrose.identification.result import Provenance
from ambrose.identification.seal import pipeline as seal_records
from ambrose.identification.seal.pipeline import identify_seal
from ambrose.law.loop import closed_loop, match_controller
from ambrose.law.pid import pid_controller
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.toml import dumps_machine, loads_machine
from ambrose.model.assemble import assemble
from ambrose.model.effects import seal
from ambrose.model.uncertainty import free_mode_reduction
from ambrose.record.record import Record

DT, K = 1e-4, 8000
AXES = ("A_zeta", "A_eta", "B_zeta", "B_eta")
Y, U, E = ([f"{kind}_{axis}" for axis in AXES] for kind in "yue")
PRESSURES = (0.0, 0.6e5, 1.2e5, 1.7e5)


@cache
def machine():
    """The seal test rig with coarse shaft sections; operating points within the pressures measured,
    and without.
    """
    given = load_machine("seal-rig")
    points = tuple(OperatingPoint(seal_pressure=p, label=f"{p:g} Pa") for p in (1.2e5, 0.0))
    return replace(
        given,
        shaft=tuple(replace(part, elements=1) for part in given.shaft),
        operation=replace(given.operation, points=points),
        tolerances=tuple(replace(item, around=()) for item in given.tolerances),
    )


@cache
def controller():
    return pid_controller(machine().controller, machine())


@cache
def true():
    """The machine that was recorded: bearings a few percent off the file's, k less, and growing
    with the square root.
    """
    bearings = []
    for item in machine().bearings:
        k_s, k_i = (
            (1.05 * np.array(item.negative_stiffness)).tolist(),
            (0.97 * np.array(item.force_per_current)).tolist(),
        )
        bearings.append(replace(item, negative_stiffness=tuple(k_s), force_per_current=tuple(k_i)))
    return replace(machine(), bearings=tuple(bearings))


def stiffness(pressure):
    return 0.8 * 3.203e6 * np.sqrt(pressure / 2.04e5) * (pressure > 0)


@cache
def record(pressure, noise=5e-9):
    own = seal.coefficients(true().seals[0], pressure)
    item = replace(
        true().seals[0],
        K=own.K,
        k=float(stiffness(pressure)),
        C=own.C,
        c=own.c,
        scales_with_pressure=(),
    )
    point = OperatingPoint(seal_pressure=pressure)
    plant = free_mode_reduction(assemble(replace(true(), seals=(item,), tolerances=()), point), 1)
    loop = closed_loop(plant, c2d(match_controller(controller(), plant), DT, "tustin", delay=DT))
    e = np.stack([0.1 * waveforms.prbs(9, 10, K, shift=127 * i) for i in range(4)])
    values = simulate(select(loop, E, Y + U), e)
    values[:4] += noise * np.random.default_rng(int(pressure)).standard_normal((4, K))
    return Record(
        "seal-rig", 1 / DT, (*Y, *U, *E), ("m",) * 4 + ("A",) * 8, np.vstack([values, e]), point
    )


@cache
def records(pressures=PRESSURES):
    return tuple(record(p) for p in pressures)


@cache
def found(form="table"):
    return identify_seal(machine(), records(), controller(), form)


@pytest.mark.usefixtures("values_alone")
def test_bearings_come_from_the_records_without_pressure_and_the_seal_from_each():
    result = found().result
    assert result.point.seal_pressure == 0 and not any(
        path.startswith("seal") for path in result.paths
    )
    ratio = result.values / result.start
    np.testing.assert_allclose(ratio[:4], 0.97, rtol=2e-3)
    np.testing.assert_allclose(ratio[4:8], 1.05, rtol=5e-3)
    fit = found().seal.fit
    np.testing.assert_array_equal(fit.pressure, PRESSURES)
    error = np.abs(fit.values[:, 1] - [stiffness(p) for p in PRESSURES])
    # the file's law, proportional to pressure, is 20 to 50 % off
    assert error.max() < 0.005 * stiffness(PRESSURES[-1])
    assert not any(
        item.code == Code.HARDLY_VISIBLE for item in fit.warnings if item.what.startswith("at 0 Pa")
    )


@pytest.mark.usefixtures("values_alone")
def test_a_table_follows_the_curve_and_survives_its_file():
    done = replace(found(), provenance=Provenance(("here",))).updated()
    made = loads_machine(dumps_machine(done.machine))
    for pressure in PRESSURES:
        k = seal.coefficients(made.seals[0], pressure).k
        assert k == pytest.approx(found().seal.fit.at(pressure).values[0, 1], rel=1e-6)
    assert made.bearings[0].force_per_current[0] == pytest.approx(found().result.values[0])
    assert "from here; seal center as a table over 4 pressures" in made.source
    widths = {item.parameter: item for item in made.tolerances}
    # the range of pressures is now each coefficient's change over it
    assert widths["seal.center.K"].absolute > 0
    assert "seal.center.pressure" not in widths and widths[
        "seal.center.k"
    ].absolute > 0.99 * stiffness(1.2e5)
    data = found().to_dict()["seal"]
    assert data["lines"] is None and np.shape(data["values"]) == (4, 4) and data["form"] == "table"
    assert "Seal center, pressure by pressure" in done.comment


@pytest.mark.usefixtures("values_alone")
def test_a_line_says_that_the_points_are_none():
    lined = found("line")
    k = lined.to_dict()["seal"]["lines"]["k"]
    assert k["scatter"] > 10  # a square root is no line, and the band is as wide as that
    made = lined.updated().machine
    assert made.seals[0].table.axes[0][1] == (0.0, PRESSURES[-1])
    assert "extrapolated" not in lined.seal.note
    assert any(
        one.code == Code.SEAL_SCATTER and "k at" in one.what and "form table" in one.remedy
        for one in lined.findings
    )
    higher = replace(lined, seal=replace(lined.seal, highest=3e5))
    assert "extrapolated to 300000 Pa; the highest measured pressure is 170000 Pa" in higher.comment


@pytest.mark.usefixtures("values_alone")
def test_without_a_calm_record_all_are_fitted_together():
    law = replace(machine(), seals=(replace(machine().seals[0], k=0.7 * 3.203e6),))
    inside = replace(
        law, operation=replace(law.operation, points=(OperatingPoint(seal_pressure=1e5),))
    )
    given = [replace(record(p), values=_proportional(p)) for p in (0.6e5, 1.2e5)]
    result = identify_seal(inside, given, controller(), "table")
    paths = result.result.paths
    assert [path for path in paths if path.startswith("seal")] == [
        f"seal.center.{letter}" for letter in "KkCc"
    ]
    k = result.seal.fit.values[:, 1]
    np.testing.assert_allclose(k, [3.203e6 * p / 2.04e5 for p in (0.6e5, 1.2e5)], rtol=0.01)


@cache
def _proportional(pressure):
    plant = free_mode_reduction(assemble(true(), OperatingPoint(seal_pressure=pressure)), 1)
    loop = closed_loop(plant, c2d(match_controller(controller(), plant), DT, "tustin", delay=DT))
    e = np.stack([0.1 * waveforms.prbs(9, 10, K, shift=127 * i) for i in range(4)])
    return np.vstack([simulate(select(loop, E, Y + U), e), e])


@pytest.mark.parametrize(
    ("pressures", "form", "options", "words"),
    [
        (
            (0.0, 0.6e5),
            "line",
            {},
            "number of seal pressures for a line is 2, but must be at least 3",
        ),
        ((0.6e5,), "table", {}, "at least 2"),
        (
            (0.0, 0.6e5),
            "table",
            {},
            "operating point '120000 Pa' is 120000 Pa, but must be within 0 to 60000 Pa",
        ),
        (PRESSURES, "curve", {}, "the form of the seal"),
        (PRESSURES, "line", {"seal": "left"}, "one of the machine's seals: center"),
        (PRESSURES, "line", {"start": {"seal.center.q": 1.0}}, "seal.center.q"),
    ],
)
def test_what_is_refused_before_anything_is_fitted(pressures, form, options, words):
    with pytest.raises(InvalidInput, match=words):
        identify_seal(machine(), records(pressures), controller(), form, **options)


def test_a_knock_under_pressure_is_found_in_its_record():
    values = record(1.2e5).values.copy()
    values[0, 5000:5004] += 3e-6
    # without u nothing shows it before the fit
    seen = [name for name in record(1.2e5).signals if name[0] != "u"]
    given = [record(0.0).select(seen), replace(record(1.2e5), values=values).select(seen)]
    result = identify_seal(machine(), given, controller(), "table")
    texts = [str(item) for item in result.findings]
    assert any(
        "record 2: y_A_zeta leaves the model for a short time" in text and "0.5" in text
        for text in texts
    ), texts
    assert not result.passed


def test_an_unstable_start_gives_way_to_the_next_and_no_convergence_is_an_error():
    known = update_machine(machine(), found().result)
    far = {"seal.center.k": 9e6}
    fit = seal_records.identify(known, [record(0.6e5)], controller(), start=far)
    assert fit.values[0, 1] == pytest.approx(stiffness(0.6e5), rel=0.01)
    with pytest.raises(InvalidInput, match="the loop at the start values is unstable"):
        whole_loop.identify(known, record(0.6e5), controller(), ["seal.center.k"], start=far)
    with pytest.raises(NumericalFailure, match="did not converge from 1 starts"):
        seal_records.identify(known, [record(1.7e5)], controller(), max_iterations=1)
