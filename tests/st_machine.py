"""Runs structured text in Python: blark's parser (not ours) makes the tree, this turns it into
Python functions.

Covers what the export writes: declarations with initial values, arrays, assignments, IF, FOR,
arithmetic, comparisons, logic, instances of other function blocks, TRUNC and DINT_TO_LREAL. Numbers
are doubles, as LREAL.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

from blark.parse import new_parser, parse_source_code

_OPS = {"<>": "!=", "=": "==", "AND": "and", "OR": "or", "MOD": "%"}
_FUNCTIONS = {"TRUNC": "int", "DINT_TO_LREAL": "float"}


@cache
def parser() -> Any:
    """Of blark, made once: its grammar takes longer to read than most sources."""
    return new_parser()


@lru_cache(maxsize=64)
def parsed(source: str) -> Any:
    """The first unit of the source as blark's dataclasses; a syntax error fails the test. Comments
    are checked by hand: the parser is slow with them.
    """
    plain = re.sub(r"\(\*.*?\*\)", "", source, flags=re.DOTALL)
    assert "(*" not in plain and "*)" not in plain
    result = parse_source_code(plain, parser=parser())
    assert result.exception is None, result.exception
    return result.transform().items[0]


@dataclass(frozen=True)
class Lean:
    """A unit that was parsed without the initial values of its arrays, and those by name."""

    unit: Any
    values: dict[str, list[Any]]


def lean(source: str) -> Lean:
    """``parsed`` for a source with long tables, whose values the parser does not see: it takes
    minutes for them, and tables of their form are parsed elsewhere.
    """
    found: dict[str, list[Any]] = {}

    def kept(match: re.Match[str]) -> str:
        texts = match[3].replace("TRUE", "True").replace("FALSE", "False").split(",")
        found[match[1]] = [eval(text.strip()) for text in texts]
        return match[1] + match[2]

    plain = re.sub(r"\(\*.*?\*\)", "", source, flags=re.DOTALL)
    return Lean(
        parsed(re.sub(r"(\w+)( : ARRAY\[[^\]]*\] OF \w+) := \[([^\]]*)\]", kept, plain)), found
    )


class FunctionBlock:
    """An instance: variables by name in ``v`` (arrays as dictionaries), called with inputs as
    keywords. others: the units of the function blocks that it has instances of, by name.
    """

    def __init__(self, unit: Any, others: dict[str, Any] | None = None) -> None:
        self.v: dict[str, Any] = {}
        self.others = others or {}
        self.values = unit.values if isinstance(unit, Lean) else {}
        unit = unit.unit if isinstance(unit, Lean) else unit
        self.inputs: set[str] = set()
        for group in unit.declarations:
            names = [name for item in group.items for name in self._declare(item)]
            if type(group).__name__ == "InputDeclarations":
                self.inputs |= set(names)
        lines = ["def body(v):", *_statements(unit.body.statements, 1)]
        scope: dict[str, Any] = {}
        # our own generated text, parsed and translated
        exec(compile("\n".join(lines), "structured text", "exec"), scope)
        self.body = scope["body"]

    def __call__(self, **inputs: Any) -> dict[str, Any]:
        assert inputs.keys() <= self.inputs
        self.v.update(inputs)
        self.body(self.v)
        return self.v

    def _declare(self, item: Any) -> list[str]:
        names = [str(declared.variable.name) for declared in item.variables]
        for name in names:
            assert name not in self.v, f"{name} is declared twice"
            kind = str(getattr(getattr(item.init, "spec", None), "type", ""))
            known = kind in self.others
            self.v[name] = (
                FunctionBlock(self.others[kind], self.others) if known else _initial(item.init)
            )
            if name in self.values:
                self.v[name] = dict(zip(self.v[name], self.values[name], strict=True))
        return names


def _initial(init: Any) -> Any:
    if type(init).__name__ == "ArrayTypeInitialization":
        spans = [range(int(s.start.value), int(s.stop.value) + 1) for s in init.spec.subranges]
        places: list[tuple[int, ...]] = [()]
        for span in spans:
            places = [(*place, i) for place in places for i in span]
        zero: Any = (
            False
            if str(init.spec.type.type_name) == "BOOL"
            else 0
            if str(init.spec.type.type_name) in {"INT", "DINT"}
            else 0.0
        )
        values = (
            [zero] * len(places)
            if init.value is None
            else [eval(text) for text in _flat(init.value)]
        )
        assert len(values) == len(places), "an array and its initial values differ in size"
        return dict(zip(places, values, strict=True))
    if init.value is not None:
        return eval(_expression(init.value))
    return {"BOOL": False, "INT": 0, "DINT": 0}.get(str(init.spec.type), 0.0)


def _flat(node: Any) -> list[str]:
    """blark groups the list by the array's rows; the values in their order."""
    if type(node).__name__ == "ArrayInitialization":
        return [text for element in node.elements for text in _flat(element.element)]
    return [_expression(node)]


def _statements(nodes: Any, depth: int) -> list[str]:
    pad, lines = "    " * depth, []
    for node in nodes:
        kind = type(node).__name__
        if kind == "AssignmentStatement":
            (target,) = node.variables
            lines.append(f"{pad}{_expression(target)} = {_expression(node.expression)}")
        elif kind == "FunctionCallStatement":
            given = ", ".join(f"{p.name.name}={_expression(p.value)}" for p in node.parameters)
            lines.append(f"{pad}v['{node.name.name}']({given})")
        elif kind == "ForStatement":
            span = f"range({_expression(node.from_)}, {_expression(node.to)} + 1)"
            lines += [
                f"{pad}for v['{node.control.name}'] in {span}:",
                *_statements(node.statements.statements, depth + 1),
            ]
        elif kind == "IfStatement":
            lines += [
                f"{pad}if {_expression(node.if_expression)}:",
                *_statements(node.statements.statements, depth + 1),
            ]
            for other in node.else_ifs:
                lines += [
                    f"{pad}elif {_expression(other.if_expression)}:",
                    *_statements(other.statements.statements, depth + 1),
                ]
            if node.else_clause is not None:
                lines += [
                    f"{pad}else:",
                    *_statements(node.else_clause.statements.statements, depth + 1),
                ]
        else:
            raise NotImplementedError(kind)
    return lines


def _expression(node: Any) -> str:
    kind = type(node).__name__
    if kind == "SimpleVariable":
        return f"v['{node.name}']"
    if kind == "MultiElementVariable":
        (subscripts,) = node.elements
        if type(subscripts).__name__ == "FieldSelector":
            return f"v['{node.name.name}'].v['{subscripts.field.name}']"
        return (
            f"v['{node.name.name}'][({', '.join(_expression(s) for s in subscripts.subscripts)},)]"
        )
    if kind in {"Real", "Integer"}:
        return str(node.value)
    if kind == "FunctionCall":
        (argument,) = node.parameters
        return f"{_FUNCTIONS[str(node.name.name)]}({_expression(argument.value)})"
    if kind == "Boolean":
        return str(node.value).capitalize()
    if kind == "ParenthesizedExpression":
        return f"({_expression(node.expr)})"
    if kind == "UnaryOperation":
        return f"({'not' if str(node.op) == 'NOT' else str(node.op)} {_expression(node.expr)})"
    if kind == "BinaryOperation":
        return (
            f"({_expression(node.left)} {_OPS.get(str(node.op), str(node.op))} "
            f"{_expression(node.right)})"
        )
    raise NotImplementedError(kind)
