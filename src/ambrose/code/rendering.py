"""Fills the templates of generated files (templates/*.j2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def render(template: str, values: Mapping[str, Any], autoescape: bool = False) -> str:
    """The text of a template. autoescape: for XML and HTML; elsewhere names are checked and
    comments made safe.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("ambrose.code"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=autoescape,
    )
    return environment.get_template(template).render(values)
