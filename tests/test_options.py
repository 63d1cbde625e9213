"""Options stand with the class that has them: what goes with what, the flags and their units come
from there.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, fields

import click
import numpy as np
import pytest
from click.testing import CliRunner

import ambrose as amb
from ambrose.cli import GROUPS, main
from ambrose.code.targets import TARGETS
from ambrose.core.checks import InvalidInput
from ambrose.identification.methods import METHODS
from ambrose.identification.output_error.problem import FitOptions
from ambrose.options import Options, choose, hertz, option, option_of, positive, settings
from ambrose.synthesis.methods import methods
from ambrose.terminal import chosen_from, options_from


@dataclass(frozen=True, slots=True, kw_only=True)
class Plain(Options):
    limit: float | None = option(None, "Of both.", check=positive("give it"))
    often: int = option(2, "How often.")


@dataclass(frozen=True, slots=True, kw_only=True)
class Tonal(Options):
    limit: float | None = option(None, "Of both.", check=positive("give it"))
    tone: float | None = option(None, "A tone.", flag="--tone-hz", convert=hertz)
    kind: str = option("sine", "Its kind.", choices=("sine", "square"))


KINDS = {"plain": Plain, "tonal": Tonal}


def test_an_option_of_another_class_is_refused_by_those_that_have_it():
    message = "tone is given, but must be left out with sort plain; it goes with tonal"
    with pytest.raises(InvalidInput, match=message):
        choose(KINDS, "sort", "plain", {"tone": 1.0})
    with pytest.raises(InvalidInput, match='did you mean "often"'):
        choose(KINDS, "sort", "plain", {"offen": 1})
    with pytest.raises(InvalidInput, match=r"sort is 'tonl', but .* did you mean .tonal."):
        choose(KINDS, "sort", "tonl", {})
    with pytest.raises(InvalidInput, match="kind is 'saw', but must be one of sine, square"):
        choose(KINDS, "sort", "tonal", {"kind": "saw"})


def test_an_object_and_its_name_are_one():
    assert choose(KINDS, "sort", Tonal(tone=3.0), {"limit": 2.0}) == Tonal(tone=3.0, limit=2.0)
    assert choose(KINDS, "sort", "tonal", {"tone": 3.0}) == Tonal(tone=3.0)
    assert settings(KINDS, Plain(often=3)) == {
        "limit": None,
        "often": 3,
        "tone": None,
        "kind": "sine",
    }


def command():
    @click.command()
    @click.argument("sort")
    @options_from(KINDS)
    def made(sort, **asked):
        try:
            click.echo(repr(chosen_from(KINDS, sort, asked, "--sort")))
        except InvalidInput as error:
            click.echo(str(error))

    return made


@pytest.mark.parametrize(
    ("line", "output"),
    [
        (["plain", "--often", "5"], "Plain(limit=None, often=5)"),
        (["tonal", "--tone-hz", "0.5"], f"Tonal(limit=None, tone={hertz(0.5)}, kind='sine')"),
        (["tonal", "--limit", "0"], "--limit is 0.0, but must be positive; give it"),
        (
            ["plain", "--tone-hz", "5"],
            "--tone-hz is given, but must be left out with --sort plain; it goes with tonal",
        ),
    ],
)
def test_flags_read_units_and_refuse_by_their_own_names(line, output):
    assert CliRunner().invoke(command(), line).output.strip() == output


@pytest.mark.parametrize(
    ("name", "kinds"),
    [("synthesize", methods()), ("export", TARGETS), ("identify", METHODS)],
)
def test_every_option_of_the_library_has_its_flag(name, kinds):
    flags = {item.name for item in main.commands[name].params}
    for kind in kinds.values():
        for item in fields(kind):
            assert (item.name in flags) == (option_of(item).flag is not None), item.name
            assert item.name in (kind.__doc__ or "") or any(
                item.name in (base.__doc__ or "") for base in kind.__mro__
            ), f"{kind.__name__}.{item.name} is not documented"


def test_loop_methods_fit_with_the_defaults_of_the_fit():
    """The defaults of a fit stand in two places: here they are held to be the same."""
    for kind in (amb.ClosedLoop, amb.Youla):
        assert kind().fit_options(None) == FitOptions()
    assert amb.ClosedLoop().fit_options(3).computing_delay == 3
    assert amb.ClosedLoop(computing_delay=2).fit_options(3).computing_delay == 2


def test_every_command_stands_in_one_group():
    assert sorted(name for group in GROUPS.values() for name in group) == sorted(main.commands)
    shown = CliRunner().invoke(main, ["--help"]).output
    assert all(f"\n{title}:\n" in shown for title in GROUPS)


@pytest.mark.parametrize("name", ["synthesize", "simulate", "verify", "export", "identify"])
def test_every_option_stands_in_one_group_of_the_help(name):
    made = main.commands[name]
    context = click.Context(made, info_name=name)
    rows = [item.name for group in made.grouped(context).values() for item in group]
    options = [p.name for p in made.get_params(context) if p.param_type_name == "option"]
    assert sorted(rows) == sorted(options)
    # no group names an option that the command does not have
    listed = [item for group in made.groups.values() for item in group]
    assert set(listed) <= set(options)


def test_help_does_without_numpy():
    """One annex's command loaded it, for every help."""
    code = (
        "import sys; from click.testing import CliRunner; from ambrose.cli import main; "
        "CliRunner().invoke(main, ['synthesize', '--help']); print('numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_method_refuses_what_did_nothing():
    """They were taken, and had no effect; the note of a lowered schedule was untrue."""
    for kind, options in (
        ("pid", {"match_reference": True}),
        ("pid", {"bending_modes": 2}),
        ("lpv", {"match_reference": True}),
        ("lpv", {"loss": 0.05, "rate": 1e4}),
    ):
        with pytest.raises(InvalidInput, match=f"left out with method {kind}; it goes with"):
            choose(methods(), "method", kind, options)


def test_an_array_is_no_plain_value():
    """Whose == is no truth: it ended in a ValueError of numpy's."""
    with pytest.raises(InvalidInput, match="unknown is an array of 1"):
        amb.Youla(unknown=np.array("x"))
    with pytest.raises(InvalidInput, match="average is an array of 4"):
        amb.StaticLoads(average=np.full((2, 2), np.nan))
