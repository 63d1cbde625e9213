"""The example without an operating system: built without a warning, run on QEMU's MPS2 board; what it
sets is what the code gives here.
"""

from __future__ import annotations

import re
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest

from ambrose.code.block.block import render
from ambrose.code.block.scheduled import SupervisedBlock
from ambrose.code.processor_build import (
    PROCESSORS,
    SAMPLES,
    Link,
    bare_metal_files,
    build,
    host,
    unit_of,
)
from ambrose.code.targets import C
from example_blocks import rig_block, small_block
from needs import needs

sys.path.append(str(Path(__file__).parent))
from test_trial import LAWS, M7

WARNINGS = ("-Wall", "-Wextra", "-Wconversion", "-Wfloat-equal", "-Wshadow", "-Werror")


def run(law, arithmetic, folder, *more, changed=()):
    """What the example says on the board."""
    folder.mkdir(exist_ok=True)
    unit, m7 = unit_of(law, arithmetic), PROCESSORS[M7]
    # no C library is needed; what of one a compiler asks for by itself stands beside it
    beside = {name: render(f"target/{name}.j2", {}) for name in ("limits.h", "memory.c")}
    files = {**unit.files, **bare_metal_files(law, arithmetic), **beside, **dict(changed)}
    for name, text in files.items():
        (folder / name).write_text(text)
    name = unit.base.name
    sources = [*unit.interface.sources, f"{name}_main.c", f"{name}_board_mps2.c", "memory.c"]
    command = [m7.compiler, *m7.flags, "-std=c99", "-O2", "-ffp-contract=off", *WARNINGS, "-I."]
    command += ["-ffreestanding", "-fno-tree-loop-distribute-patterns", "-nostdlib", *more]
    command += ["-T", f"{name}_mps2.ld", *sources, "-lgcc", "-o", "example.elf"]
    built = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    # as the file says
    said = (folder / f"{name}_board_mps2.c").read_text()
    words = re.search(r"(qemu-system-arm .*) -nographic (.*) -kernel", said)
    command = f"{words[1]} {words[2]}".split()
    command += ["-display", "none", "-monitor", "none", "-serial", "stdio"]
    ran = subprocess.run(
        [*command, "-kernel", "example.elf"],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        stdin=subprocess.DEVNULL,
    )
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.strip()


def readings(unit):
    """The triangles of the board, in this computer's words."""
    rows = np.zeros(SAMPLES, unit.given("="))
    at = np.arange(1, SAMPLES + 1)[:, None] * (np.arange(len(unit.base.inputs)) + 3) % 400
    height = np.where(at < 100, at, np.where(at < 300, 200 - at, at - 400))
    amplitude = unit.counts(unit.base.error_limit / 800, unit.metre)
    rows["error"] = amplitude * height.astype(amplitude.dtype)
    rows["valid"] = 1
    if unit.base.told:
        rows[unit.base.told[0]] = np.mean(unit.base.axes[0])
    if isinstance(unit.base, SupervisedBlock):
        rows["estimate"] = rows["half_width"] = -1
    if unit.law.beside:
        # a pulse once a turn in the middle of the band
        low, high = unit.law.law.blocks[0].band
        turn = round(2 * np.pi / ((low + high) / 2 * unit.base.sample_time))
        rows["pulse"] = np.where(np.arange(1, SAMPLES + 1) % turn == 0, 0, -1)
    return rows


def currents(law, arithmetic, folder, rows=None):
    unit = unit_of(law, arithmetic)
    here = host("cc")
    with Link(unit, here, build(unit, here, folder)) as link:
        return link.steps(readings(unit) if rows is None else rows)["current"]


@needs(M7)
@pytest.mark.parametrize(
    ("law", "arithmetic"),
    [
        pytest.param("fixed", "float", marks=pytest.mark.study),
        pytest.param("fixed", "fixed32", marks=pytest.mark.study),
        ("cascade", "double"),
        ("supervised", "float"),
        pytest.param("synchronous", "double", marks=pytest.mark.study),
        ("synchronous", "fixed32"),
    ],
)
def test_what_the_board_sets_is_what_the_code_gives_here_one_sample_later(
    tmp_path, law, arithmetic
):
    block = LAWS[law]()
    said = run(block, arithmetic, tmp_path / "board")
    # the currents of the last sample are not due any more
    due = currents(block, arithmetic, tmp_path / "host")[:-1]
    if law == "synchronous":  # the block works: without pulses the currents are others
        rows = readings(unit_of(block, arithmetic))
        rows["pulse"] = -1
        assert (currents(block, arithmetic, tmp_path / "still", rows)[:-1] != due).any()
    crc = zlib.crc32(due.tobytes())
    assert said.endswith(f": running, 1000 samples, 0 late, currents set 999 times, crc {crc:x}"), (
        said
    )


@needs(M7)
def test_currents_are_due_as_the_delay_of_the_design_says(tmp_path):
    for delay in (0, 2):
        block = small_block(delay)
        said = run(block, "float", tmp_path / f"board{delay}")
        due = currents(block, "float", tmp_path / f"host{delay}")[: SAMPLES - delay]
        assert f"set {SAMPLES - delay} times, crc {zlib.crc32(due.tobytes()):x}" in said


@needs(M7)
def test_late_work_is_counted_and_held_and_a_hang_ends_in_a_restart_without_currents(tmp_path):
    block = rig_block()
    late = run(block, "float", tmp_path / "late", "-DSLOW_AT=500")
    # sample 500 is worked on until 501 came, which is therefore not: two sets are missing
    rows = np.delete(readings(unit_of(block, "float")), 500)  # 501, counted from one
    due = np.delete(currents(block, "float", tmp_path / "host", rows)[:-1], 499, axis=0)
    assert f"1 late, currents set 997 times, crc {zlib.crc32(due.tobytes()):x}" in late
    hung = run(block, "float", tmp_path / "hung", "-DHANG_AT=500")
    assert hung.startswith("rig: restarted by the watchdog")
    assert "currents set 0 times" in hung


@needs(M7)
def test_changed_tables_are_seen_at_the_start(tmp_path):
    block = small_block()
    source = unit_of(block, "float").files["small.c"]
    place = source.index("from_error")
    other = source[:place] + re.sub(r"\d(?=\.\d{3})", "9", source[place:], count=1)
    assert other != source
    said = run(block, "float", tmp_path, changed={"small.c": other})
    assert said.startswith("small: tables changed")
    assert "currents set 0 times" in said


def test_the_example_is_delivered_where_it_is_asked_for():
    block = small_block()
    names = {"small_main.c", "small_board.h", "small_board_mps2.c", "small_mps2.ld"}
    assert set(bare_metal_files(block, "double")) == names
    plain, more = (set(C(bare_metal=b).files(block, ())) for b in (False, True))
    assert more - plain == names


@needs("cc")
@pytest.mark.parametrize("law", LAWS)
def test_the_part_that_knows_no_hardware_compiles_anywhere(tmp_path, law):
    block = LAWS[law]()
    unit = unit_of(block, "double")
    for name, text in {**unit.files, **bare_metal_files(block, "double")}.items():
        (tmp_path / name).write_text(text)
    command = ["cc", "-std=c99", "-pedantic", *WARNINGS, "-c", f"{unit.base.name}_main.c"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
