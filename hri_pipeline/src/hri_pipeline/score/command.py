"""The command `rosrun ros4hri score`: scores of the persons, gazes and groups in a bag."""

from __future__ import annotations

import argparse
import json
import sys
from typing import List, Mapping, Optional, Sequence, Tuple

from hri_pipeline.score.bag import RecordError, read_bag
from hri_pipeline.score.golden import GoldenError, compare, comparison_table, load_golden
from hri_pipeline.score.metrics import Figures, score

_LINES: Tuple[Tuple[str, str], ...] = (
    ("duration_s", "length of the bag, s"),
    ("persons_ids", "ids of persons"), ("persons_ids_per_minute", "new ids per minute"),
    ("persons_mean", "persons tracked, mean"),
    ("persons_most", "persons tracked, most"), ("gazes_mean", "gazes, mean"), ("groups_mean", "groups, mean"),
    ("person_rate_hz", "places of a person, Hz"), ("person_age_ms_p50", "age of a place, median, ms"),
    ("person_age_ms_p95", "age of a place, 95 %, ms"), ("gaze_rate_hz", "gaze messages, Hz"),
    ("groups_rate_hz", "group messages, Hz"), ("persons_true", "people there"), ("persons_found", "people found"),
    ("mota", "MOTA"), ("idf1", "IDF1"), ("hota", "HOTA"), ("deta", "HOTA: detection"), ("assa", "HOTA: association"),
    ("motp_m", "MOTP, mean error, m"), ("id_switches", "id switches"),
    ("id_switches_per_hour", "id switches per hour"), ("id_switches_permanent", "id switches between permanent ids"),
    ("fragments", "fragments"), ("misses", "misses"),
    ("false_positives", "false positives"), ("true_places", "true places"),
    ("gaze_precision", "gaze, precision"), ("gaze_recall", "gaze, recall"),
    ("gaze_precision_lenient", "gaze, precision, 0.3 s late or early"),
    ("gaze_recall_lenient", "gaze, recall, 0.3 s late or early"),
    ("groups_precision", "groups, precision (T = 2/3)"), ("groups_recall", "groups, recall"),
    ("groups_f1", "groups, F1"),
    ("faces_ids", "ids of faces"), ("faces_true", "faces there"), ("faces_missed", "faces missed"),
    ("faces_extra", "faces too many"),
    ("bodies_ids", "ids of bodies"), ("bodies_true", "bodies there"), ("bodies_missed", "bodies missed"),
    ("bodies_extra", "bodies too many"),
    ("voices_ids", "ids of voices"), ("voices_true", "voices there"), ("voices_missed", "voices missed"),
    ("voices_extra", "voices too many"),
    ("sentences_true", "sentences said"), ("sentences_heard", "sentences heard"), ("words_true", "words said"),
    ("words_heard", "words heard"), ("word_errors", "word errors"), ("word_error_rate", "word error rate"),
    ("confidence_out_of_range", "location confidences not in 0..1"),
    ("foreign_frames", "places in frames without a way to the truth's"),
    ("damaged_messages", "messages that could not be read"))


def main(arguments: Optional[List[str]] = None) -> int:
    """Read the command line and print the scores; 0, or 1 for a bag or golden figures that cannot be read, 2 for a
    wrong command line, 3 where the bag scores worse than the golden figures.
    """
    parser = argparse.ArgumentParser(prog="score", description="Scores of the persons, gazes and groups in a bag. With "
                                     "the truth in the bag (rosbag record /scene/truth/... of the scene simulator): "
                                     "errors against it; without: what can be told.")
    parser.add_argument("bag", help="bag with /tf, /tf_static, /humans/persons/..., /humans/interactions/... and the "
                                    "truth")
    parser.add_argument("--truth", default="/scene/truth", help="namespace of the truth (default: %(default)s)")
    parser.add_argument("--distance", type=float, default=0.5,
                        help="a person is found where a place is not farther away, m (default: %(default)s)")
    parser.add_argument("--golden", default="", help="YAML file of figures to compare with: {SECTION: {FIGURE: {value: "
                        "0.9, better: higher|lower|same|told, tolerance: 0.05}}}")
    parser.add_argument("--section", default="", help="section of that file; not needed where it has one only")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")
    options = parser.parse_args(_without_remappings(sys.argv[1:] if arguments is None else arguments))
    if not options.distance > 0.0:
        parser.error("--distance must be above 0")
    try:
        golden = load_golden(options.golden, options.section) if options.golden else []
        figures = score(read_bag(options.bag, options.truth), options.distance)
    except (RecordError, GoldenError) as error:
        print("score: {}".format(error), file=sys.stderr)
        return 1
    outcomes = compare(figures, golden)
    if options.json:
        compared = [{"figure": one.golden.key, "golden": one.golden.value, "now": one.value, "verdict": one.verdict}
                    for one in outcomes]
        print(json.dumps(dict(figures, golden=compared) if golden else figures))
    else:
        print(as_table(figures))
        if golden:
            print("\n" + comparison_table(outcomes))
    return 3 if any(one.failed for one in outcomes) else 0


def as_table(figures: Figures) -> str:
    """Return the figures as lines of text; those that are not known are left out, but for what the truth would tell."""
    lines = ["{:46} {}".format(text, _text(figures[key])) for key, text in _LINES if figures.get(key) is not None]
    for row in figures.get("confidence_errors_m") or ():
        lines.append("{:46} {}".format("confidence {from:g} to {to:g}: median error, m".format(**_mapping(row)),
                                       _text(_mapping(row)["median_error_m"])))
    if not figures["has_truth"]:
        lines.append("The bag holds no truth: no errors, switches or scores.")
    return "\n".join(lines)


def _mapping(row: object) -> Mapping[str, object]:
    return row if isinstance(row, dict) else {}


def _text(value: object) -> str:
    if value is None:
        return "-"
    return "{:.3f}".format(value) if isinstance(value, float) else str(value)


def _without_remappings(arguments: Sequence[str]) -> List[str]:
    """roslaunch hands over __name:=... and the like."""
    return [text for text in arguments if ":=" not in text]
