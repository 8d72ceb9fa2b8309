"""The parameters of the overlay node."""

from __future__ import annotations

from hri_pipeline.core.parameters import LIST_TIMEOUT, Parameter, ParameterTable

OVERLAY_PARAMETERS = ParameterTable(
    "overlay",
    "Draws skeletons, face landmarks, names, expressions and gazes on the camera image, while somebody looks.",
    [
        Parameter("image_transport", "raw", "Which topic to take the image from: `image`, or `image/compressed`.",
                  choices=("raw", "compressed")),
        Parameter("max_rate", 10.0, "Most images per second.", unit="Hz", minimum=0.1, maximum=120.0, live=True),
        Parameter("history", 30, "How many of the latest images are kept until their faces and bodies arrive. Each "
                  "takes width x height x 3 bytes.", minimum=2, maximum=300),
        Parameter("pair_tolerance", 0.15, "Largest difference between the stamps of an image and of a feature drawn "
                  "on it, where none has the image's stamp.",
                  unit="s", minimum=0.0, maximum=2.0, live=True),
        Parameter("min_confidence", 0.3, "Key points and landmarks below this confidence are left out.",
                  minimum=0.0, maximum=1.0, live=True),
        Parameter("names", True, "Write the names of persons who have one; false: their ids."),
        Parameter("expressions", True, "Write what faces express. The faces node finds it out for those who listen: "
                  "false spares that, too."),
        Parameter("gazes", True, "Draw who looks at whom, and write who looks at the robot."),
        LIST_TIMEOUT,
    ],
)
