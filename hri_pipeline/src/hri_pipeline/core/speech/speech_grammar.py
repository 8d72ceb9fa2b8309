"""The grammar that the recogniser of speech is given: from a text, a file, or this package."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Optional

from hri_pipeline.core.parameters import ParameterError
from hri_pipeline.core.speech.speech_engine import EngineChoice

_LONGEST = 256 * 1024
_SUFFIX = ".gram"


def read_grammar(value: str, directory: Optional[Path] = None) -> str:
    """Return the text of a grammar: `value` itself, the file that it names, or value.gram of `directory`.

    A text begins with `#` or `[`. directory: where the grammars of the package lie, None: not known.
    Raises ParameterError that names what was looked for.
    """
    text = value.strip().lstrip("\ufeff")
    if not text or text.startswith(("#", "[")):
        return text
    path = Path(text).expanduser()
    if directory is not None and path.name == text and not path.is_file():
        path = directory / (text if text.endswith(_SUFFIX) else text + _SUFFIX)
    if not path.is_file():
        raise ParameterError("parameter speech_grammar is {!r}, and there is no file {}: give the path of a grammar, its"
                             " text, or one of {}".format(value, path, ", ".join(_names(directory)) or "none here"))
    if path.stat().st_size > _LONGEST:
        raise ParameterError("parameter speech_grammar: {} has {} bytes, legal are {}".format(
            path, path.stat().st_size, _LONGEST))
    try:
        return path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError("parameter speech_grammar: {} cannot be read: {}".format(path, error)) from error


def engine_choice(settings: Any) -> EngineChoice:
    """Return the choice that the parameters speech_* make. Raises ParameterError for a grammar that is not there."""
    return EngineChoice(settings.speech_engine, settings.speech_model and str(Path(settings.speech_model).expanduser().absolute()),
                        read_grammar(settings.speech_grammar, grammar_directory()), settings.speech_language)


def grammar_directory() -> Optional[Path]:
    """Return config/grammars of this package in a source tree or install space, None where there is none."""
    here = Path(__file__).resolve()
    # <source>/hri_pipeline/src/hri_pipeline/core/speech, <install>/lib/python3/dist-packages/hri_pipeline/core/speech
    places = [here.parents[4] / "config" / "grammars"]
    places += [parent / "share" / "hri_pipeline" / "config" / "grammars" for parent in list(here.parents)[5:8]]
    return next((place for place in places if place.is_dir()), None)


def _names(directory: Optional[Path]) -> list:
    return sorted(path.stem for path in directory.glob("*" + _SUFFIX)) if directory is not None else []
