"""Parameters of activity and turns, part of the table of the node `voices` (core/voices/voice_parameters.py)."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter

VOICE_STAGE_PARAMETERS = (
    Parameter("vad_model", "", "ONNX file of the voice activity network. Empty: silero_vad.onnx in the models directory"
              " ($ROS4HRI_MODELS, or ~/.cache/ros4hri/models)."),
    Parameter("birth_threshold", 0.4, "Probability of speech from which somebody begins to speak, in noise. Higher: fewer"
              " false voices, later and fewer soft ones.", minimum=0.05, maximum=0.99, live=True),
    Parameter("clear_birth_threshold", 0.3, "The same where the sound stands out of the noise by `clear_snr`: there the"
              " network errs little, and consonants at the begin of a word get 0.3 to 0.4. Between, it is interpolated."
              " Not above birth_threshold.", minimum=0.05, maximum=0.99, live=True),
    Parameter("clear_snr", 20.0, "Level above the noise floor from which clear_birth_threshold counts.", unit="dB",
              minimum=8.5, maximum=60.0, live=True),
    Parameter("keep_threshold", 0.2, "Probability from which somebody who speaks goes on speaking. Lower bridges softer"
              " speech and keeps `is_speaking` longer behind it. Not above clear_birth_threshold.",
              minimum=0.01, maximum=0.99, live=True),
    Parameter("noise_margin", 0.2, "Whoever speaks is louder than the noise floor by this much, else it is a pause,"
              " whatever the network says: it goes on for some 0.1 s behind a word.", unit="dB", minimum=0.0,
              maximum=20.0, live=True),
    Parameter("level_drop", 22.0, "Sound so far below the loudest of what was just said is a pause as well (reverberation,"
              " breath). Larger keeps more of soft endings.", unit="dB", minimum=6.0, maximum=90.0, live=True),
    Parameter("onset_time", 0.032, "Time for which the probability has to stay above the threshold until somebody speaks;"
              " rounded up to frames of 32 ms. Longer: fewer false voices, `is_speaking` so much later.", unit="s",
              minimum=0.0, maximum=1.0, live=True),
    Parameter("speaking_hangover", 0.032, "`is_speaking` lasts this long behind the last sound of speech. Longer bridges"
              " more of the pauses between words, and says more often that somebody speaks who does not.", unit="s",
              minimum=0.0, maximum=5.0, live=True),
    Parameter("hangover_time", 0.6, "A pause longer than this ends a turn: the sentence goes to the recogniser's final"
              " result. Longer keeps slow speakers in one piece, and answers later.", unit="s", minimum=0.05, maximum=10.0, live=True),
    Parameter("min_speech", 0.1, "A turn with less speech than this was a noise: its voice is let go at once.", unit="s",
              minimum=0.0, maximum=2.0, live=True),
    Parameter("look_back", 0.2, "Sound from before the onset that `audio` and recognition get with it: the onset is"
              " noticed when the first consonant is over.", unit="s", minimum=0.0, maximum=1.0),
    Parameter("voice_timeout", 3.0, "Time after its last word for which a voice stays tracked.", unit="s", minimum=0.1,
              maximum=600.0, live=True),
    Parameter("resume_time", 0.0, "Without an array: who begins to speak within this time after the last word of a voice"
              " that is still tracked gets its id again, else a new one. Up to hangover_time, every turn is a new voice: one"
              " microphone cannot tell who answers, and a voice that goes on for somebody else is matched with the wrong face."
              " Longer suits a robot with one user. With an array the direction decides, for as long as the voice is tracked.", unit="s", minimum=0.0, maximum=600.0, live=True),
    Parameter("direction_grace", 0.05, "With an array: what is heard in a direction counts as its voice for so long after the last"
              " sound that came from there. Speech behind that is somebody else's, which the separation lets through. Longer"
              " loses less where several speak at once, and hears more of others.", unit="s", minimum=0.0, maximum=5.0),
    Parameter("resume_angle", 0.35, "With an array: a new source less than this away from a tracked voice that is silent"
              " is this voice again.", unit="rad", minimum=0.0, maximum=3.2, live=True),
)
