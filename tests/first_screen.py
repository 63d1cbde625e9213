"""What a reader meets of a page before he acts: words that are not folded away, on a screen and on
paper, and how far down the verdict and what decides reach.
"""

from dataclasses import dataclass

WIDTHS = {1400: 900, 400: 800}  # [px], and the height of the first screen
_WORDS = """() => {
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  let count = 0;
  while (texts.nextNode()) {
    const part = texts.currentNode.parentElement;
    if (!part.closest("script, style, noscript") && part.checkVisibility())
      count += texts.currentNode.data.split(/\\s+/).filter(Boolean).length;
  }
  return count;
}"""
_BOTTOM = """(kind) => {
  const part = document.querySelector(kind);
  return part ? Math.ceil(part.getBoundingClientRect().bottom) : Infinity;
}"""


@dataclass(frozen=True)
class Screen:
    """words: in sight on the whole page; verdict, decides: lower ends of the sentence and of the
    table, picture or list that decides [px]; wider: whether the page scrolls sideways; printed:
    words on paper.
    """

    words: int
    verdict: float
    decides: float
    wider: bool
    printed: int


def measure(browser, path, width):
    """The page at ``path`` in a browser of Playwright at that width."""
    context = browser.new_context(viewport={"width": width, "height": WIDTHS[width]})
    try:
        page = context.new_page()
        page.goto(path.as_uri(), wait_until="load", timeout=300_000)
        words = page.evaluate(_WORDS)
        ends = [page.evaluate(_BOTTOM, kind) for kind in (".decision", ".opening, .verdicts")]
        wider = page.evaluate("document.documentElement.scrollWidth > innerWidth")
        page.emulate_media(media="print")
        page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        return Screen(words, *ends, wider, page.evaluate(_WORDS))
    finally:
        context.close()
