"""Compiles the code of a scheduled block with a driver that replays a file of samples, and runs it."""

import subprocess
from pathlib import Path
from typing import Any

import numpy as np

import code_driver as driver
from ambrose import StateSpace
from ambrose.core.sampling import c2d
from ambrose.core.scheduled import ScheduledSystem
from ambrose.deployment.block.scheduled import ScheduledBlock, build_scheduled_block
from ambrose.deployment.c.code import generate
from ambrose.deployment.discretisation.deployment import deploy_scheduled
from ambrose.deployment.discretisation.sampling import response

ERROR, CURRENT, DT = 1e-3, 2.0, 1e-4
GRID = (100.0, 250.0, 300.0, 600.0)  # rad/s
TYPES = {"double": np.float64, "float": np.float32}
_DRIVER = """
#include <stdio.h>
#include "NAME.h"
typedef struct {
    TYPE error[PREFIX_INPUTS];
    TYPE current[PREFIX_OUTPUTS];
    TYPE speed;
    unsigned char valid[PREFIX_INPUTS];
    unsigned char op;
} row;
int main(void)
{
    static NAME_block block;
    row r;
    unsigned status;
    NAME_init(&block);
    while (fread(r.error, sizeof r.error, 1, stdin) == 1 && fread(r.current, sizeof r.current, 1, stdin) == 1 &&
           fread(&r.speed, sizeof r.speed, 1, stdin) == 1 && fread(r.valid, sizeof r.valid, 1, stdin) == 1 &&
           fread(&r.op, 1, 1, stdin) == 1) {
        status = 0;
        if (r.op == 0)
            status = NAME_step(&block, r.error, r.valid, r.speed, r.current);
        else if (r.op == 1)
            NAME_track(&block, r.error, r.valid, r.speed, r.current);
        else
            NAME_reset(&block);
        fwrite(r.current, sizeof r.current, 1, stdout);
        fwrite(&status, sizeof status, 1, stdout);
    }
    return 0;
}
"""


def small_schedule(dt: float | None = None) -> ScheduledSystem:
    """A slow pole and a resonance that moves with speed, two errors, two currents, four grid points unevenly apart."""
    systems = []
    for v in GRID:
        w = 300.0 + 2.0 * v
        A = [[-2.0, 0.0, 0.0], [0.3 * v, -60.0 - 0.2 * v, w], [0.0, -w, -80.0]]
        B = [[20.0, 5.0], [1e3, 0.0], [0.5 * v, 2e3]]
        C = [[300.0, 900.0 - v, 40.0], [-100.0 + v, 0.0, 700.0]]
        D = [[1e3 + v, 0.0], [0.0, 2e3]]
        systems.append(StateSpace(A, B, C, D, ["err_x", "err_y"], ["u_x", "u_y"]))
    return ScheduledSystem(GRID, systems)


def two_states() -> ScheduledSystem:
    """Two states, an integrator among them, one error, one current."""
    systems = [
        StateSpace([[0.0, 0.0], [0.0, -400.0 - v]], [[5.0], [3e3]], [[2e3, 10.0 + 0.1 * v]], [[1e3 + v]], ["err_x"], ["u_x"])
        for v in GRID
    ]
    return ScheduledSystem(GRID, systems)


def gain_schedule() -> ScheduledSystem:
    """A gain that grows with speed, no states."""
    systems = [StateSpace([], [], [], [[2e3 + v, 0.0], [0.0, 3e3]], ["err_x", "err_y"], ["u_x", "u_y"]) for v in GRID]
    return ScheduledSystem(GRID, systems)


def block_of(schedule: ScheduledSystem, name: str = "lpv", **settings: Any) -> ScheduledBlock:
    return build_scheduled_block(deploy_scheduled(schedule, DT, DT, force=True), name, ERROR, CURRENT, **settings)


def compiled(
    block: ScheduledBlock, arithmetic: str, directory: Path, compiler: str, flags: list[str] | None = None
) -> Path:  # fmt: skip
    """The driver's executable; the compiler's complaints are the test's failure."""
    directory.mkdir(exist_ok=True)
    files = generate(block, arithmetic, ["A */ comment that wants out ??/", "é"])
    for name, text in files.items():
        (directory / name).write_text(text)
    track = "NAME_track(&block, r.error, r.valid, r.speed, r.current);"
    code = _DRIVER if "_track(" in files[f"{block.name}.h"] else _DRIVER.replace(track, "return 1;")
    code = code.replace("PREFIX", block.name.upper()).replace("NAME", block.name).replace("TYPE", arithmetic)
    (directory / "driver.c").write_text(code)
    target = directory / f"run-{compiler}"
    sources = [str(directory / f"{block.name}.c"), str(directory / "driver.c")]
    driver.build(compiler, [*(["-O1", *driver.sanitizers(compiler)] if flags is None else flags), *sources, "-o", str(target)])
    return target


def replay(
    program: Path,
    arithmetic: str,
    errors: np.ndarray,
    speeds: np.ndarray,
    valid: np.ndarray | None = None,
    op: np.ndarray | None = None,
    given: np.ndarray | None = None,
    outputs: int = 2,
) -> tuple[np.ndarray, np.ndarray]:
    """Currents (k, p) and status (k,) of the compiled block over errors (k, m) and speeds (k,)."""
    count, inputs = errors.shape
    kind = TYPES[arithmetic]
    rows = np.zeros(count, [("e", kind, inputs), ("u", kind, outputs), ("v", kind), ("valid", "u1", inputs), ("op", "u1")])
    with np.errstate(over="ignore", invalid="ignore"):
        rows["e"], rows["v"] = errors, speeds
    rows["valid"] = 1 if valid is None else valid
    rows["op"] = 0 if op is None else op
    if given is not None:
        rows["u"] = given
    done = subprocess.run([str(program)], input=rows.tobytes(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    found = np.frombuffer(done.stdout, [("u", kind, outputs), ("status", "u4")])
    assert len(found) == count
    return found["u"].astype(float), found["status"]


def adversarial_speeds(block: ScheduledBlock, count: int, seed: int = 0) -> np.ndarray:
    """Speeds (count,): sweeps, jumps, grid points and their neighbours, out of range, NaN, infinity, denormals, any bits."""
    rng = np.random.default_rng(seed)
    low, high = block.range
    v = np.empty(count)
    start = 0
    while start < count:
        k = int(min(rng.integers(20, 600), count - start))
        kind = int(rng.integers(0, 9))
        if kind <= 1:
            part = np.linspace(*rng.uniform(low, high, 2), k)
        elif kind == 2:
            part = np.linspace(low - 0.2 * high, 1.2 * high, k)[:: rng.choice([-1, 1])]
        elif kind == 3:
            part = rng.uniform(low, high, k)
        elif kind == 4:
            part = np.nextafter(rng.choice(block.grid, k), rng.choice([-np.inf, 0.0, np.inf], k))
        elif kind == 5:
            part = rng.choice(block.grid, k)
        elif kind == 6:
            part = np.where(rng.random(k) < 0.3, rng.choice([np.nan, np.inf, -np.inf, 1e300], k), rng.uniform(low, high))
        elif kind == 7:
            part = np.full(k, np.nan)
        else:
            part = np.concatenate(
                [np.frombuffer(rng.bytes(8 * (k - k // 2))), rng.choice([5e-324, -0.0, -1e3, 1e-310], k // 2)]
            )
        v[start : start + k] = part
        start += k
    return v


def apart_in_gain(sampled: ScheduledSystem, meant: ScheduledSystem, dt: float) -> float:
    """The largest relative distance of frequency responses at the grid points from Tustin's map of a continuous schedule."""
    omega = np.geomspace(1e-4, 0.99, 100) * np.pi / dt
    worst = 0.0
    for v in meant.grid:
        expected = response(c2d(meant.at(float(v)), dt, "tustin"), omega)
        found = response(sampled.at(float(v)), omega)
        worst = max(worst, float((np.linalg.norm(found - expected, 2, (1, 2)) / np.linalg.norm(expected, 2, (1, 2))).max()))
    return worst
