"""The processors on which exported code can be tried: how each is compiled for, and what runs it.

All of it is free-standing: no C library of the target is needed, only its compiler. QEMU interprets
the instructions of the processor; its floating-point arithmetic is IEEE 754's, as the processors'
is. It is no model of pipelines, caches and memories: it counts instructions, not cycles.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache

from ambrose.core.checks import InvalidInput, invalid

# nanoseconds of virtual time for an instruction, as a power of two: SysTick's 25 MHz resolve one
COUNT_SHIFT = 8
_PROBE_TIME = 20.0  # s
_CORTEX_M = ("qemu-system-arm", "-display", "none", "-monitor", "none", "-serial", "none")
_SEMIHOSTING = ("-semihosting-config", "enable=on,target=native")


@dataclass(frozen=True, slots=True, kw_only=True)
class Processor:
    """A processor that code can be tried on.

    title: what it is. compiler: command of the cross compiler, flags: what it is told of the
    processor, package: Debian's that holds it. emulator: its command, {program} for the program,
    emulator_package. kind: which start-up code it needs, "cortex-m", "cortex-r", "linux" or "host".
    order: byte order, "<" or ">". double: how it computes in double precision. exception_frame
    [bytes]: what an interrupt puts on the stack by itself. library: the compiler's
    own, as the linker is told.
    """

    name: str
    title: str
    compiler: str
    flags: tuple[str, ...]
    package: str
    emulator: tuple[str, ...]
    emulator_package: str
    kind: str
    order: str = "<"
    double: str = "in hardware"
    exception_frame: int = 0
    library: str = "-lgcc"

    def tool(self, name: str) -> str:
        """A program of the compiler's family, such as ``size``."""
        return self.compiler.removesuffix("gcc") + name

    def check(self, arithmetic: str) -> None:
        """Refuse what cannot be tried here, before anything is computed. Raises InvalidInput."""
        for program, package in (
            (self.compiler, self.package),
            (self.emulator[0] if self.emulator else "", self.emulator_package),
        ):
            if program and not shutil.which(program):
                raise InvalidInput(
                    f"{self.name} needs {program}, which is not on this computer; install it "
                    f"(Debian: apt install {package}), or leave try_on out"
                )
        bits = mantissa(self.compiler, self.flags, "DBL")
        if arithmetic == "double" and bits != 53:
            raise InvalidInput(
                f"{self.name} has no double precision: {self.compiler} gives double {bits} bits of "
                "mantissa; export in float or fixed point (arithmetic)"
            )


@cache
def mantissa(compiler: str, flags: tuple[str, ...], kind: str) -> int:
    """Bits of the mantissa of double ("DBL") or float ("FLT") as a compiler has them. Raises
    InvalidInput for a compiler that does not answer.
    """
    command = [compiler, *flags, "-dM", "-E", "-x", "c", "-"]
    try:
        told = subprocess.run(
            command, input="", capture_output=True, text=True, timeout=_PROBE_TIME, check=True
        ).stdout
    except (OSError, subprocess.SubprocessError) as error:
        raise InvalidInput(
            f"the compiler {compiler} does not answer ({error}); install another one"
        ) from error
    found = re.search(rf"#define __{kind}_MANT_DIG__ (\d+)", told)
    return int(found[1]) if found else 0


def version_of(command: str) -> str:
    """The first line that a program says of its version. Raises InvalidInput for one that does not
    answer.
    """
    try:
        told = subprocess.run(
            [command, "--version"], capture_output=True, text=True, timeout=_PROBE_TIME, check=False
        )
    except (OSError, subprocess.SubprocessError) as error:
        raise InvalidInput(f"{command} does not answer ({error}); install it anew") from error
    return (told.stdout.splitlines() or [command])[0].strip()


_LISTED = (
    Processor(
        name="cortex-m7",
        title="Arm Cortex-M7, floating-point unit for double and single precision",
        compiler="arm-none-eabi-gcc",
        flags=("-mcpu=cortex-m7", "-mthumb", "-mfpu=fpv5-d16", "-mfloat-abi=hard", "-DCORTEX_M"),
        package="gcc-arm-none-eabi",
        emulator=(*_CORTEX_M, *_SEMIHOSTING, "-M", "mps2-an500", "-kernel", "{program}"),
        emulator_package="qemu-system-arm",
        kind="cortex-m",
        exception_frame=108,  # Armv7-M, B1.5.7: eight words, 16 + 1 floating-point registers, align
    ),
    Processor(
        name="cortex-m4",
        title="Arm Cortex-M4, floating-point unit for single precision",
        compiler="arm-none-eabi-gcc",
        flags=("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-DCORTEX_M"),
        package="gcc-arm-none-eabi",
        emulator=(*_CORTEX_M, *_SEMIHOSTING, "-M", "mps2-an386", "-kernel", "{program}"),
        emulator_package="qemu-system-arm",
        kind="cortex-m",
        double="in software",
        exception_frame=108,
    ),
    Processor(
        name="cortex-r5",
        title="Arm Cortex-R5F, floating-point unit for double and single precision",
        compiler="arm-none-eabi-gcc",
        flags=("-mcpu=cortex-r5", "-mthumb", "-mfpu=vfpv3-d16", "-mfloat-abi=hard"),
        package="gcc-arm-none-eabi",
        emulator=(
            *_CORTEX_M,
            *_SEMIHOSTING,
            *("-M", "none", "-cpu", "cortex-r5f", "-m", "16M"),
            *("-device", "loader,file={program},cpu-num=0"),
        ),
        emulator_package="qemu-system-arm",
        kind="cortex-r",
    ),
    Processor(
        name="cortex-r5-big-endian",
        title="Arm Cortex-R5F, most significant byte first",
        compiler="arm-none-eabi-gcc",
        flags=("-mcpu=cortex-r5", "-mthumb", "-mfpu=vfpv3-d16", "-mfloat-abi=hard", "-mbig-endian"),
        package="gcc-arm-none-eabi",
        emulator=("qemu-armeb", "-cpu", "cortex-r5f", "{program}"),
        emulator_package="qemu-user",
        kind="linux",
        order=">",
        library="",
    ),
    Processor(
        name="aarch64",
        title="Arm 64 bit, Cortex-A53",
        compiler="aarch64-linux-gnu-gcc",
        flags=("-mcpu=cortex-a53",),
        package="gcc-aarch64-linux-gnu",
        emulator=("qemu-aarch64", "{program}"),
        emulator_package="qemu-user",
        kind="linux",
    ),
    Processor(
        name="riscv64",
        title="RISC-V 64 bit, RV64GC",
        compiler="riscv64-linux-gnu-gcc",
        flags=("-march=rv64gc", "-mabi=lp64d", "-mno-relax"),
        package="gcc-riscv64-linux-gnu",
        emulator=("qemu-riscv64", "{program}"),
        emulator_package="qemu-user",
        kind="linux",
    ),
    Processor(
        name="ppc64",
        title="PowerPC 64 bit, most significant byte first",
        compiler="powerpc64-linux-gnu-gcc",
        flags=("-mcpu=power7", "-mno-vsx", "-mno-altivec", "-mabi=elfv2"),
        package="gcc-powerpc64-linux-gnu",
        emulator=("qemu-ppc64", "{program}"),
        emulator_package="qemu-user",
        kind="linux",
        order=">",
    ),
)
PROCESSORS = {item.name: item for item in _LISTED}


def processor_named(name: str) -> Processor:
    """The processor of a name. Raises InvalidInput."""
    if name not in PROCESSORS:
        raise invalid("try_on", repr(name), f"one of {', '.join(PROCESSORS)}", "choose one of them")
    return PROCESSORS[name]


def host(compiler: str) -> Processor:
    """This computer, with its own compiler."""
    return Processor(
        name="host",
        title="this computer",
        compiler=compiler,
        flags=(),
        package=compiler,
        emulator=(),
        emulator_package="",
        kind="host",
        double="in hardware",
    )
