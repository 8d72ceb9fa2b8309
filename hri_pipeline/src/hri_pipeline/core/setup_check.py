"""Why nobody appears: facts about a running set-up, and rules that turn them into words and what to do."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Set, Tuple

from hri_pipeline.core.images import ASPECT_TOLERANCE, BLANK_DEVIATION, ENCODINGS, other_transport
from hri_pipeline.core.parameters import ParameterTable, Settings, parameter
from hri_pipeline.core.timing import clock_fault

NO_IMAGE_YET = "no image yet"       # what a pipeline tells in /diagnostics, whatever the reason
OK, HINT, FAULT = 0, 1, 2


@dataclass(frozen=True)
class Stream:
    """One topic that the stack needs. types: what its publishers send. age: s from the last stamp to now, None without.

    unreachable: names of publishers that do not answer at their address. other: published topic of the same images in
    the other transport (raw, compressed), empty without one.
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
    other: str = ""


@dataclass(frozen=True)
class Picture:
    """The last image. problem: why it cannot be read, empty when it can. brightness, contrast: mean, deviation, 0 to
    255."""

    width: int = 0
    height: int = 0
    encoding: str = ""
    problem: str = ""
    brightness: float = 0.0
    contrast: float = 0.0


@dataclass(frozen=True)
class CalibrationFacts:
    """The last camera_info. width, height: of the images that it is for, px. focal: px, 0 while the camera is not
    calibrated. problem: why no camera has these numbers, empty where one may."""

    width: int = 0
    height: int = 0
    focal: float = 0.0
    problem: str = ""


@dataclass(frozen=True)
class Facts:
    """All that was seen of a set-up in a few seconds.

    nodes: {name: "running", "dead" (registered, but does not answer) or "absent"}. statuses: {name of the task: (level,
    text)} of /diagnostics. tracked: {kind: ids in the last list, -1 without a list}. tf_reaches: whether transforms
    lead from camera_frame to reference_frame. publishing: nodes, whatever their names, that publish below /humans.
    managers: those that publish the list of persons. time, wall_time: now, of ROS and of the machine, s. stand_ins:
    {usual name: nodes of other names that do its work}. own_cameras: nodes that see people without images. clocks:
    nodes that send /clock.
    """

    nodes: Dict[str, str] = field(default_factory=dict)
    stand_ins: Dict[str, Tuple[str, ...]] = field(default_factory=dict)
    own_cameras: Tuple[str, ...] = ()
    publishing: Tuple[str, ...] = ()
    managers: Tuple[str, ...] = ()
    image: Optional[Stream] = None
    info: Optional[Stream] = None
    picture: Optional[Picture] = None
    calibration: Optional[CalibrationFacts] = None
    sim_time: bool = False
    clock_messages: int = 0
    clocks: Tuple[str, ...] = ()
    time: float = 0.0
    wall_time: float = 0.0
    camera_frame: str = ""
    reference_frame: str = "map"
    tf_reaches: bool = False
    models_missing: Tuple[str, ...] = ()
    models_directory: str = ""
    statuses: Dict[str, Tuple[int, str]] = field(default_factory=dict)
    tracked: Dict[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class CheckSettings(Settings):
    """Looks at the running graph and says in words why nobody appears."""

    nodes: Sequence[str] = parameter(
        ["hri_faces", "hri_bodies", "hri_face_body_matcher", "hri_person_manager"], "Nodes that have to run, without a "
        "slash; nodes of any name that publish the same topics stand for these. Leave out those that are switched off.")
    watch_time: float = parameter(
        6.0, "Time of observation. Longer: slower, but finds what comes rarely.", unit="s", minimum=1.0, maximum=120.0)
    camera_frame: str = parameter("", "Frame of the camera; empty: the frame_id of its images.")
    min_rate: float = parameter(
        3.0, "Images per second below which people cannot be followed.", unit="Hz", minimum=0.1, maximum=60.0)
    max_age: float = parameter(
        1.0, "Images whose stamp differs more from now are reported: the clocks differ, or the network is too slow.",
        unit="s", minimum=0.05, maximum=60.0)
    master: str = parameter(
        "", "Address of the master that was there before the check; check.launch asks for it, so that roslaunch ends "
        "where there is none instead of starting one. Nothing is done with it here.")
    min_brightness: float = parameter(
        25.0, "Mean of the pixels (0 to 255) below which a picture is too dark.", minimum=0.0, maximum=255.0)
    min_contrast: float = parameter(
        BLANK_DEVIATION, "Standard deviation of the pixels (0 to 255) below which a picture shows nothing: a covered "
        "lens, or a test picture of one colour.", minimum=0.0, maximum=128.0)


CHECK_PARAMETERS = ParameterTable("check", CheckSettings)


@dataclass(frozen=True)
class Finding:
    """One thing about the set-up. level: OK, HINT (works, but not as it could) or FAULT. hint: what to do, empty for
    OK.

    topic: the topic that it is about. hence: what nodes report in /diagnostics as a consequence of it.
    """

    level: int
    what: str
    hint: str = ""
    topic: str = ""
    hence: Tuple[str, ...] = ()


Rule = Callable[[Facts, CheckSettings], List[Finding]]


def check(facts: Facts, settings: CheckSettings) -> List[Finding]:
    """Return what there is to say, the root causes first. settings: the values of CHECK_PARAMETERS."""
    findings = [finding for rule in _RULES for finding in rule(facts, settings)]
    told = {name: status for name, status in facts.statuses.items() if status[0] > 0}
    roots = [_with_consequences(finding, told) for finding in findings]
    return roots + [Finding(FAULT if level >= 2 else HINT, "{}: {}".format(name, text),
                            "see rostopic echo /diagnostics")
                    for name, (level, text) in sorted(told.items())] + _people(facts, settings)


def _with_consequences(finding: Finding, told: Dict[str, Tuple[int, str]]) -> Finding:
    """Return the finding with what nodes tell of the same topic, and take that out of `told` ({task: (level,
    text)})."""
    same = [name for name, (level, text) in told.items()
            if finding.topic and name.endswith(": input") and level <= finding.level and _names(text, finding.topic)]
    hence = []
    for node in sorted(name.rpartition(":")[0] for name in same):
        texts = ["input: " + told.pop(node + ": input")[1].partition(";")[0]]
        if told.get(node + ": pipeline", (OK, ""))[1] == NO_IMAGE_YET:
            texts.append("pipeline: " + told.pop(node + ": pipeline")[1])
        hence.append("{}: {}".format(node, "; ".join(texts)))
    return replace(finding, hence=tuple(hence))


def _names(text: str, topic: str) -> bool:
    """Tell whether a text names this topic, not only one that begins with it."""
    return topic in [word.rstrip(":;,.") for word in text.split()]


def is_well(findings: List[Finding]) -> bool:
    """Tell whether people can appear."""
    return all(finding.level != FAULT for finding in findings)


def as_text(findings: List[Finding]) -> str:
    """Return the findings as lines for people."""
    marks = {OK: "ok   ", HINT: "hint ", FAULT: "FAULT"}
    lines = []
    for finding in findings:
        lines.append("{}  {}".format(marks[finding.level], finding.what))
        if finding.hint:
            lines.append("       -> " + finding.hint)
        lines += ["       hence  " + text for text in finding.hence]
    faults = sum(finding.level == FAULT for finding in findings)
    lines.append("{} fault{} found".format(faults or "no", "" if faults == 1 else "s"))
    return "\n".join(lines)


_LISTS = {"hri_faces": "/humans/faces/tracked", "hri_bodies": "/humans/bodies/tracked",
          "hri_person_manager": "/humans/persons/tracked"}
_MATCHER, _MATCHED = "hri_face_body_matcher", ("hri_faces", "hri_bodies")
MATCHES = "/humans/candidate_matches"
_BLIND = (_MATCHER, "hri_person_manager", "hri_voices", "hri_voice_matcher", "hri_interactions")
"""Nodes that take no images: where no other is wanted, none have to come."""


def stand_ins(name: str, published: Mapping[str, Sequence[str]], subscribed: Mapping[str, Sequence[str]]) -> List[str]:
    """Return the nodes of any name that do the work of one of the stack, as seen from their topics.

    name: of the node, without its namespace. published, subscribed: names of nodes by topic.
    """
    if name != _MATCHER:
        return sorted(published.get(_LISTS.get(name, ""), ()))
    inputs = [set(subscribed.get(_LISTS[kind], ())) for kind in _MATCHED]
    matchers = set(published.get(MATCHES, ())).intersection(*inputs).difference(
        *(published.get(topic, ()) for topic in _LISTS.values()))
    makers = own_cameras(published).intersection(published.get(MATCHES, ()))
    return sorted(matchers | makers)


def own_cameras(published: Mapping[str, Sequence[str]]) -> Set[str]:
    """Return the nodes that tell of faces and bodies and are their own camera, as a simulator: they take no images, and
    know which face is whose.

    published: names of nodes by topic.
    """
    lists = [set(published.get(_LISTS[kind], ())) for kind in _MATCHED]
    cameras = {name for topic, names in published.items() if topic.rpartition("/")[2] == "camera_info"
               for name in names}
    return cameras.intersection(*lists)


def _nothing_runs(facts: Facts) -> bool:
    """Tell whether nothing of the stack is there, under these names (more than one) or others."""
    return len(facts.nodes) > 1 and not facts.publishing and all(state == "absent" for state in facts.nodes.values())


def _nothing(facts: Facts, settings: CheckSettings) -> List[Finding]:
    if not _nothing_runs(facts):
        return []
    return [Finding(FAULT, "nothing of ros4hri runs on this master", "roslaunch ros4hri ros4hri.launch")]


def _clock(facts: Facts, settings: CheckSettings) -> List[Finding]:
    if facts.sim_time and not facts.clock_messages:
        return [Finding(FAULT, "/use_sim_time is true, but nobody publishes /clock: time stands still for all nodes",
                        "play the bag with --clock, or: rosparam set /use_sim_time false, and start the nodes again")]
    if facts.sim_time and len(facts.clocks) > 1:
        return [Finding(FAULT, "{} nodes publish /clock ({}): time jumps back and forth".format(
            len(facts.clocks), ", ".join(facts.clocks)), "end all but one; two bags: rosbag play --clock ONE TWO")]
    return []


def _nodes(facts: Facts, settings: CheckSettings) -> List[Finding]:
    found: List[Finding] = []
    if _nothing_runs(facts):
        return found
    for name, others in facts.stand_ins.items():
        found.append(Finding(OK, "{} {} for {}".format(
            " and ".join(others), "stands" if len(others) == 1 else "stand", name)))
    for name, state in facts.nodes.items():
        if state == "dead":
            found.append(Finding(FAULT, "the node {} is registered, but does not answer: it has crashed, or its "
                                 "machine cannot be reached".format(name),
                                 "rosnode cleanup; look at its log in ~/.ros/log/latest; set ROS_IP on each machine"))
        elif state == "absent" and _namesakes(name, facts):
            namesakes = _namesakes(name, facts)
            found.append(Finding(FAULT, "the node {} does not run here, but {}".format(name, ", ".join(namesakes)),
                                 "look there: ROS_NAMESPACE={} rosrun hri_pipeline check; or give the names that run "
                                 "in _nodes".format(namesakes[0].rpartition("/")[0] or "/")))
        elif state == "absent" and not (name.rpartition("/")[2] == _MATCHER and _has_nothing_to_match(facts)):
            found.append(Finding(FAULT, "the node {} does not run".format(name),
                                 "roslaunch ros4hri ros4hri.launch; its messages there say why it ended. If its branch "
                                 "is meant to be off: rosrun hri_pipeline check _nodes:=\"[{}]\"".format(
                                     ", ".join(other for other, how in facts.nodes.items() if how != "absent"))))
    return found


def _has_nothing_to_match(facts: Facts) -> bool:
    """Tell whether one of both was switched off, so that no matcher is started."""
    states = {name.rpartition("/")[2]: state for name, state in facts.nodes.items()}
    return [states.get(name, "running") for name in _MATCHED].count("absent") == 1


def _namesakes(name: str, facts: Facts) -> List[str]:
    """Return the nodes of the same name in other namespaces."""
    return [other for other in facts.publishing if other.rpartition("/")[2] == name.rpartition("/")[2]]


def _managers(facts: Facts, settings: CheckSettings) -> List[Finding]:
    if len(facts.managers) < 2:
        return []
    return [Finding(FAULT, "{} person managers share /humans ({}): each person is there more than once".format(
        len(facts.managers), ", ".join(facts.managers)),
        "keep one, and start the others' ros4hri.launch with persons:=false")]


def _models(facts: Facts, settings: CheckSettings) -> List[Finding]:
    if not facts.models_missing:
        return []
    return [Finding(FAULT, "models are missing in {}: {}".format(facts.models_directory,
                                                                 ", ".join(facts.models_missing)),
                    "rosrun hri_pipeline fetch_models")]


def _image(facts: Facts, settings: CheckSettings) -> List[Finding]:
    stream = facts.image
    is_blind = bool(facts.nodes) and all(name.rpartition("/")[2] in _BLIND or name in facts.own_cameras
                                         for name in facts.nodes)
    is_needed = not _nothing_runs(facts) and not is_blind
    if stream is None or not (is_needed or stream.publishers):
        return []
    found = _stream(stream, "image")
    if found or not stream.messages:
        return found
    if stream.rate < settings.min_rate:
        found.append(Finding(HINT, "{} comes with {:.1f} images/s only".format(stream.topic, stream.rate),
                             "raise the camera's rate, or use image_transport:=compressed over a network"))
    if stream.age is not None and abs(stream.age) > settings.max_age:
        text, remedy = clock_fault(stream.age, facts.time, facts.wall_time, facts.sim_time)
        found.append(Finding(FAULT, "images on {} are {}".format(stream.topic, text), remedy))
    if not stream.frame:
        found.append(Finding(FAULT, "images on {} have no frame_id, so that nothing has a place".format(stream.topic),
                             "set the frame_id of the camera driver to its optical frame"))
    return found


def _stream(stream: Stream, argument: str) -> List[Finding]:
    """Why no message comes on a topic."""
    wrong = [kind for kind in stream.types if kind != stream.wanted]
    if wrong and len(wrong) == len(stream.types):
        return [Finding(FAULT, "{} is a {}, not a {}".format(stream.topic, wrong[0], stream.wanted),
                        _type_hint(wrong[0], argument), stream.topic)]
    if not stream.publishers and stream.other:
        return [Finding(FAULT, "nobody publishes {}, but {} is published".format(stream.topic, stream.other),
                        "start with image_transport:={}".format(other_transport(stream.topic)[1]), stream.topic)]
    if not stream.publishers:
        return [
            Finding(
                FAULT,
                "nobody publishes {}".format(stream.topic),
                "start the camera, or give its topic: {}:=/your/topic (rostopic list shows all)".format(argument),
                stream.topic,
            )
        ]
    if stream.unreachable and len(stream.unreachable) == len(stream.publishers):
        return [Finding(FAULT, "the publisher of {} ({}) cannot be reached".format(
            stream.topic, ", ".join(stream.unreachable)),
            "it has died (rosnode cleanup), or its address is not known here: set ROS_IP on its machine and on this "
            "one",
            stream.topic)]
    if not stream.messages:
        return [Finding(FAULT, "{} has a publisher ({}), but nothing comes".format(
            stream.topic, ", ".join(stream.publishers)),
            "see that the camera is plugged in and its driver has no error; is the bag paused?", stream.topic)]
    return []


def _type_hint(kind: str, argument: str) -> str:
    if kind == "sensor_msgs/CompressedImage":
        return "give the topic without /compressed at its end, and image_transport:=compressed"
    return "give the right topic: {}:=/your/topic".format(argument)


def _picture(facts: Facts, settings: CheckSettings) -> List[Finding]:
    picture = facts.picture
    if picture is None or (facts.image is not None and _stream(facts.image, "image")):
        return []
    topic = facts.image.topic if facts.image else "image"
    if picture.problem:
        return [Finding(FAULT, "images on {} cannot be read: {}".format(topic, picture.problem),
                        "let the driver publish one of: {}".format(", ".join(ENCODINGS)), topic)]
    if picture.brightness < settings.min_brightness:
        return [Finding(FAULT, "the picture is too dark (mean {:.0f} of 255)".format(picture.brightness),
                        "switch the light on, take the lens cap off, let the camera expose longer")]
    if picture.contrast < settings.min_contrast:
        return [Finding(FAULT, "the picture shows nothing (all pixels are alike)",
                        "take away what covers the lens; see the picture with: rqt_image_view {}".format(topic))]
    return [Finding(OK, "{}: {}x{} {}".format(topic, picture.width, picture.height, picture.encoding))]


def _calibration(facts: Facts, settings: CheckSettings) -> List[Finding]:
    if facts.info is None or not (facts.image and facts.image.messages):
        return []
    missing = _stream(facts.info, "camera_info")
    if missing:
        return [Finding(HINT, missing[0].what + ": distances are guessed from the parameter fallback_fov",
                        missing[0].hint,
                        facts.info.topic)]
    calibration, picture = facts.calibration, facts.picture
    if calibration is None or picture is None or picture.problem:
        return []
    if calibration.problem:
        return [Finding(FAULT, "{}: {}".format(facts.info.topic, calibration.problem),
                        "correct it; until then distances are guessed from the parameter fallback_fov",
                        facts.info.topic)]
    if calibration.focal <= 0.0:
        return [
            Finding(
                FAULT,
                "the camera is not calibrated: K on {} is all zero, so that distances are guessed".format(
                    facts.info.topic
                ),
                "calibrate it (rosrun camera_calibration cameracalibrator.py), or set fallback_fov",
                facts.info.topic,
            )
        ]
    ratio = (calibration.width * picture.height) / max(calibration.height * picture.width, 1)
    if abs(ratio - 1.0) > ASPECT_TOLERANCE:
        return [Finding(FAULT, "{} is for {}x{} px, images are {}x{}".format(
            facts.info.topic, calibration.width, calibration.height, picture.width, picture.height),
            "give the camera_info of this camera: camera_info:=/your/topic, or calibrate this resolution",
            facts.info.topic)]
    if facts.info.frame and facts.image.frame and facts.info.frame != facts.image.frame:
        return [Finding(HINT, "{}: camera_info is of the frame {}, images are in {}: is it that of another "
                        "camera?".format(facts.info.topic, facts.info.frame, facts.image.frame),
            "give the camera_info of this camera: camera_info:=/your/topic, or correct the driver's frame_id",
            facts.info.topic)]
    return [Finding(OK, "{}: focal length {:.0f} px".format(facts.info.topic, calibration.focal))]


def _transforms(facts: Facts, settings: CheckSettings) -> List[Finding]:
    if not facts.camera_frame:
        return []
    if facts.tf_reaches:
        return [Finding(OK, "transforms lead from {} to {}".format(facts.camera_frame, facts.reference_frame))]
    return [Finding(FAULT, "no transform leads from the camera ({}) to the reference frame {}: persons are placed "
                    "relative to the camera".format(facts.camera_frame, facts.reference_frame),
                    "publish where the camera sits (URDF with robot_state_publisher, or static_transform_publisher), "
                    "start the localisation, or start with reference_frame:= a frame that exists, e.g. base_link")]


def _people(facts: Facts, settings: CheckSettings) -> List[Finding]:
    seen = {kind: count for kind, count in facts.tracked.items() if count > 0}
    if seen.get("persons"):
        return [Finding(OK, "{} person{} tracked now".format(seen["persons"], "" if seen["persons"] == 1 else "s"))]
    if seen:
        told = " and ".join("{} {}".format(count, kind) for kind, count in seen.items())
        return [Finding(FAULT, "{} are tracked, but no person".format(told), "see that hri_person_manager runs, and "
                                                                             "its log")]
    return [] if _nothing_runs(facts) else [Finding(OK, "nobody is tracked now")]


_RULES: Tuple[Rule, ...] = (_nothing, _clock, _models, _nodes, _managers, _image, _picture, _calibration, _transforms)
