"""Parameters of the nodes `bodies` and `vision`."""

from __future__ import annotations

from dataclasses import replace
from typing import Tuple

from hri_pipeline.core.faces.parameters import CAMERA_PARAMETERS, DEPTH_PARAMETERS, FACE_PIPELINE_PARAMETERS, FACES
from hri_pipeline.core.parameters import LIST_TIMEOUT, Parameter, ParameterTable

MODELLER_PARAMETERS = (
    Parameter("interface", "paper", "Kinematic tree of the bodies. paper: the 18 joints of the ROS4HRI paper, two at"
              " each hip. rep155: the 20 joints of REP-155, three at each hip.", choices=("paper", "rep155")),
    Parameter("ik_solver", "gauss_newton", "How the joints are found. gauss_newton: closed form, then a least-squares"
              " fit of the whole body; the most exact. closed_form: faster, noisier. ikpy: chains read from the URDF,"
              " 5 to 60 ms per body; for comparison.", choices=("gauss_newton", "closed_form", "ikpy")),
    Parameter("segments", "", "YAML file of the body's proportions. Empty: the package's own config/segments.yaml."),
    Parameter("limb_lengths", True, "Estimate the length of each limb. false: only the stature, with the proportions"
              " of the table; the fit is 2 to 4 mm worse, and the models look alike."),
    Parameter("stature_tolerance", 0.03, "Relative change of the stature from which a body's URDF is replaced. For "
              "limbs it is the same length as for a thigh (12 mm at 0.03). Smaller follows the estimate closer and "
              "restarts robot_state_publisher more often.", minimum=0.005, maximum=0.5),
    Parameter("stature_window", 5.0, "Time over which lengths are measured. Longer is calmer, shorter follows a"
              " body sooner whose first estimate was wrong.", unit="s", minimum=0.5, maximum=120.0),
    Parameter("model_delay", 0.0, "Least time of watching a body before its URDF is made. Longer gives a better first"
              " stature, and later first frames: robot_state_publisher takes 0.3 s as well.", unit="s", minimum=0.0,
              maximum=10.0),
    Parameter("min_keypoint_confidence", 0.3, "Confidence from which a key point is used for the model. Lower uses"
              " guessed points of hidden limbs.", minimum=0.0, maximum=1.0, live=True),
    Parameter("keypoint_agility", 1.0, "Factor of the accelerations that the key points' low pass expects: 1 is what"
              " was measured of people who walk, wash, punch and fence. Smaller trembles less and follows sudden motion"
              " later.", minimum=0.05, maximum=20.0, live=True),
    Parameter("keypoint_gate", 0.10, "Distance from its prediction at which a key point of a resting limb is an "
              "outlier. Smaller keeps out more wrong depths and holds back sudden motion.",
              unit="m", minimum=0.01, maximum=10.0, live=True),
)
"""What BodyModeller.from_parameters needs."""


BODY_STAGE_PARAMETERS = (
    Parameter("person_detector_model", "", "ONNX file of the person detector. Empty: person_centernet.onnx in the "
              "models directory."),
    Parameter("pose_model", "full", "Pose network: `lite` (about 30 % faster, less exact), `full`, `heavy` (three "
              "times the time), or the path of an ONNX file. Get lite and heavy with `rosrun hri_pipeline fetch_models "
              "--models pose_landmarks_lite` (or `pose_landmarks_heavy`)."),
    Parameter("pose_rate", 10.0, "How often the pose network runs on each body at least (see `cpu_share`); in the images between, the body "
              "moves on by its own motion, with a lower confidence. Each run costs 11 to 15 ms on one core with the "
              "network `full`. Larger follows fast movements better. 0: every image.",
              unit="Hz", minimum=0.0, maximum=120.0, live=True),
    Parameter("pose_budget", 3, "Most known bodies per image for the pose network, where `cpu_share` allows no more; what "
              "is left (one at least, and two in slow images) goes to new ones. With more people than that the fast, "
              "the new, and those who have waited longest come first. 0: no limit.", minimum=0, maximum=64, live=True),
    Parameter("max_bodies", 10, "Most bodies tracked at the same time. Each costs 11 to 15 ms of one core `pose_rate`"
              " times a second.",
              minimum=1, maximum=64),
    Parameter("min_body_score", 0.5, "Probability of the pose network below which a body counts as lost. Higher lets "
              "go of hidden bodies sooner.", minimum=0.05, maximum=0.99, live=True),
    Parameter("min_person_score", 0.3, "Score from which the person detector's box may start a body; a body below a "
              "face needs a box of half of it. Lower finds fainter people and more things that are none.", minimum=0.05,
              maximum=0.99, live=True),
    Parameter("person_detection_size", 512, "Longer side of the person detector's input. Larger finds people farther"
              " away; the time grows with its square (17 to 40 ms at 512).", unit="px", minimum=128, maximum=1920),
    Parameter("person_detection_period", 1.0, "Time between two runs of the person detector; between them the pose"
              " network follows the known bodies. Smaller finds new people sooner and costs more. 0: every image.",
              unit="s", minimum=0.0, maximum=10.0, live=True),
    Parameter("new_windows_per_image", 3, "Most places per image searched for new bodies, 6 to 15 ms each. Larger "
              "finds a group sooner, smaller keeps the frame rate even.", minimum=1, maximum=64, live=True),
    Parameter("body_birth_delay", 0.1, "Time for which a body must be seen before it gets its topics. Larger keeps out"
              " more flickering false bodies.", unit="s", minimum=0.0, maximum=10.0, live=True),
    Parameter("body_death_time", 1.0, "Time after which a body that two searches have not found is dropped with its "
              "id. One that waits for its look is published for as long, or for one and a half rounds of looks where "
              "those take longer; one that vanished inside the image, as behind somebody, is waited for three times as "
              "long. Larger bridges longer occlusions.", unit="s", minimum=0.05, maximum=60.0, live=True),
    Parameter("body_memory", 10.0, "Time for which a lost body is remembered by clothes, place, stature and face: a "
              "new body seen for 1 s that is somebody remembered with a likelihood of 0.9 or more is told to be the "
              "same person (the id is a new one all the same). 0: never.", unit="s",
              minimum=0.0, maximum=300.0),
)
"""What BodyPipeline needs, besides `providers`."""

BODY_OUTPUT_PARAMETERS = (
    Parameter("joint_state_rate", 15.0, "Most joint states and frames per second and body. Higher moves the "
              "skeletons more evenly; robot_state_publisher asks the master three times for each: ten bodies at 30 "
              "Hz cost the master alone 12 % of a core. 0: for every image.", unit="Hz", minimum=0.0, maximum=120.0,
              live=True),
    Parameter("state_publishers", True, "Set a URDF for each body and run a robot_state_publisher, which publishes "
              "the frames of its links. false: joint states and body_ID only."),
    Parameter("up_frame", "", "TF frame whose z axis points up and whose z = 0 is the floor, such as `map` or"
              " `base_footprint`: people are placed, and their posture told, with the tilt and height of the camera."
              " Empty: the image is taken for upright, and the floor is not used."),
    LIST_TIMEOUT,
)
"""What becomes of the bodies, besides `interface` and what BodyModeller needs."""

_INTERFACE = (
    Parameter("interface", "paper", "paper: `roi` is RegionOfInterest in pixels, 18 joints. rep155: `roi` is "
              "NormalizedRegionOfInterest2D, 20 joints (three in each hip).", choices=("paper", "rep155")),
)


def _but_interface(parameters: Tuple[Parameter, ...]) -> Tuple[Parameter, ...]:
    """Camera and modeller both have `interface`; here it is one parameter."""
    return tuple(parameter for parameter in parameters if parameter.name != "interface")


_BODY_PARAMETERS = (
    BODY_STAGE_PARAMETERS + DEPTH_PARAMETERS + _but_interface(MODELLER_PARAMETERS) + BODY_OUTPUT_PARAMETERS
)

# Of more images than there are joint states nothing would be seen, and each costs 3 ms even when nobody is looked at in
# it. Three inferences and the person detector take 0.1 s.
_BODY_DEFAULTS = {"max_rate": 15.0, "max_age": 0.25}


def _with_defaults(parameters: Tuple[Parameter, ...]) -> Tuple[Parameter, ...]:
    return tuple(replace(parameter, default=_BODY_DEFAULTS[parameter.name]) if parameter.name in _BODY_DEFAULTS
                 else parameter for parameter in parameters)


_NICE = Parameter("nice", 5, "Priority on a busy processor, as in nice(1); larger is lower. The node `bodies` has a "
                  "lower one, so that faces, and with them persons, come first. 0: like all others; 19: only when "
                  "nobody else has anything to do.", minimum=0, maximum=19)

_VISION_INTERFACE = tuple(replace(parameter, doc=parameter.doc + " With `rep155` gaze_ID goes on while the eyes are "
                                  "closed, with the direction of the head.")
                          for parameter in _INTERFACE)

BODIES = ParameterTable(
    "bodies",
    "Node bodies: finds and follows bodies, their 18 key points, their place in front of the camera, and their joints.",
    _BODY_PARAMETERS + _with_defaults(_but_interface(CAMERA_PARAMETERS)) + _INTERFACE + (_NICE,),
)

VISION = ParameterTable(
    "vision",
    "Node vision: the nodes faces and bodies in one process; an image is received and decoded once.",
    FACE_PIPELINE_PARAMETERS + _BODY_PARAMETERS + _but_interface(CAMERA_PARAMETERS) + _VISION_INTERFACE
    + (replace(_NICE, default=0),),
    includes=(FACES, BODIES),
)
