"""A controller scheduled over pressure from its design to compiled code on the rig, with a sensor
that is lost or errs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.io import loadmat

from ambrose.cli import main
from ambrose.code.block.block import build_block
from ambrose.code.block.run import (
    BEHIND,
    CLAMPED,
    FAULT,
    TOLD,
    run_of,
)
from ambrose.code.block.scheduled import build_scheduled_block
from ambrose.code.c.compiled import CompiledSchedule
from ambrose.code.pipeline import export, machine_limits
from ambrose.code.sampled import deploy, deploy_scheduled
from ambrose.core.checks import InvalidInput
from ambrose.judge.controller_file import write_controller
from ambrose.law.law import ScheduledProgram
from ambrose.machine.description import Tolerance
from ambrose.machine.file.update import save_machine
from ambrose.model.assemble import assemble
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import PressureChange, PressureSensor, Pulse, Scenario
from ambrose.synthesis.design import design
from coarse import coarse
from needs import needs

DT = 1e-4
compiler = needs("cc")


@pytest.fixture(scope="module")
def machine():
    return replace(coarse("seal-rig"), gravity_direction=None)


@pytest.fixture(scope="module")
def made(machine):
    return design(assemble(machine), "lpv", pressures=(0.0, 4.08e5), rate=1 / DT)


@pytest.fixture(scope="module")
def deployment(machine, made):
    return deploy_scheduled(made, DT, DT, machine=machine)


def test_the_sampled_loop_is_verified_at_frozen_pressures(machine, deployment):
    """Tolerances around a point hold there and not at other pressures, where 'nominal +-100 %'
    would be another range.
    """
    assert deployment.verified and len(deployment.values) == 15
    assert deployment.checks[0].label == "0 Pa" and deployment.checks[-1].label == "408000 Pa"
    assert [checks.label for checks in deployment.points] == [
        point.label for point in machine.operation.points
    ]
    assert not deployment.outside
    assert [box.label for box in deployment.box] == ["over the tolerances at 204000 Pa"]


def test_a_relative_tolerance_is_left_out_where_the_seal_is_zero(machine, made):
    seal, bearing = (
        Tolerance("seal.center.pressure", 0.1),
        Tolerance("bearing.A.force_per_current", 0.03),
    )
    found = deploy_scheduled(made, DT, DT, machine=replace(machine, tolerances=(seal, bearing)))
    assert [box.label for box in found.box] == [
        f"over the tolerances at {p} Pa" for p in ("0", "204000", "408000")
    ]
    alone = deploy_scheduled(made, DT, DT, machine=replace(machine, tolerances=(seal,)))
    assert [box.label for box in alone.box] == [
        f"over the tolerances at {p} Pa" for p in ("204000", "408000")
    ]


def test_what_changes_with_a_seal_is_few_signals(machine, made, deployment):
    """One seal pushes in two directions: rank 4 of 28, and a step of about twice the frozen one."""
    block = build_scheduled_block(deployment, "rig", *machine_limits(machine))
    frozen = build_block(
        deploy(made.controller, DT, DT, force=True), "rig", *machine_limits(machine)
    )
    assert block.changes.ranks == (4, 4) and block.n_states == 24
    ratio = block.cost("double").multiplications / frozen.cost("double").multiplications
    assert ratio < 2.1  # 1.94


def test_the_command_takes_pressures_with_their_units(machine, made, tmp_path):
    file, own = write_controller(tmp_path / "k.json", made, machine), tmp_path / "rig.toml"
    save_machine(machine, own)

    def call(*options: str):
        return CliRunner().invoke(
            main,
            [
                "export",
                str(file),
                "--to",
                "c",
                "-o",
                str(tmp_path / "code"),
                "--name",
                "rig",
                "--machine",
                str(own),
                *options,
            ],
        )

    refused = call("--speed-rate", "100")
    assert (
        refused.exit_code == 2
        and "speed_limit or speed_rate is given, but must be left out" in refused.stderr
    )
    unit = call("--pressure-rate", "40 kg")
    assert unit.exit_code == 2 and "--pressure-rate" in unit.stderr
    low = call("--pressure-limit", "3 bar")
    assert (
        low.exit_code == 2
        and "pressure_limit is 300000 Pa, but must be at least 408000 Pa" in low.stderr
    )
    done = call("--pressure-rate", "40 bar/s", "--pressure-limit", "6 bar")
    # 1: the rig's tolerance of the pressure is the whole range
    assert done.exit_code in (0, 1), done.stderr
    header = (tmp_path / "code" / "rig.h").read_text()
    for text in (
        "#define RIG_PRESSURE_RATE 4000000",
        "#define RIG_PRESSURE_LIMIT 600000.0",
        "(0 to 4.08 bar)",
        "stable at 15 of 15 frozen pressures from 0 to 408000 Pa",
    ):
        assert text in header


def test_pressures_mean_nothing_to_a_schedule_over_speed(machine, made, tmp_path):
    for what in ({"pressure_rate": 1e5}, {"pressure_limit": 1e6}):
        with pytest.raises(InvalidInput, match="this controller is not scheduled over pressure"):
            export(
                made.controller,
                tmp_path / "code",
                to="c",
                machine=machine,
                **what,
            )


def test_other_targets(machine, made, deployment, tmp_path, monkeypatch):
    """The MAT-file's pages, put together by its own formulas, are the block; the FMUs are there
    with the pressure.
    """
    # verified above
    monkeypatch.setattr("ambrose.code.pipeline.deploy_scheduled", lambda *of, **how: deployment)
    done = {
        to: export(
            made,
            tmp_path / to,
            to=to,
            machine=machine,
            name="rig",
            force=True,
            **({"sources_only": True} if to == "fmu" else {}),
        )
        for to in ("fmu", "mat", "st")
    }
    assert sorted(path.name for path in done["fmu"].paths) == ["rig_fmi2.fmu", "rig_fmi3.fmu"]
    assert sorted(path.name for path in done["mat"].paths) == ["rig.mat", "rig_vectors.csv"]
    assert "pressure : LREAL" in (tmp_path / "st" / "rig.st").read_text()
    c = loadmat(tmp_path / "mat" / "rig.mat", simplify_cells=True)["rig"]
    assert (c["scheduling"]["parameter"], c["scheduling"]["unit"]) == ("pressure", "Pa")
    np.testing.assert_allclose(c["scheduling"]["grid"], deployment.sampled.grid)
    assert (
        c["A"].shape == (24, 24, 8)
        and c["D"].shape == (4, 4, 8)
        and c["limits"]["pressure"] == 8.16e5
    )
    block = c["block"]
    grid = c["scheduling"]["grid"]
    vectors = c["vectors"]
    state = np.zeros(24)
    used = np.zeros(4)
    told = grid[0]
    for e, good, p, u in zip(
        vectors["errors"], vectors["valid"], vectors["pressure"], vectors["currents"], strict=True
    ):
        told = p if abs(p) <= c["limits"]["pressure"] else told
        v = min(max(told, grid[0]), grid[-1])
        i = min(int(np.searchsorted(grid, v, side="right")) - 1, len(grid) - 2)
        s = (v - grid[i]) / (grid[i + 1] - grid[i])
        E, B, C, D, L = (
            (1 - s) * block[x][..., i] + s * block[x][..., i + 1]
            for x in ("increment", "B", "C", "D", "unwind")
        )
        ok = (good > 0) & (np.abs(e) <= c["limits"]["error"])
        used = np.where(ok, e, used)
        asked = C @ state + D @ used
        given = np.clip(asked, -c["limits"]["current"], c["limits"]["current"])
        np.testing.assert_allclose(given, u, atol=1e-9 * c["limits"]["current"].max())
        state = state + E @ state + B @ used + L @ (given - asked)


SENSORS = {
    "true": ((), 0),
    "lost": ((PressureSensor(0.03, fault="lost"),), TOLD),
    "lost for long": ((PressureSensor(0.005, fault="lost"),), TOLD | FAULT),
    "beyond the range": ((PressureSensor(offset=4e5),), CLAMPED),
    "implausible": ((PressureSensor(0.02, gain=1e3),), TOLD),
    "stuck": ((PressureSensor(0.03, fault="stuck"),), 0),
    "faster than its rate": ((), BEHIND),
}


@compiler
@pytest.mark.parametrize("name", SENSORS)
def test_the_code_on_the_rig_is_the_twin_in_python(machine, deployment, name):
    """The record's errors and pressures through the twin give the record's currents, one sample
    later, and its status.
    """
    sensors, bit = SENSORS[name]
    errors, currents = machine_limits(machine)
    rate = 10e5 if bit == BEHIND else 100e5
    block = build_scheduled_block(
        deployment, "rig", errors, currents, rate_limit=rate, hold_samples=400
    )
    scenario = Scenario(
        "surge",
        0.08,
        pulses=(Pulse("f_center_x", 20.0, 0.005, 0.003),),
        pressures=(PressureChange(0.01, 4e5, 0.06),),
        pressure_sensors=sensors,
    )
    point = next(point for point in machine.operation.points if point.seal_pressure == 0)
    code = CompiledSchedule(block)
    assert isinstance(code, ScheduledProgram)
    ran = virtual_rig.run(machine, code, scenario, point=point)
    assert ran.outcome == "completed"
    record = ran.record
    told = np.array(record["p_measured"] if sensors else record["p_seal"])
    if sensors and sensors[0].fault == "lost":
        told[round(sensors[0].time / DT) :] = np.nan
    e = -np.column_stack([record[f"y_{axis}"] for axis in machine.axes])
    twin = run_of(block, e, told)
    acts = np.column_stack([record[f"u_{axis}"] for axis in machine.axes])
    assert np.abs(acts[1:] - twin.currents[:-1]).max() < 1e-11 * np.abs(acts).max()
    assert not bit or (twin.status & bit == bit).any()
    assert code.status == twin.status[-1]
    if not bit:
        # a pressure that stands still is no news to the code: see the monitor
        assert not twin.status.any()


@compiler
def test_the_law_on_the_rig_is_that_of_the_code(machine, deployment, made):
    """Sampled member by member and read every ten samples, it stays within 2 % of what the code
    does.
    """
    errors, currents = machine_limits(machine)
    code = CompiledSchedule(build_scheduled_block(deployment, "rig", errors, currents))
    scenario = Scenario(
        "surge",
        0.08,
        pulses=(Pulse("f_center_x", 20.0, 0.005, 0.003),),
        pressures=(PressureChange(0.01, 4e5, 0.06),),
    )
    point = next(point for point in machine.operation.points if point.seal_pressure == 0)
    ran, law = (
        virtual_rig.run(machine, item, scenario, point=point).record
        for item in (code, made.scheduled)
    )
    names = [f"y_{axis}" for axis in machine.axes]
    size = max(np.ptp(law[name]) for name in names)
    assert size > 1e-6
    assert max(np.abs(ran[name] - law[name]).max() for name in names) < 0.02 * size
