"""`scripts/benchmark pipeline`: images of 1, 3 and 10 people through the whole stack and real ROS topics, measured from
outside."""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Dict, List, Mapping, Optional, Sequence

from benchmarks.report import machine, models_directory
from benchmarks.start import Start, first_run, second_run

if TYPE_CHECKING:
    import numpy as np

    from benchmarks.stack_run import StackRun

PATIENCE_S = 60.0
SPEECH = Path("/usr/share/pocketsphinx/test/data/cards")
_NOT_ASKED = "not asked for (--start)"
FACE_NETWORK, BODY_NETWORK = "face_landmarks_attention", "pose_landmarks"
"""Beginnings of the names of the networks that look at one face or body."""
NOT_STACK = ("benchmark_probe", "image_source", "moving_people", "load")
ERRORS = {"landmark": "landmark_error", "landmark_px": "landmark_error_px",
          "face_direction": "face_direction_error_deg", "skeleton": "skeleton_error"}
"""What the probe measures, and the keys of its median in JSON; `moving_` before them is that while people move."""
GPU_PEOPLE = 10
NO_GPU = "not measured: the networks of {} ran on {}"
NO_GPU_SCENE = "not measured: no scene of {} people, or not both faces and bodies were seen".format(GPU_PEOPLE)
LOAD = "while True: pass"
LOADED_PEOPLE = 3
LAUNCH = """<launch>
  <arg name="sound" default=""/>
  <arg name="speech_grammar" default=""/>
  <arg name="providers"/>
  <arg name="one_process"/>
  <node name="base_in_map" pkg="tf2_ros" type="static_transform_publisher" args="0 0 0 0 0 0 1 map base_link"/>
  <node name="camera_in_map" pkg="tf2_ros" type="static_transform_publisher"
        args="0 0 1.5 -0.5 0.5 -0.5 0.5 map camera_color_optical_frame"/>
  <node name="microphone_in_map" pkg="tf2_ros" type="static_transform_publisher"
        args="0 0 1.5 0 0 0 1 map microphone" if="$(eval sound != '')"/>
  <include file="$(find hri_pipeline)/launch/sound_source.launch" if="$(eval sound != '')">
    <arg name="source" value="$(arg sound)"/>
    <arg name="audio" value="/audio"/>
    <arg name="audio_info" value="/audio_info"/>
    <arg name="loop" value="true"/>
  </include>
  <include file="$(find ros4hri)/launch/ros4hri.launch" pass_all_args="true">
    <arg name="image" value="/camera/image_raw"/>
    <arg name="camera_info" value="/camera/camera_info"/>
    <arg name="voices" value="$(eval sound != '')"/>
    <arg name="microphone_frame" value="microphone"/>
    <arg name="overlay" value="false"/>
  </include>
</launch>
"""
"""The stack without a source of images: that of `moving_people` takes its place."""


def register(commands: argparse._SubParsersAction) -> None:
    """Add the command line of this benchmark."""
    parser = commands.add_parser("pipeline", help="frames per second, age, stages and processor of the whole stack")
    parser.add_argument("--people", type=_numbers, default="1,3,10", help="numbers of people, of 1, 3 and 10 (default: "
                                                                          "1,3,10)")
    parser.add_argument("--seconds", type=_above_0, default=20.0, help="time of measuring per number (default: 20)")
    parser.add_argument("--moving-seconds", type=_above_0, default=10.0, help="time for which the error of what is "
                        "published is measured, and as long again while heads turn and arms swing (default: 10)")
    parser.add_argument("--rate", type=_above_0, default=30.0, help="images per second of the source (default: 30)")
    parser.add_argument("--one-process", action="store_true", help="faces and bodies in one process")
    parser.add_argument("--providers", default="cpu", help="execution providers in order of preference")
    parser.add_argument("--silent", action="store_true", help="without the sound of people who speak")
    parser.add_argument("--start", nargs="?", const="both", default="", choices=("both", "first", "second"),
                        help="measure too how long scripts/demo takes to show somebody: in the first run, with nothing "
                             "set up but the system's packages (needs the network), and in the second")
    parser.add_argument("--json", action="store_true", help="one JSON object on standard output")


def _numbers(text: str) -> List[int]:
    """Numbers of people that there are scenes of."""
    try:
        people = [int(number) for number in text.split(",")]
    except ValueError:
        raise argparse.ArgumentTypeError("{!r} is no list of numbers".format(text)) from None
    if not set(people) <= {1, 3, 10}:
        raise argparse.ArgumentTypeError("there are scenes of 1, 3 and 10 people")
    return people


def _above_0(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not value > 0.0:
        raise argparse.ArgumentTypeError("{!r} is no number above 0".format(text))
    return value


def run(options: argparse.Namespace) -> int:
    """Measure every scene and print the figures; 1 when something could not be measured."""
    import cv2
    import numpy as np

    from benchmarks.moving_people import make_reference
    from benchmarks.scenes import HEIGHT, WIDTH, make_scene
    from benchmarks.stack_run import StackRun, StackRunError

    models = models_directory()
    before, rows = machine(), []
    speech = not options.silent and SPEECH.is_dir()
    arguments = ["providers:=[{}]".format(options.providers),
                 "one_process:={}".format("true" if options.one_process else "false")]
    if speech:
        arguments += ["sound:={}".format(SPEECH), "speech_grammar:={}".format(SPEECH / "cards.gram")]
    logs = Path(tempfile.mkdtemp(prefix="ros4hri-benchmark-"))
    try:
        for people in options.people:
            picture = make_scene(people, models / "demo")
            cv2.imwrite(str(logs / "{}.png".format(people)), picture)
            np.savez(str(logs / "{}.npz".format(people)), **make_reference(picture, people))
            print("{} people: starting the stack, then measuring for {:g} s ...".format(
                people, options.seconds + 2.0 * options.moving_seconds), file=sys.stderr, flush=True)
            with StackRun(logs) as stack:
                rows.append(figures(people, measure(stack, people, arguments, options)))
    except (StackRunError, OSError, ValueError) as error:
        print("scripts/benchmark: {}".format(error), file=sys.stderr)
        return 1
    shutil.rmtree(str(logs), ignore_errors=True)
    described = {"images": "{}x{}".format(WIDTH, HEIGHT), "rate": "{:g} Hz".format(options.rate),
                 "scene": "demo photographs, slow pan", "processes": 1 if options.one_process else 2,
                 "sound": "spoken commands, recognised" if speech else "none", "providers": options.providers,
                 "seconds": options.seconds}
    starts = {name: measured() for name,
              measured in (("first", first_run), ("second", second_run)) if options.start in (name, "both")}
    if options.json:
        print(json.dumps(as_json(rows, before, described, starts)))
    else:
        print(as_table(rows, before, described))
        print(starts_as_text(starts))
    return 0


def measure(stack: StackRun, people: int, arguments: Sequence[str], options: argparse.Namespace) -> dict:
    """Start the stack and the people of a scene, whose picture and reference lie in the stack's folder, and watch.

    arguments: of ros4hri.launch. Returns what the probe saw, the use of the processor (% of one core) and the memory
    (MB) by name of process. Raises StackRunError when the stack or the probe ends too soon.
    """
    from benchmarks.stack_run import StackRunError
    stack.start_master()
    launch_file = stack.folder / "pipeline.launch"
    launch_file.write_text(LAUNCH, encoding="utf-8")
    started = time.time()
    launch = stack.start("roslaunch", ["roslaunch", str(launch_file), *arguments])
    scene, reference = (str(stack.folder / "{}.{}".format(people, kind)) for kind in ("png", "npz"))
    stack.start("moving_people", [sys.executable, "-m", "benchmarks.moving_people", scene, reference, str(options.rate),
                                  "__name:=moving_people"])
    result = stack.folder / "probe.json"
    loaded_s = options.moving_seconds if people == LOADED_PEOPLE else 0.0
    probe = stack.start("probe", [sys.executable, "-m", "benchmarks.pipeline_probe", str(people), str(options.seconds),
                                  str(PATIENCE_S), str(options.moving_seconds), str(loaded_s), scene, reference,
                                  str(result), "__name:=benchmark_probe"], subprocess.PIPE)
    assert probe.stdout is not None

    def expect(line: bytes) -> None:
        if probe.stdout.readline() != line or launch.poll() is not None:
            raise StackRunError("the stack or the probe has ended; logs: {}".format(stack.folder))

    expect(b"begin\n")
    (before, _), began = stack.usage_by_name(), time.monotonic()
    expect(b"end\n")
    (after, memory), passed = stack.usage_by_name(), time.monotonic() - began
    if loaded_s:
        expect(b"load\n")
        load = stack.start("load", [sys.executable, "-c", LOAD, "__name:=load"])
        expect(b"loaded\n")
        load.kill()
    probe.wait(timeout=60.0 + 4.0 * options.moving_seconds)
    seen = dict(json.loads(result.read_text(encoding="utf-8")), started=started)
    seen["cpu_percent"] = {name: round(100.0 * (used - before.get(name, 0.0)) / passed, 1)
                           for name, used in sorted(after.items(), key=lambda item: -item[1])}
    seen["rss_mb"] = {name: round(memory[name], 1) for name in seen["cpu_percent"]}
    return seen


def figures(people: int, seen: dict) -> dict:
    """Return the figures of one scene.

    A rate is the number of different image stamps per second at the frame of a person (face, body), averaged
    over the people of the scene; one who is not found counts with 0, one too many does not count.
    Persons who are only a voice are persons by the specification; they are counted apart from those who are seen.
    Inferences are runs of a network on one face or body, per person and second: between two of them a face is moved on
    by optical flow only.
    """
    import numpy as np

    looked = {network: round(sum(hz for name, hz in seen.get("inferences_hz", {}).items()
                                 if name.startswith(network)) / people, 2)
              for network in (FACE_NETWORK, BODY_NETWORK)}
    rates = {kind: round(sum(found[:people]) / people, 2) for kind, found in seen["rates"].items()}
    middle, high = _middle_and_high(1e3 * np.array(seen["ages"] or [np.nan]), 1)
    cpu: Dict[str, float] = seen["cpu_percent"]
    return {
        "people": people, "fps": rates["person"], "faces_fps": rates["face"], "bodies_fps": rates["body"],
        "face_inferences": looked[FACE_NETWORK], "body_inferences": looked[BODY_NETWORK],
        "found": {kind: seen["tracked"].get(kind, 0) for kind in ("persons", "faces", "bodies", "voices alone")},
        "age_p50_ms": middle, "age_p95_ms": high,
        "cpu_percent": round(sum(value for name, value in cpu.items() if name not in NOT_STACK), 1),
        "cpu_percent_by_process": cpu, "rss_mb_by_process": seen.get("rss_mb", {}),
        "rss_mb": round(sum(value for name, value in seen.get("rss_mb", {}).items() if name not in NOT_STACK), 1),
        "stages_ms": seen["stages_ms"], "seconds": round(seen["seconds"], 2), "gpu": gpu(seen),
        "errors": {prefix + key + ending: value for prefix, found in seen.get("errors", {}).items()
                   for name, key in ERRORS.items()
                   for ending, value in zip(("", "_p95"), _middle_and_high(np.array(found[name] or [np.nan]), 4))},
        "loaded": loaded(seen["loaded"]) if "loaded" in seen else None}


def loaded(seen: dict) -> dict:
    """Return age (ms) and people found while something else used a whole core; seen: as of the probe."""
    import numpy as np
    return {"age_p95_ms": _middle_and_high(1e3 * np.array(seen["ages"] or [np.nan]), 1)[1], "found": seen["found"]}


def gpu(seen: dict) -> dict:
    """Return how long an image takes on a card, the longest stall and the start; None, with the reason, without a card.

    An image: the medians of the nodes' times per image, together. A stall: time between two images with faces, or
    bodies, since the first of them. The start: from roslaunch until both faces and bodies are there.
    """
    stages, began = seen.get("stages_ms", {}), seen.get("began", {})
    nodes = sorted(node for node, used in seen.get("networks", {}).items() if "frame" in stages.get(node, {}))
    elsewhere = [NO_GPU.format(node, seen["networks"][node].split(":")[0]) for node in nodes
                 if not {"cuda", "tensorrt"} & {part.split(":")[0] for part in seen["networks"][node].split("; ")}]
    if elsewhere or not nodes or not {"face", "body"} <= set(began):
        return {"ms_per_image": None, "stall_s": None, "start_s": None,
                "reason": "; ".join(elsewhere) or NO_GPU_SCENE}
    return {"ms_per_image": round(sum(stages[node]["frame"]["median"] for node in nodes), 1),
            "stall_s": round(max(seen["stall_s"].values()), 3),
            "start_s": round(max(began["face"], began["body"]) - seen["started"], 1)}


def _middle_and_high(values: np.ndarray, digits: int) -> List[Optional[float]]:
    """Median and 95th percentile, None where there are no numbers."""
    import numpy as np
    return [None if np.isnan(value) else round(float(value), digits) for value in np.percentile(values, [50, 95])]


def as_json(rows: Sequence[dict], before: dict, described: dict, starts: Optional[Mapping[str, Start]] = None) -> dict:
    """Return the JSON object of all scenes; starts: what was measured of the "first" and "second" run of
    scripts/demo."""
    result: dict = {"machine": before, "input": described, "stages_ms": {}, "scenes": list(rows), "reasons": {}}
    for name in ("first", "second"):
        start = (starts or {}).get(name, Start(None, _NOT_ASKED))
        result[name + "_run_s"] = None if start.seconds is None else round(start.seconds, 1)
        result[name + "_run"] = {"steps_s": start.steps, "fresh": start.fresh, "not_fresh": start.not_fresh}
        if start.seconds is None:
            result["reasons"][name + "_run_s"] = start.why_not
    for row in rows:
        number = row["people"]
        for key in ("fps", "faces_fps", "bodies_fps", "face_inferences", "body_inferences", "age_p50_ms", "age_p95_ms",
                    "cpu_percent", "rss_mb"):
            result["{}_{}".format(key, number)] = row[key]
        for key in ("cpu_percent_by_process", "rss_mb_by_process"):
            result["{}_{}".format(key, number)] = row[key]
        result.update({"{}_{}{}".format(key[:-4], number, "_p95") if key.endswith("_p95") else
                       "{}_{}".format(key, number): value for key, value in row["errors"].items()})
        result["stages_ms"][str(number)] = row["stages_ms"]
        if row["loaded"] is not None:
            result["loaded"] = {"{}_{}".format(key, number): value for key, value in row["loaded"].items()}
    card = next((dict(row["gpu"]) for row in rows if row["people"] == GPU_PEOPLE),
                {"ms_per_image": None, "stall_s": None, "start_s": None, "reason": NO_GPU_SCENE})
    result["gpu"] = dict({"ms_per_image_{}".format(GPU_PEOPLE): card.pop("ms_per_image")}, **card)
    return result


def starts_as_text(starts: Mapping[str, Start]) -> str:
    """Return the times from scripts/demo to the first person, for a person to read."""
    lines = [""] + ["from scripts/demo to the first person: not measured; --start does"] * (not starts)
    for name, start in starts.items():
        lines.append("{} run, from scripts/demo to the first person: {}".format(
            name, start.why_not if start.seconds is None else "{:.1f} s".format(start.seconds)))
        lines += ["  {:35s} {:7.1f} s".format(title, seconds) for title, seconds in start.steps.items()]
        lines += ["  {}: {}".format(title, ", ".join(things)) for title,
                  things in (("set up anew", start.fresh), ("there before", start.not_fresh)) if things]
    return "\n".join(lines)


def as_table(rows: Sequence[dict], before: dict, described: dict) -> str:
    """Return the same for a person to read."""
    lines: List[str] = [
        "Machine   {cpu}, {cores} cores, {system}".format(**before),
        "Load      {} before the start".format(" ".join(str(load) for load in before["load_average"])),
        "Versions  " + ", ".join("{} {}".format(*item) for item in before["versions"].items()),
        "Input     " + ", ".join("{} {}".format(*item) for item in described.items()), "",
        "people  persons/s  faces/s  bodies/s  inferences per face, body  found p/f/b/v  age p50   age p95  processor"]
    for row in rows:
        lines.append("{people:6d} {fps:10.1f} {faces_fps:8.1f} {bodies_fps:9.1f} "
                     "{face_inferences:16.1f} {body_inferences:6.1f}  {found:>11}  {p50:>8}  {p95:>8}  "
                     "{cpu_percent:6.0f} %".format(**dict(
                         row, found="{persons}/{faces}/{bodies}/{voices alone}".format(**row["found"]),
                         p50=_ms(row["age_p50_ms"]), p95=_ms(row["age_p95_ms"]))))
    for row in rows:
        lines += ["", "{} people: error of what is published           median     p95".format(row["people"])]
        lines += ["  {:42s} {:>9} {:>7}".format(key, *("-" if value is None else value for value in (
            row["errors"][key], row["errors"][key + "_p95"]))) for key in row["errors"] if not key.endswith("_p95")]
        if row["loaded"] is not None:
            lines.append("  beside a load of one core: {found} found, age p95 {age}".format(
                found=row["loaded"]["found"], age=_ms(row["loaded"]["age_p95_ms"])))
        if row["gpu"]["ms_per_image"] is not None:
            lines.append("  on a card: {ms_per_image} ms per image of faces and bodies, longest stall {stall_s} s, "
                         "start {start_s} s".format(**row["gpu"]))
    for row in rows:
        lines += ["", "{} people: processor, % of one core; memory, MB".format(row["people"])]
        lines += ["  {:28s} {:6.1f} {:7.0f}".format(name, value, row["rss_mb_by_process"].get(name, 0.0))
                  for name, value in row["cpu_percent_by_process"].items() if value >= 0.1]
        lines += ["{} people: ms per stage                 median     p95".format(row["people"])]
        lines += ["  {:35s} {:7.1f} {:7.1f}".format(node + " " + stage, times.get("median", 0.0), times.get("p95", 0.0))
                  for node, stages in sorted(row["stages_ms"].items()) for stage, times in stages.items()]
    return "\n".join(lines)


def _ms(value: object) -> str:
    return "-" if value is None else "{:.0f} ms".format(value)
