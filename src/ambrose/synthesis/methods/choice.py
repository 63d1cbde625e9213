"""The methods of this installation by their names."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from ambrose.registry import registered, resolve
from ambrose.synthesis.methods.hinf import Hinf
from ambrose.synthesis.methods.method import Method
from ambrose.synthesis.methods.mu import Mu
from ambrose.synthesis.methods.pid import Pid
from ambrose.synthesis.methods.polish import Polish
from ambrose.synthesis.methods.tuned import Tuned


@cache
def methods() -> Mapping[str, type[Method]]:
    """{name: its class}, those of the annexes last."""
    kinds = [Tuned, Pid, Hinf, Mu, Polish, *map(resolve, registered("method").values())]
    return {kind.name: kind for kind in kinds}
