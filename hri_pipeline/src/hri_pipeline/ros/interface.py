"""The parameter `interface`: the types of the topics whose type differs between the paper and REP-155.

This is the only place that knows the difference.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, List, Optional, Sequence, Type, Union

import genpy
import numpy as np
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import Header, String

from hri_msgs.msg import Group, GroupsStamped, LiveSpeech, NormalizedRegionOfInterest2D
from hri_pipeline.ros.conversions import group_to_msg, groups_to_msg, roi_to_msg

if TYPE_CHECKING:  # a module that needs scipy, of which most nodes need nothing
    from hri_pipeline.core.interactions.group_tracker import Group as SocialGroup
    from hri_pipeline.core.speech.speech_utterance import SpeechResult

PAPER, REP155 = "paper", "rep155"

RoiMessage = Union[RegionOfInterest, NormalizedRegionOfInterest2D]
SpeechMessage = Union[String, LiveSpeech]


def roi_type(interface: str) -> Type[genpy.Message]:
    """Message type of the topics `roi`. Raises ValueError for an unknown interface."""
    types = {PAPER: RegionOfInterest, REP155: NormalizedRegionOfInterest2D}
    if interface not in types:
        raise ValueError("interface is {!r}; legal: {}".format(interface, ", ".join(types)))
    return types[interface]


def roi_message(box: np.ndarray, width: int, height: int, interface: str,
                header: Optional[Header] = None, confidence: float = 1.0) -> RoiMessage:
    """Message of a box (4,) x0, y0, x1, y1 px in an image of width x height px, clipped to the image.

    header and confidence (0 to 1) go into the type that has fields for them only.
    """
    if roi_type(interface) is RegionOfInterest:
        return roi_to_msg(box, width, height)
    values = np.asarray(box, dtype=np.float64)
    if not np.isfinite(values).all():
        raise ValueError("a box holds numbers that are not finite")
    x0, y0, x1, y1 = np.clip(values / (width, height, width, height), 0.0, 1.0).tolist()
    return NormalizedRegionOfInterest2D(
        header=header or Header(), xmin=x0, ymin=y0, xmax=x1, ymax=y1, c=float(np.clip(confidence, 0.0, 1.0)))


def groups_type(interface: str) -> Type[genpy.Message]:
    """Message type of the topic `groups`: all at once, or one by one. Raises ValueError for an unknown interface."""
    roi_type(interface)
    return Group if interface == REP155 else GroupsStamped


def groups_messages(groups: Sequence[SocialGroup], header: Header, interface: str) -> List[genpy.Message]:
    """Return the messages of the groups of one time."""
    if groups_type(interface) is GroupsStamped:
        return [groups_to_msg(groups, header)]
    return [group_to_msg(group, header) for group in groups]


def has_gazing(interface: str) -> bool:
    """Tell whether each gaze is sent on `gazing`, too. Raises ValueError for an unknown interface."""
    return groups_type(interface) is Group


def speech_type(interface: str) -> Type[genpy.Message]:
    """Message type of the topics `speech`. Raises ValueError for an unknown interface."""
    roi_type(interface)
    return LiveSpeech if interface == REP155 else String


def speech_message(result: SpeechResult, interface: str, header: Header) -> SpeechMessage:
    """Message of what a voice has said, up to now or in all; header goes into the type that has one."""
    if speech_type(interface) is String:
        return String(result.final or result.incremental)
    return LiveSpeech(header=header, incremental=result.incremental, final=result.final,
                      confidence=float(np.clip(result.confidence, 0.0, 1.0)), language=result.language)
