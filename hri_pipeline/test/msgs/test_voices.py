"""Topics of voices with and without subscribers, some of which cannot be opened at once, voices that are over within a
block, and the robot's voice when time goes back; without a master."""

from unittest.mock import MagicMock

import numpy as np
import pytest
from audio_common_msgs.msg import AudioData

from hri_pipeline.core.asr.recognition import SpeechResult
from hri_pipeline.core.audio.own_voice import RobotSpeech
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.pipeline import VoiceObservation
from hri_pipeline.core.audio.stream import RATE, encode_s16
from hri_pipeline.nodes import voices
from hri_pipeline.ros import sound_input, voice_topics
from hri_pipeline.ros.sound_input import RobotVoiceInput
from hri_pipeline.ros.voice_topics import VoiceTopics


def topics_of(monkeypatch, speech=False, **given):
    """Topics of voices of which only those of `may_open` can be opened, and those of the names `heard` have
    subscribers; `published` has what was said."""
    monkeypatch.setattr(voice_topics, "rospy", MagicMock(ROSException=OSError))
    made = VoiceTopics(VOICES.resolve(given), speech)
    made.may_open, made.heard, made.published = set(), set(), []

    def advertise(identity, name, spec, listener):
        if identity not in made.may_open:
            raise OSError("too few file descriptors")
        publisher = MagicMock()
        publisher.publish = lambda message: made.published.append((identity, name, getattr(message, "data", message)))
        publisher.get_num_connections.side_effect = lambda: int(name in made.heard)
        return publisher

    monkeypatch.setattr(made._publishers, "_advertise", advertise)
    monkeypatch.setattr(made._publishers._releaser, "put", list)
    return made


@pytest.fixture()
def topics(monkeypatch):
    return topics_of(monkeypatch)


def said(voice, stamp, samples=(), speaking=True):
    return VoiceObservation(voice, stamp, np.array(samples, np.float32), speaking, True, 1.0, -20.0)


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


def test_whether_a_voice_speaks_is_told_with_each_change_and_when_it_ends_in_the_middle_of_a_word(topics):
    topics.may_open = {"first", "other"}
    topics.retain(["first", "other"])
    for speaking in (True, True, False, True):
        topics.publish(said("first", 1.0, speaking=speaking))
    topics.publish(said("other", 1.0, speaking=False))
    assert topics.published == [("first", "is_speaking", True), ("first", "is_speaking", False),
                                ("first", "is_speaking", True), ("other", "is_speaking", False)]
    topics.published.clear()
    topics.close_ids()
    assert topics.published == [("first", "is_speaking", False)] and topics._publishers.ids == []


@pytest.mark.parametrize("blocks", [4, 30])
def test_the_first_subscriber_of_the_sound_gets_the_end_of_what_was_said_before_and_each_sample_once(monkeypatch,
                                                                                                    blocks):
    topics = topics_of(monkeypatch, audio_backlog=1.0, features=False)
    topics.may_open = {"first"}
    topics.retain(["first"])
    length = RATE // 10
    block = [np.full(length, 0.001 * (number + 1), np.float32) for number in range(blocks + 4)]
    for number in range(blocks):
        topics.publish(said("first", 0.1 * number, block[number]))
    topics.heard = {"audio"}
    topics.published.clear()
    for number in (blocks, blocks + 1):
        topics.publish(said("first", 0.1 * number, block[number]))
    topics.publish(said("first", 0.1 * blocks + 0.2))       # a word of which no sound is there yet
    topics.heard = set()
    topics.publish(said("first", 0.1 * blocks + 0.2, block[blocks + 2]))
    topics.heard = {"audio"}
    topics.publish(said("first", 0.1 * blocks + 0.3, block[blocks + 3]))
    heard = [data for _, name, data in topics.published if name == "audio"]
    assert heard == [encode_s16(np.concatenate(block[max(0, blocks - 10):blocks + 1])),
                     encode_s16(block[blocks + 1]), encode_s16(block[blocks + 3])]


def test_a_voice_has_the_topics_that_are_switched_on_and_features_at_the_rate_of_now_for_who_listens(monkeypatch):
    noise = np.random.default_rng(1).normal(0.0, 0.1, RATE)
    silent = topics_of(monkeypatch, features=False, audio_backlog=0.0)
    silent.may_open, silent.heard = {"first"}, {"audio", "features"}
    silent.retain(["first"])
    silent.publish(said("first", 0.0, noise))
    assert [name for _, name, _ in silent.published] == ["is_speaking", "audio"]
    assert set(silent._publishers._open["first"]) == {"audio", "is_speaking"}
    topics = topics_of(monkeypatch, speech=True, features_rate=20.0)
    topics.may_open, counts = {"first"}, []
    topics.retain(["first"])
    for second, (listens, rate) in enumerate(((False, 20.0), (True, 20.0), (True, 50.0), (False, 50.0))):
        topics.heard = {"features"} if listens else set()
        topics.reconfigure(VOICES.resolve({"features_rate": rate}))
        topics.published.clear()
        for part in range(50):
            topics.publish(said("first", second + 0.02 * part, noise[part * RATE // 50:(part + 1) * RATE // 50]))
        counts.append(len([name for _, name, _ in topics.published if name == "features"]))
    assert counts[0] == counts[3] == 0 and 18 <= counts[1] <= 20 and 47 <= counts[2] <= 50
    assert set(topics._publishers._open["first"]) == {"audio", "is_speaking", "features", "speech"}


def test_what_a_voice_has_said_is_told_as_long_as_it_has_topics(monkeypatch):
    topics = topics_of(monkeypatch, speech=True)
    topics.may_open = {"first"}
    topics.retain(["first"])
    words = SpeechResult("first", 1.0, "", "hello", 0.9, "en")
    assert topics.publish_speech(words) and topics.published == [("first", "speech", "hello")]
    topics.retain([])
    assert not topics.publish_speech(words)


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
