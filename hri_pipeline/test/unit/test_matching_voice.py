"""Whose voice it is: mouth motion, speaking times, evidence, and the matcher over time."""

from __future__ import annotations

import math
from itertools import groupby

import numpy as np
import pytest

from benchmarks.report import least_cost
from hri_pipeline.core.matching.parameters import VOICE_MATCHER_PARAMETERS
from hri_pipeline.core.matching.voice import (
    FACE,
    MAX_MOUTHS,
    NEAR,
    PERSON,
    SILENT,
    SPEAKING,
    STEP_S,
    UNKNOWN,
    MouthTrack,
    SpeakingTimes,
    VoiceMatcher,
    direction_evidence,
    motion_evidence,
    mouth_evidence,
    opening_of_landmarks,
    opening_of_units,
)

RATE = 15.0


def moving(time):
    return 0.25 + 0.25 * math.sin(2.0 * math.pi * 4.3 * time)


def still(time):
    return 0.05


def make(faces=(), voices=(), **given):
    matcher = VoiceMatcher(VOICE_MATCHER_PARAMETERS.resolve(given))
    matcher.set_tracked("faces", faces)
    matcher.set_tracked("voices", voices)
    return matcher


def run(matcher, start, end, mouths):
    """Let time pass in steps of an image; returns [(time, {voice: (kind, id)})]. mouths: {face: opening(time)}."""
    found = []
    for number in range(int(round((end - start) * RATE))):
        now = start + number / RATE
        for face, opening in mouths.items():
            matcher.add_mouth(face, now, opening(now), 0.9)
        if number % 3 == 0:
            found.append((now, {match.voice: (match.kind, match.id) for match in matcher.matches(now)}))
    return found


def test_a_crowd_beyond_the_limit_does_not_stop_the_mouths_that_are_known():
    matcher = make(["face{}".format(number) for number in range(MAX_MOUTHS + 5)], ["vvvvv"])
    for number in range(MAX_MOUTHS + 5):
        matcher.add_mouth("face{}".format(number), 0.0, 0.05, 0.9)
    matcher.on_speaking("vvvvv", True, 0.1)
    run(matcher, 0.1, 4.0, {"face0": moving, "face1": still})
    matcher.set_tracked("faces", ["face0", "face1"])        # one of so many would not be likely enough
    assert {match.voice: (match.kind, match.id) for match in matcher.matches(4.0)} == {"vvvvv": (FACE, "face0")}


def likelihood(matcher, now, voice):
    return next((match.confidence for match in matcher.matches(now) if match.voice == voice), 0.0)


# -- what a mouth does

def test_the_opening_is_that_of_the_lips_and_a_chewing_jaw_adds_little():
    def opening(lips, jaw, confidence=0.8):
        intensity, certain = np.zeros(99), np.zeros(99)
        intensity[[25, 26]], certain[[25, 26]] = (lips, jaw), confidence
        return opening_of_units(intensity, certain)

    assert opening(0.4, 0.4) == (pytest.approx(0.4), 0.8)
    assert opening(0.0, 0.4)[0] == pytest.approx(0.1)
    assert opening(0.4, 0.4, 0.0) == (0.0, 0.0)


def face(gap, turn=1.0, scale=0.1):
    """Landmarks whose inner lips are `gap` distances of the eyes apart; turn: how much narrower the face looks."""
    points = np.full((70, 3), 0.5)
    points[:, 2] = 1.0
    points[36:42, :2], points[42:48, :2] = (0.5 - 0.5 * scale * turn, 0.4), (0.5 + 0.5 * scale * turn, 0.4)
    points[33, 1] = 0.4 + 0.77 * scale
    for upper, lower in ((61, 67), (62, 66), (63, 65)):
        points[upper, 1], points[lower, 1] = 0.52, 0.52 + gap * scale
    return points


@pytest.mark.parametrize("gap, expected", [(0.0, 0.0), (0.02, 0.0), (0.11, 0.5), (0.2, 1.0), (0.38, 2.0), (0.9, 3.0)])
def test_the_gap_of_the_lips_is_on_the_scale_of_the_action_unit(gap, expected):
    assert opening_of_landmarks(face(gap), 1.0) == (pytest.approx(expected, abs=1e-9), 1.0)


def test_the_gap_is_the_same_for_faces_near_and_far_and_turned_to_the_side():
    values = [opening_of_landmarks(face(0.1, turn, scale), 1.0)[0] for turn in (1.0, 0.6) for scale in (0.02, 0.2)]
    assert values == pytest.approx([values[0]] * 4)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 16.0 / 9.0])
def test_the_gap_is_the_same_for_a_head_that_lies_on_its_side_in_images_of_any_shape(aspect):
    upright, lying = face(0.11), face(0.11)
    lying[:, :2] = lying[:, 1::-1]
    for points in (upright, lying):
        points[:, 0] /= aspect
        assert opening_of_landmarks(points, aspect)[0] == pytest.approx(0.5)


@pytest.mark.parametrize("point", [37, 44, 33, 62, 66], ids=["right eye", "left eye", "nose", "upper lip", "lower lip"])
def test_landmarks_that_are_not_seen_have_no_weight(point):
    hidden = face(0.1)
    hidden[point, 2] = 0.0
    assert opening_of_landmarks(hidden, 1.0)[1] == 0.0


def test_landmarks_that_are_no_face_have_no_weight():
    assert opening_of_landmarks(np.full((70, 3), 0.5), 1.0)[1] == 0.0


def test_motion_is_the_deviation_in_the_window_and_unknown_where_samples_are_missing():
    track = MouthTrack()
    for stamp in np.arange(0.0, 4.0, 1.0 / RATE):
        if not 1.5 < stamp < 2.5:
            track.add(stamp, moving(stamp) if stamp < 1.5 else 0.3, 0.8)
    motion, weight = track.motion(np.array([0.75, 2.0, 3.5, 9.0]))
    assert motion[0] == pytest.approx(0.25 / math.sqrt(2.0), abs=0.03)
    assert math.isnan(motion[1]) and weight[1] == 0.0
    assert motion[2] == pytest.approx(0.0, abs=1e-6) and weight[2] == pytest.approx(0.8)
    assert math.isnan(motion[3])


def test_motion_at_a_time_does_not_depend_on_what_else_is_asked_for():
    track = MouthTrack()
    for stamp in np.arange(0.0, 4.0, 1.0 / RATE):
        track.add(stamp, moving(stamp) * stamp, 0.8)
    times = np.array([1.0, 1.9, 2.0, 3.0])
    assert track.motion(times)[0] == pytest.approx([track.motion(times[[place]])[0][0] for place in range(len(times))])


def test_images_of_a_moment_tell_no_motion():
    track = MouthTrack()
    for stamp in (1.0, 1.03, 1.06):
        track.add(stamp, stamp, 0.8)
    assert math.isnan(track.motion(np.array([1.03]))[0][0])


def test_a_mouth_keeps_its_samples_bounded_and_in_order():
    track = MouthTrack()
    for stamp in np.arange(0.0, 300.0, 0.05):
        track.add(stamp, moving(stamp), 1.0)
    track.add(10.0, 0.5, 1.0)
    assert track.newest == pytest.approx(299.95)
    assert track.motion(np.array([299.0]))[0][0] > 0.1


# -- when a voice spoke

def test_one_wrong_stamp_of_the_future_does_not_end_a_mouth():
    matcher = make(["fa"], ["v1"])
    matcher.add_mouth("fa", 1000.0, 0.5, 0.9)
    matcher.on_speaking("v1", True, 0.1)
    assert run(matcher, 0.1, 3.0, {"fa": moving})[-1][1] == {"v1": (FACE, "fa")}


def test_speaking_times_take_the_delays_off_and_bridge_pauses():
    times = SpeakingTimes(0.1, 0.2)
    assert times.say(True, 1.1) and not times.say(True, 1.2)
    times.say(False, 2.2)
    times.say(True, 2.4)          # a pause of 0.3 s
    times.say(False, 3.2)
    times.say(True, 5.1)
    assert times.at(np.array([0.9, 1.1, 2.1, 2.9, 3.1, 4.9, 9.0])).tolist() == [False, True, True, True, False, False,
                                                                                True]
    assert times.at(np.array([0.5, 0.7, 3.3, 3.5]), 0.4).tolist() == [False, True, True, False]
    assert times.first == pytest.approx(1.0) and times.last == math.inf


def test_speaking_times_are_bounded():
    times = SpeakingTimes(0.1, 0.1)
    for number in range(1000):
        times.say(number % 2 == 0, float(number))
    assert len(times._intervals) < 20


# -- evidence

def evidence(speech, moves):
    """moves: 1 moving, 0 still, NaN unknown, one for each step of 0.1 s."""
    ratios = motion_evidence(np.where(np.isnan(moves), np.nan, np.where(np.array(moves) > 0, 0.2, 0.02)),
                             np.ones(len(moves)), 0.05)
    return float(mouth_evidence(np.array([speech]), ratios[None])[0, 0])


def steps(seconds, value):
    return [value] * int(round(seconds / STEP_S))


def test_a_mouth_that_begins_with_the_voice_is_surer_than_one_that_always_moves():
    speech = steps(2.0, SILENT) + steps(0.4, NEAR) + steps(2.0, SPEAKING)
    with_voice = evidence(speech, np.array(steps(2.2, 0.0) + steps(2.2, 1.0)))
    always = evidence(speech, np.array(steps(4.4, 1.0)))
    never = evidence(speech, np.array(steps(4.4, 0.0)))
    assert with_voice > 2.5 > 1.0 > always > never and never < -2.0


def test_a_mouth_of_which_nothing_is_known_is_no_evidence():
    assert evidence(steps(3.0, SPEAKING), np.array(steps(3.0, math.nan))) == pytest.approx(0.0, abs=1e-9)


def test_what_a_mouth_does_while_somebody_else_speaks_says_nothing():
    assert abs(evidence(steps(3.0, UNKNOWN), np.array(steps(3.0, 1.0)))) < 1e-9


def test_evidence_against_the_first_speaker_comes_soon_when_another_goes_on_under_the_same_voice():
    speech = steps(1.0, SILENT) + steps(3.0, SPEAKING) + steps(0.6, NEAR) + steps(1.5, SPEAKING)
    first = evidence(speech, np.array(steps(1.0, 0.0) + steps(3.0, 1.0) + steps(2.1, 0.0)))
    second = evidence(speech, np.array(steps(4.4, 0.0) + steps(1.7, 1.0)))
    assert first < 0.0 < 1.0 < second


def test_after_a_pause_a_voice_is_half_likely_anybodys_however_sure_it_was():
    speech = np.array([steps(2.0, SILENT) + steps(5.0, SPEAKING) + steps(0.1, SILENT)])
    moves = np.array([steps(2.0, 0.0) + steps(5.1, 1.0), steps(7.1, 0.0), steps(7.1, 0.0)])
    ratios = motion_evidence(np.where(moves > 0, 0.2, 0.02), np.ones(moves.shape), 0.05)

    def probability(count):
        odds = np.exp(mouth_evidence(speech[:, :count], ratios[:, :count], 1.0)[0])
        return float(odds[0] / (odds.sum() + 1.0))
    before, after = probability(70), probability(71)
    assert before > 0.95 and after == pytest.approx(0.5 * before + 0.5 * 0.25, abs=0.02)


def test_direction_is_surest_straight_on_and_never_excludes():
    angles = np.deg2rad([0.0, 10.0, 20.0, 60.0])
    values = direction_evidence(angles, np.full(4, 3.0), math.radians(10.0))
    assert (np.diff(values) < 0.0).all() and values[0] > 2.0 and values[3] == pytest.approx(math.log(0.05), abs=1e-3)
    near = direction_evidence(np.zeros(1), np.full(1, 0.3), math.radians(10.0))
    assert near[0] < values[0]      # the place of a near head is less certain than the direction


def test_directions_of_people_out_of_view_speak_for_nobody_on_average():
    random = np.random.default_rng(3)
    bearings = random.uniform(-math.pi, math.pi, 100000)
    levels = np.arcsin(random.uniform(-1.0, 1.0, bearings.size) * math.sin(math.radians(20.0)))
    angles = np.arccos(np.cos(levels) * np.cos(bearings))
    ratios = np.exp(direction_evidence(angles, np.full(angles.size, 3.0), math.radians(7.0)))
    assert ratios.mean() == pytest.approx(1.0, abs=0.1)      # as every likelihood ratio over what speaks against


# -- the matcher

def test_one_mouth_that_moves_is_matched_within_a_second():
    matcher = make(["fa"], ["v1"])
    matcher.on_speaking("v1", True, 0.1)
    found = run(matcher, 0.1, 2.0, {"fa": moving})
    first = next(now for now, matches in found if matches == {"v1": (FACE, "fa")})
    assert first <= 1.1 and all(matches for now, matches in found if now >= first)


def test_a_voice_over_a_still_mouth_is_never_matched():
    matcher = make(["fa"], ["v1"])
    matcher.on_speaking("v1", True, 0.1)
    assert not any(matches for _, matches in run(matcher, 0.1, 10.0, {"fa": still}))


def test_a_smile_is_no_speech():
    matcher = make(["fa"], ["v1"])
    run(matcher, 0.0, 3.0, {"fa": still})
    matcher.on_speaking("v1", True, 3.1)
    assert not any(matches for _, matches in run(matcher, 3.1, 9.0,
                                                 {"fa": lambda time: min(0.4, 0.8 * max(0.0, time - 4.0))}))


def test_the_match_changes_over_when_the_evidence_turns_and_stays_when_the_voice_has_ended():
    matcher = make(["fa", "fb"], ["v1"])
    matcher.on_speaking("v1", True, 0.1)
    assert run(matcher, 0.1, 4.0, {"fa": moving, "fb": still})[-1][1] == {"v1": (FACE, "fa")}
    found = run(matcher, 4.0, 9.0, {"fa": still, "fb": moving})
    # Nobody has it before somebody else does.
    assert [key for key, _ in groupby(matches.get("v1") for _, matches in found)] == [(FACE, "fa"), None, (FACE, "fb")]
    matcher.on_speaking("v1", False, 9.0)
    assert run(matcher, 9.0, 20.0, {"fa": moving, "fb": still})[-1][1] == {"v1": (FACE, "fb")}
    matcher.set_tracked("faces", ["fa"])
    assert matcher.matches(20.1) == []


def test_two_voices_at_once_go_to_two_faces_in_their_directions():
    matcher = make(["fa", "fb"], ["v1", "v2"])
    places = {(FACE, "fa"): (2.0, 0.6, 0.0), (FACE, "fb"): (2.0, -0.6, 0.0)}
    matcher.set_direction("v1", (1.0, 0.3, 0.0), places)
    matcher.set_direction("v2", (1.0, -0.3, 0.0), places)
    for voice in ("v1", "v2"):
        matcher.on_speaking(voice, True, 0.1)
    assert run(matcher, 0.1, 2.0, {"fa": moving, "fb": moving})[-1][1] == {"v1": (FACE, "fa"), "v2": (FACE, "fb")}


def test_two_voices_never_share_a_face_while_they_speak_and_the_earlier_one_is_said_with_less():
    matcher = make(["fa"], ["v1", "v2"])
    matcher.on_speaking("v1", True, 0.1)
    run(matcher, 0.1, 3.0, {"fa": moving})
    matcher.on_speaking("v2", True, 3.0)
    assert len(run(matcher, 3.0, 5.0, {"fa": moving})[-1][1]) == 1
    matcher.on_speaking("v1", False, 5.0)
    matcher.on_speaking("v2", False, 5.0)
    run(matcher, 5.0, 8.0, {"fa": still})
    matcher.set_tracked("voices", ["v1", "v3"])
    matcher.on_speaking("v3", True, 8.0)
    run(matcher, 8.0, 11.0, {"fa": moving})
    both = {match.voice: match.confidence for match in matcher.matches(11.0)}
    assert set(both) == {"v1", "v3"} and both["v1"] <= 0.9 * both["v3"]


def test_a_person_without_a_face_is_found_by_direction_alone_but_not_by_its_own_voice():
    matcher = make((), ["v1"])
    matcher.set_direction("v1", (0.0, 1.0, 0.0), {(PERSON, "ann"): (0.1, 2.0, 0.0), (PERSON, "bob"): (2.0, 0.0, 0.0)})
    matcher.on_speaking("v1", True, 0.1)
    matcher.set_persons({"ann": ("", "v1"), "bob": ("", "")})
    assert run(matcher, 0.1, 1.0, {})[-1][1] == {}
    matcher.set_persons({"ann": ("fz", ""), "bob": ("", "")})
    assert run(matcher, 1.0, 2.0, {})[-1][1] == {}
    matcher.set_persons({"ann": ("", ""), "bob": ("", "")})
    assert run(matcher, 2.0, 3.0, {})[-1][1] == {"v1": (PERSON, "ann")}
    matcher.set_persons({"ann": ("", "v1"), "bob": ("", "")})
    assert run(matcher, 3.0, 4.0, {})[-1][1] == {"v1": (PERSON, "ann")}


def test_a_face_in_view_goes_before_somebody_who_was_lost_there():
    matcher = make(["fa"], ["v1", "v2"])
    for voice, y in (("v1", 0.0), ("v2", 2.0)):
        matcher.set_direction(voice, (2.0, y, 0.0), {(FACE, "fa"): (2.0, 0.0, 0.0), (PERSON, "ann"): (2.0, 0.0, 0.0),
                                                     (PERSON, "bob"): (2.0, 2.0, 0.0)})
        matcher.on_speaking(voice, True, 0.1)
    matcher.set_persons({}, ["ann", "bob"])
    assert run(matcher, 0.1, 1.0, {})[-1][1] == {"v1": (FACE, "fa"), "v2": (PERSON, "bob")}


def test_a_present_match_holds_where_a_new_one_would_not_begin():
    matcher = make(["fa"], ["v1"], min_likelihood=0.9)
    matcher.on_speaking("v1", True, 0.1)
    run(matcher, 0.1, 6.0, {"fa": moving})
    assert likelihood(matcher, 6.0, "v1") >= 0.9
    values = []
    for number in range(20):
        run(matcher, 6.0 + 0.1 * number, 6.1 + 0.1 * number, {"fa": still})
        values.append(likelihood(matcher, 6.1 + 0.1 * number, "v1"))
    assert values[-1] == 0.0 and any(0.5 <= value < 0.9 for value in values)
    assert not any(0.0 < value < 0.5 for value in values)


def test_time_that_jumps_back_starts_afresh():
    matcher = make(["fa"], ["v1"])
    matcher.on_speaking("v1", True, 100.0)
    run(matcher, 100.0, 103.0, {"fa": moving})
    assert matcher.matches(10.0) == []
    matcher.on_speaking("v1", True, 10.1)
    assert run(matcher, 10.1, 13.0, {"fa": moving})[-1][1] == {"v1": (FACE, "fa")}


def test_voices_and_faces_of_hours_leave_nothing_behind():
    matcher = make()
    for number in range(300):
        now, voice, name = 4.0 * number, "v%d" % number, "f%d" % number
        matcher.set_tracked("faces", [name])
        matcher.set_tracked("voices", [voice])
        matcher.on_speaking(voice, True, now)
        matcher.add_mouth(name, now, 0.5, 1.0)
        matcher.matches(now + 0.2)
        matcher.on_speaking(voice, False, now + 1.0)
    assert len(matcher._mouths) == 1 and len(matcher._past) < 10 and matcher.voices == ["v299"]


def heard_after_another(says_its_end):
    """Who the second voice is, after one that has left while it spoke, as when its node has ended."""
    matcher = make(["fa", "fb"], ["v1"])
    matcher.on_speaking("v1", True, 0.1)
    matcher.matches(2.0)
    if says_its_end:
        matcher.on_speaking("v1", False, 2.0)
    matcher.set_tracked("voices", [])
    matcher.set_tracked("voices", ["v2"])
    for begin in (12.0, 15.0, 18.0):
        matcher.on_speaking("v2", True, begin + 0.1)
        run(matcher, begin, begin + 1.0, {"fa": moving, "fb": moving})
        matcher.on_speaking("v2", False, begin + 1.1)
        run(matcher, begin + 1.0, begin + 3.0, {"fa": moving, "fb": still})
    return matcher.matches(21.0)


def test_a_voice_that_leaves_while_it_speaks_speaks_no_more():
    left = heard_after_another(says_its_end=False)
    assert [(match.voice, match.id) for match in left] == [("v2", "fb")] and left == heard_after_another(True)


def test_voices_that_leave_while_they_speak_leave_nothing_behind():
    matcher = make()
    for number in range(300):
        matcher.set_tracked("voices", ["v%d" % number])
        matcher.on_speaking("v%d" % number, True, 4.0 * number)
        matcher.matches(4.0 * number + 0.2)
    assert len(matcher._past) < 10


# -- the small ones

def test_there_is_something_to_compare_while_a_voice_speaks_and_just_after():
    matcher = make(voices=["va", "vb"])
    matcher.matches(100.0)
    assert not matcher.is_busy
    matcher.on_speaking("va", True, 101.0)
    assert matcher.is_busy
    matcher.on_speaking("va", False, 105.0)
    assert matcher.is_busy
    matcher.matches(107.0)
    assert not matcher.is_busy


def test_a_face_whose_mouth_is_never_seen_costs_no_other_face():
    matcher = make(["fa", "fb"], ["v1"])
    matcher.on_speaking("v1", True, 0.1)
    for number in range(30):
        matcher.add_mouth("fb", 0.1 * number, 0.5, 0.0)
    assert run(matcher, 0.1, 3.0, {"fa": moving})[-1][1] == {"v1": (FACE, "fa")}


def test_who_has_left():
    matcher = make()
    matcher.set_tracked("voices", ["va"])
    matcher.set_tracked("faces", ["fa"])
    assert not matcher.has_left(("va", FACE, "fa")) and not matcher.has_left(("va", PERSON, "ann"))
    assert matcher.has_left(("vb", PERSON, "ann")) and matcher.has_left(("va", FACE, "fb"))


@pytest.mark.parametrize("bad",
                         [(math.nan, 0.0, 0.0), (math.inf, 0.0, 0.0), (1e300, 1e300, 1e300), (1e200, -1e200, 0.0)])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_one_bad_place_costs_no_other_candidate(bad):
    found = []
    for places in ({}, {(FACE, "fb"): bad}):
        matcher = make(["fa", "fb"], ["v1"])
        matcher.on_speaking("v1", True, 0.06)
        matcher.set_direction("v1", (1.0, 0.0, 0.0), {(FACE, "fa"): (2.0, 0.0, 0.0), **places})
        run(matcher, 0.0, 2.0, {"fa": moving, "fb": still})
        found.append([(match.voice, match.id) for match in matcher.matches(2.0)])
    assert found == [[("v1", "fa")]] * 2


def plain_angles(direction, places):
    """Angle and distance of each place, by vectors."""
    return {key: (math.atan2(np.linalg.norm(np.cross(direction, place)), float(direction @ place)),
                  float(np.linalg.norm(place))) for key, place in places.items()}


def test_places_are_compared_by_angle_and_distance():
    random = np.random.default_rng(1)
    direction, places = random.normal(size=3), {(FACE, str(number)): random.normal(size=3) for number in range(50)}
    matcher = make(voices=["v1"])
    matcher.set_direction("v1", direction, places)
    found, expected = matcher._voices["v1"].angles, plain_angles(direction, places)
    assert found.keys() == expected.keys()
    assert np.array(list(found.values())) == pytest.approx(np.array(list(expected.values())))


def test_places_of_many_are_cheap():
    """Ten faces and ten persons are compared four times a second; it is a fifteenth (measured)."""
    random = np.random.default_rng(1)
    direction, places = random.normal(size=3), {(FACE, str(number)): random.normal(size=3) for number in range(20)}
    matcher = make(voices=["v1"])

    assert (least_cost(lambda: matcher.set_direction("v1", direction, places), 20)
            < 0.4 * least_cost(lambda: plain_angles(direction, places), 20))
