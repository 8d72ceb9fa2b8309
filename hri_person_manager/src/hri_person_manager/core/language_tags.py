"""IETF language tags (BCP 47, RFC 5646): read as people write them, and given back in one form.

Letters have the case that RFC 5646 recommends (section 2.1.1), `_` counts as `-`, and an extended language stands for
itself, as in the canonical form of section 4.5: `EN_gb` is `en-GB`, `zh-cmn-Hans` is `cmn-Hans`. The registry of
subtags is not looked up: `xx-YY` is well-formed. Names of languages (`French`) are no tags, as no tag of more than
three letters has been registered, and the tags that RFC 5646 calls grandfathered (`i-klingon`) are not read.
"""

from __future__ import annotations

import re
from typing import List

LONGEST_TAG = 64
_LANGUAGE = re.compile(r"(?P<language>[a-z]{2,3})(-(?P<extended>[a-z]{3}))?(-(?P<script>[a-z]{4}))?"
                       r"(-(?P<region>[a-z]{2}|[0-9]{3}))?(?P<variants>(-([a-z0-9]{5,8}|[0-9][a-z0-9]{3}))*)"
                       r"(?P<extensions>(-[0-9a-wy-z](-[a-z0-9]{2,8})+)*)(?P<private>-x(-[a-z0-9]{1,8})+)?", re.ASCII)
_PRIVATE = re.compile(r"x(-[a-z0-9]{1,8})+", re.ASCII)


def normal_language_tag(text: str) -> str:
    """Return a language tag in the form of BCP 47; ValueError for what is none."""
    tag = text.replace("_", "-").lower()
    found = _LANGUAGE.fullmatch(tag)
    if len(text) > LONGEST_TAG or not text.isascii() or (found is None and not _PRIVATE.fullmatch(tag)):
        raise ValueError("{!r} is no IETF language tag, such as fr, pt-BR or zh-Hant-TW".format(text[:40]))
    if found is None:
        return tag
    variants = found["variants"].split("-")[1:]
    extensions = _extensions(found["extensions"])
    if len(set(variants)) < len(variants) or len({parts[0] for parts in extensions}) < len(extensions):
        raise ValueError("{!r} is no IETF language tag: a part comes twice".format(text[:40]))
    parts = [found["extended"] or found["language"], (found["script"] or "").title(), (found["region"] or "").upper(),
             *variants, *("-".join(parts) for parts in sorted(extensions))]
    return "-".join(part for part in parts if part) + (found["private"] or "")


def _extensions(text: str) -> List[List[str]]:
    """The extensions of a tag, each a letter or digit and its subtags."""
    found: List[List[str]] = []
    for part in text.split("-")[1:]:
        if len(part) == 1:
            found.append([part])
        else:
            found[-1].append(part)
    return found
