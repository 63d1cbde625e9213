"""The structure stays: rooms that one can overlook, no import circle, packages are nouns. (The
layers: `lint-imports`.)
"""

import ast
import inspect
import re
from functools import cache
from importlib import import_module
from pathlib import Path

import grimp
import pytest
from benchmarks.reverted_defects import read_table

import ambrose

pytestmark = pytest.mark.source

SOURCE = Path(ambrose.__file__).parent
PACKAGES = sorted(path.parent for path in SOURCE.rglob("__init__.py"))
MODULES = sorted(SOURCE.rglob("*.py"))


@cache
def tree_of(path):
    """The parsed module, read once for all that look at it."""
    return ast.parse(path.read_text(encoding="utf-8"))


def name_of(path):
    return path.relative_to(SOURCE).as_posix()


def circles(imports):
    """Strongly connected components of more than one module, by Tarjan's algorithm (1972).

    imports: {module: modules that it imports}.
    """
    index = {}
    low = {}
    stack = []
    components = []

    def visit(module):
        index[module] = low[module] = len(index)
        stack.append(module)
        for other in sorted(imports[module]):
            if other not in index:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], index[other])
        if low[module] == index[module]:
            at = stack.index(module)
            components.append(sorted(stack[at:]))
            del stack[at:]

    for module in sorted(imports):
        if module not in index:
            visit(module)
    return [component for component in components if len(component) > 1]


def test_circles_are_seen():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a", "c"}}) == [["b", "c"]]
    assert circles({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == []


def test_no_module_imports_itself_through_others():
    """Imports inside functions and under TYPE_CHECKING count: a circle is a circle, even where
    Python bears it.
    """
    graph = grimp.build_graph("ambrose", cache_dir=None)
    assert len(graph.modules) == len(MODULES)
    assert (
        circles(
            {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
        )
        == []
    )


def test_no_benchmark_imports_itself_through_others():
    """The package ``benchmarks`` beside src: the same rule, with the imports inside functions."""
    root = SOURCE.parents[1]
    paths = sorted((root / "benchmarks").glob("*.py"))
    graph = grimp.build_graph("benchmarks", cache_dir=None)
    assert len(graph.modules) == len(paths)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    assert circles(imports) == []


def test_nothing_is_exempt_from_the_format():
    """Air is free: no line is kept wide, no table of code by hand (ruff holds 100 columns)."""
    marks = {
        name_of(path): re.findall(r"# fmt: \w+", path.read_text(encoding="utf-8"))
        for path in MODULES
    }
    assert {name: found for name, found in marks.items() if found} == {}


def wide_assignments(path):
    """Lines of ``a, b, c = x, y, z``: three names or more in one assignment of as many values."""
    tree = tree_of(path)
    return [
        node.lineno
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign)
        and isinstance(node.targets[0], ast.Tuple)
        and isinstance(node.value, ast.Tuple)
        and len(node.targets[0].elts) > 2
        and not swaps(node)
    ]


def swaps(node):
    """Whether a value reads a name that the same assignment sets: these cannot stand apart."""
    names = {n.id for target in node.targets[0].elts for n in ast.walk(target) if hasattr(n, "id")}
    return any(hasattr(n, "id") and n.id in names for n in ast.walk(node.value))


def test_at_most_two_names_in_one_assignment():
    wide = {name_of(path): wide_assignments(path) for path in MODULES}
    assert {name: lines for name, lines in wide.items() if lines} == {}


def test_a_package_is_a_noun():
    """Functions are verbs. A package with the name of a public function would replace it on import
    (``ambrose.verify``).
    """
    verbs = {name for name in ambrose.__all__ if inspect.isfunction(getattr(ambrose, name))}
    verbs |= {
        "assemble",
        "deploy",
        "design",
        "export",
        "identify",
        "plot",
        "reduce",
        "simulate",
        "synthesize",
        "validate",
        "verify",
    }
    assert {name_of(folder) for folder in PACKAGES if folder.name in verbs} == set()
    # modules at the root would, too
    assert {path.stem for path in SOURCE.glob("*.py")} & verbs == set()


def test_every_folder_of_modules_is_a_package():
    assert {name_of(path.parent) for path in MODULES} == {name_of(folder) for folder in PACKAGES}


@pytest.mark.parametrize(
    "name",
    sorted(
        path.stem
        for path in (SOURCE.parents[1] / "benchmarks").glob("*.py")
        if "__" not in path.stem
    ),
)
def test_every_benchmark_finds_what_it_imports(name):
    import_module(f"benchmarks.{name}")


def test_every_mended_defect_can_still_be_put_back():
    """``benchmarks/reverted_defects.toml``: its snippets stand once, its tests are there."""
    table = read_table()
    assert len({defect.name for defect in table}) == len(table) >= 30
    for defect in table:
        file = defect.place(SOURCE)
        assert defect.put_into(file) != file.read_text(encoding="utf-8"), defect.name
        files = [part for part in defect.tests if part.startswith("tests/")]
        assert files and all((SOURCE.parents[1] / file).exists() for file in files), defect.name


LAW_KINDS = {
    "ControlProgram",
    "FixedLaw",
    "FunctionLaw",
    "NativeProgram",
    "ProgramLaw",
    "ScheduledLaw",
    "ScheduledProgram",
    "ScheduledSystem",
    "SupervisedProgram",
    "Synthesis",
}
# who may ask for a kind of law: the room of laws, and the file that owns the kind
OWNERS = ("law/", "judge/result.py")
# foreign objects come in here, and nowhere below
DOORS = ("api.py", "cli/", "annexes/scheduled/monitor.py")


def names_in(node):
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def kinds_asked_for(tree):
    """Lines that ask of which kind a law is."""
    for node in ast.walk(tree):
        if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
            continue
        if node.func.id == "isinstance" and names_in(node.args[1]) & LAW_KINDS:
            yield node.lineno
        guessed = node.func.id in {"getattr", "hasattr"} and isinstance(node.args[1], ast.Constant)
        if guessed and node.args[1].value in {"law", "provenance", "scheduled"}:
            yield node.lineno


def untyped_controllers(tree):
    """Lines of parameters and fields that are controllers, laws or machines of any type."""
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            name, annotation = node.arg, node.annotation
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            name, annotation = node.target.id, node.annotation
        else:
            continue
        stated = annotation is not None and "Any" in ast.unparse(annotation).split(" | ")
        if stated and name in {"controller", "fallback", "law", "machine"}:
            yield node.lineno


def places(finder, exempt):
    return [
        f"{name_of(path)}:{line}"
        for path in MODULES
        if not name_of(path).startswith(exempt)
        for line in finder(tree_of(path))
    ]


def test_kinds_and_untyped_laws_are_seen():
    code = """
def f(controller: Any, law: Any | None, other: Any):
    if isinstance(law, ScheduledSystem | StateSpace) or isinstance(other, Plant):
        return getattr(controller, "law", controller)
"""
    assert list(kinds_asked_for(ast.parse(code))) == [3, 4]
    assert list(untyped_controllers(ast.parse(code))) == [2, 2]


def test_nobody_asks_of_which_kind_a_law_is():
    """A law is asked for what it does (``law.law.Law``); a new kind is a class there, and no branch
    anywhere else.
    """
    assert places(kinds_asked_for, OWNERS) == []


def test_nobody_asks_whether_a_machine_is_the_thrust_axis():
    """What differs is asked of the machine: its stations, magnets, reach, whether it is lateral."""
    named = [path for path in MODULES if "AxialMachine" in path.read_text(encoding="utf-8")]
    assert [name_of(path) for path in named] == ["machine/machine.py"]
    asked = [node for node in ast.walk(tree_of(named[0])) if isinstance(node, ast.Call)]
    assert not [node for node in asked if re.match(r"isinstance\(.*Axial", ast.unparse(node))]


def test_below_the_front_door_a_controller_has_a_type():
    assert places(untyped_controllers, DOORS) == []


def test_programs_that_a_test_needs_are_looked_for_in_one_place():
    """tests/needs.py: a skip that says "no <what>: <remedy>", which a summary counts."""
    own = ("which(", "not has_compiler()", "not driver.compilers()")
    found = [
        (path.name, line)
        for path in Path(__file__).parent.rglob("test_*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if "skip" in line and any(word in line for word in own) and "own = " not in line
    ]
    assert found == []
