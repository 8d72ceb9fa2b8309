"""Figures of activity and turns on real speech: hits and false alarms per frame, delay of the onset, processor time.

Labels come from the energy of the clean recording: a sample is speech where the level of the 25 ms around it is within
26 dB of the loudest of the recording. That is cruder than what a person would mark: clicks and breath count as speech,
soft ends of words do not. A frame of 32 ms is speech when more than half of it is, and a pause when none of it is;
those between are not counted. Nothing is shifted: a late onset and a hangover both count as errors.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, Dict, Iterator, List, Mapping, Optional, Sequence, Tuple

import numpy as np

from benchmarks.room import Room, images_at, with_noise
from benchmarks.speech_files import read_speech
from hri_pipeline.core.audio.features import AudioFeatureExtractor
from hri_pipeline.core.audio.parameters import VOICES, VoiceActivitySettings
from hri_pipeline.core.audio.pipeline import VoiceObservation, VoicePipeline
from hri_pipeline.core.audio.speakers import MODEL_FILE, SpeakerEmbedder
from hri_pipeline.core.audio.stream import SoundBlock, SoundFormat, SoundStream, encode_s16
from hri_pipeline.core.audio.vad import FRAME, FRAME_TIME, RATE, ActivityModel
from hri_pipeline.core.onnx import model_path

SNRS: Tuple[Optional[float], ...] = (None, 10.0, 0.0)
"""Signal-to-noise ratios in dB; None is the clean recording (with noise 80 dB below full scale)."""
SEEDS = (10, 11, 12)
_WINDOW = 400
_THRESHOLD = 0.05
_PEAK = 0.5
_QUIET = 0.3
_SUSTAINED = 0.2
_LATEST = 1.0
_CALM = 0.4


@dataclass(frozen=True)
class SoundScene:
    """Recordings with pauses of 1 to 1.5 s around them, in white noise.

    samples: (n,) float32 at 16 kHz; labels: (n,) bool, speech in the clean recording; onsets: indices of the first
    samples of speech behind 0.3 s without, where at least half of the next 0.2 s is speech (a click alone is no onset).
    """

    samples: np.ndarray
    labels: np.ndarray
    onsets: np.ndarray


def activity_settings(**changes: Any) -> VoiceActivitySettings:
    """Return the defaults of the parameters of activity, with changes."""
    return replace(VoiceActivitySettings(), **changes)


def activity_model() -> ActivityModel:
    """Return the network from the models directory. Raises ModelError with the mend."""
    return ActivityModel(model_path("", "silero_vad.onnx"))


def speaker_embedder() -> SpeakerEmbedder:
    """Return the network of speakers. Raises ModelError with the mend."""
    return SpeakerEmbedder(model_path("", MODEL_FILE))


def energy_labels(samples: np.ndarray) -> np.ndarray:
    """Return which of the clean samples (n,) are speech, (n,) bool."""
    rms = np.sqrt(np.convolve(samples * samples, np.full(_WINDOW, 1.0 / _WINDOW), "same"))
    return rms > max(rms.max() * _THRESHOLD, 1e-3)


def make_scene(recordings: Mapping[str, np.ndarray], snr: Optional[float], seed: int) -> SoundScene:
    """Join recordings {name: (n,) samples}, each scaled to a peak of 0.5.

    snr: dB, mean power of what is labelled speech over that of the white noise. The seed also draws the pauses, hence
    the position of the frames.
    """
    random = np.random.default_rng(seed)
    pieces: List[np.ndarray] = []
    labels: List[np.ndarray] = []
    for samples in recordings.values():
        pause = int(random.integers(RATE, RATE * 3 // 2))
        speech = samples * (_PEAK / np.abs(samples).max())
        pieces += [np.zeros(pause), speech]
        labels += [np.zeros(pause, bool), energy_labels(speech)]
    clean = np.concatenate(pieces + [np.zeros(RATE)])
    label = np.concatenate(labels + [np.zeros(RATE, bool)])
    power = float(np.mean(clean[label] ** 2))
    noise = 1e-4 if snr is None else np.sqrt(power / 10.0 ** (snr / 10.0))
    noisy = np.clip(clean + random.standard_normal(len(clean)) * noise, -1.0, 1.0)
    return SoundScene(noisy.astype(np.float32), label, _onsets(label))


def _onsets(labels: np.ndarray) -> np.ndarray:
    quiet, sustained = int(_QUIET * RATE), int(_SUSTAINED * RATE)
    edges = np.flatnonzero(np.diff(labels.astype(int)) == 1) + 1
    return np.array([edge for edge in edges if not labels[max(edge - quiet, 0):edge].any()
                     and labels[edge:edge + sustained].mean() >= 0.5], int)


def blocks(samples: np.ndarray, start: float = 0.0, length: int = FRAME) -> Iterator[SoundBlock]:
    """Yield samples, (n,) or (n, C), as blocks of `length` samples with the stamps from `start` on."""
    columns = samples[:, None] if samples.ndim == 1 else samples
    for first in range(0, len(columns) - length + 1, length):
        yield SoundBlock(columns[first:first + length], start + first / RATE)


def run_stage(stage: VoicePipeline, samples: np.ndarray) -> Iterator[Tuple[float, float, List[VoiceObservation]]]:
    """Yield, per block of 32 ms: the time in the sound at which it was complete, the seconds of processing, and what
    was found."""
    for block in blocks(samples):
        begin = time.perf_counter()
        found = stage.update(block)
        yield block.stamp + FRAME_TIME, time.perf_counter() - begin, found


def _speaking(scene: SoundScene, model: ActivityModel, settings: VoiceActivitySettings
              ) -> Tuple[np.ndarray, np.ndarray]:
    """(F,) bool, whether a voice is said to be speaking in each frame, and (F,) s, the processing of each."""
    steps = [(any(seen.speaking for seen in found), seconds)
             for _, seconds, found in run_stage(VoicePipeline(settings, model), scene.samples)]
    return np.array([step[0] for step in steps], bool), np.array([step[1] for step in steps])


def frame_rates(scenes: Sequence[SoundScene], model: ActivityModel,
                settings: Optional[VoiceActivitySettings] = None) -> Dict[str, float]:
    """Return {"tpr": share of the frames of speech in which somebody is speaking, "fpr": the same of the pauses}."""
    counts = np.zeros(4)
    for scene in scenes:
        speaking, _ = _speaking(scene, model, settings or activity_settings())
        share = scene.labels[:len(speaking) * FRAME].reshape(-1, FRAME).mean(axis=1)
        speech, pause = share > 0.5, share == 0.0
        counts += (speaking[speech].sum(), speech.sum(), speaking[pause].sum(), pause.sum())
    return {"tpr": round(counts[0] / counts[1], 4), "fpr": round(counts[2] / counts[3], 4)}


def onset_delays_ms(scenes: Sequence[SoundScene], model: ActivityModel,
                    settings: Optional[VoiceActivitySettings] = None) -> np.ndarray:
    """Return the ms from each onset of the labels until somebody is said to be speaking, processing included.

    That is the algorithm's delay, the wait for the end of the 32 ms block, and the processing of this block. 0 where
    somebody was speaking already; 1000 where the onset was missed.
    """
    delays: List[float] = []
    for scene in scenes:
        speaking, seconds = _speaking(scene, model, settings or activity_settings())
        for onset in scene.onsets:
            first = onset // FRAME
            hits = np.flatnonzero(speaking[first:first + int(_LATEST / FRAME_TIME)])
            delay = _LATEST if not len(hits) else (
                (first + hits[0] + 1) * FRAME_TIME - onset / RATE + seconds[first + hits[0]])
            delays.append(0.0 if first and speaking[first - 1] else 1e3 * delay)
    return np.array(delays)


def offset_delays_ms(scenes: Sequence[SoundScene], model: ActivityModel) -> np.ndarray:
    """Return the ms from each end of speech, behind which there is none for 0.4 s, until nobody is said to be
    speaking."""
    delays: List[float] = []
    for scene in scenes:
        speaking, seconds = _speaking(scene, model, activity_settings())
        for end in np.flatnonzero(np.diff(scene.labels.astype(int)) == -1) + 1:
            if scene.labels[end:end + int(_CALM * RATE)].any():
                continue
            first = end // FRAME
            silent = np.flatnonzero(~speaking[first:first + int(_LATEST / FRAME_TIME)])
            delays.append(1e3 * (_LATEST if not len(silent) else (
                first + silent[0] + 1) * FRAME_TIME - end / RATE + seconds[first + silent[0]]))
    return np.array(delays)


def off_p95_ms(names: Sequence[str], rt60: float = 0.0, seeds: Sequence[int] = SEEDS) -> float:
    """Return the 95th percentile of offset_delays_ms over clean recordings, or in a room 1.8 m away."""
    scenes = [make_scene(read_speech(names), None, seed) for seed in seeds]
    if rt60 > 0.0:
        response = Room((6.0, 5.0, 3.0), rt60).responses((4.3, 1.4, 1.5), _CENTRE[None])
        heard = [images_at(response, scene.samples.astype(np.float64))[:, 0] for scene in scenes]
        scenes = [SoundScene((sound * (_PEAK / np.abs(sound).max())).astype(np.float32), scene.labels, scene.onsets)
                  for scene, sound in zip(scenes, heard)]
    return round(float(np.percentile(offset_delays_ms(scenes, activity_model()), 95)), 1)


def vad(names: Optional[Sequence[str]] = None, seeds: Sequence[int] = SEEDS,
        settings: Optional[VoiceActivitySettings] = None) -> Dict[str, Dict[str, float]]:
    """Return {"clean", "10", "0": {"tpr", "fpr"}} over the recordings of these names, all by default."""
    recordings = read_speech(names) if names is not None else read_speech()
    model = activity_model()
    return {"clean" if snr is None else "{:g}".format(snr): frame_rates(
        [make_scene(recordings, snr, seed) for seed in seeds], model, settings) for snr in SNRS}


def onset_p95_ms(names: Optional[Sequence[str]] = None, seeds: Sequence[int] = SEEDS, snr: Optional[float] = None,
                 settings: Optional[VoiceActivitySettings] = None) -> Dict[str, float]:
    """Return {"p50", "p95": ms, "onsets": number} over the recordings of these names, all by default, at one SNR."""
    recordings = read_speech(names) if names is not None else read_speech()
    delays = onset_delays_ms([make_scene(recordings, snr, seed) for seed in seeds], activity_model(), settings)
    return {"p50": round(float(np.percentile(delays, 50)), 1), "p95": round(float(np.percentile(delays, 95)), 1),
            "onsets": len(delays)}


SQUARE = np.array([[0.0325, 0.0325, 0.0], [-0.0325, 0.0325, 0.0], [-0.0325, -0.0325, 0.0], [0.0325, -0.0325, 0.0]])
"""Positions (4, 3) m of a square of 65 mm, as arrays for robots have."""
_MESSAGE = 1024
_ROOM = Room((6.0, 5.0, 3.0), 0.3)
_CENTRE = np.array([3.0, 2.4, 1.2])
_TALKERS = ((4.5, 3.3, 1.5), (4.3, 1.4, 1.5))


def one_microphone() -> np.ndarray:
    """Return all recordings at 10 dB with pauses between, (n, 1) float32."""
    return make_scene(read_speech(), 10.0, seed=21).samples[:, None]


def four_microphones() -> np.ndarray:
    """Return two people who talk through and across each other in a room with an RT60 of 0.3 s at 10 dB, (n, 4)
    float32."""
    recordings = read_speech()
    random = np.random.RandomState(22)
    talks = [make_scene({name: recordings[name] for name in sorted(recordings, reverse=bool(turn))}, None,
                        seed=23).samples
             for turn in (0, 1)]
    length = min(len(talk) for talk in talks)
    heard = [images_at(_ROOM.responses(place, SQUARE + _CENTRE), talk[:length]) for place, talk in zip(_TALKERS, talks)]
    mixed = with_noise(heard, 10.0, random)
    return (mixed * (0.5 / np.abs(mixed).max())).astype(np.float32)


def run_all(samples: np.ndarray, settings: Optional[VoiceActivitySettings] = None) -> Dict[str, float]:
    """Run samples (n, C) at 16 kHz through intake, voices and the features of every voice, as fast as it goes.

    With four channels direction and separation run as well. Returns {"seconds" of sound, "cpu_s", "longest_ms" of one
    message of 64 ms, "voices", "feature_frames"}.
    """
    channels = samples.shape[1]
    settings = settings or VOICES.resolve({})
    array = None
    if channels > 1:
        from hri_pipeline.core.audio.separation import SoundSeparator
        array = SoundSeparator(SQUARE, settings)
    stage = VoicePipeline(settings, activity_model(), array, speakers=speaker_embedder())
    stream = SoundStream(SoundFormat(channels, RATE))
    extractors: Dict[str, AudioFeatureExtractor] = {}
    ids, frames, longest = set(), 0, 0.0
    data = np.frombuffer(encode_s16(samples), "<i2").reshape(samples.shape)
    begin = time.process_time()
    for first in range(0, len(data) - _MESSAGE + 1, _MESSAGE):
        message = time.process_time()
        for block in stream.add(data[first:first + _MESSAGE].tobytes(), 1000.0 + (first + _MESSAGE) / RATE):
            for seen in stage.update(block):
                ids.add(seen.id)
                if len(seen.samples):
                    if seen.id not in extractors:
                        extractors[seen.id] = AudioFeatureExtractor(settings.features_rate)
                    frames += len(extractors[seen.id].process(seen.samples, seen.stamp))
            for name in set(extractors) - set(stage.tracked):
                del extractors[name]
        longest = max(longest, time.process_time() - message)
    return {"seconds": len(data) / RATE, "cpu_s": time.process_time() - begin, "longest_ms": 1e3 * longest,
            "voices": len(ids), "feature_frames": frames}


def cpu_percent(channels: int, runs: int = 3) -> Dict[str, float]:
    """Return {"cpu_percent": processor time over the length of the sound, of one core, and what was done}.

    The processor time is that of the process, all its threads; the run with the least counts: others disturb it upwards
    only. channels: 1 or 4. Raises ValueError for others.
    """
    if channels not in (1, 4):
        raise ValueError("there are scenes of 1 and 4 channels, not {}".format(channels))
    samples = one_microphone() if channels == 1 else four_microphones()
    run_all(samples[:10 * RATE])
    found = min((run_all(samples) for _ in range(runs)), key=lambda run: run["cpu_s"])
    return dict({key: round(value, 2) for key, value in found.items()},
                cpu_percent=round(100.0 * found["cpu_s"] / found["seconds"], 2))
