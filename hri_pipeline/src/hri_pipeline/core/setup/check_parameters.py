"""Parameters of the check of a running set-up."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter, ParameterTable

CHECK_PARAMETERS = ParameterTable(
    "check", "Looks at the running graph and says in words why nobody appears.", (
        Parameter("nodes", ["hri_faces", "hri_bodies", "hri_face_body_matcher", "hri_person_manager"],
                  "Names of the nodes that have to run, without a slash; hri_vision stands for hri_faces and hri_bodies. "
                  "Leave out those whose branch is switched off."),
        Parameter("watch_time", 6.0,
                  "How long the graph is listened to before it is judged. Longer: slower, but finds what comes rarely.",
                  unit="s", minimum=1.0, maximum=120.0),
        Parameter("camera_frame", "",
                  "Frame of the camera; empty: the frame_id of its images."),
        Parameter("min_rate", 3.0, "Images per second below which people cannot be followed.", unit="Hz", minimum=0.1,
                  maximum=60.0),
        Parameter("max_age", 1.0, "Images whose stamp is further than this from now are told: the clocks differ, or the "
                  "network is too slow.", unit="s", minimum=0.05, maximum=60.0),
        Parameter("min_brightness", 25.0, "Mean of the pixels (0 to 255) below which a picture is too dark to find people.",
                  minimum=0.0, maximum=255.0),
        Parameter("min_contrast", 6.0, "Standard deviation of the pixels (0 to 255) below which a picture shows nothing: a "
                  "covered lens, or a test picture of one colour.", minimum=0.0, maximum=128.0),
    ))
