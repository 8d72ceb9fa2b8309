"""Look at the repository's own files: what must not be in it, and file modes.

Each rule prints its violations; the closing line says how many rules held and how many did not.
Only the standard library.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Tuple

MAX_BYTES = 500_000
_SKIPPED_DIRECTORIES = {".git", ".ws", "__pycache__", ".pytest_cache", ".ruff_cache"}
# Directories of one machine; ordinary system directories (/usr, /etc, /opt/ros, /tmp) may be named.
_MACHINE_PATH = re.compile(r"(?<![\w.~$}/-])/(?:home|root|work|Users|mnt|media|tmp)/[\w.-]+")
_ALLOWED_PATH = re.compile(r"/tmp/\.X11-unix")
_BINARY = {".bag", ".png", ".jpg", ".jpeg", ".npz", ".onnx", ".pdf", ".gz"}


def repository_files(root: Path) -> List[Path]:
    """Files of the repository, relative: those git knows or would take, else all but build products."""
    try:
        listing = subprocess.run(
            ["git", "-C", str(root), "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True,
        ).stdout
        names = {Path(os.fsdecode(name)) for name in listing.split(b"\0") if name}
    except (OSError, subprocess.CalledProcessError):
        names = set(_walk(root))
    return sorted(name for name in names if (root / name).is_file())


def _walk(root: Path) -> Iterator[Path]:
    for directory, folders, files in os.walk(str(root)):
        folders[:] = [name for name in folders if name not in _SKIPPED_DIRECTORIES]
        for name in files:
            if not name.endswith(".pyc"):
                yield (Path(directory) / name).relative_to(root)


def _text(path: Path) -> str:
    return "" if path.suffix in _BINARY else path.read_text(encoding="utf-8", errors="replace")


def large_files(root: Path, files: List[Path]) -> List[str]:
    """Files above the size limit."""
    return [
        "%s: %d bytes, more than %d" % (name, (root / name).stat().st_size, MAX_BYTES)
        for name in files
        if (root / name).stat().st_size > MAX_BYTES
    ]


def machine_paths(root: Path, files: List[Path]) -> List[str]:
    """Lines with a path that exists on somebody's machine only."""
    found = []
    for name in files:
        for number, line in enumerate(_text(root / name).splitlines(), 1):
            for match in _MACHINE_PATH.finditer(line):
                if not _ALLOWED_PATH.match(match.group()):
                    found.append("%s:%d: %s" % (name, number, match.group()))
    return found


def conflict_marks(root: Path, files: List[Path]) -> List[str]:
    """Left-over marks of a merge."""
    mark = re.compile(r"^(<{7} |>{7} )", re.MULTILINE)
    return [str(name) for name in files if mark.search(_text(root / name))]


RELAYED = {Path("scripts") / name for name in ("calibrate_cameras", "cameras", "report", "score")}
"""Commands that are run with rosrun; as with nodes, an executable one would be found twice."""


def modes(root: Path, files: List[Path]) -> List[str]:
    """Node scripts are 0644 (catkin installs relays; 0755 would give rosrun two candidates), commands 0755."""
    found = []
    for name in files:
        executable = os.access(str(root / name), os.X_OK) and bool((root / name).stat().st_mode & 0o100)
        if "nodes" in name.parts[:-1] and name.parts[0].startswith("hri_") and executable:
            found.append("%s: executable; node scripts must be 0644" % name)
        if name in RELAYED:
            found += ["%s: executable; catkin makes a relay of it, so it must be 0644" % name] if executable else []
        elif name.parent == Path("scripts") and name.suffix == "" and not executable:
            found.append("%s: not executable; commands must be 0755" % name)
        if name.match("test/ros/*.py") and _text(root / name).startswith("#!") and not executable:
            found.append("%s: not executable; test nodes must be 0755" % name)
    return found


RULES: Dict[str, Callable[[Path, List[Path]], List[str]]] = {
    "no file above 500 kB": large_files,
    "no path of one machine": machine_paths,
    "no merge marks": conflict_marks,
    "file modes": modes,
}


def check(root: Path) -> Tuple[int, int]:
    """Apply all rules, print the violations; returns the number of rules that held and that did not."""
    files = repository_files(root)
    held = broken = 0
    for title, rule in RULES.items():
        violations = rule(root, files) if files else ["no files found"]
        held, broken = (held, broken + 1) if violations else (held + 1, broken)
        for violation in violations:
            print("%s: %s" % (title, violation))
    return held, broken


def main(arguments: List[str]) -> int:
    """Command line: ROOT."""
    if len(arguments) != 1:
        print(main.__doc__, file=sys.stderr)
        return 2
    held, broken = check(Path(arguments[0]))
    print("%d passed, %d failed" % (held, broken))
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
