"""The hooks of mkdocs.yml: generated pages join those of docs/, and every ``{{ figure }}`` becomes
its number.

docs_build/figures.py      stored results, and the numbers in the text that come from them
docs_build/blocks.py       code blocks of the pages, run by tests/docs/test_blocks.py
docs_build/ahead.py        runs examples and notebooks on all processors, before their pages are made
docs_build/gallery.py      thumbnails and examples/*.py -> gallery.md, with what they print and their pictures
docs_build/thumbnails.py   the thumbnails, photographed from the pages that commands write
docs_build/words.py        words by tab, which tests/docs/test_words.py limits
docs_build/notebooks.py    notebooks/*.ipynb -> a page each, executed
docs_build/machine_file.py keys, units and limits -> the tables of machine-file.md
docs_build/reference.py    the front door and the packages -> pages for mkdocstrings
"""

import re
import sys
from pathlib import Path

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

sys.path.insert(0, str(Path(__file__).parents[1]))

from docs_build import (
    DOCS,
    ROOT,
    ahead,
    command_line,
    gallery,
    machine_file,
    notebooks,
    reference,
    scenario_file,
)
from docs_build.figures import UnknownFigure, render, stored


def on_config(config):
    """The list of packages in the navigation is that of the tree."""
    for section in config.nav:
        for pages in section.values():
            if isinstance(pages, list) and {"Packages": "reference/packages"} in pages:
                pages[pages.index({"Packages": "reference/packages"})] = {
                    "Packages": reference.navigation()
                }
    return config


def on_files(files, config):
    """Adds the generated pages and the plotting library that their pictures need."""
    for path, trouble in ahead.run():
        if trouble:
            raise PluginError(f"{path.name}: {trouble}")
    pages = {
        "gallery.md": gallery.page(),
        **notebooks.pages(),
        **reference.pages(),
        "reference/command-line.md": command_line.page(),
        "reference/scenario-file.md": scenario_file.page(),
        "contributing.md": from_root("CONTRIBUTING.md"),
        "changelog.md": from_root("CHANGELOG.md"),
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    files.append(File.generated(config, "assets/plotly.min.js", content=gallery.plotly_library()))
    return files


def on_page_markdown(markdown, page, config, files):
    """Figures and comments for the tests; an unknown figure stops the build."""
    try:
        text = render(markdown, stored())
    except UnknownFigure as error:
        raise PluginError(f"{page.file.src_uri}: {error}") from error
    if page.file.src_uri == "reference/machine-file.md":
        text = machine_file.render(text)
    return re.sub(r"<!-- (run|files|python):?.*?-->\n?", "", text, flags=re.DOTALL)


def from_root(name):
    """A page that stands at the root of the repository, its links turned to where docs/ has
    them.
    """
    text = re.sub(r"\]\(docs/", "](", (ROOT / name).read_text(encoding="utf-8"))
    return re.sub(r"\]\((CONTRIBUTING|CHANGELOG)\.md", lambda match: match[0].lower(), text)


__all__ = ["DOCS", "on_config", "on_files", "on_page_markdown"]
