"""File descriptors of this process: as many as the system allows, and a reserve."""

from __future__ import annotations

import errno
import os
import resource
from typing import Dict, Tuple

from diagnostic_msgs.msg import DiagnosticStatus

DESCRIPTORS_HINT = ("raise the limit (ulimit -Hn; nofile in /etc/security/limits.conf, LimitNOFILE= of a systemd "
                    "service, --ulimit nofile= of docker)")
_RESERVE = 64
"""Descriptors that are left free for calls of the master and the like; an eighth of them all, where that is less."""
_OWN_DESCRIPTORS = "/proc/self/fd"


def raise_limit() -> None:
    """Raise the limit of descriptors as far as it goes. Idempotent."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != hard:
        try:
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
        except (OSError, ValueError):   # more than the kernel gives to anybody
            pass


def descriptor_limit() -> int:
    """Return how many descriptors this process may have."""
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return 2 ** 31 if soft == resource.RLIM_INFINITY else soft


def descriptors_used() -> int:
    """Return how many descriptors this process has open, 0 if unknown."""
    try:
        return len(os.listdir(_OWN_DESCRIPTORS)) - 1
    except OSError as error:
        return descriptor_limit() if error.errno == errno.EMFILE else 0


def descriptors_are_short(part: float = 1.0) -> bool:
    """Return whether fewer descriptors are free than this part (0 to 1) of the reserve."""
    most = descriptor_limit()
    return most - descriptors_used() < part * min(_RESERVE, most // 8)


def require_descriptors() -> None:
    """Raise OSError if only the reserve of descriptors is left: then no topic should be opened.

    Without a free descriptor for calls of the master, rospy would try for ever, and no topic could be opened or closed.
    """
    if descriptors_are_short():
        raise OSError(
            errno.EMFILE, "too few file descriptors are left of {}: {}".format(descriptor_limit(), DESCRIPTORS_HINT)
        )


def descriptors_status() -> Tuple[int, str, Dict[str, object]]:
    """Return level, message and values for diagnostics."""
    most, count = descriptor_limit(), descriptors_used()
    values: Dict[str, object] = {"used": count, "limit": most}
    if descriptors_are_short():
        return DiagnosticStatus.WARN, ("{} of {} file descriptors are used: new topics and connections wait; {}".format(
            count, most, DESCRIPTORS_HINT)), values
    return DiagnosticStatus.OK, "{} of {} used".format(count, most), values
