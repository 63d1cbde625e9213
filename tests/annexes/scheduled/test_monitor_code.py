"""The C code of the seal monitor beside the Python one, sample by sample on the same record."""

import ctypes
import re
from dataclasses import replace

import numpy as np
import pytest

import ambrose as amb
from ambrose.annexes.scheduled.monitor import generate_monitor, write_monitor
from ambrose.annexes.scheduled.seal_monitor import seal_model
from ambrose.annexes.scheduled.seal_watch import SealMonitor
from ambrose.code.c.compiled import build_library, find_compiler, load_library
from ambrose.core.checks import InvalidInput
from ambrose.core.response import simulate
from ambrose.core.sampling import c2d
from ambrose.core.statespace import select
from ambrose.judge.result import pid_synthesis
from ambrose.law.loop import closed_loop, match_controller
from ambrose.model.assemble import assemble
from ambrose.model.uncertainty import free_mode_reduction
from needs import needs

DT, LENGTH = 1e-4, 16_000


def case(name, speed):
    machine = amb.load_machine(name)
    point = replace(machine.operation.nominal, speed=speed, label="")
    plant = free_mode_reduction(assemble(machine, point), 1)
    law = pid_synthesis(plant).controller
    dt = law.dt or DT
    held = c2d(match_controller(law, plant), dt, "tustin", delay=dt)
    loop = closed_loop(plant, held)
    m = len(machine.axes)
    rng = np.random.default_rng(0)
    e = 0.05 * np.repeat(rng.integers(0, 2, (m, LENGTH // 10)) * 2 - 1, 10, axis=1)
    e[:, 14_000:] = 0.0
    names = [[f"{k}_{axis}" for k in kinds for axis in machine.axes] for kinds in ("ed", "yu")]
    signals = simulate(select(loop, *names), np.vstack([e, 1e-7 * rng.standard_normal(e.shape)]))
    model = seal_model(
        machine, law, point, [f"seal.{machine.seals[0].name}.pressure"], dt, bending_modes=1
    )
    return model, signals[:m], signals[m:], e


@needs("C compiler")
@pytest.mark.parametrize(
    ("name", "speed"), [("seal-rig", 0.0), ("seal-rig", 300.0), ("three-bearing-train", 900.0)]
)
def test_code_and_python_give_the_same(name, speed):
    model, y, u, e = case(name, speed)
    following = SealMonitor(model, window=0.5)
    files = generate_monitor(following)
    flags = ["-Wall", "-Wextra", "-Werror", "-pedantic"]
    library = load_library(
        build_library(find_compiler(), files, ["seal_monitor.c"], flags, "mend the code")
    )
    m = len(model.axes)
    memory = ctypes.create_string_buffer(200_000)
    step, vector = library.seal_monitor_step, ctypes.c_double * m
    step.restype = ctypes.c_uint
    library.seal_monitor_init(memory)
    told = []
    for k in range(LENGTH):
        status = step(memory, vector(*y[:, k]), vector(*u[:, k]), vector(*e[:, k]))
        if status & 1:
            told.append((status, *np.frombuffer(memory, count=2)))
    found = following.follow(y, u + e, e)
    assert len(told) == len(found) > 50
    compared = 0
    for (status, value, half), item in zip(told, found, strict=True):
        assert bool(status & 4) == item.restarted
        if status & 2:
            assert value == pytest.approx(item.theta[0] * model.reference[0], rel=1e-6)
            assert half == pytest.approx(item.half_width[0] * model.reference[0], rel=1e-4)
            compared += 1
    assert compared > 30


def test_what_the_header_says_and_what_is_refused(tmp_path):
    model = case("seal-rig", 0.0)[0]
    paths = write_monitor(tmp_path / "code", SealMonitor(model))
    assert sorted(path.name for path in paths) == ["seal_monitor.c", "seal_monitor.h"]
    header = (tmp_path / "code" / "seal_monitor.h").read_text()
    assert (
        int(re.search(r"Cost: (\d+) mult", header)[1]) < 4500 and "seal.center.pressure" in header
    )
    code = (tmp_path / "code" / "seal_monitor.c").read_text()
    assert "malloc" not in code and "#include <" not in code
    with pytest.raises(InvalidInput, match="one parameter"):
        generate_monitor(SealMonitor(replace(model, unknown=model.unknown * 2)))
