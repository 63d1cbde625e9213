"""Words stand out from their ground, on paper and on dark screens: 4.5 to 1 at least (WCAG 2.1,
1.4.3), in pages and in the workbench.
"""

from __future__ import annotations

import itertools
import re
from importlib.resources import files

import pytest

from ambrose.report.page import SHADES

SHEETS = {
    "page": files("ambrose.report") / "templates" / "page.html.j2",
    "workbench": files("ambrose.annexes.workbench") / "static" / "style.css",
}
# the words of each sheet, and the grounds that they stand on
WORDS = {
    "page": ("ink muted good bad", "paper soft failed"),
    "workbench": ("ink muted limit good line", "paper ground"),
}
DARK = "prefers-color-scheme: dark"


def brightness(colour: str) -> float:
    """Relative luminance of "#rgb" or "#rrggbb" (WCAG 2.1)."""
    digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
    shares = [int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4)]
    linear = [s / 12.92 if s <= 0.04045 else ((s + 0.055) / 1.055) ** 2.4 for s in shares]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    dark, light = sorted(map(brightness, (one, other)))
    return (light + 0.05) / (dark + 0.05)


def colours(sheet: str, theme: str) -> dict[str, str]:
    """The variables of a sheet in a theme."""
    light, dark = SHEETS[sheet].read_text("utf-8").split(DARK)[:2]
    text = light if theme == "light" else dark.partition("\n  }\n")[0]
    return dict(re.findall(r"--(\w+): (#[0-9a-f]{3,6});", text))


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("sheet", SHEETS)
def test_words_stand_out_from_their_ground(sheet: str, theme: str) -> None:
    named = colours(sheet, theme)
    pairs = itertools.product(*(part.split() for part in WORDS[sheet]))
    weak = {
        (word, ground): contrast(named[word], named[ground])
        for word, ground in pairs
        if contrast(named[word], named[ground]) < 4.5
    }
    assert weak == {}


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_numbers_stand_out_from_the_shades_of_a_map(theme: str) -> None:
    """4.2 to 1 on the best of the dark ones."""
    ink = colours("page", theme)["ink"]
    grounds = {name: pair[theme == "dark"] for name, pair in SHADES.items()}
    on = {name: "#ffffff" if name == "unstable" else ink for name in grounds}  # of the style sheet
    assert {n for n, ground in grounds.items() if contrast(on[n], ground) < 4.5} == set()
