"""Measures /people with ten people: `python3 -m benchmarks.people_probe SECONDS FILE` beside a person manager with
people_msgs:=true."""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from typing import List

import rospy
from people_msgs.msg import People
from processes import wait_until

from benchmarks.persons_world import FeatureSource

PEOPLE, RATE_HZ = 10, 15.0


def main() -> int:
    """Measure, and write one JSON object."""
    seconds, path = float(sys.argv[1]), Path(sys.argv[2])
    rospy.init_node("people_probe")
    source = FeatureSource()
    faces = ["face{}".format(number) for number in range(PEOPLE)]
    source.show(faces=faces)
    stop = threading.Event()

    def place() -> None:
        while not stop.wait(1.0 / RATE_HZ):
            source.place(faces)

    threading.Thread(target=place, daemon=True).start()
    heard: List[float] = []
    subscriber = rospy.Subscriber(
        "/people", People, lambda message: len(message.people) == PEOPLE and heard.append(time.monotonic()))
    try:
        if not wait_until(lambda: len(heard) > 5, 30.0):
            print("people_probe: ten people do not come on /people", file=sys.stderr)
            return 1
        del heard[:]
        wait_until(lambda: bool(heard) and heard[-1] - heard[0] > seconds, seconds + 20.0)
        result = {"hz": (len(heard) - 1) / (heard[-1] - heard[0])}
    finally:
        stop.set()
        subscriber.unregister()
        source.close()
    path.write_text(json.dumps(result), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
