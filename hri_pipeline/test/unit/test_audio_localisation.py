"""Directions of plane waves with exact delays, and sources made of peaks: birth, silence, death, overlap, crossing."""

import sys
from pathlib import Path

import numpy as np
import pytest

from hri_pipeline.core.audio.array import MicrophoneArray
from hri_pipeline.core.audio.localisation import MIN_SEPARATION, DirectionFinder, DirectionTracker, Peak
from hri_pipeline.core.audio.spectra import BINS, FRAME, HOP, FrameSplitter, NoiseSpectrum, OverlapAdd

sys.path.insert(0, str(Path(__file__).resolve().parent))
from plane_waves import SQUARE, angle, babble, noise, plane_wave, towards  # noqa: E402

WALL = np.array([[0.0, y, z] for y in (-0.06, 0.06) for z in (-0.06, 0.06)])
STEP = 0.032
PYRAMID = np.vstack([SQUARE, [[0.0, 0.0, 0.06]]])


def peaks(sound, positions, most=4):
    """Peaks at the end of a sound (n, C)."""
    array = MicrophoneArray(positions)
    finder, background = DirectionFinder(array, most), NoiseSpectrum(BINS, array.channels)
    for spectrum in FrameSplitter(array.channels).split(sound.astype(np.float32)):
        finder.add(spectrum, background.update(np.mean(np.abs(spectrum) ** 2, axis=0)))
    return finder.peaks()


def heard(direction, positions, seconds=0.6, seed=0):
    """0.3 s of noise, then babble from a direction."""
    lead = np.zeros(int(0.3 * 16000))
    sound = plane_wave(np.concatenate([lead, babble(seconds, seed, rate=1.0)]), positions, direction)
    return sound + noise(len(sound), len(positions))


@pytest.mark.parametrize("azimuth", [-180.0, -91.3, -47.0, 0.0, 2.5, 33.3, 77.7, 121.0])
def test_a_plane_wave_is_found_within_a_degree(azimuth):
    found = peaks(heard(towards(azimuth), SQUARE, seed=int(azimuth) % 7), SQUARE)
    assert angle(found[0].direction, towards(azimuth)) < 1.0
    assert found[0].strength > 0.3


@pytest.mark.parametrize("azimuth, elevation", [(0.0, 0.0), (-33.0, 12.0), (51.0, -17.0)])
def test_an_upright_array_tells_elevation_as_well(azimuth, elevation):
    found = peaks(heard(towards(azimuth, elevation), WALL), WALL)
    assert angle(found[0].direction, towards(azimuth, elevation)) < 5.0


@pytest.mark.parametrize("azimuth, elevation", [(0.0, 0.0), (170.0, 25.0), (-101.0, -10.0)])
def test_an_array_with_height_tells_elevation_all_around(azimuth, elevation):
    found = peaks(heard(towards(azimuth, elevation), PYRAMID), PYRAMID)
    assert angle(found[0].direction, towards(azimuth, elevation)) < 5.0


def test_two_microphones_tell_the_angle_and_take_it_to_be_in_front():
    pair = np.array([[0.0, 0.05, 0.0], [0.0, -0.05, 0.0]])
    for azimuth in (-50.0, 10.0, 40.0):
        front = peaks(heard(towards(azimuth), pair), pair)[0].direction
        back = peaks(heard(towards(180.0 - azimuth), pair), pair)[0].direction
        assert angle(front, towards(azimuth)) < 2.0
        assert angle(back, towards(azimuth)) < 2.0


def test_voices_at_both_ends_of_two_microphones_are_two():
    pair = np.array([[0.0, 0.06, 0.0], [0.0, -0.06, 0.0]])
    lead = np.zeros(4800)
    sound = sum(level * plane_wave(np.concatenate([lead, babble(0.8, seed)]), pair, towards(azimuth))
                for seed, azimuth, level in ((4, 90.0, 1.0), (5, -90.0, 0.6))) + noise(17600, 2)
    found = peaks(sound, pair)
    assert [angle(peak.direction, towards(azimuth)) < 1.0 for peak, azimuth in zip(found, (90.0, -90.0))] == [True] * 2


@pytest.mark.parametrize("positions", [SQUARE, WALL, PYRAMID])
def test_one_voice_is_one_peak(positions):
    """A small array also responds to where the voice does not come from, by a tenth as much."""
    assert len(peaks(heard(towards(20.0), positions, seed=1), positions)) == 1


def test_a_direction_that_the_array_does_not_tell_has_no_response():
    array = MicrophoneArray(WALL)
    finder = DirectionFinder(array)
    for spectrum in FrameSplitter(4).split(heard(towards(0.0), WALL).astype(np.float32)):
        finder.add(spectrum, np.ones(BINS, np.float32))
    assert finder.height(towards(0.0)) > 0.3 and finder.height(towards(180.0)) == 0.0


def test_a_high_voice_is_found_by_a_level_array_at_its_azimuth():
    found = peaks(heard(towards(60.0, 35.0), SQUARE), SQUARE)
    assert angle(found[0].direction, towards(60.0)) < 1.5


def test_a_voice_that_has_ended_is_heard_nowhere():
    sound = heard(towards(40.0), SQUARE)
    assert peaks(sound, SQUARE)
    assert not peaks(np.concatenate([sound, noise(16000, 4)]), SQUARE)


def test_no_more_peaks_are_told_than_asked_for_and_the_strongest_first():
    lead = np.zeros(4800)
    sound = sum(level * plane_wave(np.concatenate([lead, babble(0.8, seed)]), SQUARE, towards(azimuth))
                for seed, azimuth, level in ((1, 20.0, 0.5), (2, 140.0, 1.0))) + noise(17600, 4)
    two, one = peaks(sound, SQUARE), peaks(sound, SQUARE, 1)
    assert len(two) >= 2 and len(one) == 1 and np.array_equal(one[0].direction, two[0].direction)
    assert [peak.strength for peak in two] == sorted((peak.strength for peak in two), reverse=True)


def test_two_voices_are_two_peaks():
    lead = np.zeros(4800)
    sound = sum(plane_wave(np.concatenate([lead, babble(0.8, seed)]), SQUARE, towards(azimuth))
                for seed, azimuth in ((1, 20.0), (2, 110.0)))
    found = peaks(sound + noise(len(sound), 4), SQUARE)
    assert len(found) >= 2
    nearest = [min(angle(peak.direction, towards(azimuth)) for peak in found) for azimuth in (20.0, 110.0)]
    assert max(nearest) < 4.0
    for index, peak in enumerate(found):
        for other in found[:index]:
            assert angle(peak.direction, other.direction) >= np.degrees(MIN_SEPARATION) - 1e-6
            assert other.strength >= peak.strength


@pytest.mark.parametrize("level", [0.0, 1e-5, 1e-2])
def test_noise_and_silence_have_no_direction(level):
    assert peaks(noise(32000, 4, level), SQUARE) == []


def test_a_clipped_voice_is_still_found():
    sound = np.clip(40.0 * heard(towards(-70.0), SQUARE), -1.0, 1.0)
    assert np.mean(np.abs(sound) == 1.0) > 0.1
    assert angle(peaks(sound, SQUARE)[0].direction, towards(-70.0)) < 3.0


def test_reset_forgets():
    array = MicrophoneArray(SQUARE)
    finder = DirectionFinder(array)
    for spectrum in FrameSplitter(4).split(heard(towards(0.0), SQUARE).astype(np.float32)):
        finder.add(spectrum, np.ones(BINS, np.float32))
    assert finder.peaks() and finder.weight > 0.0
    finder.reset()
    assert finder.peaks() == [] and finder.weight == 0.0


@pytest.mark.parametrize("sizes", [[16000], [1, 255, 256, 257, 4000, 0, 11231], [480] * 33 + [160]])
def test_frames_put_together_are_the_sound_again(sizes):
    assert sum(sizes) == 16000
    sound = np.random.RandomState(1).uniform(-1.0, 1.0, (16000, 2)).astype(np.float32)
    splitter, adders = FrameSplitter(2), (OverlapAdd(), OverlapAdd())
    parts, place = [], 0
    for size in sizes:
        for spectrum in splitter.split(sound[place:place + size]):
            parts.append(np.stack([adder.add(row) for adder, row in zip(adders, spectrum)], axis=1))
        place += size
    result = np.concatenate(parts)
    assert len(result) == ((16000 - FRAME) // HOP + 1) * HOP
    np.testing.assert_allclose(result[HOP:], sound[HOP:len(result)], atol=1e-6)


@pytest.mark.parametrize("channels", [2, 4, 8])
def test_the_noise_floor_is_the_power_of_the_noise(channels):
    background = NoiseSpectrum(BINS, channels)
    found = [(background.update(np.mean(np.abs(spectrum) ** 2, axis=0)), background.power)
             for spectrum in FrameSplitter(channels).split(noise(16000 * 8, channels, 0.01).astype(np.float32))]
    power = np.mean([power for _, power in found[250:]])
    # The squared window adds up to half of its length.
    assert 10.0 * np.log10(power / (0.01 ** 2 * FRAME / 2)) == pytest.approx(0.0, abs=0.7)
    assert np.mean([weights.mean() for weights, _ in found[250:]]) < 0.02


def test_a_hiss_is_sure_of_no_direction_and_a_voice_of_its_own_only():
    """A consonant without low frequencies also seems to come from where its waves fit between the microphones once
    more."""
    square = SQUARE * 0.0325 / 0.04
    random = np.random.RandomState(3)
    spectrum = np.fft.rfft(random.standard_normal(9600))
    frequencies = np.fft.rfftfreq(9600, 1.0 / 16000)
    spectrum[(frequencies < 4300) | (frequencies > 6000)] = 0.0
    hiss = 0.3 * np.fft.irfft(spectrum, 9600)
    hiss[:4800] = 0.0
    found = peaks(plane_wave(hiss, square, towards(31.0)) + noise(9600, 4), square)
    assert len(found) >= 2 and any(angle(peak.direction, towards(-31.0)) < 8.0 for peak in found)
    assert not any(peak.confirmed for peak in found)
    voice = peaks(heard(towards(31.0), square), square)
    assert [peak for peak in voice if peak.confirmed] == [voice[0]] and angle(voice[0].direction, towards(31.0)) < 2.0


def peak(azimuth, strength=0.15):
    a = np.radians(azimuth)
    return Peak(np.array([np.cos(a), np.sin(a), 0.0]), strength)


def azimuth_of(source):
    return float(np.degrees(np.arctan2(source.direction[1], source.direction[0])))


def follow(tracker, moments, start=0.0):
    """Feed lists of peaks STEP apart; returns {key: azimuth} after each."""
    return [{source.key: azimuth_of(source) for source in tracker.update(peaks, start + index * STEP)}
            for index, peaks in enumerate(moments)]


def tracker(birth=0.1, memory=5.0, most=4):
    return DirectionTracker(birth, memory, most)


@pytest.mark.parametrize("arguments", [(-0.1, 1.0, 4), (0.1, 0.0, 4), (0.1, 1.0, 0), (float("nan"), 1.0, 4)])
def test_illegal_constructions(arguments):
    with pytest.raises(ValueError):
        DirectionTracker(*arguments)


@pytest.mark.parametrize("step", [0.01, 0.032, 0.1])
def test_birth_takes_its_time_whatever_the_rate(step):
    sources = tracker(birth=0.3)
    stamps = np.arange(0.0, 1.0, step)
    known = [len(sources.update([peak(30.0)], stamp)) for stamp in stamps]
    born = stamps[known.index(1)]
    assert 0.3 - 1e-9 <= born <= 0.3 + step


def test_one_peak_is_nobody():
    sources = tracker(birth=0.0)
    assert follow(sources, [[peak(10.0, 0.06)]] + [[]] * 50)[-1] == {}


def test_a_still_source_keeps_its_key_and_its_direction_becomes_sure():
    random = np.random.RandomState(0)
    sources = tracker()
    seen = follow(sources, [[peak(random.normal(179.0, 4.0))] for _ in range(500)])
    assert set(seen[-1]) == {1}
    errors = [abs((moment[1] - 179.0 + 180.0) % 360.0 - 180.0) for moment in seen[100:]]
    assert np.mean(errors) < 2.0
    first, last = seen[4:][0], sources.update([peak(179.0)], 500 * STEP)[0]
    assert first and last.sd < np.radians(5.0)


def test_silence_keeps_the_key_until_the_memory_ends():
    sources = tracker(memory=2.0)
    follow(sources, [[peak(40.0)]] * 20)
    quiet = sources.update([], 20 * STEP + 1.0)
    assert [source.active for source in quiet] == [False]
    again = follow(sources, [[peak(43.0)]] * 10, start=2.0)
    assert set(again[-1]) == {1}
    assert sources.update([], 2.0 + 10 * STEP + 2.1) == []
    later = follow(sources, [[peak(43.0)]] * 20, start=6.0)
    assert set(later[-1]) == {2}


def test_two_who_speak_at_once_are_two():
    random = np.random.RandomState(1)
    sources = tracker()
    moments = []
    for _ in range(300):
        both = [peak(random.normal(0.0, 3.0)), peak(random.normal(60.0, 3.0), 0.08)]
        # Now and then only one of them has a peak, and the order says nothing.
        random.shuffle(both)
        moments.append(both[:1 + (random.uniform() < 0.7)])
    seen = follow(sources, moments)
    assert {key for moment in seen for key in moment} == {1, 2}
    assert all(abs(moment[key] - azimuth) < 8.0 for moment in seen[50:]
               for key, azimuth in zip(sorted(moment, key=moment.get), (0.0, 60.0)))


def test_two_who_pass_each_other_keep_their_keys():
    sources = tracker()
    azimuths = [(-60.0 + 30.0 * t, 60.0 - 30.0 * t) for t in np.arange(0.0, 4.0, STEP)]
    moments = []
    for a, b in azimuths:
        # Closer than the array can tell them apart, they are one peak.
        moments.append([peak(a), peak(b)] if abs(a - b) > 25.0 else [peak((a + b) / 2.0)])
    seen = follow(sources, moments)
    early, late = seen[20], seen[-1]
    assert set(early) == set(late) == {1, 2}
    for key in early:
        assert early[key] * late[key] < 0.0


def test_a_peak_between_two_speakers_is_no_third():
    sources = tracker()
    follow(sources, [[peak(0.0), peak(50.0)]] * 30)
    seen = follow(sources, [[peak(25.0, 0.1)]] * 4 + [[peak(0.0), peak(50.0)]] * 30, start=30 * STEP)
    assert set(seen[-1]) == {1, 2}
    assert seen[-1][1] == pytest.approx(0.0, abs=4.0)


def test_when_all_places_are_taken_the_one_silent_longest_goes():
    sources = tracker(most=2)
    follow(sources, [[peak(0.0)]] * 20)
    follow(sources, [[peak(90.0)]] * 40, start=20 * STEP)
    # The third has to wait until somebody was silent for a second.
    seen = follow(sources, [[peak(90.0), peak(-90.0)]] * 20, start=60 * STEP)
    assert set(seen[-1]) == {2, 3}
    full = follow(sources, [[peak(90.0), peak(-90.0), peak(180.0)]] * 60, start=80 * STEP)
    assert all(set(moment) == {2, 3} for moment in full)


def test_reset_forgets_but_gives_no_key_twice():
    sources = tracker()
    follow(sources, [[peak(0.0)]] * 10)
    sources.reset()
    assert set(follow(sources, [[peak(0.0)]] * 10)[-1]) == {2}


def test_time_that_stands_still_does_no_harm():
    sources = tracker(birth=0.0)
    for _ in range(20):
        found = sources.update([peak(12.0)], 5.0)
    assert len(found) == 1 and np.isfinite(found[0].direction).all()


def test_a_direction_that_is_not_sure_is_no_source_until_it_is():
    sources = tracker()
    hiss = [Peak(peak(30.0).direction, 0.15, False), Peak(peak(-31.0).direction, 0.12, False)]
    assert not any(follow(sources, [hiss] * 20))
    known = follow(sources, [[peak(30.0, 0.2)] + hiss[1:]] * 20, start=20 * STEP)
    assert [round(azimuth) for azimuth in known[-1].values()] == [30]
