"""Measures bodies on a ROS graph. Usage: bodies_probe.py frames|first|cpu|churn|heads FILE

Run by bodies.py, with the tools of hri_fullbody's rostests on the path. Writes one JSON object.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Callable, Dict, List, Tuple

import numpy as np
import rosgraph
import rospy
from skeleton_graph import Movers, TfTree, farthest, processes

from benchmarks.stack_run import cpu_s, usage
from hri_fullbody.ros.state_publishers import StatePublishers
from hri_msgs.msg import FacialLandmarks, Skeleton2D
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.ros.conversions import landmarks_from_msg, skeleton_from_msg
from hri_pipeline.ros.subscriptions import IdSubscribers
from hri_pipeline.testing import Camera, photograph, wait_for

RATE_HZ = 15.0
WAIT_S = 30.0
TEN = 10
PHOTOGRAPHS = range(1, 7)
NEW_ID = IdGenerator().new


class Crowd:
    """Bodies that move, their robot_state_publishers, and the tree of their frames."""

    def __init__(self) -> None:
        self.movers, self.tree = Movers(RATE_HZ), TfTree()
        self.publishers = StatePublishers(TEN, RATE_HZ)
        # The first thing that it does is to look for what dead nodes have left.
        wait_for(lambda: self.publishers.status()[2]["wanted"] == 0, WAIT_S, "the start")

    def come(self, count: int) -> List[str]:
        """Let so many new bodies come instead of those who are there; returns their ids."""
        ids = [NEW_ID() for _ in range(count)]
        for identity, urdf in self.movers.set({identity: 1.5 + 0.05 * n for n, identity in enumerate(ids)}).items():
            self.publishers.set(identity, urdf, 1)
        self.publishers.keep(ids)
        return ids

    def close(self) -> None:
        """End everything."""
        self.publishers.close()
        self.movers.close()
        self.tree.close()


def frames() -> dict:
    """Distance of the frames from forward kinematics."""
    crowd = Crowd()
    ids, errors = crowd.come(3), []
    for identity in ids:
        stamps = wait_for(lambda wanted=identity: len(crowd.tree.complete(wanted)) > 20
                          and crowd.tree.complete(wanted), WAIT_S, "frames of " + identity)
        errors += [farthest(crowd.tree, crowd.movers, identity, stamp) for stamp in stamps]
    crowd.close()
    return {"tf_fk_error_m": max(errors), "skeletons": len(errors)}


def first() -> dict:
    """Time until a body's frames are complete."""
    crowd = Crowd()

    def slowest(count: int) -> float:
        began = time.monotonic()
        ids = crowd.come(count)
        wait_for(lambda: all(identity in crowd.tree.first for identity in ids), WAIT_S, "all frames")
        taken = max(crowd.tree.first[identity] for identity in ids) - began
        crowd.publishers.keep([])
        crowd.movers.set({})
        wait_for(lambda: not any(processes(identity) for identity in ids), WAIT_S, "the end of the processes")
        return taken

    found = {"one": max(slowest(1) for _ in range(6)), "ten": statistics.median(slowest(TEN) for _ in range(3))}
    crowd.close()
    return found


def cpu(seconds: float = 15.0) -> dict:
    """Processor time of ten robot_state_publishers and of the master, % of a core."""
    crowd = Crowd()
    ids = crowd.come(TEN)
    wait_for(lambda: all(crowd.tree.complete(identity) for identity in ids), WAIT_S, "all frames")
    groups = {"all": [pid for identity in ids for pid in processes(identity)],
              "master": [rosgraph.Master("/probe").getPid()]}
    # The processor time of starting is not meant.
    settled = time.monotonic() + 1.0
    wait_for(lambda: time.monotonic() > settled, WAIT_S, "a second")
    before, began = {name: sum(map(cpu_s, pids)) for name, pids in groups.items()}, time.monotonic()
    heard = {identity: len(crowd.movers.sent[identity]) for identity in ids}
    wait_for(lambda: time.monotonic() - began > seconds, seconds + WAIT_S, "the end")
    passed = time.monotonic() - began
    found = {name: 100.0 * (sum(map(cpu_s, pids)) - before[name]) / passed for name, pids in groups.items()}
    rates = [len(crowd.movers.sent[identity]) - heard[identity] for identity in ids]
    crowd.close()
    if len(groups["all"]) != TEN or min(rates) < 0.8 * RATE_HZ * min(passed, 200.0 / RATE_HZ) - 60.0:
        raise AssertionError("{} processes, joint states {}".format(len(groups["all"]), rates))
    return {name: round(value, 2) for name, value in found.items()}


def churn(count: int = 500, warm: int = 60) -> dict:
    """What is left by bodies that come and go in tens, each with its frames heard of by robot_state_publisher."""
    movers, publishers = Movers(RATE_HZ), StatePublishers(TEN, RATE_HZ)
    master = rosgraph.Master("/probe")

    def pass_by(number: int) -> None:
        for _ in range(number // TEN):
            ids = [NEW_ID() for _ in range(TEN)]
            for identity, urdf in movers.set({identity: 1.7 for identity in ids}).items():
                publishers.set(identity, urdf, 1)
            wait_for(lambda wanted=ids: all(movers.is_heard(identity) for identity in wanted), WAIT_S, "listeners")
            publishers.keep([])
        movers.set({})
        wait_for(lambda: not processes("") and not [name for name in master.getParamNames() if name.startswith(
            ("/rsp_", "/human_description_"))], WAIT_S, "the end of all")

    def held() -> Dict[str, float]:
        mine, state = usage(os.getpid()), master.getSystemState()
        assert mine is not None     # this process has not gone
        return {"fds": mine.fds, "threads": mine.threads, "rss_mb": mine.rss_mb, "processes": len(processes("")),
                "params": len(master.getParamNames()),
                "topics": sum("/humans/bodies/" in name for part in state for name, _ in part)}

    pass_by(warm)
    before = held()
    pass_by(count)
    after = held()
    started = publishers.status()[2]
    publishers.close()
    movers.close()
    found = {name: round(after[name] - before[name], 2) for name in after}
    found.update(bodies=count, restarted=started["restarted"])
    return found


def heads() -> dict:
    """Distance of head_ID from face_ID over the people of the photographs, by the nose in the face's landmarks."""
    stack = subprocess.Popen(["roslaunch", "ros4hri", "ros4hri.launch", "overlay:=false", "persons:=false",
                              "image:=/image", "camera_info:=/camera_info", "respawn:=false"])
    camera, tree = Camera(photograph(1)), TfTree()
    features: Dict[str, Dict[str, object]] = {"faces": {}, "bodies": {}}
    feeds = [IdSubscribers(kind, {name: message}, lambda identity, _, got, kept=features[kind]: kept.update(
        {identity: got}), lambda ids, kept=features[kind]: [kept.pop(gone) for gone in list(kept) if gone not in ids])
        for kind, name, message in (("faces", "landmarks", FacialLandmarks), ("bodies", "skeleton2d", Skeleton2D))]
    people: List[float] = []
    for number in PHOTOGRAPHS:
        camera.show(photograph(number))
        people += _heads_of(features, tree, 14.0)
        camera.show(np.zeros((540, 960, 3), np.uint8))
        wait_for(lambda: not features["faces"] and not features["bodies"], WAIT_S, "nobody in the dark")
    for owner in feeds + [camera, tree]:
        owner.close()
    stack.send_signal(2)
    stack.wait(timeout=30.0)
    return {"head_face_median_m": statistics.median(people), "people": len(people),
            "worst_m": max(people), "each_m": [round(value, 3) for value in people]}


def _heads_of(features: Dict[str, Dict[str, object]], tree: TfTree, seconds: float) -> List[float]:
    """Median distance (m) of each person of one photograph over the images of its second half."""
    errors: Dict[Tuple[str, str], Dict[object, float]] = {}
    began = time.monotonic()
    while time.monotonic() - began < seconds:
        time.sleep(0.2)
        for face, body in _pairs(features):
            known = tree.moving.get("face_" + face, {})
            for stamp in [stamp for stamp in tree.complete(body) if stamp in known]:
                item = known[stamp].transform.translation
                head = tree.pose("head", body, stamp, known[stamp].header.frame_id).translation
                errors.setdefault((face, body), {})[stamp] = float(np.linalg.norm(head - (item.x, item.y, item.z)))
    return [statistics.median([found[stamp] for stamp in sorted(found)][len(found) // 2:])
            for found in errors.values() if len(found) >= 4]


def _pairs(features: Dict[str, Dict[str, object]]) -> List[Tuple[str, str]]:
    pairs = []
    for face, landmarks in list(features["faces"].items()):
        points = landmarks_from_msg(landmarks)[:, :2]
        low, high = points.min(axis=0), points.max(axis=0)
        inside = [body for body, skeleton in list(features["bodies"].items())
                  if np.all((skeleton_from_msg(skeleton)[0, :2] > low) & (skeleton_from_msg(skeleton)[0, :2] < high))]
        pairs += [(face, inside[0])] if len(inside) == 1 else []
    return pairs


def main(arguments: List[str]) -> int:
    """Measure and write."""
    figures: Dict[str, Callable[[], dict]] = {"frames": frames, "first": first, "cpu": cpu, "churn": churn,
                                              "heads": heads}
    rospy.init_node("bodies_ros_probe", disable_signals=True)
    found = figures[arguments[0]]()
    Path(arguments[1]).write_text(json.dumps(found), encoding="utf-8")
    rospy.signal_shutdown("done")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
