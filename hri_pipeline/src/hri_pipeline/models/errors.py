"""Errors of fetching and converting models; each message is one line that names what failed and the mend."""

from __future__ import annotations


class FetchError(RuntimeError):
    """Models could not be fetched, checked or put in place."""


class ConversionError(FetchError):
    """A source model holds something that its converter does not know."""
