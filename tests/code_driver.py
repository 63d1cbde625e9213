"""Compiles generated code with a driver that replays a file of samples, and runs it: the block from
C, for comparison.
"""

import functools
import shutil
import subprocess
import tempfile
from pathlib import Path

import numpy as np

import compiled_once
from ambrose.code.block.block import Block, ControlBlock
from ambrose.code.block.scheduled import ScheduledBlock
from ambrose.code.c.code import generate

FLAGS = [
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-pedantic",
    "-Werror",
    "-Wconversion",
    "-Wshadow",
    "-Wfloat-equal",
]
SANITIZERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
TYPES = {"double": np.float64, "float": np.float32, "fixed32": np.int32, "fixed16": np.int16}
STEP = 0
TRACK = 1
RESET = 2
_DRIVER = """
#include <stdio.h>
#include "NAME.h"
typedef struct {
    TYPE error[PREFIX_INPUTS];
    TYPE current[PREFIX_OUTPUTS];
    TYPE speed; /* of a scheduled block */
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
            status = NAME_step(&block, r.error, r.valid, SPEED r.current);
        else if (r.op == 1)
            NAME_track(&block, r.error, r.valid, SPEED r.current);
        else
            NAME_reset(&block);
        fwrite(r.current, sizeof r.current, 1, stdout);
        fwrite(&status, sizeof status, 1, stdout);
    }
    return 0;
}
"""


def compilers() -> list[str]:
    return [name for name in ("gcc", "clang") if shutil.which(name)]


@functools.cache
def sanitizers(compiler: str) -> tuple[str, ...]:
    """SANITIZERS, or nothing where the compiler is installed without their libraries (clang often
    is).
    """
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "empty.c").write_text("int main(void) { return 0; }\n")
        done = subprocess.run(
            [compiler, *SANITIZERS, "empty.c"], cwd=folder, capture_output=True, check=False
        )
    return tuple(SANITIZERS) if done.returncode == 0 else ()


def compiled(
    block: Block,
    arithmetic: str,
    directory: Path,
    compiler: str,
    flags: list[str] | None = None,
    **settings: float,
) -> Path:
    """The driver's executable; the compiler's complaints are the test's failure."""
    directory.mkdir(exist_ok=True)
    files = generate(block, arithmetic, ["A */ comment that wants out ??/", "é"], **settings)
    for name, text in files.items():
        (directory / name).write_text(text)
    track = "NAME_track(&block, r.error, r.valid, SPEED r.current);"
    code = _DRIVER if "_track(" in files[f"{block.name}.h"] else _DRIVER.replace(track, "return 1;")
    speed = "r.speed," if isinstance(block, ScheduledBlock) else ""
    code = (
        code.replace("SPEED", speed)
        .replace("PREFIX", block.name.upper())
        .replace("NAME", block.name)
    )
    kind = {"double": "double", "float": "float", "fixed32": "int32_t", "fixed16": "int16_t"}[
        arithmetic
    ]
    (directory / "driver.c").write_text(code.replace("TYPE", kind))
    target = directory / f"run-{compiler}"
    sources = [str(directory / f"{block.name}.c"), str(directory / "driver.c")]
    build(
        compiler,
        [
            *(["-O1", *sanitizers(compiler)] if flags is None else flags),
            *sources,
            "-o",
            str(target),
        ],
    )
    return target


def build(compiler: str, arguments: list[str]) -> None:
    status, complaints = compiled_once.build([compiler, *FLAGS, *arguments])
    assert status == 0, complaints


def replay(
    program: Path,
    arithmetic: str,
    errors: np.ndarray,
    valid: np.ndarray | None = None,
    op: np.ndarray | None = None,
    given: np.ndarray | None = None,
    outputs: int = 4,
    speeds: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Currents (k, p) and status (k,) of the compiled block over errors (k, m), and speeds (k,) if
    it is scheduled.
    """
    count, inputs = errors.shape
    kind = TYPES[arithmetic]
    rows = np.zeros(
        count,
        [
            ("e", kind, inputs),
            ("u", kind, outputs),
            ("v", kind),
            ("valid", "u1", inputs),
            ("op", "u1"),
        ],
    )
    with np.errstate(over="ignore", invalid="ignore"):
        rows["e"], rows["v"] = errors, 0 if speeds is None else speeds
    rows["valid"] = 1 if valid is None else valid
    rows["op"] = STEP if op is None else op
    rows["u"] = 0 if given is None else given
    done = subprocess.run([str(program)], input=rows.tobytes(), capture_output=True, check=False)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    found = np.frombuffer(done.stdout, [("u", kind, outputs), ("status", "u4")])
    assert len(found) == count
    return found["u"].astype(np.int64 if "fixed" in arithmetic else float), found["status"]


def adversarial(block: ControlBlock, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Errors (count, m) and flags: noise of all sizes, long saturation, worst-case switching, NaN,
    infinity, denormals, any bit pattern, values beside the limit, silence.
    """
    rng = np.random.default_rng(seed)
    m, limit = len(block.inputs), block.error_limit
    e = np.empty((count, m))
    valid = np.ones((count, m), bool)
    start = 0
    while start < count:
        k = int(min(rng.integers(20, 800), count - start))
        rows, kind = slice(start, start + k), int(rng.integers(0, 12))
        if kind == 5:
            e[rows] = np.where(
                rng.random((k, m)) < 0.3,
                rng.choice([np.nan, np.inf, -np.inf, 1e300], (k, m)),
                0.01 * limit,
            )
        elif kind == 6:
            e[rows] = rng.choice([5e-324, -5e-324, 2e-308, 1e-310, -0.0, 1e-45, 1e-39], (k, m))
        elif kind == 7:
            e[rows] = np.frombuffer(rng.bytes(8 * k * m)).reshape(k, m)
        elif kind == 8:
            e[rows] = np.nextafter(np.broadcast_to(limit, (k, m)), rng.choice([0.0, 2.0], (k, m)))
        else:
            e[rows] = limit * _ordinary(block, kind, k, rng)
        if kind == 10:
            valid[rows] = rng.random((k, m)) > 0.5
        start += k
    return e, valid


def _ordinary(block: ControlBlock, kind: int, k: int, rng: np.random.Generator) -> np.ndarray:
    m = len(block.inputs)
    if kind <= 2:
        return rng.normal(0, 1, (k, m)) * 10.0 ** rng.uniform(-6, 0, m)
    if kind == 3:
        return np.broadcast_to(rng.choice([-1.0, 1.0], m), (k, m))
    if kind == 4:
        return worst_case(block, k, rng)
    if kind == 9:
        return np.zeros((k, m))
    if kind == 10:
        return rng.normal(0, 0.02, (k, m))
    return np.where(np.arange(k)[:, None] % 2, 1.0, -1.0) * rng.uniform(0, 1.5, m)


def worst_case(block: ControlBlock, count: int, rng: np.random.Generator) -> np.ndarray:
    """The switching of all inputs that drives one output furthest after ``count`` samples: the
    impulse response's signs.
    """
    row = block.C[rng.integers(len(block.outputs))]
    signs = np.empty((count, len(block.inputs)))
    A = np.eye(block.n_states) + block.increment
    for k in reversed(range(count)):
        signs[k] = np.sign(row @ block.B)
        row = row @ A
    return signs
