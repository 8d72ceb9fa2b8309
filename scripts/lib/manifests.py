"""Look at every package.xml: what is imported and launched must be declared, and what is declared must be known to
rosdep.

catkin_lint knows the keys of rosdep only where rosdep's database is, which needs the network: those that we use stand
in rosdep_keys.txt. Each rule prints what breaks it. Only the standard library.
"""

from __future__ import annotations

import ast
import re
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Dict, Iterable, List, NamedTuple, Set

KEYS_FILE = Path(__file__).resolve().with_name("rosdep_keys.txt")
_RUN_TAGS, _TEST_TAGS = ("depend", "exec_depend"), ("depend", "exec_depend", "test_depend")
_KEYS_OF_MODULES = {"cv2": "python3-opencv", "cryptography": "python3-cryptography", "numpy": "python3-numpy",
                    "pytest": "python3-pytest",
                    "rospkg": "python3-rospkg", "scipy": "python3-scipy", "tornado": "python3-tornado",
                    "yaml": "python3-yaml"}
_MODULES = {"opencv-python-headless": "cv2", "pyyaml": "yaml"}
"""Names of modules whose PyPI package has another name."""
_FOUND = re.compile(r'\$\(find ([\w-]+)\)|\bpkg="([\w-]+)"')
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


class Package(NamedTuple):
    """A directory with a package.xml; declared: dependencies by tag."""

    name: str
    directory: Path
    declared: Dict[str, Set[str]]

    def any_of(self, tags: Iterable[str]) -> Set[str]:
        """Dependencies of these tags."""
        return {key for tag in tags for key in self.declared.get(tag, ())}


def packages(root: Path) -> List[Package]:
    """The root first, then those nested in it."""
    found = []
    for manifest in [root / "package.xml", *sorted(root.glob("*/package.xml")), *sorted(root.glob("*/*/package.xml"))]:
        tree = ElementTree.parse(str(manifest)).getroot()
        declared: Dict[str, Set[str]] = {}
        for element in tree:
            if element.tag.endswith("depend"):
                declared.setdefault(element.tag, set()).add((element.text or "").strip())
        found.append(Package(tree.findtext("name", "").strip(), manifest.parent, declared))
    return found


def from_pypi(root: Path) -> Set[str]:
    """Modules that scripts/requirements*.txt bring and no key of rosdep does."""
    lines = [line for path in sorted((root / "scripts").glob("requirements*.txt"))
             for line in path.read_text().splitlines()]
    names = {re.split(r"[ ;<>=\[]", line)[0].lower() for line in lines if re.match(r"\w", line)}
    modules = {_MODULES.get(name, name.replace("-", "_")) for name in names}
    return modules - set(_KEYS_OF_MODULES)


def imported(files: Iterable[Path]) -> Set[str]:
    """Top names of the modules that Python files import; a file without Python in it has none."""
    names: Set[str] = set()
    for path in files:
        text = path.read_text(encoding="utf-8", errors="replace")
        if path.suffix != ".py" and "python3" not in text.split("\n", 1)[0]:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.Import):
                names.update(alias.name.split(".")[0] for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names.add(node.module.split(".")[0])
    return names


def launched(files: Iterable[Path]) -> Set[str]:
    """Packages that launch files find, or of which they start a node."""
    texts = [_COMMENT.sub("", path.read_text(encoding="utf-8")) for path in files]
    return {one or other for text in texts for one, other in _FOUND.findall(text)}


def undeclared(package: Package, root: Path, ours: Set[str]) -> List[str]:
    """What a package uses and does not declare, at run time and in its tests."""
    directory = package.directory
    source = [path for pattern in ("src/**/*.py", "nodes/*") for path in directory.glob(pattern) if path.is_file()]
    tests = [path for folder in ("test", "rosbag_tests") for path in directory.glob(folder + "/**/*.py")]
    # Tests import what stands beside them.
    own = {package.name} | {path.stem for path in tests} | from_pypi(root) | set(_standard_library())
    # Only tests may use what is not installed.
    beside_tests = {path.parent.name for path in (root / "scripts").glob("*/__init__.py")}
    if directory == root:
        own |= ours | {path.stem for path in root.glob("*/test/**/*.py")}
    problems = []
    for tags, files, patterns in ((_RUN_TAGS, source, ("launch/*.launch",)),
                                  (_TEST_TAGS, tests, ("test/**/*.test", "rosbag_tests/*.test",
                                                       "rosbag_tests/*.launch"))):
        used = {_KEYS_OF_MODULES.get(name, name) for name in imported(files)}
        used |= launched(path for pattern in patterns for path in directory.glob(pattern))
        if tags is _TEST_TAGS:
            used -= beside_tests
        problems += ["{}: {} is used, but no {}".format(package.name, name, " or ".join(tags))
                     for name in sorted(used - own - package.any_of(tags))]
    return problems


def not_in_root(found: List[Package]) -> List[str]:
    """Dependencies of nested packages that the root lacks, which alone is read by rosdep and catkin."""
    root, ours = found[0], {package.name for package in found}
    problems = []
    for package in found[1:]:
        for tags, what in ((_RUN_TAGS, "at run time"), (_TEST_TAGS, "for tests"),
                           (("depend", "build_depend"), "to build")):
            everything = root.any_of(tags) | root.any_of(("depend",)) | (ours - {"audio_common_msgs", "people_msgs"})
            problems += ["{}: {} of {} is missing {}".format(root.name, key, package.name, what)
                         for key in sorted(package.any_of(tags) - everything)]
    return problems


def unknown_keys(found: List[Package], known: Set[str]) -> List[str]:
    """Declared dependencies that rosdep cannot resolve."""
    known = known | {package.name for package in found}
    return ["{}: rosdep has no key {}; see rosdep_keys.txt".format(package.name, key) for package in found
            for key in sorted(package.any_of(package.declared) - known)]


def known_keys() -> Set[str]:
    """The keys that stand in the file."""
    return {line for line in KEYS_FILE.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")}


def problems_of(root: Path) -> List[str]:
    """Everything that is wrong, in words."""
    found = packages(root)
    ours = {package.name for package in found}
    return [line for package in found
            for line in undeclared(package, root, ours)] + not_in_root(found) + unknown_keys(found, known_keys())


def _standard_library() -> Iterable[str]:
    names = getattr(sys, "stdlib_module_names", None)       # Python 3.10 and later
    if names is None:
        folder = Path(ast.__file__).parent
        names = {path.stem for path in folder.glob("*.py")} | {path.parent.name
                                                               for path in folder.glob("*/__init__.py")}
        names |= set(sys.builtin_module_names) | {path.name.split(".")[0] for path in folder.glob("lib-dynload/*.so")}
    return set(names) | {"__future__"}


if __name__ == "__main__":
    PROBLEMS = problems_of(Path(sys.argv[1]).resolve())
    print("\n".join(PROBLEMS) if PROBLEMS else "package.xml: all is declared, all keys are known")
    sys.exit(1 if PROBLEMS else 0)
