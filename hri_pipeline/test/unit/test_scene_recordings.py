"""A scene is written as a bag and read back, both without ROS."""

from collections import Counter

import numpy as np
import pytest
from rosbags.rosbag1 import Reader
from scene_bag import BASE, write_scene

from hri_pipeline.core.frames import read, scan
from hri_pipeline.core.simulation.scene_file import parse_scene
from hri_pipeline.core.simulation.world import World
from hri_pipeline.score.bag import BagWriter, read_bag, type_store

SCENE = parse_scene({"duration": 12.0, "habits": {"look_robot": 0.8, "dwell": 2.0, "turn": 1.0}, "people": [
    {"name": "ann", "at": [3.0, 0.5], "yaw": 180.0}, {"name": "bob", "at": [3.0, -0.5], "yaw": 180.0}], "formations": [
    {"shape": "side_by_side", "centre": [2.5, 0.0], "yaw": 180.0, "members": ["ann", "bob"]}]})
SECONDS, RATE = 4.0, 10.0


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "scene.bag"
    write_scene(path, SCENE, 2.0, 2.0 + SECONDS, rate=RATE)
    return path


@pytest.fixture(scope="module")
def messages(path):
    """(topic, time s, latched, message) of the whole bag, in its order."""
    store = type_store()
    with Reader(path) as reader:
        return [(connection.topic, when * 1e-9, connection.ext.latching,
                 store.deserialize_ros1(data, connection.msgtype))
                for connection, when, data in reader.messages()]


def test_every_cycle_is_there_in_order(messages):
    times = [when for _, when, _, _ in messages]
    assert (
        times == sorted(times)
        and times[0] == pytest.approx(BASE)
        and times[-1] == pytest.approx(BASE + SECONDS - 1.0 / RATE)
    )
    counts = Counter(topic for topic, _, _, _ in messages)
    for name in ("persons", "visible", "speaking", "eyes_closed", "heads", "bodies", "gaze", "groups"):
        assert counts["/scene/truth/" + name] == SECONDS * RATE
    for kind in ("faces", "bodies", "voices"):
        assert counts["/humans/{}/tracked".format(kind)] >= SECONDS


def test_stamps_are_the_times_of_the_bag(messages):
    stamped = [(when, message.header) for _, when, _, message in messages if hasattr(message, "header")]
    assert len(stamped) > 200
    assert all(header.stamp.sec + 1e-9 * header.stamp.nanosec == pytest.approx(when, abs=1e-6) for when,
               header in stamped)


def test_what_every_listener_needs_is_latched(messages):
    latched = {topic for topic, _, latching, _ in messages if latching}
    assert {"/tf_static", "/scene/truth/script"} <= latched
    assert all(topic in latched for topic, _, _, _ in messages if topic.endswith("/is_speaking"))
    assert not any(topic.endswith(("tracked", "landmarks")) or topic == "/tf" for topic in latched)


def test_features_of_whoever_is_listed(messages):
    listed = {kind: set() for kind in ("faces", "bodies", "voices")}
    for topic, _, _, message in messages:
        if topic.endswith("/tracked"):
            listed[topic.split("/")[2]].update(message.ids)
    named = {kind: {topic.split("/")[3] for topic, _, _, _ in messages
                    if topic.startswith("/humans/{}/".format(kind)) and topic.count("/") == 4} for kind in listed}
    assert named == listed and len(listed["bodies"]) >= 2
    landmarks = next(message for topic, _, _, message in messages if topic.endswith("/landmarks"))
    assert len(landmarks.landmarks) == 70 and (landmarks.width, landmarks.height) == (1280, 720)
    skeleton = next(message for topic, _, _, message in messages if topic.endswith("/skeleton2d"))
    assert len(skeleton.skeleton) == 18
    assert all(0.0 <= point.c <= 1.0 for point in (*landmarks.landmarks, *skeleton.skeleton))
    units = next(message for topic, _, _, message in messages if topic.endswith("/facs"))
    assert len(units.intensity) == len(units.confidence) == 99


def test_who_is_who_is_said_and_what_belongs_together_is_left_to_a_matcher(messages, tmp_path):
    said = [message for topic, _, _, message in messages if topic == "/humans/candidate_matches"]
    assert {(message.id1_type, message.id2_type) for message in said if message.confidence > 0.0} == {(2, 1)}
    assert {message.id2 for message in said} <= {"ann", "bob"}
    write_scene(tmp_path / "all.bag", SCENE, 0.0, 2.0, matches=True)
    with Reader(tmp_path / "all.bag") as reader:
        store = type_store()
        pairs = [store.deserialize_ros1(data, connection.msgtype) for connection, _, data in reader.messages()
                 if connection.topic == "/humans/candidate_matches"]
    assert (2, 3) in {(message.id1_type, message.id2_type) for message in pairs}


def test_faces_are_where_the_truth_says(path):
    record, world, errors = read_bag(path), World(SCENE), []
    assert len(record.truth) == SECONDS * RATE
    for frame in record.truth:
        truth = world.at(frame.stamp - BASE + 2.0)
        assert set(frame.heads) == {person.id for person in truth.people}
        for person in truth.people:
            errors.append(np.linalg.norm(np.subtract(frame.heads[person.id], person.head)))
    assert max(errors) < 1e-6
    with Reader(path) as reader:
        raw = [bytes(data) for connection, _, data in reader.messages() if connection.topic == "/tf"]
    heads = np.array([head for frame in record.truth for head in frame.heads.values()])
    depths = [read(data, offset).translation[2] for data in raw for child,
              offset in scan(data) if child.startswith(b"face_")]
    assert len(depths) > 40
    assert abs(np.median(depths) - np.median(heads[:, 0])) < 0.3     # the camera looks along x from the origin


def test_the_same_seed_gives_the_same_bag(path, tmp_path):
    write_scene(tmp_path / "again.bag", SCENE, 2.0, 2.0 + SECONDS, rate=RATE)
    contents = []
    for one in (path, tmp_path / "again.bag"):
        with Reader(one) as reader:
            contents.append([(connection.topic, when, bytes(data)) for connection, when, data in reader.messages()])
    assert contents[0] == contents[1]


@pytest.mark.parametrize("begin, end", [(12.0, 20.0), (-1.0, 3.0), (5.0, 5.0)])
def test_a_part_that_is_not_there(tmp_path, begin, end):
    with pytest.raises(ValueError, match="nothing of a scene"):
        write_scene(tmp_path / "none.bag", SCENE, begin, end)


def test_a_bag_is_not_overwritten(path):
    before = path.read_bytes()
    with pytest.raises(Exception, match="exists"), BagWriter(path):
        pass
    assert path.read_bytes() == before
