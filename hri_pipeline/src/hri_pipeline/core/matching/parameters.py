"""Parameters of the face_body_matcher and of the voice_matcher node."""

from __future__ import annotations

from dataclasses import dataclass

from hri_pipeline.core.parameters import ParameterTable, Settings, list_timeout_parameter, parameter


@dataclass(frozen=True)
class FaceBodyMatcherSettings(Settings):
    """Finds out which face belongs to which body, from their positions in the image."""

    distance_scale: float = parameter(
        0.6, "Distance between the points of face and skeleton with a likelihood of 0.61. Higher: more tolerant of "
        "inexact skeletons, less certain among faces close together.", unit="face sizes", minimum=0.05, maximum=2.0,
        live=True)
    min_likelihood: float = parameter(
        0.3, "Pairs of less likelihood are not matched.", minimum=0.01, maximum=1.0, live=True)
    min_point_confidence: float = parameter(
        0.3, "Points of less confidence are not used.", minimum=0.0, maximum=1.0, live=True)
    smoothing_time: float = parameter(
        0.3, "Time constant of the likelihood of a pair. Longer: fewer changes, later corrections.", unit="s",
        minimum=0.0, maximum=10.0, live=True)
    stay_bonus: float = parameter(
        0.1, "How much more likely another body must be to replace the matched one.", minimum=0.0, maximum=0.5,
        live=True)
    max_stamp_difference: float = parameter(
        0.15, "Largest difference between the stamps of face and skeleton. A face with images before and after the "
        "skeleton, at most 0.7 s apart, is interpolated.", unit="s", minimum=0.0, maximum=1.0, live=True)
    hold_time: float = parameter(
        10.0, "A pair ends when one side is not seen for this long. Long enough for a node that hangs for a moment: "
        "its faces stay listed. A side whose images come later than those of the other has so much longer.", unit="s",
        minimum=0.1, maximum=30.0, live=True)
    list_timeout: float = list_timeout_parameter()


@dataclass(frozen=True)
class VoiceMatcherSettings(Settings):
    """Finds out whose voice it is, from the motion of the mouths and from the direction."""

    min_likelihood: float = parameter(
        0.6, "Likelihood from which a voice is matched; it stays matched down to 0.5. Higher: fewer wrong matches, "
        "later ones.", minimum=0.5, maximum=0.99, live=True)
    stay_bonus: float = parameter(
        0.7, "Advantage of the matched face, as a logarithm of odds. Higher: fewer changes, later corrections.",
        minimum=0.0, maximum=5.0, live=True)
    unseen_weight: float = parameter(
        1.0, "Prior odds of somebody out of view (or a loudspeaker) against one face. Higher: fewer matches, and surer "
        "ones.", minimum=0.01, maximum=100.0, live=True)
    still_motion: float = parameter(
        0.05, "Motion of a mouth (standard deviation of its opening, 0 to 1) that is as likely still as speaking. "
        "Higher: for noisy action units; quiet speakers are missed.", minimum=0.005, maximum=0.5, live=True)
    direction_sd: float = parameter(
        0.17, "Standard deviation of the direction of voice_ID. Larger: for coarse arrays and echoes.", unit="rad",
        minimum=0.02, maximum=1.5, live=True)
    memory: float = parameter(
        8.0, "Motion and speech are compared over this time. Longer: surer, later corrections, more computing.",
        unit="s", minimum=2.0, maximum=15.0, live=True)
    onset_delay: float = parameter(
        0.06, "Time from a voice's first sound to is_speaking.", unit="s", minimum=0.0, maximum=1.0)
    hangover: float = parameter(
        0.08, "Time from a voice's last sound to the end of is_speaking.", unit="s", minimum=0.0, maximum=2.0)
    period: float = parameter(
        0.25, "Time between two comparisons while somebody speaks.", unit="s", minimum=0.05, maximum=1.0, live=True)
    linger_time: float = parameter(
        10.0, "Time after the last voice until faces and transforms are no longer subscribed to: what a mouth did "
        "before a voice began helps to tell whose it is.", unit="s", minimum=0.0, maximum=3600.0, live=True)
    list_timeout: float = list_timeout_parameter()
    interface: str = parameter(
        "paper", "No effect on this node; every node takes it, so that one launch argument sets all.", choices=("paper",
        "rep155"))


MATCHER_PARAMETERS = ParameterTable("face_body_matcher", FaceBodyMatcherSettings)
VOICE_MATCHER_PARAMETERS = ParameterTable("voice_matcher", VoiceMatcherSettings)
