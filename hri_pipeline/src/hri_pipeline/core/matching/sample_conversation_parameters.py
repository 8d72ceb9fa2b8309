"""Parameters of the sample_conversation node."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter, ParameterTable

SAMPLE_CONVERSATION_PARAMETERS = ParameterTable(
    "sample_conversation", "Plays a simulated conversation: faces with moving mouths, voices, and where they are.", (
        Parameter("people", 3, "Number of people in view.", minimum=1, maximum=10),
        Parameter("directions", True,
                  "The voices have directions, with an error of 10 degrees, as of an array. Off: one microphone."),
        Parameter("unseen_share", 0.2, "Part of the turns that comes from somebody out of view.", minimum=0.0,
                  maximum=1.0),
        Parameter("seed", 0, "Another number: another conversation.", minimum=0, maximum=1000000),
    ))
