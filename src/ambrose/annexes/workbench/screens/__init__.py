"""The screens that Python describes, in the order of the work; related ones in one file.

A screen is a function ``show(project, given)`` that gives blocks (``blocks.content``), and actions
by name that do something and give blocks as well. What they are given came from a page: words and
numbers to be looked at. They run in a process of their own (``desk``).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from ambrose.annexes.workbench.project import Project
from ambrose.core.checks import InvalidInput

Answer = Callable[[Project, Mapping[str, Any]], dict[str, Any]]

# in the order of the work; OWN: the page has a script of its own for it
TITLES: dict[str, str] = {
    "machine": "Machine",
    "records": "Records",
    "identification": "Identification",
    "controllers": "Controllers",
    "envelope": "Envelope",
    "live": "Live rig",
    "acceptance": "Acceptance",
    "deploy": "Deploy",
    "retuning": "Retuning",
    "studies": "Studies",
    "jobs": "Jobs",
}
OWN = ("live", "jobs")
# the module here that describes a screen, as SCREEN_MACHINE and so on
_PLACES = {
    **dict.fromkeys(("machine", "records"), "machine"),
    "controllers": "controllers",
    **dict.fromkeys(("identification", "acceptance", "retuning"), "site"),
    **dict.fromkeys(("envelope", "deploy", "studies"), "studies"),
}


@dataclass(frozen=True, slots=True)
class Screen:
    """What a screen shows, and what may be asked of it."""

    show: Answer
    actions: Mapping[str, Answer] = field(default_factory=dict)


def load_all() -> None:
    """Every screen is imported, so that the first question need not wait for it."""
    for place in _PLACES.values():
        import_module(f"{__name__}.{place}")


def answer(project: Project, name: str, action: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """What a screen answers; action "": what it shows. Raises InvalidInput and Refusal."""
    if name not in _PLACES:
        raise InvalidInput(f"there is no screen {str(name)[:60]!r}; reload the page")
    module = import_module(f"{__name__}.{_PLACES[name]}")
    screen: Screen = getattr(module, f"SCREEN_{name.upper()}")
    if not action:
        return screen.show(project, given)
    if action not in screen.actions:
        raise InvalidInput(f"the screen {name} cannot {str(action)[:60]!r}; reload the page")
    return screen.actions[action](project, given)
