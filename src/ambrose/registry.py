"""What the annexes add to the house: commands, public names, methods, proofs of motion.

Every package below ``ambrose.annexes`` states in its ``__init__`` one table of plain data,

    ANNEX = {"command": {"accept": "accept_command:accept"}, "public": {"accept": "acceptance"}},

that is {kind: {name: place}} with a place relative to the annex. The rooms ask here for a kind, and
import no annex: one that is taken off the tree takes with it what it has registered, nothing else.
"""

from __future__ import annotations

import os
from functools import cache
from importlib import import_module

TYPE_CHECKING = False  # typing itself would be most of the time that ``import ambrose`` takes
if TYPE_CHECKING:
    from typing import Any

ANNEXES = "ambrose.annexes"


@cache
def annexes() -> tuple[str, ...]:
    """The names of the annexes that this installation holds, sorted."""
    folders = [entry for root in import_module(ANNEXES).__path__ for entry in os.scandir(root)]
    packages = [f.name for f in folders if os.path.exists(os.path.join(f.path, "__init__.py"))]
    return tuple(sorted(packages))


@cache
def registered(kind: str) -> dict[str, str]:
    """{name: place} of all that the annexes registered of a kind; a place is "module:attribute".

    kind: "command", "public", "page" (of a result, by the name of its type), "method",
    "moving_proof" or "companion". Raises RuntimeError where
    two annexes register one name: that is a defect of the installation, not of the input.
    """
    places: dict[str, str] = {}
    for annex in annexes():
        table = import_module(f"{ANNEXES}.{annex}").ANNEX
        for name, place in table.get(kind, {}).items():
            if name in places:
                raise RuntimeError(f"the {kind} {name!r} is registered twice; take one of them off")
            places[name] = f"{ANNEXES}.{annex}.{place}"
    return places


def resolve(place: str) -> Any:
    """The object at "module:attribute", or the module itself at "module"; imported on first use."""
    module, _, attribute = place.partition(":")
    item = import_module(module)
    return getattr(item, attribute) if attribute else item
