"""Control of rotors on active magnetic bearings with destabilising seal forces. Read ``workflow.py`` first."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from ambrose.core.lft import GeneralizedPlant
    from ambrose.core.statespace import StateSpace
    from ambrose.machine.file.toml import load_machine

__all__ = ["GeneralizedPlant", "StateSpace", "__version__", "load_machine"]

_HOME = {
    "GeneralizedPlant": "ambrose.core.lft",
    "StateSpace": "ambrose.core.statespace",
    "load_machine": "ambrose.machine.file.toml",
}


def __getattr__(name: str) -> Any:
    """Public names are imported on first use, so that ``import ambrose`` stays fast."""
    if name in _HOME:
        return getattr(import_module(_HOME[name]), name)
    raise AttributeError(f"module 'ambrose' has no attribute {name!r}")
