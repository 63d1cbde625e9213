"""Every code block of README.md and docs/ runs as printed, and what is stored of slow commands is
what the pages show.
"""

import shlex

import click
import pytest
from docs_build.blocks import (
    Differs,
    blocks,
    commands,
    compare,
    pages,
    quoted_commands,
    run_block,
    run_page,
    stored_commands,
    stored_outputs,
)

from ambrose.cli import main
from ambrose.rig import scenario

NAMES = [name for name, path in pages().items() if blocks(path.read_text(encoding="utf-8"))]


@pytest.fixture(scope="module", autouse=True)
def brief_sequence():
    """The bundled sequence once through: of five seconds of it the pages show no figure."""
    read = scenario.read_toml

    def brief(path, kind):
        document = read(path, kind)
        return document | ({"duration": "1.1 s"} if document.get("name") == "prbs" else {})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scenario, "read_toml", brief)
        yield


@pytest.mark.parametrize("name", NAMES)
def test_page_runs_as_printed(name, cache):
    run_page(name, cache)


def test_every_stored_output_is_quoted_and_every_quoted_one_is_stored():
    assert {command for _, command in stored_commands()} == set(stored_outputs())


@pytest.mark.parametrize("name", pages())
def test_blocks_that_are_not_run_say_why(name):
    for line in pages()[name].read_text(encoding="utf-8").splitlines():
        if line.startswith("<!-- run:"):
            mark, _, reason = (
                line.removeprefix("<!-- run:").removesuffix("-->").strip().partition(",")
            )
            assert mark == "stored" or (mark == "no" and reason), f"{name}: {line}"


@pytest.mark.parametrize("name", pages())
def test_every_command_and_its_options_exist(name):
    """Also where a command stands in a sentence or is not run."""
    for quoted in quoted_commands(pages()[name].read_text(encoding="utf-8")):
        _, *words = shlex.split(quoted.replace("|", " "), comments=True)
        assert {words[0], " ".join(words[:2])} & set(main.commands), f"{name}: {quoted}"
        _, command, arguments = main.resolve_command(click.Context(main), words)
        try:
            command.make_parser(click.Context(command, resilient_parsing=True)).parse_args(
                arguments
            )
        except click.NoSuchOption as error:
            raise AssertionError(f"{name}: {quoted}: {error.message}") from error


def test_blocks_and_marks():
    text = (
        "<!-- files: a.json -->\n```python\nx = 1\n```\n<!-- run: stored -->\n```console\n$ "
        "ambrose machines\nseal-rig\n```\n"
    )
    first, second, third = blocks(text)
    assert (first.kind, first.text) == ("files", "a.json")
    assert (second.kind, second.text, second.mark) == ("python", "x = 1\n", "")
    assert (third.mark, commands(third.text)) == ("stored", [("ambrose machines", "seal-rig\n")])


def test_a_block_that_fails_or_prints_something_else_is_noticed(cache):
    (wrong,) = blocks("```console\n$ ambrose machines --json\nanother answer\n```\n")
    with pytest.raises(Differs, match="another answer"):
        run_block(wrong, {}, cache)
    (refused,) = blocks("```console\n$ ambrose check no-such-machine\n```\n")
    with pytest.raises(Differs, match="exit status 2"):
        run_block(refused, {}, cache)
    with pytest.raises(ZeroDivisionError):
        run_block(blocks("```python\n1 / 0\n```\n")[0], {}, cache)
    compare("x", "begins ... ends", 0, "begins with much and ends")
