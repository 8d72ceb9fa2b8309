"""Golden figures: what a recording has to score at least, from a YAML file, and the comparison with what it scores
now."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Mapping, Optional, Sequence, Union

import yaml

HIGHER, LOWER, SAME, TOLD = "higher", "lower", "same", "told"
WORSE, BETTER, AS_GOOD, MISSING = "WORSE", "better", "ok", "MISSING"
_KEYS = {"value", "better", "tolerance"}


class GoldenError(ValueError):
    """A file of golden figures that is not to be used; the text names file, figure and what is legal."""


@dataclass(frozen=True)
class Golden:
    """One figure. value: as it was. better: higher, lower or same is good; told: shown and never wrong.

    tolerance: by how much it may be worse, in the figure's unit, because no two runs are the same.
    """

    key: str
    value: float
    better: str
    tolerance: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """A figure, what it is now (None: there is none), and the verdict: ok, better, WORSE, MISSING or told."""

    golden: Golden
    value: Optional[float]
    verdict: str

    @property
    def failed(self) -> bool:
        """Whether the recording scores worse than it has to."""
        return self.verdict in (WORSE, MISSING)


def load_golden(path: Union[str, Path], section: str = "") -> List[Golden]:
    """Read the golden figures of a section; empty: of the only one. Raises GoldenError."""
    file = Path(path).expanduser()
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise GoldenError("{}: {}".format(file, " ".join(str(error).split()))) from error
    if not isinstance(content, dict) or not content:
        raise GoldenError("{}: a mapping of sections is needed".format(file))
    if not section and len(content) == 1:
        section = str(next(iter(content)))
    if section not in content:
        raise GoldenError("{}: {}; sections: {}".format(
            file, "there is no section {!r}".format(section) if section else "name a section",
            ", ".join(map(str, content))))
    rows = content[section]
    if not isinstance(rows, dict) or not rows:
        raise GoldenError("{}, {}: a mapping of figures is needed".format(file, section))
    return [_golden("{}, {}".format(file, section), str(key), row) for key, row in rows.items()]


def compare(figures: Mapping[str, object], golden: Sequence[Golden]) -> List[Outcome]:
    """Compare figures with golden ones.

    A list or mapping in the figures is named with dots: confidence_errors_m.0.places.
    """
    flat = _flat(figures)
    return [_outcome(wanted, flat.get(wanted.key)) for wanted in golden]


def comparison_table(outcomes: Sequence[Outcome]) -> str:
    """Return the comparison as lines of text."""
    lines = ["{:40} {:>9}  {:>9}  {:>9}  {:8} {}".format("figure", "golden", "tolerance", "now", "verdict",
                                                         "better is")]
    lines += ["{:40} {:>9.4g}  {:>9}  {:>9}  {:8} {}".format(
        one.golden.key, one.golden.value, "-" if one.verdict == TOLD else "{:.4g}".format(one.golden.tolerance),
        "-" if one.value is None else "{:.4g}".format(one.value), one.verdict, one.golden.better) for one in outcomes]
    failed, better = sum(one.failed for one in outcomes), [one.golden.key for one in outcomes if one.verdict == BETTER]
    lines.append("{} of {} figures are worse than they have to be.".format(failed, len(outcomes)) if failed
                 else "No figure is worse than it has to be.")
    if better:
        lines.append("Better, so that the golden figure may be raised: " + ", ".join(better))
    return "\n".join(lines)


def _golden(where: str, key: str, row: object) -> Golden:
    if not isinstance(row, dict) or set(row) - _KEYS or not {"value", "better"} <= set(row):
        raise GoldenError(
            "{}, {}: value and better are needed, tolerance may be given, and nothing else".format(where, key)
        )
    if row["better"] not in (HIGHER, LOWER, SAME, TOLD):
        raise GoldenError("{}, {}: better is {!r}, legal: higher, lower, same, told".format(where, key, row["better"]))
    for name in ("value", "tolerance"):
        value = row.get(name, 0.0)
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise GoldenError("{}, {}: {} is {!r}, a finite number is needed".format(where, key, name, value))
    if row.get("tolerance", 0.0) < 0.0:
        raise GoldenError("{}, {}: tolerance is {:g}, legal from 0".format(where, key, row["tolerance"]))
    return Golden(key, float(row["value"]), row["better"], float(row.get("tolerance", 0.0)))


def _outcome(golden: Golden, value: Optional[float]) -> Outcome:
    if golden.better == TOLD:
        return Outcome(golden, value, TOLD)
    if value is None:
        return Outcome(golden, None, MISSING)
    gain = value - golden.value if golden.better == HIGHER else golden.value - value
    if golden.better == SAME:
        gain = -abs(gain)
    slack = golden.tolerance + 1e-9 * max(1.0, abs(golden.value))
    return Outcome(golden, value, WORSE if gain < -slack else BETTER if gain > slack else AS_GOOD)


def _flat(figures: object, prefix: str = "") -> Dict[str, float]:
    """Numbers of nested mappings and lists by their dotted names; what is no finite number is left out."""
    if isinstance(figures, (bool, int, float)):
        return {prefix: float(figures)} if math.isfinite(figures) else {}
    items = (
        figures.items()
        if isinstance(figures, Mapping)
        else enumerate(figures) if isinstance(figures, (list, tuple)) else ()
    )
    found: Dict[str, float] = {}
    for key, value in items:
        found.update(_flat(value, "{}.{}".format(prefix, key) if prefix else str(key)))
    return found
