#!/usr/bin/env python3
"""A program written for REP-155 and hri_msgs 0.9.0: no module of this stack, only its messages.

For test_rep155_client.py, and to copy from. It follows the persons that are tracked, their faces and voices, and prints
what it learns, one line of JSON each: {"person": id, "face": id, "box": [xmin, ymin, xmax, ymax]}, {"person": id,
"engagement": level}, {"voice": id, "said": text, "final": bool}, {"gaze": [sender, receiver]}, {"group": id, "members":
[ids]}, {"space": name, "ids": [ids]}.
"""

import json
import threading

import rospy
from std_msgs.msg import String

from hri_msgs.msg import EngagementLevel, Gaze, Group, IdsList, LiveSpeech, NormalizedRegionOfInterest2D

_PRINTING = threading.Lock()


def tell(**what):
    """Print one line."""
    with _PRINTING:
        print(json.dumps(what, sort_keys=True), flush=True)


class Followed:
    """The ids of a tracked list, and what is subscribed to for each."""

    def __init__(self, kind, follow):
        self._follow = follow
        self._subscribers = {}
        self._list = rospy.Subscriber("/humans/{}/tracked".format(kind), IdsList, self._on_list)

    def _on_list(self, message):
        for identity in set(self._subscribers) - set(message.ids):
            for subscriber in self._subscribers.pop(identity):
                subscriber.unregister()
        for identity in set(message.ids) - set(self._subscribers):
            self._subscribers[identity] = self._follow(identity)


class Client:
    """Persons with their faces, voices with their words, gazes, groups and distances."""

    def __init__(self):
        self._owners = {}
        Followed("persons", self._person)
        Followed("faces", self._face)
        Followed("voices", self._voice)
        rospy.Subscriber("/humans/interactions/gazing", Gaze, lambda m: tell(gaze=[m.sender, m.receiver]))
        rospy.Subscriber("/humans/interactions/groups", Group,
                         lambda m: tell(group=m.group_id, members=list(m.members)))
        for name in ("personal", "social", "public"):
            rospy.Subscriber("/humans/persons/in_{}_space".format(name), IdsList, self._on_space, callback_args=name)

    def _person(self, person):
        prefix = "/humans/persons/{}/".format(person)
        return [rospy.Subscriber(prefix + "face_id", String, self._on_face_of, callback_args=person),
                rospy.Subscriber(prefix + "engagement_status", EngagementLevel,
                                 lambda m: tell(person=person, engagement=m.level))]

    def _face(self, face):
        return [rospy.Subscriber("/humans/faces/{}/roi".format(face), NormalizedRegionOfInterest2D, self._on_box,
                                 callback_args=face)]

    def _voice(self, voice):
        return [rospy.Subscriber("/humans/voices/{}/speech".format(voice), LiveSpeech, self._on_speech,
                                 callback_args=voice)]

    def _on_box(self, message, face):
        if face in self._owners:
            tell(person=self._owners[face], face=face, box=[message.xmin, message.ymin, message.xmax, message.ymax])

    def _on_face_of(self, message, person):
        if message.data:
            self._owners[message.data] = person

    def _on_speech(self, message, voice):
        tell(voice=voice, said=message.final or message.incremental, final=bool(message.final))

    @staticmethod
    def _on_space(message, name):
        tell(space=name, ids=list(message.ids))


if __name__ == "__main__":
    rospy.init_node("rep155_client")
    client = Client()
    rospy.spin()
