"""What the benchmarks of several parts have in common: the choice of the parts, and measuring one after the other."""

from __future__ import annotations

import sys
import traceback
from typing import Callable, Dict, List, Mapping, Optional, Sequence, Tuple

Parts = Mapping[str, Sequence[str]]
"""Names of the parts, with the keys of the figures that each gives."""


def chosen(subject: str, only: str, parts: Parts) -> Optional[List[str]]:
    """Return the parts that `--only` names, all without it; None, and a line on standard error, for unknown ones."""
    wanted = [name for name in only.split(",") if name] or list(parts)
    unknown = sorted(set(wanted) - set(parts))
    if unknown:
        print("scripts/benchmark {}: --only knows {}, not {}".format(subject, ", ".join(parts), ", ".join(unknown)),
              file=sys.stderr)
        return None
    return [name for name in parts if name in wanted]


def measure_all(wanted: Sequence[str], parts: Parts,
                measure: Callable[[str], Mapping[str, object]]) -> Tuple[Dict[str, object], Dict[str, str], bool]:
    """Measure the wanted parts; one that fails does not hide the others.

    Returns the values, the reason of each figure that is missing, and whether a part has failed.
    """
    values: Dict[str, object] = {}
    reasons = {key: "not asked for (--only)" for name, keys in parts.items() if name not in wanted for key in keys}
    failed = False
    for name in wanted:
        print("{} ...".format(name), file=sys.stderr, flush=True)
        try:
            values.update(measure(name))
        except Exception as error:
            failed = True
            traceback.print_exc(file=sys.stderr)
            reasons.update({key: "{}: {}".format(type(error).__name__, error) for key in parts[name]})
    return values, reasons, failed
