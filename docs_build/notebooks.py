"""notebooks/*.ipynb -> a page each, executed while the site is built. In git they stand without
outputs.
"""

import html
import json
import os
import tempfile

from docs_build import ROOT
from docs_build.gallery import fenced, kept

NOTEBOOKS = ROOT / "notebooks"
TIMEOUT = 900  # s for a cell, as for a test; on an idle machine a notebook stays below 60 s in all


def pages():
    """{page: text} of every notebook."""
    return {f"notebooks/{path.stem}.md": page(path) for path in sorted(NOTEBOOKS.glob("*.ipynb"))}


def page(path):
    cells = cells_of(path)
    head = (
        '<script src="../assets/plotly.min.js"></script>\n\n*This page is '
        f"`notebooks/{path.name}`, executed.*\n"
    )
    title, *rest = [of_cell(cell, i) for i, cell in enumerate(cells)]
    return "\n".join([title, head, *rest])


def cells_of(path):
    """The cells with their outputs, kept until the notebook or the package changes."""
    source = path.read_text(encoding="utf-8")
    return kept(source, lambda: executed(path), json.loads(source)["cells"])


def executed(path):
    """The cells of a notebook with their outputs, run in a folder of their own. Raises nbclient's
    CellExecutionError, and RuntimeError where it warns or shows no picture."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    environment = {"OPENBLAS_NUM_THREADS": "1", "PLOTLY_RENDERER": "plotly_mimetype"}
    os.environ.update({name: os.environ.get(name, value) for name, value in environment.items()})
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(
            notebook,
            timeout=TIMEOUT,
            kernel_name="python3",
            resources={"metadata": {"path": folder}},
        ).execute()
    cells = json.loads(nbformat.writes(notebook))["cells"]
    outputs = [
        output for cell in cells if cell["cell_type"] == "code" for output in cell["outputs"]
    ]
    if warned := ["".join(output["text"]) for output in outputs if output.get("name") == "stderr"]:
        raise RuntimeError(f"{path.name} warns: {warned[0]}")
    if not any("application/vnd.plotly.v1+json" in output.get("data", {}) for output in outputs):
        raise RuntimeError(f"{path.name} shows no picture")
    return cells


def of_cell(cell, number):
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        return source + "\n"
    shown = "\n".join(
        of_output(output, f"cell{number}-{i}") for i, output in enumerate(cell["outputs"])
    )
    return f"{fenced(source)}\n\n{shown}\n"


def of_output(output, name):
    """An output as HTML: a plotly figure, a table, a picture or text."""
    data = output.get("data", {})
    if "application/vnd.plotly.v1+json" in data:
        figure = data["application/vnd.plotly.v1+json"]
        config = "{responsive: true, displayModeBar: false}"
        arguments = (
            f'"{name}", {json.dumps(figure["data"])}, {json.dumps(figure["layout"])}, {config}'
        )
        script = f'<div id="{name}"></div><script>Plotly.newPlot({arguments})</script>'
        return f'<div class="plotly-figure" markdown="0">{script}</div>\n'
    if "text/html" in data:
        return f'<div class="cell-output" markdown="0">{"".join(data["text/html"])}</div>\n'
    text = "".join(data.get("text/plain", output.get("text", "")))
    return (
        f'<div class="cell-output" markdown="0"><pre>{html.escape(text.rstrip())}</pre></div>\n'
        if text
        else ""
    )
