"""Generated C: a step of the 24-state 4 x 4 mu controller of the seal rig against dense matrices in
C and the flop floor, code generation, single precision against double, and the code in the loop:
the nonlinear rig run by it and by the law in Python. Skipped (no rows) without a C compiler.

The dense peer is the same controller, as c2d gives it, in two nested loops over row-major matrices;
both compiled with gcc -O2 and with -O3 -march=native.
"""

from __future__ import annotations

import ctypes
import resource
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ambrose import design as tuned, load_machine
from ambrose.code.block.block import ControlBlock, build_block
from ambrose.code.block.fixed_point import in_words
from ambrose.code.block.scheduled import build_scheduled_block, supervise
from ambrose.code.c.code import Arithmetic, generate
from ambrose.code.c.compiled import CompiledBlock, read_law
from ambrose.code.fmu import generate_fmus
from ambrose.code.mat import generate_mat
from ambrose.code.pipeline import machine_limits
from ambrose.code.sampled import Deployment, deploy, deploy_scheduled
from ambrose.code.structured_text import generate_structured_text
from ambrose.core.statespace import StateSpace
from ambrose.judge.result import Provenance, Synthesis
from ambrose.law.supervision import Limits
from ambrose.machine.machine import Machine
from ambrose.model.assemble import assemble
from ambrose.rig import virtual_rig
from ambrose.rig.scenario import Scenario, load_scenario
from ambrose.rig.trace import Trace
from ambrose.synthesis.design import design

STEPS = 2_000_000
_SAMPLES = 20_000
_REAL: dict[Arithmetic, str] = {"double": "double", "float": "float", "fixed32": "int32_t"}
_TIMER = """
#include <stdio.h>
#include <time.h>
#include "INCLUDE"
static double seconds(void) /* of CPU time: other programs run beside this one */
{
    return (double)clock() / CLOCKS_PER_SEC;
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


def run(smoke: bool = False) -> Iterator[dict[str, Any]]:
    """Rows: name, ours [s], peer [s] or None, peer_name, error, target."""
    if shutil.which("gcc") is None:
        print("no gcc: generated code is not measured")
        return
    machine = load_machine("seal-rig")
    steps, runs = (20_000, 1) if smoke else (STEPS, 5)
    method = "pid" if smoke else "mu"
    deployment = deploy(design(assemble(machine), method), 1e-4, 1e-4, force=True)
    block = build_block(deployment, "rig", 0.5e-3, 4.0)
    in_the_loop = build_block(deployment, "rig", *machine_limits(machine))
    yield from _steps(block, steps, runs)
    if not smoke:  # the design of its schedule takes a quarter of a minute
        yield from _scheduled_steps(machine, steps, runs)
    yield _generation(block, runs)
    yield from _other_targets(deployment, block, 1 if smoke else 3)
    yield _precision(block, _SAMPLES // 100 if smoke else _SAMPLES)
    yield from _in_the_loop(machine, in_the_loop, 0.1 if smoke else 1.0)
    yield _read_back(in_the_loop)


def _steps(block: ControlBlock, steps: int, runs: int) -> list[dict[str, Any]]:
    coefficients = (block.increment, block.B, block.C, block.D)
    # no arrangement of the realisation avoids these
    floor = 2 * sum(int(np.count_nonzero(part)) for part in coefficients)
    peak = _peak(10 * steps, runs)
    rows = []
    for flags in (["-O2"], ["-O3", "-march=native"]):
        dense = _timed(
            _dense_files(block.system),
            flags,
            "dense.h",
            "",
            "dense_step(noise[k % 1024], u);",
            "double",
            steps,
            runs,
        )
        for arithmetic, real in _REAL.items():
            setup, call = (
                "static rig_block block; rig_init(&block);",
                "(void)rig_step(&block, noise[k % 1024], 0, u);",
            )
            ours = _timed(
                generate(block, arithmetic), flags, "rig.h", setup, call, real, steps, runs
            )
            text = (
                f"floor {floor} flops: {floor / peak * 1e9:.3g} ns at the {peak / 1e9:.3g} Gflop/s "
                "measured without vectors"
            )
            rows.append(
                {
                    "name": f"C step, {block.n_states} states 4 x 4, {arithmetic}, gcc "
                    f"{' '.join(flags)}",
                    "ours": ours,
                    "peer": dense,
                    "peer_name": "dense loops in C, double, no limits or checks",
                    "error": text,
                    "target": "faster than dense",
                }
            )
    return rows


def _scheduled_steps(machine: Machine, steps: int, runs: int) -> list[dict[str, Any]]:
    """A controller scheduled over pressure, and the same with a fixed one beside it, against the
    schedule frozen at the nominal pressure.
    """
    made = design(assemble(machine), "lpv", pressures=(0.0, 4.08e5), rate=1e4)
    frozen = build_block(deploy(made.controller, 1e-4, 1e-4, force=True), "rig", 0.5e-3, 4.0)
    block = build_scheduled_block(
        deploy_scheduled(made, 1e-4, 1e-4, force=True), "rig", 0.5e-3, 4.0
    )
    law = tuned(machine, rate=1e4, order=12).controller
    fixed = build_block(deploy(law, 1e-4, 1e-4, force=True), "rig", 0.5e-3, 4.0)
    beside = supervise(
        block, fixed, Limits(0.0, 4.08e5, 2e4, rate=80e5, noise=4e3, stuck=0.01, band=4e4)
    )
    setup, rows = "static rig_block block; rig_init(&block);", []
    for flags in (["-O2"], ["-O3", "-march=native"]):
        call = "(void)rig_step(&block, noise[k % 1024], 0, 1e5 + 100.0 * (k % 1024), u);"
        ours = _timed(generate(block), flags, "rig.h", setup, call, "double", steps, runs)
        plain = "(void)rig_step(&block, noise[k % 1024], 0, u);"
        peer = _timed(generate(frozen), flags, "rig.h", setup, plain, "double", steps, runs)
        ranks = " and ".join(map(str, block.changes.ranks))
        rows.append(
            {
                "name": f"C step scheduled over pressure, {block.n_states} states 4 x 4, double, "
                f"gcc {' '.join(flags)}",
                "ours": ours,
                "peer": peer,
                "peer_name": "the same controller frozen",
                "error": f"changes of rank {ranks}",
                "target": "below twice the peer",
            }
        )
        call = (
            "(void)rig_step(&block, noise[k % 1024], 0, 1e5 + 100.0 * (k % 1024 < 512 ? k % 1024 : "
            "1023 - k % 1024), 0, -1, u);"
        )
        both = _timed(generate(beside), flags, "rig.h", setup, call, "double", steps, runs)
        alone = _timed(generate(fixed), flags, "rig.h", setup, plain, "double", steps, runs)
        times = (
            f"{both / ours:.2f} times the schedule, {both / alone:.2f} times the fixed one alone "
            f"({1e9 * alone:.0f} ns)"
        )
        rows.append(
            {
                "name": f"C step of that schedule with a fixed one of {fixed.n_states} states "
                f"beside it, gcc {' '.join(flags)}",
                "ours": both,
                "peer": peer,
                "peer_name": "the schedule frozen",
                "error": times,
                "target": "below 3 times the peer",
            }
        )
    return rows


def _dense_files(K: StateSpace) -> dict[str, str]:
    def table(name: str, x: np.ndarray) -> str:
        rows = ",\n".join("{" + ", ".join(f"{v:.17g}" for v in row) + "}" for row in x)
        return f"static const double {name}[{x.shape[0]}][{x.shape[1]}] = {{{rows}}};\n"

    # a dense state matrix, as c2d of a controller in the coordinates of its synthesis has it
    Q = np.linalg.qr(np.random.default_rng(0).normal(0, 1, K.A.shape))[0]
    tables = [
        table("A", Q @ K.A @ Q.T),
        table("B", Q @ K.B),
        table("C", K.C @ Q.T),
        table("D", K.D),
    ]
    return {"dense.h": f"#define N {K.n_states}\n" + "".join(tables) + _DENSE}


def _timed(
    files: dict[str, str],
    flags: list[str],
    include: str,
    setup: str,
    call: str,
    real: str,
    steps: int,
    runs: int,
) -> float:
    """Least CPU seconds of a step over some runs of so many steps."""
    timer = _TIMER.replace("INCLUDE", include).replace("SETUP", setup).replace("CALL", call)
    timer = timer.replace("REAL", real).replace("STEPS", str(steps))
    with tempfile.TemporaryDirectory() as folder:
        for name, text in {**files, "timer.c": timer}.items():
            (Path(folder) / name).write_text(text)
        sources = [
            name
            for name in (*files, "timer.c")
            if name.endswith(".c") and not name.endswith("_test.c")
        ]
        subprocess.run(["gcc", "-std=c11", *flags, *sources, "-o", "timer"], cwd=folder, check=True)
        found = [
            subprocess.run([f"{folder}/timer"], capture_output=True, text=True, check=True).stdout
            for _ in range(runs)
        ]
    return min(float(text.split()[0]) for text in found)


def _peak(steps: int, runs: int) -> float:
    """Scalar multiply-adds a second of this processor with gcc -O2: eight independent chains, two
    flops each.
    """
    chains = "".join(f"static double x{i} = {i}.5;" for i in range(8))
    code = _TIMER.replace('#include "INCLUDE"', chains).replace(
        "SETUP",
        "u[0] = 0; double "
        + ", ".join(f"a{i} = x{i}" for i in range(8))
        + ", f = 1.0 - 1e-9, g = noise[0][0] + 1e-9;",
    )
    code = code.replace("CALL", "".join(f"a{i} = a{i} * f + g;" for i in range(8)))
    code = code.replace("sum += u[0];", "").replace(
        "(double)sum", "(double)sum + " + "+".join(f"a{i}" for i in range(8))
    )
    code = code.replace("REAL", "double").replace("STEPS", str(steps))
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "peak.c").write_text(code)
        subprocess.run(["gcc", "-std=c11", "-O2", "peak.c", "-o", "peak"], cwd=folder, check=True)
        found = [
            subprocess.run([f"{folder}/peak"], capture_output=True, text=True, check=True).stdout
            for _ in range(runs)
        ]
    return 16 / min(float(text.split()[0]) for text in found)


def _generation(block: ControlBlock, runs: int) -> dict[str, Any]:
    generate(block)  # the templating engine is imported once
    found = []
    for _ in range(runs):
        start = _cpu()
        files = generate(block, "fixed32")
        found.append(_cpu() - start)
    return {
        "name": "code generation: 5 files, fixed point",
        "ours": min(found),
        "peer": None,
        "peer_name": "",
        "error": f"{sum(len(text) for text in files.values()) / 1024:.0f} KiB",
        "target": "< 1 s",
    }


def _other_targets(deployment: Deployment, block: ControlBlock, runs: int) -> list[dict[str, Any]]:
    """CPU seconds of writing the other targets; the FMUs' includes the compiler's."""
    file = Synthesis(
        deployment.source, "mu", provenance=Provenance(date="2026-01-01T00:00:00+00:00")
    )
    targets = {
        "MAT-file, script, vectors": lambda: generate_mat(block, deployment, file),
        "structured text, test program, vectors": lambda: generate_structured_text(block),
        "FMI 2.0 and 3.0, sources only": lambda: generate_fmus(block, sources_only=True),
        "FMI 2.0 and 3.0, compiled": lambda: generate_fmus(block),
    }
    rows = []
    for name, write in targets.items():
        write()
        found = []
        for _ in range(runs):
            start = _cpu()
            files = write()
            found.append(_cpu() - start)
        size = sum(len(content) for content in files.values()) / 1024
        row = {
            "name": f"generation: {name}",
            "ours": min(found),
            "peer": None,
            "peer_name": "",
            "error": f"{size:.0f} KiB",
        }
        rows.append({**row, "target": "< 1 s"})
    return rows


def _cpu() -> float:
    """Seconds of this process and of the compilers it ran."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(part.ru_utime + part.ru_stime for part in used)


def _precision(block: ControlBlock, samples: int) -> dict[str, Any]:
    """Compiled single precision and fixed point against compiled double precision, relative to the
    current limit.
    """
    rng = np.random.default_rng(0)
    fixed = in_words(block)
    one = 1 << fixed.signal_bits
    whole = np.round(rng.uniform(-1, 1, (samples, 4)) * 0.02 * one).astype(np.int64)
    e = (whole / one * block.error_limit).astype(np.float32).astype(float)
    limit = block.current_limit
    off = np.abs(_played(block, "float", e) - _played(block, "double", e)).max() / limit.max()
    exact = _played(block, "double", whole / one * block.error_limit)
    start = _cpu()
    words = _played(block, "fixed32", whole)
    seconds = _cpu() - start
    fixed_off = np.abs(words / one * limit - exact).max() / limit.max()
    return {
        "name": f"rounding in C over {samples} samples, parts of the current limit",
        "ours": seconds,
        "peer": None,
        "peer_name": "double",
        "error": f"float {off:.2g}, fixed32 {fixed_off:.2g} (bound "
        f"{(fixed.error / limit).max():.2g})",
        "target": "",
    }


def _played(block: ControlBlock, arithmetic: Arithmetic, errors: np.ndarray) -> np.ndarray:
    """Currents (k, p) of the compiled block over errors (k, m), called from Python."""
    kind = {"double": np.float64, "float": np.float32, "fixed32": np.int32}[arithmetic]
    with tempfile.TemporaryDirectory() as folder:
        for name, text in generate(block, arithmetic).items():
            (Path(folder) / name).write_text(text)
        library = f"{folder}/{block.name}.so"
        command = [
            "gcc",
            "-std=c99",
            "-O2",
            "-shared",
            "-fPIC",
            f"{folder}/{block.name}.c",
            "-o",
            library,
        ]
        subprocess.run(command, check=True)
        loaded = ctypes.CDLL(library)
    step = getattr(loaded, f"{block.name}_step")
    state = ctypes.create_string_buffer(16 * (block.n_states + 32))  # zero is the block after init
    given, current = errors.astype(kind), np.empty((len(errors), len(block.outputs)), kind)
    for e, u in zip(given, current, strict=True):
        step(state, ctypes.c_void_p(e.ctypes.data), None, ctypes.c_void_p(u.ctypes.data))
    return current.astype(float)


def _in_the_loop(machine: Machine, block: ControlBlock, length: float) -> list[dict[str, Any]]:
    """Seconds of one simulated second on the nonlinear rig under a pulse, from C and from the law
    compiled into the rig.
    """
    scenario = replace(load_scenario("impulse-parallel"), duration=length)
    names = [f"y_{axis}" for axis in machine.axes]
    law, trace = _run(machine, block.system, scenario)
    meant = trace.record.select(names).values
    rows = []
    for arithmetic in _REAL:
        code, trace = _run(machine, CompiledBlock(block, arithmetic), scenario)
        apart = float(np.abs(trace.record.select(names).values - meant).max())
        accuracy = (
            f"{1 / code:.3g} s/s, law {1 / law:.3g} s/s; {apart:.2g} m apart of "
            f"{np.abs(meant).max():.2g} m"
        )
        rows.append(
            {
                "name": f"software in the loop: {length:g} s of the rig, {block.n_states} states, "
                f"{arithmetic}",
                "ours": code,
                "peer": law,
                "peer_name": "the law, compiled with the rig",
                "error": accuracy,
                "target": "as the law",
            }
        )
    return rows


def _run(machine: Machine, controller: Any, scenario: Scenario) -> tuple[float, Trace]:
    """Least seconds of three runs after a first per simulated second, without the start, and the
    last trace.
    """
    traces = [virtual_rig.run(machine, controller, scenario) for _ in range(4)]
    return min(trace.run_time for trace in traces[1:]) / scenario.duration, traces[-1]


def _read_back(block: ControlBlock) -> dict[str, Any]:
    """CPU seconds of compiling the block and reading its law back out of the running code; how far
    it is from the design's.
    """
    apart, found = {}, []
    for arithmetic in _REAL:
        begin = _cpu()
        law = read_law(CompiledBlock(block, arithmetic))
        found.append(_cpu() - begin)
        pairs = [(getattr(law, letter), getattr(block.system, letter)) for letter in "ABCD"]
        apart[arithmetic] = max(float(np.abs(a - b).max() / np.abs(b).max()) for a, b in pairs)
    return {
        "name": f"compiled, and the law of {block.n_states} states read back out of the running "
        "code",
        "ours": found[0],
        "peer": None,
        "peer_name": "",
        "error": ", ".join(f"{name} {value:.2g}" for name, value in apart.items())
        + " of each matrix's largest entry",
        "target": "",
    }
