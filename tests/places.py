"""Where things lie, for all tests: said once."""

from pathlib import Path

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "scenes"
SCRIPTS = ROOT / "scripts"
