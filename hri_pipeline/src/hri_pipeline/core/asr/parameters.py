"""Parameters of the recognition of speech, part of those of the node `voices`."""

from __future__ import annotations

from dataclasses import dataclass

from hri_pipeline.core.parameters import Settings, parameter

ENGINES = ("", "auto", "moonshine", "pocketsphinx")


@dataclass(frozen=True)
class SpeechSettings(Settings):
    """What SpeechRecognition needs (core/asr/recognition.py)."""

    speech: bool = parameter(
        True, "Recognise what voices say and publish it (`speech`). Recognition runs in a process of its own; sound "
        "is kept in memory while it is worked on, never on disk.")
    language: str = parameter(
        "", "Language that is spoken, an IETF tag such as `es` or `de-DE`; it picks the model and goes into the "
        "messages. Empty: speech_language. The models that come with this package know English only; those of others "
        "lie in the models directory as `moonshine_es` or `pocketsphinx_de`, with the files of speech_model. Without "
        "one nobody is understood, and diagnostics say so.")
    speech_engine: str = parameter(
        "auto", "Recogniser. `auto`: `moonshine` for free speech; `pocketsphinx` with a grammar, or without "
        "Moonshine's model. Empty: no recognition.", choices=ENGINES)
    speech_model: str = parameter(
        "", "Directory of the recogniser's model. Empty: that of the language. moonshine: encoder_model.onnx, "
        "decoder_model_merged.onnx, tokenizer.json; pocketsphinx: an acoustic model (mdef, means, ...), one *.dict "
        "and, for dictation, one *.lm or *.lm.bin.")
    speech_grammar: str = parameter(
        "", "Possible sentences: a JSGF grammar as text (begins with `#JSGF`), a file with one, or one of this package "
        "(`commands`, `digits`). Empty: free speech. Needs pocketsphinx.")
    speech_text: str = parameter(
        "plain", "`plain`: lower case without punctuation. `written`: as the recogniser writes it; moonshine knows "
        "capitals and punctuation.", choices=("plain", "written"))
    speech_language: str = parameter("en-US", "Language where `language` is empty, an IETF tag.")
    speech_max_speakers: int = parameter(
        2, "Most voices recognised at a time. Each has a process of its own (moonshine 230 MB, pocketsphinx 65 MB with "
        "a grammar and 130 MB without); the second starts when it is first needed. Further voices wait, and lose sound "
        "when they wait longer than `speech_queue`.", minimum=1, maximum=8)
    speech_partial_rate: float = parameter(
        3.0, "Most partial texts per second of speech. 0: none. Each costs moonshine the whole sentence so far, in 8 % "
        "of its time, so that it gives fewer.", unit="Hz", minimum=0.0, maximum=10.0)
    speech_min_confidence: float = parameter(
        0.05, "Sentences of less confidence are not published. Higher: fewer commands are heard where none was "
        "spoken, more that were spoken are missed. The numbers of different recognisers do not compare.", minimum=0.0,
        maximum=1.0, live=True)
    speech_queue: float = parameter(
        20.0, "Sound of one voice that may wait for the recogniser; more is dropped, and diagnostics say so.", unit="s",
        minimum=1.0, maximum=120.0)
    speech_nice: int = parameter(
        10, "Priority of the recogniser's processes, as in nice(1); larger is lower. 19: only idle time, texts come "
        "late on a busy machine.", minimum=0, maximum=19)
