"""The JSON schema of ``lateral.json``, for programs that read it.

python -m ambrose.annexes.rotordynamics.json_schema docs/lateral.schema.json
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from ambrose.annexes.rotordynamics.result import SCHEMA

_NUMBER = {"type": "number"}
_POSITIVE = {"type": "number", "exclusiveMinimum": 0}
_SIZE = {"type": "number", "minimum": 0}
_TEXT = {"type": "string"}
_MAYBE = {"type": ["number", "null"]}
# infinite and unknown values are text: "inf", "nan"
_ANY_NUMBER = {"type": ["number", "string"]}
_VERDICT = {"type": ["boolean", "null"]}


def lateral_schema() -> dict[str, Any]:
    """The schema (draft 2020-12): keys carry their units, amplitudes 0p or pp."""
    item = _table(
        name=_TEXT,
        title=_TEXT,
        standard=_TEXT,
        clause=_TEXT,
        basis={"enum": ["checked", "recalled", "own"]},
        value={"type": ["number", "string", "null"]},
        unit=_TEXT,
        relation={"enum": ["<=", ">=", "<", ">"]},
        limit={"type": ["number", "string", "null"]},
        passed=_VERDICT,
        note=_TEXT,
        bound={"enum": ["", ">"], "description": ">: the value is more than the one given"},
    )
    mode = _table(
        frequency_rad_per_s=_SIZE,
        log_decrement=_NUMBER,
        judged={"type": "boolean", "description": "false: above the running speed"},
        whirl={**_NUMBER, "description": "1: forward circles, -1: backward ones"},
        shares={"type": "object", "additionalProperties": _NUMBER},
        least_over_tolerances_found=_MAYBE,
        at=_TEXT,
    )
    clearance = _table(
        name=_TEXT,
        kind={"enum": ["touchdown", "seal", "clearance", "magnet"]},
        position_m=_NUMBER,
        diametral_m=_NUMBER,
        motion_m_pp={**_NUMBER, "description": "scaled"},
        offset_m=_NUMBER,
        allowed_m_pp=_NUMBER,
        at_rad_per_s=_NUMBER,
        case=_TEXT,
        passed={"type": "boolean"},
    )
    budget = _table(
        axes=_list(_TEXT),
        frequencies_rad_per_s=_list(_NUMBER),
        elements_deg={"type": "object", "additionalProperties": _list(_NUMBER)},
        total_deg=_list(_NUMBER),
        notes=_list(_TEXT),
    )
    demand = _table(
        load=_TEXT,
        kind={"enum": ["unbalance", "part of unbalance", "impulse", "surge"]},
        frequency_rad_per_s=_NUMBER,
        force_N_0p={**_NUMBER, "description": "control current times k_i"},
        current_A_0p=_NUMBER,
        voltage_V_0p=_NUMBER,
        margin_alone=_ANY_NUMBER,
    )
    capacity = _table(
        axis=_TEXT,
        frequencies_rad_per_s=_list(_NUMBER),
        force_N_0p=_list(_NUMBER),
        other_side_force_N_0p=_list(_NUMBER),
        limited_by=_list(_TEXT),
        static_N={"type": "object", "additionalProperties": _NUMBER},
        static_current_A=_NUMBER,
        demands=_list(demand),
        margins=_list(_table(margin=_ANY_NUMBER, of=_TEXT, limited_by=_TEXT)),
    )
    weight = _table(position_m=_NUMBER, amount_kg_m=_NUMBER, angle_rad=_NUMBER, carried_kg=_NUMBER)
    peak = {
        "speed_rad_per_s": _POSITIVE,
        "amplitude_m_pp": _SIZE,
        "amplification_factor": {"type": ["number", "string"], "exclusiveMinimum": 0},
    }
    curve = _table(
        reading=_TEXT,
        case=_TEXT,
        amplitude_m_pp=_list(_SIZE),
        phase_lag_deg={
            **_list(_NUMBER),
            "description": "behind the key phasor, which is where the first unbalance is",
        },
        peaks=_list(_table(**peak)),
    )
    support = _table(
        axes=_list(_TEXT),
        kind={"enum": ["magnet", "film"]},
        speeds_rad_per_s=_list(_NUMBER),
        stiffness_abs_N_per_m=_list(_NUMBER),
        stiffness_real_N_per_m=_list(_NUMBER),
    )
    crossing = _table(
        axes=_TEXT,
        critical_speed={"type": "integer"},
        speed_rad_per_s=_NUMBER,
        stiffness_N_per_m=_NUMBER,
    )
    undamped = _table(
        support_stiffness_N_per_m=_list(_NUMBER),
        forward_rad_per_s={
            **_list(_list(_NUMBER)),
            "description": "a row per critical speed, over the stiffness",
        },
        on_rigid_supports_rad_per_s=_list(_NUMBER),
        supports=_list(support),
        crossings=_list(crossing),
    )
    branch = _table(frequency_rad_per_s=_NUMBER, log_decrement=_list(_NUMBER))
    whole = _table(
        schema={"const": SCHEMA},
        machine=_TEXT,
        controller=_TEXT,
        timing=_TEXT,
        operating_point=_TEXT,
        passed={"type": "boolean"},
        speeds_rad_per_s=_table(lowest=_SIZE, highest=_POSITIVE, trip=_POSITIVE),
        mean_gas_density_kg_per_m3=_MAYBE,
        scale_factor=_table(capped=_NUMBER, uncapped=_ANY_NUMBER),
        items=_list(item),
        modes_up_to_rad_per_s=_POSITIVE,
        modes=_list(mode),
        clearances=_list(clearance),
        phase_budget=_list(budget),
        capacity=_list(capacity),
        notes=_list(_TEXT),
        critical_speed_map=undamped,
        level_one=_table(
            anticipated_N_per_m=_MAYBE,
            border_N_per_m={
                **_ANY_NUMBER,
                "description": "text, > and the end of the sweep, where none was met up to there",
            },
            log_decrement_at_anticipated=_MAYBE,
            critical_speed_ratio=_MAYBE,
            level_two_asked_for={
                "type": ["array", "null"],
                "items": _TEXT,
                "description": "reasons; null: no anticipated cross-coupling",
            },
            cross_coupling_N_per_m=_list(_NUMBER),
            modes=_list(branch),
        ),
        unbalance=_list(_table(case=_TEXT, why=_TEXT, weights=_list(weight))),
        critical_speeds=_list(
            _table(
                **peak,
                margin_percent=_NUMBER,
                required_percent=_NUMBER,
                reading=_TEXT,
                case=_TEXT,
            )
        ),
        response=_table(speeds_rad_per_s=_list(_POSITIVE), curves=_list(curve)),
    )
    # what an unstable loop, or a rotor without Level I, does not have
    missing = {"level_one", "unbalance", "critical_speeds", "response"}
    whole["required"] = [key for key in whole["required"] if key not in missing]
    head = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"lateral analysis of ambrose, schema {SCHEMA}",
    }
    return head | whole


def _table(**properties: Any) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": properties,
        "required": list(properties),
        "additionalProperties": False,
    }


def _list(entry: dict[str, Any]) -> dict[str, Any]:
    return {"type": "array", "items": entry}


if __name__ == "__main__":
    from ambrose.machine.atomic_write import write_text

    write_text(Path(sys.argv[1]), json.dumps(lateral_schema(), indent=1) + "\n", "JSON schema")
