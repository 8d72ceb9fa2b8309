"""Parameters of the scene_simulator node."""

from __future__ import annotations

from dataclasses import dataclass

from hri_pipeline.core.parameters import ParameterTable, Settings, parameter

DETECTIONS, PERSONS = "detections", "persons"


@dataclass(frozen=True)
class SceneSettings(Settings):
    """Publishes the people of a scene file as faces, bodies and voices, with the faults of real detectors, and the
    truth."""

    scene: str = parameter("three_talk", "Scene file, or the name of one in hri_pipeline/config/scenes.")
    seed: int = parameter(
        0, "Another seed gives the same scene with other random numbers: looks, talk, noise, gaps.", minimum=0,
        maximum=2147483647)
    level: str = parameter(
        DETECTIONS, "detections: faces, bodies, voices and matches, for a person manager. persons: the persons "
        "themselves.", choices=(DETECTIONS, PERSONS))
    rate: float = parameter(
        15.0, "Cycles per second of the scene's time: images, transforms, truth.", unit="Hz", minimum=0.5,
        maximum=100.0)
    speed: float = parameter(
        1.0, "How much faster than the wall clock the scene goes. Other than 1 with publish_clock only.", minimum=0.05,
        maximum=200.0)
    publish_clock: bool = parameter(
        False, "Publish /clock, for nodes with /use_sim_time; this node is then the only clock, and takes "
        "/use_sim_time back when it ends.")
    loop: bool = parameter(
        True, "Start again at the end, after a pause; ids are new, stamps go on. False: the node ends.")
    loop_pause: float = parameter(2.0, "That pause.", unit="s", minimum=0.0, maximum=600.0)
    wait_for: str = parameter("", "Topic that must have a subscriber before the scene begins. Empty: none.")
    reference_frame: str = parameter("map", "Frame of the scene: z up, floor at 0.")
    robot_frame: str = parameter("base_link", "Frame of the robot, on the floor.")
    camera_frame: str = parameter("camera_color_optical_frame", "Optical frame of the camera.")
    microphone_frame: str = parameter("microphone", "Frame of the voices, at the camera, x forward, z up.")
    publish_robot: bool = parameter(
        True, "Publish the static transforms from reference_frame to robot, camera and microphone.")
    width: int = parameter(1280, "Width of the virtual image.", unit="px", minimum=64, maximum=8192)
    height: int = parameter(720, "Height of the virtual image.", unit="px", minimum=64, maximum=8192)
    matches: bool = parameter(True, "Publish which face, body and voice belong together. False: a matcher does that.")
    match_likelihood: float = parameter(0.85, "Mean likelihood of those matches.", minimum=0.0, maximum=1.0)
    wrong_matches: float = parameter(
        0.0, "Share of the matches with the nearest other person, of 0.4 at most.", minimum=0.0, maximum=0.5)
    recognition: bool = parameter(
        True, "Recognise faces by the names in the scene. False: all persons are anonymous; somebody whose face and "
        "body were lost is somebody new.")
    recognition_delay: float = parameter(2.0, "Time until a face is recognised.", unit="s", minimum=0.0, maximum=600.0)
    truth: bool = parameter(True, "Publish the truth under /scene/truth.")
    interface: str = parameter(
        "paper", "Type of the topics roi: paper (pixels) or rep155 (normalised). With rep155 gaze_ID goes on while "
        "the eyes are closed, with the direction of the head.", choices=("paper", "rep155"))
    sense_hfov: float = parameter(
        90.0, "Horizontal field of view of the camera.", unit="deg", minimum=10.0, maximum=160.0)
    sense_range: float = parameter(10.0, "Distance up to which bodies are seen.", unit="m", minimum=0.5, maximum=50.0)
    sense_face_range: float = parameter(
        6.0, "Distance up to which faces are found.", unit="m", minimum=0.5, maximum=50.0)
    sense_face_angle: float = parameter(
        80.0, "A face turned away by more is not found.", unit="deg", minimum=10.0, maximum=180.0)
    sense_occlusion: bool = parameter(True, "People hide those behind them, like upright cylinders.")
    sense_face_rate: float = parameter(
        0.0, "Images per second in which faces are found; 0: all.", unit="Hz", minimum=0.0, maximum=200.0)
    sense_body_rate: float = parameter(
        0.0, "Images per second in which bodies are found; 0: all.", unit="Hz", minimum=0.0, maximum=200.0)
    sense_voice_rate: float = parameter(
        0.0, "Directions of a voice per second; 0: every cycle.", unit="Hz", minimum=0.0, maximum=200.0)
    sense_position_noise: float = parameter(
        0.02, "Standard deviation of positions across the view, each axis.", unit="m", minimum=0.0, maximum=2.0)
    sense_depth_noise: float = parameter(
        0.03, "Standard deviation of the distance, as a share of it.", minimum=0.0, maximum=1.0)
    sense_head_noise: float = parameter(
        5.0, "Standard deviation of the head's direction, each axis.", unit="deg", minimum=0.0, maximum=90.0)
    sense_gaze_noise: float = parameter(
        8.0, "Standard deviation of the gaze's direction, each axis.", unit="deg", minimum=0.0, maximum=90.0)
    sense_body_noise: float = parameter(
        10.0, "Standard deviation of the heading of the trunk.", unit="deg", minimum=0.0, maximum=180.0)
    sense_voice_noise: float = parameter(
        8.0, "Standard deviation of a voice's direction, each axis.", unit="deg", minimum=0.0, maximum=180.0)
    sense_noise_share: float = parameter(
        0.5, "Part of the noise's variance that is correlated in time; the rest is white.", minimum=0.0, maximum=1.0)
    sense_noise_time: float = parameter(0.5, "Correlation time of that part.", unit="s", minimum=0.01, maximum=60.0)
    sense_lid_errors: float = parameter(
        0.02, "Share of the images with open eyes taken for closed, or closed for open.", minimum=0.0, maximum=0.5)
    sense_dropout: float = parameter(
        0.1, "Share of the time that a visible face or body is not found.", minimum=0.0, maximum=0.9)
    sense_dropout_time: float = parameter(0.3, "Mean length of such a gap.", unit="s", minimum=0.01, maximum=60.0)
    sense_hold: float = parameter(
        1.0, "Time that a lost feature stays listed; after that it comes back with a new id.", unit="s", minimum=0.0,
        maximum=60.0)
    sense_birth_delay: float = parameter(
        0.2, "Time until a new feature is listed.", unit="s", minimum=0.0, maximum=10.0)
    sense_id_changes: float = parameter(
        0.0, "How often a feature changes its id, per feature.", unit="1/min", minimum=0.0, maximum=600.0)
    sense_ghosts: float = parameter(
        0.0, "How often a face is found where none is; it lasts for half a second or a little more.", unit="1/min",
        minimum=0.0, maximum=600.0)
    sense_voices: bool = parameter(True, "People who speak are voices.")
    sense_voice_hold: float = parameter(
        2.0, "Time that a silent voice stays listed.", unit="s", minimum=0.0, maximum=60.0)


SCENE_PARAMETERS = ParameterTable("scene_simulator", SceneSettings)


def sense_defaults(**changes: object) -> SceneSettings:
    """Return the settings of Senses: the defaults, and what is given by name. Raises ParameterError."""
    return SCENE_PARAMETERS.resolve(changes)
