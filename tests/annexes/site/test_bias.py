"""`ambrose bias` on the nonlinear rig: rows that the machine file lacks, found again; both methods;
page and refusals.
"""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.annexes.site.bias import identify_over_bias, with_bias
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.judge.controller_file import write_controller
from ambrose.machine.description import BiasPoint, OperatingPoint
from ambrose.model.static_load import magnet_coefficients
from ambrose.record.files import write_record
from ambrose.rig.scenario import Prbs, Scenario
from coarse import coarse

TRAIN, RIG = "three-bearing-train", "seal-rig"


@cache
def truth():
    """The train with rows at 4 A that its file lacks, off the square law by 2 and 3 %."""
    machine = coarse(TRAIN)
    rows = [
        BiasPoint(
            4.0,
            tuple(0.8 * 1.02 * k for k in b.force_per_current),
            tuple(0.64 * 0.97 * k for k in b.negative_stiffness),
        )
        for b in machine.bearings
    ]
    return replace(
        machine,
        bearings=tuple(
            replace(b, measured=(r,)) for b, r in zip(machine.bearings, rows, strict=True)
        ),
    )


@cache
def law(name):
    return amb.design(coarse(name), "pid")


@cache
def record(bias):
    machine = truth()
    items = tuple(Prbs(f"e_{a}", 0.2, 1e-3, order=10, seed=i) for i, a in enumerate(machine.axes))
    return amb.simulate(
        machine,
        law(TRAIN),
        Scenario("prbs", 2.5, sequences=items),
        point=OperatingPoint(bias_current=bias),
    ).record


def call(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.mark.study
def test_rows_that_the_file_lacks_are_found(tmp_path):
    for bias in (4.0, 5.0):
        write_record(record(bias), tmp_path / f"{bias:g}.h5")
    write_controller(tmp_path / "pid.json", law(TRAIN))
    done = call(
        "bias",
        TRAIN,
        tmp_path / "4.h5",
        tmp_path / "5.h5",
        "--controller",
        tmp_path / "pid.json",
        "-o",
        tmp_path / "found.toml",
        "--report",
        tmp_path / "bias.html",
        "--json",
    )
    assert done.exit_code == 0, done.stdout + done.stderr
    told = json.loads(done.stdout)
    assert [row["bias"] for row in told["rows"]] == [4.0, 5.0]
    again = amb.load_machine(str(tmp_path / "found.toml"))
    for bias, row in zip((4.0, 5.0), told["rows"], strict=True):
        k_i, k_s = magnet_coefficients(truth(), OperatingPoint(bias_current=bias))
        kept = magnet_coefficients(again, OperatingPoint(bias_current=bias))
        values = np.array([entry["value"] for entry in row["small_motion"].values()]).reshape(2, -1)
        assert values == pytest.approx(np.array([k_i, k_s]), rel=5e-3)
        assert np.array(kept) == pytest.approx(values, rel=1e-9)
    assert "Magnets over bias current" in (tmp_path / "bias.html").read_text()


def test_static_loads_alone_and_beside():
    """K_i of the seal rig at its own bias by loads: written where nothing else tells it; currents
    read 30 % low are named.
    """
    machine = coarse(RIG)
    loads = amb.simulate(machine, law(RIG), "static-loads-both", rate=1e4).record
    done = identify_over_bias(machine, loads=[loads])
    assert done.rows[0].dynamic is None and not done.findings
    k_i, _ = magnet_coefficients(machine, OperatingPoint())
    found = [value for value, _ in done.rows[0].values(static=True).values()]
    assert found == pytest.approx(k_i, rel=0.02)
    assert magnet_coefficients(done.machine, OperatingPoint())[0] == pytest.approx(found, rel=1e-6)
    items = tuple(Prbs(f"e_{a}", 0.1, 1e-3, order=10, seed=i) for i, a in enumerate(machine.axes))
    moving = amb.simulate(
        machine, law(RIG), Scenario("prbs", 1.3, sequences=items), rate=1e4
    ).record
    assert not identify_over_bias(machine, [moving], {None: law(RIG)}, loads=[loads]).findings
    low = np.array([0.7 if name[:2] in {"u_", "i_"} else 1.0 for name in loads.signals])[:, None]
    both = identify_over_bias(
        machine, [moving], {None: law(RIG)}, loads=[replace(loads, values=low * loads.values)]
    )
    assert "1.4" in str(both.findings[-1]) and "static loads" in str(both.findings[-1])
    kept = [value for value, _ in both.rows[0].values().values()][:4]
    assert magnet_coefficients(both.machine, OperatingPoint())[0] == pytest.approx(kept, rel=1e-6)


def test_a_bias_without_coefficients_begins_at_the_square_law():
    machine = coarse(TRAIN)
    begun = with_bias(machine, 4.0).bearings[0]
    assert begun.measured[0].force_per_current == pytest.approx(
        [0.8 * k for k in machine.bearings[0].force_per_current]
    )
    assert begun.measured[0].negative_stiffness == pytest.approx(
        [0.64 * k for k in machine.bearings[0].negative_stiffness]
    )
    assert with_bias(machine, 5.0) == machine


def test_refusals(tmp_path):
    machine = coarse(TRAIN)
    with pytest.raises(InvalidInput, match="no record was given"):
        identify_over_bias(machine)
    with pytest.raises(InvalidInput, match="none for 4 A"):
        identify_over_bias(machine, [record(4.0)], {5.0: law(TRAIN)})
    quiet = record(4.0).select([name for name in record(4.0).signals if name[:2] != "e_"])
    with pytest.raises(InvalidInput, match="at 4 A: record 1 holds no excitation"):
        identify_over_bias(machine, [quiet], {None: law(TRAIN)})
