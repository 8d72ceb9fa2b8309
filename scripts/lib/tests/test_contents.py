"""The rules on the repository's own files."""

from __future__ import annotations

from pathlib import Path

import contents


def _tree(root: Path, name: str, text: str, mode: int = 0o644) -> Path:
    path = root / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(mode)
    return Path(name)


def test_paths_of_one_machine_are_found(tmp_path: Path) -> None:
    bad = _tree(tmp_path, "a.py", "x = '/%s/someone/data'\n" % "home")
    good = _tree(tmp_path, "b.sh", "cat /etc/os-release; ls ~/.cache/x ${X}/ro" "ot/y http://h/home/x\n")
    assert contents.machine_paths(tmp_path, [bad, good]) == ["a.py:1: /%s/someone" % "home"]


def test_modes_of_nodes_and_commands(tmp_path: Path) -> None:
    files = [
        _tree(tmp_path, "hri_x/nodes/faces", "#!/usr/bin/env python3\n", 0o755),
        _tree(tmp_path, "hri_x/nodes/bodies", "#!/usr/bin/env python3\n", 0o644),
        _tree(tmp_path, "scripts/demo", "#!/bin/sh\n", 0o644),
    ]
    assert [line.split(":")[0] for line in contents.modes(tmp_path, files)] == ["hri_x/nodes/faces", "scripts/demo"]


def test_a_command_for_rosrun_is_not_executable(tmp_path: Path) -> None:
    assert contents.modes(tmp_path, [_tree(tmp_path, "scripts/score", "#!/usr/bin/env python3\n", 0o644)]) == []
    assert contents.modes(tmp_path, [_tree(tmp_path, "scripts/score", "#!/usr/bin/env python3\n", 0o755)])


def test_large_files_and_marks(tmp_path: Path) -> None:
    files = [_tree(tmp_path, "big", "x" * (contents.MAX_BYTES + 1)), _tree(tmp_path, "merge.md", "<" * 7 + " HEAD\n")]
    assert len(contents.large_files(tmp_path, files)) == 1
    assert contents.conflict_marks(tmp_path, files) == ["merge.md"]


def test_empty_listing_is_not_a_success(tmp_path: Path) -> None:
    assert contents.check(tmp_path)[0] == 0
