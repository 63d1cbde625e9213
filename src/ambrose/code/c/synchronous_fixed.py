"""Synchronous blocks as C99 in whole numbers, and the report of their formats.

The twin is ``ambrose.code.block.synchronous_twin``: equal to the last bit. The text is in
templates/synchronous_fixed.c.j2; ``CompiledWords`` runs it in this process.
"""

from __future__ import annotations

import ctypes
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from ambrose.code.block.names import as_comment
from ambrose.code.block.synchronous_twin import SynchronousTwin
from ambrose.code.block.synchronous_words import (
    ONE,
    PER_REST,
    PLACE,
    SIGNAL,
    SIXTH,
    BlockWords,
    SynchronousWords,
)
from ambrose.code.c.compiler import build_library, find_compiler, load_library
from ambrose.code.c.identity import identity_facts, with_identity
from ambrose.code.c.literals import integer_table
from ambrose.code.rendering import render
from ambrose.core.checks import InvalidInput
from ambrose.law.synchronous_block import SECTORS, BlockState

FLAGS = ("-Wall", "-Wextra", "-Wconversion", "-pedantic", "-Werror")
_ANGLES = 10_000  # at which the table is measured
_SETTINGS = 21


def generate_words(
    words: SynchronousWords, word: int, name: str = "sync", provenance: Sequence[str] = ()
) -> dict[str, str]:
    """The files of the blocks by name: <name>.h, .c and _report.md.

    word: 32 or 16, of the signals in and out; name: of files and functions; provenance: lines for
    the header.
    """
    law, n = words.law, words.law.channels
    blocks = [_block(block) for block in words.blocks]
    columns = sum(block.drive.shape[2] for block in law.blocks)
    sizes = [block.re.size * 2 + 3 * len(block.speeds) + n + _SETTINGS for block in words.blocks]
    facts: dict[str, Any] = {
        "name": name,
        "prefix": name.upper(),
        "n": n,
        "fixed": True,
        "word": word,
        "arithmetic": f"fixed point, {word} bits",
        "type": f"int{word}_t",
        "one": 1 << (word - 2),
        "up": 1 << (SIGNAL + 2 - word),
        "down": SIGNAL + 2 - word,
        "largest_word": 2 ** (word - 1) - 1,
        "sample_time": f"{law.sample_time:.9g}",
        "provenance": [as_comment(line) for line in provenance] or ["provenance: not given"],
        "blocks": blocks,
        "sectors": SECTORS,
        "circle": integer_table(words.table),
        "time_bits": words.time_bits,
        "slope_bits": words.slope_bits,
        "fastest": words.fastest,
        "per_rest": PER_REST,
        "third": SIXTH,
        "per_turn": any(block.per_turn for block in law.blocks),
        "cost": {
            # interpolated entries, their products, turning and moving, per block and channel
            "multiplications": 20 + n * (4 * columns + 20 * len(blocks)),
            "additions": 40 + n * (8 * columns + 30 * len(blocks)),
            "table_bytes": 4 * (2 * SECTORS + sum(sizes)),
        },
    }
    source = render("synchronous_fixed.c.j2", facts)
    known = identity_facts(name, source, {"int32_t": "i4"})
    return {
        f"{name}.h": render("synchronous.h.j2", {**facts, **known}),
        f"{name}.c": with_identity(source, known),
        f"{name}_report.md": render("sync_report.md.j2", {**facts, **_report(words, word)}),
    }


def _block(block: BlockWords) -> dict[str, Any]:
    """The tables of one block."""
    law = block.law
    count, n, m = block.re.shape
    gaps = max(count - 1, 1)  # of one speed: never read
    settings = [
        *(block.low, block.high, block.hysteresis, block.gain, block.gain_bits, block.leak),
        *(block.leak_bits, block.fade, block.fade_bits, block.ramp, block.drive_bits),
        *(block.headroom, block.amplitude_bits, block.hold, block.release, block.most, count),
        *(law.harmonic, law.subtracts, law.reads_currents, law.per_turn),
    ]
    return {
        "count": count,
        "m": m,
        "gaps": gaps,
        "settings": len(settings),
        "amplitude": block.amplitude_bits,
        "speeds": integer_table(block.speeds),
        "reciprocals": integer_table(np.resize(block.reciprocals, gaps)),
        "distances": integer_table(np.resize(block.reciprocal_bits, gaps)),
        "re": integer_table(block.re.reshape(count, n * m)),
        "im": integer_table(block.im.reshape(count, n * m)),
        "limit": integer_table(block.limit),
        "set": integer_table(np.array(settings, np.int64)),
    }


def table_found(words: SynchronousWords) -> float:
    """The largest error of cosine and sine over many angles."""
    twin, worst = SynchronousTwin(words), 0.0
    for theta in np.linspace(0, 2**32 - 1, _ANGLES).astype(np.int64).tolist():
        twin.angle.theta = theta
        cosine, sine = twin.turn(1)
        angle = 2 * math.pi * theta / 2**32
        worst = max(worst, abs(cosine / ONE - math.cos(angle)), abs(sine / ONE - math.sin(angle)))
    return worst


def _report(words: SynchronousWords, word: int) -> dict[str, Any]:
    dt = words.law.sample_time
    angle = words.angle_error
    return {
        "speed_lsb": f"{2 * math.pi / dt * 2.0**-PLACE:.2g}",
        "table_error": f"{words.table_error:.2g}",
        "table_found": f"{table_found(words):.2g}",
        "angle_error": f"{angle:.2g}",
        "c_error": f"{2.0 ** (1 - word):.2g}",
        "blocks": [
            {
                "drive_bits": block.drive_bits,
                "x_bits": SIGNAL - block.headroom,
                "amplitude": block.amplitude_bits,
                "relative": f"{block.relative:.2g}",
                "phase": f"{math.degrees(math.asin(min(block.relative, 1.0))):.2g}",
                "reading": f"{words.reading_error(block):.2g}",
                "gain": f"{block.gain * 2.0**-block.gain_bits / dt:.9g}",
                "leak": f"{block.leak * 2.0**-block.leak_bits / dt:.9g}",
                "fade": f"{dt / (block.fade * 2.0**-block.fade_bits):.9g}",
                "ramp": f"{dt * ONE / block.ramp:.9g}",
            }
            for block in words.blocks
        ],
    }


class CompiledWords:
    """The C code of the blocks in words of 32 bits in this process, with the methods of
    ``SynchronousTwin``.
    """

    def __init__(self, words: SynchronousWords, flags: Sequence[str] = FLAGS) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        chosen = find_compiler(None)
        if chosen is None:
            raise InvalidInput("there is no C compiler on this computer; install one")
        self.words, n = words, words.law.channels
        files = generate_words(words, 32)
        self._library = load_library(
            build_library(chosen, files, ["sync.c"], tuple(flags), "give another compiler")
        )
        self._library.sync_step.restype = ctypes.c_uint
        each_turn = any(block.per_turn for block in words.law.blocks)

        class Running(ctypes.Structure):
            _fields_ = (
                ("state", ctypes.c_int),
                ("fault", ctypes.c_uint),
                ("clock", ctypes.c_int32),
                ("ramp", ctypes.c_int32),
                ("re", ctypes.c_int64 * n),
                ("im", ctypes.c_int64 * n),
                *(
                    (
                        ("sum_re", ctypes.c_int64 * (2 * n)),
                        ("sum_im", ctypes.c_int64 * (2 * n)),
                        ("count", ctypes.c_int32),
                    )
                    if each_turn
                    else ()
                ),
            )

        class State(ctypes.Structure):
            _fields_ = (
                ("pulses", ctypes.c_int),
                ("turned", ctypes.c_int),
                *((key, ctypes.c_int64) for key in ("tau", "period", "middle", "speed", "slope")),
                ("now", ctypes.c_int32),
                ("theta", ctypes.c_uint32),
                ("block", Running * len(words.blocks)),
            )

        self._state = State()
        self._words = ctypes.c_int32 * n
        self.begin()

    def begin(self) -> None:
        """At rest: no pulse yet, all off."""
        self._library.sync_begin(ctypes.byref(self._state))

    def step(
        self,
        pulse: int,
        errors: Sequence[int],
        currents: Sequence[int],
        contact: bool = False,
        saturated: bool = False,
        enabled: bool = True,
        unusable: bool = False,
    ) -> list[int]:
        """As ``SynchronousTwin.step``."""
        c = self._words()
        flags = 4 * contact | 8 * saturated | 64 * (not enabled) | 128 * unusable
        self._library.sync_step(
            ctypes.byref(self._state),
            ctypes.c_int32(pulse),
            self._words(*errors),
            self._words(*currents),
            ctypes.c_uint(flags),
            c,
        )
        return list(c)

    @property
    def states(self) -> tuple[BlockState, ...]:
        """The state of every block."""
        return tuple(BlockState(block.state) for block in self._state.block)

    @property
    def faults(self) -> tuple[int, ...]:
        """The faults of every block."""
        return tuple(block.fault for block in self._state.block)

    @property
    def stored(self) -> list[list[int]]:
        """The stored amplitudes of every block, real parts then imaginary ones."""
        return [[*block.re, *block.im] for block in self._state.block]
