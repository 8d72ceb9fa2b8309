"""Films of people who walk past each other, made of people cut out of the demonstration photographs."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np

from hri_pipeline.core.onnx import models_directory

WIDTH, HEIGHT = 1280, 720
# Name: number of the photograph, the box around the person in parts of its width and height, how far the hues of the
# clothes are turned (of 180), and whether it is mirrored.
_GREEN, _BURGUNDY = (6, (0.07, 0.235, 0.345, 0.99)), (6, (0.315, 0.13, 0.555, 0.99))
PEOPLE = {"green": _GREEN + (0, False), "burgundy": _BURGUNDY + (0, False), "blue": _BURGUNDY + (120, True),
          "twin": _GREEN + (0, True)}
_SMALL = 320


def photograph(number):
    """Return sample<number>.jpg of the demonstration pictures."""
    folder = Path(os.environ.get("ROS4HRI_DEMO", str(models_directory() / "demo")))
    image = cv2.imread(str(folder / "sample{}.jpg".format(number)))
    assert image is not None, "no sample{}.jpg in {}: run `rosrun hri_pipeline fetch_models`".format(number, folder)
    return image


def cut_out(name, tall):
    """Return BGR and coverage (0 to 1) of a person, `tall` px high."""
    number, (left, top, right, bottom), turn, mirrored = PEOPLE[name]
    image = photograph(number)
    small = cv2.resize(image, (_SMALL, _SMALL * image.shape[0] // image.shape[1]), interpolation=cv2.INTER_AREA)
    height, width = small.shape[:2]
    x, y = int(left * width), int(top * height)
    box = (x, y, int(right * width) - x, int(bottom * height) - y)
    labels = np.zeros((height, width), np.uint8)
    cv2.setRNGSeed(1)
    cv2.grabCut(small, labels, box, np.zeros((1, 65)), np.zeros((1, 65)), 4, cv2.GC_INIT_WITH_RECT)
    cover = ((labels == cv2.GC_FGD) | (labels == cv2.GC_PR_FGD)).astype(np.float32)
    scale = tall / (image.shape[0] * (bottom - top))
    size = (int(image.shape[1] * scale), int(image.shape[0] * scale))
    colours = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    cover = cv2.GaussianBlur(cv2.resize(cover, size, interpolation=cv2.INTER_LINEAR), (5, 5), 0)
    rows = slice(int(top * size[1]), int(bottom * size[1]))
    columns = slice(int(left * size[0]), int(right * size[0]))
    colours, cover = dressed(colours[rows, columns], turn), cover[rows, columns]
    return (colours[:, ::-1], cover[:, ::-1]) if mirrored else (colours, cover)


def dressed(colours, turn):
    """Return a picture of a person in clothes of another hue: everything below the head."""
    changed = colours.copy()
    below = changed[int(0.42 * len(changed)):]
    hsv = cv2.cvtColor(below, cv2.COLOR_BGR2HSV)
    hsv[..., 0] = (hsv[..., 0].astype(np.int16) + turn) % 180
    below[:] = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)
    return changed


def background():
    """Return an image (720, 1280, 3) without people: the blurred wall of a photograph."""
    wall = cv2.resize(photograph(4)[:80, :, :], (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    return cv2.GaussianBlur(wall, (0, 0), 25)


def paint(image, person, x):
    """Put a cut-out person into the image: middle at column x, feet (or what is left of them) at the lower edge."""
    colours, cover = person
    height, width = cover.shape
    left, top = int(round(x - width / 2.0)), HEIGHT - height
    first, last = max(0, left), min(WIDTH, left + width)
    if first >= last:
        return
    part = slice(first - left, last - left)
    weight = cover[:, part, None]
    region = image[top:, first:last]
    region[:] = (weight * colours[:, part] + (1.0 - weight) * region).astype(np.uint8)


def film(names, tracks, rate, heights):
    """Yield stamp, image and {name: column}; later names stand in front.

    tracks: for each name a function of the time (s) that gives its column (px), None when it is away.
    """
    people = [cut_out(name, tall) for name, tall in zip(names, heights)]
    wall = background()
    index = 0
    while True:
        stamp = index / rate
        places = {name: track(stamp) for name, track in zip(names, tracks)}
        image = wall.copy()
        for name, person in zip(names, people):
            if places[name] is not None:
                paint(image, person, places[name])
        yield stamp, image, places
        index += 1
