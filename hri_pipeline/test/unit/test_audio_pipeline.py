"""From blocks to voices: frames, stamps, look-back, gaps, sources. The network is stood in for by the level of the
sound."""

from types import SimpleNamespace

import numpy as np
import pytest

from hri_pipeline.core.audio.features import AudioFeatureExtractor
from hri_pipeline.core.audio.level import level_dbfs
from hri_pipeline.core.audio.parameters import VoiceActivitySettings
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.audio.stream import SoundBlock, SoundFormat, SoundStream
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.parameters import ParameterTable

TABLE = ParameterTable("activity", VoiceActivitySettings)
RATE = 16000
FRAME = 512
START = 1000.0


class LoudIsSpeech:
    """Gives 0.95 to frames above -30 dBFS and 0.01 to others; counts its calls and their sizes."""

    def __init__(self):
        self.batches = []

    def probabilities(self, frames, states):
        assert frames.shape == (len(states), FRAME) and np.isfinite(frames).all()
        self.batches.append(len(states))
        return np.array([0.95 if level_dbfs(frame) > -30.0 else 0.01 for frame in frames])


class Script:
    """A separator that follows a script: {call: [(key, samples, offset, degrees)]}."""

    def __init__(self, script, active=lambda call, key: True, before=0):
        self.script, self.active, self.before, self.calls, self.resets = script, active, before, 0, 0

    def process(self, samples):
        self.calls += 1
        return [SimpleNamespace(key=key, samples=sound, offset=offset, direction=towards(degrees), direction_sd=0.1,
                                active=self.active(self.calls - 1, key), before=self.before)
                for key, sound, offset, degrees in self.script(self.calls - 1, samples)]

    def reset(self):
        self.resets += 1


def towards(degrees):
    angle = np.deg2rad(degrees)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def make(array=None, **changes):
    values = dict({"hangover_time": 0.2, "voice_timeout": 1.0, "resume_time": 0.5, "look_back": 0.1,
                   "speaking_hangover": 0.0}, **changes)
    return VoicePipeline(TABLE.resolve(values), LoudIsSpeech(), array, IdGenerator(seed=3))


def sound(*pieces):
    """(seconds, loud?) -> samples; every sample is another number, so that its place can be found again."""
    samples = np.concatenate([np.full(int(round(seconds * RATE)), 0.3 if loud else 1e-3) for seconds, loud in pieces])
    return (samples * (1.0 + np.arange(len(samples)) / len(samples) / 4)).astype(np.float32)


def feed(pipeline, samples, start=START, length=FRAME):
    columns = samples if samples.ndim == 2 else samples[:, None]
    found = []
    for first in range(0, len(columns), length):
        found += pipeline.update(SoundBlock(columns[first:first + length], start + first / RATE))
    return found


@pytest.mark.parametrize("length", [100, 160, 512, 700, 4096])
def test_a_turn_has_its_sound_without_hole_or_repetition(length):
    samples = sound((1.024, False), (0.512, True), (1.024, False))
    pipeline = make()
    turn = [seen for seen in feed(pipeline, samples, length=length) if seen.turn]
    assert len({seen.id for seen in turn}) == 1
    assert [seen.onset for seen in turn] == [True] + [False] * (len(turn) - 1)
    assert [seen.end for seen in turn] == [False] * (len(turn) - 1) + [True]
    # 0.1 s before the onset, 0.512 s of speech, and the hangover of 0.2 s with the frame that ends it.
    first = round((turn[0].stamp - START) * RATE)
    assert first == round(1.024 * RATE) - 1600
    heard = np.concatenate([seen.samples for seen in turn])
    np.testing.assert_array_equal(heard, samples[first:first + len(heard)])
    assert len(heard) == 1600 + 16 * FRAME + 7 * FRAME
    place = turn[0].stamp
    for seen in turn:
        assert seen.stamp == pytest.approx(place, abs=1e-6)
        place += len(seen.samples) / RATE


def test_speaking_and_energy_follow_the_sound():
    found = feed(make(), sound((0.512, False), (0.512, True), (0.512, False)))
    loud = [seen for seen in found if seen.speaking]
    assert len(loud) == 16 and all(seen.probability == 0.95 for seen in loud)
    assert loud[3].energy == pytest.approx(20 * np.log10(0.35), abs=1.0)
    assert loud[0].direction is None and loud[0].direction_sd is None
    assert all(not seen.samples.size and not seen.turn for seen in found if seen.stamp > START + 1.3)


def test_a_voice_is_tracked_until_its_time_is_over():
    pipeline = make()
    feed(pipeline, sound((0.512, False), (0.512, True)))
    (name,) = pipeline.tracked
    after = feed(pipeline, sound((0.9, False)), START + 1.024)
    assert pipeline.tracked == (name,) and {seen.id for seen in after} == {name}
    assert len(after) >= 27, "an observation per frame, so that topics live on"
    feed(pipeline, sound((0.2, False)), START + 1.924)
    assert pipeline.tracked == ()
    assert feed(pipeline, sound((0.512, False)), START + 2.124) == []


@pytest.mark.parametrize("pause, same", [(0.15, True), (0.35, True), (0.7, False)])
def test_who_goes_on_soon_is_the_same(pause, same):
    found = feed(make(), sound((0.512, False), (0.512, True), (pause, False), (0.512, True), (0.512, False)))
    ids = [seen.id for seen in found if seen.speaking]
    assert (ids[0] == ids[-1]) is same
    assert sum(seen.onset for seen in found) == (1 if pause < 0.2 else 2)


def test_look_back_does_not_repeat_what_was_given_before():
    """The second turn begins 64 ms behind the end of the first."""
    samples = sound((0.512, False), (0.512, True), (0.288, False), (0.512, True), (0.5, False))
    found = [seen for seen in feed(make(), samples) if seen.turn]
    assert sum(seen.onset for seen in found) == 2
    heard = np.concatenate([seen.samples for seen in found])
    assert len(np.unique(heard)) > len(heard) * 0.99
    first, second = [index for index, seen in enumerate(found) if seen.onset]
    end = found[second - 1].stamp + FRAME / RATE
    assert found[second].stamp >= end - 1e-6


@pytest.mark.parametrize("look_back", [0.0, 0.01, 0.2, 1.0])
def test_look_back_at_the_begin_of_the_sound(look_back):
    found = feed(make(look_back=look_back), sound((0.064, False), (0.512, True)))
    wanted = min(look_back, 0.064)
    assert found[0].onset and len(found[0].samples) == FRAME + round(wanted * RATE)
    assert found[0].stamp == pytest.approx(START + 0.064 - wanted, abs=1e-6)


@pytest.mark.parametrize("gap, ends", [(0.05, False), (0.15, False), (0.25, True), (5.0, True)])
def test_a_gap_is_a_pause(gap, ends):
    pipeline = make()
    feed(pipeline, sound((0.512, False), (0.512, True)))
    found = feed(pipeline, sound((0.064, True)), START + 1.024 + gap)
    assert any(seen.end for seen in found) is ends
    if ends:
        assert found[0].end and not found[0].samples.size
    assert [seen.onset for seen in found if seen.turn and seen.samples.size][0] is ends
    assert [seen for seen in found if seen.samples.size][0].stamp == pytest.approx(START + 1.024 + gap)


def test_idle_time_ends_turns_and_lets_voices_go():
    pipeline = make()
    assert pipeline.idle(5.0) == [], "no sound was ever heard"
    feed(pipeline, sound((0.512, False), (0.512, True)))
    assert pipeline.idle(START + 1.0) == []
    assert pipeline.idle(START + 1.1) == [] and len(pipeline.tracked) == 1
    (seen,) = pipeline.idle(START + 1.3)
    assert seen.end and seen.turn and not seen.speaking and not seen.samples.size
    assert pipeline.idle(START + 1.5) == [] and len(pipeline.tracked) == 1
    pipeline.idle(START + 2.5)
    assert pipeline.tracked == ()


def test_time_that_goes_back_starts_afresh():
    pipeline = make()
    feed(pipeline, sound((0.512, False), (0.512, True)))
    (name,) = pipeline.tracked
    found = feed(pipeline, sound((0.512, False), (0.512, True)), START - 500.0)
    assert name not in pipeline.tracked and len(pipeline.tracked) == 1
    assert found[0].end and found[0].id == name
    assert found[1].onset and found[1].stamp < START


def test_time_that_goes_back_is_told_to_the_array():
    array = Script(lambda call, samples: [])
    pipeline = make(array)
    for start in (START, START - 500.0):
        feed(pipeline, np.zeros((FRAME, 4), np.float32), start)
    assert array.resets == 1


def test_sound_that_was_held_up_is_the_same_voice():
    """Idle time is noted, and then the sound comes after all, with its old stamps."""
    pipeline = make(hangover_time=0.4)
    feed(pipeline, sound((0.512, False), (0.512, True)))
    (name,) = pipeline.tracked
    assert pipeline.idle(START + 1.3) == []
    found = feed(pipeline, sound((0.512, True)), START + 1.024)
    assert {seen.id for seen in found} == {name} and not any(seen.onset or seen.end for seen in found)
    assert found[0].stamp == pytest.approx(START + 1.024) and len(found) == 16


def test_reset_lets_everybody_go():
    pipeline = make()
    feed(pipeline, sound((0.512, False), (0.512, True)))
    pipeline.reset()
    assert pipeline.tracked == ()
    assert pipeline.idle(START + 100.0) == []


def test_channels_are_mixed_without_an_array():
    mono = sound((0.512, False), (0.512, True))
    found = feed(make(look_back=0.0), np.stack([mono * 2.0, mono * 0.0], axis=1))
    np.testing.assert_allclose(found[0].samples, mono[-16 * FRAME:][:FRAME], rtol=1e-6)


def test_samples_that_are_no_numbers_are_survived():
    samples = sound((0.512, False), (0.512, True))
    samples[1000], samples[9000] = np.nan, np.inf
    found = feed(make(), samples)
    assert len([seen for seen in found if seen.speaking]) == 16
    assert all(np.isfinite(seen.samples).all() and np.isfinite(seen.energy) for seen in found)


@pytest.mark.parametrize("shape", [(512,), (512, 0), (1, 512, 1)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(ValueError, match="a block of sound has the shape"):
        make().update(SoundBlock(np.zeros(shape, np.float32), START))


def test_an_empty_block_is_nothing():
    assert make().update(SoundBlock(np.zeros((0, 1), np.float32), START)) == []


def test_thresholds_are_checked_at_the_start():
    with pytest.raises(ValueError, match="must be in this order"):
        make(keep_threshold=0.9)


def test_sources_of_an_array_are_voices_of_their_own():
    def script(call, samples):
        loud = np.full(FRAME, 0.3, np.float32)
        return [(1, loud, 0, 30.0)] * (call < 40) + [(2, loud * 0.5, 0, -30.0)] * (20 <= call < 40)
    array = Script(script)
    pipeline = make(array)
    found = feed(pipeline, np.zeros((FRAME * 40, 4), np.float32))
    first, second = pipeline.tracked
    assert pipeline._model.batches == [1] * 20 + [2] * 20, "all sources in one run of the network"
    assert {seen.id for seen in found if seen.stamp < START + 0.6} == {first}
    assert [seen.energy for seen in found if seen.id == second][-1] == pytest.approx(20 * np.log10(0.15))
    for name, degrees in ((first, 30.0), (second, -30.0)):
        seen = [seen for seen in found if seen.id == name][-1]
        np.testing.assert_allclose(seen.direction, towards(degrees))
        assert seen.direction_sd == 0.1 and seen.speaking
    # Both directions fall silent: no signals come any more.
    found = feed(pipeline, np.zeros((FRAME * 15, 4), np.float32), START + 40 * FRAME / RATE)
    assert sorted(seen.id for seen in found if seen.end) == sorted((first, second))
    feed(pipeline, np.zeros((FRAME * 40, 4), np.float32), START + 55 * FRAME / RATE)
    assert pipeline.tracked == () and not pipeline._sources


def test_a_source_comes_with_sound_from_before():
    def script(call, samples):
        if call < 10:
            return []
        length, offset = (FRAME * 6, -FRAME * 5) if call == 10 else (FRAME, 0)
        return [(7, np.full(length, 0.3, np.float32), offset - 256, 0.0)]
    found = feed(make(Script(script)), np.zeros((FRAME * 12, 2), np.float32))
    assert len(found) == 7 and found[0].onset
    assert found[0].stamp == pytest.approx(START + (5 * FRAME - 256) / RATE)
    assert all(seen.speaking for seen in found)


@pytest.mark.parametrize("hangover, turns", [(0.2, 1), (0.05, 2)])
def test_a_source_that_is_missing_for_a_moment_goes_on_at_its_time_after_a_pause(hangover, turns):
    """Its sound comes in pieces of half a frame, of which those of 80 ms are missing, from within a frame on."""
    half = np.full(FRAME // 2, 0.3, np.float32)
    array = Script(lambda call, samples: [] if 21 <= call < 26 else [(1, half, 0, 0.0)])
    found = feed(make(array, hangover_time=hangover), np.zeros((FRAME * 20, 2), np.float32), length=FRAME // 2)
    stamps = [START + call * FRAME / RATE for call in [*range(10), *range(13, 20)]]
    assert [seen.stamp for seen in found if seen.samples.size] == pytest.approx(stamps)
    assert (len({seen.id for seen in found}), sum(seen.onset for seen in found)) == (1, turns)


def test_what_comes_from_elsewhere_is_not_this_voice():
    """The filter of source 1 lets source 2 through after the 20th call; nothing comes from its direction any more."""
    loud = np.full(FRAME, 0.3, np.float32)
    array = Script(lambda call, samples: [(1, loud, 0, 0.0)] + [(2, loud, 0, 90.0)] * (call >= 20),
                   active=lambda call, key: key == 2 or call < 20)
    pipeline = make(array, direction_grace=0.1)
    found = feed(pipeline, np.zeros((FRAME * 40, 2), np.float32))
    first, second = [seen.id for seen in found if seen.onset]
    last = max(seen.stamp for seen in found if seen.id == first and seen.speaking)
    assert START + 20 * FRAME / RATE <= last <= START + 20 * FRAME / RATE + 0.1
    assert [seen for seen in found if seen.id == first and seen.end]
    assert [seen.speaking for seen in found if seen.id == second] == [True] * 20


@pytest.mark.parametrize("amplitude, floor", [(0.2, -60.0), (0.01, -40.0)])
def test_speech_of_others_is_no_noise_and_a_pause(amplitude, floor):
    """Source 1 falls silent after noise and speech; then its filter lets through speech of another, or noise."""
    array = Script(lambda call, samples: [
        (1, np.full(FRAME, 1e-3 if call < 10 else 0.3 if call < 20 else amplitude, np.float32), 0, 0.0)],
                   active=lambda call, key: call < 20)
    pipeline = make(array, direction_grace=0.0)
    found = feed(pipeline, np.zeros((FRAME * 120, 2), np.float32))
    noise = pipeline._sources[1].turns.activity.noise
    assert noise.level == pytest.approx(floor, abs=2.0)
    assert found[-1].energy == -120.0 and not found[-1].speaking


def test_who_falls_silent_while_others_speak_has_no_hangover():
    loud = np.full(FRAME, 0.3, np.float32)
    pipeline = make(Script(lambda call, samples: [(1, loud, 0, 0.0)], active=lambda call, key: call < 20),
                    direction_grace=0.0, speaking_hangover=0.2)
    found = feed(pipeline, np.zeros((FRAME * 26, 2), np.float32))
    assert [seen.speaking for seen in found] == [True] * 21 + [False] * 5


def test_sound_from_before_a_source_was_heard_is_somebody_elses():
    """Six frames come at once, of which the first three are what the filter lets through of others."""
    sound = np.repeat(np.float32([0.05, 0.3]), 3 * FRAME)
    array = Script(lambda call, samples: [(7, sound, -5 * FRAME, 0.0)] * (call == 5), before=3 * FRAME)
    found = feed(make(array, look_back=0.0), np.zeros((FRAME * 6, 2), np.float32))
    assert [seen.stamp for seen in found] == pytest.approx([START + frame * FRAME / RATE for frame in (3, 4, 5)])


def test_a_speaker_whom_the_separator_loses_and_finds_is_one_voice():
    def script(call, samples):
        loud = np.full(FRAME, 0.3, np.float32)
        if call < 20:
            return [(1, loud, 0, 0.0)]
        return [(2, loud, 0, 10.0)] if call >= 32 else []
    pipeline = make(Script(script), hangover_time=5.0)
    found = feed(pipeline, np.zeros((FRAME * 40, 2), np.float32))
    assert len(pipeline.tracked) == 1
    turns = [(seen.onset, seen.end) for seen in found if seen.onset or seen.end]
    assert turns == [(True, False), (False, True), (True, False)]


def test_two_who_speak_at_once_close_to_each_other_end_no_turns():
    loud = np.full(FRAME, 0.3, np.float32)
    array = Script(lambda call, samples: [(1, loud, 0, 0.0)] + [(2, loud, 0, 15.0)] * (call >= 10))
    found = feed(make(array), np.zeros((FRAME * 30, 2), np.float32))
    assert len({seen.id for seen in found}) == 2 and not any(seen.end for seen in found)


def test_a_gap_ends_the_turns_of_an_array_and_the_voices_go_on():
    array = Script(lambda call, samples: [(1 if call < 20 else 5, np.full(FRAME, 0.3, np.float32), 0, 20.0)])
    pipeline = make(array)
    feed(pipeline, np.zeros((FRAME * 20, 2), np.float32))
    (name,) = pipeline.tracked
    found = feed(pipeline, np.zeros((FRAME * 3, 2), np.float32), START + 20 * FRAME / RATE + 0.05)
    assert array.resets == 1
    assert found[0].end and found[1].onset and {seen.id for seen in found} == {name}


def test_hundreds_of_turns_leave_nothing_behind():
    array = Script(lambda call, samples: [] if call % 10 > 5 else
                   [(call // 10, np.full(FRAME, 0.3, np.float32), 0, 40.0 * (call // 10))])
    pipeline = make(array, voice_timeout=0.3, hangover_time=0.1)
    found = feed(pipeline, np.zeros((FRAME * 2000, 2), np.float32)) + pipeline.idle(START + 65.0)
    assert sum(seen.onset for seen in found) == 200 and sum(seen.end for seen in found) == 200
    assert len(pipeline.tracked) <= 2 and len(pipeline._sources) <= 4


@pytest.mark.parametrize("samples, dbfs", [
    (np.zeros(10), -120.0), (np.zeros(0), -120.0), (np.ones(10), 0.0), (np.full(5, 0.1), -20.0),
    (np.full(5, 1e-9), -120.0)])
def test_level(samples, dbfs):
    assert level_dbfs(samples.astype(np.float32)) == pytest.approx(dbfs, abs=1e-4)


@pytest.mark.parametrize("chunk", [0.01, 0.02, 0.1])
@pytest.mark.parametrize("stall", [0.3, 1.2, 4.0])
def test_a_burst_of_late_sound_keeps_the_voice_and_all_its_words_and_no_stamp_goes_back(stall, chunk):
    """Voices ended and began anew as others, with earlier stamps, whenever the clock of the sound was set back."""
    samples = sound((1.0, False), (8.0, True), (1.0, False))
    samples *= np.where(np.arange(len(samples)) % 2, 1.0, -1.0)     # a constant is an offset, and is taken away
    pipeline = make(resume_time=6.0, voice_timeout=6.0)      # the pause that was not is no reason for another one
    stream, extractor, size = SoundStream(SoundFormat()), AudioFeatureExtractor(), int(chunk * RATE)
    seen, frames = [], []
    for first in range(0, len(samples) - size + 1, size):
        end = START + (first + size) / RATE
        arrival = START + 2.0 + stall if START + 2.0 < end < START + 2.0 + stall else end
        for block in stream.add((samples[first:first + size] * 32767.0).astype("<i2").tobytes(), arrival):
            seen += pipeline.update(block)
    turn = [one for one in seen if one.turn]
    assert len({one.id for one in turn}) == 1
    for one in turn:
        frames += extractor.process(one.samples, one.stamp)
    stamps = [one.stamp for one in turn]
    assert np.diff(stamps).min() >= 0.0 and np.diff([frame.stamp for frame in frames]).min() >= 0.0
    heard = np.concatenate([one.samples for one in turn])
    assert len(heard) / RATE > 8.0, "no word is lost"
    assert stamps[-1] == pytest.approx(START + 9.2, abs=0.15)


def test_of_late_sound_what_comes_from_elsewhere_is_not_this_voice():
    """By its stamps, which stand close together, nothing was long enough without sound from its direction."""
    loud = np.full(FRAME, 0.3, np.float32)
    array = Script(lambda call, samples: [(1, loud, 0, 0.0)], active=lambda call, key: call < 20)
    pipeline, found = make(array, direction_grace=0.1), []
    for call in range(40):
        stamp = START + min(call, 8) * FRAME / RATE + 1e-4 * max(call - 8, 0)
        found += pipeline.update(SoundBlock(np.zeros((FRAME, 2), np.float32), stamp))
    assert 20 <= sum(seen.speaking for seen in found) <= 24


def test_look_back_into_late_sound_does_not_go_back():
    """Two turns in a burst: the second one began before the end of the first one, by stamps."""
    samples = sound((0.512, True), (0.512, False), (0.512, True))
    pipeline, found = make(hangover_time=0.2), []
    for number, first in enumerate(range(0, len(samples), FRAME)):
        found += pipeline.update(SoundBlock(samples[first:first + FRAME, None], START + 1e-4 * number))
    turn = [seen for seen in found if seen.turn]
    assert sum(seen.onset for seen in turn) == 2 and np.diff([seen.stamp for seen in turn]).min() >= 0.0
    assert len(turn[-16].samples) == 1600 + FRAME
