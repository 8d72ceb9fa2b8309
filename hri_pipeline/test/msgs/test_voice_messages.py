"""Messages of voices: descriptors, and speech in both interfaces."""

import io

import genpy
import numpy as np
import pytest
from std_msgs.msg import Header, String

from hri_msgs.msg import AudioFeatures, LiveSpeech
from hri_pipeline.core.asr.recognition import SpeechResult
from hri_pipeline.core.audio.features import FeatureFrame
from hri_pipeline.ros.conversions import audio_features_to_msg, speech_message, speech_type

HEADER = Header(stamp=genpy.Time(1700000000, 5), frame_id="microphone_link")


def over_the_wire(message):
    """Serialise and deserialise."""
    buffer = io.BytesIO()
    message.serialize(buffer)
    return type(message)().deserialize(buffer.getvalue())


def test_descriptors():
    message = over_the_wire(audio_features_to_msg(FeatureFrame(3.0, 0.1, 0.2, 0.4, 12.5, np.arange(12.0))))
    assert isinstance(message, AudioFeatures)
    np.testing.assert_allclose([message.ZCR, message.RMS, message.pitch, message.HNR], [0.1, 0.2, 0.4, 12.5], rtol=1e-6)
    assert list(message.MFCC) == list(range(12))


def test_what_is_not_finite_is_zero():
    message = over_the_wire(audio_features_to_msg(FeatureFrame(0.0, np.nan, np.inf, -np.inf, np.nan,
                                                               np.full(12, np.nan))))
    assert (message.ZCR, message.RMS, message.pitch, message.HNR) == (0.0, 0.0, 0.0, 0.0) and not any(message.MFCC)


@pytest.mark.parametrize("incremental, final, confidence", [("go", "", 0.0), ("", "go forward", 0.8), ("", "", 1.7)])
def test_speech_in_both_interfaces(incremental, final, confidence):
    result = SpeechResult("abcde", 1.0, incremental, final, confidence, "en-US")
    text = speech_message(result, "paper", HEADER)
    assert speech_type("paper") is String and over_the_wire(text).data == (final or incremental)
    live = over_the_wire(speech_message(result, "rep155", HEADER))
    assert speech_type("rep155") is LiveSpeech and isinstance(live, LiveSpeech)
    assert (live.incremental, live.final, live.language) == (incremental, final, "en-US")
    assert live.confidence == min(1.0, confidence) and live.header == HEADER


def test_an_unknown_interface_is_refused():
    with pytest.raises(ValueError, match="interface is 'both'; legal: paper, rep155"):
        speech_type("both")
