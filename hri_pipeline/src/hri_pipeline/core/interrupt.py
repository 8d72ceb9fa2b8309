"""To be imported first by a program: Ctrl-C while it imports the rest ends it without a traceback.

The exit code stays that of a program that Ctrl-C has ended (130 in a shell). Who handles SIGINT later is not affected.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False       # that of `typing` would have to be imported before the hook is there
if TYPE_CHECKING:
    from types import FrameType, TracebackType
    from typing import Optional, Type

_show = sys.excepthook


def _show_others(kind: Type[BaseException], error: BaseException, trace: Optional[TracebackType]) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        _show(kind, error, trace)


sys.excepthook = _show_others

import signal  # noqa: E402


def _end_while_importing(number: int, frame: Optional[FrameType]) -> None:
    """End at once while the program imports: numpy makes an ImportError of the KeyboardInterrupt, others forget it."""
    inner = None
    while frame is not None and (frame.f_code.co_name, frame.f_globals.get("__name__")) != ("<module>", "__main__"):
        inner, frame = frame, frame.f_back
    if frame is not None and inner is not None and inner.f_code.co_filename.startswith("<frozen importlib"):
        signal.signal(number, signal.SIG_DFL)
        signal.raise_signal(number)
    raise KeyboardInterrupt


if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
    signal.signal(signal.SIGINT, _end_while_importing)
