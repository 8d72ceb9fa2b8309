"""Activity and turns from probabilities and levels, frame by frame; which turn is which voice, and until when it is
tracked."""

import math

import numpy as np
import pytest

from hri_pipeline.core.audio.level import SILENT_DBFS
from hri_pipeline.core.audio.parameters import VoiceActivitySettings
from hri_pipeline.core.audio.turns import TurnDetector, VoiceTracks, angle_between
from hri_pipeline.core.audio.vad import NoiseLevel, SpeechActivity
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.parameters import ParameterTable

TABLE = ParameterTable("activity", VoiceActivitySettings)
FRAME = 0.032
PLAIN = {"birth_threshold": 0.6, "clear_birth_threshold": 0.6, "keep_threshold": 0.3, "noise_margin": 0.0,
         "level_drop": 90.0,
         "onset_time": 0.0, "speaking_hangover": 0.0, "hangover_time": 0.1, "min_speech": 0.05}
"""Thresholds alone: the level plays no part at -20 dBFS above a floor of -60."""


def settings(**changes):
    return TABLE.resolve(dict(PLAIN, **changes))


def started(**changes):
    """A detector whose noise floor is at -60 dBFS."""
    detector = TurnDetector(settings(**changes))
    run(detector, [0.0] * 5, energy=-60.0)
    return detector


def run(detector, probabilities, energy=-20.0, duration=FRAME):
    return [detector.update(probability, energy, duration) for probability in probabilities]


def marks(steps, attribute):
    return "".join("#" if getattr(step, attribute) else "." for step in steps)


def digits(text):
    """'059' -> 0.0, 0.5, 0.9."""
    return [int(character) / 10.0 for character in text]


@pytest.mark.parametrize("changes, probabilities, speaking", [
    ({}, "00000", "....."),
    ({}, "05550", "....."),                                     # below the birth threshold nothing begins
    ({}, "06000", ".#..."),                                     # at the threshold it does
    ({}, "09550", ".###."),                                     # between the thresholds it goes on
    ({}, "09330", ".###."),
    ({}, "09290", ".#.#."),                                     # below the lower one it ends
    ({"onset_time": 2 * FRAME}, "0909900", "....#.."),          # two frames in a row are asked for
    ({"onset_time": 0.033}, "0990", "..#."),                    # a part of a frame is a frame
    ({"onset_time": 0.01}, "0900", ".#.."),
    ({"speaking_hangover": FRAME}, "0900000", ".##...."),
    ({"speaking_hangover": 3 * FRAME}, "0900900900000", ".##########.."),
    ({"speaking_hangover": 0.05}, "0900000", ".##...."),        # two frames would be longer than 0.05 s
])
def test_speaking(changes, probabilities, speaking):
    assert marks(run(started(**changes), digits(probabilities)), "speaking") == speaking


@pytest.mark.parametrize("probabilities, turn, onset, end", [
    ("00000000", "........", "........", "........"),
    ("09000000", ".#####..", ".#......", ".....#.."),           # 3 frames within 0.1 s, the fourth ends it
    ("090090000000", ".########...", ".#..........", "........#..."),   # a pause of two frames belongs to the turn
    ("09000900000", ".#########.", ".#.........", ".........#."),      # one of three as well
    ("090000900000", ".##########.", ".#....#.....", ".....#....#."),   # one of four is longer than 0.1 s
    ("0900000900000", ".#####.#####.", ".#.....#.....", ".....#.....#."),
])
def test_turns(probabilities, turn, onset, end):
    steps = run(started(), digits(probabilities))
    assert [marks(steps, name) for name in ("turn", "onset", "end")] == [turn, onset, end]


@pytest.mark.parametrize("duration", [0.008, 0.016, 0.032, 0.05])
def test_times_are_seconds_whatever_the_frame(duration):
    detector = TurnDetector(settings(hangover_time=0.4, speaking_hangover=0.2))
    detector.update(0.0, -60.0, duration)
    run(detector, [0.9], duration=duration)
    steps = run(detector, [0.0] * 100, duration=duration)
    speaking, turn = marks(steps, "speaking").count("#"), marks(steps, "turn").count("#")
    assert speaking == math.floor(0.2 / duration + 1e-9)
    assert turn == math.floor(0.4 / duration + 1e-9) + 1, "and the frame that ends it"


@pytest.mark.parametrize("speech, short", [("9", True), ("99", False), ("9009", False), ("900000", True)])
def test_a_turn_of_less_speech_than_asked_for_is_short(speech, short):
    steps = run(started(), digits("0" + speech + "000000"))
    assert [step.short for step in steps if step.end] == [short]


def test_the_time_until_the_onset_counts_as_speech():
    steps = run(started(onset_time=2 * FRAME), digits("0990000000"))
    assert [step.short for step in steps if step.end] == [False]


def test_missing_sound_is_a_pause():
    detector = started()
    assert not detector.skip(5.0).turn, "nobody speaks: nothing ends"
    run(detector, [0.9, 0.9])
    step = detector.skip(0.05)
    assert step.turn and not step.end and not step.speaking
    assert not detector.skip(0.0).end and not detector.skip(-1.0).end
    step = detector.skip(0.06)
    assert step.end and not step.short
    assert not detector.skip(1.0).end, "an end comes once"


def test_missing_sound_breaks_the_run_up_to_an_onset():
    detector = started(onset_time=2 * FRAME)
    run(detector, [0.9])
    detector.skip(0.05)
    assert marks(run(detector, [0.9, 0.9]), "onset") == ".#"


def test_a_turn_can_be_cut():
    detector = started()
    assert not detector.cut().end
    run(detector, [0.9, 0.9])
    step = detector.cut()
    assert step.end and step.turn and not step.speaking and not step.short
    assert not detector.cut().end
    assert marks(run(detector, [0.0, 0.9]), "onset") == ".#"


def test_a_cut_of_a_moment_is_short():
    detector = started()
    run(detector, [0.9])
    assert detector.cut().short


@pytest.mark.parametrize("frame", [(math.nan, -20.0, FRAME), (0.5, math.nan, FRAME), (0.5, math.inf, FRAME),
                                   (0.5, -20.0, 0.0), (0.5, -20.0, -1.0), (0.5, -20.0, math.nan)])
def test_what_is_no_frame_is_refused(frame):
    with pytest.raises(ValueError, match="frame of probability"):
        started().update(*frame)


@pytest.mark.parametrize("changes", [{"keep_threshold": 0.7}, {"clear_birth_threshold": 0.7},
                                     {"clear_birth_threshold": 0.2}])
def test_thresholds_in_the_wrong_order_are_refused(changes):
    with pytest.raises(ValueError, match="keep_threshold .* must be in this order"):
        SpeechActivity(settings(**changes))


def test_the_defaults_are_in_order():
    SpeechActivity(TABLE.resolve({}))


@pytest.mark.parametrize("snr, threshold", [(-5.0, 0.6), (8.0, 0.6), (14.0, 0.4), (20.0, 0.2), (60.0, 0.2)])
def test_less_is_asked_for_where_the_sound_stands_out(snr, threshold):
    activity = SpeechActivity(settings(clear_birth_threshold=0.2, keep_threshold=0.1, clear_snr=20.0))
    assert activity.birth_threshold(snr) == pytest.approx(threshold)


def test_a_loud_soft_consonant_begins_and_a_quiet_one_does_not():
    changes = {"clear_birth_threshold": 0.3, "keep_threshold": 0.2}
    assert run(started(**changes), [0.3], energy=-39.0)[0].speaking
    assert not run(started(**changes), [0.3], energy=-50.0)[0].speaking


def test_at_the_noise_floor_nobody_speaks_whatever_the_network_says():
    detector = started(noise_margin=1.0)
    run(detector, [0.9, 0.9])
    assert not run(detector, [0.9], energy=-60.0)[0].speaking


def test_far_below_what_was_just_said_is_a_pause():
    detector = started(level_drop=20.0)
    run(detector, [0.9])
    assert run(detector, [0.5], energy=-39.0)[0].speaking
    assert not run(detector, [0.5], energy=-45.0)[0].speaking
    assert run(detector, [0.9], energy=-45.0)[0].speaking, "a softer speaker begins anew"


def test_the_loudest_of_the_last_words_counts_and_fades_by_6_db_a_second():
    detector = started(level_drop=20.0)
    run(detector, [0.9], energy=-39.0)
    run(detector, [0.9], energy=-15.0)
    assert not run(detector, [0.5], energy=-45.0)[0].speaking
    run(detector, [0.9], energy=-15.0)
    run(detector, [0.9] * int(2.0 / FRAME), energy=-30.0)
    assert run(detector, [0.5], energy=-45.0)[0].speaking


def test_noise_floor_follows_noise_and_not_speech():
    floor = NoiseLevel()
    assert floor.update(-50.0, 0.0, FRAME) == -50.0
    for _ in range(15):
        floor.update(-70.0, 0.0, FRAME)
    assert floor.level == pytest.approx(-70.0, abs=0.2), "half a second downwards"
    for _ in range(31):
        floor.update(-20.0, 0.9, FRAME)
    assert -70.0 < floor.level < -69.0, "a second of speech"
    for _ in range(100):
        floor.update(-40.0, 0.0, FRAME)
    assert floor.level == pytest.approx(-40.0, abs=0.5), "three seconds of louder noise"


def test_speech_from_the_first_frame_on_is_no_noise_floor():
    detector = TurnDetector(settings(noise_margin=1.0))
    assert marks(run(detector, [0.1] + [0.9] * 20), "speaking") == "." + "#" * 20
    assert not detector.activity.noise.known


def test_noise_floor_is_known_after_a_tenth_of_a_second_without_speech():
    floor = NoiseLevel()
    known = []
    for probability in (0.0, 0.0, 0.9, 0.1, 0.0):
        floor.update(-50.0, probability, FRAME)
        known.append(floor.known)
    assert known == [False, False, False, True, True]


def test_noise_floor_of_digital_silence_is_bounded():
    floor = NoiseLevel()
    assert floor.update(SILENT_DBFS, 0.0, FRAME) == -90.0


def test_reset_forgets_turn_and_noise():
    detector = started()
    run(detector, [0.9])
    detector.reset()
    assert math.isnan(detector.activity.noise.level)
    assert not detector.skip(10.0).end


def tracks(**changes):
    values = dict({"voice_timeout": 3.0, "resume_time": 2.0, "resume_angle": 0.35}, **changes)
    return VoiceTracks(TABLE.resolve(values), IdGenerator(seed=1))


def towards(degrees):
    angle = np.deg2rad(degrees)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def spoken(voices, key, stamp, direction=None, short=False):
    """A turn of 1 s that begins at `stamp`; returns the id."""
    voice = voices.begin(key, stamp, direction, None if direction is None else 0.1)
    voices.heard(voice, stamp + 1.0, direction, None if direction is None else 0.1)
    voices.end(voice, short)
    return voice.id


@pytest.mark.parametrize("resume_time, pause, same", [
    (2.0, 0.7, True), (2.0, 2.0, True), (2.0, 2.1, False), (0.0, 0.01, False), (60.0, 2.9, True),
    (60.0, 3.1, False),                        # not tracked any more
])
def test_one_microphone(resume_time, pause, same):
    voices = tracks(resume_time=resume_time)
    first = spoken(voices, 0, 10.0)
    second = spoken(voices, 0, 11.0 + pause)
    assert (first == second) is same
    assert len(voices.tracked) == (1 if same else 2), "the first is tracked on for its time"


def test_the_voice_that_spoke_last_goes_on():
    voices = tracks(resume_time=1.0)
    first, second = spoken(voices, 0, 0.0), spoken(voices, 0, 2.1)
    assert first != second
    assert spoken(voices, 0, 3.2) == second


@pytest.mark.parametrize("key, degrees, pause, same", [
    (1, 0.0, 2.5, True), (1, 60.0, 2.5, True),    # the source is followed: whoever walks while silent
    (2, 15.0, 2.5, True), (2, 25.0, 2.5, False), (2, 15.0, 3.1, False), (1, 0.0, 3.1, False),
])
def test_an_array(key, degrees, pause, same):
    voices = tracks(resume_time=0.0)
    first = spoken(voices, 1, 0.0, towards(0.0))
    assert (spoken(voices, key, 1.0 + pause, towards(degrees)) == first) is same


def test_the_nearest_voice_goes_on():
    voices = tracks()
    left, right = spoken(voices, 1, 0.0, towards(10.0)), spoken(voices, 2, 0.1, towards(-10.0))
    assert spoken(voices, 3, 1.5, towards(-4.0)) == right
    assert spoken(voices, 4, 1.6, towards(4.0)) == left


def test_a_voice_in_its_turn_is_nobody_elses():
    voices = tracks()
    first = voices.begin(1, 0.0, towards(0.0), 0.1)
    second = voices.begin(2, 0.5, towards(5.0), 0.1)
    assert first.id != second.id and voices.tracked == (first.id, second.id)


def test_a_voice_is_let_go_after_its_time():
    voices = tracks()
    voice = voices.begin(0, 0.0)
    voices.expire(100.0)
    assert voices.tracked == (voice.id,), "not while it has the word"
    voices.heard(voice, 100.0, None, None)
    voices.heard(voice, 99.0, None, None)
    voices.end(voice, short=False)
    voices.expire(103.0)
    assert voices.tracked == (voice.id,)
    voices.expire(103.01)
    assert voices.tracked == ()


def test_a_noise_is_let_go_at_once_unless_the_voice_is_known():
    voices = tracks()
    spoken(voices, 0, 0.0, short=True)
    assert voices.tracked == ()
    first = spoken(voices, 0, 10.0)
    assert spoken(voices, 0, 11.5, short=True) == first
    assert voices.tracked == (first,)


def test_the_direction_is_the_last_that_was_heard():
    voices = tracks()
    voice = voices.begin(1, 0.0, towards(0.0), 0.1)
    voices.heard(voice, 0.5, towards(10.0), 0.2)
    voices.heard(voice, 0.6, None, None)
    np.testing.assert_allclose(voice.direction, towards(10.0))
    assert voice.direction_sd == 0.2


def test_silent_and_clear():
    voices = tracks()
    spoken(voices, 0, 0.0)
    speaking = voices.begin(1, 0.5, towards(0.0), 0.1)
    assert [voice.key for voice in voices.silent] == [0]
    voices.end(speaking, short=False)
    assert len(voices.silent) == 2
    voices.clear()
    assert voices.tracked == ()


@pytest.mark.parametrize("degrees", [0.0, 1e-3, 45.0, 90.0, 180.0])
def test_angle(degrees):
    assert angle_between(towards(0.0), towards(degrees)) == pytest.approx(np.deg2rad(degrees), abs=1e-9)


def sounds(seconds, low, high, level=-30.0):
    """Arguments of update() for sound that is taken for speech, whose level swings by so many dB at low and at high
    frequencies."""
    swing = np.sin(0.4 * np.arange(int(seconds / FRAME)))
    return [(0.9, level + 0.5 * low * s, FRAME, (0.5 * low * s, 0.5 * high * s)) for s in swing]


def babble(seconds):
    return sounds(seconds, 6.0, 10.0)


def test_background_talk_is_no_voice_for_ever_and_somebody_in_front_of_it_is_heard():
    activity = SpeechActivity(settings())
    spoken_of = [activity.update(*frame) for frame in babble(20.0)]
    assert spoken_of[int(2.0 / FRAME)]
    assert activity.noise.is_babble and not any(spoken_of[int(10.0 / FRAME):])
    loud = [activity.update(*frame) for frame in sounds(1.0, 6.0, 10.0, level=-20.0)]
    assert all(loud[5:])
    assert not [activity.update(*frame) for frame in babble(0.5)][-1]


@pytest.mark.parametrize("low, high", [(18.0, 20.0), (16.0, 3.0), (8.0, 2.0), (1.0, 1.0)])
def test_one_speaker_in_silence_or_in_noise_is_no_background(low, high):
    activity = SpeechActivity(settings(level_drop=60.0))
    assert all([activity.update(*frame) for frame in sounds(30.0, low, high)][5:])
    assert not activity.noise.is_babble


@pytest.mark.parametrize("above, is_babble", [(1.0, True), (5.0, False)])
def test_who_speaks_in_front_of_background_talk_is_not_taken_for_it(above, is_babble):
    """The network does not take the background for speech, or some of it that is hardly louder."""
    activity = SpeechActivity(settings())
    for index, (_, energy, duration, bands) in enumerate(sounds(20.0, 6.0, 10.0)):
        is_speech = index % 60 < 30
        activity.update(0.9 if is_speech else 0.05, energy + is_speech * above, duration, bands)
    assert activity.noise.is_babble == is_babble


def test_one_speaker_in_a_hum_as_loud_as_speech_is_no_background():
    """At low frequencies there is hardly anything but the hum; speech is told by the high ones."""
    activity = SpeechActivity(settings())
    for index in range(int(20.0 / FRAME)):
        is_speech = index % 60 < 40
        activity.update(0.9 if is_speech else 0.05, -20.0 + is_speech * 1.0, FRAME,
                        (-20.0 + is_speech * 1.0, -60.0 + is_speech * 20.0))
    assert not activity.noise.is_babble


def test_background_talk_that_ends_is_forgotten():
    activity = SpeechActivity(settings())
    for frame in babble(20.0):
        activity.update(*frame)
    for _ in range(int(2.0 / FRAME)):
        activity.update(0.01, -60.0, FRAME, (-60.0, -60.0))
    assert not activity.noise.is_babble
    assert activity.update(0.9, -35.0, FRAME)


def test_silence_that_the_network_doubts_ends_speech_without_hangover():
    activity = SpeechActivity(settings(speaking_hangover=0.064, level_drop=22.0))
    for _ in range(10):
        activity.update(0.95, -20.0, FRAME)
    assert activity.update(0.95, -50.0, FRAME)
    assert not activity.update(0.4, -50.0, FRAME)
