"""How long until the same persons are there again: manager killed, clock set back, bag looped, master restarted."""

from __future__ import annotations

import os
import signal
import subprocess
import threading
import time
from contextlib import contextmanager
from pathlib import Path
from typing import Callable, Dict, Iterator, List, Optional, Set
from urllib.parse import urlparse

import processes
import rosgraph
import rospy
from persons_scenarios import ScenarioError, expect, ids, manager_pid
from persons_world import BODY, FACE, PERSON, World, match
from rosgraph_msgs.msg import Clock

from hri_msgs.msg import IdsList
from hri_pipeline.ros.master_watch import MasterWatch

PEOPLE = 10
RATE_HZ = 30.0
JUMP_S = 60.0


class SimulatedClock:
    """Publishes /clock, 100 times a second."""

    def __init__(self, start: float) -> None:
        self._offset = start - time.monotonic()
        self._publisher = rospy.Publisher("/clock", Clock, queue_size=1, tcp_nodelay=True)
        threading.Thread(target=self._run, daemon=True).start()

    def now(self) -> rospy.Time:
        """The simulated time."""
        return rospy.Time.from_sec(time.monotonic() + self._offset)

    def jump(self, seconds: float) -> None:
        """Let the time jump."""
        self._offset += seconds

    def _run(self) -> None:
        while not rospy.is_shutdown():
            self._publisher.publish(Clock(self.now()))
            time.sleep(0.01)


class People:
    """Ten faces and bodies whose frames are published all the time; who is matched with whom is repeated twice a second."""

    def __init__(self, world: World, now: Optional[Callable[[], rospy.Time]] = None) -> None:
        self._world, self._now = world, now
        self.faces, self.bodies = ids("f", PEOPLE), ids("b", PEOPLE)
        self.named: Dict[str, str] = {}

    @contextmanager
    def present(self) -> Iterator[None]:
        """Publish until the end of the block."""
        stop = threading.Event()

        def run() -> None:
            number = 0
            while not stop.wait(1.0 / RATE_HZ):
                if number % 15 == 0:
                    self.say()
                self._world.place(self.faces, self.bodies, self._now() if self._now is not None else None)
                number += 1

        self._world.show(self.faces, self.bodies)
        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            yield
        finally:
            stop.set()
            thread.join()

    def say(self) -> None:
        """Publish the matches."""
        self._world.say(*(match(face, FACE, body, BODY, 0.9) for face, body in zip(self.faces, self.bodies)),
                        *(match(face, FACE, person, PERSON, 0.9) for face, person in self.named.items()))

    def settled(self) -> Set[str]:
        """Wait until all are persons; returns their ids."""
        expect(lambda: len(self._world.tracked) == PEOPLE and set(self.named.values()) <= set(self._world.tracked), 15.0,
               "ten persons")
        return set(self._world.tracked)


def recover(world: World) -> dict:
    """Kill the manager with ten people in view, three times."""
    people, times = People(world), []
    with people.present():
        before = people.settled()
        time.sleep(1.0)     # what survives a kill is written twice a second
        for _ in range(3):
            killed = _kill_manager(world)
            expect(lambda: set(world.tracked) == before, 20.0, "the same ten persons again")
            times.append(time.monotonic() - killed)
            time.sleep(1.5)
    return {"recover_after_kill_s": round(max(times), 2)}


def recover_clock(world: World) -> dict:
    """Set a simulated clock back by a minute with ten people in view, five of them known; then loop a bag."""
    clock = SimulatedClock(1000.0)
    rospy.set_param("/use_sim_time", True)
    _kill_manager(world)    # it comes back on simulated time
    people = People(world, clock.now)
    people.named = dict(zip(people.faces, ids("p", PEOPLE // 2)))
    lists: List[IdsList] = []
    ear = rospy.Subscriber("/humans/persons/tracked", IdsList, lists.append, queue_size=100)
    with people.present():
        before = people.settled()
        expect(lambda: _placed(world, before, 0.0), 10.0, "everybody has a frame")
        time.sleep(1.0)
        lists.clear()
        back = _jump(world, clock, before)
        time.sleep(3.0)
        others = sum(set(message.ids) != before for message in lists)
    looped = _loop(world, clock, people)
    ear.unregister()
    return {"recover_after_clock_back_s": back, "recover_after_bag_loop_s": looped,
            "lists_with_others_after_clock_back": others}


def recover_master(world: World) -> dict:
    """Kill the master with ten people in view and start another: until a newcomer hears of the same persons."""
    watch, people = MasterWatch(0.5), People(world)
    with people.present():
        before = people.settled()
        killed = time.monotonic()
        os.kill(_process(b"rosmaster"), signal.SIGKILL)
        port = urlparse(rosgraph.get_master_uri()).port
        subprocess.Popen(["rosmaster", "--core", "-p", str(port)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                         stderr=subprocess.DEVNULL)
        expect(lambda: _published() >= {"/humans/persons/{}/face_id".format(name) for name in before}, 20.0,
               "the new master has the topics of the ten persons")
        known = rospy.wait_for_message("/humans/persons/known", IdsList, 10.0)
        took = time.monotonic() - killed
        if set(world.tracked) != before or not before <= set(known.ids):
            raise ScenarioError("other persons after the restart of the master")
    watch.close()
    return {"recover_after_master_s": round(took, 2)}


def _kill_manager(world: World) -> float:
    """Returns the time (s, monotonic) of the kill."""
    world.tracked = ()
    os.kill(manager_pid(), signal.SIGKILL)
    return time.monotonic()


def _jump(world: World, clock: SimulatedClock, wanted: Set[str]) -> float:
    """Set the clock back; time (s) until all these persons, and no others, are tracked and have frames of the new time."""
    border = clock.now().to_sec() - 0.5 * JUMP_S
    clock.jump(-JUMP_S)
    jumped = time.monotonic()
    world.frames.clear()
    expect(lambda: set(world.tracked) == wanted and _placed(world, wanted, 0.0, border), 20.0,
           "the same persons after the clock went back")
    return round(time.monotonic() - jumped, 2)


def _loop(world: World, clock: SimulatedClock, people: People) -> float:
    """As when a bag starts again: the clock goes back, all features are gone, then others of the same known people come."""
    world.show()
    expect(lambda: not world.tracked, 10.0, "everybody has gone")
    people.named = dict(zip(people.faces, ids("p", PEOPLE)))
    with people.present():
        people.settled()
    world.show()
    people.faces, people.bodies = ids("g", PEOPLE), ids("c", PEOPLE)
    people.named = dict(zip(people.faces, ids("p", PEOPLE)))
    border = clock.now().to_sec() - 0.5 * JUMP_S
    clock.jump(-JUMP_S)
    expect(lambda: not world.tracked, 10.0, "everybody has gone when the bag ends")
    began = time.monotonic()
    with people.present():
        before = people.settled()
        expect(lambda: _placed(world, before, 0.0, border), 10.0, "everybody has a frame")
        return round(time.monotonic() - began, 2)


def _placed(world: World, persons: Set[str], after: float, before: float = float("inf")) -> bool:
    """Tell whether all these persons have a frame whose stamp (s) lies between two times."""
    return {"person_" + name for name in persons} <= {
        name for _, stamp, name in list(world.frames) if after < stamp < before}


def _published() -> Set[str]:
    try:
        return {topic for topic, _ in rosgraph.Master("/benchmark_persons").getSystemState()[0]}
    except (OSError, rosgraph.MasterException):
        return set()


def _process(word: bytes) -> int:
    """The marked process with a command line that has this word in it."""
    for pid in processes.marked(os.environ[processes.MARK_NAME], {os.getpid()}):
        try:
            if any(word in part for part in Path("/proc/{}/cmdline".format(pid)).read_bytes().split(b"\0")[:3]):
                return pid
        except OSError:
            continue
    raise ScenarioError("there is no process {}".format(word.decode()))


RECOVERIES: Dict[str, Callable[[World], dict]] = {
    "recover": recover, "recover_clock": recover_clock, "recover_master": recover_master}
