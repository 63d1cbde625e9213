"""A chain of stages as one list: what each is called, what it needs, what makes it.

    made = walk(STAGES, {"machine": machine, "directory": directory, "progress": progress})

A stage is a plain function of results before it, named by ``needs``; what it makes is kept under
its own name. Stages that leave files take up, on their own, what an earlier run left there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Stage:
    """name: of what it makes; needs: the names of its arguments, in order; make: the function;
    announced: what progress is told before it begins ("": the function tells it itself).
    """

    name: str
    needs: tuple[str, ...]
    make: Callable[..., Any]
    announced: str = ""


def walk(stages: Sequence[Stage], given: Mapping[str, Any]) -> dict[str, Any]:
    """All that the stages make, in order, beside what was given, by name.

    stages: each needs only what was given or made before it. given: the results at the beginning,
    with ``progress`` among them, a function that is told the stages' announcements. Raises what
    the stages raise.
    """
    made = dict(given)
    for stage in stages:
        if stage.announced:
            made["progress"](stage.announced)
        made[stage.name] = stage.make(*(made[name] for name in stage.needs))
    return made
