"""Errors and how they are logged: a kind of error once, a state that lasts once, and no line that is too long."""

from __future__ import annotations

import errno
import logging
import os
import re
import resource
import traceback
from typing import Any, Callable, Iterable, List, Optional, Set, Tuple, TypeVar

from hri_pipeline.core.resources import fullest_group

LONGEST_WORD = 200
LONGEST_LINE = 2000

Item = TypeVar("Item")
Result = TypeVar("Result")


class Outage:
    """Decides when to log that something is missing: once, and again only after it has been there for `calm` s.

    Times are in s, of a clock that never jumps.
    """

    def __init__(self, calm: float) -> None:
        self._calm = calm
        self._told = False
        self._there_since: Optional[float] = None

    def there(self, now: float) -> None:
        """It is there at `now`."""
        if self._there_since is None:
            self._there_since = now
        if now - self._there_since >= self._calm:
            self._told = False

    def is_to_tell(self) -> bool:
        """It is missing; return whether to log it."""
        self._there_since = None
        told, self._told = self._told, True
        return not told


# What rospy tells of subscribers that let go before they were connected, and of the topics of those who have gone.
_ORDINARY = re.compile(r"Inbound TCP/IP connection failed: .* 0 bytes were received"
                       r"|Could not process inbound connection: \[\S*\] is not a publisher of \[/humans/")


_NO_THREAD = "can't start new thread"
_NEARLY = 0.9           # threads end while an error is told


def thread_shortage(error: BaseException) -> str:
    """Return in a line that the system gives this process no more threads or child processes, by which limit, and what
    to do; empty for any other error."""
    trace = traceback.extract_tb(error.__traceback__)
    is_fork = (isinstance(error, OSError) and error.errno == errno.EAGAIN and bool(trace)
               and os.path.basename(trace[-1].filename) == "subprocess.py")
    if is_fork or (isinstance(error, RuntimeError) and _NO_THREAD in str(error)):
        return "the system gives no more {}: {}".format("processes" if is_fork else "threads", thread_limit())
    return ""


def thread_limit() -> str:
    """Return in words which limit of processes and threads this process has reached, by all signs, and how to raise
    it."""
    used, most = fullest_group() or (0, 0)
    if most and used >= _NEARLY * most:
        return ("its container or service has {} processes and threads, and may have {}; raise --pids-limit of docker, "
                "TasksMax= of the systemd service".format(used, most))
    of_user = resource.getrlimit(resource.RLIMIT_NPROC)[0]
    if of_user != resource.RLIM_INFINITY and os.geteuid() != 0:      # no limit for root
        return ("this user may have {} processes and threads (ulimit -u); raise that: nproc in /etc/security/"
                "limits.conf, LimitNPROC= of a systemd service, --ulimit nproc= of docker".format(of_user))
    return "the memory is full (free -m), or the machine has as many as it may (sysctl kernel.threads-max)"


class LogFilter(logging.Filter):
    """Shortens long words and lines of every log record: names of frames and topics come from outside and have any
    length. Leaves out what rospy tells of subscriptions that end while they begin, which happens all the time. Says
    which limit it is that lets no more threads start."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to log the record; change it where it is too long, or hides what to do."""
        text = record.getMessage()
        if _ORDINARY.match(text):
            return False
        if _NO_THREAD in text:
            text += "\n" + thread_limit()
            record.msg, record.args = text, ()
        if len(text) > LONGEST_WORD:
            record.msg, record.args = shortened(text), ()
        return True


def shortened(text: str) -> str:
    """Return a text, of one or more lines, whose words and lines have lost their middle where they were too long."""
    text = re.sub(r"\S{%d,}" % (LONGEST_WORD + 1),
                  lambda word: elide_middle(word.group(), LONGEST_WORD, LONGEST_WORD // 3), text)
    return "\n".join(elide_middle(line, LONGEST_LINE, LONGEST_LINE // 3) for line in text.split("\n"))


def elide_middle(text: str, most: int, tail: int, mark: str = "[...]") -> str:
    """Return a text of at most `most` characters: of a longer one the beginning, `mark`, and the last `tail`
    characters."""
    return text if len(text) <= most else text[:most - tail - len(mark)] + mark + text[-tail:]


class NewErrors:
    """Tells new kinds of errors from those that have come before; a kind is the type and the line that raised the
    error."""

    def __init__(self) -> None:
        self._known: Set[Tuple[str, str, Optional[int]]] = set()

    def is_new(self, error: BaseException) -> bool:
        """Return whether this kind of error has not come before.

        Raises IndexError for an error that was never raised.
        """
        place = traceback.extract_tb(error.__traceback__)[-1]
        kind = (type(error).__name__, place.filename, place.lineno)
        is_new = kind not in self._known
        self._known.add(kind)
        return is_new


class ItemGuard:
    """Works on one item after the other; an item whose work raises an error is left out and counted, the others go on.

    notify: called with a text and the traceback for each new kind of error, which is its type and the line that raised
    it.
    """

    def __init__(self, notify: Optional[Callable[[str], None]] = None) -> None:
        self._notify = notify
        self._kinds = NewErrors()
        self._news = ""
        self.errors = 0
        """Items that were left out."""

    def each(self, what: str, work: Callable[[Item], Result], items: Iterable[Item]) -> List[Result]:
        """Return work(item) of the items, in order, without those whose work raised. what: a word for one item."""
        results: List[Result] = []
        for item in items:
            self.attempt(what, lambda one: results.append(work(one)), item)
        return results

    def attempt(self, what: str, work: Callable[..., Any], *arguments: Any) -> bool:
        """Call work(*arguments); returns False when it raised. what: a word for the item."""
        try:
            work(*arguments)
            return True
        except Exception as error:  # whatever it is, the other items are good
            self._failed(what, error)
            return False

    def news(self) -> str:
        """Return the last error since the last call in a line, empty when there was none."""
        news, self._news = self._news, ""
        return news

    def _failed(self, what: str, error: Exception) -> None:
        self.errors += 1
        self._news = "a {} is left out: {}: {}".format(what, type(error).__name__, error)
        if self._kinds.is_new(error) and self._notify is not None:
            self._notify("{}\n{}".format(self._news, traceback.format_exc()))
