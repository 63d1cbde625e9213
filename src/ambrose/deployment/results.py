"""Verification results as plain data, for --json and for checks.json."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

from ambrose.machine.atomic_write import write_text
from ambrose.synthesis.result import Certificate
from ambrose.verification.checks import Checks


def checks_to_dict(checks: Checks) -> dict[str, Any]:
    """One verification without its curves; numbers that are not finite become strings ("inf")."""
    return {
        "label": checks.label,
        "stable": checks.stable,
        "passed": checks.passed,
        "checks": [plain(dataclasses.asdict(check)) for check in checks.checks],
    }


def certificate_to_dict(certificate: Certificate) -> dict[str, Any]:
    """A certificate as JSON-ready data."""
    return plain({f.name: getattr(certificate, f.name) for f in dataclasses.fields(certificate)})


def plain(value: Any) -> Any:
    """Nested data with JSON types only; NaN and infinities as strings, because JSON has none."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value if isinstance(value, str | int | float | bool) or value is None else dict(value)


def write_json(path: Path, content: Any) -> Path:
    """``content`` as a JSON file that appears complete or not at all. Raises InvalidInput where it cannot be written."""
    return write_text(path, json.dumps(plain(content), indent=1) + "\n", "result file")
