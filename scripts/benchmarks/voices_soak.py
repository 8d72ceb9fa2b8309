"""Turns of speech by the thousand through the node `voices`: does it give everything back?

turns() is called by voices.py; run as a program, this file is the probe on the ROS graph that it starts:
voices_soak.py COUNT FILE. Time is simulated and goes SPEED times as fast as on the wall.
"""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Dict, List

import processes

DATA = Path("/usr/share/pocketsphinx/test/data")
SPEED = 8.0
WARM_UP = 200
"""Turns after which rospy, malloc and the recogniser have found their working size."""
PERIOD_S = 2.0
"""From one turn to the next, s of sound: longer than the word, and than the hangover that ends a turn."""
_AT_A_TIME = 50
_CHUNK_S = 0.02
_RATE = 16000


def turns(count: int = 1000) -> Dict[str, object]:
    """Growth of the node over `count` turns, WARM_UP more before them: fds, threads, rss_mb; rss_mb of its recogniser.

    Everybody's audio, features, speech and is_speaking are listened to. Raises StackRunError with the reason when there
    is no figure.
    """
    from benchmarks.stack_run import ROSMASTER, StackRun
    with StackRun() as run:
        run.start_master(ROSMASTER)
        found = run.begin("turns", "voices_soak", count)(120.0 + 10.0 * (count + WARM_UP) * PERIOD_S / SPEED)
    run.remove_logs()
    return found


class _Speaker:
    """Says the same word again and again, on `audio`, with the simulated clock."""

    def __init__(self) -> None:
        import numpy as np
        import rospy
        from audio_common_msgs.msg import AudioData
        from rosgraph_msgs.msg import Clock

        said = np.fromfile(str(DATA / "goforward.raw"), "<i2")[int(0.4 * _RATE):int(1.3 * _RATE)]
        noise = np.random.default_rng(0).normal(0.0, 8.0, int(PERIOD_S * _RATE))
        noise[:len(said)] += said
        sound, size = np.rint(noise).astype("<i2"), int(_CHUNK_S * _RATE)
        self._chunks = [AudioData(data=sound[start:start + size].tobytes()) for start in range(0, len(sound), size)]
        self._clock = rospy.Publisher("/clock", Clock, queue_size=10)
        self._audio = rospy.Publisher("audio", AudioData, queue_size=1000)
        self._now = 1000.0
        self._make_clock = lambda now: Clock(clock=rospy.Time.from_sec(now))

    def is_heard(self) -> bool:
        """Tell whether the node listens."""
        self.tick()
        return self._audio.get_num_connections() > 0

    def speak(self, count: int) -> int:
        """Speak so many times; returns how often."""
        begin = time.monotonic()
        for number, chunk in enumerate(self._chunks * count, 1):
            time.sleep(max(0.0, begin + number * _CHUNK_S / SPEED - time.monotonic()))
            self.tick()
            self._audio.publish(chunk)
        return count

    def tick(self) -> None:
        """Let time go on a little."""
        self._now += _CHUNK_S
        self._clock.publish(self._make_clock(self._now))


class _Listener:
    """Listens to everything that voices give, and counts."""

    def __init__(self) -> None:
        from audio_common_msgs.msg import AudioData
        from std_msgs.msg import Bool, String

        from hri_msgs.msg import AudioFeatures
        from hri_pipeline.ros.subscriptions import IdSubscribers

        self.seen: set = set()
        self.counts = {"audio": 0, "features": 0, "speech": 0, "is_speaking": 0}
        self._lock = threading.Lock()
        self._feed = IdSubscribers("voices", {"audio": AudioData, "features": AudioFeatures, "speech": String,
                                              "is_speaking": Bool}, self._on_message, self.seen.update, queue_size=100)

    @property
    def ids(self) -> List[str]:
        """Ids that are tracked now."""
        return self._feed.ids

    def _on_message(self, identity: str, name: str, message: object) -> None:
        with self._lock:
            self.counts[name] += 1


def _wait(condition, seconds: float, what: str) -> None:
    if not processes.wait_until(condition, seconds):
        raise RuntimeError("not within {:g} s: {}".format(seconds, what))


def _held(pid: int) -> Dict[str, float]:
    """Descriptors, threads and resident memory (MB) of a process, and the memory of its children.

    RuntimeError: it has ended.
    """
    import psutil

    from benchmarks.stack_run import usage
    try:
        children = psutil.Process(pid).children()
    except psutil.Error:
        children = []
    mine, theirs = usage(pid), [usage(child.pid) for child in children]
    if mine is None:
        raise RuntimeError("the node has ended")
    return {"fds": float(mine.fds), "threads": float(mine.threads), "rss_mb": mine.rss_mb,
            "children_rss_mb": sum(one.rss_mb for one in theirs if one is not None)}


def _probe(count: int) -> Dict[str, object]:
    """Start the node, let somebody speak, and compare what it holds."""
    from xmlrpc.client import ServerProxy

    import rosgraph
    import rospy

    master = rosgraph.Master("/voices_probe")
    _wait(master.is_online, 20.0, "the master")
    master.setParam("/use_sim_time", True)
    node = subprocess.Popen(["rosrun", "hri_pipeline", "voices", "_direction:=false", "_resume_time:=0.0",
                             "_voice_timeout:=1.0",
                             "_speech_grammar:={}".format(DATA / "goforward.gram")])
    rospy.init_node("voices_probe", disable_signals=True)
    listener, speaker = _Listener(), _Speaker()
    _wait(speaker.is_heard, 60.0, "the node listens")
    pid = ServerProxy(master.lookupNode("/hri_voices")).getPid("/voices_probe")[2]

    def round_of(number: int) -> Dict[str, float]:
        # On a busy machine some turns run together: go on until so many have been heard.
        goal, most = len(listener.seen) + number, spoken[0] + 3 * number
        while len(listener.seen) < goal and spoken[0] < most:
            spoken[0] += speaker.speak(min(_AT_A_TIME, goal - len(listener.seen)))
        _wait(lambda: speaker.tick() or not listener.ids, 60.0, "all voices have gone")
        return _settled(pid)

    spoken = [0]
    before = round_of(WARM_UP)
    warm, spoken_before = len(listener.seen), spoken[0]
    begun = time.monotonic()
    after = round_of(count)
    found: Dict[str, object] = {
        "turns": len(listener.seen) - warm, "turns_spoken": spoken[0] - spoken_before,
        "seconds": time.monotonic() - begun,
        "speed": SPEED, "messages": dict(listener.counts)}
    for name, value in after.items():
        found[name + "_growth"] = round(value - before[name], 2)
        found[name] = round(value, 2)
    node.terminate()
    found["exit_code"] = node.wait(timeout=20.0)
    return found


def _settled(pid: int) -> Dict[str, float]:
    """What a process holds, when it has let go of what it lets go of within seconds: the least of several looks."""
    looks = []
    for _ in range(20):
        looks.append(_held(pid))
        time.sleep(0.25)
    return {name: min(look[name] for look in looks) for name in looks[0]}


if __name__ == "__main__":
    Path(sys.argv[2]).write_text(json.dumps(_probe(int(sys.argv[1]))), encoding="utf-8")
