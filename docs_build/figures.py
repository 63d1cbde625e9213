"""Numbers in the pages: each stands in docs/figures.json with the command that made it, and the
text only names it.

    {{ check.mass:.1f }}                          the number, as Python formats it
    {{ hinf.sensitivity.nominal*1e3:.0f }}        times a factor: ms for s, um for m

    python -m docs_build.figures                  compute the quick ones anew and list what changed (exit status 1)
    python -m docs_build.figures --write          ... and store them
    python -m docs_build.figures --slow --write   the studies and sampled designs too: some minutes

`tests/docs/test_figures.py` computes the quick ones anew; a page that names a figure which is not
stored does not build.
"""

import argparse
import json
import re
import sys
from functools import cache

from docs_build import DOCS
from docs_build.recipes import QUICK, SLOW

STORE = DOCS / "figures.json"
_MACRO = re.compile(r"\{\{ *([A-Za-z_][\w.\-]*)(?:\*([\d.e+\-]+))?(?::([^}\s]+))? *\}\}")
TOLERANCE = 1e-4  # relative; figures are printed with two to four digits


class UnknownFigure(KeyError):
    def __str__(self):
        return str(self.args[0])


@cache
def stored():
    """{group: {name: number or text}} as docs/figures.json has it."""
    return json.loads(STORE.read_text(encoding="utf-8"))


def render(text, figures):
    """The text with every figure filled in. Raises UnknownFigure for one that is not stored."""
    return _MACRO.sub(lambda match: _rendered(match, figures), text)


def quoted(text):
    """The keys of all figures that a text names."""
    return [match[1] for match in _MACRO.finditer(text)]


def lookup(key, figures):
    group, _, name = key.partition(".")
    try:
        return figures[group][name]
    except KeyError:
        known = ", ".join(figures.get(group, figures))
        raise UnknownFigure(
            f"the figure {key} is not in docs/figures.json, which has {known}; add it to "
            "docs_build/recipes.py and run "
            "python -m docs_build.figures --write"
        ) from None


def _rendered(match, figures):
    key, factor, form = match.groups()
    value = lookup(key, figures)
    if isinstance(value, str):
        return value
    value = value * float(factor) if factor else value
    return format(value, form or "")


def differences(old, new):
    """What changed from one group of figures to another, one line each."""
    lines = []
    for name in sorted(old.keys() | new.keys()):
        before, after = old.get(name), new.get(name)
        if isinstance(before, int | float) and isinstance(after, int | float):
            same = abs(after - before) <= TOLERANCE * max(abs(before), abs(after))
        else:
            same = before == after
        if not same:
            lines.append(f"{name}: stored {before}, computed {after}")
    return lines


def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python -m docs_build.figures", description="Compute the figures of docs/ anew."
    )
    parser.add_argument("groups", nargs="*", help="groups to compute; default: the quick ones")
    parser.add_argument("--slow", action="store_true", help="the slow groups, too")
    parser.add_argument("--write", action="store_true", help="store them in docs/figures.json")
    options = parser.parse_args(arguments)
    recipes = QUICK | SLOW
    names = options.groups or [*QUICK, *(SLOW if options.slow else [])]
    figures = json.loads(STORE.read_text(encoding="utf-8")) if STORE.exists() else {}
    changed = False
    for name in names:
        print(f"{name} ...", file=sys.stderr)
        new = recipes[name]()
        for line in differences(figures.get(name, {}), new):
            changed = True
            print(f"{name}.{line}")
        figures[name] = new
    if options.write:
        ordered = {name: figures[name] for name in recipes if name in figures}
        STORE.write_text(json.dumps(ordered, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        return 0
    return 1 if changed else 0


if __name__ == "__main__":
    sys.exit(main())
