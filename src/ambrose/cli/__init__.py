"""The `ambrose` command. Exit status: 0 done and all required checks passed, 1 done but a check failed, 2 bad input.

Results go to standard output (with --json exactly one JSON object), progress and errors to standard error.
"""

from __future__ import annotations

import os
import sys
from typing import Any

import click

from ambrose.cli.check import check, machines
from ambrose.cli.convert import convert
from ambrose.cli.export import export
from ambrose.cli.identify import identify
from ambrose.cli.simulate import simulate
from ambrose.cli.study import study_command
from ambrose.cli.synthesize import synthesize
from ambrose.cli.verify import verify
from ambrose.version import __version__


class AmbroseCommand(click.Group):
    """Turns every refusal of the package, and every file that cannot be used, into one message and exit status 2."""

    def invoke(self, ctx: click.Context) -> Any:
        # Before numpy is loaded: at these sizes (some hundred states) BLAS threads cost more than they bring.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        from ambrose.core.checks import AmbroseError

        try:
            return super().invoke(ctx)
        except AmbroseError as error:
            stop(str(error))
        except OSError as error:
            stop(f"{error.filename or 'file'}: {error.strerror or error}; check that it exists and may be read or written")
        except KeyboardInterrupt:
            stop("interrupted; what was finished before stays on disk", 130)


def stop(message: str, status: int = 2) -> None:
    click.echo(f"ambrose: {message}", err=True)
    sys.exit(status)


@click.group(cls=AmbroseCommand, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="ambrose")
def main() -> None:
    """Rotors on active magnetic bearings with destabilising seal forces: model, control, verification, report.

    MACHINE is a machine file (*.toml) or the name of a bundled machine; see `ambrose machines`.
    """


for command in (machines, check, synthesize, verify, simulate, identify, convert, export, study_command):
    main.add_command(command)
