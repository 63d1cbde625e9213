"""Everywhere in the tests: shapes stated in docstrings are checked, and `tests/` is importable (random_systems)."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import shape_contract

shape_contract.install()
