"""The user's side of the documentation stays small, and every page belongs to one tab."""

import pytest
from docs_build import DOCS
from docs_build.words import MOST, MOST_HOW_TO, MOST_RESEARCH, USERS, tabs, words

pytestmark = pytest.mark.source


def test_five_tabs_hold_every_page_once():
    pages = [page for listed in tabs().values() for page in listed]
    assert list(tabs()) == [*USERS, "Research"]
    assert sorted(pages) == sorted(path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md"))


def test_pages_lie_in_the_folder_of_their_tab():
    """machine-file.md lay outside that of Reference."""
    astray = [
        page
        for tab, pages in tabs().items()
        for page in pages
        if page.partition("/")[0] not in {tab.lower().replace(" ", "-"), "index.md"}
    ]
    assert astray == []


@pytest.mark.parametrize("page", tabs()["How to"])
def test_a_how_to_page_holds_one_task(page):
    assert words(page) <= MOST_HOW_TO, (
        f"{page}: split it by task, or move figures to the research tab"
    )


def test_the_users_side_is_small():
    counted = {tab: sum(map(words, tabs()[tab])) for tab in USERS}
    assert sum(counted.values()) <= MOST, counted


def test_the_research_tab_is_small():
    counted = {page: words(page) for page in tabs()["Research"]}
    assert sum(counted.values()) <= MOST_RESEARCH, counted
