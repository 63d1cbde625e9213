"""`ambrose trade-off`."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from ambrose.terminal import (
    AS_JSON,
    DELAY,
    MACHINE,
    RATE,
    claim,
    kept,
    load,
    print_table,
    progress_shown,
    say_json,
)

_OVER = (
    "settling_time",
    "unbalance_orbit",
    "max_current",
    "compliance_peak",
    "control_gain",
    "log_decrement",
    "order",
)


@click.command("trade-off")
@MACHINE
@click.option(
    "--over",
    type=click.Choice(_OVER),
    required=True,
    help="A key of [requirements], or the controller's order.",
)
@click.option(
    "--values", required=True, help='Two or more, separated by commas: "20 ms, 30 ms, 60 ms".'
)
@click.option(
    "--order", type=int, default=None, help="States of the controllers; default: three per axis."
)
@click.option(
    "--structure", type=click.Choice(["free", "plane", "axis"]), default="free", show_default=True
)
@RATE
@DELAY
@click.option(
    "-o",
    "--output",
    type=click.Path(path_type=Path),
    default=None,
    help="Write the curve as a page (*.html).",
)
@AS_JSON
def trade_off(
    machine: str,
    over: str,
    values: str,
    order: int | None,
    structure: str,
    rate_hz: float | None,
    delay_samples: int | None,
    output: Path | None,
    as_json: bool,
) -> None:
    """What a requirement costs: the lowest sensitivity that a tuned controller reaches at each of
    its values.
    """
    from ambrose.machine.atomic_write import write_text
    from ambrose.synthesis.methods.tuned import Tuned
    from ambrose.synthesis.trade_off import read_value
    from ambrose.synthesis.trade_off import trade_off as traded

    description = load(machine)
    wanted = [read_value(over, text.strip()) for text in values.split(",") if text.strip()]
    method = Tuned(rate=rate_hz, delay_samples=delay_samples, order=order, structure=structure)
    claim(page=output)
    with progress_shown(as_json) as progress:
        result = traded(description, over, wanted, method, progress=progress)
    failure = None
    if output is not None:
        from ambrose.report.plot import plot

        text = plot(result).to_html(
            include_plotlyjs=True, config={"responsive": True, "displayModeBar": False}
        )
        failure = kept(lambda path: write_text(path, text, "page"), output)
    if as_json:
        rows = zip(result.values, result.sensitivity, result.met, result.binding, strict=True)
        keys = ("value", "sensitivity", "met", "binding")
        say_json(
            {
                "over": over,
                "unit": result.unit,
                "rows": [dict(zip(keys, row, strict=True)) for row in rows],
            }
        )
    else:
        heading = over if result.unit == "-" else f"{over} [{result.unit}]"
        print_table(
            f"lowest sensitivity against {over}",
            (heading, "sensitivity", "all else met", "what binds"),
            [
                (f"{v:.4g}", f"{s:.3g}", "yes" if m else "no", b)
                for v, s, m, b in zip(
                    result.values, result.sensitivity, result.met, result.binding, strict=True
                )
            ],
        )
    if failure is not None:
        raise failure
    sys.exit(0 if all(result.met) else 1)
