"""Puts the benchmarks, and the helpers of other tests, on the import path."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[2]))
