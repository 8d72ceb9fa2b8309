"""Which turn is which voice, and until when a voice is tracked."""

import numpy as np
import pytest

from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.parameters import ParameterTable
from hri_pipeline.core.voices.voice_lives import VoiceLives, angle_between
from hri_pipeline.core.voices.voice_stage_parameters import VOICE_STAGE_PARAMETERS

TABLE = ParameterTable("activity", "Activity.", VOICE_STAGE_PARAMETERS)


def lives(**changes):
    values = dict({"voice_timeout": 3.0, "resume_time": 2.0, "resume_angle": 0.35}, **changes)
    return VoiceLives(TABLE.resolve(values), IdGenerator(seed=1))


def towards(degrees):
    angle = np.deg2rad(degrees)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def spoken(book, key, stamp, direction=None, short=False):
    """A turn of 1 s that begins at `stamp`; returns the id."""
    voice = book.begin(key, stamp, direction, None if direction is None else 0.1)
    book.heard(voice, stamp + 1.0, direction, None if direction is None else 0.1)
    book.end(voice, short)
    return voice.id


@pytest.mark.parametrize("resume_time, pause, same", [
    (2.0, 0.7, True), (2.0, 2.0, True), (2.0, 2.1, False), (0.0, 0.01, False), (60.0, 2.9, True),
    (60.0, 3.1, False),                        # not tracked any more
])
def test_one_microphone(resume_time, pause, same):
    book = lives(resume_time=resume_time)
    first = spoken(book, 0, 10.0)
    second = spoken(book, 0, 11.0 + pause)
    assert (first == second) is same
    assert len(book.tracked) == (1 if same else 2), "the first is tracked on for its time"


def test_the_voice_that_spoke_last_goes_on():
    book = lives(resume_time=1.0)
    first, second = spoken(book, 0, 0.0), spoken(book, 0, 2.1)
    assert first != second
    assert spoken(book, 0, 3.2) == second


@pytest.mark.parametrize("key, degrees, pause, same", [
    (1, 0.0, 2.5, True), (1, 60.0, 2.5, True),    # the source is followed: whoever walks while silent
    (2, 15.0, 2.5, True), (2, 25.0, 2.5, False), (2, 15.0, 3.1, False), (1, 0.0, 3.1, False),
])
def test_an_array(key, degrees, pause, same):
    book = lives(resume_time=0.0)
    first = spoken(book, 1, 0.0, towards(0.0))
    assert (spoken(book, key, 1.0 + pause, towards(degrees)) == first) is same


def test_the_nearest_voice_goes_on():
    book = lives()
    left, right = spoken(book, 1, 0.0, towards(10.0)), spoken(book, 2, 0.1, towards(-10.0))
    assert spoken(book, 3, 1.5, towards(-4.0)) == right
    assert spoken(book, 4, 1.6, towards(4.0)) == left


def test_a_voice_in_its_turn_is_nobody_elses():
    book = lives()
    first = book.begin(1, 0.0, towards(0.0), 0.1)
    second = book.begin(2, 0.5, towards(5.0), 0.1)
    assert first.id != second.id and book.tracked == (first.id, second.id)


def test_a_voice_is_let_go_after_its_time():
    book = lives()
    voice = book.begin(0, 0.0)
    book.expire(100.0)
    assert book.tracked == (voice.id,), "not while it has the word"
    book.heard(voice, 100.0, None, None)
    book.heard(voice, 99.0, None, None)
    book.end(voice, short=False)
    book.expire(103.0)
    assert book.tracked == (voice.id,)
    book.expire(103.01)
    assert book.tracked == ()


def test_a_noise_is_let_go_at_once_unless_the_voice_is_known():
    book = lives()
    spoken(book, 0, 0.0, short=True)
    assert book.tracked == ()
    first = spoken(book, 0, 10.0)
    assert spoken(book, 0, 11.5, short=True) == first
    assert book.tracked == (first,)


def test_the_direction_is_the_last_that_was_heard():
    book = lives()
    voice = book.begin(1, 0.0, towards(0.0), 0.1)
    book.heard(voice, 0.5, towards(10.0), 0.2)
    book.heard(voice, 0.6, None, None)
    np.testing.assert_allclose(voice.direction, towards(10.0))
    assert voice.direction_sd == 0.2


def test_silent_and_clear():
    book = lives()
    spoken(book, 0, 0.0)
    speaking = book.begin(1, 0.5, towards(0.0), 0.1)
    assert [voice.key for voice in book.silent] == [0]
    book.end(speaking, short=False)
    assert len(book.silent) == 2
    book.clear()
    assert book.tracked == ()


@pytest.mark.parametrize("degrees", [0.0, 1e-3, 45.0, 90.0, 180.0])
def test_angle(degrees):
    assert angle_between(towards(0.0), towards(degrees)) == pytest.approx(np.deg2rad(degrees), abs=1e-9)
