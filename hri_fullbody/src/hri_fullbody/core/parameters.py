"""Parameters of the nodes `bodies` and `vision`."""

from __future__ import annotations

from dataclasses import dataclass

from hri_pipeline.core.faces.parameters import (
    FACES,
    CameraSettings,
    DepthCameraSettings,
    FacePipelineSettings,
    PersonDetectorSettings,
)
from hri_pipeline.core.parameters import ParameterTable, Settings, list_timeout_parameter, parameter, parameter_like


@dataclass(frozen=True)
class BodyTrackingSettings(PersonDetectorSettings):
    """What finding and following bodies needs."""

    pose_model: str = parameter(
        "full", "Pose network: `lite` (about 30 % faster, less exact), `full`, `heavy` (three times the time), or the "
        "path of an ONNX file. Get lite and heavy with `rosrun hri_pipeline fetch_models --models "
        "pose_landmarks_lite` (or `pose_landmarks_heavy`).")
    pose_rate: float = parameter(
        10.0, "Least runs of the pose network on each body (see `cpu_share`); in the images between, the body moves on "
        "by its own motion, with a lower confidence. Each run costs 11 to 15 ms on one core with the network `full`. "
        "Larger follows fast movements better. 0: every image.", unit="Hz", minimum=0.0, maximum=120.0, live=True)
    pose_budget: int = parameter(
        3, "Most known bodies per image for the pose network (see `cpu_share`); what is left (one at least, and two in "
        "slow images) goes to new ones. With more people than that the fast, the new, and those who have waited "
        "longest come first. A camera of less than 5 Hz has more in proportion, where the machine has the time. "
        "0: no limit.", minimum=0, maximum=64, live=True)
    max_bodies: int = parameter(
        10, "Most bodies tracked at the same time. Each costs 11 to 15 ms of one core `pose_rate` times a second.",
        minimum=1, maximum=64)
    min_body_score: float = parameter(
        0.5, "Probability of the pose network below which a body is lost. Higher lets go of hidden bodies sooner.",
        minimum=0.05, maximum=0.99, live=True)
    min_person_score: float = parameter(
        0.3, "Score from which the person detector's box may start a body; a body below a face, or one that the pose "
        "network is sure of and sees in the mirror, too, needs a box of half of it. Lower finds fainter people and "
        "more things that are none.",
        minimum=0.05, maximum=0.99, live=True)
    person_detection_size: int = parameter(
        512, "Longer side of the person detector's input. Larger finds people farther away; the time grows with its "
        "square (17 to 40 ms at 512).", unit="px", minimum=128, maximum=1920)
    person_detection_period: float = parameter(
        1.0, "Time between two runs of the person detector; between them the pose network follows the known bodies. "
        "Smaller finds new people sooner and costs more. 0: every image.", unit="s", minimum=0.0, maximum=10.0,
        live=True)
    new_windows_per_image: int = parameter(
        3, "Most windows per image searched for new bodies; 6 to 15 ms each. Larger finds a group sooner, smaller "
        "keeps the frame rate even. A camera of less than 10 Hz has more in proportion, after its image is told, where "
        "the machine has the time.", minimum=1, maximum=64, live=True)
    body_birth_delay: float = parameter(
        0.1, "Time that a body must be seen before it gets topics. Larger keeps out more flickering false bodies.",
        unit="s", minimum=0.0, maximum=10.0, live=True)
    body_death_time: float = parameter(
        1.0, "Time after which a body that two searches have not found ends. One that waits for its turn is published "
        "for as long, or for one and a half rounds of turns where those take longer; one that vanished inside the "
        "image, as behind somebody, ends after three times as long. Larger bridges longer occlusions.", unit="s",
        minimum=0.05, maximum=60.0, live=True)
    body_memory: float = parameter(
        10.0, "Time for which a lost body can be recognised by clothes, place, stature and face: a new body seen for 1 "
        "s gets a match of 0.9 or more with its person (and another body id). 0: never.", unit="s", minimum=0.0,
        maximum=300.0)


@dataclass(frozen=True)
class BodyModelSettings(Settings):
    """What the joints and the model of each body need."""

    ik_solver: str = parameter(
        "gauss_newton", "How the joints are found. gauss_newton: closed form, then least squares over the whole body; "
        "the most exact. closed_form: faster, noisier. ikpy: 5 to 60 ms per body, from the URDF; for comparison.",
        choices=("gauss_newton", "closed_form", "ikpy"))
    segments: str = parameter("", "YAML file of the body's proportions. Empty: config/segments.yaml.")
    limb_lengths: bool = parameter(
        True, "Estimate the length of each limb. false: only the stature; the fit is 2 to 4 mm worse, and the models "
        "look alike.")
    stature_tolerance: float = parameter(
        0.03, "Relative change of the stature from which the URDF is replaced. For limbs it is the same length as for "
        "a thigh (12 mm at 0.03). Smaller follows the estimate closer and restarts robot_state_publisher more often.",
        minimum=0.005, maximum=0.5)
    stature_window: float = parameter(
        5.0, "Time over which lengths are measured. Longer is calmer, shorter follows a body sooner whose first "
        "estimate was wrong.", unit="s", minimum=0.5, maximum=120.0)
    model_delay: float = parameter(
        0.0, "Time of observation before the URDF is made. Longer gives a better first stature, and later first "
        "frames: robot_state_publisher takes 0.3 s as well.", unit="s", minimum=0.0, maximum=10.0)
    min_keypoint_confidence: float = parameter(
        0.3, "Confidence from which a key point is used. Lower uses guessed points of hidden limbs.", minimum=0.0,
        maximum=1.0, live=True)
    keypoint_agility: float = parameter(
        1.0, "Factor of the accelerations that the key points' filter expects: 1 is what was measured of people who "
        "walk, wash, punch and fence. Smaller trembles less and follows sudden motion later.", minimum=0.05,
        maximum=20.0, live=True)
    keypoint_gate: float = parameter(
        0.10, "Distance from its prediction from which a key point of a resting limb is an outlier. Smaller keeps out "
        "more wrong depths and holds back sudden motion.", unit="m", minimum=0.01, maximum=10.0, live=True)


@dataclass(frozen=True)
class BodyOutputSettings(Settings):
    """What becomes of the bodies."""

    joint_state_rate: float = parameter(
        15.0, "Most joint states and frames per second and body. Higher moves the skeletons more evenly; "
        "robot_state_publisher asks the master three times for each: ten bodies at 30 Hz cost the master alone 12 % of "
        "a core. 0: every image.", unit="Hz", minimum=0.0, maximum=120.0, live=True)
    state_publishers: bool = parameter(
        True, "Set a URDF for each body and run a robot_state_publisher. false: joint states and body_ID only.")
    list_timeout: float = list_timeout_parameter()


@dataclass(frozen=True)
class BodiesSettings(BodyTrackingSettings, DepthCameraSettings, BodyModelSettings, BodyOutputSettings,
                     CameraSettings):
    """Node bodies: finds and follows bodies, their 18 key points, their place in front of the camera, and their
    joints."""

    # Of more images than there are joint states nothing would be seen, and each costs 3 ms even when nobody is
    # looked at in it.
    max_rate: float = parameter_like(CameraSettings, "max_rate", default=15.0)
    # On a slow machine three inferences and the person detector take so long.
    max_age: float = parameter_like(CameraSettings, "max_age", default=0.5)
    interface: str = parameter(
        "paper", "paper: `roi` is RegionOfInterest in pixels, 18 joints. rep155: `roi` is "
        "NormalizedRegionOfInterest2D, 20 joints (three in each hip).", choices=("paper", "rep155"))
    nice: int = parameter(
        5, "Priority on a busy processor, as in nice(1); larger is lower. The node `bodies` has a lower one, so that "
        "faces, and with them persons, come first. 0: like all others; 19: only idle time.", minimum=0, maximum=19)


@dataclass(frozen=True)
class VisionSettings(FacePipelineSettings, BodiesSettings):
    """Node vision: the nodes faces and bodies in one process; an image is received and decoded once."""

    max_rate: float = parameter_like(CameraSettings, "max_rate")
    max_age: float = parameter_like(BodiesSettings, "max_age")
    interface: str = parameter_like(
        BodiesSettings, "interface", " With `rep155` gaze_ID goes on while the eyes are closed, with the direction of "
        "the head.")
    nice: int = parameter_like(BodiesSettings, "nice", default=0)
    threads: int = parameter_like(CameraSettings, "threads", doc=(
        "Threads of the networks, which share the people of an image; faces and bodies take turns. 0: `cpu_share` of "
        "the cores (at the start), eight at most, one on two cores. With more, everybody is looked at more often. For "
        "a GPU they only cut the images. Cores are those that the process may use: affinity, and quotas of containers "
        "and of systemd."))


BODIES = ParameterTable("bodies", BodiesSettings, includes=(FACES,))
VISION = ParameterTable("vision", VisionSettings, includes=(FACES, BODIES))
