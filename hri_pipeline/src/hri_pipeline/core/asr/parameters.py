"""Parameters of the descriptors and of the recognition of speech, part of the table of the node `voices`."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter

ENGINES = ("", "auto", "moonshine", "pocketsphinx")

AUDIO_FEATURE_PARAMETERS = (
    Parameter("features_rate", 25.0, "Frames of `features` per second and voice, to a whole number of the 10 ms steps "
              "of the definition; nothing is computed while nobody listens. 25 is every fourth frame, enough to follow "
              "pitch and loudness; 100 is every frame, what emotion recognition needs. Processor time grows in "
              "proportion, here and in every subscriber.",
              unit="Hz", minimum=1.0, maximum=100.0, live=True),
)
"""What AudioFeatureExtractor needs (core/audio/features.py)."""

SPEECH_RECOGNITION_PARAMETERS = (
    Parameter("language", "", "Language that is spoken, an IETF tag such as `es` or `de-DE`; it picks the model and "
              "goes into the messages. Empty: speech_language. The models that come with this package know English "
              "only; those of others lie in the models directory as `moonshine_es` or `pocketsphinx_de`, with the files of "
              "speech_model. Without one nobody is understood, and diagnostics say so."),
    Parameter("speech_engine", "auto", "Recogniser. `auto`: `moonshine` for free speech, which `fetch_models` brings; "
              "`pocketsphinx` with a grammar, or where Moonshine's model is not there. Empty: no recognition.",
              choices=ENGINES),
    Parameter("speech_model", "", "Directory of the recogniser's model. Empty: that of the language. moonshine: "
              "encoder_model.onnx, decoder_model_merged.onnx, tokenizer.json; pocketsphinx: an acoustic model (mdef, "
              "means, ...), one *.dict and, for dictation, one *.lm or *.lm.bin."),
    Parameter("speech_grammar", "", "Sentences that are possible: a JSGF grammar as text (begins with `#JSGF`), the "
              "path of a file with one, or the name of a grammar of this package (`commands`, `digits`). Empty: free "
              "speech. moonshine knows free speech only."),
    Parameter("speech_text", "plain", "`plain`: words in lower case without punctuation. `written`: as the recogniser "
              "writes it; moonshine knows capitals and punctuation.", choices=("plain", "written")),
    Parameter("speech_language", "en-US", "Language where `language` is empty, an IETF tag."),
    Parameter("speech_max_speakers", 2, "Voices that are recognised at the same time. Each has a process of its own "
              "(moonshine 230 MB, pocketsphinx 65 MB with a grammar and 130 MB without); the second starts when it is"
              " first needed. Further voices wait, and lose sound when they wait longer than `speech_queue`.",
              minimum=1, maximum=8),
    Parameter("speech_partial_rate", 3.0, "Texts so far per second of speech, at most. 0: none, only whole sentences. "
              "moonshine gives fewer: it hears the whole sentence again for each, in 8 % of the time.",
              unit="Hz",
              minimum=0.0, maximum=10.0),
    Parameter("speech_min_confidence", 0.05, "Sentences of less confidence are not published. Higher: fewer commands "
              "are heard where none was spoken, more that were spoken are missed. The numbers of different recognisers "
              "do not compare.", minimum=0.0, maximum=1.0, live=True),
    Parameter("speech_queue", 20.0, "Sound of one voice that may wait for the recogniser; what does not fit is dropped,"
              " and told in diagnostics.", unit="s", minimum=1.0, maximum=120.0),
    Parameter("speech_nice", 10, "How far the recogniser's processes stand back behind all others, as in nice(1). 19:"
              " they run when nothing else wants to, and texts come late on a busy machine.", minimum=0, maximum=19),
)
"""What SpeechRecognition needs (core/asr/recognition.py)."""
