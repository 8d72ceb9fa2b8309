"""Files with personal data: readable by their owner only, replaced as a whole, overwritten when they go."""

from __future__ import annotations

import fcntl
import io
import os
import stat
import time
from abc import ABC, abstractmethod
from pathlib import Path
from typing import Optional, Sequence

DAMAGED = ".damaged-"
"""What stands between the name of a file that was set aside and the time of that."""
MAX_FILE_BYTES = 2 ** 30
"""Largest file that is read."""


class StoreError(RuntimeError):
    """A store cannot be used; the text names the file and the mend."""


class Transform(ABC):
    """What is done to bytes on their way to the disk and back, such as encryption. name: written beside them."""

    name: str

    @abstractmethod
    def pack(self, content: bytes) -> bytes:
        """Return the bytes to write."""

    @abstractmethod
    def unpack(self, stored: bytes) -> bytes:
        """Return what `pack` was given; ValueError when that cannot be."""


def set_aside(path: Path, now: float, also: Sequence[Path] = ()) -> Path:
    """Rename a damaged file, and those of `also` that are there; returns its new name, with the time `now` (s)."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(now))
    name = path.name + DAMAGED + stamp
    others = len([other for other in path.parent.glob(name + "*") if not other.name.endswith(("-wal", "-shm"))])
    target = path.parent / (name + (".{}".format(others) if others else ""))
    for file in also:
        if file.exists():
            os.replace(str(file), str(target) + file.name[len(path.name):])
    os.replace(str(path), str(target))
    sync_directory(path.parent)
    return target


def replace_file(path: Path, content: bytes) -> None:
    """Put `content` in place of a file, mode 0600: at any moment there is the old one or the new one.

    What the old file held is overwritten, so that it does not stay on the disk (a file system that writes elsewhere,
    or a solid-state disk, keeps it all the same). Raises OSError.
    """
    beside = path.parent / "{}.new-{}".format(path.name, os.getpid())
    descriptor = os.open(str(beside), os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW, 0o600)
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        old = _open_old(path)
        os.replace(str(beside), str(path))
    except BaseException:
        beside.unlink()
        raise
    sync_directory(path.parent)
    if old is not None:
        with os.fdopen(old, "r+b") as file:
            _overwrite(file)


def wipe(path: Path) -> None:
    """Overwrite a file with zeros and remove it; one that is not there is none."""
    try:
        with open(str(path), "r+b") as file:
            _overwrite(file)
        path.unlink()
    except FileNotFoundError:
        pass


def _overwrite(file: io.BufferedRandom) -> None:
    left = file.seek(0, os.SEEK_END)
    file.seek(0)
    while left > 0:
        left -= file.write(bytes(min(left, 2 ** 20)))
    file.flush()
    os.fsync(file.fileno())


def _open_old(path: Path) -> Optional[int]:
    try:
        return os.open(str(path), os.O_RDWR | os.O_NOFOLLOW)
    except OSError:
        return None


def read_private(path: Path) -> bytes:
    """Return the content of a file, which is made private where it is not. Raises OSError."""
    # Without blocking: a pipe in the place of the file is refused, not waited for.
    descriptor = os.open(str(path), os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode) or status.st_size > MAX_FILE_BYTES:
            raise OSError("not a plain file of at most {} bytes".format(MAX_FILE_BYTES))
        os.fchmod(file.fileno(), 0o600)
        return file.read()


def make_private_directory(directory: Path) -> None:
    """Make the directory of a store, mode 0700, where there is none. StoreError, also when others can read it."""
    try:
        if not directory.is_dir():
            directory.mkdir(mode=0o700, parents=True)
        if directory.stat().st_mode & 0o077:
            raise StoreError("directory {} can be read by others; run `chmod 700 {}`, or name "
                             "a directory of its own".format(directory, directory))
    except OSError as error:
        raise StoreError("directory {} cannot be made ({}); name one that can be "
                         "written".format(directory, error)) from error


def hold(path: Path) -> int:
    """Lock a store against a second writer; returns the descriptor, with which the lock ends. Raises StoreError."""
    lock = path.parent / (path.name + ".lock")
    try:
        descriptor = os.open(str(lock), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise StoreError("the lock {} cannot be made ({}); correct the permissions of its directory".format(
            lock, error)) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise StoreError("{} is in use by another process; end that one, or give each its own "
                         "file".format(path)) from error
    return descriptor


def sync_directory(directory: Path) -> None:
    """Put the names in a directory on disk."""
    descriptor = os.open(str(directory), os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
