"""Parameters of the face_body_matcher node."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter, ParameterTable

MATCHER_PARAMETERS = ParameterTable(
    "face_body_matcher", "Finds out which face belongs to which body, from their positions in the image.", (
        Parameter("distance_scale", 0.6,
                  "Mean distance between the eyes and nose of a face and those of a skeleton, in sizes of the "
                  "face, at which the likelihood has fallen to 0.61. Higher: more tolerant of inexact "
                  "skeletons, less certain among faces close together.", unit="face sizes", minimum=0.05,
                  maximum=2.0, live=True),
        Parameter("min_likelihood", 0.3, "A face and a body of less likelihood are not matched.",
                  minimum=0.01, maximum=1.0, live=True),
        Parameter("min_point_confidence", 0.3,
                  "Points of the face or the skeleton of less confidence are not used.", minimum=0.0, maximum=1.0, live=True),
        Parameter("smoothing_time", 0.3,
                  "Time constant of the likelihood of a pair. Longer: fewer changes, later corrections.",
                  unit="s", minimum=0.0, maximum=10.0, live=True),
        Parameter("stay_bonus", 0.1,
                  "Likelihood by which another body has to be better before a face changes over to it.",
                  minimum=0.0, maximum=0.5, live=True),
        Parameter("max_stamp_difference", 0.15,
                  "Face and skeleton are compared when their images are at most this far apart.", unit="s",
                  minimum=0.0, maximum=1.0, live=True),
        Parameter("hold_time", 10.0,
                  "A pair that cannot be compared for so long, because one side is tracked without being "
                  "seen, is withdrawn. Long enough for a node that died to come back: its faces stay listed until then.", unit="s", minimum=0.1, maximum=30.0, live=True),
    ))
