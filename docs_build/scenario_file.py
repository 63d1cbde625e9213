"""The page of the scenario file, from the classes that its tables become and what the reader knows
of their keys.
"""

import inspect
from dataclasses import MISSING, fields

from ambrose.machine.units import DIMENSIONS
from ambrose.rig import scenario as reader
from ambrose.rig.scenario import _QUANTITIES

HEAD = """# Scenario file

Generated from the program itself. One TOML file says what is done to a closed loop during a simulation:
`ambrose simulate MACHINE --controller FILE --scenario my.toml`; `ambrose scenarios` lists the bundled ones, which are written
in the same way. Numbers are SI, or texts with a unit, `"10 ms"`. What does not exist is refused with its table and key.

In place of a bearing's name, in signals and ports, stand `first`, `last` (in the order of the machine file) and `every`:
`e_first_zeta`, `f_last_eta`, `port = "every"`. In place of a number may stand a share of what the machine says, such as
`"80 % of top speed"`: {shares}.

Signals that a disturbance may act on: current excitation `e_BEARING_AXIS` [A], output disturbance `d_BEARING_AXIS` [m],
reference `r_BEARING_AXIS` [m], force `f_PORT_AXIS` [N] at a bearing, seal, disc or coupling. Axes of bearings and
couplings are `zeta` and `eta`, of seals and discs `x` and `y`.

Angles: x and y are the machine's axes, in the direction of spin from x to y; `zeta` of a bearing stands at its `angle` from x,
`eta` a quarter turn further. The rotor's angle is zero at time zero and grows with the speed; the phase of an unbalance counts
from the first axis of its port in the direction of spin: from x at a disc or a seal, from zeta at a bearing. The angles of
`ambrose balance` count from x everywhere, so 30 deg at a bearing whose `angle` is 45 deg are 75 deg there.
"""


def page():
    """reference/scenario-file.md."""
    shares = ", ".join(f"`{name}`" for name in _QUANTITIES)
    parts = [
        HEAD.format(shares=shares),
        section("The file itself", reader.Scenario, {kind for kind, _ in reader._TABLES.values()}),
    ]
    parts += [section(f"`[[{key}]]`", kind) for key, (_, kind) in reader._TABLES.items()]
    return "\n".join(parts)


def section(title, kind, leave_out=frozenset()):
    """A table: what it is, and a row per key."""
    words = " ".join(inspect.cleandoc(kind.__doc__).replace("``", "`").split())
    rows = [row(item) for item in fields(kind) if item.name not in leave_out]
    return (
        f"## {title}\n\n{words}\n\n"
        + "\n".join(["| key | unit | default |", "|---|---|---|", *rows])
        + "\n"
    )


def row(item):
    required = item.default is MISSING and item.default_factory is MISSING
    default = (
        "required"
        if required
        else ""
        if item.default is None or item.default == ""
        else f"{item.default}"
    )
    return f"| `{item.name}` | {unit(item.name)} | {default} |"


def unit(key):
    if key in reader._TEXTS:
        return "text"
    if key in reader._COUNTS:
        return "whole number"
    if key == "amplitude":
        return "that of the signal"
    if key == "amount":
        return "kg m"
    return DIMENSIONS[reader._KINDS[key]].unit + (", list" if key == "frequencies" else "")
