"""Magnets of machine files: coefficients from [bearing.magnet], the sheets, refusals."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import main
from ambrose.core.checks import InvalidInput
from ambrose.machine.file.toml import dumps_machine, load_machine, loads_machine
from ambrose.machine.part import Magnet
from ambrose.model.effects.magnet import force, linearised, parameters
from ambrose.report.page import page_of

BLOWER = load_machine("overhung-blower")
EIGHT = Magnet("heteropolar", 59.5, 950e-6, 0.5e-3)
PM = Magnet(
    "homopolar",
    60,
    400e-6,
    0.5e-3,
    bias="permanent-magnet",
    remanence=1.1,
    magnet_length=0.01,
    magnet_area=1e-3,
)


def with_magnet(part, **more):
    first, second = BLOWER.bearings
    bearing = replace(first, geometry=None, magnet=part, **more)
    return replace(BLOWER, bearings=(bearing, second))


def test_the_file_keeps_it_and_the_plant_takes_it():
    machine = loads_machine(dumps_machine(with_magnet(EIGHT)))
    assert machine.bearings[0].magnet == EIGHT
    by_geometry = linearised(BLOWER.bearings[0])
    found = linearised(machine.bearings[0])
    assert found.force_per_current == pytest.approx(by_geometry.force_per_current, rel=1e-12)
    # the geometry's k_s is k_i i_0/s_0, with cos(22.5 deg)
    assert found.negative_stiffness[0] * np.cos(np.pi / 8) == pytest.approx(
        by_geometry.negative_stiffness[0], rel=1e-12
    )
    poles = np.linalg.eigvals(amb.assemble(machine).system.A)
    assert poles.real.max() > np.linalg.eigvals(amb.assemble(BLOWER).system.A).real.max()


def test_the_rig_takes_the_pair_of_the_same_derivatives():
    bearing = with_magnet(
        replace(
            PM, bias="coil", remanence=None, magnet_length=None, magnet_area=None, bias_turns=130.0
        )
    ).bearings[0]
    p, stated = parameters(bearing), linearised(bearing)
    h = 1e-3
    k_i = (force(h, 0, 0, 0, p)[0] - force(-h, 0, 0, 0, p)[0]) / (2 * h)
    k_s = (force(0, 0, 1e-8, 0, p)[0] - force(0, 0, -1e-8, 0, p)[0]) / 2e-8
    assert k_i == pytest.approx(stated.force_per_current[0], rel=1e-6)
    assert k_s == pytest.approx(stated.negative_stiffness[0], rel=1e-6)
    assert p[5] == pytest.approx(0.5e-3)  # its gap is the magnet's own


def test_a_permanent_magnet_says_the_bias_it_is_worth():
    with pytest.raises(InvalidInput, match=r"write bias_current = ") as refused:
        amb.magnet_sheets(with_magnet(PM))
    bias = float(str(refused.value).rpartition("= ")[2])
    sheet = amb.magnet_sheets(with_magnet(PM, bias_current=bias), "impeller-side").sheets[0]
    assert sheet.flux_density[1] == pytest.approx(2 * sheet.flux_density[0], rel=1e-3)


@pytest.mark.parametrize(
    ("part", "word"),
    [
        (replace(EIGHT, poles=10), "poles is 10, but must be one of 8, 12, 16"),
        (replace(EIGHT, gap=-1e-3), "gap"),
        (replace(EIGHT, back_iron_area=1e-3), "needs journal_radius and iron_path"),
        (replace(EIGHT, bias_turns=10.0), 'belongs to kind = "homopolar"'),
        (replace(PM, remanence=None), "remanence is missing"),
        (replace(PM, bias="coil"), "bias_turns is missing"),
        (replace(EIGHT, gap=0.1e-3), "must land before it meets the magnet"),
    ],
)
def test_bad_magnets(part, word):
    with pytest.raises(InvalidInput, match=word):
        with_magnet(part)


def test_the_command(tmp_path):
    page = tmp_path / "magnets.html"
    run = CliRunner().invoke(main, ["magnet", "overhung-blower", "-o", str(page), "--json"])
    assert run.exit_code == 0, run.output
    sheet = json.loads(run.output)["magnets"][0]
    i_0, k_i = 4.0, sheet["force_per_current"][0]
    assert sheet["force_at_full_modulation_0p"] == pytest.approx(k_i * i_0, rel=1e-9)
    assert sheet["force_per_current_left"] == pytest.approx(0.5, rel=1e-9)
    assert 0.05 < sheet["linearity_zeta"]["largest_error"] < 0.15
    assert "Error of the linear law" in page.read_text(encoding="utf-8")
    found = amb.magnet_sheets(BLOWER)
    shown = page_of(found)
    (table,) = shown.opening.tables  # which had no verdict and no table that decides
    assert [row[0] for row in table.rows] == list(found.bearings)
    worst = max(item.worst for item in found.sheets[0].maps)
    assert f"off by at most {100 * worst:.3g} %" in shown.result.text
    with pytest.raises(InvalidInput, match="no magnet of"):
        amb.magnet_sheets(load_machine("turboexpander"))
    with pytest.raises(InvalidInput, match="there is no bearing"):
        amb.magnet_sheets(BLOWER, "A")
