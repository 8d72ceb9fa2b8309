"""The simulated room: direct sound at its time and level, echoes where mirrors put them, a decay as asked for."""

import numpy as np
import pytest

from benchmarks.room import RATE, Room, images_at, with_noise
from hri_pipeline.core.audio.array import SPEED_OF_SOUND

SIZE = (5.0, 4.0, 3.0)


@pytest.mark.parametrize("size, rt60", [((5.0, 4.0), 0.3), ((0.1, 4.0, 3.0), 0.3), ((5.0, 4.0, 3.0), -0.1),
                                        ((5.0, 4.0, 3.0), 9.0), ((np.nan, 4.0, 3.0), 0.3)])
def test_illegal_rooms(size, rt60):
    with pytest.raises(ValueError):
        Room(size, rt60)


@pytest.mark.parametrize("source, microphone",
                         [((6.0, 1.0, 1.0), (1.0, 1.0, 1.0)), ((1.0, 1.0, 1.0), (1.0, -1.0, 1.0))])
def test_points_outside_are_refused(source, microphone):
    with pytest.raises(ValueError, match="outside"):
        Room(SIZE, 0.3).responses(source, np.array([microphone]))


def test_without_walls_sound_arrives_late_and_weaker_by_its_distance():
    source = np.array([1.0, 1.0, 1.0])
    microphones = np.array([[2.0, 1.0, 1.0], [1.0, 3.5, 1.0]])
    responses = Room(SIZE, 0.0).responses(source, microphones)
    spectra = np.fft.rfft(responses, axis=1)
    frequencies = np.fft.rfftfreq(responses.shape[1], 1.0 / RATE)
    band = (frequencies > 100.0) & (frequencies < 7000.0)
    for spectrum, distance in zip(spectra, (1.0, 2.5)):
        expected = np.exp(-2j * np.pi * frequencies * distance / SPEED_OF_SOUND) / distance
        assert np.abs(spectrum - expected)[band].max() < 0.01 / distance


def test_the_first_echo_comes_from_behind_the_nearest_wall():
    source, microphone = np.array([2.5, 2.0, 0.5]), np.array([[3.5, 2.0, 0.5]])
    room = Room(SIZE, 0.3)
    response = room.responses(source, microphone)[0]
    # The floor mirrors the source at -0.5 m.
    distance = np.hypot(1.0, 1.0)
    place = distance / SPEED_OF_SOUND * RATE
    around = slice(int(place) - 2, int(place) + 4)
    direct = np.abs(response).max()
    assert np.abs(response[around]).max() / direct == pytest.approx(room.reflection / distance, rel=0.25)


@pytest.mark.parametrize("rt60", [0.2, 0.4])
def test_sound_decays_about_as_fast_as_asked(rt60):
    response = Room((5.2, 4.1, 2.8), rt60).responses((1.2, 1.1, 1.4), np.array([[3.6, 2.9, 1.2]]))[0]
    energy = np.cumsum(response[::-1] ** 2)[::-1]
    level = 10.0 * np.log10(energy / energy[0])
    begin, end = np.argmax(level < -5.0), np.argmax(level < -25.0)
    # Eyring's formula is for diffuse sound; in a shoebox the sound along the longest side lasts longer.
    assert 0.75 * rt60 < 3.0 * (end - begin) / RATE < 1.5 * rt60


def test_images_and_noise_have_the_levels_asked_for():
    sound = np.random.RandomState(0).standard_normal(RATE)
    responses = Room(SIZE, 0.0).responses((1.0, 1.0, 1.0), np.array([[2.0, 1.0, 1.0], [1.0, 2.0, 1.0]]))
    image = images_at(responses, sound)
    assert image.shape == (RATE, 2)
    mixed = with_noise([image], 10.0, np.random.RandomState(1))
    ratio = np.mean(image ** 2) / np.mean((mixed - image) ** 2)
    assert 10.0 * np.log10(ratio) == pytest.approx(10.0, abs=0.3)
