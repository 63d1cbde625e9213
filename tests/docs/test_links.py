"""README.md and the other pages at the root link to files that are there; links between pages of docs/ are mkdocs' to check.

README.md is also the page of a package index, where no file of the repository is beside it: its links are
absolute.
"""

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.source

ROOT = Path(__file__).parents[2]


def test_links_of_the_readme_work_on_a_package_index():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)\s]+)", text) + re.findall(r"(?:src|href)=[\"']([^\"']+)", text)
    assert [target for target in targets if not target.startswith("https://")] == []


@pytest.mark.parametrize("name", ["CONTRIBUTING.md", "CHANGELOG.md"])
def test_links_lead_somewhere(name):
    for target in re.findall(r"\]\(([^)#\s]+)", (ROOT / name).read_text(encoding="utf-8")):
        assert target.startswith("https://") or (ROOT / target).exists(), target


def test_every_page_is_in_the_navigation():
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for path in sorted((ROOT / "docs").rglob("*.md")):
        assert path.relative_to(ROOT / "docs").as_posix() in navigation


def test_the_search_of_a_site_opened_from_its_folder_needs_no_network():
    """The offline plugin would load its shim from elsewhere if none with this name were in the configuration."""
    configuration = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    (shim,) = re.findall(r"polyfills: \[(.*iframe-worker.*?)\]", configuration)
    assert (ROOT / "docs" / shim).exists() and "\n  - offline\n" in configuration
