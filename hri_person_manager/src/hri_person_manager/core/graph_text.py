"""The association as text in the language of GraphViz, for people: `rostopic echo -p /humans/graph`, or xdot."""

from __future__ import annotations

from typing import Iterable, List, Tuple

from hri_person_manager.core.association import Kind, Node
from hri_person_manager.core.person_state import Snapshot

_SHAPES = {Kind.PERSON: "box", Kind.FACE: "ellipse", Kind.BODY: "hexagon", Kind.VOICE: "cds"}
Edge = Tuple[Node, Node, float]


def graph_text(snapshot: Snapshot, matches: Iterable[Edge], unions: Iterable[Tuple[str, str, float]],
               threshold: float) -> str:
    """Return a GraphViz graph of persons, their features (bold) and all candidate matches (dotted below the threshold).

    matches: pairs of features, or of feature and person, with their likelihood; unions: pairs of persons.
    """
    lines: List[str] = ["graph humans {", "  rankdir=LR;"]
    nodes = set()
    for state in snapshot.persons:
        person = Node(Kind.PERSON, state.id)
        label = "%s\\n%s" % (state.id, "alias of " + state.alias if state.alias else "%.2f" % state.confidence)
        lines.append("  %s [shape=box, style=%s, label=\"%s\"];" % (
            _name(person), "dashed" if state.anonymous else "solid", label))
        for kind, feature in ((Kind.FACE, state.face), (Kind.BODY, state.body), (Kind.VOICE, state.voice)):
            if feature:
                nodes.add(Node(kind, feature))
                lines.append("  %s -- %s [style=bold];" % (_name(person), _name(Node(kind, feature))))
    shown = {Node(Kind.PERSON, state.id) for state in snapshot.persons}
    pairs = [(first, second, value) for first, second, value in matches]
    pairs += [(Node(Kind.PERSON, first), Node(Kind.PERSON, second), value) for first, second, value in unions]
    for first, second, value in sorted(pairs):
        nodes.update((first, second))
        lines.append("  %s -- %s [label=\"%.2f\", style=%s];" % (
            _name(first), _name(second), value, "solid" if value >= threshold else "dotted"))
    for node in sorted(nodes - shown):
        lines.append("  %s [shape=%s, label=\"%s\"];" % (_name(node), _SHAPES[node.kind], node.id))
    return "\n".join(lines + ["}"]) + "\n"


def _name(node: Node) -> str:
    """Identifier of a node; ids are letters, digits and underscores, so nothing needs quoting."""
    return "%s_%s" % (node.kind.name.lower(), node.id)
