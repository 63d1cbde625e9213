"""The `ambrose` command. Exit status: 0 done and all required checks passed, 1 done but a check
failed, 2 bad input, 130 interrupted.

Results go to standard output (with --json exactly one JSON object, also where the input is refused:
its error and status), progress and errors to standard error.
"""

from __future__ import annotations

import os
import sys
from contextlib import AbstractContextManager, nullcontext
from typing import Any, NoReturn

import click
from click.exceptions import NoArgsIsHelpError

from ambrose.cli.check import check, machines, scenarios
from ambrose.cli.convert import convert
from ambrose.cli.convert_controller import convert_controller
from ambrose.cli.export import export
from ambrose.cli.identify import identify
from ambrose.cli.identify_generic import identify_generic
from ambrose.cli.map import map_command
from ambrose.cli.new import new
from ambrose.cli.record_check import record_check
from ambrose.cli.seal import seal
from ambrose.cli.simulate import simulate
from ambrose.cli.study import study_command
from ambrose.cli.synthesize import synthesize
from ambrose.cli.trade_off import trade_off
from ambrose.cli.verify import verify
from ambrose.machine.messages import BULLET
from ambrose.registry import registered, resolve
from ambrose.terminal import say, say_json, streams_settled
from ambrose.version import __version__


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
                        (f"{name:{width}}", command.get_short_help_str(room))
                        for name, command in commands.items()
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
        as_json = "--json" in (sys.argv[1:] if args is None else args)
        with streams_settled():
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

                if not isinstance(error, AmbroseError):
                    raise
                stop(str(error), as_json=as_json)
            sys.exit(status if isinstance(status, int) else 0)


def _one_thread() -> AbstractContextManager[None]:
    """Linear algebra in one thread: told to the libraries before they are loaded, so that no thread
    is started, or to those that a program has loaded which calls this command.
    """
    if "numpy" not in sys.modules:
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        return nullcontext()
    from ambrose.core.threads import one_thread

    return one_thread()


def stop(message: str, status: int = 2, *, as_json: bool = False) -> NoReturn:
    first, *others = message.split(BULLET)
    say(f"ambrose: {first}", err=True)
    for line in others:
        say(f"  - {line}", err=True)
    if as_json:
        say_json({"error": message, "status": status}, unless_said=True)
    sys.exit(status)


@click.group(cls=AmbroseCommand, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="ambrose")
def main() -> None:
    """Rotors on active magnetic bearings with destabilising seal forces: model, control,
    verification, report.

    MACHINE is a machine file (*.toml) or the name of a bundled machine; see `ambrose machines`.
    """


# the commands by what they are for; annexes add theirs
GROUPS: dict[str, dict[str, click.Command]] = {
    "Design": {
        "machines": machines,
        "scenarios": scenarios,
        "new": new,
        "check": check,
        "synthesize": synthesize,
        "verify": verify,
        "simulate": simulate,
        "export": export,
        "study": study_command,
    },
    "Site": {
        "record check": record_check,
        "identify": identify,
        "identify --generic": identify_generic,
        "convert": convert,
        "convert controller": convert_controller,
    },
    "Research": {"trade-off": trade_off, "map": map_command, "seal": seal},
}
for title, commands in GROUPS.items():
    for name, place in registered(f"{title.lower()} command").items():
        commands[name] = resolve(place)
    for name, command in commands.items():
        main.add_command(command, name)
