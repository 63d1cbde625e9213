"""`ambrose workbench`."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import click

from ambrose.terminal import say

_EXTRA = (
    "the workbench needs starlette, uvicorn and websockets; install them with "
    "pip install 'ambrose[workbench]'"
)


@click.command()
@click.argument("folder", required=False, type=click.Path(path_type=Path))
@click.option("--demo", is_flag=True, help="Begin with the seal rig, in the folder seal-rig-demo.")
@click.option("--new", is_flag=True, help="Make FOLDER where there is none.")
@click.option("--no-browser", is_flag=True, help="Print the address and open nothing.")
@click.option(
    "--listen",
    metavar="ADDRESS",
    default="127.0.0.1",
    show_default=True,
    help="An address of this computer in a network that may see the workbench, unencrypted.",
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Default: a free one.")
def workbench(
    folder: Path | None, demo: bool, new: bool, no_browser: bool, listen: str, port: int
) -> None:
    """The chain in a browser: a live rig to push, and all steps for one project folder.

    FOLDER (default: this one) holds the machine file machine.toml, controllers, records, runs,
    reports and jobs, all of them files that the other commands read. The address that is printed is
    good once; whoever opens it may do here what you may. Ctrl-C ends it, with all that it started.
    """
    from ambrose.core.checks import InvalidInput
    from ambrose.core.processes import listening

    try:
        from ambrose.annexes.workbench.server import serve
    except ModuleNotFoundError as error:
        if error.name not in {"starlette", "uvicorn", "websockets", "anyio"}:
            raise
        raise InvalidInput(_EXTRA) from None
    from ambrose.annexes.workbench.project import Project, begin

    if folder is not None and not folder.is_dir() and not (new or demo):
        raise InvalidInput(
            f"there is no folder {folder}; correct its name, or add --new to begin a project there"
        )
    project = Project(folder or (Path("seal-rig-demo") if demo else Path()))
    if demo and not project.machine.exists():
        begin(project, "seal-rig")
    listener = listening(listen, port)
    opened: list[str] = []

    def announce(address: str) -> None:
        # what follows the first is for a second browser
        say(f"Another browser: {address}" if opened else f"Workbench of {project.root}: {address}")
        if not opened and not no_browser:
            webbrowser.open(address)
        opened.append(address)

    serve(project, listener, announce)
