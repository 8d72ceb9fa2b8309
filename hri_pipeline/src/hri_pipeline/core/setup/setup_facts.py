"""What was found out about a running set-up; `setup_check` judges it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Dict, Optional, Tuple

NO_IMAGE_YET = "no image yet"       # what a pipeline tells in /diagnostics, whatever the reason

@dataclass(frozen=True)
class Stream:
    """One topic that the stack needs. types: what its publishers send. age: s from the last stamp to now, None without.

    unreachable: names of publishers that do not answer at their address.
    """

    topic: str
    wanted: str
    types: Tuple[str, ...] = ()
    publishers: Tuple[str, ...] = ()
    unreachable: Tuple[str, ...] = ()
    messages: int = 0
    rate: float = 0.0
    age: Optional[float] = None
    frame: str = ""


@dataclass(frozen=True)
class Picture:
    """The last image. problem: why it cannot be read, empty when it can. brightness, contrast: mean, deviation, 0 to 255."""

    width: int = 0
    height: int = 0
    encoding: str = ""
    problem: str = ""
    brightness: float = 0.0
    contrast: float = 0.0


@dataclass(frozen=True)
class Calibration:
    """The last camera_info. focal: px, 0 while the camera is not calibrated."""

    width: int = 0
    height: int = 0
    focal: float = 0.0


@dataclass(frozen=True)
class Facts:
    """All that was seen of a set-up in a few seconds.

    nodes: {name: "running", "dead" (registered, but does not answer) or "absent"}. statuses: {name of the task: (level,
    text)} of /diagnostics. tracked: {kind: ids in the last list, -1 without a list}. tf_reaches: whether transforms lead
    from camera_frame to reference_frame. publishing: nodes, whatever their names, that publish below /humans.
    """

    nodes: Dict[str, str] = field(default_factory=dict)
    publishing: Tuple[str, ...] = ()
    image: Optional[Stream] = None
    info: Optional[Stream] = None
    picture: Optional[Picture] = None
    calibration: Optional[Calibration] = None
    sim_time: bool = False
    clock_messages: int = 0
    camera_frame: str = ""
    reference_frame: str = "map"
    tf_reaches: bool = False
    models_missing: Tuple[str, ...] = ()
    models_directory: str = ""
    statuses: Dict[str, Tuple[int, str]] = field(default_factory=dict)
    tracked: Dict[str, int] = field(default_factory=dict)
