"""The Python reference: the front door name by name, then every package with its modules, for
mkdocstrings to fill in.
"""

import importlib
import inspect

from docs_build import ROOT

SOURCE = ROOT / "src"
PACKAGE = SOURCE / "ambrose"
INTRODUCTION = """# Python

`import ambrose as amb` is the front door: a function per step of the chain, and the nouns that travel between them. Everything
below it is open, too, and listed package by package under [Packages](packages/{first}.md). Arrays have their shape and unit in
the docstring, `stiffness (n, n) [N/m]`; quantities are SI, rates rad/s. Bad input raises `InvalidInput`, which names the
quantity, its value, what is required and the remedy.
"""


def packages():
    """Dotted name of every folder with modules -> its modules, in order of name: the root comes
    first.
    """
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.name == "__init__.py" or "templates" in path.parts:
            continue
        dotted = ".".join(path.relative_to(SOURCE).with_suffix("").parts)
        found.setdefault(dotted.rpartition(".")[0], []).append(dotted)
    return {name: found[name] for name in sorted(found) if name != "ambrose.cli"}


def navigation():
    return [
        {name.removeprefix("ambrose."): f"reference/api/packages/{name}.md"} for name in packages()
    ]


def pages():
    result = {"reference/api/index.md": front_door()}
    for name, modules in packages().items():
        heading = f"# `{name}`\n"
        result[f"reference/api/packages/{name}.md"] = "\n".join(
            [heading, *(f"::: {module}\n" for module in modules)]
        )
    return result


def front_door():
    """A table of all public names with the first sentence of what each is, linked to its full
    description.
    """
    ambrose = importlib.import_module("ambrose")
    rows = {"functions": [], "nouns": [], "errors": []}
    for name in sorted(set(ambrose.__all__) - {"__version__"}):
        item = inspect.unwrap(getattr(ambrose, name))
        kind = "functions" if inspect.isfunction(item) else "errors" if is_error(item) else "nouns"
        rows[kind].append(
            f"| [`{name}`][{item.__module__}.{item.__qualname__}] | {first_sentence(item)} |"
        )
    tables = [
        f"## {kind.capitalize()}\n\n| name | what it is |\n|---|---|\n" + "\n".join(lines) + "\n"
        for kind, lines in rows.items()
        if lines
    ]
    return "\n".join([INTRODUCTION.format(first=next(iter(packages()))), *tables])


def is_error(item):
    return inspect.isclass(item) and issubclass(item, Exception)


def first_sentence(item):
    """The first sentence of a docstring, in one line of a table."""
    text = " ".join((inspect.getdoc(item) or "").split("\n\n")[0].split())
    return text.split(". ")[0].rstrip(".").replace("|", "\\|") + "."
