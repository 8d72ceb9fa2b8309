"""Directions of plane waves with exact delays, alone, together, and when there is nothing."""

import sys
from pathlib import Path

import numpy as np
import pytest

from hri_pipeline.core.sound.microphone_array import MicrophoneArray
from hri_pipeline.core.sound.noise_floor import NoiseFloor
from hri_pipeline.core.sound.sound_direction import MIN_SEPARATION, DirectionFinder
from hri_pipeline.core.sound.sound_spectra import BINS, FRAME, HOP, FrameSplitter, OverlapAdd

sys.path.insert(0, str(Path(__file__).resolve().parent))
from plane_waves import SQUARE, angle, babble, noise, plane_wave, towards  # noqa: E402

WALL = np.array([[0.0, y, z] for y in (-0.06, 0.06) for z in (-0.06, 0.06)])
PYRAMID = np.vstack([SQUARE, [[0.0, 0.0, 0.06]]])


def peaks(sound, positions, most=4):
    """Peaks at the end of a sound (n, C)."""
    array = MicrophoneArray(positions)
    finder, floor = DirectionFinder(array, most), NoiseFloor(BINS, array.channels)
    for spectrum in FrameSplitter(array.channels).split(sound.astype(np.float32)):
        finder.add(spectrum, floor.update(np.mean(np.abs(spectrum) ** 2, axis=0)))
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


def test_a_high_voice_is_found_by_a_level_array_at_its_azimuth():
    found = peaks(heard(towards(60.0, 35.0), SQUARE), SQUARE)
    assert angle(found[0].direction, towards(60.0)) < 1.5


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
    floor = NoiseFloor(BINS, channels)
    found = [(floor.update(np.mean(np.abs(spectrum) ** 2, axis=0)), floor.power)
             for spectrum in FrameSplitter(channels).split(noise(16000 * 8, channels, 0.01).astype(np.float32))]
    power = np.mean([power for _, power in found[250:]])
    # The squared window adds up to half of its length.
    assert 10.0 * np.log10(power / (0.01 ** 2 * FRAME / 2)) == pytest.approx(0.0, abs=0.7)
    assert np.mean([sure.mean() for sure, _ in found[250:]]) < 0.02


def test_a_hiss_is_sure_of_no_direction_and_a_voice_of_its_own_only():
    """A consonant without low frequencies also seems to come from where its waves fit between the microphones once more."""
    square = SQUARE * 0.0325 / 0.04
    random = np.random.RandomState(3)
    spectrum = np.fft.rfft(random.standard_normal(9600))
    frequencies = np.fft.rfftfreq(9600, 1.0 / 16000)
    spectrum[(frequencies < 4300) | (frequencies > 6000)] = 0.0
    hiss = 0.3 * np.fft.irfft(spectrum, 9600)
    hiss[:4800] = 0.0
    found = peaks(plane_wave(hiss, square, towards(31.0)) + noise(9600, 4), square)
    assert len(found) >= 2 and any(angle(peak.direction, towards(-31.0)) < 8.0 for peak in found)
    assert not any(peak.sure for peak in found)
    voice = peaks(heard(towards(31.0), square), square)
    assert [peak for peak in voice if peak.sure] == [voice[0]] and angle(voice[0].direction, towards(31.0)) < 2.0
