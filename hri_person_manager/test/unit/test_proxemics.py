"""Who is how near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hri_person_manager.core.location import Place
from hri_person_manager.core.proxemics import Proxemics, Space, horizontal_distance
from hri_pipeline.core.geometry import Pose


def test_every_person_is_in_exactly_one_space():
    found = Proxemics().update({"near": 0.5, "mid": 2.0, "far": 8.0})
    assert found == {Space.PERSONAL: ["near"], Space.SOCIAL: ["mid"], Space.PUBLIC: ["far"]}


def test_somebody_on_a_border_does_not_go_to_and_fro():
    proxemics = Proxemics(1.2, 3.6)
    for distance, space in ((1.1, Space.PERSONAL), (1.25, Space.PERSONAL), (1.31, Space.SOCIAL), (1.15, Space.SOCIAL),
                            (1.05, Space.PERSONAL), (3.75, Space.PUBLIC), (3.55, Space.PUBLIC), (3.45, Space.SOCIAL)):
        assert proxemics.update({"ann": distance})[space] == ["ann"], distance


def test_who_is_gone_is_in_no_space_and_starts_anew():
    proxemics = Proxemics(1.2, 3.6)
    proxemics.update({"ann": 1.1})
    assert not any(proxemics.update({}).values())
    assert proxemics.update({"ann": 1.25})[Space.SOCIAL] == ["ann"]


@pytest.mark.parametrize("borders", [(0.0, 1.0), (2.0, 1.0), (1.0, 1.0)])
def test_illegal_borders(borders):
    with pytest.raises(ValueError):
        Proxemics(*borders)


def at(frame, *position):
    return Place(frame, Pose(np.eye(3), np.array(position)), 1.0)


@pytest.mark.parametrize("frame, position, origin, distance", [
    ("map", (10.6, 2.0, 1.6), (10.0, 2.0, 0.0), 0.6),                               # a face before a robot on the floor
    ("map", (13.0, 6.0, 1.6), (10.0, 2.0, 0.4), 5.0),
    ("odom", (0.6, 0.0, -3.0), (0.0, 0.0, 0.0), 0.6),
    ("camera_color_optical_frame", (0.3, -0.9, 0.4), (0.0, 0.0, 0.0), 0.5),         # y is down
    ("left_optical", (0.3, -0.9, 0.4), (0.0, 0.0, 0.0), 0.5)])
def test_distances_are_horizontal(frame, position, origin, distance):
    assert horizontal_distance(at(frame, *position), np.array(origin)) == pytest.approx(distance)


def test_a_camera_whose_name_does_not_say_so_looks_along_z():
    place = replace(at("camera", 0.3, -0.9, 0.4), of_camera=True)
    assert horizontal_distance(place, np.zeros(3)) == pytest.approx(0.5)
