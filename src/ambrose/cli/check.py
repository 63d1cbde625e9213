"""`ambrose machines` and `ambrose check`."""

from __future__ import annotations

import sys

import click

from ambrose.terminal import AS_JSON, MACHINE, load, print_table, say, say_json


@click.command()
@AS_JSON
def machines(as_json: bool) -> None:
    """List the bundled machines."""
    from ambrose.machine.file.toml import bundled_machines, load_machine

    descriptions = {name: load_machine(name).description for name in bundled_machines()}
    if as_json:
        say_json(descriptions)
        return
    print_table("Bundled machines", ("name", "what it is"), list(descriptions.items()))


@click.command()
@click.argument("name", required=False)
@AS_JSON
def scenarios(name: str | None, as_json: bool) -> None:
    """List the bundled scenarios, or print the file of the one called NAME, to copy and change."""
    from ambrose.rig.scenario import bundled_scenarios, scenario_text

    known = bundled_scenarios()
    if name is not None:
        text = scenario_text(name)
        if as_json:
            say_json({"name": name, "text": text})
        else:
            for line in text.splitlines():
                say(line)
        return
    if as_json:
        say_json(known)
    else:
        print_table("Bundled scenarios", ("name", "what is done"), list(known.items()))


@click.command()
@MACHINE
@AS_JSON
def check(machine: str, as_json: bool) -> None:
    """Validate a machine file, and say what it can do: mass, magnets against weight, bending,
    poles, critical speeds.

    What is implausible (a length without its unit, a magnet that cannot lift, a gain below k_s/k_i)
    is said with its remedy, and the exit status is 1.
    """
    from ambrose.chain.facts_in_words import rows_of
    from ambrose.chain.plants import facts

    known = facts(load(machine, magnets=False), machine)
    if as_json:
        say_json(known)
    else:
        title = ": ".join(text for text in (known["machine"], known["description"]) if text)
        print_table(title, ("quantity", "value"), rows_of(known))
        for doubt in known["doubts"]:
            say(f"implausible: {doubt}")
        for remark in known["remarks"]:
            say(f"note: {remark}")
    sys.exit(1 if known["doubts"] else 0)
