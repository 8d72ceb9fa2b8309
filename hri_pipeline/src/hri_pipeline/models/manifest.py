"""manifest.json: where every file of the models directory comes from, and its sha256."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Dict, List, Mapping, Sequence

from hri_pipeline.models import names
from hri_pipeline.models.archives import sha256_of_file
from hri_pipeline.models.catalogue import CONVERTER_REVISION, PACKAGES, Product

FORMAT = 1
USER = "user"


def read_manifest(directory: Path) -> Dict[str, Dict[str, Any]]:
    """Entries by file name; empty when there is no manifest that can be read."""
    try:
        document = json.loads((directory / names.MANIFEST).read_text(encoding="utf-8"))
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
    source = {
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
