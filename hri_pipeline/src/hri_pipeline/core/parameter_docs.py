"""Keeps config/<node>.yaml and the list in docs/nodes/<node>.md equal to the parameter table of the node.

The YAML file tells everything of a parameter, the page one line.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import pkgutil
import re
from pathlib import Path
from typing import Iterator, List, Tuple, Union

from hri_pipeline.core.parameters import ParameterTable

PACKAGES = ("hri_pipeline", "hri_fullbody", "hri_person_manager")
BEGIN = "<!-- parameters:begin -->"
END = "<!-- parameters:end -->"
_DEFINITION = re.compile(r"^[A-Z]\w* = ParameterTable\(", re.MULTILINE)
COMMAND = "rosrun hri_pipeline parameter_docs --write"

PathLike = Union[str, Path]


class ParameterDocsError(AssertionError):
    """A file that says something else than the parameter table."""


def tables(package: str) -> List[ParameterTable]:
    """Return the parameter tables that stand as constants in modules of `<package>.core`, by node name.

    Only modules whose text defines a table are imported, as others may need libraries that are not there; they are
    found here, so that hri_pipeline needs no package that depends on it. A package that is not installed has no tables.
    """
    if importlib.util.find_spec(package) is None:
        return []
    core = importlib.import_module(package + ".core")
    found = {}
    for module_info in pkgutil.walk_packages(core.__path__, core.__name__ + "."):
        if _defines_table(module_info.name):
            module = importlib.import_module(module_info.name)
            for value in vars(module).values():
                # A table that one module imports from another package belongs to the other.
                if isinstance(value, ParameterTable) and not _foreign(package, value):
                    found[value.node] = value
    return [found[node] for node in sorted(found)]


def files(root: PathLike, package: str, table: ParameterTable) -> Tuple[Path, Path]:
    """Return the paths of the YAML file and the documentation page of a table under the root of the sources."""
    return (Path(root) / package / "config" / (table.node + ".yaml"),
            Path(root) / "docs" / "nodes" / (table.node + ".md"))


def problems(table: ParameterTable, yaml_path: PathLike, doc_path: PathLike) -> List[str]:
    """Return one line for each of the two files that differs from the table; an empty list when all is well."""
    lines = []
    yaml_file, doc_file, link = Path(yaml_path), Path(doc_path), _link(yaml_path, doc_path)
    for path, wanted in ((yaml_file, lambda text: table.to_yaml()), (doc_file, lambda text: _with(table, text, link))):
        if not path.is_file():
            lines.append("{} is missing; run `{}`".format(path, COMMAND))
            continue
        text = path.read_text(encoding="utf-8")
        if BEGIN not in text and path is doc_file:
            lines.append("{} has no line {}; run `{}`".format(path, BEGIN, COMMAND))
        elif text != wanted(text):
            lines.append("{} differs from the parameter table of {}; run `{}`".format(path, table.node, COMMAND))
    return lines


def check(table: ParameterTable, yaml_path: PathLike, doc_path: PathLike) -> None:
    """Raise ParameterDocsError, an AssertionError, when one of the two files differs from the table."""
    found = problems(table, yaml_path, doc_path)
    if found:
        raise ParameterDocsError("; ".join(found))


def write(table: ParameterTable, yaml_path: PathLike, doc_path: PathLike) -> List[Path]:
    """Write both files where they differ and return the paths written. The rest of the page is kept."""
    written = []
    yaml_file, doc_file = Path(yaml_path), Path(doc_path)
    page = doc_file.read_text(encoding="utf-8") if doc_file.is_file() else "# {}\n\n{}\n".format(
        table.node, table.summary)
    for path, text in ((yaml_file, table.to_yaml()), (doc_file, _with(table, page, _link(yaml_path, doc_path)))):
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
            written.append(path)
    return written


def registered() -> Iterator[Tuple[str, ParameterTable]]:
    """Yield (package, table) for all tables of all packages that are installed."""
    for package in PACKAGES:
        for table in tables(package):
            yield package, table


def _link(yaml_path: PathLike, doc_path: PathLike) -> str:
    """Return the path of the YAML file as the page links to it."""
    return Path(os.path.relpath(str(yaml_path), str(Path(doc_path).parent))).as_posix()


def _with(table: ParameterTable, page: str, link: str) -> str:
    """Return `page` with the list between its markers, or at its end when it has none."""
    block = "{}\n{}{}".format(BEGIN, table.to_markdown(link), END)
    start, stop = page.find(BEGIN), page.find(END)
    if start < 0 or stop < start:
        return page.rstrip("\n") + "\n\n## Parameters\n\n" + block + "\n"
    return page[:start] + block + page[stop + len(END):]


def _defines_table(module: str) -> bool:
    """Return whether the text of a module assigns a ParameterTable to a constant."""
    spec = importlib.util.find_spec(module)
    if spec is None or spec.origin is None:
        return False
    return _DEFINITION.search(Path(spec.origin).read_text(encoding="utf-8")) is not None


def _foreign(package: str, table: ParameterTable) -> bool:
    """Tell whether the table is also that of another package that comes before this one."""
    for earlier in PACKAGES[:PACKAGES.index(package)] if package in PACKAGES else ():
        if any(other is table for other in tables(earlier)):
            return True
    return False
