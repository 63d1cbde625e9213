"""Options: the fields of a frozen dataclass, each with what it means, what it must be, and how a
command line asks for it.

A method, a target or anything else that one of several is chosen from is such a class, with its own
options alone; what goes with what is then said by the types. ``choose`` makes one of them from a
name and options by name, and refuses an option that it does not have by naming those that do.
Nothing here needs numpy before a value is checked, so that the command line's help stays fast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar

from ambrose.machine.units import meant, suggestion

if TYPE_CHECKING:
    from pathlib import Path

    from ambrose.law.law import LawLike

Check = Callable[[Any, str], None]
# (options, another, whether they go with it or are left out with it, remedy with it as {})
Rules = tuple[tuple[tuple[str, ...], str, bool, str], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Option:
    """What is known of an option beside its type and its default.

    meaning: a sentence for people. check: refuses a value by a name, in SI as in the command line's
    unit. flag: on the command line ("": its name with hyphens; None: it has none there).
    convert: from a number of the command line to SI; dimension: there it is a text with a unit.
    choices: the values allowed. many: it is given there once for each value; metavar: what stands
    for the value there.
    """

    meaning: str
    check: Check | None = None
    flag: str | None = ""
    convert: Callable[[float], float] | None = None
    dimension: str = ""
    choices: tuple[Any, ...] = ()
    many: bool = False
    metavar: str | None = None


def option(default: Any, meaning: str, **known: Any) -> Any:
    """A field with a default, for the body of a class of ``Options``; known: as of ``Option``."""
    return field(default=default, metadata={"option": Option(meaning=meaning, **known)})


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """A class whose fields are options: each value is checked as it is made.

    Raises InvalidInput.
    """

    why: ClassVar[str] = ""  # why it has no others, told where one of them is refused
    rules: ClassVar[Rules] = ()

    def __post_init__(self) -> None:
        from ambrose.core.checks import check_plain_fields

        check_plain_fields(self)  # "no" is as good as True, and ends in no error
        for item in fields(self):
            check_option(item, getattr(self, item.name), item.name)
        self.check_rules(self.values(), {})

    @classmethod
    def check_rules(cls, given: Mapping[str, Any], spelled: Mapping[str, str]) -> None:
        """Refuse options by the ``rules``; spelled: as of ``choose``. Raises InvalidInput."""
        from ambrose.core.checks import invalid

        usual = {item.name: item.default for item in fields(cls)}

        def stated_as(name: str, value: Any) -> bool:
            """Whether it is another than the default; an array is, whose == is no truth."""
            alike = isinstance(value, type(usual[name]) | int | float)
            return value is not None and not (alike and value == usual[name])

        stated = {name: value for name, value in given.items() if stated_as(name, value)}
        for names, other, together, remedy in cls.rules:
            wrong = [name for name in names if name in stated and (other in stated) is not together]
            if wrong:
                raise invalid(
                    spelled.get(wrong[0], wrong[0]),
                    stated[wrong[0]] if spelled else "given",
                    f"{'given' if together else 'left out'} with {spelled.get(other, other)}",
                    remedy.format(spelled.get(other, other)),
                )

    def values(self) -> dict[str, Any]:
        """{option: its value}."""
        return {item.name: getattr(self, item.name) for item in fields(self)}


def option_of(item: Field[Any]) -> Option:
    """What is known of a field. Raises KeyError for one that is no option."""
    known: Option = item.metadata["option"]
    return known


def check_option(item: Field[Any], value: Any, name: str) -> None:
    """Refuse a value that an option cannot have, by what the caller calls it. None is checked only
    where it is not the default. Raises InvalidInput.
    """
    from ambrose.core.checks import invalid

    known = option_of(item)
    if value is None and item.default is None:
        return
    several = any(word in str(item.type) for word in ("Sequence", "ArrayLike"))
    if type(value).__name__ == "ndarray" and not (value.ndim and several):
        raise invalid(name, f"an array of {value.size}", f"{item.type}", "give a plain value")
    for part in (value if known.many else (value,)) if known.choices else ():
        # an array compares by element: what is no word (or number) of the choices' kind is none
        if not any(isinstance(part, type(one)) and part == one for one in known.choices):
            words = ", ".join(map(str, known.choices))
            raise invalid(name, repr(part), f"one of {words}", "leave the default")
    if known.check is not None:
        known.check(value, name)


Kind = TypeVar("Kind", bound=Options)


def choose(
    kinds: Mapping[str, type[Kind]],
    word: str,
    kind: Kind | str,
    given: Mapping[str, Any],
    spelled: Mapping[str, str] | None = None,
) -> Kind:
    """One of several, with options by name.

    word: what they are ("method"). kind: the name of one, or one itself, whose options ``given``
    replaces. spelled: what the caller calls the options ("--rate-hz") and the word. Raises
    InvalidInput for an unknown name or option, and for an option that goes with others.
    """
    from ambrose.core.checks import invalid

    spelled = spelled or {}
    if isinstance(kind, Options):
        given = kind.values() | dict(given)
        kind = next((key for key, other in kinds.items() if other is type(kind)), repr(kind))
    if not isinstance(kind, str) or kind not in kinds:
        close = meant(str(kind), kinds)
        raise invalid(
            spelled.get(word, word),
            repr(kind),
            f"one of {', '.join(kinds)}",
            f'did you mean "{close}"?' if close else "choose one of them",
        )
    refuse_foreign(kinds, word, kind, given, spelled)
    return kinds[kind](**given)


def refuse_foreign(
    kinds: Mapping[str, type[Options]],
    word: str,
    kind: str,
    given: Iterable[str],
    spelled: Mapping[str, str],
) -> None:
    """Refuse the first of the options that ``kind`` does not have; arguments as of ``choose``.

    Raises InvalidInput, which names those that have it, or the option that was probably meant.
    """
    from ambrose.core.checks import InvalidInput, invalid

    because = f": {kinds[kind].why}" if kinds[kind].why else ""
    for name in given:
        having = kinds_with(kinds, name)
        if not having:
            known = {item.name for other in kinds.values() for item in fields(other)}
            raise InvalidInput(f"there is no option {name!r}; {suggestion(name, known)}")
        if kind not in having:
            raise invalid(
                spelled.get(name, name),
                "given",
                f"left out with {spelled.get(word, word)} {kind}",
                f"it goes with {either(having)}{because}",
            )


def either(names: Sequence[str]) -> str:
    """ "a, b or c"."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if names[1:] else names)


def kinds_with(kinds: Mapping[str, type[Options]], name: str) -> tuple[str, ...]:
    """The names of those that have an option."""
    return tuple(
        key for key, kind in kinds.items() if any(item.name == name for item in fields(kind))
    )


def defaults(kinds: Mapping[str, type[Options]]) -> dict[str, Any]:
    """{option: its default} of all of them."""
    return {
        item.name: None if item.default is MISSING else item.default
        for kind in kinds.values()
        for item in fields(kind)
    }


def settings(kinds: Mapping[str, type[Options]], chosen: Options) -> dict[str, Any]:
    """All options of all kinds, as files keep them: the chosen one's, the others at their
    defaults.
    """
    return defaults(kinds) | asdict(chosen)


def positive(remedy: str, *, zero_allowed: bool = False) -> Check:
    """A check: one positive number."""

    def check(value: Any, name: str) -> None:
        from ambrose.core.checks import check_positive

        check_positive(value, name, remedy, zero_allowed=zero_allowed)

    return check


def count(remedy: str, what: str = "") -> Check:
    """A check: a whole number, zero or more; ``what`` it counts."""

    def check(value: Any, name: str) -> None:
        from operator import index

        from ambrose.core.checks import invalid

        try:
            whole = not isinstance(value, bool) and index(value) >= 0
        except TypeError:
            whole = False
        if not whole:
            full = f"{what} ({name})" if what else name
            raise invalid(full, repr(value), "a whole number, zero or more", remedy)

    return check


def ends(value: Any, name: str) -> None:
    """Refuse what is no range: two numbers, the lower first. Raises InvalidInput."""
    from ambrose.core.checks import check_positive, invalid

    try:
        if isinstance(value, str):
            raise TypeError
        low, high = (float(end) for end in value if not isinstance(end, str))
    except (TypeError, ValueError) as error:
        remedy = "give the lowest and the highest"
        raise invalid(name, repr(value), "two numbers", remedy) from error
    if not 0 <= low < high < float("inf"):
        swapped = 0 <= high < low
        raise invalid(
            name,
            f"{low:g} and {high:g}",
            "the lower, then the higher, both finite, none negative",
            "swap the two" if swapped else "give two numbers that differ",
        )
    check_positive(high, name, "give two numbers")


def hertz(value: float) -> float:
    """A frequency [Hz] in rad/s."""
    return 6.283185307179586 * value


def bar(value: float) -> float:
    """A pressure [bar] in Pa."""
    return 1e5 * value


def rpm(value: float) -> float:
    """A speed [rpm] in rad/s."""
    return hertz(value) / 60


def percent(value: float) -> float:
    """Per cent as a share."""
    return value / 100


GROUPS = ("radial", "thrust")  # of axes
_AXIAL = (
    "The controller of the thrust axis; default: that of the controller file, else the machine "
    "file's PID."
)
# What the verbs of the front door take beside machine, controller, records and files.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AsItRuns(Options):
    """When a loop runs.

    rate [Hz]: it is sampled; delay_samples: from measured errors to currents set (None: as the
    controller or the machine file says, ``law.loop.timing_of``).
    """

    rate: float | None = option(
        None,
        "Sample rate; default: the controller's or the machine file's.",
        flag="--rate-hz",
        check=positive("10000 Hz is usual"),
    )
    delay_samples: int | None = option(
        None,
        "Loop delay, from measured errors to currents set; default: the controller's, the "
        "machine file's, or 1.",
        check=count("1 is usual", "the computing delay"),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verifying(AsItRuns):
    """How a controller is judged.

    axial: the controller of the thrust axis, where the other does not hold it. axes: the one group
    of axes that is judged (None: all). tolerances: the tolerance boxes, too; everywhere: bounds and
    proofs over them around every operating point, not the first alone; informed: what no
    requirement limits over them, too: mu to the machine's [weights], by how much they might grow
    with stability proved, the input's sensitivity. How fast the machine may move between its
    points: pressure_rate [Pa/s], the fastest change of the seal pressure (None: the machine file's;
    without one nothing is proved for a pressure that changes); pressure_error [Pa], how far off
    what a controller scheduled over the pressure is told may be; speed_rate [rad/s^2], the fastest
    run-up (None: nothing is proved for a speed that changes).
    """

    axial: LawLike | None = option(None, _AXIAL)
    axes: str | None = option(None, "One group of axes.", flag=None, choices=GROUPS)
    tolerances: bool = option(True, "Over the tolerances as well.", flag=None)
    everywhere: bool = option(
        False,
        "Bounds and proofs over the tolerances around every operating point, not the first alone.",
    )
    informed: bool = option(True, "Over the tolerances what no requirement limits.", flag=None)
    pressure_rate: float | None = option(
        None,
        'Fastest change of the seal pressure, such as "20 bar/s", for a proof while it changes; '
        "default: the machine file's.",
        dimension="pressure per time",
        metavar="RATE",
        check=positive("give the fastest change in Pa/s, or leave it out"),
    )
    pressure_error: float = option(
        0.0,
        'Largest error of the pressure reading of a scheduled controller, such as "0.4 bar"; '
        "default: none.",
        dimension="pressure",
        metavar="PRESSURE",
        check=positive("give it in Pa", zero_allowed=True),
    )
    speed_rate: float | None = option(
        None,
        "Fastest run-up, rad/s^2, for a proof while the speed changes, over the tolerances as "
        "well; default: none is tried.",
        check=positive("give the fastest run-up in rad/s^2"),
    )


# of a controller that takes over from one scheduled over pressure
READING_ERROR: dict[str, Any] = {
    "meaning": 'With --fallback: how far off the reading may be, such as "0.4 bar"; an estimate '
    "trims it by as much.",
    "dimension": "pressure",
    "metavar": "PRESSURE",
}
STUCK_AFTER: dict[str, Any] = {
    "meaning": "With --fallback: longest time without a change of the reading; default: not "
    "checked.",
    "metavar": "SECONDS",
}
_ONE_LAW = "the linear loop has all modes, no noise and one controller; leave one of the two out"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulating(AsItRuns):
    """How a scenario is run: on the nonlinear virtual rig or, linear, on the linear closed loop.

    axial: the controller of the thrust axis, where the other does not hold it; all axes then run
    together. axes: the one group that runs. second: takes over at the scenario's switch_at.
    fallback: the fixed controller that takes over where the pressure that a schedule is told cannot
    be trusted; pressure_rate [Pa/s]: how fast that may change (None: the machine file's),
    pressure_error [Pa]: how far off the reading may be, stuck_after [s]: how long it may be the
    very same (None: for ever); estimate: a seal monitor runs "beside" the reading, or "alone" in
    place of it. bending_modes: per plane of the rig (None: 3, as identification models). seed: of
    the sensors' noise. path (.h5): where the record is written while it grows. every: only each so
    many-th sample is recorded; dt [s]: longest integration step (None: by the machine's fastest
    pole); computing_delay [samples]: of the rig (None: that of the timing).
    """

    rules: ClassVar[Rules] = (
        (
            (
                *("bending_modes", "seed", "second", "fallback", "axial"),
                *("path", "every", "dt", "computing_delay"),
            ),
            "linear",
            False,
            _ONE_LAW,
        ),
        (
            ("pressure_rate", "pressure_error", "stuck_after", "estimate"),
            "fallback",
            True,
            "name the controller that takes over",
        ),
    )
    axial: LawLike | None = option(None, _AXIAL)
    axes: str | None = option(None, "One group of axes.", flag=None, choices=GROUPS)
    linear: bool = option(False, "The linear model instead of the nonlinear virtual rig.")
    second: LawLike | None = option(
        None, "A controller that takes over at the scenario's switch_at."
    )
    fallback: LawLike | None = option(
        None, "Fixed controller for when a schedule's pressure cannot be trusted."
    )
    pressure_rate: float | None = option(
        None,
        'With --fallback: the fastest change believed, such as "80 bar/s".',
        dimension="pressure per time",
        metavar="RATE",
    )
    pressure_error: float = option(0.0, **READING_ERROR)
    stuck_after: float | None = option(None, **STUCK_AFTER)
    estimate: str | None = option(
        None,
        "With --fallback: a seal monitor checks the pressure reading (beside), or its estimate "
        "replaces the reading (alone).",
        choices=("beside", "alone"),
    )
    bending_modes: int | None = option(
        None, "Bending modes per plane of the rig; default: 3, as identify models."
    )
    seed: int = option(0, "Of the sensors' noise on the rig; default: 0.")
    path: str | Path | None = option(None, "Of the record, written while it grows.", flag=None)
    every: int = option(1, "Samples are left out between those recorded.", flag=None)
    dt: float | None = option(None, "Longest integration step, s.", flag=None)
    computing_delay: int | None = option(None, "Of the rig, samples.", flag=None)


PARTS = ("poles", "campbell", "pulses", "unbalance")  # of a map


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exploring(AsItRuns):
    """What is mapped of a loop over its range, and how far.

    parts: some of PARTS (none: all). pressure [Pa], speed [rad/s]: of a map of the poles, from and
    to (None: zero to twice the largest pressure, to 1.2 times the top speed). bound: an upper bound
    beside the worst unbalance found, which takes longer.
    """

    parts: Sequence[str] = option(
        PARTS, "Only this (repeatable); default: all.", flag="--what", choices=PARTS, many=True
    )
    pressure: tuple[float, float] | None = option(
        None,
        "Poles over this range of the seal pressure.",
        flag="--pressure-bar",
        check=ends,
        convert=bar,
    )
    speed: tuple[float, float] | None = option(
        None, "Poles over this range of the speed.", flag="--speed-rpm", check=ends, convert=rpm
    )
    bound: bool = option(False, "Also compute an upper bound of the worst unbalance response.")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rejecting(Options):
    """A block against unbalance beside a controller.

    synchronous: what it rejects. synchronous_band [rad/s]: where it is on (None: from a tenth of
    the top speed to it). synchronous_time [s]: its time constant (None: as short as the loop
    allows). base: the controller to add it to, in place of a new design.
    """

    rules: ClassVar[Rules] = (
        (
            ("synchronous_band", "synchronous_time", "synchronous_update", "base"),
            "synchronous",
            True,
            "add {} current-free",
        ),
    )
    synchronous: str | None = option(
        None,
        "Design a block as well that rejects the unbalance's signal, and write it into the "
        "controller file.",
        choices=("current-free", "force-free", "vibration-free", "damping"),
    )
    synchronous_band: tuple[float, float] | None = option(
        None,
        "With --synchronous: lowest and highest speed of the block in rad/s; default: 10 to 100 "
        "% of the top speed; for damping, state the speeds around the critical speed.",
    )
    synchronous_time: float | None = option(
        None,
        "With --synchronous: time constant of the block in seconds; default: as short as the "
        "loop allows.",
        check=positive("give 2/eps in seconds"),
    )
    synchronous_update: str | None = option(
        None,
        "With --synchronous: when the block's amplitudes move; default: every sample.",
        choices=("sample", "turn"),
    )
    base: LawLike | None = option(
        None,
        "With --synchronous: the controller file to add the block to, in place of a new design.",
    )
