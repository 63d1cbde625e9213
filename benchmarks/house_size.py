"""How large the house is: statements, files, imports and branches on kinds, room by room.

    python -m benchmarks.house_size [folder of a checkout, this one]

A statement is one of Python's without imports and docstrings. A branch on a kind is an
``isinstance`` with a class of the package in it.
"""

import ast
import sys
from collections import Counter
from pathlib import Path


def docstring_of(node):
    """The statement that is a docstring, or None."""
    first = node.body[0] if getattr(node, "body", None) else None
    text = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return first if text and isinstance(first.value.value, str) else None


def counts(tree, classes):
    """Statements, import statements and branches on kinds of one module."""
    owners = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    nodes = list(ast.walk(tree))
    left_out = {id(docstring_of(node)) for node in nodes if isinstance(node, owners)}
    imports = [node for node in nodes if isinstance(node, ast.Import | ast.ImportFrom)]
    statements = [n for n in nodes if isinstance(n, ast.stmt) and id(n) not in left_out]
    asked = [
        node
        for node in nodes
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "isinstance"
        and {part.id for part in ast.walk(node.args[1]) if isinstance(part, ast.Name)} & classes
    ]
    return len(statements) - len(imports), len(imports), len(asked)


def rooms(source):
    """{room: Counter of files, statements, imports, branches} of a folder ``src/ambrose``."""
    trees = {p: ast.parse(p.read_text(encoding="utf-8")) for p in sorted(source.rglob("*.py"))}
    classes = {n.name for t in trees.values() for n in ast.walk(t) if isinstance(n, ast.ClassDef)}
    found = {}
    for path, tree in trees.items():
        parts = path.relative_to(source).with_suffix("").parts
        room = "/".join(parts[:2]) if parts[0] == "annexes" and len(parts) > 2 else parts[0]
        statements, imports, branches = counts(tree, classes)
        found.setdefault(room, Counter()).update(
            files=1, statements=statements, imports=imports, branches=branches
        )
    return found


def main(root):
    found = rooms(Path(root) / "src" / "ambrose")
    total = sum(found.values(), Counter())
    trunk = sum((c for room, c in found.items() if not room.startswith("annexes")), Counter())
    columns = ("files", "statements", "imports", "branches")
    print(f"{'room':24}" + "".join(f"{name:>12}" for name in columns))
    for room, count in [*sorted(found.items()), ("trunk", trunk), ("all", total)]:
        print(f"{room:24}" + "".join(f"{count[name]:12}" for name in columns))


if __name__ == "__main__":
    main(*sys.argv[1:] or [Path(__file__).parents[1]])
