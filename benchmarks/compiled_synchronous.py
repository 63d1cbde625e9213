"""The C code of synchronous blocks in this process, alone or as a unit with its controller."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ambrose.annexes.synchronous.block_code import (
    RunUnit,
    UnitRun,
    generate_run,
    generate_synchronous,
    generate_words,
)
from ambrose.code.block.synchronous_twin import SynchronousWords
from ambrose.code.c.code import Arithmetic
from ambrose.code.c.compiled import Loaded
from ambrose.code.interface import (
    TYPES,
    Argument,
    Interface,
    amplitude_type,
    amplitudes_at,
    interface_of,
)
from ambrose.law.synchronous_block import BlockState, SynchronousLaw


def synchronous_interface(law: SynchronousLaw, name: str, arithmetic: str) -> Interface:
    """Of synchronous blocks by themselves."""
    real, n = TYPES[arithmetic][0], law.channels
    arguments = (
        Argument("pulse", real),
        Argument("error", real, n),
        Argument("current", real, n),
        Argument("flags", "unsigned"),
        Argument("c", real, n, given=False),
    )
    places = {
        "now": ("now", real, 1),
        **amplitudes_at(law, "", amplitude_type(arithmetic)),
    }
    return Interface(name, f"{name}_state", (f"{name}.c",), arguments, places, "begin")


class _CompiledBeside:
    """What the compiled blocks share, in floating point and in whole numbers."""

    def __init__(
        self, law: SynchronousLaw, arithmetic: str, files: dict[str, str], compiler: str | None
    ) -> None:
        self.law = law
        self._code = Loaded(synchronous_interface(law, "sync", arithmetic), files, compiler)
        self.begin()

    def begin(self) -> None:
        """At rest: no pulse yet, all off."""
        self._code.begin()

    def _step(
        self,
        pulse: float,
        errors: ArrayLike,
        currents: ArrayLike | None = None,
        contact: bool = False,
        saturated: bool = False,
        enabled: bool = True,
        unusable: bool = False,
    ) -> tuple[np.ndarray, int]:
        flags = 4 * contact | 8 * saturated | 64 * (not enabled) | 128 * unusable
        current = 0 if currents is None else currents
        return self._code.call(pulse=pulse, error=errors, current=current, flags=flags)

    def _each(self, what: str) -> list[np.ndarray]:
        """What the memory keeps of every block."""
        return [self._code.at[f"{what} {b}"] for b in range(len(self.law.blocks))]

    @property
    def states(self) -> tuple[BlockState, ...]:
        """The state of every block."""
        return tuple(BlockState(int(state[0])) for state in self._each("state"))


class CompiledSynchronous(_CompiledBeside):
    """The C code of the blocks in this process, with the methods of ``SynchronousBlock``."""

    def __init__(
        self, law: SynchronousLaw, arithmetic: str = "double", compiler: str | None = None
    ) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        super().__init__(law, arithmetic, generate_synchronous(law, "sync", arithmetic), compiler)
        self.faults = 0

    def step(
        self,
        pulse: float,
        errors: np.ndarray,
        currents: np.ndarray | None = None,
        *flags: bool,
        **named: bool,
    ) -> np.ndarray:
        """As ``SynchronousBlock.step``."""
        c, self.faults = self._step(pulse, errors, currents, *flags, **named)
        return c.astype(float)

    @property
    def speed(self) -> float:
        """The speed as the angle's tracker has it [rad/s]."""
        return float(self._code.at["now"][0])

    def amplitudes(self) -> np.ndarray:
        """a (blocks, n) complex [m]."""
        return np.array(self._each("re")) + 1j * np.array(self._each("im"))


class CompiledWords(_CompiledBeside):
    """The C code of the blocks in words of 32 bits in this process, with the methods of
    ``SynchronousTwin``.
    """

    def __init__(self, words: SynchronousWords) -> None:
        """Compiles the code. Raises InvalidInput where there is no C compiler, or it fails."""
        super().__init__(words.law, "fixed32", generate_words(words, 32), None)

    def step(
        self,
        pulse: int,
        errors: Sequence[int],
        currents: Sequence[int],
        *flags: bool,
        **named: bool,
    ) -> list[int]:
        """As ``SynchronousTwin.step``."""
        return self._step(pulse, errors, currents, *flags, **named)[0].tolist()

    @property
    def faults(self) -> tuple[int, ...]:
        """The faults of every block."""
        return tuple(int(fault[0]) for fault in self._each("fault"))

    @property
    def stored(self) -> list[list[int]]:
        """The stored amplitudes of every block, real parts then imaginary ones."""
        pairs = zip(self._each("re"), self._each("im"), strict=True)
        return [[*re.tolist(), *im.tolist()] for re, im in pairs]


class CompiledRun:
    """The unit's C code in this process."""

    def __init__(
        self, unit: RunUnit, arithmetic: Arithmetic = "double", compiler: str | None = None
    ) -> None:
        """Compiles the code; in fixed point pulses, errors, currents, c are counts, amplitudes
        stored numbers. Raises InvalidInput where there is no C compiler, or it fails.
        """
        self.unit = unit
        files = generate_run(unit, arithmetic)
        self._code = Loaded(interface_of(unit, arithmetic), files, compiler)

    def run(
        self,
        pulses: ArrayLike,
        errors: ArrayLike,
        told: ArrayLike | None = None,
        valid: ArrayLike | None = None,
        contact: ArrayLike | None = None,
        enabled: ArrayLike | None = None,
    ) -> UnitRun:
        """As ``annexes.synchronous.block_code.run_unit``; its states are left empty."""
        e, times = np.asarray(errors, float), np.asarray(pulses, float)
        (count, n), names = e.shape, self.unit.base.told
        blocks = range(len(self.unit.law.blocks))
        good = np.ones((count, n), np.uint8) if valid is None else np.array(valid, np.uint8)
        marks = np.zeros(count, bool) if contact is None else np.asarray(contact, bool)
        on = np.ones(count, bool) if enabled is None else np.asarray(enabled, bool)
        flags = 4 * marks + 64 * ~on
        given = np.reshape([] if told is None else told, (count, len(names)))
        run = UnitRun(
            np.zeros((count, n)),
            np.zeros(count, int),
            np.zeros(count, int),
            np.zeros((count, 0), int),
            np.zeros((count, n)),
            np.zeros((count, len(blocks), n), complex),
        )
        code, at = self._code, self._code.at
        code.begin()
        for k in range(count):
            heard = dict(zip(names, given[k], strict=True))
            run.currents[k], run.status[k] = code.call(
                pulse=times[k], error=e[k], valid=good[k], flags=flags[k], **heard
            )
            run.faults[k], run.c[k] = at["faults"][0], at["c"]
            run.amplitudes[k] = [at[f"re {b}"] + 1j * at[f"im {b}"] for b in blocks]
        return run
