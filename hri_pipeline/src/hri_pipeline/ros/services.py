"""Calls of services that end after a time: rospy's own wait for a minute, or for ever."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeout
from typing import Any, Callable, Sequence, TypeVar

import rospy

from hri_pipeline.ros.master import ANSWER_S

_Answer = TypeVar("_Answer")


class NoAnswer(rospy.ServiceException):
    """A service is offered, but does not answer in time; the text names it, and says what to do."""


def in_time(call: Callable[[], _Answer], seconds: float) -> _Answer:
    """Return what a call in a thread of its own returns, or raise what it raises.

    Raises TimeoutError after `seconds`; the call goes on then, and nobody hears of its end.
    """
    done: "Future[_Answer]" = Future()

    def run() -> None:
        try:
            done.set_result(call())
        except BaseException as error:      # its caller is to have it
            done.set_exception(error)

    threading.Thread(target=run, name="call in time", daemon=True).start()
    try:
        return done.result(seconds)
    except FutureTimeout:
        if done.done():                     # just now; or the call itself has raised it
            return done.result()
        raise TimeoutError("no answer within {:g} s".format(seconds)) from None


def call_service(name: str, kind: type, values: Sequence[object], seconds: float) -> Any:
    """Return the answer of a service (resolved name).

    Raises rospy.ServiceException where it is not there or fails, NoAnswer after `seconds`.
    """
    try:
        return in_time(lambda: rospy.ServiceProxy(name, kind)(*values), seconds)
    except TimeoutError:
        raise NoAnswer("{} has not answered within {:g} s, and may still do what it was asked. Its node hangs, or "
                       "waits for its disk: see its log, or end it and start it again".format(name, seconds)) from None


def wait_for_service(name: str, seconds: float) -> None:
    """Return as soon as a service (resolved name) is offered and takes connections.

    Raises rospy.ROSException after `seconds`, and ANSWER_S more where the master, or the node, does not answer.
    """
    try:
        in_time(lambda: rospy.wait_for_service(name, seconds), seconds + ANSWER_S)
    except TimeoutError:
        raise rospy.ROSException("{} takes no call within {:g} s: its node, or the ROS master, hangs; see its log, or "
                                 "end it and start it again".format(name, seconds + ANSWER_S)) from None
