"""The parameters of the sound_source node."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter, ParameterTable
from hri_pipeline.core.pictures.source_parameters import EXIT, STAY

SOUND_SOURCE_PARAMETERS = ParameterTable(
    "sound_source",
    "Plays a sound file, a directory of them or an ALSA device as audio_common_msgs.",
    [
        Parameter("source", "", "What to play: a sound file (wav, flac, ogg, mp3, ... what libsndfile reads; .raw as 16-bit "
                  "samples of `raw_rate` and `raw_channels`), a directory of them (in reading order) or a microphone "
                  "(alsa, or alsa:DEVICE with a name that `arecord -L` shows). Required."),
        Parameter("sample_rate", 0, "Rate of the sound that goes out. 0: that of the (first) file, 16000 of a microphone. A "
                  "file of another rate is resampled.", unit="Hz", minimum=0, maximum=192000),
        Parameter("channels", 0, "Channels of the sound that goes out. 0: those of the (first) file, 1 of a microphone. A file "
                  "with one channel is put on all, several are mixed to one; other numbers do not fit together.",
                  minimum=0, maximum=32),
        Parameter("chunk", 0.02, "Length of the sound in one message. Shorter is heard sooner, and costs more.", unit="s",
                  minimum=0.005, maximum=1.0),
        Parameter("rate", 1.0, "How fast files are played: 2 sends twice as many messages per second, each as it is. "
                  "Who listens in real time hears it too high and says that the rate is wrong.", minimum=0.1, maximum=100.0),
        Parameter("loop", True, "Start again at the end of a file or directory."),
        Parameter("pause", 1.0, "Silence after each file, so that the next is a new turn.", unit="s", minimum=0.0,
                  maximum=600.0),
        Parameter("at_end", STAY, "What to do at the end when loop is false. stay: keep the node alive with `finished` true. "
                  "exit: end the node with exit code 0.", choices=(STAY, EXIT)),
        Parameter("wait_for_subscriber", False, "Start only when somebody listens, so that the begin is not lost."),
        Parameter("raw_rate", 16000, "Rate of files that end in .raw.", unit="Hz", minimum=4000, maximum=192000),
        Parameter("raw_channels", 1, "Channels of files that end in .raw.", minimum=1, maximum=32),
        Parameter("retry_period", 2.0, "How often a microphone that is not there is tried again.", unit="s", minimum=0.1,
                  maximum=60.0),
    ],
)
