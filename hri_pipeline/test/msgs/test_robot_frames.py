"""Frames of the robot in tf2's buffer, which ends the process when it is given a time that it cannot reckon with."""

from __future__ import annotations

import subprocess
import sys

import genpy
import numpy as np
import pytest

from hri_pipeline.core.tf_scan import RawTransform
from hri_pipeline.ros.robot_frames import RobotFrames

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
                frames = RobotFrames("map")
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
    code = "import runpy, sys; sys.path[:0] = {!r}; runpy.run_path({!r})['use_wild_stamps']()".format(sys.path, __file__)
    ended = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE,
                           stderr=subprocess.PIPE, universal_newlines=True, check=False, timeout=120)
    assert (ended.returncode, ended.stdout) == (0, "alive\n"), ended.stderr[-2000:]


@pytest.mark.parametrize("bad", [link(2 ** 31 - 1), link(NOW, 10 ** 9), link(NOW, x=float("nan")), link(NOW, w=0.0),
                                 link(NOW, w=float("inf")), link(NOW, child="map"), link(NOW, child="")])
@pytest.mark.parametrize("fixed", [False, True])
def test_what_is_no_transform_is_refused(bad, fixed):
    frames = RobotFrames("map")
    with pytest.raises(ValueError):
        frames.put(bad, fixed)
    assert frames.known == 0


def test_the_latest_is_taken_for_a_stamp_that_is_none():
    frames = RobotFrames("map")
    frames.put(link(NOW, x=2.0), fixed=False)
    assert frames.lookup("camera", at(2 ** 32 - 1, 2 ** 32 - 1)).translation[0] == 2.0


@pytest.mark.parametrize("ahead", [11, 3600, 2 ** 31 - 2 - NOW])
def test_one_stamp_of_the_future_does_not_hold_the_frame(ahead):
    frames = RobotFrames("map")
    frames.put(RawTransform("map", "base", NOW, 0, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0, 1.0)), fixed=True)
    for second, x in ((0, 1.0), (ahead, 50.0), (1, 2.0), (2, 3.0)):
        frames.put(link(NOW + second, x=x)._replace(parent="base"), fixed=False)
        frames.lookup("camera", at(NOW + second))
    assert np.allclose(frames.lookup("camera", at(NOW + 1, 500000000)).translation, (2.5, 0.0, 1.0))
