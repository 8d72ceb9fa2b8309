"""Recognition of free speech in real time, in its own process: when texts come, and what they cost.

The sound is played at its own speed to the voices and to SpeechRecognition, as the node does. On a machine that does
other work as well the delays are those of that machine.
"""

from __future__ import annotations

import time
from typing import Dict, List, NamedTuple, Sequence, Tuple

import numpy as np
import psutil

from benchmarks.speech_files import HELD_OUT_FILES, RATE, read_speech
from benchmarks.voice_figures import activity_model, blocks, energy_labels, make_scene, speaker_embedder
from hri_pipeline.core.asr.recognition import SpeechRecognition, SpeechResult
from hri_pipeline.core.audio.parameters import VOICES
from hri_pipeline.core.audio.pipeline import VoicePipeline
from hri_pipeline.core.audio.vad import FRAME

SEED = 1000
LOAD_S, LAST_TEXT_S, IDLE_S = 60.0, 3.0, 10.0
_BREATH_S = 0.2


class Heard(NamedTuple):
    """What came of a sound.

    Attributes
    ----------
    results : (s after the begin of the sound, result).
    ends : {voice: s at which its turn ended}.
    cpu_percent : of a core, of the recogniser's processes while the sound was played.
    """

    results: List[Tuple[float, SpeechResult]]
    ends: Dict[str, float]
    cpu_percent: float


def play(speech: SpeechRecognition, sound: np.ndarray) -> Heard:
    """Play a sound (n,) in real time."""
    pipeline = VoicePipeline(VOICES.resolve({}), activity_model(), speakers=speaker_embedder())
    results: List[Tuple[float, SpeechResult]] = []
    ends: Dict[str, float] = {}
    before, begin = _cpu_s(speech), time.monotonic()
    for block in blocks(sound):
        time.sleep(max(0.0, begin + block.stamp + FRAME / RATE - time.monotonic()))
        for seen in pipeline.update(block):
            if seen.onset:
                speech.start(seen.id, seen.stamp)
            if len(seen.samples):
                speech.feed(seen.id, seen.samples, seen.stamp, seen.speaking)
            if seen.end:
                speech.end(seen.id, seen.stamp)
                ends[seen.id] = time.monotonic() - begin
        results += [(time.monotonic() - begin, result) for result in speech.poll()]
    spent, passed = _cpu_s(speech) - before, time.monotonic() - begin
    while time.monotonic() - begin < passed + LAST_TEXT_S:
        results += [(time.monotonic() - begin, result) for result in speech.poll()]
        time.sleep(0.01)
    return Heard(results, ends, 100.0 * spent / passed)


def _cpu_s(speech: SpeechRecognition) -> float:
    """Processor time (s) so far of the recogniser's processes."""
    return sum(sum(psutil.Process(process.pid).cpu_times()[:2]) for process in list(speech._pool._processes))


def first_texts(heard: Heard, onsets: Sequence[float], longest: float = 4.0) -> List[float]:
    """Return for each onset (s) the time (s) until the first text behind it; those without one count as `longest`."""
    moments = [moment for moment, result in heard.results if result.incremental or result.final]
    return [min([moment - onset for moment in moments if moment > onset] + [longest]) for onset in onsets]


def text_delays(heard: Heard) -> List[float]:
    """Return the times (s) from the end of each turn to its text."""
    return [moment - heard.ends[result.voice_id] for moment, result in heard.results
            if result.final and result.voice_id in heard.ends]


def figures() -> Dict[str, object]:
    """Return the delays of texts and the cost of recognition. Raises FileNotFoundError with the mend."""
    settings = VOICES.resolve({"speech_engine": "moonshine"})
    speech = SpeechRecognition(settings)
    try:
        limit = time.monotonic() + LOAD_S
        while not speech.status()[2]["speech_ready"]:
            if time.monotonic() > limit:
                raise RuntimeError("the recogniser is not ready after {:.0f} s: {}".format(LOAD_S, speech.status()[1]))
            time.sleep(0.05)
        recordings = read_speech(HELD_OUT_FILES)
        idle = play(speech, 1e-3 * np.random.RandomState(SEED).standard_normal(int(IDLE_S * RATE)).astype(np.float32))
        scene = make_scene(recordings, None, seed=SEED)
        turns = play(speech, scene.samples)
        talk = [part for sound in recordings.values()
                for part in (sound[energy_labels(sound).argmax():], np.zeros(int(_BREATH_S * RATE)))]
        without_end = play(speech, np.concatenate(talk).astype(np.float32))
        memory = max(psutil.Process(process.pid).memory_info().rss for process in speech._pool._processes)
    finally:
        speech.close()
    delays, first = text_delays(turns), first_texts(turns, scene.onsets / RATE)
    return {"text_p95_s": float(np.percentile(delays, 95)), "first_partial_s": float(np.percentile(first, 95)),
            "cpu_percent_speaking": without_end.cpu_percent, "cpu_percent_idle": idle.cpu_percent,
            "text_median_s": float(np.median(delays)), "first_partial_median_s": float(np.median(first)),
            "live_turns": len(delays), "live_onsets": len(first), "recogniser_mb": memory / 1e6}
