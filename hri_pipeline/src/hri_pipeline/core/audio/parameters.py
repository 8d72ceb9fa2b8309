"""Parameters of the node `voices`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

from hri_pipeline.core.audio.stream import SAMPLE_FORMATS
from hri_pipeline.core.parameters import ParameterTable, Settings, parameter

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


@dataclass(frozen=True)
class SoundInputSettings(Settings):
    """Of the input of sound (core/audio/stream.py, ros/sound_input.py)."""

    use_audio_info: bool = parameter(
        True, "Use the format in `audio_info` where published: its channels, rate and format go before the three "
        "parameters below.")
    channels: int = parameter(1, "Interleaved channels of the sound without AudioInfo.", minimum=1, maximum=32)
    sample_rate: int = parameter(
        16000, "Sample rate of the sound without AudioInfo. It is resampled to 16 kHz once; lower rates lose the "
        "voice's overtones.", unit="Hz", minimum=4000, maximum=384000)
    sample_format: str = parameter(
        "S16LE", "Layout of one sample without AudioInfo, in GStreamer's words.", choices=SAMPLE_FORMATS)
    input_latency: float = parameter(
        0.0, "Least time between a sound and the message with it: buffers of the sound card and its driver. It is "
        "taken from every stamp; a wrong value shifts voices against faces.", unit="s", minimum=0.0, maximum=2.0)
    resampling: str = parameter(
        "HQ", "Quality of the resampler. HQ keeps sound up to 7.3 kHz and holds it back for 37 ms at 48 kHz; LQ up to "
        "5.8 kHz and 20 ms. A microphone of 16 kHz is not resampled.", choices=("HQ", "MQ", "LQ"))
    gap_tolerance: float = parameter(
        0.08, "Missing sound of more than this is a gap: stamps go on behind it. Smaller notices shorter gaps and "
        "takes slow deliveries for gaps.", unit="s", minimum=0.02, maximum=1.0)
    silence_time: float = parameter(
        2.0, "Time without any message after which all voices end.", unit="s", minimum=0.2, maximum=60.0, live=True)
    frame_id: str = parameter(
        "microphone_link", "TF frame of the microphone or the array: x forward, y left, z up. The parent of the "
        "frames of voices; goes into headers.")


@dataclass(frozen=True)
class VoiceActivitySettings(Settings):
    """Of voice activity detection, turns and voices (core/audio/vad.py, core/audio/turns.py)."""

    vad_model: str = parameter("", "ONNX file of the voice activity network. Empty: silero_vad.onnx.")
    birth_threshold: float = parameter(
        0.4, "Probability of speech from which a voice begins, in noise. Higher: fewer false voices, later and fewer "
        "soft ones.", minimum=0.05, maximum=0.99, live=True)
    clear_birth_threshold: float = parameter(
        0.3, "The same where the sound is louder than the noise by `clear_snr`: there the network errs little, and "
        "consonants at the begin of a word get 0.3 to 0.4. Between, it is interpolated. Not above birth_threshold.",
        minimum=0.05, maximum=0.99, live=True)
    clear_snr: float = parameter(
        20.0, "Level above the noise floor from which clear_birth_threshold counts.", unit="dB", minimum=8.5,
        maximum=60.0, live=True)
    keep_threshold: float = parameter(
        0.2, "Probability from which a voice goes on. Lower bridges softer speech and keeps `is_speaking` longer "
        "behind it. Not above clear_birth_threshold.", minimum=0.01, maximum=0.99, live=True)
    noise_margin: float = parameter(
        0.2, "Sound that exceeds the noise floor by less than this is a pause: the network goes on for some 0.1 s "
        "behind a word.", unit="dB", minimum=0.0, maximum=20.0, live=True)
    level_drop: float = parameter(
        22.0, "Sound this much below the loudest of the last words is a pause (reverberation, breath). Larger keeps "
        "more of soft endings.", unit="dB", minimum=6.0, maximum=90.0, live=True)
    onset_time: float = parameter(
        0.032, "Time above the threshold after which somebody speaks; rounded up to frames of 32 ms. Longer: fewer "
        "false voices, `is_speaking` so much later.", unit="s", minimum=0.0, maximum=1.0, live=True)
    speaking_hangover: float = parameter(
        0.032, "`is_speaking` ends this long after the last sound of speech. Longer bridges more of the pauses between "
        "words, and says more often that somebody speaks who does not.", unit="s", minimum=0.0, maximum=5.0, live=True)
    hangover_time: float = parameter(
        0.6, "A pause longer than this ends a turn: the sentence goes to the recogniser's final result. Longer keeps "
        "slow speakers in one piece, and answers later.", unit="s", minimum=0.05, maximum=10.0, live=True)
    speaker_changes: bool = parameter(
        True, "Without an array, end a turn where another speaker goes on: a new voice begins, 1 to 2 s later, with "
        "all its sound from the change on. The text of the first voice ends there. Needs speaker_embedding.onnx.")
    min_speech: float = parameter(
        0.1, "A turn with less speech than this was noise: its voice ends at once.", unit="s", minimum=0.0, maximum=2.0,
        live=True)
    look_back: float = parameter(
        0.2, "Sound before the onset that `audio` and recognition get: the onset is noticed when the first consonant "
        "is over.", unit="s", minimum=0.0, maximum=1.0)
    voice_timeout: float = parameter(
        3.0, "Time after its last word until a voice ends.", unit="s", minimum=0.1, maximum=600.0, live=True)
    resume_time: float = parameter(
        0.0, "Without an array, speech within this time after the last word continues the voice. Up to hangover_time, "
        "every turn is a new voice. With speaker_changes a turn is a new voice until 1.2 s of it sound like an earlier "
        "one, which then takes all of it over, and voices of known sound are tracked so long: 15 suits a robot without "
        "a camera. Without speaker_changes whoever speaks continues the voice, and is matched with the wrong face: "
        "for one user only. With an array the direction decides, for as long as the voice is tracked.",
        unit="s", minimum=0.0, maximum=600.0, live=True)
    direction_grace: float = parameter(
        0.05, "With an array, time that speech counts for a direction after the last sound from there. Speech behind "
        "that is somebody else's, which the separation lets through. Longer loses less where several speak at once, "
        "and hears more of others.", unit="s", minimum=0.0, maximum=5.0)
    resume_angle: float = parameter(
        0.35, "With an array, a source this near to a silent voice is this voice.", unit="rad", minimum=0.0,
        maximum=3.2, live=True)


@dataclass(frozen=True)
class DirectionSettings(Settings):
    """Of the frames of voices."""

    direction: bool = parameter(
        True, "Find and separate directions, with two or more microphones at known positions. Off: all channels are "
        "mixed.")
    direction_distance: float = parameter(
        1.0, "Distance of the frame voice_ID from the microphone: an array knows the direction only.", unit="m",
        minimum=0.1, maximum=20.0, live=True)


@dataclass(frozen=True)
class ArraySettings(Settings):
    """Of the microphone array (core/audio/array.py), localisation and separation."""

    microphone_positions: Sequence[str] = parameter(
        [], "A text \"x y z\" per microphone, in the microphone frame: [\"0.04 0.04 0\", \"-0.04 0.04 0\", \"-0.04 "
        "-0.04 0\", \"0.04 -0.04 0\"]. Errors of some millimetres cost some degrees. Empty: no array, the channels are "
        "mixed.", unit="m")
    microphone_channels: Sequence[int] = parameter(
        [-1], "Channels that are used, from 0: the channel of each of microphone_positions, in their order. A "
        "ReSpeaker v2 sends six, of which 1 to 4 are microphones: [1, 2, 3, 4]. [-1]: all.", minimum=-1, maximum=31)
    line_front: bool = parameter(
        True, "Microphones on one line (as any two) measure only the angle to the line. True: voices are in front of "
        "it. False: no direction is published; they are separated all the same.")
    max_sources: int = parameter(
        4, "Most directions at a time. Each costs as much as the first search for directions.", minimum=1, maximum=8)
    source_birth_time: float = parameter(
        0.1, "Time that a new direction must sound before it is used. Its voice is not cut: what was said meanwhile is "
        "kept. Longer: fewer echoes and slammed doors.", unit="s", minimum=0.0, maximum=1.0)
    source_look_back: float = parameter(
        0.3, "Sound kept from before a direction is used.", unit="s", minimum=0.0, maximum=1.0)
    source_hold_time: float = parameter(
        2.0, "Time that a silent direction is still used. It must be longer than the pause that ends a turn "
        "(hangover_time).", unit="s", minimum=0.1, maximum=10.0, live=True)
    source_memory: float = parameter(
        10.0, "Time that a silent direction is remembered. A voice from there is the same as before, later it is a new "
        "one.", unit="s", minimum=0.5, maximum=600.0)


@dataclass(frozen=True)
class OwnVoiceSettings(Settings):
    """Of the robot's own voice (core/audio/own_voice.py)."""

    robot_speaking_timeout: float = parameter(
        30.0, "A `robot_speaking` that stays true counts this long after the last message. Robots that say more at a "
        "time repeat it.", unit="s", minimum=1.0, maximum=600.0, live=True)
    robot_tail: float = parameter(
        0.4, "Time that the robot is still heard after the end of its speech: buffers of its sound card, and echoes of "
        "the room.", unit="s", minimum=0.0, maximum=5.0, live=True)
    barge_in_angle: float = parameter(
        0.5, "With an array, least angle between the robot's voice and somebody who is heard meanwhile. The directions "
        "of the robot's voice are learnt.", unit="rad", minimum=0.1, maximum=3.2, live=True)
    barge_in_margin: float = parameter(
        0.0, "How much louder than the robot that person must be, at the microphones. Lower hears more people, and "
        "words of the robot with them.", unit="dB", minimum=-20.0, maximum=40.0, live=True)


@dataclass(frozen=True)
class AudioFeatureSettings(Settings):
    """Of the descriptors (core/audio/features.py)."""

    features: bool = parameter(
        True, "Publish the 16 descriptors of each voice (`features`). They are personal data, and what emotion "
        "recognition is made of.")
    features_rate: float = parameter(
        25.0, "Frames of `features` per second and voice, rounded to steps of 10 ms; nothing is computed while nobody "
        "listens. 25 is every fourth frame, enough to follow pitch and loudness; 100 is every frame, what emotion "
        "recognition needs. Processor time grows in proportion, here and in every subscriber.", unit="Hz", minimum=1.0,
        maximum=100.0, live=True)


@dataclass(frozen=True)
class VoiceIdentitySettings(Settings):
    """Of whose voice it is (core/audio/speakers.py)."""

    voice_identity: bool = parameter(
        False, "Recognise the voices of people who have agreed: templates of voices are computed, and kept of those "
        "who were enrolled while they spoke. They are biometric data. Needs speaker_embedding.onnx.")
    gallery: str = parameter(
        "", "Store of people (.sqlite) that keeps the templates of voices beyond the run; shared with the person "
        "manager (parameter `store`) and recognisers of faces. Empty: in memory only.")
    gallery_key: str = parameter("", "File with the key that encrypts `gallery`; that of the other nodes.")


@dataclass(frozen=True)
class VoicesSettings(SoundInputSettings, VoiceActivitySettings, DirectionSettings, ArraySettings, OwnVoiceSettings,
                     AudioFeatureSettings, VoiceIdentitySettings, SpeechSettings):
    """Node voices: finds out who speaks, from where, and what is said, in the sound of a microphone or an array of
    them."""

    audio_backlog: float = parameter(
        1.0, "Part of the turn so far that the first subscriber of `audio` gets: the voice must speak before its topic "
        "can be known. In memory only.", unit="s", minimum=0.0, maximum=10.0)
    interface: str = parameter(
        "paper", "Type of `speech`: `paper` is std_msgs/String, `rep155` hri_msgs/LiveSpeech, which tells partial and "
        "final texts apart.", choices=("paper", "rep155"))


VOICES = ParameterTable("voices", VoicesSettings)
