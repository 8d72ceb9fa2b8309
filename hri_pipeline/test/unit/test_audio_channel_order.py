"""Channels of an array that are not in the order of its positions, on plane waves without a room."""

import sys
from pathlib import Path

import numpy as np
import pytest

from hri_pipeline.core.audio.array import SPEED_OF_SOUND, MicrophoneArray
from hri_pipeline.core.audio.channel_order import ChannelOrder, order_problem
from hri_pipeline.core.audio.separation import SoundSeparator
from hri_pipeline.core.audio.spectra import BINS, FrameSplitter, NoiseSpectrum, mean_power

sys.path.insert(0, str(Path(__file__).resolve().parent))
from plane_waves import RATE, SQUARE, babble, noise, plane_wave, towards  # noqa: E402

LINE = np.array([[0.0, y, 0.0] for y in (0.113, -0.036, -0.076, -0.113)])
HEXAGON = np.array([[0.046 * np.cos(angle), 0.046 * np.sin(angle), 0.0] for angle in np.arange(6) * np.pi / 3.0])
PAIR = LINE[:2]


def talk(positions, azimuths=(20.0, -50.0, 75.0), seconds=5.0):
    """What an array (C, 3) hears of somebody in directions (degrees), one after the other: (n, C)."""
    sound = np.concatenate([plane_wave(babble(seconds, seed), positions, towards(azimuth, 15.0))
                            for seed, azimuth in enumerate(azimuths)])
    return sound + noise(len(sound), len(positions))


def hear(order, sound):
    noise_power, frames = NoiseSpectrum(BINS, sound.shape[1]), FrameSplitter(sound.shape[1])
    for spectrum in frames.split(sound.astype(np.float32)):
        order.add(spectrum, noise_power.update(mean_power(spectrum)))
    return order.found


def distances(positions):
    return np.linalg.norm(positions[:, None] - positions[None], axis=2)


@pytest.mark.parametrize("positions", [SQUARE, LINE, HEXAGON, PAIR], ids=["square", "line", "hexagon", "pair"])
def test_channels_in_their_order_are_right(positions):
    assert hear(ChannelOrder(MicrophoneArray(positions)), talk(positions)) == ()


@pytest.mark.parametrize("positions, channels", [
    (SQUARE, [1, 0, 2, 3]), (SQUARE, [0, 3, 1, 2]), (LINE, [0, 2, 1, 3]), (LINE, [2, 0, 3, 1]),
    (HEXAGON, [0, 2, 1, 3, 4, 5])])
def test_an_order_that_fits_is_told_where_the_channels_do_not(positions, channels):
    order = hear(ChannelOrder(MicrophoneArray(positions)), talk(positions)[:, channels])
    heard_at = positions[np.array(channels)[list(order)]]
    np.testing.assert_allclose(distances(heard_at), distances(positions), atol=1e-9,
                               err_msg="right, or the array turned or mirrored")


@pytest.mark.parametrize("channels", [[1, 2, 3, 0], [0, 3, 2, 1]], ids=["turned", "mirrored"])
def test_an_array_that_is_turned_or_mirrored_cannot_be_told(channels):
    assert hear(ChannelOrder(MicrophoneArray(SQUARE)), talk(SQUARE)[:, channels]) == ()


def test_the_order_of_channels_of_the_wrong_sign_is_right():
    """What is wrong with them is told where sound comes in."""
    assert hear(ChannelOrder(MicrophoneArray(SQUARE)), talk(SQUARE) * [1, -1, 1, 1]) == ()


@pytest.mark.parametrize("echoes, is_told", [(0.3, True), (1.5, False)])
def test_among_many_echoes_no_order_is_told(echoes, is_told):
    sound = talk(SQUARE)[:, [1, 0, 2, 3]]
    level = np.sqrt(np.convolve(np.mean(sound ** 2, axis=1), np.full(800, 1.0 / 800), "same"))[:, None]
    assert bool(hear(ChannelOrder(MicrophoneArray(SQUARE)), sound + level * noise(len(sound), 4, echoes))) == is_told


@pytest.mark.parametrize("positions, place", [(LINE, [0.0, 0.0, -0.12]), (LINE, [0.15, 0.0, 0.0]),
                                              (HEXAGON[::2], [0.0, 0.0, -0.08])], ids=["below", "before", "axis"])
def test_of_who_is_nearer_than_the_array_is_wide_no_order_is_told(positions, place):
    """As of a robot's own loudspeaker: other orders fit plane waves better by 1.1 to 1.6."""
    sound = babble(8.0, 3)
    ways = np.linalg.norm(positions - place, axis=1)
    turns = np.exp(-2j * np.pi * np.fft.rfftfreq(len(sound), 1.0 / RATE)[:, None] * ways / SPEED_OF_SOUND)
    heard = np.fft.irfft(np.fft.rfft(sound)[:, None] * turns, len(sound), axis=0)
    assert hear(ChannelOrder(MicrophoneArray(positions)), heard + noise(len(heard), len(positions))) == ()


def test_what_was_told_of_a_wrong_beginning_is_taken_back():
    order, sound = ChannelOrder(MicrophoneArray(SQUARE)), talk(SQUARE)
    assert hear(order, sound[:, [1, 0, 2, 3]])
    assert hear(order, sound) == ()


def test_a_gap_in_the_sound_mends_no_wires():
    separator, sound = SoundSeparator(SQUARE), talk(SQUARE)[:, [1, 0, 2, 3]]
    for first in range(0, len(sound), 1600):
        separator.process(sound[first:first + 1600])
    assert separator.fitting_order
    separator.reset()
    assert separator.fitting_order


@pytest.mark.parametrize("channels, working, order, told", [
    ([0, 1, 2, 3], [0, 1, 2, 3], (0, 2, 1, 3), "[0, 1, 2, 3], and better with [0, 2, 1, 3]"),
    ([1, 2, 3, 4], [0, 1, 2, 3], (3, 0, 1, 2), "[1, 2, 3, 4], and better with [4, 1, 2, 3]"),
    ([5, 4, 3, 2, 1], [0, 1, 3, 4], (1, 0, 2, 3), "[5, 4, 3, 2, 1], and better with [4, 5, 3, 2, 1]")])
def test_the_mend_names_channels_of_the_sound(channels, working, order, told):
    problem = order_problem(order, channels, working)
    assert "~microphone_channels: " + told in problem and "directions are wrong" in problem
