"""Parameters of the interactions node."""

from __future__ import annotations

from dataclasses import dataclass

from hri_pipeline.core.parameters import ParameterTable, Settings, list_timeout_parameter, parameter


@dataclass(frozen=True)
class PeopleSettings(Settings):
    """Of the people and the robot, and of the results."""

    rate: float = parameter(
        15.0, "Most results per second; there is at most one for each image. Higher: gazes that follow sooner, more "
        "load.", unit="Hz", minimum=1.0, maximum=60.0, live=True)
    reference_frame: str = parameter(
        "map", "Frame in which people are compared. Where no transform leads to it, the frame of the sensor takes its "
        "place, with one warning, and is taken for level, as is a reference frame with `optical` in its name.",
        shared="/humans/reference_frame")
    robot_frame: str = parameter(
        "", "Frame of the robot's head or eyes: what people look at when they look at the robot. Where it looks itself "
        "is its z axis when its name has `optical` in it, else its x axis. Empty: the camera (of several: that with "
        "most people).", shared="/humans/robot_reference_frame")
    use_facs: bool = parameter(
        False, "Subscribe to the action units of the faces: a face whose unit 45 (eyelids closed) is above "
        "closed_threshold looks at nobody. Needed for face detectors that send gaze_ID while the eyes are closed; "
        "with interface rep155, where the node faces does so, it is always on. Makes the node faces compute action "
        "units.")
    list_timeout: float = list_timeout_parameter()
    frame_timeout: float = parameter(
        0.5, "Frames of a face, gaze or body that are older than the newest by this are not used.", unit="s",
        minimum=0.05, maximum=5.0, live=True)
    gaze_timeout: float = parameter(
        0.15, "Eyes are closed when gaze_ID misses this long while face_ID goes on; only where a face of the same "
        "sensor has had a gaze_ID. Longer: for detectors that lose the gaze now and then; closed eyes are noticed "
        "later.", unit="s", minimum=0.0, maximum=2.0, live=True)
    groups_with_robot: bool = parameter(
        True, "The robot may be in a group, as the empty id. It needs a place: robot_frame, or the camera.", live=True)
    interface: str = parameter(
        "paper", "paper: groups are GroupsStamped. rep155: groups are Group, one message each; gazes also on `gazing`.",
        choices=("paper", "rep155"))


@dataclass(frozen=True)
class GazeSettings(Settings):
    """Of who looks at whom."""

    gaze_sd: float = parameter(
        0.1, "Standard deviation of the eyes' direction (gaze_ID) near the camera, each axis. Larger: slower "
        "decisions, fewer wrong ones.", unit="rad", minimum=0.02, maximum=1.0, live=True)
    gaze_without_face: bool = parameter(
        False, "Publish gazes of people without a face in view, by skeleton or trunk: right four times in ten.",
        live=True)
    gaze_range: float = parameter(
        5.0, "Distance from the camera from which eyes are too small: beyond, gaze_ID counts no more than the "
        "direction of the head, and from half of it on less and less. Larger for cameras of high resolution: about 4.5 "
        "m per 1000 px of focal length, where a face is 30 px wide.", unit="m", minimum=0.2, maximum=50.0, live=True)
    head_sd: float = parameter(
        0.09, "Standard deviation of the head's direction (face_ID), each axis.", unit="rad", minimum=0.02, maximum=1.0,
        live=True)
    skeleton_head_sd: float = parameter(
        0.35, "Standard deviation of the head's direction (head_ID of a skeleton), each axis.", unit="rad",
        minimum=0.02, maximum=2.0, live=True)
    trunk_sd: float = parameter(
        0.35, "Standard deviation of the trunk's direction (body_ID).", unit="rad", minimum=0.02, maximum=2.0,
        live=True)
    head_gain: float = parameter(
        0.7, "Part of the turn from trunk to target that the head does; the eyes do the rest. Used where both "
        "directions are known.", minimum=0.3, maximum=1.0, live=True)
    eyes_in_head_sd: float = parameter(
        0.28, "Standard deviation of the eyes' direction in the head, where the trunk is not known. Larger: the head "
        "alone says less.", unit="rad", minimum=0.02, maximum=1.0, live=True)
    trunk_target_sd: float = parameter(
        0.6, "Standard deviation of the angle from the trunk to what somebody looks at. Larger: people of whom only "
        "the body is seen look at somebody less often (gaze_without_face).", unit="rad", minimum=0.1, maximum=2.0,
        live=True)
    head_radius: float = parameter(
        0.12, "Radius of a head. A near head takes a larger part of the view, and hides who is behind.", unit="m",
        minimum=0.01, maximum=1.0, live=True)
    max_distance: float = parameter(
        8.0, "Greatest distance of what is looked at.", unit="m", minimum=0.5, maximum=100.0, live=True)
    nobody_prior: float = parameter(
        0.3, "Part of the time in which people look at nobody. Higher: fewer gazes, surer ones.", minimum=0.01,
        maximum=0.99, live=True)
    nobody_field: float = parameter(
        2.0, "Solid angle over which gazes at nobody are spread. Smaller: fewer gazes, surer ones.", unit="sr",
        minimum=0.05, maximum=12.6, live=True)
    dwell_time: float = parameter(
        1.3, "Mean time between two changes of the target. Longer: fewer wrong changes, later right ones.", unit="s",
        minimum=0.1, maximum=60.0, live=True)
    evidence_time: float = parameter(
        0.3, "Correlation time of the errors of a direction: images that follow each other sooner count less than as "
        "many independent ones, unless the direction is seen to tremble. Longer: for detectors whose errors last.",
        unit="s", minimum=0.0, maximum=5.0, live=True)
    gaze_on: float = parameter(0.6, "Probability from which a gaze begins.", minimum=0.05, maximum=0.99, live=True)
    gaze_off: float = parameter(
        0.55, "Probability below which a gaze ends; below gaze_on, so that it does not flicker.", minimum=0.01,
        maximum=0.99, live=True)
    gaze_hold: float = parameter(
        0.3, "A gaze ends this long after its last observation.", unit="s", minimum=0.0, maximum=10.0, live=True)
    closed_threshold: float = parameter(
        0.5, "Action unit 45 from which the eyes are closed: then there is no gaze.", minimum=0.05, maximum=0.99,
        live=True)


@dataclass(frozen=True)
class EngagementSettings(Settings):
    """Of who is engaged with the robot."""

    engagement: bool = parameter(True, "Publish engagement_status. False: another node does, such as hri_engagement.")
    engagement_distance: float = parameter(
        3.0, "Distance from the robot up to which somebody may be engaged.", unit="m", minimum=0.2, maximum=20.0,
        live=True)
    engagement_distance_margin: float = parameter(
        0.3, "Somebody must go this much farther to be outside again.", unit="m", minimum=0.0, maximum=5.0, live=True)
    engagement_view: float = parameter(
        1.2, "Largest angle between where the robot looks and a person. pi: it sees all around.", unit="rad",
        minimum=0.1, maximum=3.15, live=True)
    engagement_time: float = parameter(
        1.5, "Time constant of the attention (smoothed mutual gaze, 0 to 1). Longer: engaged later, and still so over "
        "longer looks away.", unit="s", minimum=0.05, maximum=60.0, live=True)
    engaging_level: float = parameter(
        0.25, "Attention from which somebody disengaged is engaging.", minimum=0.02, maximum=0.98, live=True)
    engaged_level: float = parameter(
        0.7, "Attention from which somebody is engaged.", minimum=0.02, maximum=0.98, live=True)
    disengaging_level: float = parameter(
        0.45, "Attention below which somebody engaged is disengaging.", minimum=0.02, maximum=0.98, live=True)
    disengaged_level: float = parameter(
        0.12, "Attention below which somebody is disengaged.", minimum=0.01, maximum=0.97, live=True)
    engagement_lost_time: float = parameter(
        2.0, "Time without place and direction until engagement is unknown.", unit="s", minimum=0.1, maximum=60.0,
        live=True)


@dataclass(frozen=True)
class GroupSettings(Settings):
    """Of who stands together."""

    group_stride: float = parameter(
        0.4, "Distance from a person to the group's expected middle. Larger: for people who stand in wide circles.",
        unit="m", minimum=0.0, maximum=2.0, live=True)
    group_size_sd: float = parameter(
        0.3, "Standard deviation of that distance between groups: circles may be wider or narrower, for all of their "
        "members alike. Larger: wide and narrow circles alike.", unit="m", minimum=0.02, maximum=2.0, live=True)
    group_depth: float = parameter(
        0.4, "Standard deviation of the group's middle along a member's direction, beside the size of the group. "
        "Larger: members stand nearer and farther than others of their group.", unit="m", minimum=0.05, maximum=2.0,
        live=True)
    group_width: float = parameter(
        0.3, "The same across the direction. Larger: people side by side and people turned away rather belong to a "
        "group.", unit="m", minimum=0.05, maximum=2.0, live=True)
    group_room: float = parameter(
        22.0, "Area over which the middles of groups are spread: people form a group when their middles agree better "
        "than by chance in this area. Larger: more and larger groups.", unit="m^2", minimum=1.0, maximum=1000.0,
        live=True)
    group_period: float = parameter(
        0.3, "Least time between two results of the groups. Longer: less load.", unit="s", minimum=0.0, maximum=5.0,
        live=True)
    group_time: float = parameter(
        2.0, "Time constant of who stands with whom: a group is who stood together for most of about twice this time. "
        "Longer: steadier groups, later changes.", unit="s", minimum=0.0, maximum=30.0, live=True)
    group_speed: float = parameter(
        0.7, "People with a larger relative speed (one walks past or away) are not together. Lower: people leave a "
        "group sooner, noise breaks it.", unit="m/s", minimum=0.1, maximum=10.0, live=True)
    group_delay: float = parameter(
        0.5, "Time that people are seen before they are in a group.", unit="s", minimum=0.0, maximum=30.0, live=True)
    group_hold_time: float = parameter(
        1.0, "Time that an unseen member stays in the group, and that an ended group can return with its id.", unit="s",
        minimum=0.0, maximum=30.0, live=True)
    group_head_sd: float = parameter(
        0.6, "Standard deviation of the direction of the head from the trunk's: what the head says of the trunk. "
        "Larger: heads count less.", unit="rad", minimum=0.05, maximum=3.0, live=True)


@dataclass(frozen=True)
class InteractionSettings(PeopleSettings, GazeSettings, EngagementSettings, GroupSettings):
    """Who looks at whom, who stands together, and who is engaged with the robot."""


INTERACTION_PARAMETERS = ParameterTable("interactions", InteractionSettings)
