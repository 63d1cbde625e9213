"""The notebooks run from top to bottom, use the front door only, and stand in git without
outputs.
"""

import json
import re

import pytest
from docs_build.notebooks import NOTEBOOKS, executed

pytestmark = pytest.mark.study  # minutes

PATHS = sorted(NOTEBOOKS.glob("*.ipynb"))


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_runs(path):
    pytest.importorskip("nbclient")
    outputs = [
        output
        for cell in executed(path)
        if cell["cell_type"] == "code"
        for output in cell["outputs"]
    ]
    assert any("application/vnd.plotly.v1+json" in output.get("data", {}) for output in outputs)
    assert not [
        output
        for output in outputs
        if output["output_type"] == "error" or output.get("name") == "stderr"
    ]


@pytest.mark.parametrize("path", PATHS, ids=lambda path: path.stem)
def test_stands_in_git_without_outputs_and_imports_the_front_door_only(path):
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None
            source = "".join(cell["source"])
            assert not re.search(r"(from|import) ambrose\.|amb\.\w+\.\w+ import", source)
