#!/usr/bin/env python3
"""Listens to the topics of all faces, for id_publishers_test.py."""

import rospy
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import String

from hri_pipeline.ros.subscriptions import IdSubscribers

rospy.init_node("id_listener")
counter = rospy.Publisher("~received", String, queue_size=1000)
feed = IdSubscribers("faces", {"roi": RegionOfInterest, "name": String},
                     lambda identity, name, message: counter.publish(identity + "/" + name))
rospy.spin()
feed.close()
