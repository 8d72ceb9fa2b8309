"""Puts scripts/ of the checkout on the import path: some tests measure with the tools of `scripts/benchmark`."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2] / "scripts"))
