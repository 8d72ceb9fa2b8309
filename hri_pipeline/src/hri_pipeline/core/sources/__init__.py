"""Where images and sound come from when no robot sends them: files, directories, cameras, microphones."""

from __future__ import annotations

import re
from pathlib import Path
from typing import List, Tuple


def in_reading_order(path: Path) -> List[Tuple[int, int, str]]:
    """Sort key of files: picture2 comes before picture10."""
    return [(0, int(part), "") if part.isdecimal() else (1, 0, part.lower())
            for part in re.split(r"(\d+)", path.name) if part]
