"""The gallery: thumbnails of the pages that commands write, and examples/*.py with what they print and their pictures.

The thumbnails are stored (docs_build/thumbnails.py); the examples run while the site is built.
An example that has a picture defines ``picture()``, which gives a plotly figure. Results are kept in .site_cache/ until the
example or the package changes. DRAFT=1 in the environment builds the pages without running anything.
"""

import contextlib
import hashlib
import io
import json
import os
import runpy

from docs_build import ROOT

EXAMPLES = ROOT / "examples"
CACHE = ROOT / ".site_cache"


def page():
    """gallery.md."""
    from docs_build import thumbnails

    examples = sorted(EXAMPLES.glob("[0-9]*.py"))
    pictured = thumbnails.with_picture()
    pages = [
        card(thumbnails.thumbnail(item.name), item.title, item.text, item.link)
        for item in thumbnails.CARDS
    ]
    figures = [
        card(
            thumbnails.thumbnail(thumbnails.number(path)),
            split(path.read_text(encoding="utf-8"))[0],
            "",
            f"#{anchor(path)}",
        )
        for path in pictured
    ]
    parts = [
        "# Gallery\n",
        "## Pages that the commands write\n",
        grid(pages),
        "## Examples\n",
        "One page of Python each. They run as tests; what they print and their pictures come from the build of this site.\n",
        grid(figures),
        '<script src="assets/plotly.min.js"></script>\n',
    ]
    for path in examples:
        run = run_of(path)
        title, body = split(path.read_text(encoding="utf-8"))
        parts.append(f"### {title} {{ #{anchor(path)} }}\n\n`examples/{path.name}`\n")
        if run["picture"]:
            parts.append(f'<div class="plotly-figure" markdown="0">{run["picture"]}</div>\n')
        parts.append(f"It prints\n\n```text\n{run['printed'].rstrip()}\n```\n")
        parts.append(f'??? example "The program"\n\n{indented(fenced(body))}\n')
    return "\n".join(parts)


def card(image, title, text, link):
    """A picture, its title and a sentence, all leading to ``link``."""
    words = f"**[{title}]({link})**" + (f"<br>{text}" if text else "")
    return f"-   [![{title}]({image})]({link})\n\n    {words}\n"


def grid(cards):
    return '<div class="grid cards gallery" markdown>\n\n' + "\n".join(cards) + "\n</div>\n"


def anchor(path):
    """Of an example's section: "example-02"."""
    return f"example-{path.name.partition('_')[0]}"


def run_of(path):
    """What an example prints and shows, kept until it or the package changes."""
    source = path.read_text(encoding="utf-8")
    return kept(source, lambda: of_example(path), {"printed": "(a draft: not run)", "picture": ""})


def of_example(path):
    """What an example prints when it is run, and its picture as HTML."""
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        names = runpy.run_path(str(path), run_name="__main__")
    figure = names["picture"]() if "picture" in names else None
    return {"printed": printed.getvalue(), "picture": html_of(figure) if figure is not None else ""}


def html_of(figure):
    """A plotly figure as a piece of a page that has the library already."""
    return figure.to_html(
        full_html=False,
        include_plotlyjs=False,
        default_width="100%",
        config={"responsive": True, "displayModeBar": False},
    )


def plotly_library():
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()


def split(source):
    """Title and text of an example: the first sentence of its docstring heads it."""
    docstring = source.split('"""')[1]
    title = docstring.split("\n")[0].split(": ")[0].rstrip(".")
    return title, source


def fenced(source):
    return f"```python\n{source.rstrip()}\n```"


def indented(text):
    return "\n".join(f"    {line}" if line else "" for line in text.splitlines())


def kept(source, make, draft):
    """What ``make`` gives, as JSON; kept until the source or the package changes. ``draft``: what a
    draft shows.
    """
    if os.environ.get("DRAFT"):
        return draft
    path = CACHE / f"{hashlib.sha256((source + _package()).encode()).hexdigest()}.json"
    if path.exists():
        return json.loads(path.read_text(encoding="utf-8"))
    before = os.getcwd()
    result = make()
    os.chdir(before)
    CACHE.mkdir(exist_ok=True)
    path.write_text(json.dumps(result), encoding="utf-8")
    return result


def _package():
    digest = hashlib.sha256()
    for path in sorted(
        [*(ROOT / "src").rglob("*.py"), *(ROOT / "src").rglob("*.toml"), *EXAMPLES.iterdir()]
    ):
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()
