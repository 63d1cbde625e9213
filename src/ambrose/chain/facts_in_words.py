"""What `ambrose check` tells about a machine, as rows of words."""

from __future__ import annotations

from typing import Any

from ambrose.chain.check_axial import axial_rows
from ambrose.report.units import quantity


def rows_of(facts: dict[str, Any]) -> list[tuple[str, str]]:
    """The facts of a machine (``chain.plants.facts``) in words, as rows of quantity and value."""
    if "axis" in facts:
        return list(axial_rows(facts, quantity))
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
                "critical speeds, undamped, no cross-coupling",
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
    force = f"{item['max_force']:.4g} N per axis for {item['weight']:.4g} N of the weight"
    if item["weight_of_axis"] is not None:
        force += f", at most {item['weight_of_axis']:.4g} N on an axis"
    if item["static_current"]:
        force += f", which takes {item['static_current']:.3g} A"
    return (
        f"bearing {item['name']}",
        f"k_i {item['k_i']:.4g} N/A, k_s {item['k_s'] / 1e6:.4g} N/um, {force}",
    )
