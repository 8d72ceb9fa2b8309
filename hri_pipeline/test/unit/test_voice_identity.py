"""Whose voice it is: what is told, withdrawn, kept and forgotten. The network is stood in for by the mean of a sound,
which is an angle."""

import numpy as np
import pytest

from hri_pipeline.core.audio.identity import (
    CALIBRATION,
    HOP_S,
    LEAST_PRODUCT,
    LEAST_WINDOWS,
    LIKELIHOOD,
    MODEL,
    WINDOW_S,
    VoiceIdentity,
    VoicePerson,
)
from hri_pipeline.core.recognition.gallery import GalleryError, MemoryGallery, StoredGallery
from hri_pipeline.core.recognition.store import KnownPerson, PersonStore

RATE = 16000
ENOUGH = WINDOW_S + (LEAST_WINDOWS - 1) * HOP_S


class AngleIsSpeaker:
    def embed(self, sounds):
        angles = sounds.mean(axis=1)
        return np.stack([np.cos(angles), np.sin(angles)], axis=1).astype(np.float32)


def make(gallery=None):
    return VoiceIdentity(AngleIsSpeaker(), MemoryGallery(MODEL, 2, CALIBRATION) if gallery is None else gallery)


def say(identity, voice, angle, seconds=ENOUGH):
    """Speak in frames of 32 ms."""
    for _ in range(int(round(seconds * RATE / 512.0))):
        identity.add(voice, np.full(512, angle, np.float32))
    return identity.changes()


def known(*people):
    """An identity that knows people {name: angle}."""
    identity = make()
    for name, angle in people:
        say(identity, "voice_" + name, angle)
        identity.enrol("voice_" + name, name)
    identity.retain(())
    identity.changes()
    return identity


NEAR, FAR = np.arccos(LEAST_PRODUCT + 0.02), np.arccos(LEAST_PRODUCT - 0.02)


def test_who_was_enrolled_is_told_and_nobody_else():
    identity = known(("anna", 0.0))
    assert say(identity, "first", NEAR) == [VoicePerson("first", "anna", LIKELIHOOD)]
    assert say(identity, "second", FAR) == []
    assert identity.current() == [VoicePerson("first", "anna", LIKELIHOOD)]


def test_nothing_is_told_of_little_speech():
    identity = known(("anna", 0.0))
    assert say(identity, "first", 0.0, ENOUGH - 0.1) == []
    assert say(identity, "first", 0.0, 0.2) != []


def test_nothing_is_told_between_two_people_who_are_alike():
    identity = known(("anna", 0.0), ("berta", 0.4))
    assert say(identity, "first", 0.2) == []
    assert say(identity, "second", -0.1) == [VoicePerson("second", "anna", LIKELIHOOD)]


def test_what_was_told_is_withdrawn_when_the_voice_becomes_another():
    identity = known(("anna", 0.0))
    say(identity, "first", 0.0)
    assert say(identity, "first", 1.5, 20.0) == [VoicePerson("first", "anna", 0.0)]


def test_a_voice_alone_makes_nobody_known():
    identity = make()
    say(identity, "first", 0.0)
    with pytest.raises(GalleryError, match="by face"):
        identity.enrol("first", "")
    with pytest.raises(GalleryError, match="not tracked"):
        identity.enrol("second", "anna")
    say(identity, "third", 0.0, ENOUGH - 0.1)
    with pytest.raises(GalleryError, match="has not spoken"):
        identity.enrol("third", "anna")
    assert identity.list_known() == []


def test_forgetting_withdraws_and_forgets():
    identity = known(("anna", 0.0), ("berta", 1.5))
    say(identity, "first", 0.0)
    assert identity.forget("anna") and not identity.forget("anna")
    assert identity.changes() == [VoicePerson("first", "anna", 0.0)]
    assert say(identity, "second", 0.0) == [] and identity.list_known() == ["berta"]
    with pytest.raises(GalleryError):
        identity.export("anna")
    identity.forget_all()
    assert identity.list_known() == []


def test_the_store_keeps_voices_beside_faces_and_forgets_both(tmp_path):
    """Another process forgets the person: the voice is gone here, and nothing of it is left in the file."""
    path, face = tmp_path / "people.sqlite", np.eye(4, dtype=np.float32)[:1]
    path.parent.chmod(0o700)
    faces = PersonStore(path)
    faces.put_templates(KnownPerson("anna", face, True), "face", 1000.0)
    identity = make(StoredGallery(PersonStore(path), MODEL, 2, CALIBRATION))
    say(identity, "first", 0.3)
    identity.enrol("first", "anna")
    identity.flush()
    assert len(faces.load_templates("face", 4)) == len(faces.load_templates(MODEL, 2)) == 1
    again = make(StoredGallery(PersonStore(path), MODEL, 2, CALIBRATION))
    assert say(again, "second", 0.3) == [VoicePerson("second", "anna", LIKELIHOOD)]
    template = identity.export("anna").templates.astype("<f4").tobytes()
    faces.remove_record("anna")
    identity.flush()
    again.flush()
    assert identity.list_known() == again.list_known() == []
    assert say(again, "third", 0.3) == []
    again.close()
    identity.close()
    faces.close()
    assert all(template not in file.read_bytes() for file in tmp_path.iterdir())
