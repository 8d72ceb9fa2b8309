"""A bag of a scene, written without ROS: the truth; persons, gazes and groups with faults are added by the test."""

import numpy as np

from benchmarks.recordings import write_truth
from hri_pipeline.core.geometry import Pose
from hri_pipeline.score.bag import BagWriter


class SceneBag(BagWriter):
    """A bag that is being written; times in s."""

    def confidence(self, person, value, stamp):
        self.number("/humans/persons/{}/location_confidence".format(person), value, stamp)

    def truth(self, truth, base, visible=None, namespace="/scene/truth"):
        """A cycle of the truth, as the simulator publishes it."""
        write_truth(self, truth, base, [person.id for person in truth.people] if visible is None else visible,
                    namespace)


def upright(place):
    """A pose without a turn."""
    return Pose(np.eye(3), np.asarray(place, dtype=float))
