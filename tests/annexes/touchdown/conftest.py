"""Makes ``free_mass`` importable: it goes with its annex."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
