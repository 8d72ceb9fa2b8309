"""What `scripts/benchmark` measures: one module for each subject, and the figures, scenes and recordings that it needs.

Tests use it, too. Nothing that is installed imports it.
"""

import sys
from pathlib import Path

# Tools that the shell scripts use as well, such as `processes`.
sys.path.append(str(Path(__file__).resolve().parents[1] / "lib"))
