"""A scenario in terms of the machine: its "first", "last" and "every" bearing, and shares of its
top speed or pressure.

A scenario file may say ``signal = "e_first_zeta"``, ``port = "every"`` or ``to_speed = "80 % of top
speed"``; what that is, the machine says. Of "every" bearing a grade of unbalance is parted among
them, and each has a binary sequence of its own.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

from ambrose.core.checks import InvalidInput
from ambrose.machine.axial import AXIS, AxialMachine
from ambrose.machine.description import BEARING_TERMS
from ambrose.machine.machine import Machine
from ambrose.machine.units import DIMENSIONS, Dimension, read_quantity
from ambrose.model.plant import top_speed
from ambrose.rig.disturbances import Prbs, Unbalance

_SEEDS = 2  # axes of a bearing: two sequences at one bearing have neighbouring seeds
_THRUST = f"thrust{AXIS}"  # the axis along the shaft, whatever its bearing's name
_PHRASE = re.compile(r"(.+?)\s+of\s+(?:the\s+)?([a-z]+ [a-z]+)")


class Share(float):
    """A share of a quantity of the machine, until a machine is known; ``of`` is its name."""

    of: str

    def __new__(cls, share: float, of: str) -> Share:
        value = super().__new__(cls, share)
        value.of = of
        return value

    def __repr__(self) -> str:
        return f"{100 * self:g} % of {self.of}"


def _top_pressure(machine: Machine) -> float | None:
    return max(point.seal_pressure for point in machine.operation.envelope)


def _least(name: str) -> Callable[[Machine], float | None]:
    """Of the bearings; of an axial one's pair the lesser."""
    return lambda machine: min(
        (
            min(v) if isinstance(v, tuple) else v
            for b in machine.axis_bearings
            if (v := getattr(b, name)) is not None
        ),
        default=None,
    )


def _thrusts(machine: Machine) -> list[float]:
    """The process thrust [N] at every operating point of the axis along the shaft."""
    return (
        [item.load for item in machine.conditions] if isinstance(machine, AxialMachine) else [0.0]
    )


_QUANTITIES: dict[str, tuple[str, Callable[[Machine], float | None], str]] = {
    "top speed": ("angular rate", top_speed, "[operation] speed_range"),
    "balance speed": (
        "angular rate",
        lambda m: m.requirements.balance_speed or top_speed(m) or None,
        "[operation] speed_range",
    ),
    "top pressure": ("pressure", _top_pressure, "an [[operation.point]] with seal_pressure"),
    "max current": ("current", _least("max_current"), "max_current of a [[bearing]]"),
    "largest thrust": (
        "force",
        lambda machine: max(_thrusts(machine), key=abs) or None,
        "a [[thrust_bearing.load]], and take file.toml#axial",
    ),
    "thrust range": (
        "force",
        lambda machine: max(_thrusts(machine)) - min(_thrusts(machine)) or None,
        "[[thrust_bearing.load]] of two points, and take file.toml#axial",
    ),
    "touchdown gap": ("length", _least("touchdown_gap"), "touchdown_gap of a [[bearing]]"),
}


def read_share(value: Any, dimension: Dimension) -> Share | None:
    """The share that a text such as "80 % of top speed" says; None for anything else. Raises
    InvalidInput, ValueError.
    """
    match = _PHRASE.fullmatch(value.strip()) if isinstance(value, str) else None
    if not match:
        return None
    names = [name for name, (kind, *_) in _QUANTITIES.items() if DIMENSIONS[kind] is dimension]
    if match[2] not in names:
        raise ValueError(
            f"is {value!r}, but may be a share of {' or '.join(names) or 'nothing'} only; correct "
            "it"
        )
    return Share(read_quantity(match[1], DIMENSIONS["ratio"]), match[2])


def relative_values(item: Any) -> Iterator[Share]:
    """All shares in a dataclass, the tuples in it and their items."""
    if isinstance(item, Share):
        yield item
    elif isinstance(item, tuple):
        for part in item:
            yield from relative_values(part)
    elif is_dataclass(item):
        for field in fields(item):
            yield from relative_values(getattr(item, field.name))


def with_quantities(item: Any, machine: Machine) -> Any:
    """The same with the machine's numbers in place of shares. Raises InvalidInput where the machine
    does not state one.
    """
    if isinstance(item, Share):
        _, value_of, key = _QUANTITIES[item.of]
        value = value_of(machine)
        if value is None:
            raise InvalidInput(
                f"the scenario needs the {item.of} of machine {machine.name!r}, which states "
                f"none; add {key}"
            )
        return float(item) * value
    if isinstance(item, tuple):
        return tuple(with_quantities(part, machine) for part in item)
    if is_dataclass(item) and not isinstance(item, type) and any(relative_values(item)):
        return replace(
            item,
            **{
                f.name: with_quantities(getattr(item, f.name), machine)
                for f in fields(item)
                if f.init
            },
        )
    return item


def at_bearings(items: Sequence[Any], bearings: Sequence[str]) -> tuple[Any, ...]:
    """Disturbances, unbalances or failures with the names of these bearings in place of "first",
    "last" and "every".
    """
    return tuple(made for item in items for made in _at(item, bearings))


def _at(item: Any, bearings: Sequence[str]) -> Iterator[Any]:
    key = next((name for name in ("signal", "port", "axis") if hasattr(item, name)), "")
    text = getattr(item, key, None) or ""
    before, word, after = _parted(text)
    if word not in BEARING_TERMS:
        yield item
        return
    chosen = {"first": bearings[:1], "last": bearings[-1:], "every": bearings}[word]
    for number, name in enumerate(chosen):
        changes: dict[str, Any] = {}
        if isinstance(item, Unbalance):
            changes = (
                {"amount": item.amount / len(chosen)}
                if item.amount is not None
                else {"share": item.share / len(chosen)}
            )
        elif isinstance(item, Prbs):
            changes = {"seed": item.seed + _SEEDS * number}
        yield replace(item, **{key: f"{before}{name}{after}"}, **changes)


def along_shaft(items: Sequence[Any], axis: str) -> tuple[Any, ...]:
    """The same on the one axis of ``AxialMachine``: what is along a bearing's first direction acts
    on it, what is along its second one on nothing.
    """
    name, found = axis.removesuffix(AXIS), []
    for item in items:
        key = next((key for key in ("signal", "axis") if getattr(item, key, None)), "")
        text = getattr(item, key, "") if key else ""
        if text.endswith(f"{name}_zeta"):
            found.append(replace(item, **{key: f"{text.removesuffix('_zeta')}{AXIS}"}))
        elif not text.endswith(f"{name}_eta"):
            found.append(item)
    return tuple(found)


def names_thrust(item: Any) -> bool:
    """Whether a disturbance or failure is along the shaft by its name: e_thrust_z, f_T_z, T_z."""
    text = getattr(item, "signal", None) or getattr(item, "axis", None) or ""
    return bool(text.endswith(AXIS))


def on_thrust(items: Sequence[Any], axis: str) -> tuple[Any, ...]:
    """What is along the shaft by its name, with the axis in place of "thrust_z", and what is of all
    axes (a failure of no axis by itself).
    """
    chosen = []
    for item in items:
        if getattr(item, "axis", "") is None:
            chosen.append(item)
        elif names_thrust(item):
            key = "signal" if getattr(item, "signal", None) else "axis"
            text = getattr(item, key)
            ending = _THRUST if text.endswith(_THRUST) else axis
            chosen.append(replace(item, **{key: f"{text.removesuffix(ending)}{axis}"}))
    return tuple(chosen)


def _parted(text: str) -> tuple[str, str, str]:
    """ "e_first_zeta" -> "e_", "first", "_zeta"; "first_zeta" and "first" likewise."""
    match = re.fullmatch(rf"([edrf]_)?({'|'.join(BEARING_TERMS)})(_zeta|_eta)?", text)
    return (match[1] or "", match[2], match[3] or "") if match else ("", text, "")
