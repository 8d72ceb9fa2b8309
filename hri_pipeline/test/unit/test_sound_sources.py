"""Sound files, directories of them and ALSA devices as one stream."""

import os
import resource
import shutil
import signal
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest
import soundfile

from hri_pipeline.core.sources.parameters import SOUND_SOURCE_PARAMETERS
from hri_pipeline.core.sources.sound_sources import (
    SoundDevice,
    SoundDeviceError,
    SoundSourceError,
    is_live,
    open_sound_source,
    sounds_in,
)

needs_alsa = pytest.mark.skipif(shutil.which("arecord") is None, reason="alsa-utils is not installed")


def settings(source, **changes):
    return SOUND_SOURCE_PARAMETERS.resolve(dict({"source": str(source)}, **changes))


def write(path, seconds=0.5, rate=16000, channels=1, frequency=440.0, **options):
    times = np.arange(int(seconds * rate)) / rate
    samples = np.repeat(0.5 * np.sin(2 * np.pi * frequency * times)[:, None], channels, axis=1)
    soundfile.write(str(path), samples, rate, **options)
    return path


def everything(source, count=160):
    parts = []
    while True:
        part = source.read(count)
        if part is None:
            return np.concatenate(parts)
        assert part.shape == (count, source.channels) and part.dtype == np.float32
        parts.append(part)


def refuse(text):
    raise AssertionError(text)


@pytest.mark.parametrize("name", ["a.wav", "a.flac", "a.ogg", "a.mp3"])
def test_files_of_many_formats(tmp_path, name):
    source = open_sound_source(settings(write(tmp_path / name, 1.0, 48000, 2), loop=False, pause=0.5), refuse)
    assert (source.rate, source.channels) == (48000, 2)
    sound = everything(source)
    assert len(sound) >= 1.5 * 48000 and np.sqrt(np.mean(sound[4800:43200] ** 2)) == pytest.approx(0.354, abs=0.02)
    assert not sound[-20000:].any(), "silence after the file"
    source.close()
    source.close()


def test_raw_files_are_what_the_parameters_say(tmp_path):
    path = tmp_path / "a.raw"
    (np.arange(3200) % 100).astype("<i2").tofile(str(path))
    source = open_sound_source(settings(path, raw_rate=8000, raw_channels=2, loop=False, pause=0.0), refuse)
    assert (source.rate, source.channels) == (8000, 2)
    assert len(everything(source)) == 1600


def test_a_directory_in_reading_order_and_in_one_format(tmp_path):
    write(tmp_path / "s2.wav", 0.5, 48000, 1, 1000.0)
    write(tmp_path / "s10.wav", 0.5, 16000, 2, 2000.0)
    (tmp_path / "s1.wav").write_bytes(b"this is no sound")
    (tmp_path / "notes.txt").write_text("no sound either")
    assert [path.name for path in sounds_in(tmp_path)] == ["s1.wav", "s2.wav", "s10.wav"]
    said = []
    source = open_sound_source(settings(tmp_path, sample_rate=16000, channels=1, loop=False, pause=0.0), said.append)
    sound = everything(source)[:, 0]
    assert len(said) == 1 and "s1.wav" in said[0] and "left out" in said[0]
    assert len(sound) == 16000
    for part, frequency in ((sound[1000:7000], 1000.0), (sound[9000:15000], 2000.0)):
        spectrum = np.abs(np.fft.rfft(part * np.hanning(len(part))))
        assert np.fft.rfftfreq(len(part), 1 / 16000)[np.argmax(spectrum)] == pytest.approx(frequency, abs=4.0)


def test_reading_order_of_any_names(tmp_path):
    names = ["take 2.wav", "take 10.wav", "take 10\u00b2.wav"]
    for name in names:
        (tmp_path / name).touch()
    assert [path.name for path in sounds_in(tmp_path)] == names


def damaged(path):
    """A flac file whose second half cannot be decoded."""
    noise = np.random.default_rng(0).normal(scale=0.1, size=48000)
    soundfile.write(str(path), noise, 16000)
    content = bytearray(path.read_bytes())
    content[len(content) // 2:] = bytes(len(content) - len(content) // 2)
    path.write_bytes(bytes(content))
    return path


def test_a_file_that_is_damaged_further_on_is_left_out_of_a_directory(tmp_path):
    damaged(tmp_path / "s1.flac")
    write(tmp_path / "s2.wav")
    said = []
    source = open_sound_source(settings(tmp_path, pause=0.0), said.append)
    sound = np.concatenate([source.read(1600) for _ in range(60)])
    assert len(said) == 1 and "s1.flac" in said[0] and "left out" in said[0]
    np.testing.assert_array_equal(sound[-8000:], sound[-16000:-8000], "the other one goes on, again and again")


def test_a_damaged_file_alone_is_an_error(tmp_path):
    with pytest.raises(SoundSourceError, match="s1.flac is damaged.*replace it"):
        everything(open_sound_source(settings(damaged(tmp_path / "s1.flac"), loop=False), refuse), 1600)


def test_one_channel_goes_to_all(tmp_path):
    source = open_sound_source(settings(write(tmp_path / "a.wav"), channels=4, loop=False), refuse)
    sound = source.read(160)
    assert sound.shape == (160, 4) and np.array_equal(sound[:, 0], sound[:, 3]) and sound.any()


@pytest.mark.parametrize("count", [100, 160, 1600, 7000])
def test_the_end_is_the_end_wherever_it_falls_in_a_chunk(tmp_path, count):
    source = open_sound_source(settings(write(tmp_path / "a.wav", 0.503), loop=False, pause=0.0), refuse)
    chunks = [source.read(count) for _ in range(-(-8048 // count))]
    assert all(chunk is not None for chunk in chunks)
    assert [source.read(count) for _ in range(3)] == [None] * 3


def test_it_loops(tmp_path):
    source = open_sound_source(settings(write(tmp_path / "a.wav", 0.1), pause=0.1), refuse)
    sound = np.concatenate([source.read(160) for _ in range(40)])[:, 0]
    np.testing.assert_array_equal(sound[:1600], sound[3200:4800])


@pytest.mark.parametrize("make, changes, words", [
    (lambda path: "", {}, "~source is empty"),
    (lambda path: path / "no.wav", {}, "no.wav does not exist; give a sound file"),
    (lambda path: path, {}, "holds no sound file"),
    (lambda path: str(path / "x.wav") if (path / "x.wav").write_bytes(b"no sound") else "", {}, "x.wav.*ffmpeg"),
    (lambda path: write(path / "e.wav", 0.0), {}, "holds no sound; give another"),
    (lambda path: write(path / "s.wav", 2.1 / 48000, 48000), {"sample_rate": 8000}, "holds no sound; give another"),
    (lambda path: write(path / "t.wav", channels=3), {"channels": 2}, "3 channels.*set ~channels to 1 or 3"),
])
def test_what_cannot_be_played_is_named_with_the_mend(tmp_path, make, changes, words):
    with pytest.raises(SoundSourceError, match=words):
        open_sound_source(settings(make(tmp_path), **changes), refuse)


def test_names_of_devices():
    assert [is_live(name) for name in ("alsa", "alsa:hw:1,0", "/alsa", "alsa.wav")] == [True, True, False, False]


@needs_alsa
def test_a_missing_microphone_is_named():
    source = open_sound_source(settings("alsa:no_such_microphone"), refuse)
    with pytest.raises(SoundSourceError, match="no_such_microphone has ended .*arecord -L"):
        source.read(160)
    source.close()
    source.close()


@needs_alsa
def test_a_device_is_read_by_a_program_that_has_many_files_open():
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    if limits[1] < 1200:
        pytest.skip("no more than {} descriptors here".format(limits[1]))
    resource.setrlimit(resource.RLIMIT_NOFILE, (1200, limits[1]))
    files = [os.open(os.devnull, os.O_RDONLY) for _ in range(1050)]     # select() takes none above 1023
    try:
        device = SoundDevice("null", 16000, 2)
        assert device.read(320).shape == (320, 2)
        device.close()
    finally:
        for file in files:
            os.close(file)
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)


@needs_alsa
def test_a_device_is_read_in_its_time_and_its_end_is_told():
    device = SoundDevice("null", 16000, 2)          # ALSA's own device of zeros, which has no clock
    begun = time.monotonic()
    for _ in range(40):
        assert device.read(320).shape == (320, 2)
    assert time.monotonic() - begun > 0.2, "0.8 s of sound, 0.5 s of it ahead of its time at most"
    os.kill(device.pid, signal.SIGKILL)
    with pytest.raises(SoundDeviceError, match="microphone null has ended"):
        for _ in range(10000):
            device.read(320)
    device.close()


@needs_alsa
def test_the_recording_ends_with_its_parent():
    code = textwrap.dedent("""
        import os, signal
        from hri_pipeline.core.sources.sound_sources import SoundDevice
        device = SoundDevice("null", 16000, 1)
        device.read(160)
        print(device.pid, flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
    """)
    said = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, universal_newlines=True,
                          timeout=60).stdout
    path = "/proc/{}/stat".format(int(said))
    deadline = time.monotonic() + 20.0
    while os.path.exists(path) and open(path).read().rsplit(")", 1)[1].split()[0] not in "ZX":
        assert time.monotonic() < deadline, "arecord outlives its parent"
        time.sleep(0.01)
