"""Enrolment from photographs: one person of several pictures, and who is refused."""

import shutil
import struct
import zlib

import cv2
import numpy as np
import pytest

from hri_pipeline.core.onnx import models_directory
from hri_pipeline.core.privacy import StoreError, TemplateCipher, make_key_file
from hri_pipeline.core.recognition.embedding import KINDS
from hri_pipeline.core.recognition.enrolment import EnrolmentError, enrol, photographs, templates_of
from hri_pipeline.core.recognition.store import PersonStore
from hri_pipeline.core.recognition.stored_gallery import open_gallery

PICTURES = models_directory() / "evaluation" / "recognition"
pytestmark = pytest.mark.skipif(not PICTURES.is_dir(), reason="needs fetch_models --models evaluation")


@pytest.fixture
def directory(tmp_path):
    folder = tmp_path / "ada"
    folder.mkdir()
    for name in ("one_2.jpg", "one_3.jpg"):
        shutil.copy(str(PICTURES / name), str(folder))
    return folder


def test_somebody_who_has_agreed_is_known_by_photographs(directory, tmp_path):
    cv2.imwrite(str(directory / "wall.png"), np.full((480, 640, 3), 128, np.uint8))
    cv2.imwrite(str(directory / "burnt.png"), cv2.convertScaleAbs(cv2.imread(str(PICTURES / "one_2.jpg")), alpha=5.0))
    cipher = TemplateCipher(make_key_file(tmp_path / "key"))
    found = templates_of(photographs(directory))
    assert len(found.templates) == 2 and found.left_out == (
        "burnt.png: the face is too small, blurred, dark, overexposed or turned away",
        "wall.png: no faces, one is wanted")
    store = PersonStore(tmp_path / "private" / "people.sqlite", cipher)
    person = enrol(store, "Ada", found, 1000.0)
    record, = store.load_records()
    assert (record.id, record.name, record.enrolled, record.first_seen) == (person, "Ada", True, 1000.0)
    with pytest.raises(EnrolmentError, match="looks the same"):
        enrol(store, "Eve", found, 2000.0)
    other = PersonStore(store.path, cipher)
    with pytest.raises(StoreError, match="in use"):
        enrol(store, "Eve", found, 2000.0)
    other.close()
    store.close()
    # The recogniser knows her by a third picture.
    kind = KINDS[found.model]
    gallery = open_gallery(str(store.path), found.model, kind.dimension, kind.calibration, cipher)
    views = templates_of([PICTURES / "one_1.jpg"])
    assert gallery.match(views.templates[:1], enrolled_only=True)[0].candidates[0].person_id == person
    gallery.close()


def test_pictures_of_two_people_are_refused(directory):
    shutil.copy(str(PICTURES / "other_1.jpg"), str(directory))
    with pytest.raises(EnrolmentError, match="same person"):
        templates_of(photographs(directory))


def test_pictures_of_absurd_sizes_are_left_out(directory):
    for name, shape in (("high.png", (10000, 1, 3)), ("long.png", (1, 10000, 3)), ("one.png", (1, 1, 3))):
        cv2.imwrite(str(directory / name), np.full(shape, 128, np.uint8))
    header = b"IHDR" + struct.pack(">IIBBBBB", 60000, 60000, 8, 2, 0, 0, 0)
    (directory / "vast.png").write_bytes(
        b"\x89PNG\r\n\x1a\n\0\0\0\r" + header + struct.pack(">I", zlib.crc32(header)))
    found = templates_of(photographs(directory))
    assert len(found.templates) == 2 and [text.split(":")[0] for text in found.left_out] == [
        "high.png", "long.png", "one.png", "vast.png"]
    assert found.left_out[3] == "vast.png: no picture, or one too large"


def test_a_directory_without_pictures_is_told(tmp_path):
    with pytest.raises(EnrolmentError, match="no photographs"):
        photographs(tmp_path)
