"""The labels of who is who."""

from collections import defaultdict

from benchmarks.recognition import identities


def test_nobody_is_twice_on_one_photograph():
    people = defaultdict(list)
    for label in identities():
        people[label.file, label.frame].append(label.label)
    assert max(map(len, people.values())) > 1
    assert all(len(names) == len(set(names)) for names in people.values())


def test_the_figure_counts_what_was_asked_for():
    asked = identities(asked_only=True)
    assert len(asked) == 28 and len({label.label for label in asked}) == 23
    assert sum(label.label == "one" for label in asked) == 5
    assert {label.file.split("/")[0] for label in asked} == {"demo", "evaluation"}
    assert len(identities()) > len(asked)
