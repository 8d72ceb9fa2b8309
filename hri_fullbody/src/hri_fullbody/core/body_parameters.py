"""Parameters of the nodes `bodies` and `vision`."""

from __future__ import annotations

from hri_pipeline.core.face_parameters import CAMERA_PARAMETERS, FACE_STAGE_PARAMETERS
from hri_pipeline.core.parameters import Parameter, ParameterTable

BODY_STAGE_PARAMETERS = (
    Parameter("person_detector_model", "", "ONNX file of the person detector. Empty: person_centernet.onnx in the"
              " models directory ($ROS4HRI_MODELS, or ~/.cache/ros4hri/models)."),
    Parameter("pose_model", "", "ONNX file of the pose network. Empty: pose_landmarks_full.onnx in the models"
              " directory. pose_landmarks_lite.onnx is faster, pose_landmarks_heavy.onnx more exact."),
    Parameter("max_bodies", 10, "Most bodies tracked at the same time. Each costs 6 to 15 ms per image on one core.",
              minimum=1, maximum=64),
    Parameter("min_body_score", 0.5, "Probability from which the pose network is believed that it sees a body. Higher"
              " lets go of hidden bodies sooner.", minimum=0.05, maximum=0.99),
    Parameter("min_person_score", 0.3, "Score from which the person detector's box may start a body. Lower finds"
              " fainter people and more things that are none.", minimum=0.05, maximum=0.99),
    Parameter("person_detection_size", 512, "Longer side of the person detector's input. Larger finds people farther"
              " away; the time grows with its square (17 to 40 ms at 512).", unit="px", minimum=128, maximum=1920),
    Parameter("person_detection_period", 0.7, "Time between two runs of the person detector; between them the pose"
              " network follows the known bodies. Smaller finds new people sooner and costs more. 0: every image.",
              unit="s", minimum=0.0, maximum=10.0),
    Parameter("new_windows_per_image", 3, "Most places per image that are searched for new bodies, 6 to 15 ms each."
              " Larger finds a group sooner, smaller keeps the frame rate even.", minimum=1, maximum=64),
    Parameter("body_birth_delay", 0.1, "Time for which a body must be seen before it gets its topics. Larger keeps out"
              " more flickering false bodies.", unit="s", minimum=0.0, maximum=10.0),
    Parameter("body_death_time", 1.0, "Time after which a body that is not seen any more is dropped with its id."
              " Larger bridges longer occlusions.", unit="s", minimum=0.05, maximum=60.0),
)
"""What BodyStage needs, besides `providers`."""

BODIES = ParameterTable(
    "bodies",
    "Node bodies: finds and follows bodies, their 18 key points and their place in front of the camera.",
    BODY_STAGE_PARAMETERS + CAMERA_PARAMETERS,
)

VISION = ParameterTable(
    "vision",
    "Node vision: the nodes faces and bodies in one process; an image is received and decoded once.",
    FACE_STAGE_PARAMETERS + BODY_STAGE_PARAMETERS + CAMERA_PARAMETERS,
)
