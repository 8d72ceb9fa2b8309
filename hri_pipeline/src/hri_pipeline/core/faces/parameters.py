"""Parameters of the node `faces`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Sequence

from hri_pipeline.core.image_rotation import CHOICES
from hri_pipeline.core.onnx import PROVIDERS
from hri_pipeline.core.parameters import ParameterTable, Settings, parameter


@dataclass(frozen=True)
class PersonDetectorSettings(Settings):
    """What faces and bodies ask where there are people."""

    person_detector_model: str = parameter("", "ONNX file of the person detector. Empty: person_centernet.onnx.")


@dataclass(frozen=True)
class FaceTrackingSettings(PersonDetectorSettings):
    """What finding and following faces needs."""

    face_detector_model: str = parameter(
        "", "ONNX file of the face detector. Empty: face_detection_full_range.onnx in the models directory, as for the "
        "files below.")
    face_mesh_model: str = parameter("", "ONNX file of the face mesh. Empty: face_landmarks_attention.onnx.")
    face_blendshapes_model: str = parameter("", "ONNX file of the movements of the face. Empty: face_blendshapes.onnx.")
    canonical_face: str = parameter("", "The mean face, for head poses. Empty: canonical_face.npz.")
    max_faces: int = parameter(
        10, "Most faces tracked at the same time: of more, the large and central ones. A run on one costs 2 to 5 ms "
        "on one core.", minimum=1, maximum=64, live=True)
    min_detection_score: float = parameter(
        0.6, "Score from which a detection may start a track. Lower finds fainter faces and more things that are none.",
        minimum=0.05, maximum=0.99, live=True)
    min_face_presence: float = parameter(
        0.5, "Probability of the mesh network below which a face is lost. Higher lets go of hidden faces sooner.",
        minimum=0.05, maximum=0.99, live=True)
    face_person_lead: float = parameter(
        0.0, "A new face of which the face detector is not sure (a score below 0.9) gets topics when the person "
        "detector scores a person around it by this factor as high as anything else. Asked once, and each second anew "
        "while it is refused and moves, each three times at one place with less demand. Each costs 30 ms; 33 MB of "
        "memory are taken at the start of the node, where this is above 0 then, else when it first asks (none in "
        "`vision`). Larger refuses more animals and toys, and more people who are masked, tiny or blurred. 0: never "
        "asked.", minimum=0.0, maximum=10.0, live=True)
    face_detection_period: float = parameter(
        0.3, "Time between two searches of the whole image; twice this while every face is known. Smaller finds new "
        "faces sooner and costs more. 0: every image.", unit="s", minimum=0.0, maximum=10.0, live=True)
    face_detection_tiles: int = parameter(
        3, "Small faces are searched in tiles x tiles parts of the image, one between two runs on the whole: a part in "
        "which something has changed, or where a face waits for its confirmation. 1: no tiles.", minimum=1, maximum=4)
    face_mesh_rate: float = parameter(
        10.0, "Least runs of the mesh network on each face (see `cpu_share`); in the images between, the face goes "
        "where its picture goes (optical flow), with a confidence that says so. Higher follows quick heads better, and "
        "costs more. 0: every image.", unit="Hz", minimum=0.0, maximum=120.0, live=True)
    face_budget: float = parameter(
        10.0, "Processor time per image for the mesh network (see `cpu_share`). With more faces than it allows, they "
        "take turns. On a faster machine the same budget means more runs. The networks behind it (expression, age and "
        "gender, recognition) take three quarters of it at most, over time, and 0.3 s at once for who has just come.",
        unit="ms", minimum=1.0, maximum=1000.0, live=True)
    face_birth_delay: float = parameter(
        0.1, "Time that a face must be seen before it gets topics. Larger keeps out more flickering false faces.",
        unit="s", minimum=0.0, maximum=10.0, live=True)
    face_death_time: float = parameter(
        1.0, "Time after which a lost face ends. Larger bridges longer occlusions.", unit="s", minimum=0.05,
        maximum=60.0, live=True)
    face_min_detections: int = parameter(
        2, "Detections before a face gets topics. 1 finds faces one detection period sooner, and takes a badge or a "
        "pattern for a face more often.", minimum=1, maximum=20, live=True)
    face_support_time: float = parameter(
        4.0, "Time after which a face that the detector no longer finds ends: it was a pattern that looked like a face "
        "for a moment.", unit="s", minimum=0.5, maximum=600.0, live=True)


@dataclass(frozen=True)
class FaceAnalysisSettings(Settings):
    """What is found out about each face; each can be switched off on its own (config/privacy_strict.yaml: all)."""

    action_units: bool = parameter(
        True, "Publish the action units of each face (`facs`). Facial movements are personal data.")
    expression: bool = parameter(
        True, "Publish the expression of each face (`expression`). In the European Union, inferring emotions at work "
        "and in education is forbidden (AI Act, Art. 5(1)(f)).")
    age_gender: bool = parameter(True, "Publish apparent age and gender of each face (`softbiometrics`).")
    recognition: bool = parameter(
        True, "Recognise persons by their faces and say so on /humans/candidate_matches. Templates of faces are kept "
        "in memory; on disk only with `gallery`.")
    expression_model: str = parameter("", "ONNX file of the expression network. Empty: face_expression.onnx.")
    age_gender_model: str = parameter(
        "", "ONNX file of the age and gender network. Empty: age_gender.onnx. One with the inputs and outputs of "
        "age-gender-recognition-retail-0013 is known by them.")
    recognition_model: str = parameter(
        "", "Recognition network: `face_recognition`, `mobilefacenet`, `faceres`, or an ONNX file of one of them; "
        "empty: face_recognition. `mobilefacenet` tells alike people better; its licence stands in docs/models.md, "
        "and `fetch_models --models mobilefacenet` gets it. Each has templates of its own in `gallery`: who was "
        "learnt with one is not known to another, and is kept.")
    recognition_policy: str = parameter(
        "learn", "`learn`: an unknown face that is seen well becomes a new person; `enrolled`: only enrolled people "
        "are recognised.", choices=("learn", "enrolled"))
    recognition_learn_delay: float = parameter(
        1.5, "Time until an unknown face becomes a new person. Larger makes fewer persons of passers-by.", unit="s",
        minimum=0.0, maximum=600.0, live=True)
    gallery: str = parameter(
        "", "SQLite file that keeps who is known beyond the run: ids, templates and times, readable by its owner "
        "alone, in a directory of its own, whose name ends in .sqlite. It can be shared with the person manager (its "
        "`store`) and other recognisers. NAME.npz, a gallery of earlier versions: its people are moved to "
        "NAME.sqlite. Empty: in memory only.")
    gallery_key: str = parameter(
        "", "File with the key that encrypts `gallery`; make one with `rosrun hri_person_manager people make-key "
        "FILE`. Empty: not encrypted.")
    gallery_read_only: Sequence[str] = parameter(
        [], "More stores to recognise people from, never changed: plain ones, or with the key of `gallery_key`.")


@dataclass(frozen=True)
class CameraSettings(Settings):
    """What every node that works on the camera's images needs."""

    providers: Sequence[str] = parameter(
        ["cpu"], "Execution providers of the networks, by preference; one that is not available is told once and "
        "skipped.", choices=tuple(PROVIDERS))
    image_transport: str = parameter(
        "raw", "`raw`: subscribe to `image`; `compressed`: to `image/compressed`.", choices=("raw", "compressed"))
    fallback_fov: float = parameter(
        1.0472, "Horizontal field of view of a camera without calibration. Distances scale with it.", unit="rad",
        minimum=0.1, maximum=3.0)
    up_frame: str = parameter(
        "", "TF frame whose z axis points up from the floor, such as `map` or `base_footprint`: gives roll, tilt and "
        "height of the camera, for `image_rotation`, places and postures. Empty: none.")
    image_rotation: str = parameter(
        "auto", "Degrees by which images are turned clockwise so that people stand upright in them: 180 for a camera "
        "that is mounted upside down, 90 for one that is rolled clockwise, as seen from behind it. `auto`: the nearest "
        "by `up_frame` at the time of the image, 0 without one. All that is published is of the image as it came, and "
        "in its frame.", choices=CHOICES)
    ignored_regions: Sequence[str] = parameter(
        [], "Where nobody begins: posters, screens. A text `x y width height` for each region, as shares of the image "
        "from its upper left corner, of a camera that stands still. Who comes from elsewhere is followed through it.")
    max_rate: float = parameter(
        30.0, "Most images processed per second; the others are skipped, which leaves more of the processor to "
        "others. 0: as fast as they come.", unit="Hz", minimum=0.0, maximum=1000.0, live=True)
    cpu_share: float = parameter(
        0.75, "Load of all cores (0 to 1, all processes), and of a container's quota, up to which people get more "
        "inferences than the rates and budgets say: up to every image, who moves, speaks, is near or uncertain before "
        "others. When others need the processor, it is given back within a second or two. 0: never. Above 0.95: 0.95, "
        "as others are seen to need the processor by the idle time that is left.", minimum=0.0, maximum=1.0, live=True)
    threads: int = parameter(
        0, "Threads of the networks, which share the people of an image. 0: half of `cpu_share` of the cores (at the "
        "start), eight at most, one on two cores. With more, everybody is looked at more often. For a GPU they only "
        "cut the images. Cores are those that the process may use: affinity, and quotas of containers and of systemd.",
        minimum=0, maximum=64)
    max_age: float = parameter(
        0.1, "Age of an image up to which more people get an inference; each gets two per second all the same.",
        unit="s", minimum=0.01, maximum=10.0, live=True)
    interface: str = parameter(
        "paper", "Type of `roi`: `paper` is sensor_msgs/RegionOfInterest in pixels, `rep155` is "
        "hri_msgs/NormalizedRegionOfInterest2D. With `rep155` gaze_ID goes on while the eyes are closed, with the "
        "direction of the head.", choices=("paper", "rep155"))


@dataclass(frozen=True)
class DepthCameraSettings(CameraSettings):
    """What those of them need that can use a depth image, too."""

    use_depth: bool = parameter(
        False, "Place people by `depth`, a depth image registered to the colour image. Without depth for an image, a "
        "face stands where its size and its irises put it, a body where face, floor and size do.")
    depth_slop: float = parameter(
        0.03, "Largest difference between the stamps of image and depth image. Larger takes more pairs of cameras that "
        "are not synchronised, and puts moving people where they were.", unit="s", minimum=0.0, maximum=1.0)


@dataclass(frozen=True)
class FacePipelineSettings(FaceTrackingSettings, FaceAnalysisSettings, CameraSettings):
    """What FacePipeline needs."""


@dataclass(frozen=True)
class FacesSettings(FacePipelineSettings, DepthCameraSettings):
    """Node faces: finds and follows faces, their 70 landmarks, pose, gaze, action units, expression, apparent age and
    gender, and whose they are."""


FACES = ParameterTable("faces", FacesSettings)
