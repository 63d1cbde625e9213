"""What turns docs/, examples/, notebooks/ and the docstrings into the site; mkdocs calls ``hooks``.
READ hooks.py FIRST.
"""

from pathlib import Path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
