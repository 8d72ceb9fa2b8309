"""Run on one of two machines: waits until the people of a picture are there, and writes what it saw as JSON.

two_machines_probe.py FILE SECONDS; exit code 0, or 1 when nobody was there in time.
"""

import json
import sys
import time
from xmlrpc.client import ServerProxy

import rosgraph
import rospy
from tf2_msgs.msg import TFMessage

from hri_msgs.msg import IdsList
from hri_pipeline.ros.node import wait_for_master

PEOPLE = 1


def connections(node, topic):
    """How many others the node sends a topic to."""
    _, _, rows = ServerProxy(rosgraph.Master("/probe").lookupNode(node)).getBusInfo("/probe")
    return sum(row[4] == topic for row in rows)


def main(file, seconds):
    """Look, and write the file."""
    wait_for_master("two_machines_probe")
    rospy.init_node("two_machines_probe", anonymous=True)
    seen = {"persons": 0, "age_s": None}

    def on_tf(message):
        ages = [rospy.get_time() - one.header.stamp.to_sec() for one in message.transforms
                if one.child_frame_id.startswith("person_")]
        if ages:
            seen["age_s"] = round(max(ages), 3)

    rospy.Subscriber("/humans/persons/tracked", IdsList, lambda message: seen.update(persons=len(message.ids)),
                     queue_size=1)
    rospy.Subscriber("/tf", TFMessage, on_tf, queue_size=100)
    end = time.monotonic() + seconds
    while seen["persons"] < PEOPLE or seen["age_s"] is None:
        if time.monotonic() > end:
            print("seen: %s" % seen)
            return 1
        time.sleep(0.1)
    seen["raw"] = connections("/image_source", "/camera/image_raw")
    seen["compressed"] = connections("/image_source", "/camera/image_raw/compressed")
    with open(file, "w") as stream:
        json.dump(seen, stream)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], float(sys.argv[2])))
