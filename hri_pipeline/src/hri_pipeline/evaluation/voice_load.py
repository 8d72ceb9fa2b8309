"""Processor time of the voices without recognition of speech: intake, activity, features, and direction with separation."""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Dict, Optional

import numpy as np

from hri_pipeline.core.sound.sound_format import SoundFormat
from hri_pipeline.core.sound.sound_stream import SoundStream
from hri_pipeline.core.voices.audio_features import AudioFeatureExtractor
from hri_pipeline.core.voices.voice_parameters import VOICES
from hri_pipeline.core.voices.voice_stage import VoiceStage
from hri_pipeline.evaluation.room import Room, images_at, with_noise
from hri_pipeline.evaluation.speech_files import read_speech
from hri_pipeline.evaluation.voice_figures import RATE, activity_model, make_scene

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
    """Return two people who talk through and across each other in a room with an RT60 of 0.3 s at 10 dB, (n, 4) float32."""
    recordings = read_speech()
    random = np.random.RandomState(22)
    talks = [make_scene({name: recordings[name] for name in sorted(recordings, reverse=bool(turn))}, None, seed=23).samples
             for turn in (0, 1)]
    length = min(len(talk) for talk in talks)
    heard = [images_at(_ROOM.responses(place, SQUARE + _CENTRE), talk[:length]) for place, talk in zip(_TALKERS, talks)]
    mixed = with_noise(heard, 10.0, random)
    return (mixed * (0.5 / np.abs(mixed).max())).astype(np.float32)


def run_all(samples: np.ndarray, settings: Optional[SimpleNamespace] = None) -> Dict[str, float]:
    """Run samples (n, C) at 16 kHz through intake, voices and the features of every voice, as fast as it goes.

    With four channels direction and separation run as well. Returns {"seconds" of sound, "cpu_s", "longest_ms" of one message of
    64 ms, "voices", "feature_frames"}.
    """
    channels = samples.shape[1]
    settings = settings or VOICES.resolve({})
    array = None
    if channels > 1:
        from hri_pipeline.core.sound.sound_separation import SoundSeparator
        array = SoundSeparator(SQUARE, settings)
    stage = VoiceStage(settings, activity_model(), array)
    stream = SoundStream(SoundFormat(channels, RATE))
    extractors: Dict[str, AudioFeatureExtractor] = {}
    ids, frames, longest = set(), 0, 0.0
    data = np.round(np.clip(samples, -1.0, 1.0) * 32767.0).astype("<i2")
    begin = time.process_time()
    for first in range(0, len(data) - _MESSAGE + 1, _MESSAGE):
        message = time.process_time()
        for block in stream.add(data[first:first + _MESSAGE].tobytes(), 1000.0 + (first + _MESSAGE) / RATE):
            for seen in stage.process(block):
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
