"""Which of the slow tests a change can be the cause of, by the imports that they reach.

``durations.json`` beside this file holds the tests above ``NOTED`` seconds of processor time, each
with the fixtures that it has in common with others: left alone, it pays for them (`make durations`
renews it). A test above ``SLOW`` runs where a file that it reaches differs from the main branch;
quick and new ones always run, and all do on CI, with ``--all``, and where the difference cannot be
told. Within a run the longest files come first.
"""

import ast
import json
import re
import subprocess
import time
from functools import cache
from pathlib import Path

TESTS = Path(__file__).parent
ROOT = TESTS.parent
DURATIONS = TESTS / "durations.json"
NOTED = 0.1
SLOW = 0.25  # seconds of processor time, as the file says
# whoever imports one of these may reach any file of the package
DOORS = {"ambrose.__main__", "ambrose.cli"}
EVERYTHING = (
    "pyproject.toml",
    "constraints.txt",
    "constraints-oldest.txt",
    "tests/conftest.py",
    "src/ambrose/__init__.py",
    "src/ambrose/registry.py",
)


class Unknown(Exception):
    """Why it cannot be said what differs from the main branch."""


def git(*arguments, root=ROOT):
    """What git prints. Raises Unknown where there is no git, or it refuses."""
    try:
        done = subprocess.run(
            ["git", "-C", str(root), *arguments], capture_output=True, text=True, check=False
        )
    except OSError:
        raise Unknown("git is not installed") from None
    if done.returncode:
        raise Unknown("this is no git checkout" if "not a git" in done.stderr else done.stderr)
    return done.stdout.strip()


def changed_files(root=ROOT, base=None):
    """The files that differ from the main branch, relative to the root.

    base: a revision to compare with in its place. Raises Unknown with the reason.
    """
    if dirty := git("status", "--porcelain", root=root).splitlines():
        raise Unknown(f"{len(dirty)} files are not committed")
    if git("rev-parse", "--is-shallow-repository", root=root) == "true":
        raise Unknown("the clone is shallow")
    base = base or main_branch(root)
    fork = git("merge-base", base, "HEAD", root=root)
    return set(git("diff", "--name-only", "--no-renames", fork, "HEAD", root=root).splitlines())


def main_branch(root):
    """The main branch of the remote, or the local one where HEAD is another branch."""
    for name in ("origin/main", "main"):
        try:
            git("rev-parse", "--verify", "--quiet", f"{name}^{{commit}}", root=root)
        except Unknown:
            continue
        if name != git("rev-parse", "--abbrev-ref", "HEAD", root=root):
            return name
    raise Unknown("there is no main branch to compare with")


@cache
def package_graph():
    """The imports of the package, those inside functions as well, those for types alone not."""
    import grimp

    return grimp.build_graph("ambrose", cache_dir=None, exclude_type_checking_imports=True)


@cache
def imports_of(module):
    """The modules that a module of the package imports, or takes from the registry by its kind."""
    from ambrose.registry import registered

    needed = set(package_graph().find_modules_directly_imported_by(module))
    if "ambrose.registry" in needed:
        file = ROOT.joinpath("src", *module.split("."))
        package = file / "__init__.py"  # the folder alone is what a moved package leaves behind
        file = package if package.exists() else file.with_suffix(".py")
        for kind in re.findall(r'registered\("([\w ]+)"\)', file.read_text(encoding="utf-8")):
            needed |= {str(place).partition(":")[0] for place in registered(kind).values()}
    return needed


def modules_behind(modules):
    """These modules of the package and all that they import, directly or not."""
    behind = set()
    pending = [name for name in modules if name in package_graph().modules]
    while pending:
        if (module := pending.pop()) not in behind:
            behind.add(module)
            pending.extend(imports_of(module) - behind)
    return behind


def for_types(node):
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


def names_of(tree):
    """The dotted names that a tree imports, anywhere in it but for types alone."""
    names = set()
    for node in (n for top in tree.body if not for_types(top) for n in ast.walk(top)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names if alias.name != "ambrose"}
        elif isinstance(node, ast.ImportFrom) and node.module == "ambrose":
            names |= {name for alias in node.names for name in home_of(alias.name)}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return names


@cache
def home_of(public):
    """Where a public name lives: of a function of ``ambrose.api`` what it imports itself, or what
    the functions beside it do that it calls.
    """
    import ambrose

    homes = ambrose._HOME
    home = f"ambrose.{homes[public].partition(':')[0] if public in homes else public}"
    if home != "ambrose.api":
        return {home}
    tree = ast.parse((ROOT / "src" / "ambrose" / "api.py").read_text(encoding="utf-8"))
    functions = {n.name: n for n in tree.body if isinstance(n, ast.FunctionDef)}
    called = set()
    pending = [public]
    while pending:
        if (name := pending.pop()) in functions and name not in called:
            called.add(name)
            pending += [n.id for n in ast.walk(functions[name]) if isinstance(n, ast.Name)]
    body = [n for n in tree.body if not isinstance(n, ast.FunctionDef) or n.name in called]
    return names_of(ast.Module(body, []))


@cache
def names_in(path):
    """The dotted names that a file imports, a public name by where it lives; "ambrose.cli", which
    reaches all, where the package is asked for more than public names.
    """
    tree = ast.parse(path.read_text(encoding="utf-8"))
    nodes = list(ast.walk(tree))
    names = names_of(tree)
    imports = [alias for node in nodes if isinstance(node, ast.Import) for alias in node.names]
    aliases = {alias.asname or alias.name for alias in imports if alias.name == "ambrose"}
    used = [n for n in nodes if isinstance(n, ast.Name) and n.id in aliases]
    public = [n for n in nodes if isinstance(n, ast.Attribute) and n.value in used]
    names |= {name for node in public for name in home_of(node.attr)}
    return frozenset(names | {"ambrose.cli"} if len(used) > len(public) else names)


@cache
def reach(path):
    """Modules of the package (None: any of them), and files of tests and benchmarks."""
    files = {path}
    names = set()
    pending = [path]
    while pending:
        found = names_in(pending.pop())
        names |= found
        for name in found:
            own = name.split(".")[-1]
            for file in (TESTS / f"{own}.py", ROOT / "benchmarks" / f"{own}.py"):
                if file.exists() and file not in files:
                    files.add(file)
                    pending.append(file)
    text = path.read_text(encoding="utf-8")
    # the package in a process of its own
    if names & DOORS or re.search(r"""["'](?:-m|ambrose)["']|sys\.executable""", text):
        return None, frozenset(files)
    return frozenset(modules_behind(names)), frozenset(files)


def reached(path, changed):
    """Whether one of the changed files can change what the tests in a file give."""
    modules, files = reach(path)
    text = path.read_text(encoding="utf-8")
    for name in changed:
        file = ROOT / name
        top = name.split("/")[0]
        if name in EVERYTHING or file in files:
            return True
        if top == "src" and (modules is None or file.suffix != ".py" or module_of(file) in modules):
            return True
        if (
            top == "tests"
            and file.suffix != ".py"
            and (file.parent in path.parents or file.stem in text)
        ):
            return True
        if top not in ("src", "tests") and re.search(rf"\b{re.escape(top)}\b", text):
            return True
    return False


def module_of(file):
    """ambrose.core.lft of its file."""
    parts = file.relative_to(ROOT / "src").with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def durations():
    """{test: seconds of processor time}, of the tests that take long enough to be noted."""
    return json.loads(DURATIONS.read_text(encoding="utf-8"))["seconds"]


def write_durations(seconds):
    """Keep what was measured: the tests of a file that is there and was not run keep theirs.

    seconds: {test: seconds of processor time}.
    """
    run = {name.split("::")[0] for name in seconds}
    kept = {
        name: s
        for name, s in durations().items()
        if (file := name.split("::")[0]) not in run and (ROOT / file).exists()
    }
    # a test that is named after a place of this computer is another one elsewhere
    here = {n: s for n, s in {**kept, **seconds}.items() if str(ROOT) not in n}
    noted = {n: round(s, 1) for n, s in here.items() if s >= NOTED}
    content = {"additions_s": additions(), "seconds": dict(sorted(noted.items()))}
    text = json.dumps(content, indent=0, ensure_ascii=False)
    DURATIONS.write_text(text + "\n", encoding="utf-8")


def additions():
    """Seconds for 10^7 additions in Python: how fast the computer is that measured."""
    begin = time.process_time()
    total = 0
    for number in range(10**7):
        total += number
    return round(time.process_time() - begin, 2)


def left_out(changed, quick=False):
    """The slow tests that are left out: of files that reach nothing that differs.

    changed: the files that differ. quick: all slow ones, whatever differs.
    """
    slow = [name for name, seconds in durations().items() if seconds > SLOW]
    files = {ROOT / name.split("::")[0] for name in slow}
    reaching = {f for f in files if not quick and changed and f.exists() and reached(f, changed)}
    return [name for name in slow if ROOT / name.split("::")[0] not in reaching]


def longest_first(items):
    """The tests, whole files of them, in the order of how long the files take."""
    seconds = durations()
    total = dict.fromkeys((item.path for item in items), 0.0)
    for item in items:
        total[item.path] += seconds.get(item.nodeid, 0.02)
    return sorted(items, key=lambda item: -total[item.path])
