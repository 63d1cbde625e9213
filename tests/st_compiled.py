"""Structured text through MATIEC's iec2c (a compiler that is not ours) to C, and that run over a
file of samples.

MATIEC is no package: build it from its repository and set MATIEC to the folder with iec2c and lib/.
"""

import subprocess
from pathlib import Path

import numpy as np

from ambrose.code.block.block import ControlBlock
from needs import MATIEC, STRUCPP

_CONFIGURATION = """
CONFIGURATION config
RESOURCE res ON plc
TASK cyclic(INTERVAL := T#1ms, PRIORITY := 0);
PROGRAM main WITH cyclic : NAME_test;
END_RESOURCE
END_CONFIGURATION
"""
_HEAD = """
#include <stdio.h>
#include "iec_std_lib.h"
#include "accessor.h"
TIME __CURRENT_TIME;
BOOL __DEBUG;
#include "POUS.h"
#include "POUS.c"
"""


def translated(files: dict[str, str], name: str, folder: Path) -> None:
    """The C of the function block and its test program in ``folder``; the compiler's complaints are
    the test's failure.
    """
    source = folder / "all.st"
    source.write_text(
        files[f"{name}.st"] + files[f"{name}_test.st"] + _CONFIGURATION.replace("NAME", name)
    )
    done = subprocess.run(
        [str(MATIEC / "iec2c"), "-I", str(MATIEC / "lib"), "-T", str(folder), str(source)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def selftest(name: str, folder: Path) -> tuple[int, int, bool]:
    """Samples, wrong ones, done: what the test program has after 100 cycles."""
    upper = name.upper()
    code = f"""{_HEAD}
int main(void)
{{
    static {upper}_TEST test;
    int k;
    {upper}_TEST_init__(&test, 0);
    for (k = 0; k < 100; k++)
        {upper}_TEST_body__(&test);
    printf("%d %d %d", test.SAMPLE.value, test.WRONG.value, test.DONE.value);
    return 0;
}}
"""
    samples, wrong, done = _run(code, folder, b"").decode().split()
    return int(samples), int(wrong), bool(int(done))


def replay(
    block: ControlBlock,
    folder: Path,
    errors: np.ndarray,
    valid: np.ndarray,
    kind: str = "double",
    track: np.ndarray | None = None,
    given: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Currents (k, p) and status (k,) of the function block over errors (k, m)."""
    m = len(block.inputs)
    p = len(block.outputs)
    upper = block.name.upper()
    sets = [
        f"fb.{s.upper()}.value = r.e[{j}]; fb.VALID_{s.upper()}.value = r.valid[{j}];"
        for j, s in enumerate(block.inputs)
    ]
    if track is not None:
        sets += [
            "fb.TRACK.value = r.track;",
            *(f"fb.GIVEN_{s.upper()}.value = r.u[{i}];" for i, s in enumerate(block.outputs)),
        ]
    gets = [f"r.u[{i}] = fb.{s.upper()}.value;" for i, s in enumerate(block.outputs)]
    code = f"""{_HEAD}
#pragma pack(push, 1)
typedef struct {{ {kind} e[{m}]; {kind} u[{p}]; unsigned char valid[{m}]; unsigned char track; }} row;
#pragma pack(pop)
int main(void)
{{
    static {upper} fb;
    row r;
    unsigned status;
    {upper}_init__(&fb, 0);
    while (fread(&r, sizeof r, 1, stdin) == 1) {{
        {" ".join(sets)}
        {upper}_body__(&fb);
        {" ".join(gets)}
        status = fb.HELD.value + 2 * fb.FAULT.value + 4 * fb.LIMITED.value;
        fwrite(r.u, sizeof r.u, 1, stdout);
        fwrite(&status, sizeof status, 1, stdout);
    }}
    return 0;
}}
"""
    number = np.float64 if kind == "double" else np.float32
    rows = np.zeros(
        len(errors), [("e", number, m), ("u", number, p), ("valid", "u1", m), ("track", "u1")]
    )
    with np.errstate(over="ignore", invalid="ignore"):
        rows["e"] = errors
    rows["valid"] = valid
    rows["track"] = 0 if track is None else track
    rows["u"] = 0 if given is None else given
    found = np.frombuffer(_run(code, folder, rows.tobytes()), [("u", number, p), ("status", "u4")])
    assert len(found) == len(errors)
    return found["u"].astype(float), found["status"]


def _run(code: str, folder: Path, given: bytes) -> bytes:
    (folder / "driver.c").write_text(code)
    build = ["gcc", "-w", "-O1", "-I", str(MATIEC / "lib" / "C"), "driver.c", "-o", "driver", "-lm"]
    done = subprocess.run(build, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return subprocess.run(
        [str(folder / "driver")], input=given, capture_output=True, check=True, timeout=120
    ).stdout


def replay_strucpp(
    files: dict[str, str], block: ControlBlock, folder: Path, errors: np.ndarray, valid: np.ndarray
) -> tuple[np.ndarray, np.ndarray, tuple[int, int, bool]]:
    """Through STruC++ to C++17: currents (k, p), status (k,), and what the test program has after
    100 cycles.
    """
    m = len(block.inputs)
    p = len(block.outputs)
    name = block.name
    (folder / "all.st").write_text(files[f"{name}.st"] + files[f"{name}_test.st"])
    translate = ["node", str(STRUCPP / "dist/node/cli.js"), "all.st", "-o", "all.cpp"]
    done = subprocess.run(
        translate, cwd=folder, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 0, done.stdout + done.stderr
    sets = [
        f"fb.{s.upper()} = r.e[{j}]; fb.VALID_{s.upper()} = r.valid[{j}] != 0;"
        for j, s in enumerate(block.inputs)
    ]
    gets = [f"r.u[{i}] = static_cast<double>(fb.{s.upper()});" for i, s in enumerate(block.outputs)]
    (folder / "main.cpp").write_text(f"""#include <cstdio>
#include "all.hpp"
using namespace strucpp;
#pragma pack(push, 1)
struct row {{ double e[{m}], u[{p}]; unsigned char valid[{m}]; }};
#pragma pack(pop)
int main()
{{
    static {name.upper()} fb;
    static Program_{name.upper()}_TEST test;
    row r;
    for (int k = 0; k < 100; k++)
        test.run();
    unsigned found[3] = {{static_cast<unsigned>(int(test.SAMPLE)), static_cast<unsigned>(int(test.WRONG)), bool(test.DONE)}};
    std::fwrite(found, sizeof found, 1, stdout);
    while (std::fread(&r, sizeof r, 1, stdin) == 1) {{
        {" ".join(sets)}
        fb();
        {" ".join(gets)}
        unsigned status = (bool(fb.HELD) ? 1u : 0u) + (bool(fb.FAULT) ? 2u : 0u) + (bool(fb.LIMITED) ? 4u : 0u);
        std::fwrite(r.u, sizeof r.u, 1, stdout);
        std::fwrite(&status, sizeof status, 1, stdout);
    }}
}}
""")
    include = str(STRUCPP / "src/runtime/include")
    build = ["g++", "-std=c++17", "-w", "-O1", "-I", include, "main.cpp", "all.cpp", "-o", "driver"]
    done = subprocess.run(build, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    rows = np.zeros(len(errors), [("e", float, m), ("u", float, p), ("valid", "u1", m)])
    rows["e"], rows["valid"] = errors, valid
    out = subprocess.run(
        [str(folder / "driver")], input=rows.tobytes(), capture_output=True, check=True, timeout=120
    ).stdout
    samples, wrong, finished = np.frombuffer(out[:12], "u4").tolist()
    found = np.frombuffer(out[12:], [("u", float, p), ("status", "u4")])
    assert len(found) == len(errors)
    return found["u"], found["status"], (samples, wrong, bool(finished))
