"""The screens that Python describes, in the order of the work; each is one file here.

A screen is a function ``show(project, given)`` that gives blocks (``blocks.content``), and actions
by name that do something and give blocks as well. What they are given came from a page: words and
numbers to be looked at. They run in a process of their own (``desk``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from ambrose.annexes.workbench.project import Project
from ambrose.core.checks import InvalidInput

Answer = Callable[[Project, Mapping[str, Any]], dict[str, Any]]

# modules of this package, in the order of the work; None: the page has a script of its own for it
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


@dataclass(frozen=True, slots=True)
class Screen:
    """What a module here calls SCREEN: what it shows, and what may be asked of it."""

    show: Answer
    actions: Mapping[str, Answer] = field(default_factory=dict)


def load_all() -> None:
    """Every screen is imported, so that the first question need not wait for it."""
    for name in TITLES:
        if name not in OWN:
            import_module(f"{__name__}.{name}")


def answer(project: Project, name: str, action: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """What a screen answers; action "": what it shows. Raises InvalidInput and Refusal."""
    if name not in TITLES or name in OWN:
        raise InvalidInput(f"there is no screen {str(name)[:60]!r}; reload the page")
    screen: Screen = import_module(f"{__name__}.{name}").SCREEN
    if not action:
        return screen.show(project, given)
    if action not in screen.actions:
        raise InvalidInput(f"the screen {name} cannot {str(action)[:60]!r}; reload the page")
    return screen.actions[action](project, given)
