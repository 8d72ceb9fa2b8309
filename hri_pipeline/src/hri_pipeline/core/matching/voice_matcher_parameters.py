"""Parameters of the voice_matcher node."""

from __future__ import annotations

from hri_pipeline.core.parameters import Parameter, ParameterTable

VOICE_MATCHER_PARAMETERS = ParameterTable(
    "voice_matcher", "Finds out whose voice it is, from the motion of the mouths and from the direction.", (
        Parameter("min_likelihood", 0.6,
                  "Likelihood from which on a voice is matched with a face or a person; it stays matched down to 0.5. Higher: "
                  "fewer wrong matches, later ones.", minimum=0.5, maximum=0.99, live=True),
        Parameter("stay_bonus", 0.7,
                  "Advantage of the face that a voice is matched with, as a logarithm of odds. Higher: fewer changes, later "
                  "corrections.", minimum=0.0, maximum=5.0, live=True),
        Parameter("unseen_weight", 1.0,
                  "How likely a voice comes from somebody whom nobody sees (or from a loudspeaker), beforehand and against "
                  "one face. Higher: fewer matches, and surer ones.", minimum=0.01, maximum=100.0, live=True),
        Parameter("still_motion", 0.05,
                  "Motion of a mouth, as standard deviation of its opening (0 to 1) over half a second, at which it may as well "
                  "be still as moving. Higher: for noisy action units; quiet speakers are missed.", minimum=0.005, maximum=0.5, live=True),
        Parameter("direction_sd", 0.17,
                  "Standard deviation of the direction of voice_ID. Larger: for coarse arrays and echoes.", unit="rad",
                  minimum=0.02, maximum=1.5, live=True),
        Parameter("memory", 8.0,
                  "Motion and speech are compared over this time. Longer: surer, later corrections, more computing.", unit="s",
                  minimum=2.0, maximum=15.0, live=True),
        Parameter("onset_delay", 0.06,
                  "Time from the first sound of a voice to the arrival of is_speaking.", unit="s", minimum=0.0, maximum=1.0),
        Parameter("hangover", 0.08,
                  "Time from the last sound of a voice to the arrival of the end of is_speaking.", unit="s", minimum=0.0,
                  maximum=2.0),
        Parameter("period", 0.25,
                  "Time between two comparisons while somebody speaks.", unit="s", minimum=0.05, maximum=1.0, live=True),
        Parameter("linger_time", 10.0,
                  "The node listens to faces and transforms while there is a voice, and for so long after the last one: what a "
                  "mouth did before a voice began helps to tell whose it is.", unit="s", minimum=0.0, maximum=3600.0, live=True),
        Parameter("interface", "paper",
                  "Taken by every node of the stack, so that one launch argument sets all; the topics of this node are the "
                  "same in both.", choices=("paper", "rep155")),
    ))
