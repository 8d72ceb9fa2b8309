"""The numbers of attitudes, postures and gestures are those of the messages."""

import pytest

from hri_fullbody.core.language.attitude import Attitude
from hri_fullbody.core.language.gesture import Gesture
from hri_fullbody.core.language.posture import Posture
from hri_msgs.msg import BodyAttitude, BodyPosture
from hri_msgs.msg import Gesture as GestureMessage


@pytest.mark.parametrize("ours, message", [
    (Attitude, BodyAttitude), (Posture, BodyPosture), (Gesture, GestureMessage)])
def test_numbers_equal_the_constants_of_the_message(ours, message):
    constants = {name: getattr(message, name) for name in vars(message)
                 if name.isupper() and isinstance(getattr(message, name), int)}
    assert {item.name: item.value for item in ours} == constants
