"""Where another speaker goes on: the frames, times and ids. The network is stood in for by the pitch of a tone."""

import numpy as np
import pytest

from hri_pipeline.core.audio.level import level_dbfs
from hri_pipeline.core.audio.parameters import VoiceActivitySettings
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.audio.speakers import BANDS, HOP, LEVEL_DBFS, WINDOW, mel_power
from hri_pipeline.core.audio.stream import SoundBlock
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.parameters import ParameterTable

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


def turns_of(*pieces, **changes):
    """{id: its observations in turns} of the pieces, with 0.5 s before and 1 s behind."""
    settings = TABLE.resolve(dict({"hangover_time": 0.6, "speaking_hangover": 0.0}, **changes))
    pipeline = VoicePipeline(settings, LoudIsSpeech(), ids=IdGenerator(seed=3), speakers=PitchIsSpeaker())
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


@pytest.mark.parametrize("pieces", [(tone(LOW, 8.0),), (tone(LOW, 2.0), pause(0.4), tone(LOW, 3.0))],
                         ids=["long", "with a pause"])
def test_one_speaker_is_one_turn(pieces):
    assert len(turns_of(*pieces)) == 1


def test_another_speaker_does_not_resume_the_voice():
    assert len(turns_of(tone(LOW, 2.5), tone(HIGH, 2.5), resume_time=60.0)) == 2


def test_a_turn_after_a_pause_is_not_compared_with_the_one_before():
    first, second = turns_of(tone(LOW, 2.5), pause(1.0), tone(HIGH, 2.5)).values()
    assert len(first[-1].samples) and second[0].stamp == pytest.approx(START + 4.0, abs=0.25)


def test_the_bands_tell_frequency_and_power():
    """A tone in the middle of the linear part is in the bands around it (2.5 mel of 66.7 Hz apart), with half of its
    squared amplitude times the window's energy, spread over triangles of the area 1."""
    power = mel_power(tone(500.0, 0.5))
    assert power.shape == ((8000 - WINDOW) // HOP + 1, BANDS) and power.dtype == np.float32
    assert set(np.argsort(power.mean(axis=0))[-2:]) <= {4, 5, 6}
    np.testing.assert_allclose(mel_power(2.0 * tone(500.0, 0.5)), 4.0 * power, rtol=1e-4)
    assert LEVEL_DBFS == -30.0
