"""Words of the pages by tab: each side stays small, a how-to page is one task.

python -m docs_build.words      words by tab, and of every page

Counted are the pages written by hand, with tables and code, as ``wc -w`` does, but without comments
(what the tests run and no reader sees); pages made from docstrings, examples and notebooks are not.
The tab of a page is that of the navigation in mkdocs.yml.
"""

import re

from docs_build import DOCS, ROOT

USERS = ("Start", "How to", "Reference", "Theory")
MOST = 28_000  # words of the user's side
MOST_HOW_TO = 899  # words of a how-to page
MOST_RESEARCH = 25_000  # words of the research tab, the pages for who takes part included


def tabs():
    """{tab: its pages that are written by hand}, in the order of the navigation."""
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    result = {}
    for line in navigation.splitlines():
        if tab := re.fullmatch(r"  - ([\w ]+):", line):
            pages = result.setdefault(tab[1], [])
        elif (page := re.search(r"([\w/-]+\.md)$", line)) and (DOCS / page[1]).exists():
            pages.append(page[1])
    return result


def words(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    return len(re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL).split())


def main():
    counted = {tab: {page: words(page) for page in pages} for tab, pages in tabs().items()}
    for tab, pages in counted.items():
        print(f"{tab:12}{sum(pages.values()):7}")
        for page, number in pages.items():
            print(f"    {page:40}{number:6}")
    users = sum(sum(counted[tab].values()) for tab in USERS)
    print(f"the user's side: {users} of at most {MOST}")
    print(f"research: {sum(counted['Research'].values())} of at most {MOST_RESEARCH}")


if __name__ == "__main__":
    main()
