"""Generated C: a step of the 24-state 4 x 4 mu controller of the seal rig against dense matrices in C and the flop floor, code
generation, and single precision against double. Skipped (no rows) without a C compiler.

The dense peer is the same controller, as c2d gives it, in two nested loops over row-major matrices; both compiled with gcc -O2
and with -O3 -march=native.
"""

from __future__ import annotations

import ctypes
import resource
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from ambrose import load_machine
from ambrose.core.statespace import StateSpace
from ambrose.export.code_cost import flop_floor
from ambrose.export.control_block import ControlBlock, control_block
from ambrose.export.controller_code import Arithmetic, generate
from ambrose.export.files import ControllerFile, Provenance
from ambrose.export.fixed_point import fixed_point
from ambrose.export.fmu import fmu_files
from ambrose.export.mat import mat_files
from ambrose.export.sampling import Deployment, deploy
from ambrose.export.structured_text import structured_text
from ambrose.plant.assemble import assemble
from ambrose.synthesis.design import design

STEPS = 2_000_000
_SAMPLES = 20_000
_REAL: dict[Arithmetic, str] = {"double": "double", "float": "float", "fixed32": "int32_t"}
_TIMER = """
#include <stdio.h>
#include <time.h>
#include "INCLUDE"
static double seconds(void)
{
    struct timespec t;
    timespec_get(&t, TIME_UTC);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}
int main(void)
{
    static REAL noise[1024][4];
    REAL u[4], sum = 0;
    unsigned seed = 1;
    double begin;
    int k, j;
    SETUP
    for (k = 0; k < 1024; k++)
        for (j = 0; j < 4; j++) {
            seed = seed * 1664525u + 1013904223u;
            noise[k][j] = (REAL)(2e-8 * ((double)(seed >> 8) / 16777216.0 - 0.5));
        }
    begin = seconds();
    for (k = 0; k < STEPS; k++) {
        CALL
        sum += u[0];
    }
    printf("%.17g %g", (seconds() - begin) / STEPS, (double)sum);
    return 0;
}
"""
_DENSE = """
#ifndef DENSE_H
#define DENSE_H
static double state[N];
static void dense_step(const double e[4], double u[4])
{
    double next[N];
    int i, j;
    for (i = 0; i < 4; i++) {
        u[i] = 0;
        for (j = 0; j < N; j++) u[i] += C[i][j] * state[j];
        for (j = 0; j < 4; j++) u[i] += D[i][j] * e[j];
    }
    for (i = 0; i < N; i++) {
        next[i] = 0;
        for (j = 0; j < N; j++) next[i] += A[i][j] * state[j];
        for (j = 0; j < 4; j++) next[i] += B[i][j] * e[j];
    }
    for (i = 0; i < N; i++) state[i] = next[i];
}
#endif
"""


def run() -> list[dict[str, Any]]:
    """Rows: name, ours [s], peer [s] or None, peer_name, error, target."""
    if shutil.which("gcc") is None:
        print("no gcc: generated code is not measured")
        return []
    plant = assemble(load_machine("seal-rig"))
    deployment = deploy(design(plant, "mu"), 1e-4, 1e-4, force=True)
    block = control_block(deployment, "rig", 0.5e-3, 4.0)
    return [*_steps(block), _generation(block), *_other_targets(deployment, block), _precision(block)]


def _steps(block: ControlBlock) -> list[dict[str, Any]]:
    floor, peak = flop_floor(block), _peak()
    rows = []
    for flags in (["-O2"], ["-O3", "-march=native"]):
        dense = _timed(_dense_files(block.system), flags, "dense.h", "", "dense_step(noise[k % 1024], u);", "double")
        for arithmetic, real in _REAL.items():
            setup, call = "static rig_block block; rig_init(&block);", "(void)rig_step(&block, noise[k % 1024], 0, u);"
            ours = _timed(generate(block, arithmetic), flags, "rig.h", setup, call, real)
            text = f"floor {floor} flops: {floor / peak * 1e9:.3g} ns at the {peak / 1e9:.3g} Gflop/s measured without vectors"
            rows.append(
                {
                    "name": f"C step, {block.n_states} states 4 x 4, {arithmetic}, gcc {' '.join(flags)}",
                    "ours": ours,
                    "peer": dense,
                    "peer_name": "dense loops in C, double, no limits or checks",
                    "error": text,
                    "target": "faster than dense",
                }
            )
    return rows


def _dense_files(K: StateSpace) -> dict[str, str]:
    def table(name: str, x: np.ndarray) -> str:
        rows = ",\n".join("{" + ", ".join(f"{v:.17g}" for v in row) + "}" for row in x)
        return f"static const double {name}[{x.shape[0]}][{x.shape[1]}] = {{{rows}}};\n"

    # a dense state matrix, as c2d of a controller in the coordinates of its synthesis has it
    Q = np.linalg.qr(np.random.default_rng(0).normal(0, 1, K.A.shape))[0]
    tables = [table("A", Q @ K.A @ Q.T), table("B", Q @ K.B), table("C", K.C @ Q.T), table("D", K.D)]
    return {"dense.h": f"#define N {K.n_states}\n" + "".join(tables) + _DENSE}


def _timed(files: dict[str, str], flags: list[str], include: str, setup: str, call: str, real: str) -> float:
    """Median seconds of a step over five runs."""
    timer = _TIMER.replace("INCLUDE", include).replace("SETUP", setup).replace("CALL", call)
    timer = timer.replace("REAL", real).replace("STEPS", str(STEPS))
    with tempfile.TemporaryDirectory() as folder:
        for name, text in {**files, "timer.c": timer}.items():
            (Path(folder) / name).write_text(text)
        sources = [name for name in (*files, "timer.c") if name.endswith(".c") and not name.endswith("_test.c")]
        subprocess.run(["gcc", "-std=c11", *flags, *sources, "-o", "timer"], cwd=folder, check=True)
        found = [subprocess.run([f"{folder}/timer"], capture_output=True, text=True, check=True).stdout for _ in range(5)]
    return float(np.median([float(text.split()[0]) for text in found]))


def _peak() -> float:
    """Scalar multiply-adds a second of this processor with gcc -O2: eight independent chains, two flops each."""
    chains = "".join(f"static double x{i} = {i}.5;" for i in range(8))
    code = _TIMER.replace('#include "INCLUDE"', chains).replace("SETUP", "u[0] = 0; double " + ", ".join(
        f"a{i} = x{i}" for i in range(8)) + ", f = 1.0 - 1e-9, g = noise[0][0] + 1e-9;")  # fmt: skip
    code = code.replace("CALL", "".join(f"a{i} = a{i} * f + g;" for i in range(8)))
    code = code.replace("sum += u[0];", "").replace("(double)sum", "(double)sum + " + "+".join(f"a{i}" for i in range(8)))
    code = code.replace("REAL", "double").replace("STEPS", str(10 * STEPS))
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "peak.c").write_text(code)
        subprocess.run(["gcc", "-std=c11", "-O2", "peak.c", "-o", "peak"], cwd=folder, check=True)
        done = subprocess.run([f"{folder}/peak"], capture_output=True, text=True, check=True)
    return 16 / float(done.stdout.split()[0])


def _generation(block: ControlBlock) -> dict[str, Any]:
    generate(block)  # the templating engine is imported once
    found = []
    for _ in range(5):
        start = time.perf_counter()
        files = generate(block, "fixed32")
        found.append(time.perf_counter() - start)
    return {
        "name": "code generation: 5 files, fixed point",
        "ours": float(np.median(found)),
        "peer": None,
        "peer_name": "",
        "error": f"{sum(len(text) for text in files.values()) / 1024:.0f} KiB",
        "target": "< 1 s",
    }


def _other_targets(deployment: Deployment, block: ControlBlock) -> list[dict[str, Any]]:
    """CPU seconds of writing the other targets; the FMUs' includes the compiler's."""
    provenance = Provenance("", None, None, "2026-01-01T00:00:00+00:00")
    file = ControllerFile(deployment.source, "mu", "uncertified", float("nan"), None, provenance)
    targets = {
        "MAT-file, script, vectors": lambda: mat_files(block, deployment, file),
        "structured text, test program, vectors": lambda: structured_text(block),
        "FMI 2.0 and 3.0, sources only": lambda: fmu_files(block, sources_only=True),
        "FMI 2.0 and 3.0, compiled": lambda: fmu_files(block),
    }
    rows = []
    for name, write in targets.items():
        write()
        found = []
        for _ in range(3):
            start = _cpu()
            files = write()
            found.append(_cpu() - start)
        size = sum(len(content) for content in files.values()) / 1024
        row = {"name": f"generation: {name}", "ours": min(found), "peer": None, "peer_name": "", "error": f"{size:.0f} KiB"}
        rows.append({**row, "target": "< 1 s"})
    return rows


def _cpu() -> float:
    """Seconds of this process and of the compilers it ran."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(part.ru_utime + part.ru_stime for part in used)


def _precision(block: ControlBlock) -> dict[str, Any]:
    """Compiled single precision and fixed point against compiled double precision, relative to the current limit."""
    rng = np.random.default_rng(0)
    fixed = fixed_point(block)
    one = 1 << fixed.signal_bits
    whole = np.round(rng.uniform(-1, 1, (_SAMPLES, 4)) * 0.02 * one).astype(np.int64)
    e = (whole / one * block.error_limit).astype(np.float32).astype(float)
    limit = block.current_limit
    off = np.abs(_played(block, "float", e) - _played(block, "double", e)).max() / limit.max()
    exact = _played(block, "double", whole / one * block.error_limit)
    start = time.perf_counter()
    words = _played(block, "fixed32", whole)
    seconds = time.perf_counter() - start
    fixed_off = np.abs(words / one * limit - exact).max() / limit.max()
    return {
        "name": f"rounding in C over {_SAMPLES} samples, parts of the current limit",
        "ours": seconds,
        "peer": None,
        "peer_name": "double",
        "error": f"float {off:.2g}, fixed32 {fixed_off:.2g} (bound {(fixed.error / limit).max():.2g})",
        "target": "",
    }


def _played(block: ControlBlock, arithmetic: Arithmetic, errors: np.ndarray) -> np.ndarray:
    """Currents (k, p) of the compiled block over errors (k, m), called from Python."""
    kind = {"double": np.float64, "float": np.float32, "fixed32": np.int32}[arithmetic]
    with tempfile.TemporaryDirectory() as folder:
        for name, text in generate(block, arithmetic).items():
            (Path(folder) / name).write_text(text)
        library = f"{folder}/{block.name}.so"
        command = ["gcc", "-std=c99", "-O2", "-shared", "-fPIC", f"{folder}/{block.name}.c", "-o", library]
        subprocess.run(command, check=True)
        loaded = ctypes.CDLL(library)
    step = getattr(loaded, f"{block.name}_step")
    state = ctypes.create_string_buffer(16 * (block.n_states + 32))  # zero is the block after init
    given, current = errors.astype(kind), np.empty((len(errors), len(block.outputs)), kind)
    for e, u in zip(given, current, strict=True):
        step(state, ctypes.c_void_p(e.ctypes.data), None, ctypes.c_void_p(u.ctypes.data))
    return current.astype(float)
