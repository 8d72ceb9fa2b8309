"""Bytes into samples; stamps, gaps and levels of a stream of sound that arrives with jitter, drift and losses."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hri_pipeline.core.audio.stream import (
    BLOCK,
    RATE,
    SAMPLE_FORMATS,
    SampleClock,
    SoundError,
    SoundFormat,
    SoundStream,
    decode,
    encode_s16,
    nearest_rate,
)


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
    (dict(sample_format="ULAW"), "'ULAW'"), (dict(coding_format="mp3"), "_format:=wave"),
    (dict(sample_format="S8"), "'S8'")])
def test_formats_that_cannot_be_are_named(arguments, words):
    with pytest.raises(SoundError, match=words):
        SoundFormat(**arguments)


@given(st.integers(-2, 40), st.sampled_from([0, 3999, 4000, 384000, 384001]) | st.integers(0, 10 ** 6))
def test_1_to_32_channels_and_4_to_384_khz_are_read(channels, rate):
    wrong = [words for words, right in (("{} channels".format(channels), 1 <= channels <= 32),
                                        ("{} samples a second".format(rate), 4000 <= rate <= 384000)) if not right]
    if wrong:
        with pytest.raises(SoundError, match=wrong[0]):
            SoundFormat(channels, rate)
    else:
        assert SoundFormat(channels, rate).text.startswith("{} Hz, {} channel".format(rate, channels))


@given(st.sampled_from(SAMPLE_FORMATS), st.integers(1, 8),
       st.lists(st.floats(-1.0, 1.0, width=32, exclude_max=True), min_size=8, max_size=64))
def test_every_format_gives_the_same_sound(name, channels, samples):
    wave = np.clip(samples, -1.0, 0.999).astype(np.float32)[:len(samples) // channels * channels]
    data = as_bytes(wave, name)
    sound = decode(data, SoundFormat(channels, 16000, name))
    assert sound.shape == (len(wave) // channels, channels) and sound.dtype == np.float32
    np.testing.assert_allclose(sound.ravel(), wave, atol=1.0 / 128.0 if name == "U8" else 1.0 / 32768.0)
    if name == "S16LE":
        assert encode_s16(sound) == data


@given(st.binary(max_size=200), st.sampled_from(SAMPLE_FORMATS), st.integers(1, 4))
def test_any_bytes_are_sound_or_are_refused(data, name, channels):
    form = SoundFormat(channels, 16000, name)
    try:
        sound = decode(data, form)
    except SoundError as error:
        assert len(data) % form.frame_bytes or name == "F32LE" or "the bytes are" in str(error)
    else:
        assert sound.shape == (len(data) // form.frame_bytes, channels) and np.abs(sound).max(initial=0.0) <= 16.0


def test_other_names_of_a_format_are_the_same_format():
    assert SoundFormat(sample_format="s24_3le") == SoundFormat(sample_format="S24LE")
    assert SoundFormat(sample_format="", coding_format="WAV") == SoundFormat(coding_format="raw") == SoundFormat()


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


@pytest.mark.parametrize("head, size", [
    (b"\xff\xfb\x90\x64", 417), (b"\xff\xfb\x92\x64", 418),      # 128 kbit/s of 44.1 kHz, without and with padding
    (b"\xff\xfb\xe8\x64", 1440),                                  # 320 of 32 kHz
    (b"\xff\xf3\x80\x64", 208), (b"\xff\xe3\x14\x64", 48),       # MPEG 2: 64 of 22.05 kHz; MPEG 2.5: 8 of 12 kHz
])
def test_one_frame_of_mp3_is_as_long_as_its_header_says(head, size):
    form = SoundFormat(sample_format="U8")
    with pytest.raises(SoundError, match="the bytes are mp3"):
        decode(head + bytes(size - 4), form)
    assert len(decode(head + bytes(size - 3), form)) == size + 1


@pytest.mark.parametrize("head", [b"\xff\xeb\x90\x64", b"\xff\xfb\x9c\x64", b"\xff\xfb\x00\x64", b"\xff\xfb\xf0\x64"],
                         ids=["version", "rate", "no bitrate", "bitrate"])
def test_sound_that_begins_as_a_frame_of_what_there_is_not_is_read(head):
    assert decode(head + bytes(636), SoundFormat()).shape == (320, 1)


def test_sound_is_not_taken_for_mp3():
    random = np.random.default_rng(2)
    for _ in range(200):
        noise = random.integers(0, 256, 640, dtype=np.uint8).tobytes()
        # It begins like a frame, and no other follows.
        assert decode(b"\xff\xfb\x90\x64" + noise, SoundFormat()).shape == (322, 1)


def test_wild_floats_are_refused():
    with pytest.raises(SoundError, match="F32LE"):
        decode(np.full(4, np.nan, "<f4").tobytes(), SoundFormat(sample_format="F32LE"))
    with pytest.raises(SoundError, match="F32LE"):
        decode(np.full(4, 1e9, "<f4").tobytes(), SoundFormat(sample_format="F32LE"))


def test_loud_sound_is_clipped():
    assert np.frombuffer(encode_s16(np.array([2.0, -2.0, np.nan, np.inf, 0.5, -1.0])), "<i2").tolist() == [
        32767, -32768, 0, 0, 16384, -32768]


def test_the_usual_rate_nearby():
    assert nearest_rate(44050.0) == (44100, True)
    assert nearest_rate(13000.0)[1] is False


BEGIN = 1000.0


def tone(seconds, rate=RATE, channels=1, amplitude=0.3, frequency=440.0):
    times = np.arange(int(seconds * rate)) / rate
    return np.repeat((amplitude * np.sin(2 * np.pi * frequency * times))[:, None], channels, axis=1)


def deliver(stream, samples, rate=RATE, chunk=0.02, delays=None, begin=BEGIN, drift=0.0, dropped=()):
    """Feed sound that begins at `begin`; returns the blocks. delays: s, of each chunk. dropped: numbers of lost
    chunks."""
    size, blocks, arrival = int(chunk * rate), [], 0.0
    for number in range(len(samples) // size):
        if number in dropped:
            continue
        end = begin + (number + 1) * size / rate * (1.0 + drift)
        arrival = max(arrival, end + (delays[number] if delays is not None else 0.001))
        blocks += stream.add(encode_s16(samples[number * size:(number + 1) * size]), arrival)
    return blocks


@pytest.mark.parametrize("tolerance", [0.0, -1.0])
def test_illegal_tolerances(tolerance):
    with pytest.raises(ValueError, match="gap tolerance"):
        SampleClock(tolerance)


@pytest.mark.parametrize("rate", [8000, 16000, 44100, 48000])
@pytest.mark.parametrize("channels", [1, 2, 4])
def test_sound_of_every_rate_keeps_its_place_in_time(rate, channels):
    click = np.zeros((rate * 2, channels))
    click[rate:rate + 2] = 0.9                 # 1 s after the begin
    stream = SoundStream(SoundFormat(channels, rate))
    blocks = deliver(stream, click, rate)
    assert all(1 <= len(block.samples) <= BLOCK and block.samples.shape[1] == channels for block in blocks)
    assert all(block.samples.dtype == np.float32 for block in blocks)
    sound = np.concatenate([block.samples[:, -1] for block in blocks])
    times = np.concatenate([block.stamp + np.arange(len(block.samples)) / RATE for block in blocks])
    assert times[np.argmax(np.abs(sound))] == pytest.approx(BEGIN + 1.0, abs=0.002)
    assert len(sound) > 1.8 * RATE and not stream.gaps


def test_blocks_are_handed_on_as_they_come():
    stream = SoundStream(SoundFormat())
    assert [len(block.samples) for block in stream.add(encode_s16(tone(0.01)), BEGIN)] == [160]
    assert [len(block.samples) for block in stream.add(encode_s16(tone(0.08)), BEGIN + 0.08)] == [512, 512, 256]


def test_jitter_does_not_shake_the_stamps():
    random = np.random.default_rng(0)
    delays = 0.002 + random.exponential(0.01, 3000)
    stream = SoundStream(SoundFormat())
    blocks = deliver(stream, tone(60.0), delays=delays)
    assert not stream.gaps
    settled = [block for block in blocks if block.stamp > BEGIN + 5.0]
    errors = np.array([block.stamp for block in settled]) - (
        BEGIN + 0.02 * (np.arange(len(blocks))[-len(settled):]))
    assert 0.0 < errors.mean() < 0.006 and errors.std() < 0.001
    steps = np.diff([block.stamp for block in blocks])
    assert np.all(np.abs(steps - 0.02) < 0.003), "stamps run on evenly, also at the begin"


@pytest.mark.parametrize("drift", [2e-4, -2e-4])
def test_the_stamps_follow_a_clock_that_drifts(drift):
    random = np.random.default_rng(1)
    stream = SoundStream(SoundFormat())
    blocks = deliver(stream, tone(100.0), chunk=0.032, delays=0.002 + random.exponential(0.005, 10000), drift=drift)
    truth = BEGIN + 0.032 * np.arange(len(blocks)) * (1.0 + drift)
    errors = np.array([block.stamp for block in blocks]) - truth
    assert np.abs(errors[300:]).max() < 0.008
    assert not stream.gaps and not stream.problem()


def test_lost_sound_is_a_gap_of_its_length():
    stream = SoundStream(SoundFormat())
    blocks = deliver(stream, tone(6.0), dropped=range(100, 125))
    gaps = [block for block in blocks if block.gap]
    assert stream.gaps == 1 and len(gaps) == 1
    assert gaps[0].gap == pytest.approx(0.5, abs=0.01) and stream.lost == pytest.approx(0.5, abs=0.01)
    assert blocks[-1].stamp == pytest.approx(BEGIN + 6.0 - 0.02, abs=0.005)
    # Found within 0.3 s after the sound goes on.
    assert gaps[0].stamp < BEGIN + 2.5 + 0.3


def test_a_late_delivery_is_no_gap():
    delays = np.full(500, 0.001)
    delays[200:210] = 0.2 - 0.02 * np.arange(10)      # a stall of 0.2 s, then all of it at once
    stream = SoundStream(SoundFormat())
    blocks = deliver(stream, tone(10.0), delays=delays)
    assert not stream.gaps
    assert np.abs(np.diff([block.stamp for block in blocks]) - 0.02).max() < 0.003


def test_a_pause_of_the_sender_is_a_gap_at_once():
    stream = SoundStream(SoundFormat(1, 48000))
    before = deliver(stream, tone(2.0, 48000), 48000)
    after = deliver(stream, tone(2.0, 48000), 48000, begin=BEGIN + 30.0)
    gaps = [block for block in after if block.gap]
    assert len(gaps) == 1 and gaps[0].gap == pytest.approx(28.0, abs=0.05)
    assert gaps[0].stamp == pytest.approx(BEGIN + 30.0, abs=0.005)
    # What the resampler held of the sound before belongs there.
    tail = after[:after.index(gaps[0])]
    assert tail and tail[-1].stamp < BEGIN + 2.01
    assert sum(len(block.samples) for block in before + tail) == 2 * RATE


def test_an_overrun_is_told_with_the_next_block():
    stream = SoundStream(SoundFormat())
    chunk = encode_s16(tone(0.02))
    first = stream.add(chunk, BEGIN + 0.02)[0]
    stream.skip(0.4)
    block = stream.add(chunk, BEGIN + 0.44)[0]
    assert block.gap == pytest.approx(0.4) and block.stamp - first.stamp == pytest.approx(0.42, abs=0.001)
    assert stream.add(chunk, BEGIN + 0.46)[0].gap == 0.0


def test_a_stall_taken_for_a_gap_is_put_right():
    delays = np.full(500, 0.001)
    delays[100:160] = 1.2 - 0.02 * np.arange(60)
    stream = SoundStream(SoundFormat())
    blocks = deliver(stream, tone(10.0), delays=delays)
    assert stream.values()["clock_set_back"] >= 1
    assert blocks[-1].stamp == pytest.approx(BEGIN + 9.98, abs=0.01)


@pytest.mark.parametrize("chunk", [0.01, 0.02, 0.1])
@pytest.mark.parametrize("rate", [16000, 48000])
@pytest.mark.parametrize("stall", [0.5, 1.2, 5.0])
def test_stamps_never_go_back_and_are_right_soon_after_a_burst_of_late_sound(rate, chunk, stall):
    """The first message of a burst looks as if the sound before it were missing; the others are that sound."""
    delays = np.full(int(10.0 / chunk), 0.001)
    late = int(round(stall / chunk))
    delays[int(2.0 / chunk):int(2.0 / chunk) + late] = stall - chunk * np.arange(late)
    stream = SoundStream(SoundFormat(1, rate))
    blocks = deliver(stream, tone(10.0, rate), rate, chunk, delays)
    stamps = np.array([block.stamp for block in blocks])
    assert np.diff(stamps).min() > 0.0
    assert blocks[-1].stamp + len(blocks[-1].samples) / RATE == pytest.approx(BEGIN + 10.0, abs=0.05)
    settled = [block for block in blocks if block.stamp > BEGIN + 2.2 + stall]
    assert np.abs(np.diff([block.stamp for block in settled]) - [
        len(block.samples) / RATE for block in settled[:-1]]).max() < 0.02


@pytest.mark.parametrize("real, said, words", [
    (44100, 16000, "set ~sample_rate .* to 44100"), (16000, 44100, "set ~sample_rate .* to 16000"),
    (48000, 44100, ""), (13000, 8000, "right, or is sound lost"),
])
def test_a_wrong_rate_is_named(real, said, words):
    stream = SoundStream(SoundFormat(1, said))
    deliver(stream, tone(6.0, real), real)
    if words:
        assert stream.problem().startswith("{} samples a second come".format(real))
        assert re.search(words, stream.problem())
    else:
        # 9 % too fast is within what a late sender may show; the measured rate tells it.
        assert stream.problem() == ""
    assert stream.values()["measured_rate_hz"] == pytest.approx(real, rel=0.02)


@pytest.mark.parametrize("said, real, words", [
    ((1, 16000), (2, 16000), ["32000", "2 channels of 16000"]), ((1, 16000), (6, 16000), ["6 channels of 16000"]),
    ((1, 16000), (2, 44100), ["2 channels of 44100"]), ((1, 44100), (2, 44100), ["2 channels of 44100"]),
    ((2, 16000), (1, 16000), ["1 channel of 16000"]), ((6, 16000), (1, 48000), ["1 channel of 48000"]),
    ((1, 16000), (1, 44100), ["44100"]), ((2, 48000), (2, 16000), ["16000"])])
def test_where_the_number_of_channels_may_be_wrong_the_rate_is_not_told_alone(said, real, words):
    stream = SoundStream(SoundFormat(*said))
    deliver(stream, tone(6.0, real[1], real[0]), real[1])
    told = stream.problem()
    assert all(word in told for word in words), told
    assert ("channel" in told.split("instead")[1]) == (said[0] != real[0]), told


def test_the_latency_is_taken_from_the_stamps():
    stream = SoundStream(SoundFormat(), latency=0.1)
    assert stream.add(encode_s16(tone(0.02)), BEGIN + 0.02)[0].stamp == pytest.approx(BEGIN - 0.1)


def test_levels():
    stream = SoundStream(SoundFormat())
    noise = np.random.default_rng(0).normal(0.0, 0.001, (4 * RATE, 1))
    sound = noise + np.where((np.arange(4 * RATE) // RATE % 2 == 1)[:, None], tone(4.0, amplitude=0.5), 0.0)
    deliver(stream, sound)
    values = stream.values()
    assert values["noise_floor_dbfs"] == pytest.approx(-60.0, abs=1.0)
    assert values["level_dbfs"] == pytest.approx(-9.0, abs=0.2)
    assert values["peak_dbfs"] == pytest.approx(-6.0, abs=0.2)
    assert values["clipped_percent"] == 0.0 and stream.problem() == ""


def test_a_stream_that_has_just_begun_tells_no_level_and_no_rate():
    stream = SoundStream(SoundFormat())
    assert stream.problem() == "" and {"level_dbfs", "measured_rate_hz"}.isdisjoint(stream.values())


@pytest.mark.parametrize("sound, words", [
    (np.zeros((3 * RATE, 1)), "dead silence"), (np.full((3 * RATE, 2), 0.3), "dead silence"),
    (tone(3.0, channels=2, amplitude=3.0), "clipped: .* at the limit; turn the microphone's gain down"),
    (0.4 * np.clip(tone(3.0, amplitude=3.0), -1.0, 1.0), "channel 0 of 1 is clipped at 40 %.* gain"),
    (tone(3.0, frequency=1000.0), "^$"), (tone(3.0, frequency=50.0), "^$"),
    (tone(3.0) * [1.0, 0.0], "channel 1 of 2 is dead"), (tone(3.0) + 0.2, "offset of 20 %"),
    (tone(3.0) - 0.5, "offset of 50 %"),
    (tone(1.0) * 0.0, ""),
])
def test_bad_sound_is_named(sound, words):
    stream = SoundStream(SoundFormat(sound.shape[1]))
    deliver(stream, sound)
    assert re.search(words, stream.problem()) if words else stream.problem() == ""


def six_channels():
    """Noise of 3 s that differs in each channel: processed sound, four microphones, silence of the loudspeaker."""
    random = np.random.default_rng(4)
    return random.normal(0.0, 0.05, (3 * RATE, 6)) * [1.0, 1.0, 1.0, 1.0, 1.0, 0.0]


def test_channels_are_selected_in_the_order_of_the_microphones_and_others_do_not_count():
    for form in (SoundFormat(6), SoundFormat(6, 48000)):
        stream = SoundStream(form, channels=[4, 1, 3], is_array=True)
        sound = np.repeat(six_channels(), form.sample_rate // RATE, axis=0)
        found = np.concatenate([block.samples for block in deliver(stream, sound, form.sample_rate)])
        assert found.shape[1] == 3 and stream.problem() == "", form
        if form.sample_rate == RATE:
            np.testing.assert_allclose(found, sound[:len(found), [4, 1, 3]], atol=1e-4)
    assert "channel 5 of 6 is dead" in problem_of(six_channels(), channels=[-1])


def problem_of(sound, **options):
    stream = SoundStream(SoundFormat(sound.shape[1]), **options)
    deliver(stream, sound)
    return stream.problem()


@pytest.mark.parametrize("change, words", [
    (lambda sound: sound * [1, 1, 0.01, 1, 1, 1], "channel 2 of 6 is silent: .*~microphone_channels"),
    (lambda sound: sound[:, [0, 1, 2, 1, 4, 5]] * [1, 1, 1, 0.7, 1, 1], "channels 1, 3 of 6 are copies.*no directions"),
    (lambda sound: sound * [1, 1, 1, 1, 60, 1], r"clipped: .*\(channel 4 of 6\)"),
    (lambda sound: np.clip(sound, [-1, -1, -1, -1, -0.05, -1], [1, 1, 1, 1, 0.05, 1]),
     "channel 4 of 6 is clipped at 5 % of full scale"),
    (lambda sound: sound * [1, 1, 1, 0, 1, 1], "channel 3 of 6 is dead"),
    (lambda sound: sound[:, :2], "names channel 2, and the sound has 2 channels"),
    (lambda sound: 1e-3 * sound * [1, 1, 0.3, 1, 1, 1], "^$")])
def test_a_microphone_of_an_array_that_is_silent_copied_or_clipped_is_named(change, words):
    problem = problem_of(change(six_channels()), channels=[1, 2, 3, 4], is_array=True)
    assert re.search(words, problem), problem


def broken_at_the_end(sound):
    stream = SoundStream(SoundFormat(sound.shape[1]), is_array=True)
    return deliver(stream, sound)[-1].broken


@pytest.mark.parametrize("change, broken, words", [
    (lambda sound, own: sound, (), "^$"), (lambda sound, own: sound * [1, 1, 0, 1], (2,), "channel 2 of 4 is dead"),
    (lambda sound, own: sound * [0, 1, 0.01, 1], (0, 2), "channel 0 of 4 is dead"),
    (lambda sound, own: np.where([False, True, False, False], own, sound), (1,), "channel 1 of 4 is noisy: .*others"),
    (lambda sound, own: np.where([False, True, False, False], 0.3 * own, sound), (), "^$"),
    (lambda sound, own: own, (), "^$"), (lambda sound, own: 0.0 * sound, (), "dead silence"),
    (lambda sound, own: sound * [1, 1, -1, 1], (), "channel 2 of 4 is inverted: directions are wrong")])
def test_microphones_of_an_array_that_hear_nothing_are_told_with_each_block(change, broken, words):
    random = np.random.default_rng(8)
    sound = random.normal(0.0, 0.05, (4 * RATE, 1)) + random.normal(0.0, 0.02, (4 * RATE, 4))
    sound = change(sound, random.normal(0.0, 0.08, (4 * RATE, 4)))
    assert broken_at_the_end(sound) == broken
    assert re.search(words, problem_of(sound, is_array=True))


def test_a_loose_contact_is_broken_until_it_has_held_for_10_s():
    random = np.random.default_rng(9)
    sound = random.normal(0.0, 0.05, (16 * RATE, 1)) + random.normal(0.0, 0.02, (16 * RATE, 4))
    sound[:3 * RATE, 1] = 0.0
    assert broken_at_the_end(sound[:12 * RATE]) == (1,) and broken_at_the_end(sound) == ()


def test_a_knock_on_one_of_two_microphones_breaks_the_other_one_not():
    random = np.random.default_rng(10)
    sound = random.normal(0.0, 2e-3, (6 * RATE, 1)) + random.normal(0.0, 5e-4, (6 * RATE, 2))
    sound[4 * RATE:4 * RATE + RATE // 10, 0] += random.normal(0.0, 0.3, RATE // 10)
    assert broken_at_the_end(sound) == () and problem_of(sound, is_array=True) == ""
    sound[:, 1] *= 0.01
    assert broken_at_the_end(sound) == (1,)


def test_in_silence_of_less_than_a_step_of_16_bits_no_microphone_is_broken():
    """Some change by a step now and then, some do not; in speech all of them hear."""
    random = np.random.default_rng(11)
    sound = np.zeros((8 * RATE, 4))
    sound[::1000, :2] = 1.0 / 32768.0
    sound[5 * RATE:] += random.normal(0.0, 0.05, (3 * RATE, 1)) + random.normal(0.0, 0.01, (3 * RATE, 4))
    stream = SoundStream(SoundFormat(4), is_array=True)
    assert {block.broken for block in deliver(stream, sound)} == {()}


def test_a_dead_microphone_stays_broken_in_silence():
    random = np.random.default_rng(12)
    sound = np.zeros((20 * RATE, 4))
    sound[::1000, :3] = 1.0 / 32768.0
    sound[:3 * RATE, :3] += random.normal(0.0, 0.05, (3 * RATE, 1)) + random.normal(0.0, 0.01, (3 * RATE, 3))
    assert broken_at_the_end(sound) == (3,)


def heard(sound, **options):
    """Return the mean over channels that comes out in the last two of three seconds, and what the stream complains
    of."""
    stream = SoundStream(SoundFormat(sound.shape[1]), **options)
    found = np.concatenate([block.samples for block in deliver(stream, sound)])
    return found.mean(axis=1)[RATE:], stream.problem()


@pytest.mark.parametrize("signs", [(1, -1), (-1, 1, 1), (1, -1, -1, 1)])
def test_channels_that_would_cancel_each_other_are_mixed_in_phase_and_told(signs):
    random = np.random.default_rng(2)
    one = random.normal(0.0, 0.1, (3 * RATE, 1))
    mixed, problem = heard(one * signs + random.normal(0.0, 1e-3, (3 * RATE, len(signs))))
    assert np.abs(np.corrcoef(mixed, one[RATE:RATE + len(mixed), 0])[0, 1]) > 0.99
    assert np.std(mixed) == pytest.approx(0.1, rel=0.02)
    assert re.search(r"channels? [\d, ]+ of {} (is|are) inverted.*wiring".format(len(signs)), problem), problem


def test_a_hum_against_the_phase_turns_no_speech_over():
    random = np.random.default_rng(3)
    hum = 0.3 * np.sin(2.0 * np.pi * 50.0 * np.arange(3 * RATE) / RATE)[:, None]
    speech = random.normal(0.0, 0.1, (3 * RATE, 1))
    mixed, problem = heard(speech + hum * [1, -1])
    np.testing.assert_allclose(mixed, speech[RATE:RATE + len(mixed), 0], atol=1e-3)
    assert problem == ""


def test_a_tone_that_turns_a_channel_over_leaves_the_speech_behind_it_alone():
    """Of a beep of 860 Hz from the side microphones 20 cm apart hear the opposite; of speech something else each."""
    random = np.random.default_rng(4)
    beep = 0.2 * np.sin(2.0 * np.pi * 860.0 * np.arange(2 * RATE) / RATE)[:, None] * [1.0, -1.0]
    speech = random.normal(0.0, 0.1, (2 * RATE, 2)) + 0.001
    sound = np.concatenate([np.zeros((RATE, 2)), beep, np.zeros((RATE, 2)), speech]) + random.normal(
        0.0, 1e-3, (6 * RATE, 2))
    stream = SoundStream(SoundFormat(2))
    deliver(stream, sound[:4 * RATE])
    assert "inverted" in stream.problem(), "the beep"
    deliver(stream, sound[4 * RATE:])
    assert stream.problem() == ""


@pytest.mark.parametrize("channels", [1, 2])
def test_an_offset_is_taken_from_the_sound(channels):
    one = np.random.default_rng(6).normal(0.0, 0.01, (3 * RATE, channels))
    mixed, _ = heard(one + np.linspace(0.1, 0.2, channels))
    assert abs(mixed.mean()) < 1e-3 and np.std(mixed) == pytest.approx(one.mean(axis=1).std(), rel=0.02)


def test_sound_without_an_offset_is_handed_on_as_it_is_and_a_bang_is_no_offset():
    one = np.rint(np.random.default_rng(7).normal(0.0, 1000.0, (3 * RATE, 1))) / 32768.0
    one[RATE:RATE + RATE // 4] += 0.25
    mixed, _ = heard(one)
    np.testing.assert_array_equal(mixed, one[RATE:RATE + len(mixed), 0].astype(np.float32))


def test_a_copied_channel_is_no_problem_where_there_is_no_array():
    assert problem_of(np.repeat(six_channels()[:, :1], 2, axis=1)) == ""


def test_two_microphones_close_to_each_other_are_no_copies():
    random = np.random.default_rng(5)
    hum = np.sin(2.0 * np.pi * 50.0 * (np.arange(3 * RATE)[:, None] / RATE + [0.0, 0.02 / 343.0]))
    assert problem_of(0.1 * hum + random.normal(0.0, 1e-4, hum.shape), is_array=True) == ""


def test_bad_bytes_leave_the_stream_as_it_was():
    stream = SoundStream(SoundFormat())
    chunk = encode_s16(tone(0.02))
    first = stream.add(chunk, BEGIN + 0.02)[0]
    with pytest.raises(SoundError):
        stream.add(b"\x00" * 641, BEGIN + 0.04)
    assert stream.add(b"", BEGIN + 0.04) == []
    second = stream.add(chunk, BEGIN + 0.04)[0]
    assert second.stamp - first.stamp == pytest.approx(0.02, abs=0.001)
