"""The parameters of the overlay node."""

from __future__ import annotations

from dataclasses import dataclass

from hri_pipeline.core.parameters import ParameterTable, Settings, list_timeout_parameter, parameter


@dataclass(frozen=True)
class OverlaySettings(Settings):
    """Draws skeletons, face landmarks, names, expressions and gazes on the camera image, while somebody looks."""

    image_transport: str = parameter(
        "raw", "Which topic to take the image from: `image`, or `image/compressed`.", choices=("raw", "compressed"))
    max_rate: float = parameter(10.0, "Most images per second.", unit="Hz", minimum=0.1, maximum=120.0, live=True)
    history: int = parameter(
        30, "How many of the latest images are kept until their faces and bodies arrive. Each takes width x height x "
        "3 bytes.", minimum=2, maximum=300)
    pair_tolerance: float = parameter(
        0.15, "Largest difference between the stamps of an image and of a feature drawn on it, where none has the "
        "image's stamp.", unit="s", minimum=0.0, maximum=2.0, live=True)
    min_confidence: float = parameter(
        0.3, "Key points and landmarks below this confidence are left out.", minimum=0.0, maximum=1.0, live=True)
    names: bool = parameter(True, "Write the names of persons who have one; false: their ids.")
    expressions: bool = parameter(
        True, "Write what faces express. The faces node finds it out for those who listen: false spares that, too.")
    gazes: bool = parameter(True, "Draw who looks at whom, and write who looks at the robot.")
    list_timeout: float = list_timeout_parameter()


OVERLAY_PARAMETERS = ParameterTable("overlay", OverlaySettings)
