"""Parameters of the node `voices`."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter, ParameterTable
from hri_pipeline.core.sound.sound_array_parameters import SOUND_ARRAY_PARAMETERS
from hri_pipeline.core.sound.sound_format import SAMPLE_FORMATS
from hri_pipeline.core.speech.speech_parameters import AUDIO_FEATURE_PARAMETERS, SPEECH_RECOGNITION_PARAMETERS
from hri_pipeline.core.voices.voice_stage_parameters import VOICE_STAGE_PARAMETERS

INTAKE_PARAMETERS = (
    Parameter("use_audio_info", True, "Believe the AudioInfo on `audio_info` where there is one: its channels, rate and"
              " format go before the three parameters below."),
    Parameter("channels", 1, "Interleaved channels of the sound while there is no AudioInfo.", minimum=1, maximum=32),
    Parameter("sample_rate", 16000, "Sample rate of the sound while there is no AudioInfo. It is resampled to 16 kHz"
              " once; lower rates lose the voice's overtones.", unit="Hz", minimum=4000, maximum=384000),
    Parameter("sample_format", "S16LE", "Layout of one sample while there is no AudioInfo, as GStreamer names it.",
              choices=SAMPLE_FORMATS),
    Parameter("input_latency", 0.0, "Least time between a sound and the message with it: buffers of the sound card and"
              " its driver. It is taken from every stamp; a wrong value shifts voices against faces.",
              unit="s", minimum=0.0, maximum=2.0),
    Parameter("resampling", "HQ", "Quality of the resampler. HQ keeps sound up to 7.3 kHz and holds it back for 37 ms at"
              " 48 kHz; LQ up to 5.8 kHz and 20 ms. A microphone of 16 kHz is not resampled.", choices=("HQ", "MQ", "LQ")),
    Parameter("gap_tolerance", 0.08, "Sound that stays missing for more than this is called a gap: stamps go on behind"
              " it. Smaller notices shorter gaps and takes slow deliveries for gaps.",
              unit="s", minimum=0.02, maximum=1.0),
    Parameter("silence_time", 2.0, "Time without any message after which all voices are let go.", unit="s", minimum=0.2,
              maximum=60.0, live=True),
    Parameter("frame_id", "microphone_link", "TF frame of the microphone or the array: x forward, y left, z up. The"
              " parent of the frames of voices; goes into headers."),
)
"""What taking in sound needs (core/sound/sound_format.py, core/sound/sound_stream.py, ros/sound_intake.py)."""

DIRECTION_PARAMETERS = (
    Parameter("direction", True, "Find where voices come from and separate them, with two channels or more and the"
              " positions of the microphones. Off: all channels are mixed to one."),
    Parameter("direction_distance", 1.0, "Distance from the microphone at which the frame voice_ID is put: an array"
              " knows the direction only.", unit="m", minimum=0.1, maximum=20.0, live=True),
) + SOUND_ARRAY_PARAMETERS
"""What direction and separation need (core/sound/sound_direction.py, core/sound/sound_separation.py)."""

FEATURE_PARAMETERS = (
    Parameter("features", True, "Publish the 16 descriptors of each voice (`features`), while somebody listens. They"
              " are personal data, and what emotion recognition is made of."),
) + AUDIO_FEATURE_PARAMETERS
"""What the descriptors need (core/voices/audio_features.py)."""

SPEECH_PARAMETERS = (
    Parameter("speech", True, "Recognise what voices say and publish it (`speech`). Recognition runs in a process of"
              " its own; sound is kept in memory while it is worked on, never on disk."),
) + SPEECH_RECOGNITION_PARAMETERS
"""What recognition of speech needs (core/speech/speech_recognition.py)."""

OUTPUT_PARAMETERS = (
    Parameter("audio_backlog", 1.0, "The first who subscribes to the `audio` of a voice is given so much of its turn from"
              " before, since the voice must speak before its topic can be known. In memory only.", unit="s", minimum=0.0,
              maximum=10.0),
    Parameter("interface", "paper", "Type of `speech`: `paper` is std_msgs/String, the text so far and then the"
              " whole sentence; `rep155` is hri_msgs/LiveSpeech, which tells the two apart.", choices=("paper", "rep155")),
)

VOICES = ParameterTable(
    "voices",
    "Node voices: finds out who speaks, from where, and what is said, in the sound of a microphone or an array of them.",
    INTAKE_PARAMETERS + VOICE_STAGE_PARAMETERS + DIRECTION_PARAMETERS + FEATURE_PARAMETERS + SPEECH_PARAMETERS
    + OUTPUT_PARAMETERS,
)
