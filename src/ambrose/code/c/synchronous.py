"""Synchronous blocks as C99, beside any controller: one function a sample, without heap, recursion
or library.

The twin is ``ambrose.law.synchronous_block``: the code takes the same steps in the same order.
The text is in templates/synchronous.c.j2 and .h.j2; ``CompiledSynchronous`` runs it in this
process.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ambrose.code.block.names import as_comment
from ambrose.code.c.code import LARGEST, check_precision, code_types
from ambrose.code.c.compiler import COMPILERS, build_library, find_compiler, load_library
from ambrose.code.c.identity import identity_facts, with_identity
from ambrose.code.c.literals import literal, real_table
from ambrose.code.rendering import render
from ambrose.core.checks import InvalidInput, invalid
from ambrose.law.synchronous_block import (
    DECAY,
    JUMP,
    LOST_TURNS,
    SECTORS,
    BlockLaw,
    BlockState,
    SynchronousLaw,
    circle,
)
from ambrose.machine.atomic_write import write_files

_FLAGS = ("-Wall", "-Wextra", "-pedantic", "-Werror", "-ffp-contract=off")
NEWTON = 12  # steps of the square root: enough for any amplitude up to 1e3 limits
FAR = 1e9  # turns beyond which the angle stands still: years without a pulse


def generate_synchronous(
    law: SynchronousLaw,
    name: str = "sync",
    arithmetic: str = "double",
    provenance: Sequence[str] = (),
) -> dict[str, str]:
    """The files of the blocks by name: <name>.h and .c.

    name: of files and functions; arithmetic: "double" or "float"; provenance: lines for the header.
    Raises InvalidInput.
    """
    if not (name.isidentifier() and name.isascii()):
        raise invalid(
            "the name of the synchronous code", repr(name), "a name in C", "letters, digits and _"
        )
    check_precision(arithmetic)
    table = real_table(arithmetic)
    n = law.channels
    dt = law.sample_time
    blocks = [_block(block, table, arithmetic, dt) for block in law.blocks]

    def number(value: float) -> str:
        return literal(value, arithmetic)

    columns = sum(block.drive.shape[2] for block in law.blocks)
    size = {"double": 8, "float": 4}[arithmetic]
    numbers = 2 * SECTORS + sum(
        2 * block.drive.size + len(block.speeds) + n for block in law.blocks
    )
    turning = sum(n * 8 * block.drive.shape[2] for block in law.blocks if block.per_turn)
    cost = {
        # at the end of a turn the table serves twice, for the mean's real and imaginary part
        "multiplications": 40 + n * (4 * columns + (14 + 2 * NEWTON) * len(law.blocks)) + turning,
        "additions": 40 + n * (6 * columns + (10 + NEWTON) * len(law.blocks)) + turning,
        "table_bytes": size * numbers,
    }
    facts: dict[str, Any] = {
        "name": name,
        "prefix": name.upper(),
        "n": n,
        "arithmetic": {"double": "double precision", "float": "single precision"}[arithmetic],
        "type": arithmetic,
        "sample_time": f"{dt:.9g}",
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "blocks": blocks,
        "cost": cost,
        "sectors": SECTORS,
        "circle": table(circle()),
        "newton": NEWTON,
        "dt": number(dt),
        "fastest": number(law.fastest),
        "jump": number(JUMP),
        "lost_turns": number(LOST_TURNS),
        "two_pi": number(2 * math.pi),
        "per_radian": number(SECTORS / (2 * math.pi)),
        "sector_angle": number(2 * math.pi / SECTORS),
        "half": number(0.5),
        "sixth": number(1 / 6),
        "zero": number(0.0),
        "one": number(1.0),
        "fixed": False,
        "largest": LARGEST[arithmetic],
        "far": number(FAR),
        "per_turn": any(block.per_turn for block in law.blocks),
    }
    source = render("synchronous.c.j2", facts)
    known = identity_facts(name, source, code_types(arithmetic))
    header = render("synchronous.h.j2", {**facts, **known})
    return {f"{name}.h": header, f"{name}.c": with_identity(source, known)}


def write_synchronous(
    directory: str | Path,
    law: SynchronousLaw,
    name: str = "sync",
    arithmetic: str = "double",
    provenance: Sequence[str] = (),
) -> list[Path]:
    """Generate the code and write it to ``directory``: all files, or none. Returns their paths.
    Raises InvalidInput.
    """
    return write_files(directory, generate_synchronous(law, name, arithmetic, provenance))


def _block(block: BlockLaw, table: Any, arithmetic: str, dt: float) -> dict[str, Any]:
    def number(value: float) -> str:
        return literal(value, arithmetic)

    count, n, m = block.drive.shape
    drive = block.drive.reshape(count, n * m)
    return {
        "count": count,
        "m": m,
        "speeds": table(block.speeds),
        "re": table(drive.real),
        "im": table(drive.imag),
        "limit": table(block.limit),
        "low": number(block.band[0]),
        "high": number(block.band[1]),
        "hysteresis": number(block.hysteresis),
        "gain": number(block.gain),
        "leak": number(block.leak),
        "ramp": number(dt / block.ramp),
        "fade": number(1 - dt / block.release),
        "hold": round(block.hold / dt),
        "release": round(DECAY * block.release / dt),
        "harmonic": block.harmonic,
        "subtracts": int(block.subtracts),
        "currents": int(block.reads_currents),
        "per_turn": int(block.per_turn),
    }


class CompiledSynchronous:
    """The C code of the blocks in this process, with the methods of ``SynchronousBlock``."""

    def __init__(
        self, law: SynchronousLaw, arithmetic: str = "double", compiler: str | None = None
    ) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        chosen = find_compiler(compiler)
        if chosen is None:
            known = compiler or " or ".join(COMPILERS)
            raise InvalidInput(
                f"there is no C compiler {known} on this computer; install one to run the C code "
                "here"
            )
        files = generate_synchronous(law, "sync", arithmetic)
        self.law = law
        self._real = ctypes.c_double if arithmetic == "double" else ctypes.c_float
        self._kind = np.float64 if arithmetic == "double" else np.float32
        self._library = load_library(
            build_library(chosen, files, ["sync.c"], _FLAGS, "give another compiler")
        )
        self._library.sync_step.restype = ctypes.c_uint
        n, real = law.channels, self._real

        class Running(ctypes.Structure):
            _fields_ = (
                ("state", ctypes.c_int),
                ("fault", ctypes.c_uint),
                ("clock", ctypes.c_long),
                ("ramp", real),
                ("re", real * n),
                ("im", real * n),
                *(
                    (
                        ("sum_re", real * (2 * n)),
                        ("sum_im", real * (2 * n)),
                        ("count", ctypes.c_long),
                    )
                    if any(block.per_turn for block in law.blocks)
                    else ()
                ),
            )

        class State(ctypes.Structure):
            _fields_ = (
                ("pulses", ctypes.c_int),
                ("turned", ctypes.c_int),
                *(
                    (name, real)
                    for name in ("tau", "period", "middle", "speed", "slope", "now", "theta")
                ),
                ("block", Running * len(law.blocks)),
            )

        self._state = State()
        self._address = ctypes.addressof(self._state)
        self.faults = 0
        self.begin()

    def begin(self) -> None:
        """At rest: no pulse yet, all off."""
        self._library.sync_begin(ctypes.c_void_p(self._address))

    def step(
        self,
        pulse: float,
        errors: np.ndarray,
        currents: np.ndarray | None = None,
        contact: bool = False,
        saturated: bool = False,
        enabled: bool = True,
        unusable: bool = False,
    ) -> np.ndarray:
        """As ``SynchronousBlock.step``."""
        n = self.law.channels
        e = np.ascontiguousarray(errors, self._kind)
        u = (
            np.zeros(n, self._kind)
            if currents is None
            else np.ascontiguousarray(currents, self._kind)
        )
        c = np.empty(n, self._kind)
        flags = 4 * contact | 8 * saturated | 64 * (not enabled) | 128 * unusable
        self.faults = self._library.sync_step(
            ctypes.c_void_p(self._address),
            self._real(pulse),
            ctypes.c_void_p(e.ctypes.data),
            ctypes.c_void_p(u.ctypes.data),
            ctypes.c_uint(flags),
            ctypes.c_void_p(c.ctypes.data),
        )
        return c.astype(float)

    @property
    def states(self) -> tuple[BlockState, ...]:
        """The state of every block."""
        return tuple(BlockState(block.state) for block in self._state.block)

    @property
    def speed(self) -> float:
        """The speed as the angle's tracker has it [rad/s]."""
        return float(self._state.now)

    def amplitudes(self) -> np.ndarray:
        """a (blocks, n) complex [m]."""
        return np.array(
            [np.array(block.re) + 1j * np.array(block.im) for block in self._state.block]
        )
