"""Topics of voices that cannot be opened at once, voices that are over within a block, and the robot's voice when time
goes back; without a master."""

from unittest.mock import MagicMock

import numpy as np
import pytest
from audio_common_msgs.msg import AudioData

from hri_pipeline.core.audio.own_voice import RobotSpeech
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.pipeline import VoiceObservation
from hri_pipeline.core.audio.stream import RATE, encode_s16
from hri_pipeline.nodes import voices
from hri_pipeline.ros import sound_input, voice_topics
from hri_pipeline.ros.sound_input import RobotVoiceInput
from hri_pipeline.ros.voice_topics import VoiceTopics


@pytest.fixture()
def topics(monkeypatch):
    """Topics of voices of which only those of `may_open` can be opened; `published` has what was said."""
    monkeypatch.setattr(voice_topics, "rospy", MagicMock(ROSException=OSError))
    made = VoiceTopics(VOICES.resolve({}), False)
    made.may_open, made.published = set(), []

    def advertise(identity, name, spec, listener):
        if identity not in made.may_open:
            raise OSError("too few file descriptors")
        publisher = MagicMock()
        publisher.publish = lambda message: made.published.append((identity, name, message.data))
        publisher.get_num_connections.return_value = 0
        return publisher

    monkeypatch.setattr(made._publishers, "_advertise", advertise)
    monkeypatch.setattr(made._publishers._releaser, "put", list)
    return made


def said(voice, stamp):
    return VoiceObservation(voice, stamp, np.zeros(0, np.float32), True, True, 1.0, -20.0)


def test_a_voice_whose_topics_cannot_be_opened_costs_no_other_and_is_told_later(topics):
    topics.may_open.add("other")
    topics.retain(["first", "other"])
    for voice in ("first", "other"):
        topics.publish(said(voice, 1.0))
    assert topics.published == [("other", "is_speaking", True)]
    topics.may_open.add("first")
    topics.retain(["first", "other"])
    topics.publish(said("first", 1.1))
    assert topics.published[1:] == [("first", "is_speaking", True)]


def test_of_a_voice_whose_topics_never_opened_no_sound_is_kept(topics):
    for number in range(20):
        voice = "voice%d" % number
        topics.retain([voice])
        topics.publish(VoiceObservation(voice, 1.0, np.ones(RATE, np.float32), True, True, 1.0, -20.0))
    topics.retain([])
    assert not topics._backlogs and not topics._extractors and not topics._speaking


def test_of_voices_that_begin_and_end_within_a_block_nothing_is_kept_when_no_word_of_them_was_recognised(monkeypatch):
    monkeypatch.setattr(voices, "_LAST_WORDS_S", -1.0)
    node = voices.VoiceProcessor.__new__(voices.VoiceProcessor)     # without master and models
    node._settings, node._end, node._present, node._persons = VOICES.resolve({"frame_id": "microphone"}), 1.0, (), None
    node._frame_times, node._unfinished, node._awaited, node._counts = {}, set(), {}, {"turns": 0}
    node._topics, node._tracked_list, node._transforms, node._robot_input = (MagicMock() for _ in range(4))
    node._speech, node._pipeline = MagicMock(**{"poll.return_value": []}), MagicMock(tracked=())
    monkeypatch.setattr(voices, "rospy", MagicMock())
    for number in range(20):
        node._publish([VoiceObservation("voice%d" % number, 1.0, np.ones(RATE, np.float32), True, True, 1.0, -20.0,
                                        direction=np.array([1.0, 0.0, 0.0]), onset=True, end=True)])
        node.poll()
    assert not node._unfinished and not node._awaited and not node._frame_times


def test_what_the_robot_played_before_time_went_back_is_forgotten(monkeypatch):
    ros = MagicMock()
    ros.get_time.return_value, ros.Subscriber.return_value.get_num_connections.return_value = 100.0, 1
    monkeypatch.setattr(sound_input, "rospy", ros)
    robot = RobotSpeech(VOICES.resolve({}))
    played = RobotVoiceInput(robot)
    loud = np.sin(np.arange(RATE) * 0.3).astype(np.float32)
    played._on_audio(AudioData(data=encode_s16(loud)))
    played.update(100.1)
    assert robot.speaks(99.2, 99.8)
    played.update(5.0)
    assert not robot.speaks(99.2, 99.8)
