"""The scores of small bags that are written here from a simulated scene, with faults put in on purpose."""

import json
import math

import numpy as np
import pytest
from scene_bag import SceneBag, upright

from hri_pipeline.core.geometry import Pose
from hri_pipeline.core.simulation.scene_file import parse_scene
from hri_pipeline.core.simulation.world import World
from hri_pipeline.score import bag as module
from hri_pipeline.score.bag import RecordError, is_closed, read_bag
from hri_pipeline.score.command import main, score

BASE, RATE, SECONDS = 1000.0, 10.0, 12.0
SCENE = parse_scene({"duration": 12.0, "habits": {"look_away": 0.1, "dwell": 2.0}, "people": [
    {"name": "ann"}, {"name": "bob"}, {"name": "cho"}], "formations": [
    {"shape": "circle", "centre": [2.5, 0.0], "members": ["ann", "bob", "cho"], "until": 8.0}]})
NAMES = {"ann": "pa", "bob": "pb", "cho": "pc"}


def write(path, names=lambda t: NAMES, shift=(0.0, 0.0, 0.0), listed=lambda t, ids: ids, gaze=True, groups=True,
          parent=("map", None),
          truth=True, late=0.02):
    """A bag in which persons are where they truly are, moved by `shift`; names(t): person ids by true ids.

    parent: frame of the persons, and its pose in map: None, fixed, or by the time, as links that move (name, pose in
    the one before).
    """
    world = World(SCENE)
    with SceneBag(path) as bag:
        if isinstance(parent[1], Pose):
            bag.transforms("/tf_static", [("map", parent[0], parent[1])], BASE)
        for number in range(int(SECONDS * RATE)):
            now = world.at(number / RATE)
            stamp, ids = BASE + now.stamp, names(now.stamp)
            if truth:
                bag.truth(now, BASE)
            shown = listed(now.stamp, [ids[person.id] for person in now.people])
            bag.ids("/humans/persons/tracked", shown, stamp)
            frames, sensor = [], parent[1] or Pose.identity()
            if callable(sensor):
                links, sensor = sensor(now.stamp), Pose.identity()
                for above, (link, pose) in zip(["map"] + [link for link, _ in links], links):
                    frames.append((above, link, pose))
                    sensor = sensor.compose(pose)
            for person in now.people:
                place = upright(person.head + np.array(shift))
                frames.append((parent[0], "person_" + ids[person.id], sensor.inverse().compose(place)))
            bag.transforms("/tf", frames, stamp, stamp + late)
            for person in ids.values():
                bag.confidence(person, 1.0, stamp)
            if gaze:
                bag.gaze("/humans/interactions/gaze",
                         [(ids[person.id], ids.get(person.target, "")) for person in now.people
                          if person.target is not None], stamp)
            if groups:
                bag.groups("/humans/interactions/groups",
                           [[ids[member] for member in group.members] for group in now.groups], stamp)
    return path


def test_a_perfect_bag_has_perfect_scores(tmp_path):
    figures = score(read_bag(write(tmp_path / "a.bag")))
    assert figures["mota"] == 1.0 and figures["motp_m"] < 1e-6 and figures["id_switches"] == 0
    assert (figures["persons_true"], figures["persons_found"], figures["persons_ids"]) == (3, 3, 3)
    assert figures["gaze_precision"] == figures["gaze_recall"] == 1.0
    assert figures["groups_f1"] == 1.0
    assert figures["person_rate_hz"] == pytest.approx(RATE, rel=0.01)
    assert figures["person_age_ms_p50"] == pytest.approx(20.0, abs=1.0)
    assert figures["confidence_errors_m"][0]["places"] > 300
    assert figures["damaged_messages"] == figures["foreign_frames"] == 0


def test_an_offset_is_the_error(tmp_path):
    figures = score(read_bag(write(tmp_path / "a.bag", shift=(0.1, 0.2, 0.2))))
    assert figures["motp_m"] == pytest.approx(0.3, abs=1e-6) and figures["mota"] == 1.0
    far = score(read_bag(tmp_path / "a.bag"), distance=0.2)
    assert far["mota"] == -1.0 and far["persons_found"] == 0


def test_ids_that_change_are_switches(tmp_path):
    swapped = {"ann": "pb", "bob": "pa", "cho": "pc"}
    figures = score(read_bag(write(tmp_path / "a.bag", names=lambda t: NAMES if t < 6.0 else swapped)))
    assert figures["id_switches"] == 2
    assert figures["id_switches_per_hour"] == pytest.approx(2 * 3600.0 / figures["duration_s"])
    assert figures["id_switches_permanent"] == 2
    # Whoever is called otherwise from now on still looks at the same people.
    assert figures["gaze_precision"] == figures["gaze_recall"] == 1.0


def test_recognition_is_a_switch_and_no_fault(tmp_path):
    strangers = {name: "anonymous_person_" + name for name in NAMES}
    figures = score(read_bag(write(tmp_path / "a.bag", names=lambda t: strangers if t < 6.0 else NAMES)))
    assert (figures["id_switches"], figures["id_switches_permanent"]) == (3, 0)


def test_somebody_who_is_not_listed_is_missed_for_that_time(tmp_path):
    path = write(tmp_path / "a.bag", listed=lambda t, ids: ids if t < 6.0 else ids[1:])
    figures = score(read_bag(path))
    assert figures["misses"] == pytest.approx(60, abs=2)
    assert figures["mota"] == pytest.approx(1.0 - 60.0 / 360.0, abs=0.01)


def test_gazes_that_do_not_come(tmp_path):
    figures = score(read_bag(write(tmp_path / "a.bag", gaze=False, groups=False)))
    assert figures["gaze_precision"] is None and figures["groups_f1"] is None


def test_persons_in_the_frame_of_the_camera(tmp_path):
    camera = Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.3, 0.1, 1.3]))
    figures = score(read_bag(write(tmp_path / "a.bag", parent=("camera", camera))))
    assert figures["mota"] == 1.0 and figures["motp_m"] < 1e-6


def test_a_camera_on_links_that_move_and_are_called_as_those_of_humans(tmp_path):
    def links(t):
        turn = np.array([[math.cos(t), -math.sin(t), 0.0], [math.sin(t), math.cos(t), 0.0], [0.0, 0.0, 1.0]])
        return [("body_link", Pose(np.eye(3), np.array([0.1 * t, 0.0, 1.0]))),
                ("head_pan_link", Pose(turn, np.array([0.0, 0.1, 0.4]))),
                ("camera", Pose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
                                np.array([0.05, 0.0, 0.1])))]
    figures = score(read_bag(write(tmp_path / "a.bag", parent=("camera", links))))
    assert figures["foreign_frames"] == 0 and figures["mota"] == 1.0 and figures["motp_m"] < 1e-6


def test_persons_in_a_frame_that_leads_nowhere(tmp_path):
    figures = score(read_bag(write(tmp_path / "a.bag", parent=("odom", None))))
    assert figures["foreign_frames"] > 300 and figures["persons_found"] == 0


def test_persons_in_a_frame_that_leads_to_itself(tmp_path):
    with SceneBag(tmp_path / "a.bag") as bag:
        bag.truth(World(SCENE).at(0.0), BASE)
        bag.transforms("/tf", [("odom", "base", upright((0.0, 0.0, 0.0))), ("base", "odom", upright((0.0, 0.0, 0.0)))],
                       BASE + 1.0)
        bag.transforms("/tf", [("base", "person_pa", upright((1.0, 0.0, 0.0)))], BASE + 1.1)
    assert score(read_bag(tmp_path / "a.bag"))["foreign_frames"] == 1


def test_without_the_truth(tmp_path, capsys):
    path = write(tmp_path / "a.bag", truth=False)
    figures = score(read_bag(path))
    assert figures["has_truth"] is False and "mota" not in figures
    assert (figures["persons_ids"], figures["persons_most"]) == (3, 3)
    assert figures["groups_mean"] > 0.3
    assert main([str(path)]) == 0
    assert "no truth" in capsys.readouterr().out


def test_the_command(tmp_path, capsys):
    path = write(tmp_path / "a.bag")
    assert main([str(path), "--json", "__name:=score"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["mota"] == 1.0
    assert main([str(path)]) == 0
    shown = capsys.readouterr().out
    assert "MOTA" in shown and "1.000" in shown
    assert main([str(path), "--truth", "/elsewhere"]) == 0
    assert "no truth" in capsys.readouterr().out


@pytest.mark.parametrize("name, content",
                         [("none.bag", None), ("text.bag", b"hello"), ("empty.bag", b""), ("a.txt", b"x")])
def test_files_that_are_no_bags(tmp_path, capsys, name, content):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(RecordError, match=name):
        read_bag(path)
    assert main([str(path)]) == 1
    assert name in capsys.readouterr().err


@pytest.mark.parametrize("name, index", [("a.bag", 0), ("a.bag", 10 ** 9), ("a.bag.active", 0)])
def test_a_recording_that_was_cut_off_is_told_with_the_mend(tmp_path, name, index):
    path = tmp_path / name
    head = b"\x12\x00\x00\x00index_pos=" + index.to_bytes(8, "little") + b"\x04\x00\x00\x00op=\x03"
    path.write_bytes(b"#ROSBAG V2.0\n" + len(head).to_bytes(4, "little") + head + bytes(4096))
    assert not is_closed(path)
    with pytest.raises(RecordError, match="was not closed.*rosbag reindex"):
        read_bag(path)


def test_a_recording_that_was_closed_before_anything_came(tmp_path):
    path = tmp_path / "a.bag"
    fields = {b"op": b"\x03", b"index_pos": (4117).to_bytes(8, "little"), b"conn_count": bytes(4),
              b"chunk_count": bytes(4)}
    head = b"".join((len(name) + 1 + len(value)).to_bytes(4, "little") + name + b"=" + value
                    for name, value in fields.items())
    head = b"#ROSBAG V2.0\n" + len(head).to_bytes(4, "little") + head
    path.write_bytes(head + (4113 - len(head)).to_bytes(4, "little") + b" " * (4113 - len(head)))     # as rosbag does
    assert is_closed(path)
    with pytest.raises(RecordError, match="nothing was recorded"):
        read_bag(path)


def test_a_bag_that_may_not_be_read(tmp_path, monkeypatch):
    def refuse(path):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(module, "is_recording", refuse)
    (tmp_path / "a.bag").write_bytes(b"")
    with pytest.raises(RecordError, match="a.bag cannot be read: Permission denied"):
        read_bag(tmp_path / "a.bag")


def test_a_recording_that_was_closed(tmp_path):
    with SceneBag(tmp_path / "a.bag") as bag:
        bag.transforms("/tf", [("map", "person_pa", upright((1.0, 2.0, 0.0)))], BASE)
    assert is_closed(tmp_path / "a.bag")


def test_groups_and_speech_of_the_types_of_rep_155(tmp_path):
    """A message for each group, of which those of one stamp belong together; of speech what is finished."""
    with SceneBag(tmp_path / "a.bag") as bag:
        for stamp, groups in ((BASE, ["ab", "cd"]), (BASE + 1.0, ["abc"])):
            for number, members in enumerate(groups):
                name = "hri_msgs/msg/Group"
                bag.write("/humans/interactions/groups", name,
                          bag.make(name, bag.header(stamp), "g%d" % number, list(members)), stamp)
        for stamp, texts in ((BASE, ("how", "")), (BASE + 1.0, ("", "how are you")), (BASE + 5.0, ("", "good bye"))):
            name = "hri_msgs/msg/LiveSpeech"
            bag.write("/humans/voices/v/speech", name, bag.make(name, bag.header(stamp), *texts, 0.9, "en-GB"), stamp)
    record = read_bag(tmp_path / "a.bag")
    assert record.groups == [(BASE, (frozenset("ab"), frozenset("cd"))), (BASE + 1.0, (frozenset("abc"),))]
    assert [text for _, text in record.said["v"]] == ["how are you", "good bye"]
    assert [when - BASE for when, _, _ in record.texts] == pytest.approx([1.0, 5.0])


def test_of_texts_that_replace_each_other_the_last_one_was_said(tmp_path):
    with SceneBag(tmp_path / "a.bag") as bag:
        for number, text in enumerate(("how", "how are", "how are you")):
            bag.text("/humans/voices/v/speech", text, BASE + number)
    assert [text for _, text in read_bag(tmp_path / "a.bag").said["v"]] == ["how are you"]


def test_places_that_are_told_again_or_of_before_are_left_out(tmp_path):
    with SceneBag(tmp_path / "a.bag") as bag:
        for number, (stamp, x) in enumerate(((10.0, 1.0), (10.0, 1.5), (11.0, 2.0), (9.0, 3.0))):
            bag.transforms("/tf", [("map", "person_pa", upright((x, 0.0, 0.0)))], BASE + stamp, BASE + 20.0 + number)
    track = read_bag(tmp_path / "a.bag").tracks["pa"]
    assert [x for x, _, _ in track.places] == [1.0, 2.0] and track.ages == pytest.approx([10.0, 11.0])


def test_messages_of_another_type_are_damaged_ones(tmp_path):
    with SceneBag(tmp_path / "a.bag") as bag:
        for number, topic in enumerate(("/humans/persons/tracked", "/humans/interactions/gaze",
                                        "/humans/interactions/groups",
                                        "/scene/truth/persons", "/scene/truth/visible", "/humans/faces/tracked",
                                        "/humans/persons/pa/location_confidence", "/humans/voices/v/speech",
                                        "/scene/truth/words")):
            bag.poses(topic, [upright((1.0, 2.0, 3.0))], BASE + 0.1 * number)
    assert score(read_bag(tmp_path / "a.bag"))["damaged_messages"] == 9


def test_damaged_messages_are_counted(tmp_path):
    path = tmp_path / "a.bag"
    world = World(SCENE)
    with SceneBag(path) as bag:
        bag.truth(world.at(0.0), BASE)
        bag.transforms("/tf", [("map", "person_pa", upright((1.0, math.nan, 0.0)))], BASE)
        bag.write("/tf", "tf2_msgs/msg/TFMessage", bag.make("tf2_msgs/msg/TFMessage", []), BASE)
        bag.write_raw("/tf", "tf2_msgs/msg/TFMessage", b"\xff\xff\xff\x00damaged", BASE)
    figures = score(read_bag(path))
    assert figures["foreign_frames"] + figures["damaged_messages"] >= 2
