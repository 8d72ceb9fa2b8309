"""People as plain Python objects, for programs that want to use what the stack publishes.

    from hri_pipeline.client import Humans

    with Humans() as humans:
        for person in humans.persons.values():
            print(person.id, person.name, person.pose("base_link"))

docs/tutorial.md leads through it.
"""

from hri_pipeline.client.humans import Body, Face, Humans, Person, Voice
from hri_pipeline.client.topics import (
    Attitude,
    Demographics,
    Engagement,
    Expression,
    GazeOfPerson,
    Gesture,
    GroupOfPersons,
    Posture,
    Region,
)
from hri_pipeline.core.geometry import Pose

__all__ = ["Attitude", "Body", "Demographics", "Engagement", "Expression", "Face", "GazeOfPerson", "Gesture",
           "GroupOfPersons", "Humans", "Person", "Pose", "Posture", "Region", "Voice"]
