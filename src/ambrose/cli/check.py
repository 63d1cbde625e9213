"""`ambrose machines` and `ambrose check`."""

from __future__ import annotations

import sys
from typing import Any

import click

from ambrose.terminal import AS_JSON, MACHINE, load, print_table, say, say_json


@click.command()
@AS_JSON
def machines(as_json: bool) -> None:
    """List the bundled machines."""
    from ambrose.machine.file.toml import bundled_machines, load_machine

    descriptions = {name: load_machine(name).description for name in bundled_machines()}
    if as_json:
        say_json(descriptions)
        return
    print_table("Bundled machines", ("name", "what it is"), list(descriptions.items()))


@click.command()
@click.argument("name", required=False)
@AS_JSON
def scenarios(name: str | None, as_json: bool) -> None:
    """List the bundled scenarios, or print the file of the one called NAME, to copy and change."""
    from ambrose.rig.scenario import bundled_scenarios, scenario_text

    known = bundled_scenarios()
    if name is not None:
        text = scenario_text(name)
        if as_json:
            say_json({"name": name, "text": text})
        else:
            for line in text.splitlines():
                say(line)
        return
    if as_json:
        say_json(known)
    else:
        print_table("Bundled scenarios", ("name", "what is done"), list(known.items()))


@click.command()
@MACHINE
@AS_JSON
def check(machine: str, as_json: bool) -> None:
    """Validate a machine file, and say what it can do: mass, magnets against weight, bending,
    poles, critical speeds.

    What is implausible (a length without its unit, a magnet that cannot lift, a gain below k_s/k_i)
    is said with its remedy, and the exit status is 1.
    """
    from ambrose.chain.check_axial import axial_rows
    from ambrose.chain.plants import facts
    from ambrose.report.units import quantity

    known = facts(load(machine, magnets=False))
    if as_json:
        say_json(known)
    else:
        title = ": ".join(text for text in (known["machine"], known["description"]) if text)
        rows = axial_rows(known, quantity) if "axis" in known else _facts_in_words(known)
        print_table(title, ("quantity", "value"), rows)
        for doubt in known["doubts"]:
            say(f"implausible: {doubt}")
        for remark in known["remarks"]:
            say(f"note: {remark}")
    sys.exit(1 if known["doubts"] else 0)


def _facts_in_words(facts: dict[str, Any]) -> list[tuple[str, str]]:
    from ambrose.report.units import quantity

    unstable = ", ".join(f"{re:.1f}{im + 0.0:+.1f}j" for re, im in facts["unstable_poles_rad_s"])
    margin, least = facts["stiffness_margin"], facts["least_sensitivity"]
    held = []
    if facts["bearings"]:  # nothing of a rotor that no magnet holds
        held = [
            (
                "static stiffness margin, K_p k_i / k_s",
                "no reference controller" if margin is None else f"{margin:.3g}",
            ),
            (
                "critical speeds, undamped",
                ", ".join(quantity(w, "rad/s") for w in facts["critical_speeds_rad_s"]) or "none",
            ),
            (
                "least sensitivity that the delay allows",
                "none" if least is None else f"{least:.3g}",
            ),
        ]
    return [
        ("rotor mass", quantity(facts["mass_kg"], "kg")),
        ("centre of mass", quantity(facts["centre_m"], "m")),
        (
            "inertia, diametral and polar",
            f"{facts['diametral_inertia_kg_m2']:.4g} and {facts['polar_inertia_kg_m2']:.4g} kg m²",
        ),
        *(_bearing(item) for item in facts["bearings"]),
        *held,
        ("free-free bending", ", ".join(quantity(w, "rad/s") for w in facts["bending_rad_s"])),
        ("error of the mesh in these and all judged", _mesh(facts["mesh_error"])),
        ("unstable open-loop poles", f"{unstable} rad/s" if unstable else "none"),
        (
            "rotor states, full and reduced",
            f"{facts['rotor_states']} and {facts['reduced_rotor_states']}",
        ),
        (
            "plant states, full and reduced",
            f"{facts['plant_states']} and {facts['reduced_plant_states']}",
        ),
        ("operating points", ", ".join(facts["operating_points"])),
        ("uncertain parameters", ", ".join(facts["tolerances"]) or "none"),
        ("assumed entries", f"{facts['assumed']}, listed with their reasons in the report"),
    ]


def _mesh(errors: list[float]) -> str:
    worst = max(range(len(errors)), key=errors.__getitem__)
    return f"at most {100 * errors[worst]:.2g} %, of mode {worst + 1}"


def _bearing(item: dict[str, Any]) -> tuple[str, str]:
    force = f"{item['max_force']:.4g} N for {item['weight']:.4g} N of the weight"
    if item["current"]:
        force += f", which takes {item['current']:.3g} A"
    return (
        f"bearing {item['name']}",
        f"k_i {item['k_i']:.4g} N/A, k_s {item['k_s'] / 1e6:.4g} N/um, {force}",
    )
