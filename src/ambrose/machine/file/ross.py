"""Rotor models of ROSS (*.toml, *.json): read as a RotorModel, and a machine written so that ROSS
loads it.

A ROSS file holds a table per element, "Class_tag". Shaft elements at one node lie in layers: those
without stiffness are laminations and sleeves, which a machine states by ``mass_diameter``. Bearings
become places for magnets, of the geometry that a MagneticBearingElement states; seals, supports and
forces are left out, and named, and so is every key that is not read and says something.
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from textwrap import shorten
from typing import Any

from ambrose.core.checks import InvalidInput, invalid
from ambrose.machine.attachment import mesh, node_positions, stations
from ambrose.machine.file.toml import parse_toml, written, written_key
from ambrose.machine.machine import Machine
from ambrose.machine.ordinary_file import TEXT, TOML_BYTES, parse_json
from ambrose.machine.part import Disc, Material, RotorModel, ShaftSection

_SOFT = 1e-3  # of the stiffest material at a node: a layer below carries mass only
_GRADED = 1e-9  # relative difference of two diameters or lengths that is rounding

# keys of its elements that change no number, and the values of others that the machine has anyway
_IDLE = ("tag", "name", "color", "scale_factor", "Poisson", "specific_heat", "thermal_conductivity")
_NEUTRAL = {"gyroscopic": True, "shear_method_calc": "cowper"}
# of an active magnetic bearing, which ROSS 2.3 saves as a BearingElement
_MAGNET = {
    "g0": "gap",
    "i0": "bias_current",
    "ag": "pole_area",
    "nw": "turns",
    "alpha": "pole_half_angle",
    "sensors_axis_rotation": "angle",
}
_LONG = TEXT // 2  # characters of a list in a machine file
_GAINS = ("kp_pid", "ki_pid", "kd_pid")
_COEFFICIENT = re.compile("[kcm][xyz]{2}|frequency")  # what a magnetic bearing computes anew

_Row = Mapping[str, Any]


def parse_ross(text: str, name: str, suffix: str) -> dict[str, Any]:
    """A ROSS file as plain data. Raises InvalidInput."""
    if suffix != ".json":
        return parse_toml(text, name)
    if len(text) > TOML_BYTES or text.count("[") + text.count("{") > TOML_BYTES // 10:
        raise InvalidInput(
            f"{name}: it is larger, or has more brackets, than any rotor; is it the right file?"
        )
    try:
        document = parse_json(text, "save the rotor again; a cut-off file ends like this too")
    except InvalidInput as error:
        raise InvalidInput(f"{name}: {error}") from None
    return document if isinstance(document, dict) else {}


GIVE = (
    "a machine file is made of what Rotor.save of ROSS wrote (*.toml, *.json) or of a table of "
    "stations (*.csv, *.xlsx)"
)


def rotor_of_ross(document: Mapping[str, Any], name: str) -> RotorModel:
    """The rotor in a ROSS document; ``name`` stands in messages. Raises InvalidInput."""
    rows = [
        (str(key), row)
        for key, row in document.items()
        if isinstance(row, Mapping) and key != "parameters"
    ]
    layers = [_layer(name, key, row) for key, row in rows if key.startswith("ShaftElement")]
    if not layers:
        raise InvalidInput(
            f"{name}: it has no ShaftElement, so that it is not a rotor of ROSS; {GIVE}"
        )
    layers.sort(key=lambda layer: layer["n"])
    assumed: dict[str, str] = {}
    sections: list[ShaftSection] = []
    nodes = {int(layers[0]["n"]): 0.0}
    for node, group in groupby(layers, key=lambda layer: int(layer["n"])):
        if node not in nodes:
            raise InvalidInput(
                f"{name}: no shaft element ends at node {node}, where another begins; the shaft "
                "has a gap"
            )
        section = _section(name, list(group), nodes[node], assumed)
        sections.append(section)
        nodes[node + 1] = section.start + section.length
    sections = merged(sections)
    discs = list[Disc]()
    bearings = list[float]()
    magnets = dict[float, dict[str, float]]()
    left = list[str]()
    for key, row in rows:
        kind = key.partition("_")[0]
        if kind == "ShaftElement":
            continue
        at = nodes.get(int(_number(name, key, row, "n"))) if "n" in row else None
        if kind.startswith(("Disk", "Gear", "PointMass")) and at is not None:
            discs.append(_disc(name, key, row, at, len(discs) + 1))
        elif "Bearing" in kind and at is not None:
            bearings.append(at)
            if stated := _magnet(name, key, row):
                magnets[at] = stated
        else:
            left.append(key)
    flags = [layers[0].get(flag, True) for flag in ("shear_effects", "rotary_inertia")]
    theory = "timoshenko" if flags[0] else "rayleigh" if flags[1] else "bernoulli-euler"
    if (
        any(str(layer.get("shear_method_calc", "cowper")) != "cowper" for layer in layers)
        and theory == "timoshenko"
    ):
        assumed["beam_theory"] = (
            "the shear coefficient is Cowper's here, Hutchinson's in the model of ROSS"
        )
    unread = _unread(document, rows, theory)
    if unread:
        items = shorten("; ".join(unread), _LONG, placeholder=" ... and more")
        assumed["rotor"] = f"not taken over from the model of ROSS: {items}"
    if left:
        names = shorten(", ".join(left), _LONG, placeholder=" ... and more")
        assumed["seal"] = f"the ROSS model also contains {names}: left out"
    version = document.get("ross_version", "unknown")
    speed = (
        document.get("parameters", {}).get("rated_w")
        if isinstance(document.get("parameters"), Mapping)
        else None
    )
    return RotorModel(
        "rotor",
        tuple(sections),
        tuple(discs),
        tuple(sorted(set(bearings))),
        None if speed is None else float(speed),
        theory,
        f"ROSS model (version {version})",
        assumed,
        (*left, *unread),
        magnets,
    )


def _unread(
    document: Mapping[str, Any], rows: Sequence[tuple[str, _Row]], theory: str
) -> tuple[str, ...]:
    """What elements that are taken over say, and the machine does not: every key that is not read
    and not neutral, with its value and where it stands first.
    """
    usual = {**_NEUTRAL, "shear_effects": theory == "timoshenko"}
    usual["rotary_inertia"] = theory != "bernoulli-euler"
    found: dict[tuple[str, str], list[str]] = {}

    def note(where: str, row: _Row, known: Sequence[str]) -> None:
        for key, value in row.items():
            idle = key in known or key in _IDLE or isinstance(value, Mapping)
            says = value != usual[key] if key in usual else value not in (0, None, "", [], {})
            if says and not idle:
                found.setdefault((key, str(value)[:60]), []).append(where)

    parameters = document.get("parameters")
    if isinstance(parameters, Mapping):
        note("the model", parameters, ("rated_w", "min_w", "max_w"))
    for name, row in rows:
        kind = name.partition("_")[0]
        if kind == "ShaftElement":
            note(name, row, ("L", "idl", "odl", "idr", "odr", "n"))
            material = row["material"]
            note(name, material, ("rho", "E", "G_s"))
            young, shear = float(material["E"]), float(material.get("G_s", 0.0))
            if shear and not -0.99 <= young / (2 * shear) - 1 <= 0.49:
                found.setdefault(("G_s", f"{shear:g}: Poisson's ratio is cut"), []).append(name)
        elif kind.startswith(("Disk", "Gear", "PointMass")):
            mass = row["m"] if row.get("m") is not None else row.get("mx")
            alike = [key for key in ("mx", "my", "mz") if row.get(key) == mass]
            note(name, row, ("n", "m", "mx", "Id", "Ip", *alike))
        elif "Bearing" in kind and "n" in row:
            magnetic = bool(_magnet("", name, row))
            idle = [key for key in row if _COEFFICIENT.fullmatch(key)]
            note(name, row, ("n", *idle, *(_MAGNET if magnetic else ())))
            if magnetic and not any(row.get(key) for key in _GAINS):
                found.setdefault(("controller_transfer_function", "not saved"), []).append(name)
            elif not magnetic and (
                springs := [key for key in idle if str(row[key]).strip("[0., ]")]
            ):
                found.setdefault((", ".join(springs), "replaced by magnets"), []).append(name)
    return tuple(
        f"{key} = {value} ({places[0]}{f' and {len(places) - 1} more' if places[1:] else ''})"
        for (key, value), places in found.items()
    )


def merged(sections: Sequence[ShaftSection]) -> list[ShaftSection]:
    """Neighbours of the same length, diameters and material as one section of several elements."""
    joined: list[ShaftSection] = []
    for item in sections:
        last = joined[-1] if joined else None
        if last is not None and _alike(last, item):
            joined[-1] = replace(
                last, length=last.length + item.length, elements=last.elements + item.elements
            )
        else:
            joined.append(item if last is None else replace(item, start=last.start + last.length))
    return joined


def _alike(one: ShaftSection, other: ShaftSection) -> bool:
    if one.conical:  # the next cone of the same ends begins anew
        return False
    same = (
        replace(other, start=one.start, length=one.length, elements=one.elements, label=one.label)
        == one
    )
    return (
        same
        and abs(one.length / one.elements - other.length / other.elements) < _GRADED * one.length
    )


def _number(name: str, key: str, row: _Row, entry: str) -> float:
    value = row.get(entry)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise invalid(
            f"{name}: [{key}]: {entry}",
            repr(value),
            "a finite number",
            "save the rotor anew with ROSS",
        )
    return float(value)


def _magnet(name: str, key: str, row: _Row) -> dict[str, float]:
    """What an active magnetic bearing says of its magnets; nothing for another bearing, or where
    its axes differ. Raises InvalidInput.
    """
    values = {their: row[their] for their in _MAGNET if their in row}
    axes = {their: {*v} if isinstance(v, list) else {v} for their, v in values.items()}
    needed = ("g0", "i0", "ag", "nw")
    if not {*needed} <= axes.keys() or any(len(values) != 1 for values in axes.values()):
        return {}
    said = {their: value for their, (value,) in axes.items()}
    numbers = {their: _number(name, key, said, their) for their in said}
    if min(numbers[their] for their in needed) <= 0:
        raise InvalidInput(
            f"{name}: [{key}]: g0, i0, ag and nw must be positive; correct the element"
        )
    return {_MAGNET[their]: value for their, value in numbers.items()}


def _layer(name: str, key: str, row: _Row) -> dict[str, Any]:
    numbers = {entry: _number(name, key, row, entry) for entry in ("L", "n")}
    for left, right in (("idl", "idr"), ("odl", "odr")):
        numbers[left] = _number(name, key, row, left)
        numbers[right] = _number(name, key, row, right) if right in row else numbers[left]
    material = row.get("material")
    if not isinstance(material, Mapping):
        raise InvalidInput(f"{name}: [{key}]: it has no material; save the rotor anew with ROSS")
    rho, young = _number(name, key, material, "rho"), _number(name, key, material, "E")
    shear = _number(name, key, material, "G_s") if "G_s" in material else young / 2.6
    if min(rho, young, shear, numbers["L"]) <= 0:
        raise InvalidInput(
            f"{name}: [{key}]: L, rho, E and G_s must be positive; correct the element"
        )
    material_part = Material(
        rho, young, min(max(young / (2 * shear) - 1, -0.99), 0.49), str(material.get("name", ""))
    )
    return {**row, **numbers, "stuff": material_part}


def _conical(layer: Mapping[str, Any]) -> bool:
    ends = (("odl", "odr"), ("idl", "idr"))
    return any(
        abs(layer[left] - layer[right]) > _GRADED * max(layer[left], layer[right])
        for left, right in ends
    )


def _section(
    name: str, layers: Sequence[dict[str, Any]], start: float, assumed: dict[str, str]
) -> ShaftSection:
    """The layers between two nodes as one section: stiffness of the stiff ones, mass of all; a
    single one may be a cone.
    """
    if any(abs(layer["L"] - layers[0]["L"]) > _GRADED * layers[0]["L"] for layer in layers):
        raise InvalidInput(
            f"{name}: the layers at node {layers[0]['n']:.0f} have different lengths; make them "
            "equal"
        )
    if len(layers) == 1 and _conical(one := layers[0]):
        return ShaftSection(
            start,
            one["L"],
            one["odl"],
            one["idl"],
            material=one["stuff"],
            label=str(one.get("tag") or ""),
            end_outer_diameter=one["odr"],
            end_inner_diameter=one["idr"],
        )
    for layer in layers:
        for left, right in (("odl", "odr"), ("idl", "idr")):
            if abs(layer[left] - layer[right]) > _GRADED * max(layer[left], layer[right]):
                assumed["shaft.outer_diameter"] = (
                    "conical elements in layers have their mean diameter"
                )
                layer[left] = (layer[left] + layer[right]) / 2
    top = max(layer["stuff"].youngs_modulus for layer in layers)
    stiff = [layer for layer in layers if layer["stuff"].youngs_modulus > _SOFT * top]
    bore, outer = min(layer["idl"] for layer in stiff), max(layer["odl"] for layer in stiff)
    material = stiff[0]["stuff"]
    if len(stiff) > 1:
        bending = sum(
            layer["stuff"].youngs_modulus * (layer["odl"] ** 4 - layer["idl"] ** 4)
            for layer in stiff
        )
        material = Material(
            material.density, bending / (outer**4 - bore**4), material.poisson_ratio, material.name
        )
        assumed["shaft.material"] = (
            "stiff layers at one node are one section of the same bending stiffness and mass"
        )
    area = sum(layer["stuff"].density * (layer["odl"] ** 2 - layer["idl"] ** 2) for layer in layers)
    heavy = math.sqrt(area / material.density + bore**2)
    if len(layers) > len(stiff):
        assumed["shaft.mass_diameter"] = (
            "layers without stiffness of the model of ROSS: their mass, on the shaft's own density"
        )
    mass = None if abs(heavy - outer) <= _GRADED * outer else heavy
    return ShaftSection(
        start,
        layers[0]["L"],
        outer,
        bore,
        mass,
        material=material,
        label=str(stiff[0].get("tag") or ""),
    )


def _disc(name: str, key: str, row: _Row, at: float, number: int) -> Disc:
    mass = (
        _number(name, key, row, "m") if row.get("m") is not None else _number(name, key, row, "mx")
    )
    tag = re.sub(r"[^A-Za-z0-9_-]+", "-", key.partition("_")[2]).strip("-")
    label = tag if re.match(r"[A-Za-z]", tag) else f"disc-{number}"
    inertia = [_number(name, key, row, entry) if entry in row else 0.0 for entry in ("Ip", "Id")]
    return Disc(f"{label}-{number}" if not tag.endswith(str(number)) else label, at, mass, *inertia)


def ross_text(machine: Machine, springs: Mapping[str, tuple[float, float]]) -> str:
    """The machine as a TOML file that ROSS loads: an element per element of the mesh, discs,
    bearings as springs.

    springs: stiffness [N/m] and damping [N s/m] of every bearing, by name. Discs and bearings stand
    at nodes, as everything in the mesh does but for what ``off_nodes`` names.
    """
    lines = ['ross_version = "2.0.0"', "", "[parameters]"]
    flags = {
        "shear_effects": machine.beam_theory == "timoshenko",
        "rotary_inertia": machine.beam_theory != "bernoulli-euler",
    }
    pieces = mesh(machine.shaft, stations(machine))
    for n, piece in enumerate(pieces):
        material = piece.section.material
        ends = [piece.section.diameters(place) for place in (piece.left, piece.right)]
        rings = [([(bore, outer) for outer, bore, _ in ends], 1.0)]
        if any(mass > outer for outer, _, mass in ends):
            rings.append(([(outer, max(mass, outer)) for outer, _, mass in ends], 1e-8))
        for layer, (((idl, odl), (idr, odr)), share) in enumerate(rings):
            young = material.youngs_modulus * share
            row = {
                "L": piece.length,
                "idl": idl,
                "odl": odl,
                "idr": idr,
                "odr": odr,
                "n": n,
                "axial_force": 0,
                "torque": 0,
                **flags,
                "gyroscopic": True,
                "shear_method_calc": "cowper",
                "tag": f"shaft {n}.{layer}",
            }
            lines += _element(f"ShaftElement_shaft {n}.{layer}", row)
            lines += _element(
                f"ShaftElement_shaft {n}.{layer}",
                {
                    "name": f"{material.name or 'steel'}{layer}",
                    "rho": material.density,
                    "E": young,
                    "G_s": young / (2 * (1 + material.poisson_ratio)),
                    "color": "#525252",
                },
                "material",
            )

    nodes = node_positions(pieces)

    for disc in machine.discs:
        row = {
            "n": _nearest(nodes, disc.position),
            "m": disc.mass,
            "Id": disc.diametral_inertia,
            "Ip": disc.polar_inertia,
            "tag": disc.name,
        }
        lines += _element(f"DiskElement_{disc.name}", row)
    for bearing in machine.bearings:
        k, c = springs[bearing.name]
        row = {
            "n": _nearest(nodes, bearing.position),
            "kxx": [k],
            "kyy": [k],
            "cxx": [c],
            "cyy": [c],
            "tag": bearing.name,
        }
        lines += _element(f"BearingElement_{bearing.name}", row)
    return "\n".join(lines) + "\n"


def off_nodes(machine: Machine) -> dict[str, float]:
    """How far [m] discs and bearings stand from the nodes that ``ross_text`` gives them, by name,
    where it is more than rounding: so near to another node that no element fits between.
    """
    nodes = node_positions(mesh(machine.shaft, stations(machine)))
    places = {disc.name: disc.position for disc in machine.discs}
    places |= {bearing.name: bearing.position for bearing in machine.bearings}
    found = {name: abs(nodes[_nearest(nodes, at)] - at) for name, at in places.items()}
    return {name: away for name, away in found.items() if away > 1e-9 * machine.length}


def _nearest(nodes: Sequence[float], position: float) -> int:
    return min(range(len(nodes)), key=lambda i: abs(nodes[i] - position))


def _element(name: str, row: Mapping[str, Any], below: str = "") -> list[str]:
    header = f"[{written_key(name)}{f'.{below}' if below else ''}]"
    return ["", header, *(f"{key} = {written(value)}" for key, value in row.items())]
