"""Whose voice a sound is: embeddings of speakers (`SpeakerEmbedder`), where in a turn another one goes on
(`SpeakerChange`), and which of the people who have agreed a voice is of (`VoiceIdentity`).

The network (Resemblyzer 0.1.4, Apache-2.0) was trained with the loss of L. Wan et al., "Generalized end-to-end loss for
speaker verification", ICASSP 2018: unit vectors of two sounds of one speaker have a larger product than those of two
speakers. It takes the power in 40 mel bands, of 25 ms every 10 ms, of 1.6 s of speech or any other length.
"""

from __future__ import annotations

import threading
from collections import deque
from functools import lru_cache
from pathlib import Path
from typing import Callable, Deque, Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np
import scipy.fft

from hri_pipeline.core.audio.level import level_dbfs
from hri_pipeline.core.audio.stream import RATE
from hri_pipeline.core.ids import IdGenerator
from hri_pipeline.core.onnx import OnnxModel
from hri_pipeline.core.recognition.gallery import GalleryError, MemoryGallery
from hri_pipeline.core.recognition.likelihood import TemplateCalibration
from hri_pipeline.core.recognition.store import KnownPerson

BANDS, DIMENSION = 40, 256
MODEL_FILE = "speaker_embedding.onnx"
WINDOW, HOP = RATE * 25 // 1000, RATE // 100
LEVEL_DBFS = -30.0
"""Level to which sound is brought: the network was trained on such."""
_BREAK_HZ, _HZ_PER_MEL = 1000.0, 200.0 / 3.0
_LOG_STEP = np.log(6.4) / 27.0
# Of SpeakerChange, in frames of 32 ms: what is compared (1.2 s), how often (0.26 s), with how much of the turn (4 s),
# and where the change is looked for before the end of what is compared. The least product of one speaker, and how often
# in a row it must be missed: chosen with scripts/benchmarks/voice_turns.py so that few turns of one speaker are cut.
# The mean of several windows, and pitch beside the embedding, found no more changes at that price (20 dialogues).
_COMPARED, _EVERY, _REFERENCE = 38, 8, 125
_LATEST, _EARLIEST = 18, 54
_LEAST_PRODUCT, _IN_A_ROW = 0.64, 2
_SHORT_PAUSE_S = 0.03
# Least product of a turn with an earlier voice that goes on, in the first _EARLIER_LOOKS looks. With 0.75 twice as much
# speech was in somebody else's voice, and with 0.83 nearly as much, in a sixth more voices (ten scenes of two and three
# of nine speakers, RT60 0.35 s, 15 to 30 dB).
_LEAST_LIKE, _EARLIER_LOOKS = 0.79, 4
KEPT_EMBEDDINGS = 30
"""Of each tracked voice: 8 s of its speech."""


@lru_cache(maxsize=1)
def _filters() -> np.ndarray:
    """Return the weights (bins, BANDS) of triangular filters of equal area on the scale of M. Slaney's Auditory Toolbox
    (Interval Research, report 1998-010): linear up to 1 kHz, logarithmic above."""
    break_mel = _BREAK_HZ / _HZ_PER_MEL
    top = break_mel + np.log(RATE / 2.0 / _BREAK_HZ) / _LOG_STEP
    mels = np.linspace(0.0, top, BANDS + 2)
    edges = np.where(mels < break_mel, mels * _HZ_PER_MEL, _BREAK_HZ * np.exp(_LOG_STEP * (mels - break_mel)))
    places = np.linspace(0.0, RATE / 2.0, WINDOW // 2 + 1)[:, None]
    low, middle, high = edges[:-2], edges[1:-1], edges[2:]
    rising, falling = (places - low) / (middle - low), (high - places) / (high - middle)
    return (np.maximum(0.0, np.minimum(rising, falling)) * 2.0 / (high - low)).astype(np.float32)


def mel_power(samples: np.ndarray) -> np.ndarray:
    """Return the power (T, BANDS) of samples (n,), -1 to 1 at 16 kHz, in T frames; at least one WINDOW of samples."""
    frames = np.lib.stride_tricks.sliding_window_view(np.asarray(samples, np.float32), WINDOW)[::HOP]
    window = (0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(WINDOW) / WINDOW)).astype(np.float32)
    spectrum = scipy.fft.rfft(frames * window, axis=1)
    return np.asarray((spectrum.real ** 2 + spectrum.imag ** 2) @ _filters(), np.float32)


class SpeakerEmbedder:
    """The network, loaded once per process.

    Parameters
    ----------
    path : str or Path
        speaker_embedding.onnx.
    notify
        See OnnxModel.

    Raises
    ------
    ModelError
        When the file is missing, damaged, or another model.
    """

    def __init__(self, path: Union[str, Path], notify: Optional[Callable[[str], None]] = None) -> None:
        self._model = OnnxModel(path, inputs=("mel",), outputs=("embedding",), notify=notify)

    def embed(self, sounds: np.ndarray) -> np.ndarray:
        """Return the embeddings (N, DIMENSION), unit vectors with no negative part, of sounds (N, n) of speech: samples
        from -1 to 1 at 16 kHz without pauses, best 1.6 s or more.

        Raises ValueError for sounds that are shorter than a WINDOW.
        """
        sounds = np.asarray(sounds, np.float32)
        if sounds.ndim != 2 or sounds.shape[1] < WINDOW:
            raise ValueError("sounds of the shape {}, wanted is (N, {} or more)".format(sounds.shape, WINDOW))
        level = np.sqrt(np.mean(np.square(sounds), axis=1, keepdims=True) + 1e-12)
        scaled = sounds * (np.float32(10.0 ** (LEVEL_DBFS / 20.0)) / level)
        return self._model.run({"mel": np.stack([mel_power(sound) for sound in scaled])})["embedding"]


class _Frame(NamedTuple):
    """samples: (n,), stamp: s of the first; is_speech: nobody pauses; pause: s without speech right before it."""

    samples: np.ndarray
    stamp: float
    is_speech: bool
    pause: float


class OtherSpeaker(NamedTuple):
    """samples: (n,) sound of another speaker; since: s, when it begins; embedding: (DIMENSION,)."""

    samples: np.ndarray
    since: float
    embedding: np.ndarray


def most_alike(embedding: np.ndarray, voices: Sequence[Sequence[np.ndarray]]) -> Optional[int]:
    """Return the index of the voice, of (DIMENSION,) embeddings each, that an embedding is of; None: of none."""
    products = [_product(np.mean(known, axis=0), embedding) if known else 0.0 for known in voices]
    best = int(np.argmax(products)) if products else 0
    return best if products and products[best] >= _LEAST_LIKE else None


def _product(mean: np.ndarray, embedding: np.ndarray) -> float:
    return float(mean @ embedding) / float(np.linalg.norm(mean))


class SpeakerChange:
    """Finds in one turn where another speaker goes on: the last 1.2 s of speech are compared with what was said before.

    Parameters
    ----------
    embedder : SpeakerEmbedder
    """

    def __init__(self, embedder: SpeakerEmbedder) -> None:
        self._embedder = embedder
        self.end()

    def end(self) -> None:
        """Forget sound and embeddings: the turn is over."""
        self.begin(deque(maxlen=KEPT_EMBEDDINGS))

    def begin(self, known: Deque[np.ndarray], earlier: Sequence[Sequence[np.ndarray]] = ()) -> None:
        """Begin the turn of a new voice, to whose embeddings those of the turn are added, or of one of the earlier
        voices of these embeddings: add() tells when it is."""
        self.take_for(known)
        self._earlier = earlier
        self._reset()

    def take_for(self, known: Deque[np.ndarray]) -> None:
        """Add the embeddings from now on to those of another voice, whose turn this is."""
        self._known = known

    def _reset(self) -> None:
        self._frames: Deque[_Frame] = deque()
        self._spoken = 0      # frames of speech, in the turn and in _frames
        self._kept = 0
        self._pause = 0.0
        self._views: List[Tuple[int, np.ndarray]] = []    # frames of speech up to the end of it, embedding
        self._missed = 0      # times in a row that the product was too small

    def add(self, samples: np.ndarray, stamp: float, is_speech: bool) -> Optional[OtherSpeaker]:
        """Add a frame of the turn (n,); stamp: s. Return another speaker with whom it ends; None while nothing has
        changed. After a change the other speaker's turn has begun."""
        self._frames.append(_Frame(samples, stamp, is_speech, self._pause))
        self._pause = 0.0 if is_speech else self._pause + len(samples) / RATE
        if not is_speech:
            return None
        self._spoken += 1
        self._kept += 1
        # All of a turn may be an earlier voice's.
        while self._kept > _EARLIEST and not self._earlier:
            self._kept -= self._frames.popleft().is_speech
        if self._spoken < _COMPARED or (self._spoken - _COMPARED) % _EVERY:
            return None
        newest = self._embed()
        self._missed = self._missed + 1 if self._is_other(newest) else 0
        self._views.append((self._spoken, newest))
        if self._missed >= _IN_A_ROW:
            return self._divide(self._find_change(), newest)
        if not self._missed:
            self._known.append(newest)
        return self._find_earlier()

    def _find_earlier(self) -> Optional[OtherSpeaker]:
        """Return all of the turn where an earlier voice has begun it."""
        if not self._earlier or self._missed:
            return None
        mean = np.mean([embedding for _, embedding in self._views], axis=0)
        mean /= np.linalg.norm(mean)
        if most_alike(mean, self._earlier) is not None:
            return self._divide(0, mean)
        if len(self._views) >= _EARLIER_LOOKS:
            self._earlier = ()
        return None

    def _embed(self) -> np.ndarray:
        """Return the embedding of the newest speech."""
        speech = [frame.samples for frame in self._frames if frame.is_speech]
        return self._embedder.embed(np.concatenate(speech[-_COMPARED:])[None])[0]

    def _is_other(self, newest: np.ndarray) -> bool:
        last = self._spoken - _COMPARED
        self._views = [view for view in self._views if view[0] > last - _REFERENCE]
        before = [embedding for end, embedding in self._views if end <= last]
        return bool(before) and _product(np.mean(before, axis=0), newest) < _LEAST_PRODUCT

    def _find_change(self) -> int:
        """Return the frame in which the other speaker begins: at the longest pause there, else where it is softest."""
        frames = list(self._frames)
        speech = [index for index, frame in enumerate(frames) if frame.is_speech]
        places = speech[:len(speech) - _LATEST]
        place = max(places, key=lambda index: frames[index].pause)
        if frames[place].pause < _SHORT_PAUSE_S:
            place = min(places[-(_EARLIEST - _LATEST):-_EVERY], key=lambda index: level_dbfs(frames[index].samples))
        return place

    def _divide(self, place: int, embedding: np.ndarray) -> OtherSpeaker:
        """Begin the other speaker's turn with the frame of this index."""
        rest = list(self._frames)[place:]
        self._earlier = ()
        self._reset()
        for frame in rest:
            self._frames.append(frame)
            self._spoken += frame.is_speech
        self._kept = self._spoken
        return OtherSpeaker(np.concatenate([frame.samples for frame in rest]), rest[0].stamp, embedding)


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
        self._new_id = IdGenerator().new
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
            self._drop_gone()
            changes, self._changes = self._changes, []
            return changes

    def current(self) -> List[VoicePerson]:
        """Return all matches of voices that are tracked."""
        with self._lock:
            self._drop_gone()
            return [VoicePerson(name, voice.told, LIKELIHOOD) for name, voice in self._voices.items() if voice.told]

    def _drop_gone(self) -> None:
        """Compare the voices anew whose persons were merged, or forgotten by another process."""
        for voice_id, voice in self._voices.items():
            if voice.told and voice.told not in self._gallery:
                self._compare(voice_id, voice)

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
        """Keep the voice of a person who has agreed; return the id of the person.

        Parameters
        ----------
        person_id : empty: who the voice is taken for, else somebody new, as where nobody has a face.
        confirm : without an id it is somebody new, although the voice sounds like somebody who is known.

        Raises
        ------
        GalleryError
            The voice is not heard, has not spoken enough, is unlike the one that is kept of the person, or sounds like
            somebody else and that is not confirmed.
        """
        with self._lock:
            voice = self._voices.get(voice_id)
            if voice is None or len(voice.embeddings) < LEAST_WINDOWS:
                raise GalleryError("voice {!r} is not tracked, or has not spoken for {:.1f} s yet".format(
                    voice_id, WINDOW_S + (LEAST_WINDOWS - 1) * HOP_S))
            person_id = person_id or ("" if confirm else voice.told or self._new_unlike(voice)) or self._new_id()
            apart = self._gallery.nearest(person_id, voice.mean())
            if apart is None:
                self._gallery.add_person(person_id, voice.mean()[None], enrolled=True)
            elif apart > self._gallery.calibration.fair_midpoint:
                raise GalleryError("the voice does not sound like {} (distance {:.2f}); if it is, forget them and "
                                   "enrol them again".format(person_id, apart))
            else:
                self._gallery.add_template(person_id, voice.mean())
                self._gallery.enrol(person_id)
            self._compare(voice_id, voice)
            return person_id

    def _new_unlike(self, voice: _Voice) -> str:
        """Return a new id. Raises GalleryError where the voice sounds like somebody who is known."""
        for one in self._gallery.match(voice.mean()[None], most=1)[0].candidates:
            if 1.0 - 0.5 * one.distance ** 2 >= KEEP_PRODUCT:
                raise GalleryError("the voice sounds like {}, who is known already; if it is somebody else, confirm "
                                   "it".format(one.person_id))
        return self._new_id()

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
