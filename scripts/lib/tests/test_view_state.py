"""What a picture of the demonstration lacks, and when it is good enough."""

from __future__ import annotations

from dataclasses import replace

from view_state import Lack, Steady, View, good_enough, lack, seen_and_heard

TOPICS = ("/skeletons", "/overlay")
FULL = View(frozenset("pq"), frozenset("fg"), frozenset("ab"), frozenset("ab"), 2, 1, 1, (2, 2), frozenset(TOPICS))


def test_a_voice_alone_is_a_person_but_nobody_who_is_seen() -> None:
    features = {"ann": {"face_id": "f", "body_id": ""}, "bob": {"face_id": "", "body_id": "b"},
                "anonymous": {"face_id": "", "body_id": ""}}
    assert seen_and_heard(["ann", "anonymous", "bob", "new"], features) == (["ann", "bob"], ["anonymous", "new"])


def test_a_full_view_lacks_nothing() -> None:
    found = lack(FULL, 2, TOPICS)
    assert found == Lack(0, [], []) and found.weight == 0 and found.text == "nothing"


def test_what_is_missing_is_named() -> None:
    for change, word in ((dict(marked=0), "a name"), (dict(faces=frozenset(), overlay=(0, 2)), "a face"),
                         (dict(skeletons=frozenset()), "a skeleton in space"),
                         (dict(overlay=(0, 2)), "faces on the camera image"),
                         (dict(overlay=None), "bodies on the camera image"),
                         (dict(viewed=frozenset(["/overlay"])), "/skeletons in the viewer")):
        assert word in lack(replace(FULL, **change), 2, TOPICS).needed, word


def test_parts_are_wished_for() -> None:
    found = lack(replace(FULL, skeletons=frozenset("a"), overlay=(1, 2), gazes=0), 2, TOPICS)
    assert not found.needed
    assert set(found.wished) == {"1 of 2 skeletons in space", "1 of 2 faces on the camera image", "gazes"}


def test_a_skeleton_of_somebody_who_has_gone_does_not_count() -> None:
    assert "1 of 2 skeletons in space" in lack(replace(FULL, skeletons=frozenset("ax")), 2, TOPICS).wished


def test_a_voice_without_a_place_needs_no_name() -> None:
    assert lack(replace(FULL, persons=frozenset("pqv")), 2, TOPICS).text == "nothing"
    assert "1 of 2 names" in lack(replace(FULL, persons=frozenset("pqv"), marked=1), 2, TOPICS).wished


def test_persons_weigh_most_then_what_is_needed() -> None:
    views = [FULL, replace(FULL, gazes=0, groups=0), replace(FULL, overlay=(0, 2)),
             replace(FULL, persons=frozenset("p"))]
    weights = [lack(view, 2, TOPICS).weight for view in views]
    assert weights == sorted(weights) and len(set(weights)) == len(weights)


def test_the_worst_of_the_last_moments_counts() -> None:
    steady, bad, good = Steady(1.0), Lack(0, ["a face"], []), Lack(0, [], [])
    assert steady.add(0.0, bad) is None
    assert steady.add(0.6, good) is None
    assert steady.add(1.2, good) == bad
    assert steady.add(1.7, good) == good


def test_wishes_are_waited_for_half_of_the_time() -> None:
    assert good_enough(Lack(0, [], []), 0.0)
    assert not good_enough(Lack(0, [], ["gazes"]), 0.4) and good_enough(Lack(0, [], ["gazes"]), 0.6)
    assert not good_enough(Lack(0, ["a face"], []), 0.9) and not good_enough(Lack(1, [], []), 0.9)
