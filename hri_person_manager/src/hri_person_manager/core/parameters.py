"""Parameters of the person manager."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, Iterable, Sequence

from hri_person_manager.core.location import DECAY_KINDS
from hri_pipeline.core.parameters import ParameterError, ParameterTable, Settings, list_timeout_parameter, parameter


@dataclass(frozen=True)
class PersonManagerSettings(Settings):
    """Fuses faces, bodies and voices into persons and locates them."""

    match_threshold: float = parameter(
        0.5, "Likelihood from which on a candidate match counts. Higher: fewer wrong unions, more persons in two "
        "halves.", minimum=0.01, maximum=1.0, live=True, shared="/humans/match_threshold")
    reference_frame: str = parameter(
        "map", "Parent of the frames person_ID. Where no transform leads to it, the frame of the sensor takes its "
        "place, with one warning.", shared="/humans/reference_frame")
    anonymous_persons: bool = parameter(True, "People who are not recognised are persons. False: not.")
    features_from_matches: bool = parameter(True, "A feature in a match exists before it is listed. False: not.")
    new_person_delay: float = parameter(
        0.5, "Time that a feature waits for a match until it is an anonymous person. Longer: fewer short-lived "
        "persons, later frames.", unit="s", minimum=0.0, maximum=60.0, live=True)
    voice_person_delay: float = parameter(
        2.0, "Time that a voice waits for a match until it is an unseen person: mouth and voice have to be compared "
        "for about a second. Shorter: unseen speakers are persons earlier, and speakers in view get a person for a "
        "moment that then is an alias. Counts where it is longer than new_person_delay.", unit="s", minimum=0.0,
        maximum=60.0, live=True)
    decay: str = parameter(
        "exponential", "How the location confidence falls after 1 s (or three image periods) without a place. "
        "exponential: half after each half_life. linear: 0 after two. step: 0.5 at once, 0 after two.",
        choices=DECAY_KINDS, live=True)
    half_life: float = parameter(
        5.0, "Time in which the confidence of an old place halves. Longer: frames stay longer at the last place.",
        unit="s", minimum=0.01, maximum=3600.0, live=True)
    confidence_floor: float = parameter(
        0.05, "Exponential decay: a confidence below this is 0.", minimum=0.001, maximum=0.9, live=True)
    coast_time: float = parameter(
        0.0, "Time that the frame of a lost person goes on with the last velocity, slowing down. 0: it stays at the "
        "last place.", unit="s", minimum=0.0, maximum=10.0)
    robot_frame: str = parameter(
        "", "Frame from which distances for the lists in_*_space are measured, such as base_link. Empty: the sensor.")
    personal_distance: float = parameter(
        1.2, "Outer border of the personal space.", unit="m", minimum=0.1, maximum=10.0, live=True)
    social_distance: float = parameter(
        3.6, "Outer border of the social space; what is farther away is public.", unit="m", minimum=0.2, maximum=50.0,
        live=True)
    cross_camera: bool = parameter(
        True, "Join persons whom several cameras see at one place, and follow people from view to view. Nothing "
        "happens with one camera, or without transforms to the reference frame.")
    cross_camera_distance: float = parameter(
        0.5, "Ten times the error of the cameras' poses: rays that pass each other by a tenth of it (and by 2 % of the "
        "distance) are one person. Larger: for an inexact calibration; people who stand close together may be taken "
        "for one.", unit="m", minimum=0.05, maximum=3.0, live=True)
    cross_camera_time: float = parameter(
        1.0, "Time that the rays of two cameras agree before persons are joined; three times as long where they agree "
        "less well; after twice as long apart they are parted.", unit="s", minimum=0.1, maximum=30.0, live=True)
    distance_error: float = parameter(
        0.12, "Standard deviation of distances from a camera, as a share of the distance: 0.12 without depth, about "
        "0.03 with a depth image.", minimum=0.005, maximum=1.0, live=True)
    distance_errors: Sequence[str] = parameter(
        [], "The same for single cameras, by optical frame, such as camera_depth_optical_frame=0.03; distance_error "
        "holds for the others.")
    cross_camera_handover: float = parameter(
        4.0, "Time in which somebody who left one view may appear in another as the same person, where the last "
        "velocity leads. 0: never.", unit="s", minimum=0.0, maximum=60.0, live=True)
    people_msgs: bool = parameter(
        False, "Publish /people (people_msgs/People) for navigation: positions, velocities, and as tags group, "
        "engagement, posture.")
    source_timeout: float = parameter(
        0.5, "Time without the face frame until the body places the person, and without all frames until the last "
        "place is sent again. Where face and body were seen together, the body goes on after 0.25 s, or three images "
        "of the face. A body whose stamps lag goes on when the face has told nothing for 1 s (three image periods) at "
        "the latest.", unit="s", minimum=0.02, maximum=10.0)
    store: str = parameter(
        "", "File (SQLite) in which permanent persons are kept across runs: ids, names, languages, demographics, "
        "times; the recognisers keep their templates in the same file. Empty: in memory only.")
    store_key: str = parameter(
        "", "File with the key that encrypts names, languages, demographics and times in `store`: that of the "
        "recognisers (their `gallery_key`); make one with `people make-key FILE`. Empty: not encrypted.")
    store_read_only: Sequence[str] = parameter(
        [], "More stores to know people from, never changed: plain ones, or with the same key.")
    store_max_age: float = parameter(
        0.0, "Persons not seen for longer are removed from the store. 0: never.", unit="days", minimum=0.0,
        maximum=36500.0)
    store_max_persons: int = parameter(
        1000, "Most persons in the store; of more, those unseen for longest are removed, and who has a name, a "
        "language or has agreed to be recognised last. 0: no limit.", minimum=0, maximum=1000000)
    max_matches_per_second: float = parameter(
        2000.0, "Candidate matches accepted per second; more are dropped and counted in the diagnostics.", unit="1/s",
        minimum=1.0, maximum=100000.0, live=True)
    list_timeout: float = list_timeout_parameter()
    interface: str = parameter(
        "paper", "No effect on this node; every node takes it, so that one launch argument sets all.", choices=("paper",
        "rep155"))


PERSON_MANAGER_PARAMETERS = ParameterTable("person_manager", PersonManagerSettings)


def sensor_errors(items: Iterable[str]) -> Dict[str, float]:
    """Read `FRAME=SHARE` for each sensor whose distances are more or less exact than those of others.

    Raises ParameterError for anything else.
    """
    found = {}
    for item in items:
        frame, _, share = item.partition("=")
        try:
            found[frame.strip().lstrip("/")] = value = float(share)
        except ValueError:
            value = 0.0
        if not (frame.strip() and 0.001 <= value <= 1.0):
            raise ParameterError("~distance_errors has {!r}, wanted FRAME=SHARE with a share of 0.001 to 1, such as "
                             "camera_depth_optical_frame=0.03".format(item))
    return found
