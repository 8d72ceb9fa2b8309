"""The robot's own voice: when it speaks, from where, and who is heard meanwhile."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hri_pipeline.core.audio.own_voice import BargeInFilter, RobotSpeech, hear_humans
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.separation import SourceSignal
from hri_pipeline.core.audio.stream import RATE, SoundBlock

SETTINGS = VOICES.resolve({"barge_in_margin": 0.0, "robot_tail": 0.4, "robot_speaking_timeout": 10.0})
STEP = 512
STEP_S = STEP / RATE


@pytest.fixture
def robot():
    return RobotSpeech(SETTINGS)


def test_it_speaks_from_its_word_until_the_tail_behind_its_end(robot):
    assert not robot.speaks(0.0, 1000.0)
    robot.tell(True, 100.0)
    assert robot.speaks(99.0, 100.0) and robot.speaks(105.0, 105.1) and not robot.speaks(98.0, 99.9)
    robot.tell(True, 104.0)
    robot.tell(False, 106.0)
    assert robot.speaks(106.3, 106.4) and robot.speaks(101.0, 101.1) and not robot.speaks(106.5, 106.6)
    robot.tell(False, 200.0)
    assert not robot.speaks(199.0, 201.0) and robot.problem == ""


def test_a_word_that_is_not_taken_back_is_believed_for_a_while_only(robot):
    robot.tell(True, 100.0)
    robot.update(109.0, connected=True)
    assert robot.speaks(109.0, 109.1)
    robot.tell(True, 109.0)
    robot.update(118.0, connected=True)
    assert robot.speaks(118.0, 118.1)
    robot.update(119.5, connected=True)
    assert not robot.speaks(119.5, 119.6) and "more than 10 s" in robot.problem
    robot.tell(True, 130.0)
    assert robot.speaks(130.0, 130.1) and robot.problem == ""


def test_a_publisher_that_dies_ends_it(robot):
    robot.tell(True, 100.0)
    robot.update(101.0, connected=False)
    assert robot.speaks(101.2, 101.3) and not robot.speaks(101.5, 101.6) and "publisher has gone" in robot.problem
    robot.update(102.0, connected=False)
    robot.tell(False, 103.0)
    assert robot.problem == ""


def test_a_publisher_that_goes_while_the_robot_is_silent_is_no_problem(robot):
    robot.tell(True, 100.0)
    robot.tell(False, 101.0)
    for stamp in (102.0, 200.0):
        robot.update(stamp, connected=False)
    assert robot.problem == "" and not robot.speaks(102.0, 200.0)


def test_a_word_that_is_repeated_for_ever_is_told(robot):
    for stamp in np.arange(100.0, 219.0, 0.1):
        robot.tell(True, stamp)
    robot.update(219.0, connected=True)
    assert robot.long_speech(219.0) == "" and robot.problem == ""
    for stamp in np.arange(219.0, 230.0, 0.1):
        robot.tell(True, stamp)
    assert "for 130 s without a pause" in robot.long_speech(230.0)
    robot.tell(False, 230.0)
    assert robot.long_speech(230.5) == ""


def test_sound_that_is_played_without_a_pause_is_told(robot):
    for number in range(1300):
        robot.play(0.1 * np.ones(RATE // 10, np.float32), 100.0 + 0.1 * number)
    assert robot.long_speech(210.0) == "" and "for 130 s" in robot.long_speech(230.0)
    assert robot.long_speech(231.0) == ""


def test_what_it_has_said_for_hours_is_not_kept(robot):
    for stamp in np.arange(0.0, 3600.0, 4.0):
        robot.tell(True, stamp)
        robot.tell(False, stamp + 1.0)
    assert len(robot._spans) < 20 and robot.speaks(3590.0, 3600.0)


def test_a_longer_tail_counts_at_once(robot):
    robot.tell(True, 100.0)
    robot.tell(False, 101.0)
    assert not robot.speaks(102.0, 102.1)
    robot.reconfigure(VOICES.resolve({"robot_tail": 2.0}))
    assert robot.speaks(102.0, 102.1)


def test_time_that_goes_back_begins_anew(robot):
    robot.tell(True, 100.0)
    robot.tell(False, 50.0)
    assert not robot.speaks(50.0, 200.0)


def test_what_it_plays_counts_and_its_pauses_do_not(robot):
    sound = 0.1 * np.ones(RATE // 10, np.float32)
    for number in range(5):
        robot.play(sound, 100.0 + 0.1 * number)
    robot.play(5e-3 * sound, 100.5)         # -66 dBFS
    assert robot.speaks(100.2, 100.3) and robot.speaks(100.85, 100.89)
    assert not robot.speaks(99.0, 99.9) and not robot.speaks(100.91, 101.1)
    robot.play(2e-2 * sound, 102.0)         # -54 dBFS
    assert robot.speaks(102.0, 102.1) and not robot.speaks(101.0, 101.9)


class Separator:
    """Gives the sources that a test asks for: {key: (azimuth in degrees, level)}."""

    def __init__(self):
        self.sources, self.resets, self.settings = {}, 0, None

    def process(self, samples):
        return [SourceSignal(key, np.full(len(samples), level, np.float32), -32, direction(degrees), 0.1, True)
                for key, (degrees, level) in self.sources.items()]

    def reset(self):
        self.resets += 1

    def reconfigure(self, settings):
        self.settings = settings


def direction(degrees):
    return np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0])


class Scene:
    def __init__(self, robot):
        self.robot, self.array, self.time = robot, Separator(), 100.0
        self.filter = BargeInFilter(self.array, robot, SETTINGS)

    def play(self, seconds, step=STEP, **sources):
        """Return {key: samples that come through}; sources: number=(degrees, level); step: samples at a time."""
        self.array.sources = {int(name[1:]): source for name, source in sources.items()}
        heard = {}
        for _ in range(int(round(seconds * RATE / step))):
            self.filter.stamp = self.time
            for signal in self.filter.process(np.zeros((step, 4), np.float32)):
                begin = self.time + signal.offset / RATE
                heard.setdefault(signal.key, []).append((begin, len(signal.samples)))
            self.time += step / RATE
        for parts in heard.values():
            ends = [begin + length / RATE for begin, length in parts]
            assert np.allclose([begin for begin, _ in parts[1:]], ends[:-1]), "nothing is missing, nothing comes twice"
        return {key: sum(length for _, length in parts) / RATE for key, parts in heard.items()}


@pytest.fixture
def scene(robot):
    return Scene(robot)


def test_while_the_robot_is_silent_everybody_is_heard(scene):
    assert set(scene.play(1.0, s1=(0.0, 0.1), s2=(90.0, 0.01))) == {1, 2}


def test_the_robot_is_not_heard_and_its_echo_neither(scene):
    scene.robot.tell(True, 100.0)
    assert scene.play(3.0, s1=(0.0, 0.1), s2=(120.0, 0.04)) == {}
    scene.robot.tell(False, scene.time)
    scene.play(0.5, s1=(0.0, 0.05))
    assert set(scene.play(0.5, s1=(0.0, 0.1))) == {1}, "somebody in front of the loudspeaker is heard afterwards"


@pytest.mark.parametrize("degrees, level, heard", [
    (120.0, 0.2, True), (120.0, 0.12, True), (120.0, 0.1, False), (120.0, 0.08, False), (15.0, 0.2, False),
    (40.0, 0.2, True)])
def test_who_is_louder_and_elsewhere_is_heard(scene, degrees, level, heard):
    scene.robot.tell(True, 100.0)
    scene.play(2.0, s1=(0.0, 0.1))
    found = scene.play(1.0, s1=(0.0, 0.1), s2=(degrees, level))
    assert set(found) == ({2} if heard else set())
    if heard:
        assert found[2] == pytest.approx(1.0, abs=2 * STEP_S), "the begin is kept"
        assert scene.play(0.5, s1=(0.0, 0.1), s2=(degrees, 0.05)) == {2: pytest.approx(0.5, abs=STEP_S)}


@pytest.mark.parametrize("changes", [{"barge_in_angle": 3.0}, {"barge_in_margin": 20.0}])
def test_changed_settings_decide_who_is_heard_at_once(scene, changes):
    scene.robot.tell(True, 100.0)
    scene.play(2.0, s1=(0.0, 0.1))
    changed = VOICES.resolve(changes)
    scene.filter.reconfigure(changed)
    assert scene.play(1.0, s1=(0.0, 0.1), s2=(120.0, 0.2)) == {} and scene.array.settings is changed


def test_a_short_bang_is_nobody(scene):
    scene.robot.tell(True, 100.0)
    scene.play(2.0, s1=(0.0, 0.1))
    for _ in range(5):
        assert scene.play(0.1, s1=(0.0, 0.1), s2=(120.0, 0.5)) == {}
        assert scene.play(0.3, s1=(0.0, 0.1), s2=(120.0, 0.01)) == {}


def test_who_was_heard_while_the_robot_spoke_has_to_be_louder_again_the_next_time(scene):
    for loud, heard in ((0.2, {2}), (0.05, set())):
        scene.robot.tell(True, scene.time)
        scene.play(2.0, s1=(0.0, 0.1))
        assert set(scene.play(1.0, s1=(0.0, 0.1), s2=(120.0, loud))) == heard
        scene.robot.tell(False, scene.time)
        assert set(scene.play(1.0, s2=(120.0, 0.05))) == {2}


def test_who_speaks_over_the_robot_for_long_is_not_taken_for_it(scene):
    scene.robot.tell(True, 100.0)
    scene.play(2.0, s1=(0.0, 0.1))
    assert set(scene.play(10.0, s1=(0.0, 0.1), s2=(120.0, 0.2))) == {2}
    scene.filter.reset()
    assert set(scene.play(1.0, s1=(0.0, 0.1), s3=(120.0, 0.2))) == {3}


def test_where_the_robot_is_not_heard_any_more_people_are_heard(scene):
    """A head that turns takes its loudspeaker along."""
    scene.robot.tell(True, 100.0)
    scene.play(16.0, s1=(0.0, 0.1), step=RATE // 4)
    scene.play(40.0, s1=(90.0, 0.1), step=RATE // 4)
    assert set(scene.play(1.0, s1=(90.0, 0.1), s2=(0.0, 0.2))) == {2}


def test_nobody_is_heard_before_the_place_of_the_robot_is_known(scene):
    scene.robot.tell(True, 100.0)
    assert scene.play(0.25, s2=(120.0, 0.5)) == {}
    scene.robot.tell(False, scene.time)


def test_the_place_of_the_robot_outlives_a_reset(scene):
    scene.robot.tell(True, 100.0)
    scene.play(2.0, s1=(0.0, 0.1))
    scene.filter.reset()
    assert scene.array.resets == 1 and set(scene.play(0.5, s1=(0.0, 0.1), s3=(120.0, 0.3))) == {3}


def test_sources_without_a_direction_are_the_robot(scene, monkeypatch):
    scene.robot.tell(True, 100.0)
    monkeypatch.setattr(scene.array, "process", lambda samples: [
        SourceSignal(1, np.full(len(samples), 0.3, np.float32), 0, None, 0.1, True)])
    assert scene.play(1.0) == {}


class Pipeline:
    def __init__(self):
        self.calls = []

    def update(self, block):
        self.calls.append("sound")
        return []

    def idle(self, stamp):
        self.calls.append(stamp)
        return []


def test_without_an_array_the_sound_of_the_robot_is_a_pause(robot):
    pipeline = Pipeline()
    robot.tell(True, 100.0)
    for stamp in (99.0, 100.0, 101.0):
        hear_humans(pipeline, robot, None, SoundBlock(np.zeros((RATE // 10, 1), np.float32), stamp))
    robot.tell(False, 101.1)
    hear_humans(pipeline, robot, None, SoundBlock(np.zeros((RATE // 10, 1), np.float32), 102.0))
    assert pipeline.calls == ["sound", 100.1, 101.1, "sound"]


def test_with_an_array_the_sound_of_the_robot_goes_through_the_filter_at_its_time(scene):
    pipeline = Pipeline()
    scene.robot.tell(True, 100.0)
    hear_humans(pipeline, scene.robot, scene.filter, SoundBlock(np.zeros((RATE // 10, 4), np.float32), 103.0))
    assert pipeline.calls == ["sound"] and scene.filter.stamp == 103.0
