"""The simulated rooms of the identity benchmark: errors as large as they say, and people who are really there."""

import numpy as np

from benchmarks.camera_room import shared_room, two_views


def test_errors_are_those_that_were_measured():
    along, across = [], []
    for seed in range(8):
        room = shared_room(900 + seed, 2, 3)
        for _ in range(150):
            for sighting in room.step(0.02):
                camera = next(eye for eye in room.cameras if eye.name == sighting.camera)
                ray = room.head_at(sighting.person, sighting.stamp) - camera.position
                distance = np.linalg.norm(ray)
                error = (sighting.place - camera.position) / distance - ray / distance
                along.append(error @ ray / distance)
                across.append(np.linalg.norm(error - (error @ ray / distance) * ray / distance) / np.sqrt(2.0))
    assert 0.08 < np.std(along) < 0.16
    assert 0.015 < np.sqrt(np.mean(np.square(across))) < 0.035


def test_who_leaves_the_left_view_comes_up_in_the_right_one():
    room, leaves = two_views(5, True)
    seen = {}
    while room.now < leaves + 6.5:
        for sighting in room.step(0.02):
            if sighting.person == 0:
                seen.setdefault(sighting.camera, []).append(sighting.stamp)
    assert seen["left"][-1] < seen["right"][0] + 0.5
