"""Warnings of a state that lasts, texts with names of any length, and one bad item among others."""

from __future__ import annotations

import errno
import logging
import resource
import subprocess

import pytest

from hri_pipeline.core import error_log
from hri_pipeline.core.error_log import (
    LONGEST_LINE,
    LONGEST_WORD,
    ItemGuard,
    LogFilter,
    Outage,
    shortened,
    thread_shortage,
)


def test_an_outage_is_told_once():
    outage = Outage(10.0)
    assert [outage.is_to_tell() for _ in range(5)] == [True, False, False, False, False]


def test_what_comes_back_for_a_moment_is_the_same_outage():
    outage = Outage(10.0)
    assert outage.is_to_tell()
    for now in (20.0, 25.0, 29.9):
        outage.there(now)
    assert not outage.is_to_tell()
    outage.there(31.0)
    assert not outage.is_to_tell()      # it was away in between


def test_what_was_there_for_long_is_told_again():
    outage = Outage(10.0)
    assert outage.is_to_tell()
    for now in (20.0, 25.0, 30.0):
        outage.there(now)
    assert outage.is_to_tell()
    assert not outage.is_to_tell()


def test_a_long_name_is_cut_and_the_words_around_it_stay():
    text = shortened("no transform leads from " + 50000 * "f" + "_end to map: persons move with it")
    assert len(text) < LONGEST_WORD + 80
    assert text.startswith("no transform leads from fff") and text.endswith("f_end to map: persons move with it")


def test_many_words_are_cut_line_by_line():
    text = shortened("short\n" + 50000 * "a " + "\nend")
    first, middle, last = text.split("\n")
    assert (first, last) == ("short", "end") and len(middle) == LONGEST_LINE


def test_ordinary_texts_stay_as_they_are():
    for text in ("", "a", "x" * LONGEST_WORD, "Traceback:\n" + "\n".join(100 * ["  File /a/b.py, line 3"])):
        assert shortened(text) == text


def test_the_filter_changes_records_with_arguments_and_drops_ordinary_ends(caplog):
    logger = logging.getLogger("test_log_texts")
    cut = LogFilter()
    logger.addFilter(cut)
    try:
        with caplog.at_level(logging.INFO):
            logger.info("from %s to %s, 100 %%", 50000 * "f", "map")
            logger.warning("Inbound TCP/IP connection failed: %s", "connection from sender terminated before handshake "
                           "header received. 0 bytes were received. Please check sender for additional details.")
            logger.warning("Could not process inbound connection: [/hri_faces] is not a publisher of "
                           "[/humans/faces/abcde/roi]. Topics are []{'callerid': '/rviz'}")
            logger.warning("Could not process inbound connection: topic types do not match: [a/A] vs. [b/B]")
    finally:
        logger.removeFilter(cut)
    assert len(caplog.messages[0]) < 300 and caplog.messages[0].endswith(" to map, 100 %")
    assert len(caplog.messages) == 2 and "types do not match" in caplog.messages[1]


def test_the_others_get_their_results_in_order():
    guard = ItemGuard()
    assert guard.each("number", lambda value: 6 // value, [1, 0, 3, 0, 2]) == [6, 2, 3]
    assert guard.errors == 2


def test_each_kind_of_error_is_told_once_and_the_last_is_news_once():
    told = []
    guard = ItemGuard(told.append)
    for _ in range(3):
        guard.each("number", lambda value: 6 // value, [0, 0])
    guard.attempt("word", int, "seven")
    assert (
        len(told) == 2 and "Traceback" in told[0] and "ZeroDivisionError" in told[0] and "a word is left out" in told[1]
    )
    assert "seven" in guard.news() and guard.news() == ""


def test_an_attempt_says_whether_it_worked():
    guard, done = ItemGuard(), []
    assert guard.attempt("item", done.append, 1) and done == [1]
    assert not guard.attempt("item", done.remove, 2)


def limited(monkeypatch, group=None, of_user=resource.RLIM_INFINITY, user=1000):
    monkeypatch.setattr(error_log, "fullest_group", lambda: group)
    monkeypatch.setattr(error_log.resource, "getrlimit", lambda which: (of_user, of_user))
    monkeypatch.setattr(error_log.os, "geteuid", lambda: user)


NO_THREAD = RuntimeError("can't start new thread")


@pytest.mark.parametrize("given, said", [
    ({"of_user": 60}, "this user may have 60 processes and threads (ulimit -u); raise that"),
    ({"of_user": 60, "group": (99, 100)}, "has 99 processes and threads, and may have 100; raise --pids-limit"),
    ({"of_user": 60, "group": (50, 100)}, "this user may have 60 "),
    ({"of_user": 60, "user": 0}, "the memory is full"),
    ({}, "the memory is full"),
])
def test_which_limit_lets_no_more_threads_start(given, said, monkeypatch):
    limited(monkeypatch, **given)
    assert said in thread_shortage(NO_THREAD) and "\n" not in thread_shortage(NO_THREAD)


def test_no_more_processes_are_the_same_limit_and_other_errors_none(monkeypatch):
    limited(monkeypatch, of_user=60)

    fork = compile("raise BlockingIOError(errno.EAGAIN, 'temporarily unavailable')", subprocess.__file__, "exec")
    with pytest.raises(BlockingIOError) as caught:
        exec(fork)
    assert thread_shortage(caught.value).startswith("the system gives no more processes: this user may have 60 ")
    for other in (RuntimeError("dictionary changed size"), BlockingIOError(errno.EAGAIN, "a socket"), OSError(),
                  KeyError()):
        assert thread_shortage(other) == ""


def test_the_log_says_which_limit_where_somebody_else_has_no_thread(monkeypatch, caplog):
    limited(monkeypatch, of_user=60)
    logger = logging.getLogger("test_log_threads")
    hint = LogFilter()
    logger.addFilter(hint)
    try:
        logger.error("unable to start TCPROS server: %s", NO_THREAD)
        logger.error("another error")
    finally:
        logger.removeFilter(hint)
    first, second = (record.getMessage() for record in caplog.records)
    assert first.startswith("unable to start TCPROS server: can't start new thread\nthis user may have 60 ")
    assert second == "another error"
