"""The log: what rospy leaves out of it, and when its throttled lines come; whether topics have statistics."""

import logging
import logging.config

import pytest
import rospy

from hri_pipeline.ros import rospy_compat
from hri_pipeline.ros.rospy_compat import StatisticsSwitch

LOGGING = """[loggers]
keys=root{0}
[handlers]
keys=file
[formatters]
keys=plain
[logger_root]
level=INFO
handlers=file
[handler_file]
class=FileHandler
formatter=plain
args=({1!r},)
[formatter_plain]
format=%(message)s
"""


@pytest.mark.parametrize("names, lines, level", [
    ("", "", logging.WARNING),
    (", rospy", "[logger_rospy]\nlevel=DEBUG\nhandlers=file\nqualname=rospy\n", logging.DEBUG)])
def test_the_log_file_tells_warnings_of_connections_only_unless_its_configuration_names_rospy(
        tmp_path, monkeypatch, names, lines, level):
    logger = logging.getLogger("rospy.internal")
    for changed in (logger, logging.getLogger("rospy"), logging.root):
        monkeypatch.setattr(changed, "level", changed.level)
        monkeypatch.setattr(changed, "handlers", list(changed.handlers))
    rospy_compat.log_no_connections()
    (tmp_path / "logging.conf").write_text(LOGGING.format(names, str(tmp_path / "log")) + lines, encoding="utf-8")
    # As rospy.init_node does (rosgraph.roslogging).
    logging.config.fileConfig(str(tmp_path / "logging.conf"), disable_existing_loggers=False)
    assert logger.getEffectiveLevel() == level and not logger.disabled


def test_throttled_lines_do_not_come_with_each_message_of_two_clocks(monkeypatch):
    """rospy's own table forgets all lines when /clock goes back."""
    monkeypatch.setattr(rospy.core, "_logging_throttle", rospy.core._logging_throttle)
    monkeypatch.setattr(rospy.Time, "now", lambda: times.pop(0))
    times = [rospy.Time(100 - 50 * (number % 2) + number) for number in range(100)]
    rospy_compat.prepare_rospy()
    due = [rospy.core._logging_throttle("line %d" % (number % 3), 10.0) for number in range(30)]
    assert due == 3 * [True] + 27 * [False]


def test_throttled_lines_come_again_after_their_period():
    now = [5.0]
    throttle = rospy_compat.WallTimeThrottle(lambda: now[0])
    told = []
    for now[0] in (5.0, 14.9, 15.1, 16.0, 26.0):
        told.append(throttle("here", 10.0))
    assert told == [True, False, True, False, True]


def test_whether_topics_have_statistics_is_not_asked_with_each_of_them():
    now, asked, given = [100.0], [], [False]
    switch = StatisticsSwitch(lambda: asked.append(now[0]) or given[0], lambda: now[0])
    assert [switch() for _ in range(5)] == 5 * [False] and len(asked) == 1
    given[0], now[0] = True, 109.0
    assert not switch() and len(asked) == 1
    now[0] = 110.0
    assert switch() and len(asked) == 2, "it may be switched on later"
