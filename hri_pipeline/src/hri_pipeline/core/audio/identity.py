"""Whose voice this is: compared with the voices of people who have agreed (`VoiceIdentity`).

The mean embedding (core/audio/speakers.py) of at least 3.2 s of speech is compared with the templates of everybody who
is enrolled. Products of embeddings depend on the length of the sound and on the room, and speakers who are alike come
near to one speaker in two rooms: only a match with a product above LEAST_PRODUCT is published. The threshold was
chosen on the tuning speakers of scripts/benchmarks/voice_identity.py, so that strangers get no match.
"""

from __future__ import annotations

import threading
from typing import Dict, Iterable, List, NamedTuple

import numpy as np

from hri_pipeline.core.audio.speakers import SpeakerEmbedder
from hri_pipeline.core.audio.stream import RATE
from hri_pipeline.core.recognition.gallery import GalleryError, MemoryGallery
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
from hri_pipeline.core.recognition.store import KnownPerson

MODEL = "speaker_embedding"
"""Name under which the templates stand in the store of people."""
CALIBRATION = TemplateCalibration(midpoint=0.566, fair_midpoint=0.85, scale=0.03, near=0.316)
"""Of the gallery: it keeps templates of products between 0.64 and 0.95 beside each other. Its likelihoods are not
used."""
LEAST_PRODUCT, LEAST_MARGIN = 0.84, 0.05
"""Least product of a voice with a template, and how far the next person must be below it."""
KEEP_PRODUCT = 0.78
"""A voice that was told is withdrawn below it."""
LIKELIHOOD = 0.95
WINDOW_S, HOP_S = 1.6, 0.8
LEAST_WINDOWS, MOST_WINDOWS = 3, 20


class VoicePerson(NamedTuple):
    """The voice is of the person with this likelihood; 0: no longer."""

    voice_id: str
    person_id: str
    likelihood: float


class _Voice:
    """Speech (n,) that was not embedded yet, embeddings so far, and who was told."""

    def __init__(self) -> None:
        self.speech = np.zeros(0, np.float32)
        self.embeddings: List[np.ndarray] = []
        self.told = ""

    def mean(self) -> np.ndarray:
        """Return the mean embedding, a unit vector."""
        mean = np.mean(self.embeddings, axis=0)
        return np.asarray(mean / np.linalg.norm(mean), np.float32)


class VoiceIdentity:
    """Compares voices with enrolled people. Safe from several threads; no method but flush() and close() waits for a
    disk.

    Parameters
    ----------
    embedder : SpeakerEmbedder
    gallery : MemoryGallery
        Of MODEL, DIMENSION and CALIBRATION; close() closes it.
    """

    def __init__(self, embedder: SpeakerEmbedder, gallery: MemoryGallery) -> None:
        self._embedder = embedder
        self._gallery = gallery
        self._lock = threading.RLock()
        self._voices: Dict[str, _Voice] = {}
        self._changes: List[VoicePerson] = []
        self.flush, self.close = gallery.flush, gallery.close

    def add(self, voice_id: str, samples: np.ndarray) -> None:
        """Add speech (n,) of a voice, -1 to 1 at 16 kHz, without its pauses."""
        with self._lock:
            voice = self._voices.setdefault(voice_id, _Voice())
            voice.speech = np.concatenate([voice.speech, samples])
            window, hop = int(WINDOW_S * RATE), int(HOP_S * RATE)
            fresh = False
            while len(voice.speech) >= window:
                voice.embeddings = voice.embeddings[1 - MOST_WINDOWS:] + [
                    self._embedder.embed(voice.speech[None, :window])[0]]
                voice.speech, fresh = voice.speech[hop:], True
            if fresh and len(voice.embeddings) >= LEAST_WINDOWS:
                self._compare(voice_id, voice)

    def retain(self, voice_ids: Iterable[str]) -> None:
        """Forget all other voices; matches with them stay as they are."""
        with self._lock:
            kept = set(voice_ids)
            self._voices = {name: voice for name, voice in self._voices.items() if name in kept}

    def changes(self) -> List[VoicePerson]:
        """Return the matches that are new or withdrawn since the last call."""
        with self._lock:
            changes, self._changes = self._changes, []
            return changes

    def current(self) -> List[VoicePerson]:
        """Return all matches of voices that are tracked."""
        with self._lock:
            return [VoicePerson(name, voice.told, LIKELIHOOD) for name, voice in self._voices.items() if voice.told]

    def _compare(self, voice_id: str, voice: _Voice) -> None:
        near = [(1.0 - 0.5 * one.distance ** 2, one.person_id)
                for one in self._gallery.match(voice.mean()[None], most=2, enrolled_only=True)[0].candidates]
        product, person = near[0] if near else (0.0, "")
        margin = product - (near[1][0] if len(near) > 1 else 0.0)
        if person and product >= (KEEP_PRODUCT if person == voice.told else LEAST_PRODUCT) and margin >= LEAST_MARGIN:
            self._tell(voice_id, voice, person)
        elif person != voice.told or product < KEEP_PRODUCT:
            self._tell(voice_id, voice, "")

    def _tell(self, voice_id: str, voice: _Voice, person: str) -> None:
        if person == voice.told:
            return
        if voice.told:
            self._changes.append(VoicePerson(voice_id, voice.told, 0.0))
        if person:
            self._changes.append(VoicePerson(voice_id, person, LIKELIHOOD))
        voice.told = person

    # What the service ~gallery asks for

    def enrol(self, voice_id: str, person_id: str = "", confirm: bool = False) -> str:
        """Keep the voice of a person who has agreed; return the id of the person. confirm: has no effect.

        Raises GalleryError when the voice is not heard, has not spoken enough, or no person is named: a voice alone
        makes nobody known.
        """
        with self._lock:
            voice = self._voices.get(voice_id)
            if voice is None or len(voice.embeddings) < LEAST_WINDOWS:
                raise GalleryError("voice {!r} is not tracked, or has not spoken for {:.1f} s yet".format(
                    voice_id, WINDOW_S + (LEAST_WINDOWS - 1) * HOP_S))
            if not person_id:
                raise GalleryError("a voice is enrolled for a person who is known by face; enrol the face first")
            if person_id not in self._gallery:
                self._gallery.add_person(person_id, voice.mean()[None], enrolled=True)
            else:
                self._gallery.add_template(person_id, voice.mean())
                self._gallery.enrol(person_id)
            self._compare(voice_id, voice)
            return person_id

    def forget(self, person_id: str) -> bool:
        """Forget a person and withdraw all matches; return whether a voice of the person was known."""
        with self._lock:
            for voice_id, voice in self._voices.items():
                if voice.told == person_id:
                    self._tell(voice_id, voice, "")
            return self._gallery.remove(person_id)

    def forget_all(self) -> None:
        """Forget everybody and withdraw all matches."""
        with self._lock:
            for voice_id, voice in self._voices.items():
                self._tell(voice_id, voice, "")
            self._gallery.clear()

    def merge(self, source: str, target: str) -> None:
        """Two ids are of one person, `target`. Raises GalleryError when one is not known."""
        self._gallery.merge(source, target)

    def export(self, person_id: str) -> KnownPerson:
        """Return all that is kept of a person. Raises GalleryError when there is nothing."""
        return self._gallery.export(person_id)

    def list_known(self) -> List[str]:
        """Return the ids of everybody whose voice is known."""
        return self._gallery.ids()
