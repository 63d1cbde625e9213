"""Simulated or measured time responses as Curves: one for the displacements, one for the currents of a trace."""

from __future__ import annotations

from collections.abc import Sequence

from ambrose.core.checks import InvalidInput
from ambrose.machine.machine import Machine
from ambrose.simulation.trace import Trace
from ambrose.verification.checks import Curve

_KINDS = (("y", "displacement", "m"), ("i", "current", "A"), ("u", "controller output", "A"))


def trace_curves(trace: Trace, machine: Machine, kinds: Sequence[str] = ("y", "i")) -> tuple[Curve, ...]:
    """The signals of a trace at the control axes, grouped: "y" displacements [m], "i" currents, "u" controller output [A].

    The curves are named "<scenario>.<kind in words>", so that traces of one scenario at several operating points share
    figures, and carry the touchdown gap or the largest control current of the bearings as limits. Kinds that the record does
    not hold are left out. Raises InvalidInput for an unknown kind.
    """
    curves = []
    for kind in kinds:
        found = [row for row in _KINDS if row[0] == kind]
        if not found:
            raise InvalidInput(f"the kind of signal is {kind!r}, but must be one of y, i, u")
        _, words, unit = found[0]
        names = tuple(name for axis in machine.axes if (name := f"{kind}_{axis}") in trace.record.signals)
        if names:
            values = trace.record.select(names).values
            title = f"{trace.scenario}: {words}"
            labels = tuple(name.removeprefix(f"{kind}_") for name in names)
            limits = _limits(machine, kind)
            name = f"{trace.scenario}.{words.replace(' ', '_')}"
            curves.append(Curve(name, title, "time", trace.record.time, values, labels, "s", unit, limits))
    return tuple(curves)


def _limits(machine: Machine, kind: str) -> tuple[tuple[str, float], ...]:
    """The tightest limit of the bearings, on both sides."""
    words, values = (
        ("touchdown gap", [bearing.touchdown_gap for bearing in machine.bearings])
        if kind == "y"
        else ("largest control current", [bearing.max_current for bearing in machine.bearings])
    )
    known = [value for value in values if value is not None]
    return ((words, min(known)), (words, -min(known))) if known else ()
