"""Templates encrypted at rest, with a key that lies in a file of its own."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Union

from hri_pipeline.core.private_file import StoreError, Transform


class KeyFileTransform(Transform):
    """Encrypts and signs with Fernet (AES-128-CBC and HMAC-SHA256) of the library cryptography.

    key_file: made by `make_key_file`. Who has the store without the key has no templates; who loses the key has lost
    them. Raises StoreError that names the file and the mend.
    """

    name = "fernet"

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

    def pack(self, content: bytes) -> bytes:
        """Return the bytes encrypted."""
        return self._fernet.encrypt(content)

    def unpack(self, stored: bytes) -> bytes:
        """Return what `pack` was given; ValueError for another key or changed bytes."""
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
    with os.fdopen(descriptor, "wb") as file:
        file.write(Fernet.generate_key() + b"\n")
    return path
