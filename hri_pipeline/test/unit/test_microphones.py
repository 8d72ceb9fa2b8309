"""The presets config/microphones/*.yaml: sound in the channels of each device is found where it comes from."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from hri_pipeline.core.audio.array import SPEED_OF_SOUND, MicrophoneArray, parse_positions
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.separation import SoundSeparator
from hri_pipeline.core.audio.stream import SoundFormat, SoundStream, encode_s16

PRESETS = sorted((Path(__file__).parents[2] / "config" / "microphones").glob("*.yaml"))
OTHERS = {"respeaker_v2": (0, 5), "respeaker_core": (6, 7)}
"""Channels that are no microphones."""


def load(path):
    return VOICES.resolve(yaml.safe_load(path.read_text(encoding="utf-8")))


def played(settings, others, azimuth, seconds=1.5):
    """What the device sends, (N, C), of syllables of noise from far away at `azimuth` (rad); its other channels carry
    the same sound without any delay."""
    rate, random = settings.sample_rate, np.random.default_rng(7)
    count = int(seconds * rate)
    times = np.arange(count) / rate
    sound = random.normal(size=count) * (np.sin(2.0 * np.pi * 4.0 * times) > 0.0) * 0.05
    towards = np.array([math.cos(azimuth), math.sin(azimuth), 0.0])
    spectrum, frequencies = np.fft.rfft(sound), np.fft.rfftfreq(count, 1.0 / rate)
    sent = random.normal(0.0, 1e-4, (count, settings.channels))
    for channel, place in zip(settings.microphone_channels, parse_positions(settings.microphone_positions)):
        sent[:, channel] += np.fft.irfft(spectrum * np.exp(2j * np.pi * frequencies * (place @ towards)
                                                           / SPEED_OF_SOUND), count)
    for channel in others:
        sent[:, channel] += sound
    return sent


def test_the_presets_are_those_of_the_launch_files():
    assert [path.stem for path in PRESETS] == ["azure_kinect", "pepper", "respeaker_core", "respeaker_v2"]
    launch = (PRESETS[0].parents[2] / "launch" / "voices.launch").read_text(encoding="utf-8")
    assert all(path.stem in launch for path in PRESETS)


@pytest.mark.parametrize("path", PRESETS, ids=lambda path: path.stem)
def test_a_sound_in_the_channels_of_a_device_has_its_direction(path):
    settings = load(path)
    used = sorted(list(settings.microphone_channels) + list(OTHERS.get(path.stem, ())))
    assert used == list(range(settings.channels)), "every channel is a microphone or is known"
    assert MicrophoneArray(parse_positions(settings.microphone_positions)).shape == "plane"
    for degrees in (-160.0, -65.0, 10.0, 97.0):
        azimuth = math.radians(degrees)
        stream = SoundStream(SoundFormat(settings.channels, settings.sample_rate),
                             channels=settings.microphone_channels, is_array=True)
        separator = SoundSeparator(parse_positions(settings.microphone_positions), settings)
        found = []
        for block in stream.add(encode_s16(played(settings, OTHERS.get(path.stem, ()), azimuth)), 100.0):
            found += [signal.direction for signal in separator.process(block.samples) if signal.active]
        errors = [math.degrees(math.acos(min(1.0, one @ [math.cos(azimuth), math.sin(azimuth), 0.0]))) for one in found]
        assert len(errors) > 20 and np.percentile(errors, 90) <= 3.0, (degrees, np.percentile(errors, 90))


def test_without_the_channel_map_the_direction_is_wrong():
    """The test above can fail: the first four channels of a ReSpeaker v2 are not its microphones."""
    settings = load(next(path for path in PRESETS if path.stem == "respeaker_v2"))
    sound = played(settings, OTHERS["respeaker_v2"], math.radians(97.0))[:, :4]
    separator = SoundSeparator(parse_positions(settings.microphone_positions), settings)
    found = [signal.direction for signal in separator.process(sound.astype(np.float32)) if signal.active]
    errors = [math.degrees(math.acos(min(1.0, one @ [math.cos(1.69), math.sin(1.69), 0.0]))) for one in found]
    assert not errors or np.median(errors) > 10.0
