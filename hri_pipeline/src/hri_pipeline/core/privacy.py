"""What a node computes and keeps of people: its privacy notice, as data and as text; and files with personal data:
readable by their owner only, encrypted where that is wanted, overwritten when they go."""

from __future__ import annotations

import fcntl
import glob
import io
import os
import stat
import time
from dataclasses import dataclass
from pathlib import Path
from typing import List, Sequence, Tuple, Union

DAMAGED = ".damaged-"
"""What stands between the name of a file that was set aside and the time of that."""
MAX_FILE_BYTES = 2 ** 30
"""Largest file that is read."""
_PAUSE_S = 0.02


@dataclass(frozen=True)
class DataUse:
    """What one node does with what it perceives of people.

    computes: of each person. store: the file in which something is kept, empty for memory only. stored: what.
    max_age: days after which who was not seen is removed from there, 0 for never. encrypted: whether what can identify
    somebody is. agreed: ids of those who have agreed to be recognised.
    """

    computes: Tuple[str, ...]
    store: str = ""
    stored: Tuple[str, ...] = ()
    max_age: float = 0.0
    encrypted: bool = False
    agreed: Tuple[str, ...] = ()


def joined(uses: Sequence[DataUse]) -> DataUse:
    """Return the use of a node that does all of these; one of them at most may keep something."""
    keeps = next((use for use in uses if use.store), DataUse(()))
    return DataUse(tuple(dict.fromkeys(name for use in uses for name in use.computes)), keeps.store, keeps.stored,
                   keeps.max_age, keeps.encrypted, tuple(sorted({name for use in uses for name in use.agreed})))


def notice(uses: Sequence[Tuple[str, DataUse]]) -> str:
    """Return the notice for people to read, of (name of the node, what it does)."""
    lines: List[str] = []
    for node, use in sorted(uses, key=lambda item: item[0]):
        lines.append("{} computes: {}".format(node, ", ".join(use.computes) or "nothing of people"))
        if use.store:
            lines.append("    keeps in {}{}: {}; {}".format(
                use.store, ", encrypted" if use.encrypted else ", not encrypted", ", ".join(use.stored),
                "removed {:g} days after the last time".format(use.max_age) if use.max_age else "without a limit"))
        else:
            lines.append("    keeps nothing beyond the run")
        if use.agreed:
            lines.append("    agreed to be recognised: {}".format(", ".join(use.agreed)))
    return "\n".join(lines)


class StoreError(RuntimeError):
    """A store cannot be used; the text names the file and what to do."""


def set_aside(path: Path, now: float, also: Sequence[Path] = ()) -> Path:
    """Rename a damaged file, and those of `also` that are there; returns its new name, with the time `now` (s)."""
    stamp = time.strftime("%Y%m%dT%H%M%SZ", time.gmtime(now))
    name = path.name + DAMAGED + stamp
    others = len([other for other in files_beside(path, DAMAGED + stamp) if not other.name.endswith(("-wal", "-shm"))])
    target = path.parent / (name + (".{}".format(others) if others else ""))
    for file in also:
        if file.exists():
            os.replace(str(file), str(target) + file.name[len(path.name):])
    os.replace(str(path), str(target))
    sync_directory(path.parent)
    return target


def files_beside(path: Path, mark: str) -> List[Path]:
    """Return the files in the directory of `path` whose names begin with its name and `mark`, sorted."""
    return sorted(path.parent.glob(glob.escape(path.name + mark) + "*"))


def wipe(path: Path) -> None:
    """Overwrite a file with zeros and remove it; nothing is done where there is none."""
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


def _without_links(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NOFOLLOW)


def read_private(path: Path) -> bytes:
    """Return the content of a file, which is made private where it is not. Raises OSError."""
    # Without blocking: a pipe in the place of the file is refused, not waited for.
    with open(str(path), "rb", opener=lambda name, flags: _without_links(name, flags | os.O_NONBLOCK)) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode) or status.st_size > MAX_FILE_BYTES:
            raise OSError("not a plain file of at most {} bytes".format(MAX_FILE_BYTES))
        os.fchmod(file.fileno(), 0o600)
        return file.read()


def make_private_directory(directory: Path) -> None:
    """Make the directory of a store, mode 0700, where there is none. StoreError, also when others can read it."""
    try:
        if not directory.is_dir():
            directory.mkdir(mode=0o700, parents=True, exist_ok=True)    # another process may be faster
        if directory.stat().st_mode & 0o077:
            raise StoreError("directory {} can be read by others; run `chmod 700 {}`, or name "
                             "a directory of its own".format(directory, directory))
    except OSError as error:
        raise StoreError("directory {} cannot be made ({}); name one that can be "
                         "written".format(directory, error)) from error


def hold(path: Path, patience: float = 5.0) -> int:
    """Lock a file against other processes that call this; returns the descriptor, with which the lock ends.

    Raises StoreError when another one still holds it after `patience` (s).
    """
    lock = path.parent / (path.name + ".lock")
    try:
        descriptor = os.open(str(lock), os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise StoreError("the lock {} cannot be made ({}); correct the permissions of its directory".format(
            lock, error)) from error
    end = time.monotonic() + patience
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return descriptor
        except OSError as error:
            if time.monotonic() >= end:
                os.close(descriptor)
                raise StoreError("{} is in use by another process; end that one, or give each its own "
                                 "file".format(path)) from error
            time.sleep(_PAUSE_S)


def sync_directory(directory: Path) -> None:
    """Put the names in a directory on disk."""
    descriptor = os.open(str(directory), os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class TemplateCipher:
    """Encrypts bytes on their way to the disk and decrypts them on their way back.

    Encrypts and signs with Fernet (AES-128-CBC and HMAC-SHA256) of the library cryptography.

    key_file: made by `make_key_file`. Who has the store without the key has no templates; who loses the key has lost
    them. Raises StoreError that names the file and what to do.
    """

    name = "fernet"
    """Written to the store beside the templates."""

    def __init__(self, key_file: Union[str, Path]) -> None:
        from cryptography.fernet import Fernet, InvalidToken  # only those who encrypt need the library
        path = Path(key_file).expanduser().absolute()
        try:
            mode = path.stat().st_mode
            key = path.read_bytes().strip()
        except OSError as error:
            raise StoreError("key file {}: {}; make one with `rosrun hri_person_manager people make-key FILE`".format(
                path, error.strerror)) from None
        if stat.S_IMODE(mode) & 0o077:
            raise StoreError("key file {} can be read by others (mode {:04o}); mend: chmod 600".format(
                path, stat.S_IMODE(mode)))
        try:
            self._fernet = Fernet(key)
        except ValueError:
            raise StoreError("key file {} holds no key; make one with `rosrun hri_person_manager people make-key "
                             "FILE`".format(path)) from None
        self._invalid = InvalidToken

    def encrypt(self, content: bytes) -> bytes:
        """Return the bytes to write. The time, which Fernet writes in plain, is 0: it would tell when somebody was
        seen."""
        return self._fernet.encrypt_at_time(content, 0)

    def decrypt(self, stored: bytes) -> bytes:
        """Return what `encrypt` was given; raises ValueError for another key or changed bytes."""
        try:
            return self._fernet.decrypt(stored)
        except self._invalid:
            raise ValueError("encrypted with another key, or changed") from None


def make_key_file(path: Union[str, Path]) -> Path:
    """Write a new key, mode 0600, and return its path. Raises StoreError when the file exists or cannot be written."""
    from cryptography.fernet import Fernet
    path = Path(path).expanduser().absolute()
    try:
        descriptor = os.open(str(path), os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise StoreError("key file {}: {}; an existing key is never overwritten".format(path, error.strerror)) from None
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(Fernet.generate_key() + b"\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:        # a full disk: half a key would be in the way of the next try
        path.unlink()
        raise StoreError("key file {}: {}".format(path, error.strerror)) from None
    return path
