"""Beamformers and the whole way from an array's sound to its sources, on plane waves without a room."""

import sys
from pathlib import Path

import numpy as np
import pytest

from hri_pipeline.core.audio.array import MicrophoneArray
from hri_pipeline.core.audio.parameters import ArraySettings
from hri_pipeline.core.audio.separation import SoundSeparator, SourceBeamformers, inverse, solve
from hri_pipeline.core.audio.spectra import BINS, HOP, RATE
from hri_pipeline.core.parameters import ParameterError, ParameterTable

sys.path.insert(0, str(Path(__file__).resolve().parent))
from plane_waves import SQUARE, angle, babble, noise, plane_wave, towards  # noqa: E402


def settings(**changes):
    return ParameterTable("array", ArraySettings).resolve(changes)


def one_voice(azimuth=30.0, seconds=1.5, seed=0, lead=0.5, positions=SQUARE):
    """The voice at the first microphone (n,) and what the array hears (n, C)."""
    voice = np.concatenate([np.zeros(int(lead * RATE)), babble(seconds, seed)])
    sound = plane_wave(voice, positions, towards(azimuth))
    return sound[:, 0], sound + noise(len(sound), len(positions))


def separate(sound, sizes=(480,), separator=None):
    """Hand sound (n, C) in; returns the separator and {key: (n,) signal at its place in the sound}."""
    separator = separator or SoundSeparator(SQUARE)
    found, first, turn = {}, 0, 0
    while first < len(sound):
        size = sizes[turn % len(sizes)]
        for signal in separator.process(sound[first:first + size]):
            begin = first + signal.offset
            whole = found.setdefault(signal.key, np.full(len(sound), np.nan))
            part = whole[begin:begin + len(signal.samples)]
            assert np.isnan(part).all(), "samples came twice"
            part[:] = signal.samples
        first, turn = first + size, turn + 1
    return separator, {key: np.nan_to_num(signal) for key, signal in found.items()}


def ratio_db(estimate, reference):
    """Scale-invariant signal-to-distortion ratio."""
    target = estimate @ reference / (reference @ reference) * reference
    return 10.0 * np.log10(np.sum(target ** 2) / np.sum((estimate - target) ** 2))


@pytest.mark.parametrize("channels", [2, 4, 7])
def test_inverses_and_solutions_are_those_of_lapack(channels):
    random = np.random.RandomState(channels)
    roots = random.standard_normal((50, channels, channels)) + 1j * random.standard_normal((50, channels, channels))
    matrices = roots @ roots.conj().transpose(0, 2, 1) + 0.1 * np.eye(channels)
    last = np.moveaxis(matrices, 0, -1)
    np.testing.assert_allclose(np.moveaxis(inverse(last), -1, 0), np.linalg.inv(matrices), rtol=1e-8, atol=1e-8)
    vectors = random.standard_normal((50, channels)) + 1j * random.standard_normal((50, channels))
    np.testing.assert_allclose(solve(last, vectors.T).T, np.linalg.solve(matrices, vectors[:, :, None])[:, :, 0],
                               rtol=1e-8, atol=1e-8)


def test_the_parts_of_all_sources_are_no_more_than_the_sound():
    random = np.random.RandomState(0)
    filters = SourceBeamformers(MicrophoneArray(SQUARE))
    filters.steer({1: towards(0.0), 2: towards(120.0)})
    noise_power = np.full(BINS, 1e-3, np.float32)
    for _ in range(30):
        spectrum = (random.standard_normal((4, BINS)) + 1j * random.standard_normal((4, BINS))).astype(np.complex64)
        parts = filters.separate(spectrum, noise_power)
        assert set(parts) == {1, 2}
        assert all(np.isfinite(part).all() for part in parts.values())
        assert np.linalg.norm(parts[1] + parts[2]) < 1.5 * np.linalg.norm(spectrum[0])
    filters.steer({2: towards(120.0)})
    assert set(filters.separate(spectrum, noise_power)) == {2}
    filters.steer({})
    assert filters.separate(spectrum, noise_power) == filters.shares(spectrum, noise_power) == {}


def test_who_has_walked_on_is_listened_to_where_they_are_now():
    sound = noise(1, 4 * BINS, 0.1).reshape(4, BINS) * (1.0 + 1.0j)
    moved, there = (SourceBeamformers(MicrophoneArray(SQUARE)) for _ in range(2))
    moved.steer({1: towards(0.0)})
    for filters in (moved, there):
        filters.steer({1: towards(20.0)})
    parts = [filters.separate(sound.astype(np.complex64), np.full(BINS, 1e-3, np.float32))[1]
             for filters in (moved, there)]
    np.testing.assert_array_equal(*parts)


def test_one_voice_comes_out_sample_for_sample_where_it_was():
    voice, sound = one_voice()
    _, found = separate(sound)
    assert len(found) == 1
    part = slice(int(0.7 * RATE), len(sound) - 512)
    estimate = next(iter(found.values()))
    assert ratio_db(estimate[part], voice[part]) > 15.0
    # No shift explains it better.
    lags = range(-40, 41)
    products = [float(np.roll(estimate, -lag)[part] @ voice[part]) for lag in lags]
    assert lags[int(np.argmax(products))] == 0


def test_the_direction_is_told_with_its_uncertainty():
    separator, _ = separate(one_voice(azimuth=-120.0)[1])
    source = separator.sources[0]
    assert angle(source.direction, towards(-120.0)) < 1.5
    assert 0.0 < source.sd < np.radians(6.0)


def test_the_beginning_of_a_voice_is_not_lost():
    voice, sound = one_voice(seed=2)
    _, found = separate(sound)
    estimate = next(iter(found.values()))
    begin = slice(int(0.5 * RATE), int(0.7 * RATE))
    assert np.sum(estimate[begin] ** 2) > 0.5 * np.sum(voice[begin] ** 2) > 0.0


def test_two_voices_at_once_come_out_apart():
    first, one = one_voice(20.0, 2.5, seed=1)
    second, other = one_voice(140.0, 2.5, seed=5)
    sound = one + other
    separator, found = separate(sound)
    assert len(found) == 2
    part = slice(int(1.0 * RATE), len(sound) - 512)
    for azimuth, voice in ((20.0, first), (140.0, second)):
        source = min(separator.sources, key=lambda s, a=azimuth: angle(s.direction, towards(a)))
        assert angle(source.direction, towards(azimuth)) < 5.0
        assert ratio_db(found[source.key][part], voice[part]) > ratio_db(sound[part, 0], voice[part]) + 6.0


def test_who_has_fallen_silent_is_not_heard_though_somebody_else_is():
    (_, first), (_, second) = one_voice(20.0, 2.0, seed=3), one_voice(140.0, 4.0, seed=7)
    sound = second.copy()
    sound[:len(first)] += first
    separator, heard = SoundSeparator(SQUARE), {20.0: [], 140.0: []}
    for begin in range(0, len(sound), 480):
        for signal in separator.process(sound[begin:begin + 480]):
            azimuth = min(heard, key=lambda side, signal=signal: angle(signal.direction, towards(side)))
            heard[azimuth].append((begin / RATE, signal.active))
    part = {azimuth: [np.mean([active for stamp, active in of if since < stamp < since + 0.8])
                      for since in (1.5, 2.7, 3.6)] for azimuth, of in heard.items()}
    assert min(part[140.0]) > 0.9 and part[20.0][0] > 0.8
    assert part[20.0][1] < 0.2 and part[20.0][2] == 0.0


@pytest.mark.parametrize("sizes", [(16000,), (160,), (511, 1, 0, 1024, 333)])
def test_the_output_does_not_depend_on_how_sound_is_cut(sizes):
    _, sound = one_voice(seconds=1.0)
    _, expected = separate(sound)
    _, found = separate(sound, sizes)
    assert set(found) == set(expected)
    for key, signal in expected.items():
        np.testing.assert_array_equal(found[key], signal)


def test_the_output_lags_by_less_than_its_latency():
    _, sound = one_voice()
    separator, last = SoundSeparator(SQUARE), None
    for first in range(0, len(sound), 100):
        for signal in separator.process(sound[first:first + 100]):
            end = first + signal.offset + len(signal.samples)
            assert 0 <= min(first + 100, len(sound)) - end < separator.latency * RATE
            assert len(signal.samples) % HOP == 0 and signal.samples.dtype == np.float32
            last = end
    assert last is not None


def test_a_voice_that_pauses_comes_back_under_its_key():
    one, two = one_voice(seconds=0.6, lead=0.4)[1], one_voice(seconds=0.6, lead=1.8, seed=3)[1]
    sound = np.concatenate([one, two])
    short = settings(source_hold_time=0.3)
    _, found = separate(sound, separator=SoundSeparator(SQUARE, short))
    assert set(found) == {1}
    # Not listened to when it has been silent for longer than the hold time.
    silent = slice(len(one) + int(1.2 * RATE), len(one) + int(1.4 * RATE))
    assert not found[1][silent].any()
    assert found[1][len(one) + int(1.9 * RATE):].any()
    # One long block in which a source went and came back tells it twice, and tells the same.
    signals = SoundSeparator(SQUARE, short).process(sound)
    assert [signal.key for signal in signals] == [1, 1]
    for signal in signals:
        part = slice(signal.offset, signal.offset + len(signal.samples))
        np.testing.assert_array_equal(found[1][part], signal.samples)


@pytest.mark.parametrize("sound", [np.zeros((16000, 4)), noise(16000, 4, 0.02), np.ones((16000, 4))])
def test_silence_noise_and_direct_current_are_nobody(sound):
    assert separate(sound)[1] == {}


def test_full_scale_and_clipped_sound_gives_finite_signals():
    _, sound = one_voice()
    _, found = separate(np.clip(100.0 * sound, -1.0, 1.0))
    assert found and all(np.isfinite(signal).all() and np.abs(signal).max() <= 2.0 for signal in found.values())


def test_samples_that_are_no_numbers_do_not_last():
    voice, sound = one_voice()
    sound[9000:9100, 1] = np.nan
    sound[9200, 2] = np.inf
    _, found = separate(sound)
    assert len(found) == 1
    part = slice(int(1.0 * RATE), len(sound) - 512)
    assert ratio_db(next(iter(found.values()))[part], voice[part]) > 15.0


@pytest.mark.parametrize("channel", [0, 2])
def test_a_dead_microphone_is_survived(channel):
    _, sound = one_voice()
    sound[:, channel] = 0.0
    _, found = separate(sound)
    assert len(found) == 1 and all(np.isfinite(signal).all() and signal.any() for signal in found.values())


@pytest.mark.parametrize("shape", [(100,), (100, 3), (100, 5), (4, 100), (100, 4, 1)])
def test_sound_of_another_number_of_channels_is_refused(shape):
    with pytest.raises(ValueError, match="4 microphones"):
        SoundSeparator(SQUARE).process(np.zeros(shape))


def test_wrong_positions_are_refused():
    with pytest.raises(ParameterError, match="microphone_positions"):
        SoundSeparator(SQUARE[:1])


def test_no_sound_is_no_news():
    assert SoundSeparator(SQUARE).process(np.zeros((0, 4))) == []


def test_reset_begins_anew_with_other_keys():
    _, sound = one_voice()
    separator, before = separate(sound)
    separator.reset()
    assert separator.sources == []
    _, after = separate(sound, separator=separator)
    assert set(before) == {1} and set(after) == {2}
    np.testing.assert_allclose(after[2], before[1], atol=1e-7)


def test_two_microphones_separate_and_tell_directions_only_when_told_to():
    pair = np.array([[0.0, 0.06, 0.0], [0.0, -0.06, 0.0]])
    _, sound = one_voice(azimuth=35.0, positions=pair)
    for front in (True, False):
        separator = SoundSeparator(pair, settings(line_front=front))
        signals = [signal for first in range(0, len(sound), 480)
                   for signal in separator.process(sound[first:first + 480])]
        assert signals
        if front:
            assert angle(signals[-1].direction, towards(35.0)) < 4.0
        else:
            assert all(signal.direction is None for signal in signals)
    _, sound = one_voice(azimuth=35.0)
    signals = SoundSeparator(SQUARE, settings(line_front=False)).process(sound)
    assert [angle(signal.direction, towards(35.0)) < 4.0 for signal in signals] == [True], "no line"


def test_not_more_sources_than_allowed():
    sound = sum(one_voice(azimuth, 2.0, seed)[1] for seed, azimuth in enumerate((0.0, 90.0, 180.0)))
    separator, _ = separate(sound, separator=SoundSeparator(SQUARE, settings(max_sources=1)))
    assert len(separator.sources) == 1


def test_nothing_grows_with_time():
    """Many short voices from everywhere: what is kept stays as it was, whatever was heard."""
    separator = SoundSeparator(SQUARE, settings(source_memory=0.5, source_hold_time=0.2))
    sizes = []
    for seed in range(10):
        sound = one_voice(seed * 77.0, 0.3, seed, lead=0.8)[1]
        for first in range(0, len(sound), 480):
            separator.process(sound[first:first + 480])
        sizes.append(_numbers_in(separator))
    assert separator.sources[-1].key >= 8
    assert max(sizes[5:]) <= max(sizes[:5])


def _numbers_in(thing, seen=None):
    """How many numbers of arrays, and items of containers, an object holds."""
    seen = seen if seen is not None else set()
    if id(thing) in seen:
        return 0
    seen.add(id(thing))
    if isinstance(thing, np.ndarray):
        return thing.size
    if isinstance(thing, dict):
        return len(thing) + sum(_numbers_in(item, seen) for item in thing.values())
    if isinstance(thing, (str, bytes)):
        return 0
    if hasattr(thing, "__dict__"):
        return _numbers_in(vars(thing), seen)
    try:
        items = list(thing)
    except TypeError:
        return 0
    return len(items) + sum(_numbers_in(item, seen) for item in items)
