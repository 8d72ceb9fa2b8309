"""Parameters of the recognition of speech, part of those of the node `voices`."""

from __future__ import annotations

from dataclasses import dataclass

from hri_pipeline.core.parameters import Settings, parameter

ENGINES = ("", "auto", "moonshine", "pocketsphinx", "vosk", "sherpa_onnx")


@dataclass(frozen=True)
class SpeechSettings(Settings):
    """What SpeechRecognition needs (core/asr/recognition.py)."""

    speech: bool = parameter(
        True, "Recognise what voices say and publish it (`speech`). Recognition runs in a process of its own; sound "
        "is kept in memory while it is worked on, never on disk.")
    speech_engine: str = parameter(
        "auto", "Recogniser. `auto`: `moonshine` for free speech, which `fetch_models` brings; `pocketsphinx` with a "
        "grammar, or where Moonshine's model is not there. `vosk` and `sherpa_onnx` are for users who bring a model "
        "(`speech_model`) and install the package. Empty: no recognition.", choices=ENGINES)
    speech_model: str = parameter(
        "", "Directory of the recogniser's model. Empty: the English one that comes with `moonshine` and "
        "`pocketsphinx`. moonshine: encoder_model.onnx, decoder_model_merged.onnx, tokenizer.json; pocketsphinx: an "
        "acoustic model (mdef, means, ...), one *.dict and, for dictation, one *.lm or *.lm.bin; vosk: an unpacked "
        "model; sherpa_onnx: tokens.txt with encoder*.onnx, decoder*.onnx, joiner*.onnx of a streaming transducer.")
    speech_grammar: str = parameter(
        "", "Sentences that are possible: a JSGF grammar as text (begins with `#JSGF`), the path of a file with one, "
        "or the name of a grammar of this package (`commands`, `digits`). With vosk a JSON list of phrases. Empty: "
        "free speech. moonshine and sherpa_onnx know free speech only.")
    speech_text: str = parameter(
        "plain", "`plain`: words in lower case without punctuation. `written`: as the recogniser writes it; moonshine "
        "knows capitals and punctuation.", choices=("plain", "written"))
    speech_language: str = parameter(
        "en-US", "Language of the model, an IETF tag; goes into the messages. The models that come with this package "
        "know English only.")
    speech_max_speakers: int = parameter(
        2, "Voices that are recognised at the same time. Each has a process of its own (moonshine 230 MB, "
        "pocketsphinx 65 MB with a grammar and 130 MB without); the second starts when it is first needed. Further "
        "voices wait, and lose sound when they wait longer than `speech_queue`.", minimum=1, maximum=8)
    speech_partial_rate: float = parameter(
        3.0, "Texts so far per second of speech, at most. 0: none, only whole sentences. moonshine gives fewer: it "
        "hears the whole sentence again for each, in 8 % of the time.", unit="Hz", minimum=0.0, maximum=10.0)
    speech_min_confidence: float = parameter(
        0.05, "Sentences of less confidence are not published. Higher: fewer commands are heard where none was "
        "spoken, more that were spoken are missed. The numbers of different recognisers do not compare.", minimum=0.0,
        maximum=1.0, live=True)
    speech_queue: float = parameter(
        20.0, "Sound of one voice that may wait for the recogniser; what does not fit is dropped, and told in "
        "diagnostics.", unit="s", minimum=1.0, maximum=120.0)
    speech_nice: int = parameter(
        10, "How far the recogniser's processes stand back behind all others, as in nice(1). 19: they run when "
        "nothing else wants to, and texts come late on a busy machine.", minimum=0, maximum=19)
