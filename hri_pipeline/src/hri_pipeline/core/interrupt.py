"""To be imported first by a program: Ctrl-C while it imports the rest ends it without a traceback.

The exit code stays that of a program that Ctrl-C has ended (130 in a shell). Who handles SIGINT later is not affected.
"""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Optional, Type

_show = sys.excepthook


def _show_others(kind: Type[BaseException], error: BaseException, trace: Optional[TracebackType]) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        _show(kind, error, trace)


sys.excepthook = _show_others
