"""The methods of identification: a class for each, with the options that it has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar

from ambrose.options import Options, option, positive

if TYPE_CHECKING:
    from ambrose.identification.output_error.problem import FitOptions


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identifying(Options):
    """One way from records to parameters. looped: of the running loop, with its controller."""

    method: ClassVar[str]  # its name
    looped: ClassVar[bool] = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoopMethod(Identifying):
    """A method that models the loop with the controller that ran.

    unknown: paths such as "bearing.*.negative_stiffness.*" (none: what the machine marks as
    uncertain, K_i and K_s of every axis, the amplifier's lag; "delay" and "bending" alone are added
    to these). start: path -> SI value to begin at. computing_delay [samples]: from measured errors
    to acting currents (None: the controller's own, else 1). bending_modes: per plane, as many as
    the rotor has at most (None: as many as the records tell, from 3 on). harmonics: up to which
    multiple of its speed a record's signals may turn with the rotor; tones [Hz]: others that they
    may hold. initial_state, offset: estimated per record, else zero. max_iterations: of the fit.
    """

    unknown: str | Sequence[str] = option(
        (),
        'What to identify, "*" for every name or axis: bearing.*.negative_stiffness.* '
        "(repeatable). Default: what the machine file marks as uncertain, K_i and K_s of every "
        "axis, and the amplifier's lag; delay, and bending (bending_2, ...) for frequency and "
        "damping of a bending mode, add to these.",
        many=True,
        metavar="PATH",
    )
    start: Mapping[str, float] | None = option(
        None,
        "SI value to begin at; default: the machine's (repeatable).",
        many=True,
        metavar="PATH=VALUE",
    )
    computing_delay: float | None = option(
        None,
        "From measured errors to acting currents; default: the controller file's, or 1.",
        flag="--delay-samples",
        check=positive("1 is usual", zero_allowed=True),
    )
    bending_modes: int | None = option(
        None,
        "Bending modes per plane in the model; default: as many as the record shows, 3 or more.",
    )
    harmonics: int = option(3, "Harmonics of the speed that unbalance may have.")
    tones: Sequence[float] = option(
        (), "Another tone, as of the mains (repeatable).", flag="--tone", many=True, metavar="HZ"
    )
    initial_state: bool = option(True, "Estimated per record.", flag=None)
    offset: bool = option(True, "Estimated per record.", flag=None)
    max_iterations: int = option(50, "Of the fit, at most.", flag=None)

    def fit_options(self, computing_delay: float | None) -> FitOptions:
        """How the loop is modelled and fitted; computing_delay [samples]: the controller's own."""
        from ambrose.identification.output_error.problem import FitOptions

        names = {item.name for item in fields(self)}
        known = {i.name: getattr(self, i.name) for i in fields(FitOptions) if i.name in names}
        if self.bending_modes is None:
            del known["bending_modes"]  # those to begin with
        if self.computing_delay is None:
            known["computing_delay"] = 1 if computing_delay is None else computing_delay
        return FitOptions(**known)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedLoop(LoopMethod):
    """The closed loop's output error over the whole record.

    signals: those fitted (None: every y_<axis>); u_ and i_<axis> are possible. weights: signal ->
    size of its noise [m] or [A] (None: the signal's rms). period [s], or "auto": the excitation is
    periodic, and the fit goes over the lines of its spectrum, much faster. seal_form: "line" or
    "table", the seal at every pressure of the records; seal: which one.
    """

    method: ClassVar[str] = "closed-loop"
    why: ClassVar[str] = "the closed loop is fitted over the whole record"

    signals: Sequence[str] | None = option(
        None,
        "Signals to fit, y_, u_ or i_<axis>; default: every y_<axis>.",
        many=True,
        metavar="NAME",
    )
    weights: Mapping[str, float] | None = option(None, "Size of each signal's noise.", flag=None)
    period: float | str | None = option(None, "Of the excitation, s.", flag=None)
    seal_form: str | None = option(
        None,
        "The seal pressure by pressure, and how kept.",
        flag="--seal-fit",
        choices=("line", "table"),
    )
    seal: str | None = option(None, "Which seal, where there are several.", metavar="NAME")

    def __post_init__(self) -> None:
        from ambrose.core.checks import InvalidInput

        Options.__post_init__(self)
        if self.seal is not None and self.seal_form is None:
            raise InvalidInput(
                "seal names the seal of seal_form (--seal-fit), which is missing; give it as line "
                "or table, or leave seal out"
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Youla(LoopMethod):
    """The residual of the dual Youla parametrisation; records need every u_<axis>."""

    method: ClassVar[str] = "youla"
    why: ClassVar[str] = "the Youla residual takes every u_ and y_<axis> of one operating point"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StaticLoads(Identifying):
    """K_i from static loads f_<port> and currents; no controller.

    average [s]: the end of every level that is averaged. drift [-]: how much of the levels' range a
    signal may still change in that time.
    """

    method: ClassVar[str] = "static"
    looped: ClassVar[bool] = False
    why: ClassVar[str] = (
        "static loads give K_i of every axis from forces and currents; no loop is modelled"
    )

    average: float = option(0.5, "Static: seconds averaged at the end of a level.")
    drift: float = option(0.01, "How much of its range a level may drift.", flag=None)


METHODS: Mapping[str, type[Identifying]] = {
    kind.method: kind for kind in (ClosedLoop, Youla, StaticLoads)
}
