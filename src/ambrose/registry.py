"""What can be added to the house: commands, public names, methods, proofs of motion, effects.

Every package below ``ambrose.annexes`` states in its ``__init__`` one table of plain data,

    ANNEX = {"site command": {"accept": "accept_command:accept"}, "public": {...}},

that is {kind: {name: place}} with a place relative to the annex. The rooms ask here for a kind, and
import no annex: one that is taken off the tree takes with it what it has registered, nothing else.

A room that lower rooms ask for what it holds states the same table: ``ambrose.model.effects`` lists
its physical effects, which the room of machine files asks for by their tables. ``register`` adds
one from outside of the tree, for the life of the process.
"""

from __future__ import annotations

import os
from functools import cache
from importlib import import_module

TYPE_CHECKING = False  # typing itself would be most of the time that ``import ambrose`` takes
if TYPE_CHECKING:
    from typing import Any

ANNEXES = "ambrose.annexes"
# rooms that state a table of their own, ROOM, and what was added by ``register``: kind -> name
ROOMS = ("ambrose.model.effects",)
_ADDED: dict[str, dict[str, Any]] = {}


@cache
def annexes() -> tuple[str, ...]:
    """The names of the annexes that this installation holds, sorted."""
    folders = [entry for root in import_module(ANNEXES).__path__ for entry in os.scandir(root)]
    packages = [f.name for f in folders if os.path.exists(os.path.join(f.path, "__init__.py"))]
    return tuple(sorted(packages))


def registered(kind: str) -> dict[str, Any]:
    """{name: place} of all that rooms and annexes registered of a kind; a place is
    "module:attribute", or the object itself where it came by ``register``.

    kind: "design command", "site command" or "research command" (the groups of the command line's
    help), "public", "page" (of a result, by the name of its type), "method", "moving_proof",
    "companion", "effect", "beside" (what is done with the blocks beside a law) or "study file"
    (what a study leaves besides its report). Raises RuntimeError where two register one name: a
    defect of the installation, not of the input.
    """
    return {**_stated(kind), **_ADDED.get(kind, {})}


@cache
def _stated(kind: str) -> dict[str, str]:
    """What the tables of rooms and annexes state of a kind."""
    places: dict[str, str] = {}
    tables = [(room, import_module(room).ROOM) for room in ROOMS]
    for package in (f"{ANNEXES}.{annex}" for annex in annexes()):
        tables.append((package, import_module(package).ANNEX))
    for package, table in tables:
        for name, place in table.get(kind, {}).items():
            if name in places:
                raise RuntimeError(f"the {kind} {name!r} is registered twice; take one of them off")
            places[name] = f"{package}.{place}"
    return places


def register(kind: str, name: str, item: Any) -> None:
    """Add something from outside of the tree: the object itself, or its "module:attribute".

    kind, name: as in ``registered``. Raises RuntimeError where the name is taken.
    """
    if name in registered(kind):
        raise RuntimeError(f"the {kind} {name!r} is registered already; take the other one off")
    _ADDED.setdefault(kind, {})[name] = item


def unregister(kind: str, name: str) -> None:
    """Take off what ``register`` added. Raises KeyError where it added nothing of this name."""
    del _ADDED[kind][name]


def resolve(place: Any) -> Any:
    """The object at "module:attribute", or the module itself at "module"; imported on first use.
    What is no text is the object already.
    """
    if not isinstance(place, str):
        return place
    module, _, attribute = place.partition(":")
    item = import_module(module)
    return getattr(item, attribute) if attribute else item
