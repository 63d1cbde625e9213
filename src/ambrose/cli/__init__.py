"""The `ambrose` command. Exit status: 0 done and all required checks passed, 1 done but a check
failed, 2 bad input, 130 interrupted.

Results go to standard output (with --json exactly one JSON object, also where the input is refused:
its error and status), progress and errors to standard error.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator, MutableMapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, NoReturn

import click
from click.exceptions import NoArgsIsHelpError

from ambrose.machine.units import BULLET
from ambrose.registry import registered, resolve
from ambrose.terminal import say, say_json, streams_settled
from ambrose.version import __version__


class OnDemand(MutableMapping[str, click.Command]):
    """Commands by name, each imported when it is asked for: what one call does not need is not
    loaded.

    places: {name: the command, or its "module:attribute"}.
    """

    def __init__(self, places: dict[str, Any]) -> None:
        self.places = places

    def __getitem__(self, name: str) -> click.Command:
        command: click.Command = resolve(self.places[name])
        return command

    def __setitem__(self, name: str, command: click.Command) -> None:
        self.places[name] = command

    def __delitem__(self, name: str) -> None:
        del self.places[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)


class AmbroseCommand(click.Group):
    """Turns every refusal of the package, and every file that cannot be used, into one message and
    exit status 2.
    """

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Names of two words, too; the second one may be an option, anywhere after the first."""
        for place, word in enumerate(args[1:], 1):
            two = f"{args[0]} {word}"
            if two in self.commands and (place == 1 or word.startswith("--")):
                rest = [*args[1:place], *args[place + 1 :]]
                return super().resolve_command(ctx, [two, *rest])
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The commands by what they are for, each group in its own order."""
        width = max(len(name) for name in self.commands)
        room = formatter.width - 6 - width
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl(
                    [
                        (f"{name:{width}}", self.commands[name].get_short_help_str(room))
                        for name in commands
                    ]
                )

    def main(  # type: ignore[override]
        self, args: Any = None, prog_name: Any = None, *, standalone_mode: bool = True, **extra: Any
    ) -> Any:
        with _one_thread():
            return self._main(args, prog_name, standalone_mode, **extra)

    def _main(self, args: Any, prog_name: Any, standalone_mode: bool, **extra: Any) -> Any:
        if not standalone_mode:
            return super().main(args, prog_name, standalone_mode=False, **extra)
        given = sys.argv[1:] if args is None else args
        as_json = "--json" in given
        if any("\0" in str(word) for word in given):  # of a program that calls this command
            stop("an argument contains a null character; leave it out", as_json=as_json)
        with streams_settled(), _no_path_of_the_source():
            try:
                status = super().main(args, prog_name, standalone_mode=False, **extra)
            except OSError as error:
                remedy = "check that it exists, may be read or written, and has room"
                stop(
                    f"{error.filename or 'file'}: {error.strerror or error}; {remedy}",
                    as_json=as_json,
                )
            except (KeyboardInterrupt, click.Abort):
                stop("interrupted; what was finished before stays on disk", 130, as_json=as_json)
            except click.ClickException as error:
                context = getattr(error, "ctx", None)
                if isinstance(error, NoArgsIsHelpError):
                    error.show()
                else:
                    usage = context.get_usage().splitlines() if context else ()
                    for line in (*usage, f"Error: {error.format_message()}"):
                        say(line, err=True)
                    if as_json:
                        say_json({"error": error.format_message(), "status": 2}, unless_said=True)
                sys.exit(2)
            except Exception as error:
                # with numpy, which --help does without
                from ambrose.core.checks import AmbroseError

                if isinstance(error, AmbroseError):
                    stop(str(error), as_json=as_json)
                if os.environ.get("AMBROSE_TRACEBACK"):
                    raise
                stop(_broken_down(error), as_json=as_json)
            sys.exit(status if isinstance(status, int) else 0)


def _broken_down(error: Exception) -> str:
    """What is said where the program itself is at fault, or met numbers that nothing refused."""
    if isinstance(error, ArithmeticError | RuntimeWarning):
        return (
            "the calculation broke down: a number on its way overflows or is undefined; look for "
            "one with a wrong unit or exponent (ambrose check names them)"
        )
    return (
        f"the calculation broke down ({type(error).__name__}), which is a fault of this program or "
        "an input that it should have refused; set AMBROSE_TRACEBACK=1 and report what it prints"
    )


@contextmanager
def _no_path_of_the_source() -> Iterator[None]:
    """Numbers that overflow or become undefined end the command instead of a warning with a place
    in the source; other warnings are a line each.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("error", ".*encountered in", RuntimeWarning)
        warnings.showwarning = lambda message, *_, **__: say(f"note: {message}", err=True)
        yield


def _one_thread() -> AbstractContextManager[None]:
    """Linear algebra in one thread: told to the libraries before they are loaded, so that no thread
    is started, or to those that a program has loaded which calls this command.
    """
    if "numpy" not in sys.modules:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        return nullcontext()
    from ambrose.core.processes import one_thread

    return one_thread()


def stop(message: str, status: int = 2, *, as_json: bool = False) -> NoReturn:
    first, *others = message.split(BULLET)
    say(f"ambrose: {first}", err=True)
    for line in others:
        say(f"  - {line}", err=True)
    if as_json:
        say_json({"error": message, "status": status}, unless_said=True)
    sys.exit(status)


# the places of commands by what they are for; annexes add theirs
GROUPS: dict[str, dict[str, str]] = {
    "Design": {
        "machines": "ambrose.cli.machine_commands:machines",
        "scenarios": "ambrose.cli.machine_commands:scenarios",
        "new": "ambrose.cli.machine_commands:new",
        "check": "ambrose.cli.machine_commands:check",
        "synthesize": "ambrose.cli.controller_commands:synthesize",
        "verify": "ambrose.cli.controller_commands:verify",
        "simulate": "ambrose.cli.run_commands:simulate",
        "export": "ambrose.cli.controller_commands:export",
        "study": "ambrose.cli.run_commands:study_command",
    },
    "Site": {
        "record check": "ambrose.cli.record_commands:record_check",
        "identify": "ambrose.cli.record_commands:identify",
        "identify --generic": "ambrose.cli.record_commands:identify_generic",
        "convert": "ambrose.cli.machine_commands:convert",
        "convert controller": "ambrose.cli.machine_commands:convert_controller",
    },
    "Research": {
        "trade-off": "ambrose.cli.controller_commands:trade_off",
        "map": "ambrose.cli.controller_commands:map_command",
        "seal": "ambrose.cli.record_commands:seal",
    },
}
for title, commands in GROUPS.items():
    commands.update(registered(f"{title.lower()} command"))


@click.group(
    cls=AmbroseCommand,
    commands=OnDemand({name: place for group in GROUPS.values() for name, place in group.items()}),
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.version_option(__version__, prog_name="ambrose")
def main() -> None:
    """Rotors on active magnetic bearings with destabilising seal forces: model, control,
    verification, report.

    MACHINE is a machine file (*.toml) or the name of a bundled machine; see `ambrose machines`.
    """
