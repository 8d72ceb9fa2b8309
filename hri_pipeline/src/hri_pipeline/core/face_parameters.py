"""Parameters of the node `faces`."""

from __future__ import annotations

from hri_pipeline.core.onnx_model import PROVIDERS
from hri_pipeline.core.parameters import Parameter, ParameterTable

FACE_STAGE_PARAMETERS = (
    Parameter("face_detector_model", "", "ONNX file of the face detector. Empty: face_detection_full_range.onnx in"
              " the models directory ($ROS4HRI_MODELS, or ~/.cache/ros4hri/models)."),
    Parameter("face_mesh_model", "", "ONNX file of the face mesh with attention. Empty:"
              " face_landmarks_attention.onnx in the models directory."),
    Parameter("canonical_face", "", "The mean face used for head poses. Empty: canonical_face.npz in the models"
              " directory."),
    Parameter("max_faces", 10, "Most faces tracked at the same time. Each costs 2 to 3 ms per frame on one core.",
              minimum=1, maximum=64),
    Parameter("min_detection_score", 0.6, "Score from which a detection may start a track. Lower finds fainter"
              " faces and more things that are none.", minimum=0.05, maximum=0.99),
    Parameter("min_face_presence", 0.5, "Probability from which the mesh network is believed that it still sees a"
              " face. Higher lets go of hidden faces sooner.", minimum=0.05, maximum=0.99),
    Parameter("face_detection_period", 0.3, "Time between two looks of the detector at the whole image; between them"
              " the mesh follows the known faces. Smaller finds new faces sooner and costs more. 0: every image.",
              unit="s", minimum=0.0, maximum=10.0),
    Parameter("face_detection_tiles", 2, "The image is also searched in tiles x tiles parts, one part half-way between"
              " two looks at the whole, for faces too small for it. 1: no tiles.", minimum=1, maximum=4),
    Parameter("face_birth_delay", 0.1, "Time for which a face must be seen before it gets its topics. Larger keeps out"
              " more flickering false faces.", unit="s", minimum=0.0, maximum=10.0),
    Parameter("face_death_time", 1.0, "Time after which a face that is not seen any more is dropped with its id."
              " Larger bridges longer occlusions.", unit="s", minimum=0.05, maximum=60.0),
    Parameter("face_min_detections", 2, "How many runs of the detector must have seen a face before it gets its topics."
              " 1 finds faces one detection period sooner, and takes a badge or a pattern for a face more often.",
              minimum=1, maximum=20),
    Parameter("face_support_time", 4.0, "Time after which a face that only its mesh still sees, and the detector does"
              " not, is dropped: it is a pattern that looked like a face for a moment.",
              unit="s", minimum=0.5, maximum=600.0),
)
"""What FaceStage needs."""

CAMERA_PARAMETERS = (
    Parameter("providers", ["cpu"], "Execution providers for the networks, in order of preference; one that is not"
              " available is told once and skipped.", choices=tuple(PROVIDERS)),
    Parameter("image_transport", "raw", "Transport of the input: `raw` subscribes to `image`, `compressed` to"
              " `image/compressed`.", choices=("raw", "compressed")),
    Parameter("fallback_fov", 1.0472, "Horizontal field of view of the camera while there is no calibration"
              " (camera_info missing, or its K all zero). Distances scale with it.",
              unit="rad", minimum=0.1, maximum=3.0),
    Parameter("max_rate", 20.0, "Most images processed per second; the others are skipped, which leaves more of the"
              " processor to others. 0: as fast as they come.",
              unit="Hz", minimum=0.0, maximum=1000.0),
    Parameter("interface", "paper", "Type of `roi`: `paper` is sensor_msgs/RegionOfInterest in pixels, `rep155` is"
              " hri_msgs/NormalizedRegionOfInterest2D.", choices=("paper", "rep155")),
)
"""What every node that works on the camera's images needs."""

FACES = ParameterTable(
    "faces",
    "Node faces: finds and follows faces, their 70 landmarks and their pose in front of the camera.",
    FACE_STAGE_PARAMETERS + CAMERA_PARAMETERS,
)
