"""Frames of the robot: what is refused, stamps of any kind, and the same poses as tf2's buffer gives."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import genpy
import numpy as np
import pytest
import rospy
import tf2_py
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3

from hri_pipeline.core.frames import FrameHistory, RawTransform
from hri_pipeline.ros import tf
from hri_pipeline.ros.conversions import pose_from_transform
from hri_pipeline.ros.tf import HISTORY_S, RobotTf, TfPublisher
from hri_pipeline.testing import held_by

NOW = 1700000000
WILD = (0, 2 ** 31 - 2, 2 ** 31 - 1, 2 ** 31, 4294967200, 2 ** 32 - 1)
NANOSECONDS = (0, 999999999, 10 ** 9, 2 ** 32 - 1)


def link(secs, nsecs=0, x=1.0, w=1.0, child="camera"):
    return RawTransform("map", child, secs, nsecs, (x, 0.0, 0.0), (0.0, 0.0, 0.0, w))


def at(secs, nsecs=0):
    time = genpy.Time()
    time.secs, time.nsecs = secs, nsecs     # as read from a message: unlike the constructor, nothing is checked
    return time


def use_wild_stamps():
    """Every order of two wild stamps and a good one, put and looked up; run in a process of its own."""
    stamps = [(secs, nsecs) for secs in WILD for nsecs in NANOSECONDS]
    for fixed in (False, True):
        for first in stamps:
            for second in stamps:
                frames = RobotTf("map")
                for stamp in (first, (NOW, 0), second, (NOW + 1, 0)):
                    try:
                        frames.put(link(*stamp), fixed)
                    except ValueError:
                        pass
                    for wild in (first, second):
                        frames.lookup("camera", at(*wild))
                pose = frames.lookup("camera", at(NOW + 1))
                assert pose is not None and pose.translation[0] == 1.0
    print("alive")


def test_no_stamp_ends_the_process():
    code = "import runpy, sys; sys.path[:0] = {!r}; runpy.run_path({!r})['use_wild_stamps']()".format(
        sys.path, __file__
    )
    ended = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE,
                           stderr=subprocess.PIPE, universal_newlines=True, check=False, timeout=120)
    assert (ended.returncode, ended.stdout) == (0, "alive\n"), ended.stderr[-2000:]


@pytest.mark.parametrize("bad", [link(2 ** 31 - 1), link(NOW, 10 ** 9), link(NOW, x=float("nan")), link(NOW, w=0.0),
                                 link(NOW, w=float("inf")), link(NOW, child="map"), link(NOW, child="")])
@pytest.mark.parametrize("fixed", [False, True])
def test_what_is_no_transform_is_refused(bad, fixed):
    frames = RobotTf("map")
    with pytest.raises(ValueError):
        frames.put(bad, fixed)
    assert frames.known == 0


def test_the_latest_is_taken_for_a_stamp_that_is_none():
    frames = RobotTf("map")
    frames.put(link(NOW, x=2.0), fixed=False)
    assert frames.lookup("camera", at(2 ** 32 - 1, 2 ** 32 - 1)).translation[0] == 2.0


@pytest.mark.parametrize("ahead", [11, 3600, 2 ** 31 - 2 - NOW])
def test_one_stamp_of_the_future_does_not_hold_the_frame(ahead):
    frames = RobotTf("map")
    frames.put(RawTransform("map", "base", NOW, 0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)), fixed=True)
    for second, x in ((0, 1.0), (ahead, 50.0), (1, 2.0), (2, 3.0)):
        frames.put(link(NOW + second, x=x)._replace(parent="base"), fixed=False)
        frames.lookup("camera", at(NOW + second))
    assert np.allclose(frames.lookup("camera", at(NOW + 1, 500000000)).translation, (2.5, 0.0, 1.0))


def test_what_is_closed_leaves_no_memory_behind():
    """A buffer of tf2 is never freed; conversations and questions of a client need one for a while."""
    def use(count):
        for _ in range(count):
            frames = RobotTf("map")
            for number in range(30):
                frames.put(link(NOW, child="frame{}".format(number)), fixed=number % 2 == 0)
            assert frames.lookup("frame7", at(NOW)) is not None
            frames.close()
            frames.close()
            assert frames.lookup("frame7", at(NOW)) is None

    use(20)
    before = held_by(os.getpid()).rss_mb
    use(400)
    assert held_by(os.getpid()).rss_mb - before < 4.0


def random_link(rng, child, number, parents):
    turn = rng.normal(size=4)
    return RawTransform(parents[child], child, NOW + number, int(rng.integers(10 ** 9)),
                        tuple(rng.normal(size=3).tolist()), tuple((turn / np.linalg.norm(turn)).tolist()))


@pytest.mark.parametrize("seed", range(20))
def test_the_history_says_what_tf2_says(seed):
    rng = np.random.default_rng(seed)
    names = ["map"] + ["frame{}".format(number) for number in range(6)]
    parents = {child: names[int(rng.integers(number + 1))] for number, child in enumerate(names[1:])}
    history, buffer = FrameHistory(HISTORY_S), tf2_py.BufferCore(rospy.Duration(HISTORY_S))
    for name in names:
        history.follow(name)
    for number in range(14):
        for child in names[1:]:
            fixed = child == "frame2"
            if not fixed and rng.random() < 0.2:
                continue
            transform = random_link(rng, child, number, parents)
            history.put(transform, fixed)
            message = TransformStamped(child_frame_id=child)
            message.header.frame_id, message.header.stamp = transform.parent, genpy.Time(
                transform.secs, transform.nsecs
            )
            message.transform.translation = Vector3(*transform.translation)
            message.transform.rotation = Quaternion(*transform.rotation)
            (buffer.set_transform_static if fixed else buffer.set_transform)(message, "test")
    compared = 0
    for _ in range(200):
        target, frame = (names[index] for index in rng.choice(len(names), 2, replace=False))
        for time in (genpy.Time(), at(NOW + int(rng.integers(0, 15)), int(rng.integers(10 ** 9)))):
            pose = history.between(target, frame, time.to_sec() or None)
            try:
                wanted = pose_from_transform(buffer.lookup_transform_core(target, frame, time))
            except tf2_py.TransformException:
                assert pose is None
                continue
            compared += 1
            assert pose is not None
            assert np.allclose(pose.translation, wanted.translation, atol=1e-5)
            assert np.allclose(pose.rotation, wanted.rotation, atol=1e-5)
    assert compared > 100


def test_the_next_one_knows_nothing_of_before():
    first = RobotTf("map")
    first.put(link(NOW, child="arm"), fixed=True)
    first.put(link(NOW), fixed=False)
    first.close()
    second = RobotTf("map")
    assert [second.lookup(frame, at(NOW)) for frame in ("arm", "camera")] == [None, None]
    second.put(link(NOW - 1000, x=3.0), fixed=False)
    assert second.lookup("camera", at(NOW - 1000)).translation[0] == 3.0


@pytest.mark.parametrize("again", [True, False])
def test_a_fixed_frame_may_become_a_moving_one(again):
    frames = RobotTf("map")
    frames.put(link(NOW, x=1.0), fixed=True)
    frames.put(link(NOW, x=5.0, child="arm"), fixed=True)
    assert frames.lookup("camera", at(NOW + 1)).translation[0] == 1.0 and frames.lookup("arm", at(NOW)) is not None
    if again:       # the same buffer, for somebody else
        frames.close()
        frames = RobotTf("map")
        frames.put(link(NOW, x=5.0, child="arm"), fixed=True)
        assert frames.lookup("camera", at(NOW)) is None and frames.lookup("arm", at(NOW)) is not None
    frames.put(link(NOW + 1, x=2.0), fixed=False)
    frames.put(link(NOW + 2, x=3.0), fixed=False)
    assert frames.lookup("camera", at(NOW + 1)).translation[0] == 2.0
    assert frames.lookup("arm", at(NOW + 1)).translation[0] == 5.0
    frames.reset()
    assert frames.lookup("camera", at(NOW + 1)) is None and frames.lookup("arm", at(NOW + 1)) is not None


def panned(history, until, hz=50.0, speed=1.5, jump_at=None, frame="camera"):
    """Put a frame that turns at `speed` rad/s, or is turned at once by 0.1 rad."""
    for step in range(int(until * hz) + 1):
        turn = speed * step / hz if jump_at is None else 0.1 * (step / hz >= jump_at)
        stamp = NOW + step / hz
        history.put(RawTransform("map", frame, int(stamp), int(round(stamp % 1.0 * 1e9)), (0.0, 0.0, 1.0),
                                 (0.0, 0.0, math.sin(turn / 2.0), math.cos(turn / 2.0))), fixed=False)


def turn_of(pose):
    return math.atan2(pose.rotation[1, 0], pose.rotation[0, 0])


@pytest.mark.parametrize("hz", [10.0, 50.0])
def test_a_camera_that_pans_goes_on_where_its_transforms_come_late(hz):
    frames = RobotTf("map")
    frames.lookup("camera", at(NOW))
    panned(frames, 1.0, hz)
    for late in (0.05, 0.15):
        stamp = at(NOW + 1, int(late * 1e9))
        assert turn_of(frames.lookup("camera", stamp)) == pytest.approx(1.5 * (1.0 + late), abs=1e-3)
        assert frames.lags("camera", stamp)
    assert turn_of(frames.lookup("camera", at(NOW + 5))) == pytest.approx(1.5 * 1.2, abs=1e-3)
    assert not frames.lags("camera", at(NOW + 5)) and not frames.lags("camera", at(NOW))
    assert turn_of(frames.lookup("camera", at(0))) == pytest.approx(1.5, abs=1e-3)


def test_a_jump_of_the_localisation_does_not_go_on():
    frames = RobotTf("map")
    frames.lookup("camera", at(NOW))
    panned(frames, 1.0, jump_at=0.98)
    assert turn_of(frames.lookup("camera", at(NOW + 1, 10 ** 8))) == pytest.approx(0.1, abs=1e-6)


def test_what_stands_is_not_waited_for():
    frames = RobotTf("map")
    frames.lookup("camera", at(NOW))
    panned(frames, 1.0, speed=0.0)
    assert not frames.lags("camera", at(NOW + 1, 10 ** 8))


def test_a_localisation_that_comes_once_a_second_holds_nobody_back():
    frames = RobotTf("map")
    frames.put(link(NOW, child="odom"), fixed=False)
    frames.put(link(NOW + 0, x=0.0, child="odom"), fixed=False)
    for step in range(50):
        stamp, turn = NOW + step / 50.0, 1.5 * step / 50.0
        frames.put(RawTransform("odom", "camera", int(stamp), int(round(stamp % 1.0 * 1e9)), (0.0, 0.0, 1.0),
                                (0.0, 0.0, math.sin(turn / 2.0), math.cos(turn / 2.0))), fixed=False)
        frames.lookup("camera", at(NOW))
    assert turn_of(frames.lookup("camera", at(NOW, 900000000))) == pytest.approx(1.35, abs=1e-3)
    assert not frames.lags("camera", at(NOW, 900000000))


class Clocks:
    """The graph's time and the wall's, s."""

    now = wall = 1000.0


@pytest.fixture
def clocks(monkeypatch):
    clocks = Clocks()
    monkeypatch.setattr(rospy, "get_time", lambda: clocks.now)
    monkeypatch.setattr(tf.time, "monotonic", lambda: clocks.wall)
    return clocks


@pytest.fixture
def sent(monkeypatch):
    """A publisher whose messages are kept, and (child, seconds) of what was sent."""
    found = []

    class Topic:
        def __init__(self, name, kind, queue_size):
            pass

        def publish(self, message):
            found.extend((one.child_frame_id, one.header.stamp.to_sec()) for one in message.transforms)

    monkeypatch.setattr(rospy, "Publisher", Topic)
    return TfPublisher(), found


def send(publisher, *stamps, child="person_a"):
    for stamp in stamps:
        transform = TransformStamped(child_frame_id=child)
        transform.header.stamp = genpy.Time.from_sec(stamp)
        transform.transform.rotation.w = 1.0
        publisher.send([transform])


def test_no_frame_is_sent_twice_for_one_stamp_and_none_after_a_newer_one(sent, clocks):
    publisher, found = sent
    # Two images of the face, the same ones of the body a little later, the time of now in a silence, and a late image.
    send(publisher, 10.0, 10.125, 10.0, 10.125, 10.25, 12.0, 11.5, 12.0, 12.25)
    send(publisher, 10.0, child="person_b")
    assert found == [("person_a", stamp) for stamp in (10.0, 10.125, 10.25, 12.0, 12.25)] + [("person_b", 10.0)]
    assert publisher.dropped == 4


def test_frames_are_sent_again_when_the_clock_has_gone_back(sent, clocks):
    publisher, found = sent
    send(publisher, 1000.0)
    clocks.now = 980.0
    send(publisher, 979.875)
    assert [stamp for _, stamp in found] == [1000.0, 979.875]


def test_frames_are_sent_again_when_only_older_stamps_come_for_long(sent, clocks):
    publisher, found = sent
    send(publisher, 1000.0)
    for _ in range(12):
        clocks.now, clocks.wall = clocks.now + 1.0, clocks.wall + 1.0
        send(publisher, clocks.now - 100.0)
    assert [stamp for _, stamp in found] == [1000.0, 911.0, 912.0]
    publisher.reset()
    send(publisher, 800.0)
    assert found[-1] == ("person_a", 800.0)
