"""Code blocks of docs/*.md and README.md: every ```python and ```console block runs as printed,
page by page, in order.

```python                 runs in the page's namespace; an exception fails the test
```console                `$ command`, then what it prints; `...` stands for anything. `ambrose` runs in this process,
                          other programs where they are installed. Exit status 2 only where the page
                          shows its message
<!-- files: pid.json -->  before the first block: files that the page's commands find in their folder (FILES)
<!-- python: ... -->      runs, but is not shown
<!-- run: stored -->      a ```console block that takes too long for the tests: compared with docs/outputs.json
<!-- run: no, REASON -->  not run

python -m docs_build.blocks how-to/design.md      run a page here and show what differs
python -m docs_build.blocks --stored              run the stored commands anew and write docs/outputs.json (minutes)
"""

import argparse
import contextlib
import doctest
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from click.testing import CliRunner

from docs_build import DOCS, ROOT

OUTPUTS = DOCS / "outputs.json"
FILES = {  # name -> the command that makes it; made once and copied
    "pid.json": "ambrose synthesize seal-rig --method pid -o pid.json",
    "hinf.json": "ambrose synthesize seal-rig --method hinf -o hinf.json",
    "controller.json": "ambrose synthesize seal-rig --method pid -o controller.json",
    "prbs.h5": "ambrose simulate seal-rig --controller pid.json --scenario prbs -o prbs.h5",
    "loads.h5": "ambrose simulate seal-rig --controller pid.json --scenario static-loads-both -o "
    "loads.h5",
}
RECORDS = ROOT / "tests" / "records" / "levitation"  # files of it may be named, too
_NEEDS = {"prbs.h5": ["pid.json"], "loads.h5": ["pid.json"]}
_BLOCK = re.compile(
    r"^<!-- (?P<mark>files|python|run): "
    r"?(?P<note>.*?)-->|^```(?P<kind>\w+)(?P<rest>[^\n]*)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
_SAME = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


@dataclass(frozen=True)
class Block:
    """A piece of a page. kind: python, console, files or file (of that title); mark: "", "stored"
    or "no"; line: its place.
    """

    kind: str
    text: str
    mark: str
    line: int
    title: str = ""


class Differs(AssertionError):
    """A block did not do what the page says."""


def pages():
    """Every page whose blocks run, by its name in docs/."""
    return {"README.md": ROOT / "README.md"} | {
        path.relative_to(DOCS).as_posix(): path for path in sorted(DOCS.rglob("*.md"))
    }


def blocks(text):
    """The blocks of a page, marks applied to the block that follows them."""
    result, mark = [], ""
    for match in _BLOCK.finditer(text):
        line = text.count("\n", 0, match.start()) + 1
        if match["mark"] == "run":
            mark = match["note"].split(",")[0].strip()
            continue
        if match["mark"]:
            result.append(Block(match["mark"], match["note"].strip(), "", line))
            continue
        title = re.search(r'title="([^"]+)"', match["rest"])
        if title:
            result.append(Block("file", match["text"], mark, line, title[1]))
        elif match["kind"] in ("python", "console"):
            result.append(Block(match["kind"], match["text"], mark, line))
        mark = ""
    return result


def commands(text):
    """(command, what it prints) of a console block; a line that ends in a backslash goes on."""
    pairs = []
    for line in text.splitlines():
        if line.startswith("$ "):
            pairs.append([line[2:], ""])
        elif pairs and pairs[-1][0].endswith("\\") and not pairs[-1][1]:
            pairs[-1][0] = pairs[-1][0][:-1] + line.strip()
        elif pairs:
            pairs[-1][1] += line + "\n"
        else:
            raise Differs(
                f"a console block begins with {line!r}; it must begin with a command, '$ ...'"
            )
    return [(command, printed) for command, printed in pairs]


def stored_outputs():
    return json.loads(OUTPUTS.read_text(encoding="utf-8")) if OUTPUTS.exists() else {}


def run_page(name, cache):
    """Runs the blocks of a page in a folder of their own; ``cache``: where files for several pages
    lie. Raises Differs.
    """
    parts = blocks(pages()[name].read_text(encoding="utf-8"))
    if not any(block.kind in ("python", "console") and block.mark != "no" for block in parts):
        return 0
    namespace, done = {"__name__": "__main__"}, 0
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for block in sorted(parts, key=lambda block: block.kind != "file"):
            if block.mark == "no":
                continue
            try:
                run_block(block, namespace, cache)
            except Differs:
                raise
            except Exception as error:
                raise Differs(
                    f"{name}:{block.line}: {type(error).__name__}: {error}\n{block.text}"
                ) from error
            done += 1
    return done


def run_block(block, namespace, cache):
    if block.kind == "files":
        for name in block.text.split():
            shutil.copy(make_file(name, cache), name)
    elif block.kind == "file":
        Path(block.title).write_text(block.text, encoding="utf-8")
    elif block.kind == "python":
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(block.text, f"line {block.line}", "exec", dont_inherit=True), namespace)
    else:
        for command, printed in commands(block.text):
            status, output = (
                (0, stored_outputs().get(command))
                if block.mark == "stored"
                else run_command(command)
            )
            compare(command, printed, status, output)


def compare(command, printed, status, output):
    """Raises Differs unless the command ended and printed as the page shows; a page may show
    nothing of what is printed.
    """
    if output is None:
        if status != "stored":
            return  # a program that is not installed here
        raise Differs(
            f"$ {command}\nis not in docs/outputs.json; run python -m docs_build.blocks --stored"
        )
    if status not in (0, 1) and not printed.startswith("ambrose: "):
        raise Differs(f"$ {command}\nended with exit status {status}:\n{output}")
    if printed.strip() and not doctest.OutputChecker().check_output(printed, output, _SAME):
        raise Differs(f"$ {command}\nthe page shows\n{printed}\nbut it prints\n{output}")


def run_command(command):
    """(exit status, standard output; the message of a refusal). Standard error holds progress,
    which pages do not show.
    """
    words = shlex.split(command, comments=True)
    if words[0] == "ambrose":
        from ambrose.cli import main

        done = CliRunner(env={"COLUMNS": "100", "TERM": "dumb"}).invoke(main, words[1:])
        if done.exception and not isinstance(done.exception, SystemExit):
            raise done.exception
        _, refused, why = done.stderr.partition("ambrose: ")  # progress before it
        return done.exit_code, done.stdout or refused + why
    if words[0] == "python":
        words[0] = sys.executable
    elif not shutil.which(words[0]) and not Path(words[0]).exists():
        return 0, None
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=600)
    return done.returncode, done.stdout + done.stderr


def make_file(name, cache):
    """The path of a shared file, made on first use, or of a record as it is."""
    if (RECORDS / name).is_file():
        return RECORDS / name
    path = Path(cache) / name
    if not path.exists():
        for needed in _NEEDS.get(name, []):
            make_file(needed, cache)
        with contextlib.chdir(cache):
            status, output = run_command(FILES[name])
        if status not in (0, 1):
            raise Differs(f"{FILES[name]}: {output}")
    return path


def quoted_commands(text):
    """Every `ambrose ...` of a page, shown as a block, in a table or in a sentence."""
    shown = [
        command
        for block in blocks(text)
        if block.kind == "console"
        for command, _ in commands(block.text)
    ]
    words = re.findall(r"`(ambrose [a-z][^`\n]*)`", text) + re.findall(
        r"^ *(ambrose [a-z].*)$", text, re.MULTILINE
    )
    return [
        command
        for command in shown + words
        if command.startswith("ambrose ") and "..." not in command
    ]


def stored_commands():
    """Every command whose output is stored, with the folder's files it needs: (page, command)."""
    return [
        (name, command)
        for name, path in pages().items()
        for block in blocks(path.read_text(encoding="utf-8"))
        if block.mark == "stored"
        for command, _ in commands(block.text)
    ]


def store(cache):
    """Runs the stored commands, page by page in one folder each, and writes what they print to
    docs/outputs.json.
    """
    outputs = {}
    for name in dict.fromkeys(page for page, _ in stored_commands()):
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            for block in blocks(pages()[name].read_text(encoding="utf-8")):
                if block.kind == "files":
                    run_block(block, {}, cache)
            for command in [command for page, command in stored_commands() if page == name]:
                print(f"{name}: {command}", file=sys.stderr)
                status, outputs[command] = run_command(command)
                if status not in (0, 1):
                    raise Differs(f"{command}: {outputs[command]}")
    OUTPUTS.write_text(json.dumps(outputs, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def main(arguments=None):
    parser = argparse.ArgumentParser(
        prog="python -m docs_build.blocks", description="Run the code blocks of docs/."
    )
    parser.add_argument("names", nargs="*", help="pages; default: all")
    parser.add_argument(
        "--stored",
        action="store_true",
        help="run the stored commands anew and write docs/outputs.json",
    )
    options = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with tempfile.TemporaryDirectory() as cache:
        if options.stored:
            store(cache)
            return 0
        failures = 0
        for name in options.names or pages():
            try:
                print(f"{name}: {run_page(name, cache)} blocks")
            except Differs as difference:
                failures += 1
                print(f"{name}: {difference}")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
