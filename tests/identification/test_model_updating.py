"""The machine with what was identified: values, tolerances, single seal entries, origin; its file
loads.
"""

from dataclasses import replace

import numpy as np
import pytest

from ambrose import load_machine
from ambrose.core.checks import InvalidInput
from ambrose.identification.findings import Code, Finding
from ambrose.identification.output_error.closed_loop import ParameterEstimate
from ambrose.identification.output_error.statistics import ResidualTest
from ambrose.identification.parameters import update_machine
from ambrose.identification.result import LoopIdentification, Provenance
from ambrose.identification.validation.repeatability import repeats
from ambrose.machine.description import OperatingPoint
from ambrose.machine.file.toml import dumps_machine, loads_machine, machine_hash
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import channels

NOMINAL = OperatingPoint(seal_pressure=2.04e5, label="nominal pressure")
ENDS = [("A", "zeta"), ("A", "eta"), ("B", "zeta"), ("B", "eta")]
NINE = {f"bearing.{b}.force_per_current.{a}": 150.0 + 10 * i for i, (b, a) in enumerate(ENDS)}
NINE |= {f"bearing.{b}.negative_stiffness.{a}": 1e6 + 1e5 * i for i, (b, a) in enumerate(ENDS)}
NINE["amplifier.natural_frequency"] = 1300.0


def found(values, relative=0.01, point=NOMINAL, machine="seal-rig"):
    paths, numbers = tuple(values), np.array(list(values.values()))
    q = len(paths)
    test = ResidualTest("y_A_zeta", "e_A_zeta", 0.01, 0.05, 3, True)
    return ParameterEstimate(
        machine,
        point,
        paths,
        numbers,
        0.9 * numbers,
        np.diag((relative * numbers) ** 2),
        np.eye(q),
        np.eye(q),
        ((1, "y_A_zeta", 98.5),),
        (test,),
        3.0,
        True,
        4,
        (),
        "the residuals contain no trace of the excitation",
    )


def test_values_tolerances_and_origin_survive_the_file():
    machine = load_machine("seal-rig")
    made = update_machine(machine, found(NINE), origin="9 parameters identified from a.h5")
    again = loads_machine(dumps_machine(made))
    assert again == made and machine_hash(again) != machine_hash(machine)
    assert again.bearings[0].force_per_current == (150.0, 160.0) and again.bearings[
        1
    ].negative_stiffness == (1.2e6, 1.3e6)
    assert again.amplifier.natural_frequency == 1300.0
    tolerances = {item.parameter: item for item in again.tolerances}
    assert tolerances["bearing.A.force_per_current.zeta"].relative == pytest.approx(
        0.0196, rel=1e-9
    )
    assert tolerances["seal.center.pressure"].relative == 1.0  # another parameter's stays
    assert again.source.endswith("; 9 parameters identified from a.h5")
    keys = dict(again.assumed)
    # no assumption any more
    assert "bearing.force_per_current" not in keys and "bearing.negative_stiffness" not in keys
    assert {"bearing.position", "amplifier.damping", "bearing.measured.force_per_current"} <= set(
        keys
    )


def test_an_assumption_stays_as_long_as_one_of_its_values_is_not_identified():
    machine = load_machine("seal-rig")
    some = {
        path: value for path, value in NINE.items() if path != "bearing.B.force_per_current.eta"
    }
    assert "bearing.force_per_current" in dict(update_machine(machine, found(some)).assumed)


def test_another_bias_gets_a_row_of_its_own():
    machine = load_machine("seal-rig")
    made = update_machine(machine, found(NINE, point=replace(NOMINAL, bias_current=6.0)))
    assert made.bearings[0].force_per_current == machine.bearings[0].force_per_current
    assert [row.bias_current for row in made.bearings[0].measured] == [6.0, 8.0, 10.0]
    assert made.bearings[0].measured[0].force_per_current == (150.0, 160.0)


def test_single_seal_entries_are_averaged_and_the_tolerance_covers_both():
    machine = load_machine("seal-rig")
    made = update_machine(machine, found({"seal.center.K_xx": 0.5e6, "seal.center.K_yy": 0.4e6}))
    assert made.seals[0].K == pytest.approx(0.45e6)
    tolerance = next(item for item in made.tolerances if item.parameter == "seal.center.K")
    assert tolerance.relative * 0.45e6 == pytest.approx(0.05e6 + 1.96 * 0.005e6)
    # its fellow stays as it was: 3.203e6 at 2.04 bar
    one = update_machine(machine, found({"seal.center.k_yx": 3.0e6}))
    assert one.seals[0].k == pytest.approx((3.0e6 + 3.203e6) / 2)
    plant = assemble(made, NOMINAL)
    assert channels(plant, "seal.center.K")[0].nominal == pytest.approx(0.45e6)
    assert loads_machine(dumps_machine(made)) == made


def test_a_coefficient_that_scales_with_pressure_is_stored_at_its_reference():
    machine = load_machine("seal-rig")
    made = update_machine(
        machine, found({"seal.center.k": 5e6}, point=replace(NOMINAL, seal_pressure=4.08e5))
    )
    assert made.seals[0].k == pytest.approx(2.5e6)
    with pytest.raises(InvalidInput, match="identify it under pressure"):
        update_machine(
            machine, found({"seal.center.k": 5e6}, point=replace(NOMINAL, seal_pressure=0.0))
        )


def test_a_coefficient_found_beside_others_that_follow_the_pressure_says_so():
    """Nobody knows how a new K follows the pressure: the machine that holds it needs a reason, and
    gets one.
    """
    rig = load_machine("seal-rig")
    machine = replace(
        rig, seals=(replace(rig.seals[0], K=0.0, scales_with_pressure=("k", "C", "c")),)
    )
    made = update_machine(machine, found({"seal.center.K": 0.1e6}))
    assert made.seals[0].K == 0.1e6
    assert dict(made.assumed)["seal.center.scales_with_pressure"].startswith(
        "K: found at 204000 Pa; how it follows"
    )
    assert loads_machine(dumps_machine(made)) == made


def test_a_stated_range_of_operation_is_kept_where_asked_for():
    both = update_machine(
        load_machine("seal-rig"), found({"seal.center.k": 3e6})
    )  # the pressure's range is another parameter's
    assert [t.relative for t in both.tolerances] == [1.0, pytest.approx(0.0196)]
    rig, wide = load_machine("seal-rig"), found({"seal.center.k": 3e6}, relative=0.8)
    assert (
        update_machine(rig, found({"seal.center.k": 3e6}), keep_wider=True).tolerances
        == rig.tolerances
    )  # it moves k by more
    assert len(update_machine(rig, wide, keep_wider=True).tolerances) == 2
    machine = load_machine("seal-rig-k-only")
    narrow = update_machine(machine, found({"seal.center.k": 3e6}, machine=machine.name))
    assert next(
        t for t in narrow.tolerances if t.parameter == "seal.center.k"
    ).relative == pytest.approx(0.0196)
    kept = update_machine(
        machine, found({"seal.center.k": 3e6}, machine=machine.name), keep_wider=True
    )
    assert (
        next(t for t in kept.tolerances if t.parameter == "seal.center.k") == machine.tolerances[0]
    )
    unsure = update_machine(
        machine, found({"seal.center.k": 3e6}, relative=0.8, machine=machine.name), keep_wider=True
    )
    assert next(
        t for t in unsure.tolerances if t.parameter == "seal.center.k"
    ).relative == pytest.approx(1.568)


def test_another_machine_is_refused():
    with pytest.raises(InvalidInput, match="the machine of the result is 'turboexpander'"):
        update_machine(load_machine("seal-rig"), found(NINE, machine="turboexpander"))


def checked(result, findings=(), scatter=None):
    machine, source = (
        load_machine("seal-rig"),
        Provenance(("a.h5", "b.h5"), "pid.json", "2026-11-21"),
    )
    return LoopIdentification(
        given=machine,
        machine=machine,
        result=result,
        checks=tuple(findings),
        repeats=scatter,
        provenance=source,
        outputs=(),
        controller=None,
        computing_delay=1,
        bending_modes=1,
    )


def test_provenance_is_a_comment_that_a_reader_skips():
    load_machine("seal-rig")
    result = replace(
        found(NINE), warnings=(Finding(Code.CORRELATED, "warning", "one thing\nin two lines"),)
    )
    origin, comment = checked(result).origin, checked(result).comment
    assert origin == "9 parameters identified 2026-11-21 from a.h5, b.h5 with pid.json"
    made = checked(result).updated().machine
    assert made.source.endswith(origin)
    assert loads_machine(comment + dumps_machine(made)) == made
    assert (
        "# Warning: one thing in two lines" in comment
        and "standard deviation 1.5, began at 135" in comment
    )
    assert all(line.startswith("#") for line in comment.splitlines() if line)


def test_as_plain_values():
    finding = Finding(Code.BURST, "warning", "a", "b", "c")
    scatter = repeats(tuple(NINE), np.outer([0.99, 1.0, 1.02], list(NINE.values())))
    plain = checked(found(NINE), [finding], scatter).to_dict()
    assert not plain["good"] and plain["findings"] == [
        {"code": "burst", "severity": "warning", "what": "a", "evidence": "b", "remedy": "c"}
    ]
    first = plain["parameters"][0]
    assert first["unit"] == "N/A" and first["interval_95"] == pytest.approx(
        [150 - 2.94, 150 + 2.94]
    )
    assert plain["repeats"]["count"] == 3 and plain["residual_tests"][0]["passed"] is True
    assert checked(found(NINE)).to_dict()["good"]
