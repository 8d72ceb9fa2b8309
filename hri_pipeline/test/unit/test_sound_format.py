"""Bytes into samples, and bytes that are none."""

import numpy as np
import pytest

from hri_pipeline.core.sound.sound_format import (
    SAMPLE_FORMATS,
    SoundError,
    SoundFormat,
    decode,
    encode_s16,
    nearest_rate,
)

WAVE = 0.5 * np.sin(np.linspace(0.0, 20.0, 600, dtype=np.float32))


def as_bytes(samples, name):
    if name == "U8":
        return np.rint(samples * 128.0 + 128.0).clip(0, 255).astype(np.uint8).tobytes()
    if name in ("S16LE", "S16BE"):
        return np.rint(samples * 32768.0).astype("<i2" if name == "S16LE" else ">i2").tobytes()
    if name == "S24LE":
        wide = np.rint(samples.astype(float) * 2 ** 23).astype("<i4")
        return wide.view(np.uint8).reshape(-1, 4)[:, :3].tobytes()
    if name == "S32LE":
        return np.rint(samples.astype(float) * 2 ** 31).astype("<i4").tobytes()
    return samples.astype("<f4").tobytes()


@pytest.mark.parametrize("arguments, words", [
    (dict(channels=0), "0 channels"), (dict(channels=33), "33 channels"), (dict(sample_rate=0), "0 samples a second"),
    (dict(sample_rate=10 ** 6), "1000000 samples"), (dict(sample_format="ULAW"), "'ULAW'"),
    (dict(coding_format="mp3"), "_format:=wave"), (dict(sample_format="S8"), "'S8'"),
])
def test_formats_that_cannot_be_are_named(arguments, words):
    with pytest.raises(SoundError, match=words):
        SoundFormat(**arguments)


@pytest.mark.parametrize("name", SAMPLE_FORMATS)
def test_every_format_gives_the_same_sound(name):
    sound = decode(as_bytes(WAVE, name), SoundFormat(3, 16000, name))
    assert sound.shape == (200, 3) and sound.dtype == np.float32
    np.testing.assert_allclose(sound.ravel(), WAVE, atol=0.5 / 128.0 + 1e-6 if name == "U8" else 1.0 / 32768.0)


def test_names_of_alsa_and_an_empty_name():
    assert SoundFormat(sample_format="s24_3le").sample_format == "S24LE"
    assert SoundFormat(sample_format="", coding_format="WAVE").sample_format == "S16LE"


def test_bytes_that_are_no_whole_samples_are_refused():
    with pytest.raises(SoundError, match="1023 bytes are no whole number .* 2 channel"):
        decode(bytes(1023), SoundFormat(2))
    assert decode(b"", SoundFormat()).shape == (0, 1)


def mp3_frame(size=417):
    # MPEG 1 layer III, 128 kbit/s, 44.1 kHz: 144 * 128000 / 44100 = 417 bytes.
    return b"\xff\xfb\x90\x64" + np.random.default_rng(1).integers(0, 255, size - 4, dtype=np.uint8).tobytes()


@pytest.mark.parametrize("data, name", [
    (mp3_frame(), "mp3"), (mp3_frame() + mp3_frame() + b"\x01", "mp3"), (b"ID3\x04" + bytes(100), "mp3"),
    (b"RIFF" + bytes(40), "WAV"), (b"OggS" + bytes(40), "Ogg"), (b"fLaC" + bytes(40), "FLAC"),
])
def test_bytes_of_files_are_recognised(data, name):
    with pytest.raises(SoundError, match="the bytes are .*{}.*_format:=wave".format(name)):
        decode(data, SoundFormat())


def test_sound_is_not_taken_for_mp3():
    random = np.random.default_rng(2)
    for _ in range(200):
        noise = random.integers(0, 256, 640, dtype=np.uint8).tobytes()
        decode(b"\xff\xfb\x90\x64" + noise, SoundFormat())     # begins like a frame, and no other follows


def test_wild_floats_are_refused():
    with pytest.raises(SoundError, match="F32LE"):
        decode(np.full(4, np.nan, "<f4").tobytes(), SoundFormat(sample_format="F32LE"))
    with pytest.raises(SoundError, match="F32LE"):
        decode(np.full(4, 1e9, "<f4").tobytes(), SoundFormat(sample_format="F32LE"))


def test_out_goes_what_came_in_and_loud_sound_is_clipped():
    data = as_bytes(WAVE, "S16LE")
    assert encode_s16(decode(data, SoundFormat())) == data
    assert np.frombuffer(encode_s16(np.array([2.0, -2.0, np.nan])), "<i2").tolist() == [32767, -32768, 0]


def test_the_usual_rate_nearby():
    assert nearest_rate(44050.0) == (44100, True)
    assert nearest_rate(13000.0)[1] is False
