"""Where another speaker goes on: the frames, times and ids. The network is stood in for by the pitch of a tone."""

import gc
import weakref

import numpy as np
import pytest

from hri_pipeline.core.audio.level import level_dbfs
from hri_pipeline.core.audio.parameters import VoiceActivitySettings
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.audio.speakers import (
    BANDS,
    CALIBRATION,
    HOP,
    HOP_S,
    LEAST_PRODUCT,
    LEAST_WINDOWS,
    LEVEL_DBFS,
    LIKELIHOOD,
    MODEL,
    WINDOW,
    WINDOW_S,
    VoiceIdentity,
    VoicePerson,
    mel_power,
)
from hri_pipeline.core.audio.stream import SoundBlock
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.parameters import ParameterTable
from hri_pipeline.core.recognition.gallery import GalleryError, MemoryGallery
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore
from hri_pipeline.core.recognition.stored_gallery import StoredGallery

TABLE = ParameterTable("activity", VoiceActivitySettings)
RATE, FRAME, START = 16000, 512, 1000.0
LOW, HIGH = 220.0, 700.0


class LoudIsSpeech:
    def probabilities(self, frames, states):
        return np.array([0.95 if level_dbfs(frame) > -30.0 else 0.01 for frame in frames])


class PitchIsSpeaker:
    """A unit vector (2,) of how much of a sound is below and above 450 Hz."""

    def embed(self, sounds):
        power = np.abs(np.fft.rfft(sounds, axis=1)) ** 2
        high = np.fft.rfftfreq(sounds.shape[1], 1.0 / RATE) > 450.0
        found = np.stack([power[:, ~high].sum(axis=1), power[:, high].sum(axis=1)], axis=1)
        return found / np.linalg.norm(found, axis=1, keepdims=True)


def tone(hertz, seconds):
    time = np.arange(int(seconds * RATE)) / RATE
    return (0.3 * np.sin(2.0 * np.pi * hertz * time)).astype(np.float32)


def pause(seconds):
    return np.zeros(int(seconds * RATE), np.float32)


def pipeline_of(speakers=None, **changes):
    settings = TABLE.resolve(dict({"hangover_time": 0.6, "speaking_hangover": 0.0}, **changes))
    return VoicePipeline(settings, LoudIsSpeech(), ids=IdGenerator(seed=3), speakers=speakers or PitchIsSpeaker())


def turns_of(*pieces, pipeline=None, **changes):
    """{id: its observations in turns} of the pieces, with 0.5 s before and 1 s behind."""
    pipeline = pipeline or pipeline_of(**changes)
    samples = np.concatenate([pause(0.5), *pieces, pause(1.0)])
    found = {}
    for first in range(0, len(samples) - FRAME + 1, FRAME):
        for seen in pipeline.update(SoundBlock(samples[first:first + FRAME, None], START + first / RATE)):
            if seen.turn:
                found.setdefault(seen.id, []).append(seen)
    return found


@pytest.mark.parametrize("gap", [0.0, 0.1, 0.3], ids=["at once", "short gap", "long gap"])
def test_another_speaker_gets_a_voice_with_all_its_sound(gap):
    begin = START + 0.5 + 2.5 + gap
    first, second = turns_of(tone(LOW, 2.5), pause(gap), tone(HIGH, 2.5)).values()
    assert first[0].onset and first[-1].end and second[0].onset and second[-1].end
    assert not any(seen.onset for seen in first[1:] + second[1:])
    assert first[-1].stamp == pytest.approx(second[0].stamp)
    # Behind a pause exactly; without one, within what was compared.
    assert begin - (0.07 if gap else 0.8) < second[0].stamp < begin + 0.07
    sound = np.concatenate([seen.samples for seen in second])
    assert len(sound) / RATE == pytest.approx(begin + 2.5 + 0.6 - second[0].stamp, abs=0.1)
    ends = [seen.stamp + len(seen.samples) / RATE for seen in second if len(seen.samples)]
    stamps = [seen.stamp for seen in second if len(seen.samples)]
    np.testing.assert_allclose(stamps[1:], ends[:-1], atol=1e-6)


def test_speakers_who_answer_each_other_are_three_turns():
    found = turns_of(tone(LOW, 2.5), pause(0.1), tone(HIGH, 2.5), pause(0.1), tone(LOW, 2.5))
    assert len(found) == 3


def test_voices_of_speakers_who_went_on_for_each_other_are_tracked_for_their_time_only():
    pipeline = pipeline_of(voice_timeout=3.0)
    assert len(turns_of(tone(LOW, 2.5), tone(HIGH, 2.5), pipeline=pipeline)) == 2
    pipeline.idle(START + 12.0)
    assert pipeline.tracked == ()


@pytest.mark.parametrize("pieces", [(tone(LOW, 8.0),), (tone(LOW, 2.0), pause(0.4), tone(LOW, 3.0))],
                         ids=["long", "with a pause"])
def test_one_speaker_is_one_turn(pieces):
    assert len(turns_of(*pieces)) == 1


def test_another_speaker_does_not_resume_the_voice():
    assert len(turns_of(tone(LOW, 2.5), tone(HIGH, 2.5), resume_time=60.0)) == 2


def test_who_answers_within_the_resume_time_has_another_voice_and_who_goes_on_the_same():
    found = turns_of(tone(LOW, 2.5), pause(1.0), tone(HIGH, 2.5), pause(1.0), tone(LOW, 2.5), pause(1.0),
                     tone(HIGH, 2.5), resume_time=15.0)
    lengths = {name: sum(len(seen.samples) for seen in turns) / RATE for name, turns in found.items()}
    low, high = [name for name, length in lengths.items() if length > 4.0]
    assert lengths[low] == pytest.approx(2 * 3.2, abs=0.5) and lengths[high] == pytest.approx(2 * 3.2, abs=0.5)
    assert sum(seen.onset for seen in found[low]) == sum(seen.onset for seen in found[high]) == 2
    assert len(found) == 4, "who goes on has a voice of its own until 1.2 s of speech sound like the earlier one"


def test_a_turn_of_an_earlier_voice_has_all_its_sound_and_nothing_is_left_of_the_new_one():
    pipeline = pipeline_of(resume_time=15.0, look_back=0.2)
    found = turns_of(tone(LOW, 2.5), pause(1.0), tone(LOW, 2.5), pipeline=pipeline)
    (same, turns), (passing, passed) = found.items()
    assert pipeline.tracked == (same,)
    assert passed[0].onset and passed[-1].end and len(passed) < 45
    again = [seen for seen in turns if seen.onset][1]
    assert again.stamp == pytest.approx(passed[0].stamp) == pytest.approx(passed[-1].stamp)
    assert again.stamp == pytest.approx(START + 4.0 - 0.2, abs=0.07)
    assert [len(seen.samples) for seen in passed[:1]] == [int(0.2 * RATE) + FRAME]


@pytest.mark.parametrize("resume_time, silence, turns", [(2.0, 1.5, 2), (15.0, 13.0, 2), (15.0, 14.5, 1)])
def test_who_is_compared_after_the_resume_time_has_one_voice_for_the_turn(resume_time, silence, turns):
    """The turn begins within resume_time; 1.2 s of speech later it is over, or the earlier voice has ended, too."""
    found = turns_of(tone(LOW, 2.5), pause(silence), tone(LOW, 2.5), resume_time=resume_time)
    assert [sum(seen.onset for seen in seens) for seens in found.values()] == [turns, 1]


class UnsureAtFirst(PitchIsSpeaker):
    """Takes the looks 7 to 9, the first three in a second turn, for nobody's."""

    def __init__(self):
        self.looks = 0

    def embed(self, sounds):
        self.looks += 1
        return np.array([[0.697, 0.717]]) if 6 < self.looks < 10 else super().embed(sounds)


def test_a_turn_is_wholly_an_earlier_voices_after_the_last_look_too():
    pipeline = pipeline_of(UnsureAtFirst(), resume_time=15.0)
    found = turns_of(tone(LOW, 2.5), pause(1.0), tone(LOW, 3.5), pipeline=pipeline)
    (same, turns), (_, passed) = found.items()
    assert len(passed) > 60, "it was told in the fourth look"
    assert [seen.stamp for seen in turns if seen.onset][1] == pytest.approx(passed[0].stamp)
    assert pipeline.tracked == (same,)


class Watched(PitchIsSpeaker):
    """Knows which of its embeddings are kept by anybody."""

    def __init__(self):
        self.told = []

    def embed(self, sounds):
        found = super().embed(sounds)
        self.told.append(weakref.ref(found))
        return found

    @property
    def kept(self):
        gc.collect()
        return [told for told in self.told if told() is not None]


@pytest.mark.parametrize("resume_time, after_turn", [(0.0, 0), (15.0, 5)])
def test_no_embedding_outlives_its_voice(resume_time, after_turn):
    watched = Watched()
    pipeline = pipeline_of(watched, resume_time=resume_time)
    samples = np.concatenate([pause(0.5), tone(LOW, 2.5), pause(1.0)])
    for first in range(0, len(samples) - FRAME + 1, FRAME):
        pipeline.update(SoundBlock(samples[first:first + FRAME, None], START + first / RATE))
    assert len(watched.told) > 4 and len(watched.kept) >= after_turn
    assert resume_time > 0.0 or not watched.kept
    for second in range(20):        # silence that is heard
        pipeline.update(SoundBlock(pause(1.0)[:, None], START + 4.0 + second))
    assert pipeline.tracked == () and not watched.kept


@pytest.mark.parametrize("second", [tone(LOW, 0.8), tone(HIGH, 0.8)], ids=["same", "other"])
def test_who_says_too_little_to_be_compared_is_nobody_who_spoke_before(second):
    assert len(turns_of(tone(LOW, 2.5), pause(1.0), second, resume_time=15.0)) == 2


@pytest.mark.parametrize("seconds, silence, there", [(2.5, 10.0, 1), (2.5, 16.0, 0), (0.8, 10.0, 0)])
def test_a_voice_of_known_sound_is_tracked_as_long_as_it_may_go_on(seconds, silence, there):
    pipeline = pipeline_of(resume_time=15.0)
    turns_of(tone(LOW, seconds), pipeline=pipeline)
    pipeline.idle(START + 0.5 + seconds + silence)
    assert len(pipeline.tracked) == there


def test_who_went_on_for_another_in_one_turn_may_have_spoken_before():
    found = turns_of(tone(LOW, 2.5), pause(0.1), tone(HIGH, 2.5), pause(0.1), tone(LOW, 2.5), resume_time=15.0)
    assert len(found) == 2


def test_a_turn_after_a_pause_is_not_compared_with_the_one_before():
    first, second = turns_of(tone(LOW, 2.5), pause(1.0), tone(HIGH, 2.5)).values()
    assert len(first[-1].samples) and second[0].stamp == pytest.approx(START + 4.0, abs=0.25)


def test_the_bands_tell_frequency_and_power():
    """A tone in the middle of the linear part is in the bands around it (2.5 mel of 66.7 Hz apart), with half of its
    squared amplitude times the window's energy, spread over triangles of the area 1."""
    power = mel_power(tone(500.0, 0.5))
    assert power.shape == ((8000 - WINDOW) // HOP + 1, BANDS) and power.dtype == np.float32
    np.testing.assert_allclose(mel_power(2.0 * tone(500.0, 0.5)), 4.0 * power, rtol=1e-4)
    assert LEVEL_DBFS == -30.0


@pytest.mark.parametrize("hertz, bands", [(500.0, {5, 6}), (1000.0, {12, 13}), (4000.0, {30, 31}), (6500.0, {37, 38})])
def test_the_bands_are_even_up_to_1_khz_and_in_proportion_above(hertz, bands):
    """45.2 mel up to 8 kHz, as 15 up to 1 kHz and 27 for each factor of 6.4 above, in 41 steps."""
    assert set(np.argsort(mel_power(tone(hertz, 0.5)).mean(axis=0))[-2:]) == bands


ENOUGH = WINDOW_S + (LEAST_WINDOWS - 1) * HOP_S


class AngleIsSpeaker:
    def embed(self, sounds):
        angles = sounds.mean(axis=1)
        return np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)


def make(gallery=None):
    return VoiceIdentity(AngleIsSpeaker(), MemoryGallery(MODEL, 2, CALIBRATION) if gallery is None else gallery)


def say(identity, voice, angle, seconds=ENOUGH):
    """Speak in frames of 32 ms."""
    for _ in range(int(round(seconds * RATE / 512.0))):
        identity.add(voice, np.full(512, angle, np.float32))
    return identity.changes()


def known(*people):
    """An identity that knows people {name: angle}."""
    identity = make()
    for name, angle in people:
        say(identity, "voice_" + name, angle)
        identity.enrol("voice_" + name, name)
    identity.retain(())
    identity.changes()
    return identity


NEAR, FAR = np.arccos(LEAST_PRODUCT + 0.02), np.arccos(LEAST_PRODUCT - 0.02)


def test_who_was_enrolled_is_told_and_nobody_else():
    identity = known(("anna", 0.0))
    assert say(identity, "first", NEAR) == [VoicePerson("first", "anna", LIKELIHOOD)]
    assert say(identity, "second", FAR) == []
    assert identity.current() == [VoicePerson("first", "anna", LIKELIHOOD)]


def test_nothing_is_told_of_little_speech():
    identity = known(("anna", 0.0))
    assert say(identity, "first", 0.0, ENOUGH - 0.1) == []
    assert say(identity, "first", 0.0, 0.2) != []


def test_nothing_is_told_between_two_people_who_are_alike():
    identity = known(("anna", 0.0), ("berta", 0.4))
    assert say(identity, "first", 0.2) == []
    assert say(identity, "second", -0.1) == [VoicePerson("second", "anna", LIKELIHOOD)]


def test_what_was_told_is_withdrawn_when_the_voice_becomes_another():
    identity = known(("anna", 0.0))
    say(identity, "first", 0.0)
    assert say(identity, "first", 1.5, 20.0) == [VoicePerson("first", "anna", 0.0)]


def test_who_was_told_stays_while_somebody_alike_is_not_nearer():
    identity = known(("anna", 0.0), ("berta", 0.4))
    assert say(identity, "first", -0.1) == [VoicePerson("first", "anna", LIKELIHOOD)]
    assert say(identity, "first", 0.18, 20.0) == []
    assert say(identity, "first", 0.25, 20.0) == [VoicePerson("first", "anna", 0.0)]


def test_a_voice_that_is_not_heard_or_has_said_little_is_not_enrolled():
    identity = make()
    with pytest.raises(GalleryError, match="not tracked"):
        identity.enrol("second", "anna")
    say(identity, "third", 0.0, ENOUGH - 0.1)
    with pytest.raises(GalleryError, match="has not spoken"):
        identity.enrol("third", "")
    assert identity.list_known() == []


def test_who_has_no_face_is_enrolled_by_voice_alone_and_is_one_person_in_all_turns():
    identity = make()
    say(identity, "first", 0.0)
    person = identity.enrol("first", "")
    assert identity.list_known() == [person]
    assert identity.changes() == [VoicePerson("first", person, 0.95)]
    assert identity.enrol("first", "") == person, "who it is taken for"
    assert say(identity, "second", 0.1) == [VoicePerson("second", person, 0.95)]
    assert say(identity, "third", 1.5) == []
    assert identity.enrol("third", "") != person


def test_a_voice_like_one_that_is_known_is_somebody_new_only_when_that_is_confirmed():
    identity = known(("anna", 0.0))
    near = 0.65                     # of a product of .796: too little to be told, too much to be somebody else
    assert say(identity, "first", near) == []
    with pytest.raises(GalleryError, match="sounds like anna"):
        identity.enrol("first", "")
    assert identity.list_known() == ["anna"]
    assert identity.enrol("first", "", confirm=True) not in ("", "anna")


def test_forgetting_withdraws_and_forgets():
    identity = known(("anna", 0.0), ("berta", 1.5))
    say(identity, "first", 0.0)
    assert identity.forget("anna") and not identity.forget("anna")
    assert identity.changes() == [VoicePerson("first", "anna", 0.0)]
    assert say(identity, "second", 0.0) == [] and identity.list_known() == ["berta"]
    with pytest.raises(GalleryError):
        identity.export("anna")
    identity.forget_all()
    assert identity.list_known() == []


def test_a_voice_of_who_was_forgotten_elsewhere_or_merged_is_compared_anew():
    """Without a word from the voice: a listener that comes late would be told of somebody who is not known."""
    identity = known(("anna", 0.0), ("berta", 1.5))
    say(identity, "first", 0.0)
    identity.merge("anna", "berta")
    assert identity.changes() == [VoicePerson("first", "anna", 0.0), VoicePerson("first", "berta", LIKELIHOOD)]
    identity._gallery.remove("berta")           # as flush() does, for another process
    assert identity.current() == [] and identity.changes() == [VoicePerson("first", "berta", 0.0)]


def test_a_voice_unlike_that_of_the_person_is_not_enrolled_without_a_word():
    identity = known(("anna", 0.0))
    say(identity, "first", 1.5)
    with pytest.raises(GalleryError, match="does not sound like anna"):
        identity.enrol("first", "anna")
    say(identity, "second", 0.3)
    assert identity.enrol("second", "anna") == "anna"


def test_the_store_keeps_voices_beside_faces_and_forgets_both(tmp_path):
    """Another process forgets the person: the voice is gone here, and nothing of it is left in the file."""
    path, face = tmp_path / "people.sqlite", np.eye(4, dtype=np.float32)[:1]
    path.parent.chmod(0o700)
    faces = PersonStore(path)
    faces.put_templates(KnownPerson("anna", face, True), "face", 1000.0)
    identity = make(StoredGallery(PersonStore(path), MODEL, 2, CALIBRATION))
    say(identity, "first", 0.3)
    identity.enrol("first", "anna")
    identity.flush()
    assert len(faces.load_templates("face", 4)) == len(faces.load_templates(MODEL, 2)) == 1
    again = make(StoredGallery(PersonStore(path), MODEL, 2, CALIBRATION))
    assert say(again, "second", 0.3) == [VoicePerson("second", "anna", LIKELIHOOD)]
    template = identity.export("anna").templates.astype("<f4").tobytes()
    faces.remove_record("anna")
    identity.flush()
    again.flush()
    assert identity.list_known() == again.list_known() == []
    assert again.changes() == [VoicePerson("second", "anna", 0.0)] and say(again, "third", 0.3) == []
    again.close()
    identity.close()
    faces.close()
    assert all(template not in file.read_bytes() for file in tmp_path.iterdir())
