"""A chain of stages as one list: what each is called, what it needs, what makes it.

    made = walk(STAGES, {"machine": machine, "directory": directory, "progress": progress})

A stage is a plain function of results before it, named by ``needs``; what it makes is kept under
its own name. Stages that leave files take up, on their own, what an earlier run left there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ambrose.core.checks import AmbroseError

REQUIRED = object()
# what a stage may end with besides a refusal: a defect of one is none of the others' results
FAILURES = (AmbroseError, ArithmeticError, LookupError, TypeError, ValueError, OSError)


@dataclass(frozen=True, slots=True)
class Stage:
    """name: of what it makes; needs: the names of its arguments, in order; make: the function;
    announced: what progress is told before it begins ("": the function tells it itself);
    otherwise: what stands in its place where it fails (REQUIRED: the chain ends there).
    """

    name: str
    needs: tuple[str, ...]
    make: Callable[..., Any]
    announced: str = ""
    otherwise: Any = REQUIRED


def walk(stages: Sequence[Stage], given: Mapping[str, Any]) -> dict[str, Any]:
    """All that the stages make, in order, beside what was given, by name; and "failures", a list of
    (stage, why) of those that failed and have something else in their place.

    stages: each needs only what was given or made before it. given: the results at the beginning,
    with ``progress`` among them, a function that is told the stages' announcements. Raises what
    the required stages raise.
    """
    failures: list[tuple[str, str]] = []
    results = {**given, "failures": failures}
    for stage in stages:
        if stage.announced:
            results["progress"](stage.announced)
        try:
            results[stage.name] = stage.make(*(results[name] for name in stage.needs))
        except FAILURES as error:
            if stage.otherwise is REQUIRED:
                raise
            known = isinstance(error, AmbroseError)
            why = str(error) if known else f"{type(error).__name__}: {error}"
            name = stage.name.replace("_", " ")
            results["progress"](f"no {name}; {why}")
            failures.append((name, why))
            results[stage.name] = stage.otherwise
    return results
