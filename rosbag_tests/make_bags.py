#!/usr/bin/env python3
"""Makes the bags of these tests, without ROS: `make_bags.py DIRECTORY [scene] [jumps] [pictures] [sound]`; all without
a name.

scene: three people of the scene simulator, 26 s; jumps: ten seconds of three who stand. pictures: photographs of the
models' directory, as a slowly panned camera. sound: sentences of Debian's pocketsphinx-testdata. What is missing for
one is told in a line, and the others are made.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Callable, Dict, List

import cv2
import numpy as np

from hri_pipeline.core.camera import CameraModel
from hri_pipeline.core.onnx import models_directory
from hri_pipeline.core.simulation.scene_file import load_scene
from hri_pipeline.core.sources.image_sources import PictureMotion
from hri_pipeline.score.bag import BagWriter

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / "scripts"), str(ROOT / "hri_pipeline/test/unit")]

from scene_bag import BASE, write_scene  # noqa: E402

from benchmarks.speech_files import read_speech  # noqa: E402

SCENE = Path(__file__).resolve().parent / "three_meet.yaml"
STANDING = SCENE.with_name("three_stand.yaml")
STANDING_S = 10.0
PHOTOGRAPHS = {1: (3, 3), 4: (4, 3)}
"""Faces, and bodies of which enough is seen, counted by eye, of sample<number>.jpg."""
PICTURE_RATE, PICTURE_S = 6.0, 9.0  # Hz, s of each photograph
SIZE, FIELD_OF_VIEW = (1280, 720), 1.0472
SENTENCES = (("goforward.raw", "go forward ten meters"), ("tidigits/dhd.2934z.raw", "two nine three four zero"),
             ("goforward.raw", "go forward ten meters"))
RATE, BLOCK, PAUSE_S = 16000, 320, 2.5   # Hz, samples of a message, s before each sentence and after the last
HISS = 3e-4                         # standard deviation of the noise of the microphone, of full scale 1


def scene_bag(path: Path) -> None:
    """Write the whole scene."""
    write_scene(path, load_scene(SCENE))


def jumps_bag(path: Path) -> None:
    """Write three people who stand before the robot."""
    write_scene(path, load_scene(STANDING), 0.0, STANDING_S)


def pictures_bag(path: Path) -> None:
    """Write compressed images and camera_info, and how many there are to be found.

    Raises FileNotFoundError with the mend.
    """
    matrix = CameraModel.from_fov(*SIZE, FIELD_OF_VIEW).matrix
    with BagWriter(path) as bag:
        for order, (number, (faces, bodies)) in enumerate(PHOTOGRAPHS.items()):
            source = models_directory() / "demo" / "sample{}.jpg".format(number)
            picture = cv2.imread(str(source))
            if picture is None:
                raise FileNotFoundError("{} is missing; fetch it: rosrun hri_pipeline fetch_models".format(source))
            motion = PictureMotion(picture, *SIZE)
            for image in range(int(PICTURE_S * PICTURE_RATE)):
                stamp = BASE + order * PICTURE_S + image / PICTURE_RATE
                _picture(bag, motion.view(image / PICTURE_RATE), matrix, stamp)
                bag.ids("/scene/truth/faces", ["{}_{}".format(number, face) for face in range(faces)], stamp)
                bag.ids("/scene/truth/bodies", ["{}_{}".format(number, body) for body in range(bodies)], stamp)


def sound_bag(path: Path) -> None:
    """Write sentences with pauses as AudioData of 16 bit, AudioInfo, and the words.

    Raises FileNotFoundError with the mend.
    """
    recordings = read_speech(sorted({name for name, _ in SENTENCES}))
    quiet = np.zeros(int(PAUSE_S * RATE))
    parts = [quiet]
    for name, _ in SENTENCES:
        parts += [recordings[name], quiet]
    sound = np.concatenate(parts) + np.random.default_rng(3).normal(0.0, HISS, sum(map(len, parts)))
    samples = np.clip(np.round(32767.0 * sound), -32768, 32767).astype("<i2")
    with BagWriter(path) as bag:
        name = "audio_common_msgs/msg/AudioInfo"
        bag.write("/microphone/audio_info", name, bag.make(name, 1, RATE, "S16LE", 16 * RATE, "wave"), BASE,
                  latched=True)
        for _, words in SENTENCES:
            bag.text("/scene/truth/words", words, BASE)
        name = "audio_common_msgs/msg/AudioData"
        for begin in range(0, len(samples) - BLOCK + 1, BLOCK):
            data = np.frombuffer(samples[begin:begin + BLOCK].tobytes(), np.uint8)
            bag.write("/microphone/audio", name, bag.make(name, data), BASE + (begin + BLOCK) / RATE)


BAGS: Dict[str, Callable[[Path], None]] = {"scene": scene_bag, "jumps": jumps_bag, "pictures": pictures_bag,
                                           "sound": sound_bag}


def _picture(bag: BagWriter, image: np.ndarray, matrix: np.ndarray, stamp: float) -> None:
    header = bag.header(stamp, "camera_optical")
    name = "sensor_msgs/msg/CameraInfo"
    roi = bag.make("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
    projection = np.hstack([matrix, np.zeros((3, 1))]).ravel()
    bag.write("/camera/camera_info", name,
              bag.make(name, header, SIZE[1], SIZE[0], "plumb_bob", np.zeros(5), matrix.ravel(),
                       np.eye(3).ravel(), projection, 0, 0, roi), stamp)
    name = "sensor_msgs/msg/CompressedImage"
    _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92])
    bag.write("/camera/image_raw/compressed", name, bag.make(name, header, "bgr8; jpeg compressed bgr8", data.ravel()),
              stamp)


def main(arguments: List[str]) -> int:
    """Make the bags; 1 when one could not be made, 2 for a wrong command line."""
    names = arguments[1:] or list(BAGS)
    if not arguments or set(names) - set(BAGS):
        print(__doc__, file=sys.stderr)
        return 2
    directory, code = Path(arguments[0]).expanduser(), 0
    directory.mkdir(parents=True, exist_ok=True)
    for name in names:
        path = directory / (name + ".bag")
        try:
            path.unlink(missing_ok=True)
            BAGS[name](path)
            print("{}: {:.1f} MB".format(path, path.stat().st_size / 1e6))
        except FileNotFoundError as error:
            path.unlink(missing_ok=True)
            print("{}: not made: {}".format(path, error), file=sys.stderr)
            code = 1
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
