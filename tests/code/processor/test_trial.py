"""The exported code on other processors, in QEMU: bit for bit as here, and what is refused."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ambrose.cli import main
from ambrose.code import processor_build as link, processor_build as machines
from ambrose.code.c.code import generate
from ambrose.code.processor_build import (
    PROCESSORS,
    Link,
    Program,
    Unwalked,
    build,
    listed,
    unit_of,
    written_below,
)
from ambrose.code.processor_trial import check_room, stimulus, try_unit
from ambrose.code.targets import PROCESSORS as OFFERED, C
from ambrose.core.checks import InvalidInput
from ambrose.judge.controller_file import write_controller
from example_blocks import rig_block, small_block, small_controller
from needs import needs

sys.path.append(str(Path(__file__).parents[1] / "c"))
from test_run import base_of, unit_of as beside_of

M7, BIG = "cortex-m7", "cortex-r5-big-endian"
LAWS = {
    "fixed": rig_block,
    "cascade": lambda: base_of("cascade"),
    "scheduled": lambda: base_of("scheduled"),
    "supervised": lambda: base_of("supervised"),
    "synchronous": lambda: beside_of("fixed"),
    "synchronous beside a fallback": lambda: beside_of("supervised"),
}
FIXED_POINT = ("fixed", "cascade", "synchronous")


def every():
    """Law, number type and processor; what is no slow one is not among the campaigns."""
    for law in LAWS:
        for arithmetic in ("double", "float", *(("fixed32",) if law in FIXED_POINT else ())):
            for name in PROCESSORS:
                quick = (law, arithmetic, name) in {
                    ("fixed", "float", M7),
                    ("fixed", "double", BIG),
                }
                # of the others the double is what the float is, with other words
                rare = name != M7 or (law != "fixed" and arithmetic == "double")
                marks = [needs(name)]
                marks += [pytest.mark.study] if rare and not quick else []
                yield pytest.param(law, arithmetic, name, marks=marks)


@pytest.mark.parametrize(("law", "arithmetic", "name"), list(every()))
def test_the_currents_are_those_of_this_computer_to_the_last_bit(law, arithmetic, name):
    unit = unit_of(LAWS[law](), arithmetic)
    rows = stimulus(unit, 600)
    trial = try_unit(unit, PROCESSORS[name], clock=480e6, samples=rows, contraction=False)
    assert trial.problems == ()
    assert trial.equal
    assert trial.self_test
    assert trial.found == trial.meant
    assert trial.apart.max() == 0
    # what is stated covers what was written, and no function on a path is unknown
    assert trial.footprint.outside == ()
    assert 8 <= trial.written <= trial.footprint.stack
    assert 100 < trial.instructions.min() <= trial.instructions.max() < 60_000


@cache
def counted(name, arithmetic):
    unit = unit_of(small_block(), arithmetic)
    return try_unit(unit, PROCESSORS[name], samples=stimulus(unit, 64), contraction=False)


@needs("cortex-m4")
def test_double_precision_in_software_costs_more_than_single_in_hardware():
    double, single = (counted("cortex-m4", kind).instructions.max() for kind in ("double", "float"))
    assert double > 5 * single
    assert counted("cortex-m4", "double").footprint.library > 500
    assert counted("cortex-m4", "float").footprint.library == 0


@needs("cortex-m4")
def test_the_stack_is_the_same_by_frames_by_instructions_and_by_what_is_written(tmp_path):
    """Calls into the compiler's library among them: three ways that share nothing."""
    unit, m4 = unit_of(small_block(), "double"), PROCESSORS["cortex-m4"]
    program = build(unit, m4, tmp_path)
    with Link(unit, m4, program) as link:
        written = link.steps(stimulus(unit, 64))["stack"].max()
    listing = [m4.tool("objdump"), "-d", "--no-show-raw-insn", program.path]
    code = listed(subprocess.run(listing, capture_output=True, text=True, check=True).stdout)
    assert program.footprint.library > 0
    assert program.footprint.outside == ()
    assert program.footprint.stack == written == written_below(code, program.symbols[unit.step])


def lines(text):
    """A listing of two bytes per instruction, from address 16 on."""
    return listed("\n".join(f"{16 + 2 * i:x}:\t{line}" for i, line in enumerate(text.split("; "))))


@pytest.mark.parametrize(
    ("text", "deep"),
    [
        ("bx lr", 0),
        ("push\t{r4, r5, lr}; vpush\t{d8-d9}; sub\tsp, #8; add\tsp, #8; pop\t{pc}", 36),
        # a conditional branch around a push: the deeper path
        ("cbz\tr0, 14 <f>; push\t{r4}; pop\t{r4}; bx\tlr", 4),
        # a call below what is pushed, of a function that pushes 12
        ("push\t{r4, lr}; bl\t16 <g>; pop\t{r4, pc}; push\t{r4-r6}; pop\t{r4-r6}; bx\tlr", 20),
        # a jump into another function: below what is left
        ("push\t{r4}; pop\t{r4}; b.w\t16 <g>; str.w\tlr, [sp, #-8]!; ldr.w\tpc, [sp], #8", 8),
        # a conditional return does not end the path
        ("push\t{r4, lr}; popeq\t{r4, pc}; push\t{r5}; pop\t{r5}; pop\t{r4, pc}", 12),
    ],
)
def test_what_instructions_push(text, deep):
    assert written_below(lines(text), 16) == deep


@pytest.mark.parametrize(
    "text",
    [
        "bx\tr3",
        "blx\tr3",
        "mov\tsp, r7; bx\tlr",
        "tbb\t[pc, r0]",
        "bl\t10 <f>; bx\tlr",
        "push\t{r4}; b.n\t10 <f>",
        "nop",
    ],
)
def test_what_cannot_be_followed_is_no_bound(text):
    with pytest.raises(Unwalked):
        written_below(lines(text), 16)


@needs(M7)
def test_a_changed_table_or_another_law_is_seen(tmp_path):
    """The trial can fail: one digit of one number, in what runs there alone."""
    unit = unit_of(small_block(), "float")
    source = unit.files["small.c"]
    place = source.index("from_error")
    changed = source[:place] + re.sub(r"\d(?=\.\d{3})", "9", source[place:], count=1)
    assert changed != source
    other = replace(unit, files={**unit.files, "small.c": changed})
    rows = stimulus(unit, 40)
    answers = []
    for which, label in ((unit, "as written"), (other, "changed")):
        program = build(which, PROCESSORS[M7], tmp_path / label)
        with Link(which, PROCESSORS[M7], program) as link:
            passed = link.self_test()
            link.begin()
            answers.append((passed, link.steps(rows)["current"], link.checksum()[:2]))
    assert answers[0][0]
    assert not answers[1][0]
    assert answers[0][2][0] == answers[0][2][1]
    assert answers[1][2][0] != answers[1][2][1]
    assert not np.array_equal(answers[0][1], answers[1][1])


def scaled(system, factor):
    """The system with its outputs scaled."""
    return replace(system, C=factor * system.C, D=factor * system.D)


def crc(content):
    """CRC-32 of IEEE 802.3, bit by bit."""
    value = 0xFFFFFFFF
    for octet in content:
        value ^= octet
        for _ in range(8):
            value = value >> 1 ^ (0xEDB88320 if value & 1 else 0)
    return value ^ 0xFFFFFFFF


def test_the_checksum_is_that_of_the_block_s_numbers():
    assert crc(b"123456789") == 0xCBF43926  # the check value of the standard
    files = generate(small_block())
    meant = int(re.search(r"SMALL_CHECKSUM 0x([0-9A-F]{8})u", files["small.h"])[1], 16)
    # all that stands, comments aside, between "static const real name[..] = {" and "};", as doubles one by one
    numbers = [
        float(number)
        for table in re.sub(r"/\*.*?\*/", "", files["small.c"]).split("static const real ")[1:]
        for number in re.sub(r"[{},]", " ", table.split("=", 1)[1].split("};")[0]).split()
    ]
    assert len(numbers) == 42
    assert crc(np.array(numbers, "<f8").tobytes()) == meant


def test_the_identity_follows_the_numbers_and_nothing_else():
    one, same, other = (
        re.search(r'IDENTITY "(\S+ [0-9a-f]{16} ambrose \S+)"', generate(*given)["small.h"])[1]
        for given in (
            (small_block(),),
            (small_block(), "double", ["another header"]),
            (small_block(system=scaled(small_controller(), 1.01)),),
        )
    )
    assert one == same != other


def test_the_processors_of_the_command_are_those_described():
    assert OFFERED == tuple(PROCESSORS)


@pytest.fixture
def fake(tmp_path, monkeypatch):
    """A path on which alone these programs are: shell scripts."""

    def made(**programs):
        folder = tmp_path / "bin"
        folder.mkdir()
        for name, script in programs.items():
            (folder / name.replace("_", "-")).write_text(f"#!/bin/sh\n{script}\n")
            (folder / name.replace("_", "-")).chmod(0o755)
        monkeypatch.setenv("PATH", str(folder))
        machines.mantissa.cache_clear()

    yield made
    machines.mantissa.cache_clear()


COMPILER, QEMU = "arm_none_eabi_gcc", "qemu_system_arm"
SHORT = "echo '#define __DBL_MANT_DIG__ 24'"


@pytest.mark.parametrize(
    ("programs", "arithmetic", "said"),
    [
        ({}, "float", "cortex-m7 needs arm-none-eabi-gcc, which is not on this computer; install"),
        ({COMPILER: SHORT}, "float", "cortex-m7 needs qemu-system-arm, which is not on this"),
        ({COMPILER: SHORT, QEMU: ""}, "double", "cortex-m7 has no double precision: arm-none"),
        ({COMPILER: "exit 1", QEMU: ""}, "float", "arm-none-eabi-gcc does not answer"),
        ({COMPILER: SHORT, QEMU: ""}, "float", "a trial compares with this computer, which has"),
    ],
)
def test_what_is_not_there_is_refused_before_anything_is_computed(
    fake, tmp_path, programs, arithmetic, said
):
    path = write_controller(tmp_path / "small.json", small_controller())
    fake(**programs)
    words = ["export", path, "--to", "c", "-o", tmp_path / "code", "--try-on", M7]
    words += ["--arithmetic", arithmetic, "--error-limit", "1e-3", "--current-limit", "2"]
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == 2
    assert said in result.stderr
    assert result.stderr.count("\n") == 1
    assert not (tmp_path / "code").exists()


@needs(M7)
@pytest.mark.parametrize(
    ("room", "what"), [({"flash": 500.0}, "flash"), ({"memory": 80.0}, "memory")]
)
def test_code_that_is_larger_than_what_there_is_is_refused(room, what):
    with pytest.raises(InvalidInput, match=rf"needs \d+ bytes of {what} on cortex-m7, but only"):
        check_room(unit_of(small_block(), "float"), PROCESSORS[M7], **room)


def test_what_goes_with_a_processor_is_refused_without_one(tmp_path):
    path = write_controller(tmp_path / "small.json", small_controller())
    words = ["export", str(path), "--to", "c", "-o", str(tmp_path / "code"), "--clock", "480MHz"]
    words += ["--error-limit", "1e-3", "--current-limit", "2"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 2
    assert "name a processor" in result.stderr
    with pytest.raises(InvalidInput, match="try_on"):
        C(try_on="cortex-m9")


@needs(M7)
def test_the_command_tries_what_it_writes(tmp_path):
    path = write_controller(tmp_path / "small.json", small_controller())
    words = ["export", path, "--to", "c", "-o", tmp_path / "code", "--name", "small", "--force"]
    words += ["--error-limit", "1e-3", "--current-limit", "2", "--try-on", M7]
    words += ["--clock", "480MHz", "--flash", "65536", "--ram", "8192"]
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == 1  # forced
    assert re.search(
        r"cortex-m7: currents equal to the last bit; uses [\d.]+ % of 100 us at 480", result.stderr
    )
    page = (tmp_path / "code" / "small_cortex-m7.md").read_text()
    assert "| self-test on the target | passed |" in page
    assert "with contraction of multiply and add" in page


@pytest.mark.parametrize("said", ["", "printf '\\004\\003\\002\\001aaaa'; "])
def test_an_emulator_that_hangs_is_ended(tmp_path, monkeypatch, said):
    """Before its first word or after; it was waited for without an end."""
    monkeypatch.setattr(link, "_PATIENCE", 0.2)
    monkeypatch.setattr(link, "_LOOK", 0.01)
    words = ("sh", "-c", f"{said}exec sleep 3600", "{program}")
    m7 = replace(PROCESSORS[M7], emulator=words, kind="linux")
    program = Program(tmp_path / "program", None, {})
    unit = unit_of(small_block(), "float")
    late = pytest.raises(InvalidInput, match=r"did not answer within 0\.2 s and was ended")
    if said:
        with Link(unit, m7, program) as running, late:
            running.self_test()
    else:
        with late:
            Link(unit, m7, program)


def test_a_program_that_does_not_tell_its_version_is_named(tmp_path, monkeypatch):
    path = tmp_path / "quiet"
    path.write_text("#!/bin/sh\nexec sleep 3600\n")
    path.chmod(0o755)
    monkeypatch.setattr(machines, "_PROBE_TIME", 0.1)
    for command in (str(path), str(tmp_path / "absent")):
        with pytest.raises(InvalidInput, match="does not answer"):
            machines.version_of(command)
