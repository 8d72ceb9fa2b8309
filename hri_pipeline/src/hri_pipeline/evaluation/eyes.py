"""Real faces with open and with closed eyes: the labels of eyes.txt and the confusion table."""

from __future__ import annotations

from pathlib import Path
from typing import Dict, List, Optional, Sequence

from hri_pipeline.evaluation.labels import LabelledFace, frames, images, nearest_face, read_labels

__all__ = ["TABLE", "LabelledFace", "confusion", "frames", "images", "labelled_eyes", "nearest_face"]

TABLE = Path(__file__).with_name("eyes.txt")


def labelled_eyes(path: Optional[Path] = None) -> List[LabelledFace]:
    """Read the labels (`open` or `closed`), by default those of this package. Raises ValueError naming file and line."""
    return read_labels(path or TABLE, ("open", "closed"))


def confusion(labels: Sequence[LabelledFace], predicted: Sequence[Optional[bool]]) -> Dict[str, int]:
    """Count closed found closed (tp), open found closed (fp), open found open (tn), closed found open (fn).

    predicted: one per label, None where there was no answer: counted as `unknown`. Raises ValueError when the
    lengths differ.
    """
    if len(labels) != len(predicted):
        raise ValueError("{} labels and {} answers".format(len(labels), len(predicted)))
    table = {"tp": 0, "fp": 0, "tn": 0, "fn": 0, "unknown": 0}
    for label, answer in zip(labels, predicted):
        if answer is None:
            table["unknown"] += 1
        elif label.closed:
            table["tp" if answer else "fn"] += 1
        else:
            table["fp" if answer else "tn"] += 1
    return table
