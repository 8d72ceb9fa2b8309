"""Publishers of ids, of which some cannot be opened; without a master."""

import pytest
from std_msgs.msg import String

from hri_pipeline.ros import publishers as module
from hri_pipeline.ros.publishers import IdPublishers, TopicSpec


@pytest.fixture()
def publishers(monkeypatch):
    """Those of a namespace; `refused` has the ids whose topics cannot be opened."""
    made = IdPublishers("/humans/faces", {"roi": TopicSpec(String)})
    made.refused = set()

    def advertise(identity, name, spec, listener):
        if identity in made.refused:
            raise OSError("too few file descriptors")
        return object()

    monkeypatch.setattr(made, "_advertise", advertise)
    monkeypatch.setattr(made._releaser, "put", lambda topics: list(topics))
    return made


def test_who_has_gone_is_closed_although_a_new_one_cannot_be_opened(publishers, monkeypatch):
    """Otherwise the descriptors that the new one needs are never free."""
    publishers.keep(["gone"])

    def refuse():
        raise OSError("too few file descriptors")

    monkeypatch.setattr(module, "require_descriptors", refuse)
    with pytest.raises(OSError):
        publishers.keep(["new"])
    assert publishers.ids == []


def test_one_that_cannot_be_opened_costs_no_other(publishers):
    publishers.refused.add("second")
    with pytest.raises(OSError, match="descriptors"):
        publishers.keep(["first", "second", "third"])
    assert publishers.ids == ["first", "third"]
    publishers.refused.clear()
    publishers.keep(["second", "third"])
    assert publishers.ids == ["third", "second"]
