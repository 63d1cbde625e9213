"""What a controller can be written for: a class for each target, with the options that it has."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

from ambrose.options import READING_ERROR, STUCK_AFTER, AsItRuns, hertz, option, positive

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from ambrose.code.c.code import Arithmetic, Precision
    from ambrose.code.interface import Base, Law
    from ambrose.code.processor_trial import Trial
    from ambrose.code.sampled import Deployment, Progress, ScheduledDeployment
    from ambrose.core.sampling import Method
    from ambrose.judge.result import Synthesis
    from ambrose.law.law import Scheduling

    Made = tuple[Synthesis, Deployment | ScheduledDeployment]

Files = Mapping[str, "str | bytes"]
# as code.processor.machines describes them
PROCESSORS = (
    "cortex-m7",
    "cortex-m4",
    "cortex-r5",
    "cortex-r5-big-endian",
    "aarch64",
    "riscv64",
    "ppc64",
)
WORDS = ("double", "float", "fixed32", "fixed16")


def _identifier(value: Any, name: str) -> None:
    from ambrose.code.block.block import check_identifier

    check_identifier(value, "the name of the block", "choose letters, digits and underscores")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Target(AsItRuns, ABC):
    """How a controller is written, whatever it is written for.

    name: prefix of every name in the code, a C identifier. rate [Hz], delay_samples: 10 kHz and one
    sample where neither controller nor machine file says it. sampling, prewarp [rad/s]: as in
    ``core.sampling.c2d``. error_limit [m], current_limit [A]: one number or one per axis (None: the
    bearings' gaps, or twice their touchdown gaps, and largest currents). windup_time [s],
    hold_samples: as in ``build_block`` (None: its own). speed_limit [rad/s], speed_rate [rad/s^2],
    pressure_limit [Pa], pressure_rate [Pa/s]: of a controller that is scheduled over the one, as in
    ``build_scheduled_block``. force: write a controller that is not verified, or not stable
    everywhere. Raises InvalidInput.
    """

    to: ClassVar[str]
    apart: ClassVar[str] = ""  # why the thrust axis is a unit of its own
    beside: ClassVar[str] = ""  # why it holds no synchronous blocks
    # whether it holds a fallback, a schedule over two, and tables that can be compared
    whole: ClassVar[bool] = False
    name: str = option(
        "controller", "Prefix of every name in the code, a C identifier.", check=_identifier
    )
    sampling: Method = option(
        "tustin", "How it is sampled.", choices=("tustin", "zoh", "backward-euler", "matched")
    )
    prewarp: float | None = option(
        None,
        "tustin: exact at this frequency; matched: same gain as the continuous controller at "
        "this frequency.",
        flag="--prewarp-hz",
        convert=hertz,
        check=positive("leave it out, or give a frequency below half the rate"),
    )
    error_limit: ArrayLike | None = option(
        None, "Largest plausible error in m; default: the bearing's gap."
    )
    current_limit: ArrayLike | None = option(None, "Largest current in A; default: the bearing's.")
    windup_time: float | None = option(None, "Time constant of the anti-windup, s.", flag=None)
    hold_samples: int | None = option(None, "Samples a lost reading is held for.", flag=None)
    speed_limit: float | None = option(
        None, "Scheduled: largest plausible speed in rad/s; default: twice the range's."
    )
    speed_rate: float | None = option(None, "Scheduled: how fast it follows the speed, in rad/s^2.")
    pressure_limit: float | None = option(
        None,
        'Scheduled: largest plausible pressure, such as "6 bar"; default: twice the range\'s.',
        dimension="pressure",
        metavar="PRESSURE",
    )
    pressure_rate: float | None = option(
        None,
        'Scheduled: how fast it follows the pressure, such as "40 bar/s"; with --fallback the '
        "fastest change believed.",
        dimension="pressure per time",
        metavar="RATE",
    )
    force: bool = option(
        False, "Export a controller that is not verified, or not stable everywhere."
    )

    @abstractmethod
    def files(
        self,
        law: Law,
        lines: Sequence[str],
        along: Sequence[str] = (),
        made: Made | None = None,
    ) -> Files:
        """{name: content} of a unit; lines, along: where the controller and the one along the shaft
        come from; made: the synthesis and what of it was sampled and judged.
        """

    @property
    def arithmetic(self) -> Arithmetic:
        """Numbers of the code."""
        return "double"

    @property
    def cascade(self) -> bool:
        """Whether a filter bank is written section by section."""
        return False

    def along_shaft(self) -> Self:
        """How the axial controller is written beside the radial one: alike, under a name of its
        own. Raises InvalidInput for what is tried part by part.
        """
        return replace(self, name=f"{self.name}_axial", error_limit=None, current_limit=None)

    def check_trial(self, block: Callable[[], Base]) -> None:
        """What can be refused of a trial before the loop is verified. block: makes it, unverified.
        Raises InvalidInput.
        """

    def tried(self, law: Law, files: Files, progress: Progress) -> Trial | None:
        """The files of a law, run on the target's processor; None: it is not tried. Raises
        InvalidInput.
        """
        return None

    def check_tools(self) -> None:
        """Raises InvalidInput where what it is written with is not installed."""

    def check_beside(self) -> None:
        """Raises InvalidInput where this target holds no synchronous blocks."""
        from ambrose.core.checks import invalid

        if self.beside:
            raise invalid(
                "a controller with synchronous blocks",
                f"for the target {self.to!r}",
                "for the target 'c', 'fmu' or 'st'",
                f"{self.beside}; write one of these, which run both in one unit",
            )

    def schedule_limits(
        self, along: Scheduling
    ) -> tuple[tuple[float | None, ...], tuple[float | None, ...]]:
        """The largest plausible value of every parameter of the schedule (speed [rad/s], pressure
        [Pa]), and of its rate; None: as ``build_scheduled_block`` takes it.
        """
        limits, rates = (
            tuple(getattr(self, f"{one.name}_{what}") for one in along.each)
            for what in ("limit", "rate")
        )
        return limits, rates


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class C(Target):
    """C99, with a self-test.

    arithmetic: of the code. form: "modal", or of filters "cascade", section by section. With a
    fallback pressure_rate, pressure_error [Pa] and stuck_after [s] are rate, band and stuck of
    ``law.supervision.Limits``. try_on: a processor that the code is compiled for and run on, in an
    emulator, beside this computer (None: not); clock [Hz]: of it; flash, ram [bytes]: code, or
    memory and stack, beyond them are refused. bare_metal: also an example that runs it without an
    operating system (``bare_metal``).
    """

    to: ClassVar[str] = "c"
    whole: ClassVar[bool] = True

    arithmetic: Arithmetic = option("double", "Numbers of the code.", choices=WORDS)
    form: str = option(
        "modal",
        "Realisation in C: modal, or of a filter bank its sections one by one.",
        choices=("modal", "cascade"),
    )
    pressure_error: float | None = option(None, **READING_ERROR)
    stuck_after: float | None = option(None, **STUCK_AFTER)
    try_on: str | None = option(
        None,
        "Compile it for this processor too, run it there in QEMU, and compare bit by bit.",
        choices=PROCESSORS,
    )
    clock: float | None = option(
        None,
        'With --try-on: the processor\'s clock, such as "480 MHz".',
        dimension="frequency",
        metavar="FREQUENCY",
        check=positive("give it in Hz"),
    )
    flash: float | None = option(
        None,
        "With --try-on: bytes that there are for code and tables.",
        metavar="BYTES",
        check=positive("give it in bytes"),
    )
    ram: float | None = option(
        None,
        "With --try-on: bytes that there are for states and stack.",
        metavar="BYTES",
        check=positive("give it in bytes"),
    )
    bare_metal: bool = option(
        False,
        "Also an example without an operating system: timer, two buffers, watchdog, on an emulated "
        "Cortex-M board.",
    )

    @property
    def cascade(self) -> bool:
        return self.form == "cascade"

    def along_shaft(self) -> Self:
        from ambrose.core.checks import InvalidInput

        if self.try_on is not None or self.bare_metal:
            raise InvalidInput(
                "a unit of all axes is not tried on a processor as a whole; export each controller "
                "by itself with --try-on or --bare-metal (--axes radial, --axes thrust), then both "
                "without"
            )
        # its sections are its own file's
        return replace(super(C, self).along_shaft(), form="modal")

    def check_trial(self, block: Callable[[], Base]) -> None:
        """Options without a processor, a compiler or emulator that is not there, and a controller
        whose code alone is too large.
        """
        from ambrose.code.processor_build import processor_named, unit_of
        from ambrose.code.processor_trial import check_room, check_trial
        from ambrose.core.checks import invalid

        if self.try_on is None:
            for name in ("clock", "flash", "ram"):
                if (value := getattr(self, name)) is not None:
                    remedy = "it goes with try_on: name a processor"
                    raise invalid(name, value, "left out", remedy)
            return
        processor = processor_named(self.try_on)
        check_trial(processor, self.arithmetic)
        if self.flash is not None or self.ram is not None:
            check_room(unit_of(block(), self.arithmetic), processor, self.flash, self.ram)

    def tried(self, law: Law, files: Files, progress: Progress) -> Trial | None:
        from ambrose.code.processor_build import processor_named, unit_of
        from ambrose.code.processor_trial import check_room, try_unit

        if self.try_on is None:
            return None
        texts = {name: text for name, text in files.items() if isinstance(text, str)}
        unit, processor = unit_of(law, self.arithmetic, texts), processor_named(self.try_on)
        check_room(unit, processor, self.flash, self.ram)
        return try_unit(unit, processor, clock=self.clock, progress=progress)

    def files(
        self,
        law: Law,
        lines: Sequence[str],
        along: Sequence[str] = (),
        made: Made | None = None,
    ) -> Files:
        from ambrose.code.c.code import law_files
        from ambrose.code.processor_build import bare_metal_files

        files = law_files(law, self.arithmetic, lines, along)
        return {**files, **bare_metal_files(law, self.arithmetic)} if self.bare_metal else files


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mat(Target):
    """A MAT-file for MATLAB and Octave, in double precision."""

    to: ClassVar[str] = "mat"
    apart: ClassVar[str] = "a MAT-file contains one law"
    beside: ClassVar[str] = "a MAT-file contains the linear law alone"

    def files(
        self,
        law: Law,
        lines: Sequence[str],
        along: Sequence[str] = (),
        made: Made | None = None,
    ) -> Files:
        from ambrose.code.mat import generate_mat

        synthesis, deployment = made or (None, None)
        return generate_mat(law, deployment, synthesis, lines)  # type: ignore[arg-type]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fmu(Target):
    """Functional mock-up units, FMI 2.0 and 3.0.

    arithmetic: of the code. sources_only: without a binary.
    """

    to: ClassVar[str] = "fmu"

    arithmetic: Arithmetic = option("double", "Numbers of the code.", choices=WORDS)
    sources_only: bool = option(False, "An FMU without a binary: no C compiler is needed here.")

    def check_tools(self) -> None:
        from ambrose.code.fmu import check_compiler

        if not self.sources_only:
            check_compiler()

    def files(
        self,
        law: Law,
        lines: Sequence[str],
        along: Sequence[str] = (),
        made: Made | None = None,
    ) -> Files:
        from ambrose.code.fmu import generate_fmus

        return generate_fmus(law, self.arithmetic, lines, sources_only=self.sources_only)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class St(Target):
    """Structured text, IEC 61131-3. arithmetic: of the code."""

    to: ClassVar[str] = "st"
    apart: ClassVar[str] = "a function block holds one group of axes"

    arithmetic: Precision = option("double", "Numbers of the code.", choices=WORDS[:2])

    def files(
        self,
        law: Law,
        lines: Sequence[str],
        along: Sequence[str] = (),
        made: Made | None = None,
    ) -> Files:
        from ambrose.code.structured_text import unit_structured_text

        return unit_structured_text(law, self.arithmetic, lines)


TARGETS: Mapping[str, type[Target]] = {kind.to: kind for kind in (C, Mat, Fmu, St)}
