"""The page of the command line, from click's own description of every command."""

import html
import importlib
import inspect

import click

HEAD = """# Command line

Generated from the program itself. Every command takes `--json`, which prints one JSON object and nothing else. Exit status 0:
done, and every required check passed; 1: done, but a check failed; 2: bad input or nothing could be computed, with one message
that says what to do.
"""


def page():
    """reference/command-line.md."""
    main = importlib.import_module("ambrose.cli").main
    parts = [HEAD, f"```text\n{main.get_help(click.Context(main, info_name='ambrose'))}\n```\n"]
    return "\n".join(
        [*parts, *(section(name, command) for name, command in sorted(main.commands.items()))]
    )


def section(name, command):
    """A command: what it does, how it is called, a row per option."""
    context = click.Context(command, info_name=f"ambrose {name}")
    usage = " ".join(command.collect_usage_pieces(context))
    options = "\n\n".join(
        table(title, rows, context) for title, rows in groups(command, context).items()
    )
    return (
        f"## ambrose {name}\n\n{escaped(inspect.cleandoc(command.help))}\n\n```text\nambrose "
        f"{name} {usage}\n```\n\n{options}\n"
    )


def groups(command, context):
    """{title: options} of a command; one group without a title where it has none."""
    if hasattr(command, "grouped"):
        return command.grouped(context)
    return {"": [item for item in command.get_params(context) if isinstance(item, click.Option)]}


def table(title, options, context):
    """A group of options, a row for each."""
    heading = f"| {title[:1].lower()}{title[1:] or 'option'} | meaning |"
    return "\n".join([heading, "|---|---|", *(row(option, context) for option in options)])


def row(option, context):
    names, meaning = option.get_help_record(context)
    choices = html.escape(names).replace(
        "|", "&#124;<wbr>"
    )  # a long list of choices breaks after a bar
    meaning = escaped(meaning.replace("|", "\\|"))
    return f"| <code>{choices}</code> | {meaning} |"


def escaped(text):
    """Stars and angles that Markdown would take for its own."""
    return text.replace("*", "&#42;").replace("<", "&lt;")
