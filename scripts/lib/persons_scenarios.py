"""What `scripts/benchmark persons` measures, each in a process of its own beside a running person manager.

`persons_scenarios.py NAME RESULT.json [NUMBER]`
"""

from __future__ import annotations

import itertools
import json
import os
import random
import subprocess
import sys
import time
from pathlib import Path
from typing import Callable, Dict, List, Set, Tuple

import numpy as np
import processes
import rospy
from persons_world import BODY, FACE, PERSON, FaceIdEar, World, match, wait
from process_usage import cpu_s, pid_of_node, usage
from std_msgs.msg import Float32

LIB = Path(__file__).resolve().parent
MANAGER = "hri_person_manager"


class ScenarioError(RuntimeError):
    """What was expected did not happen."""


def expect(condition: Callable[[], bool], seconds: float, what: str) -> None:
    """Wait for a condition. Raises ScenarioError naming `what` when it does not come true."""
    if not wait(condition, seconds):
        raise ScenarioError("did not happen within {:g} s: {}".format(seconds, what))


def manager_pid() -> int:
    """Process of the person manager. Raises ScenarioError when there is none."""
    pid = pid_of_node(os.environ[processes.MARK_NAME], MANAGER)
    if pid is None:
        raise ScenarioError("there is no person manager")
    return pid


def held(pid: int) -> Dict[str, float]:
    """Memory (MB), descriptors and threads of the person manager. Raises ScenarioError when it has ended."""
    found = usage(pid)
    if found is None:
        raise ScenarioError("the person manager has ended")
    return {"rss_mb": found.rss_mb, "threads": found.threads, "fds": found.fds}


def ids(letter: str, count: int) -> List[str]:
    """Ids that start with a letter."""
    return ["%s%03d" % (letter, number) for number in range(count)]


def _repeat(world: World, rate: float, seconds: float, step: Callable[[int], None]) -> None:
    """Call step(0), step(1), ... at `rate` Hz for some seconds."""
    began = time.monotonic()
    for number in itertools.count():
        pause = began + number / rate - time.monotonic()
        if number / rate >= seconds or rospy.is_shutdown():
            return
        if pause > 0.0:
            time.sleep(pause)
        step(number)


def latency(world: World, switches: int = 300) -> dict:
    """Time from a match to the face_id that follows from it, alone and beside a load of other matches."""
    world.show(faces=["f000"])
    world.say(match("f000", FACE, "ann", PERSON, 0.7))
    expect(lambda: "ann" in world.tracked, 10.0, "ann is tracked")
    ear, found = FaceIdEar("bob"), {}
    world.say(match("f000", FACE, "bob", PERSON, 0.9))
    if ear.wait("f000", 10.0) is None:
        raise ScenarioError("bob never got the face")
    for rate in (0, 300, 1800):
        loader = None if not rate else subprocess.Popen(
            [sys.executable, str(LIB / "persons_world.py"), str(rate)], stdout=subprocess.DEVNULL)
        if loader is not None:
            time.sleep(3.0)     # the load has begun and its first matches are settled
        try:
            times = [_switch(world, ear, number) for number in range(switches)]
        finally:
            if loader is not None:
                loader.kill()
                loader.wait()
        middle, high = np.percentile(1e3 * np.array(times), [50, 99])
        suffix = "_%d" % rate if rate else ""
        found.update({"latency_p50_ms" + suffix: round(float(middle), 2),
                      "latency_p99_ms" + suffix: round(float(high), 2)})
    return found


def _switch(world: World, ear: FaceIdEar, number: int) -> float:
    """Give bob the face or take it away; returns how long it took (s)."""
    likelihood, wanted = ((0.0, ""), (0.9, "f000"))[number % 2]
    time.sleep(random.uniform(0.01, 0.03))
    ear.forget()
    sent = time.monotonic()
    world.say(match("f000", FACE, "bob", PERSON, likelihood))
    heard = ear.wait(wanted, 5.0)
    if heard is None:
        raise ScenarioError("bob's face_id did not become {!r}".format(wanted))
    return heard - sent


def crowd(world: World, seconds: float = 20.0) -> dict:
    """10, then 30 people with face and body at 30 Hz."""
    found: Dict[str, object] = {"dropped": 0}
    for people in (10, 30):
        values, dropped = _people(world, people, seconds)
        found.update(values)
        found["dropped"] += dropped
    return found


def _people(world: World, people: int, seconds: float) -> Tuple[dict, int]:
    """Number of persons (the worst one seen), processor (% of a core), and how many of their frames never came."""
    faces, bodies = ids("f", people), ids("b", people)
    world.show(faces, bodies)
    sent: List[float] = []
    counts: Set[int] = set()

    def step(number: int) -> None:
        world.say(*(match(face, FACE, body, BODY, 0.8 + 0.1 * (number % 2)) for face, body in zip(faces, bodies)))
        sent.append(round(world.place(faces, bodies).to_sec(), 6))
        counts.add(len(world.tracked))

    _repeat(world, 30.0, 4.0, step)
    for seen in (sent, counts, world.frames):
        seen.clear()
    pid, before, began = manager_pid(), cpu_s(manager_pid()), time.monotonic()
    _repeat(world, 30.0, seconds, step)
    used = 100.0 * (cpu_s(pid) - before) / (time.monotonic() - began)
    time.sleep(0.5)     # the last frames are on their way
    arrived = {(round(stamp, 6), name) for _, stamp, name in world.frames}
    stamps = set(sent)
    missing = people * len(sent) - sum(stamp in stamps for stamp, _ in arrived)
    world.show()
    expect(lambda: not world.tracked, 10.0, "everybody has gone")
    return {"persons_%d" % people: max(counts, key=lambda count: abs(count - people)),
            "cpu_percent_%d" % people: round(used, 1)}, missing


def hard_graphs(world: World, seconds: float = 10.0) -> dict:
    """Longest time without a frame of a person while hard graphs change all the time; frames come at 100 Hz."""
    chance, pid = random.Random(2), manager_pid()
    found: Dict[str, object] = {}
    faces, bodies = ids("f", 7), ids("b", 7)
    seven = [(face, body) for face in faces for body in bodies]
    found["linked_7x7_ms"] = _longest_gap(world, faces, bodies, seven, seconds, chance)
    faces, bodies = ids("g", 12), ids("c", 12)
    chain = list(zip(faces, bodies)) + list(zip(faces[1:], bodies))
    before = held(pid)["rss_mb"]
    found["chain_12_ms"] = _longest_gap(world, faces, bodies, chain, seconds, chance)
    found["chain_12_rss_growth_mb"] = round(held(pid)["rss_mb"] - before, 2)
    return found


def _longest_gap(world: World, faces: List[str], bodies: List[str], pairs: list, seconds: float,
                 chance: random.Random) -> float:
    world.show(faces, bodies)
    world.say(*(match(face, FACE, body, BODY, chance.uniform(0.55, 0.95)) for face, body in pairs))
    expect(lambda: len(world.tracked) == len(faces), 10.0, "{} persons".format(len(faces)))

    def step(number: int) -> None:
        world.place(faces, bodies)
        face, body = pairs[number % len(pairs)]
        world.say(match(face, FACE, body, BODY, chance.uniform(0.55, 0.95)))

    _repeat(world, 100.0, 1.0, step)
    world.frames = []
    _repeat(world, 100.0, seconds, step)
    times = sorted({when for when, _, _ in world.frames})
    world.show()
    expect(lambda: not world.tracked, 10.0, "everybody has gone")
    return round(1e3 * float(np.max(np.diff(times))), 1)


def confidence(world: World) -> dict:
    """The location confidence of a person from before it is lost until it is forgotten."""
    world.show(faces=["f000"])
    world.say(match("f000", FACE, "ann", PERSON, 0.9))
    curve: List[List[float]] = []
    lost = [float("inf")]
    topic = "/humans/persons/ann/location_confidence"
    listener = rospy.Subscriber(topic, Float32, lambda message: curve.append(
        [round(time.monotonic() - lost[0], 2) if lost[0] < float("inf") else -0.01, round(message.data, 3)]))
    _repeat(world, 30.0, 2.0, lambda number: world.place(["f000"]))
    expect(lambda: bool(curve) and curve[-1][1] == 1.0, 5.0, "confidence 1 while the face is seen")
    lost[0] = time.monotonic()
    world.show()
    expect(lambda: curve[-1][1] < 1.0, 5.0, "confidence below 1")
    late = rospy.wait_for_message(topic, Float32, 5.0).data
    expect(lambda: curve[-1][1] == 0.0, 120.0, "confidence 0")
    ended = time.monotonic()
    time.sleep(1.0)
    after = sum(when > ended + 0.2 and name == "person_ann" for when, _, name in world.frames)
    listener.unregister()
    return {"confidence_curve": curve, "confidence_late_subscriber": round(late, 3), "frames_after_zero": after}


def churn(world: World, seconds: float) -> dict:
    """100 faces, 20 new ones each second."""
    shown, numbers = ids("f", 100), itertools.count(1000)

    def step(number: int) -> None:
        shown.pop(0)
        shown.append("f%06d" % next(numbers))
        world.show(faces=shown)
        if number % 2 == 0:
            world.place(shown)

    return {"churn_" + key: value for key, value in _growth(world, 20.0, seconds, step).items()}


def rest(world: World, seconds: float) -> dict:
    """Ten faces that stay."""
    faces = ids("f", 10)
    world.show(faces=faces)
    return {"rest_" + key: value for key, value in
            _growth(world, 30.0, seconds, lambda number: world.place(faces)).items()}


def _growth(world: World, rate: float, seconds: float, step: Callable[[int], None]) -> Dict[str, float]:
    """Growth of memory, descriptors and threads of the manager after the first fifth of the time."""
    _repeat(world, rate, 0.2 * seconds, step)
    pid, before = manager_pid(), held(manager_pid())

    def clear(number: int) -> None:
        step(number)
        world.frames.clear()

    _repeat(world, rate, 0.8 * seconds, clear)
    return {key: round(value - before[key], 2) for key, value in held(pid).items()}


SCENARIOS = {"latency": latency, "crowd": crowd, "hard": hard_graphs, "confidence": confidence,
             "churn": churn, "rest": rest}

if __name__ == "__main__":
    rospy.init_node("benchmark_persons", disable_signals=True)
    the_world = World()
    if not the_world.wait_for_manager():
        sys.exit("the person manager does not listen")
    from persons_recovery import RECOVERIES  # not above: it takes its tools from here
    outcome = {**SCENARIOS, **RECOVERIES}[sys.argv[1]](the_world, *(float(text) for text in sys.argv[3:]))
    Path(sys.argv[2]).write_text(json.dumps(outcome), encoding="utf-8")
    os._exit(0)     # rospy's threads have nothing left to say
