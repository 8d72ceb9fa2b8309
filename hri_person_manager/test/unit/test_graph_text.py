"""The association as a GraphViz graph."""

from __future__ import annotations

from hri_person_manager.core.association import Kind, Node
from hri_person_manager.core.graph_text import graph_text
from hri_person_manager.core.person_state import PersonState, Snapshot


def test_persons_features_and_matches_are_all_in_the_graph():
    snapshot = Snapshot((PersonState("ann", "f1", "b1", "", False, 1.0),
                         PersonState("bob", "", "", "", True, 0.0, "ann")), ("ann",), ("ann", "bob"))
    text = graph_text(snapshot, [(Node(Kind.FACE, "f1"), Node(Kind.BODY, "b1"), 0.9),
                                 (Node(Kind.FACE, "f1"), Node(Kind.BODY, "b2"), 0.3)], [("ann", "bob", 0.8)], 0.5)
    assert text.startswith("graph humans {") and text.endswith("}\n")
    assert "person_ann -- face_f1 [style=bold];" in text
    assert 'face_f1 -- body_b1 [label="0.90", style=solid];' in text
    assert 'face_f1 -- body_b2 [label="0.30", style=dotted];' in text
    assert 'person_ann -- person_bob [label="0.80", style=solid];' in text
    assert "alias of ann" in text and "body_b2 [shape=hexagon" in text
