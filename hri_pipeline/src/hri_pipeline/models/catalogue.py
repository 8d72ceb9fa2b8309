"""What can be fetched: the files, and what they are made of (`package_table` holds the packages)."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import Any, List, Mapping, Sequence, Tuple

from hri_pipeline.models import evaluation_media, names
from hri_pipeline.models.errors import FetchError
from hri_pipeline.models.package_table import PACKAGES, Package

__all__ = ["CONVERTER_REVISION", "PACKAGES", "PRODUCTS", "Package", "Product", "select"]

CONVERTER_REVISION = 1  # raised when a converter's results change: the next fetch then renews the files


@dataclass(frozen=True)
class Product:
    """A file in the models directory: made by `converter` from `members` (path -> sha256) of a package."""

    output: str
    package: str
    members: Mapping[str, str]
    converter: str
    licence: str
    purpose: str
    options: Mapping[str, Any] = field(default_factory=dict)
    default: bool = True

    @property
    def name(self) -> str:
        """The name for the command line: the file name without its ending."""
        return str(PurePosixPath(self.output).with_suffix(""))

    @property
    def is_picture(self) -> bool:
        """Whether it is a picture or film, without which the nodes work as well."""
        return self.output in names.DEMO_PICTURES or self.for_evaluation

    @property
    def for_evaluation(self) -> bool:
        """Whether only the benchmark and the tests need it."""
        return self.output.startswith(evaluation_media.DIRECTORY)


_SILERO_SHA256 = "1a153a22f4509e292a94e67d6f9b85e8deb25b4988682b7e174c65279d8788e3"
_FACE_ASSETS_SHA256 = "dbe5905c582c0462cdaea17e7e6ecea92edaa8cccc515c5e2e7291f2cbb5fb99"
_FACE_LOADER_SHA256 = "95147c15fdf12ba8b9ffc3c3964dbdfa1ffa4251182749babca19e75962bf128"
_MODULES = "mediapipe/modules/"
_MOVENET = "StatefulPartitionedCall/"


def _tflite(
    output: str, package: str, member: str, sha256: str, purpose: str, default: bool = True
) -> Product:
    return Product(
        output,
        package,
        {member: sha256},
        "tflite",
        "Apache-2.0",
        purpose,
        {"outputs": names.TENSORS[output].outputs},
        default,
    )


def _tfjs(
    output: str,
    stem: str,
    json_sha256: str,
    bin_sha256: str,
    licence: str,
    purpose: str,
    options: Mapping[str, Any],
    default: bool,
) -> Product:
    members = {"package/models/%s.json" % stem: json_sha256, "package/models/%s.bin" % stem: bin_sha256}
    return Product(output, "human", members, "tfjs", licence, purpose, options, default)


def _faceapi(
    output: str, network: str, json_sha256: str, bin_sha256: str, licence: str, purpose: str
) -> Product:
    members = {
        "package/model/%s_model-weights_manifest.json" % network: json_sha256,
        "package/model/%s_model.bin" % network: bin_sha256,
    }
    return Product(output, "face-api", members, "faceapi", licence, purpose, {"network": network})


def _pictures(sums: Sequence[str]) -> Tuple[Product, ...]:
    return tuple(
        Product(
            output,
            "face-api",
            {"package/" + output: sha256},
            "copy",
            "MIT (package)",
            "group photograph for the demonstration and the tests",
        )
        for output, sha256 in zip(names.DEMO_PICTURES, sums)
    )


def _evaluation_media() -> Tuple[Product, ...]:
    return tuple(
        Product(output, package, {member: sha256}, "copy", evaluation_media.LICENCE, "real faces", default=False)
        for output, package, member, sha256 in evaluation_media.evaluation_files()
    )


PRODUCTS: Tuple[Product, ...] = (
    (
        _tflite(
            names.FACE_DETECTION_FULL_RANGE,
            "mediapipe",
            _MODULES + "face_detection/face_detection_full_range_sparse.tflite",
            "2c3728e6da56f21e21a320433396fb06d40d9088f2247c05e5635a688d45dfe1",
            "faces up to about 5 m",
        ),
        _tflite(
            names.FACE_DETECTION_SHORT_RANGE,
            "mediapipe",
            _MODULES + "face_detection/face_detection_short_range.tflite",
            "bbff11cebd1eb27a1e004cae0b0e63ec8c551cbf34a4451148b4908b8db3eca8",
            "faces up to about 2 m, faster",
        ),
        _tflite(
            names.FACE_LANDMARKS_ATTENTION,
            "mediapipe",
            _MODULES + "face_landmark/face_landmark_with_attention.tflite",
            "e06a804e0144f9929eda782122916b35d60c697c3c9344013ca2bbe76a6ce2b4",
            "face mesh of 468 points with refined lips, eyes and irises",
        ),
        _tflite(
            names.POSE_LANDMARKS_FULL,
            "mediapipe",
            _MODULES + "pose_landmark/pose_landmark_full.tflite",
            "e9a5c5cb17f736fafd4c2ec1da3b3d331d6edbe8a0d32395855aeb2cdfd64b9f",
            "body pose, 33 points in 2D and 3D",
        ),
        _tfjs(
            names.PERSON_CENTERNET,
            "centernet",
            "bfb942eaacc5becf738d536663bc4580a0ae9e560722306e6d4dd7fe4a09de05",
            "1b635a15009071f506f9f2b3519b31c072c534888989f30d269ffd44734ef7ef",
            "MIT (package); licence of the weights not stated",
            "people in the whole image (CenterNet, COCO)",
            {
                "inputs": {"tower_0/images": "images"},
                "dynamic_size": True,
                "outputs": {"tower_0/keypoints": "heat", "tower_0/wh": "ltrb"},
            },
            True,
        ),
        _faceapi(
            names.FACE_EXPRESSION,
            "face_expression",
            "5b349c17c7836da506e03422cd6461c74085d8bb2713ad4114647dc5d28174c8",
            "9a9840f2cf1f4c7eab95f197512569345c00d2426754d4608b92af30e0300f3d",
            "MIT",
            "seven facial expressions",
        ),
        _faceapi(
            names.AGE_GENDER,
            "age_gender",
            "74b60bf3ebf981bf4e661e9cca3a185614e10b25d797118b62e2a68d3ff2569f",
            "49f92bbc0afef2342c4385e4a2b0acb6d7a727c6f0aa539499719a81acf9abaa",
            "MIT",
            "apparent age and gender",
        ),
        _faceapi(
            names.FACE_RECOGNITION,
            "face_recognition",
            "cbaffa501b0b9275a12b63357a6843e7e30c054e1c9151e1a5f879b26e32986b",
            "b413e420d6840b2775fba32008db6f3cddb07d485967fb42cfcf379c16a8c589",
            "MIT (package); weights of dlib, CC0",
            "128 numbers that tell faces apart",
        ),
        Product(
            names.SILERO_VAD,
            "silero-vad",
            {"silero_vad/data/silero_vad.onnx": _SILERO_SHA256},
            "copy",
            "MIT",
            "speech or silence, 32 ms frames at 16 kHz",
        ),
        Product(
            names.CANONICAL_FACE,
            "face-mesh",
            {
                "package/face_mesh_solution_packed_assets.data": _FACE_ASSETS_SHA256,
                "package/face_mesh_solution_packed_assets_loader.js": _FACE_LOADER_SHA256,
            },
            "canonical_face",
            "Apache-2.0",
            "the metric shape of a mean face, for head pose",
        ),
    )
    + _pictures(
        (
            "8ecae4b267b2d3169e06e00c7dee97097aa2a94635d45216f7732a5f4943cb51",
            "7d2b60ae6f13bf30f422e04df87451081a02c83de469056f25afb44b7000c691",
            "8eb081c9efb14370fa94d9feab9e5fbeafd19a627491853a80c2bf67f7ffa936",
            "729efa5923061d40eb4ed5f267a18cc7b8ba6f852bb2757b16d8b7e4937476fc",
            "6d45095ebb182d8f975c0790e0e4eefd86fbb40609cf4b271776d92e12662938",
            "9baad80f9d5e306fb9b8c0913d44445f1e95848df317530efb03d0934c57ba87",
        )
    )
    + (
        _tflite(
            names.POSE_LANDMARKS_LITE,
            "pose",
            "package/pose_landmark_lite.tflite",
            "f17bfbecadb61c3be1baa8b8d851cc6619c870a87167b32848ad20db306b9d61",
            "body pose, faster and less exact",
            default=False,
        ),
        _tflite(
            names.POSE_LANDMARKS_HEAVY,
            "pose",
            "package/pose_landmark_heavy.tflite",
            "59e42d71bcd44cbdbabc419f0ff76686595fd265419566bd4009ef703ea8e1fe",
            "body pose, slower and more exact",
            default=False,
        ),
        _tflite(
            names.POSE_DETECTION,
            "mediapipe",
            _MODULES + "pose_detection/pose_detection.tflite",
            "9ba9dd3d42efaaba86b4ff0122b06f29c4122e756b329d89dca1e297fd8f866c",
            "one or two near people (BlazePose)",
            default=False,
        ),
        _tfjs(
            names.MOVENET,
            "movenet-lightning",
            "df8cbde44d00f533ccc4916a7c6ebc17316532fb3fadad114ec667fef22872e9",
            "bf97bc10d9c8a11200b0190ed64ce039b6252f1aff7cb552aca99b3d191c2f34",
            "Apache-2.0",
            "people and 17 rough points each, the four network heads (MoveNet Lightning)",
            {
                "inputs": {"input": "images"},
                "dynamic_size": True,
                "outputs": {
                    _MOVENET + "Sigmoid": "keypoint_heat",
                    _MOVENET + "kpt_regress_0/conv2d_6/BiasAdd": "keypoint_regression",
                    _MOVENET + "Sigmoid_1": "center_heat",
                    _MOVENET + "kpt_offset_0/conv2d_7/BiasAdd": "keypoint_offset",
                },
            },
            False,
        ),
        _tfjs(
            names.FACERES,
            "faceres",
            "5b83d49c0385d2e68a05122441b94226313677cae9fcc40b9587ad50079eb4df",
            "2c7d2d62b76c97528b736527aa09d310ea71743c9e3e79fb6c62d4b2d73af79b",
            "MIT (package); weights trained on VGGFace2, licence not verified",
            "age, gender and 1024 numbers that tell faces apart",
            {
                "outputs": {
                    "gender_pred/Sigmoid": "gender",
                    "global_pooling/Mean": "descriptor",
                    "age_pred/Softmax": "age",
                }
            },
            False,
        ),
    )
    + _evaluation_media()
)


def select(wanted: Sequence[str]) -> List[Product]:
    """The products of the given names (with or without ending), or of the groups default, demo, evaluation and all.

    `all` leaves out the pictures and films for evaluation: they are fetched only when they are named.

    FetchError lists the known names when one is not known.
    """
    groups = {
        "default": [p for p in PRODUCTS if p.default],
        "demo": [p for p in PRODUCTS if p.output in names.DEMO_PICTURES],
        "evaluation": [p for p in PRODUCTS if p.for_evaluation],
        "all": [p for p in PRODUCTS if not p.for_evaluation],
    }
    chosen = set()
    for name in wanted:
        matching = groups.get(name) or [p for p in PRODUCTS if name in (p.name, p.output)]
        if not matching:
            known = [p.name for p in PRODUCTS if not p.is_picture]
            raise FetchError(
                "unknown model '%s'; known are: %s, and the groups default, demo, evaluation, all"
                % (name, ", ".join(known))
            )
        chosen.update(p.output for p in matching)
    return [p for p in PRODUCTS if p.output in chosen]
