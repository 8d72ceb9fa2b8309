"""The parameter `interface`: the types of the topics whose type differs between the paper and REP-155.

This is the only place that knows the difference.
"""

from __future__ import annotations

from typing import Optional, Type, Union

import genpy
import numpy as np
from sensor_msgs.msg import RegionOfInterest
from std_msgs.msg import Header

from hri_msgs.msg import NormalizedRegionOfInterest2D
from hri_pipeline.ros.conversions import roi_to_msg

PAPER, REP155 = "paper", "rep155"

RoiMessage = Union[RegionOfInterest, NormalizedRegionOfInterest2D]


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
