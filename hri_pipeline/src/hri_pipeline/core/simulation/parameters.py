"""Parameters of the scene_simulator node; the rows `sense_...` are the settings of sensors.Senses."""

from __future__ import annotations

from types import SimpleNamespace

from hri_pipeline.core.parameters import Parameter, ParameterTable

DETECTIONS, PERSONS = "detections", "persons"

_SENSES = (
    Parameter("sense_hfov", 90.0, "Horizontal field of view of the camera.", unit="deg", minimum=10.0, maximum=160.0),
    Parameter("sense_range", 10.0, "Distance up to which bodies are seen.", unit="m", minimum=0.5, maximum=50.0),
    Parameter("sense_face_range", 6.0, "Distance up to which faces are found.", unit="m", minimum=0.5, maximum=50.0),
    Parameter("sense_face_angle", 80.0, "A face turned away from the camera by more is not found.", unit="deg",
              minimum=10.0,
              maximum=180.0),
    Parameter("sense_occlusion", True, "Somebody who stands before another hides face and body of the other."),
    Parameter("sense_face_rate", 0.0, "Images per second in which faces are found; 0: all.", unit="Hz", minimum=0.0,
              maximum=200.0),
    Parameter("sense_body_rate", 0.0, "Images per second in which bodies are found; 0: all.", unit="Hz", minimum=0.0,
              maximum=200.0),
    Parameter("sense_voice_rate", 0.0, "How often the direction of a voice is measured; 0: every cycle.", unit="Hz",
              minimum=0.0,
              maximum=200.0),
    Parameter("sense_position_noise", 0.02, "Standard deviation of positions across the line of sight, each axis.",
              unit="m", minimum=0.0, maximum=2.0),
    Parameter("sense_depth_noise", 0.03, "Standard deviation of the distance, as a share of it.", minimum=0.0,
              maximum=1.0),
    Parameter("sense_head_noise", 5.0, "Standard deviation of the direction of the head, each axis.", unit="deg",
              minimum=0.0,
              maximum=90.0),
    Parameter("sense_gaze_noise", 8.0, "Standard deviation of the direction of the gaze, each axis.", unit="deg",
              minimum=0.0,
              maximum=90.0),
    Parameter("sense_body_noise", 10.0, "Standard deviation of the heading of the trunk.", unit="deg", minimum=0.0,
              maximum=180.0),
    Parameter("sense_voice_noise", 8.0, "Standard deviation of the direction of a voice, each axis.", unit="deg",
              minimum=0.0,
              maximum=180.0),
    Parameter("sense_noise_share", 0.5, "Part of the variance of all noise that is correlated in time; the rest is "
                                        "white.",
              minimum=0.0, maximum=1.0),
    Parameter("sense_noise_time", 0.5, "Correlation time of that part.", unit="s", minimum=0.01, maximum=60.0),
    Parameter("sense_lid_errors", 0.02, "Share of the images in which open eyes are read as closed and closed ones as "
                                        "open.",
              minimum=0.0, maximum=0.5),
    Parameter("sense_dropout", 0.1, "Share of the time in which a visible face or body is not found.",
              minimum=0.0,
              maximum=0.9),
    Parameter("sense_dropout_time", 0.3, "Mean length of such a gap.", unit="s", minimum=0.01, maximum=60.0),
    Parameter("sense_hold", 1.0, "How long a feature that is not found stays listed; after that it comes back with a "
                                 "new id.",
              unit="s", minimum=0.0, maximum=60.0),
    Parameter("sense_birth_delay", 0.2, "How long a feature is seen before it is listed.", unit="s", minimum=0.0,
              maximum=10.0),
    Parameter("sense_id_changes", 0.0, "How often a feature gets a new id without reason, per feature.", unit="1/min",
              minimum=0.0,
              maximum=600.0),
    Parameter("sense_ghosts", 0.0, "How often a face is found where nobody is; it lasts for half a second or a little "
                                   "more.",
              unit="1/min", minimum=0.0, maximum=600.0),
    Parameter("sense_voices", True, "People who speak are voices."),
    Parameter("sense_voice_hold", 2.0, "How long a voice stays listed after its last word.", unit="s", minimum=0.0,
              maximum=60.0),
)

SCENE_PARAMETERS = ParameterTable(
    "scene_simulator", "Publishes the people of a scene file as faces, bodies and voices, with the faults of real "
                       "detectors, and the truth.", (
        Parameter("scene", "three_talk", "Scene file (YAML), or the name of one in hri_pipeline/config/scenes."),
        Parameter("seed", 0, "Another seed gives the same scene with other random numbers: looks, talk, noise, gaps.",
                  minimum=0,
                  maximum=2147483647),
        Parameter("level", DETECTIONS, "detections: faces, bodies, voices and matches, for a person manager. "
                  "persons: the persons themselves, without one.",
                  choices=(DETECTIONS, PERSONS)),
        Parameter("rate", 15.0, "Cycles per second of the scene's time: images, transforms, truth.", unit="Hz",
                  minimum=0.5,
                  maximum=100.0),
        Parameter("speed", 1.0, "How much faster than the wall clock the scene goes. Other than 1 with publish_clock "
                                "only.",
                  minimum=0.05, maximum=200.0),
        Parameter("publish_clock", False, "Publish /clock, for nodes with /use_sim_time; this node is then the only "
                  "clock, and takes /use_sim_time back when it ends."),
        Parameter("loop", True, "Start again at the end of the scene, after a pause in which nobody is there; ids are "
                  "new, stamps go on. False: the node ends."),
        Parameter("loop_pause", 2.0, "That pause, in the scene's time.", unit="s", minimum=0.0, maximum=600.0),
        Parameter("wait_for", "", "Topic that must have a subscriber before the scene begins, such as "
                  "/humans/candidate_matches. Empty: begin at once."),
        Parameter("reference_frame", "map", "Frame of the scene: z up, floor at 0."),
        Parameter("robot_frame", "base_link", "Frame of the robot, on the floor."),
        Parameter("camera_frame", "camera_color_optical_frame", "Optical frame of the camera, at the height that the "
                                                                "scene gives."),
        Parameter("microphone_frame", "microphone", "Frame of the voices, at the place of the camera, x forward, z "
                                                    "up."),
        Parameter("publish_robot", True, "Publish the transforms from reference_frame to robot, camera and microphone "
                                         "(static)."),
        Parameter("width", 1280, "Width of the virtual image.", unit="px", minimum=64, maximum=8192),
        Parameter("height", 720, "Height of the virtual image.", unit="px", minimum=64, maximum=8192),
        Parameter("matches", True, "Publish which face, body and voice belong together. False: a matcher does that."),
        Parameter("match_likelihood", 0.85, "Mean likelihood of those matches.", minimum=0.0, maximum=1.0),
        Parameter("wrong_matches", 0.0, "Share of the matches that name the nearest other person, with a likelihood "
                  "of 0.4 at most.",
                  minimum=0.0, maximum=0.5),
        Parameter("recognition", True, "Recognise faces after recognition_delay, by the names in the scene. False: "
                  "all persons are anonymous; somebody whose face and body were lost is somebody new."),
        Parameter("recognition_delay", 2.0, "Time from the first sight of a face to its recognition.", unit="s",
                  minimum=0.0,
                  maximum=600.0),
        Parameter("truth", True, "Publish the truth under /scene/truth."),
        Parameter("interface", "paper", "Type of the topics roi: paper (pixels) or rep155 (normalised). With rep155 "
                  "gaze_ID goes on while the eyes are closed, with the direction of the head.",
                  choices=("paper", "rep155")),
        *_SENSES,
    ))


def sense_defaults(**changes: object) -> SimpleNamespace:
    """Return the settings of Senses: the defaults, and what is given by name. Raises ParameterError."""
    return SCENE_PARAMETERS.resolve(changes)
