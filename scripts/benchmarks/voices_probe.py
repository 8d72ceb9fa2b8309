"""Plays sound to the voices node in real time and listens to it. Usage: voices_probe.py CHANNELS FILE

Run by voices.py beside a running node. Writes one JSON object.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from pathlib import Path
from typing import Dict, List, Tuple
from xmlrpc.client import ServerProxy

import numpy as np
import rosgraph
import rospy
from audio_common_msgs.msg import AudioData, AudioInfo
from processes import wait_until
from std_msgs.msg import Bool

from benchmarks.speech_files import RATE, read_speech
from benchmarks.stack_run import cpu_s
from benchmarks.voice_figures import SoundScene, four_microphones, make_scene
from hri_msgs.msg import AudioFeatures, IdsList
from hri_pipeline.core.audio.stream import encode_s16

NODE = "/hri_voices"
CHUNK = RATE // 50
WAIT_S = 30.0
LATEST_S = 1.0


class Listener:
    """Notes when which voice began and ended to speak; listens to the features of all, so that they are computed."""

    def __init__(self) -> None:
        self.changes: List[Tuple[float, str, bool]] = []
        self.features = 0
        self._lock = threading.Lock()
        self._voices: Dict[str, list] = {}
        self._tracked = rospy.Subscriber("/humans/voices/tracked", IdsList, self._on_tracked)

    @property
    def voices(self) -> int:
        """Voices so far."""
        return len(self._voices)

    def _on_tracked(self, message: IdsList) -> None:
        for name in set(message.ids) - set(self._voices):
            space = "/humans/voices/{}/".format(name)
            self._voices[name] = [
                rospy.Subscriber(space + "is_speaking", Bool, self._on_speaking, name, tcp_nodelay=True),
                rospy.Subscriber(space + "features", AudioFeatures, self._on_features)]

    def _on_speaking(self, message: Bool, name: str) -> None:
        with self._lock:
            self.changes.append((time.time(), name, message.data))

    def _on_features(self, message: AudioFeatures) -> None:
        self.features += 1


def node_pid() -> int:
    """Process id of the voices node, 0 while it is not there."""
    try:
        uri = rosgraph.Master(rospy.get_name()).lookupNode(NODE)
        return int(ServerProxy(uri).getPid(rospy.get_name())[2])
    except (rosgraph.MasterError, OSError):
        return 0


def play(samples: np.ndarray, publisher: rospy.Publisher) -> float:
    """Send samples (n, C) in real time, 20 ms each when they are complete; returns the wall time of the first
    sample."""
    data = np.frombuffer(encode_s16(samples), "<i2").reshape(np.shape(samples))
    begin = time.time()
    for first in range(0, len(data) - CHUNK + 1, CHUNK):
        rest = begin + (first + CHUNK) / RATE - time.time()
        if rest > 0.0:
            time.sleep(rest)
        publisher.publish(AudioData(data=data[first:first + CHUNK].tobytes()))
    return begin


def delays_ms(scene: SoundScene, begin: float, changes: List[Tuple[float, str, bool]]) -> List[float]:
    """Time from each onset of the labels until a voice was said to be speaking; 1000 where none was."""
    found: List[float] = []
    for onset in begin + scene.onsets / RATE:
        state: Dict[str, bool] = {}
        state.update((name, speaking) for stamp, name, speaking in changes if stamp <= onset)
        later = [stamp - onset for stamp, _, speaking in changes if speaking and onset < stamp <= onset + LATEST_S]
        found.append(0.0 if any(state.values()) else 1e3 * min(later + [LATEST_S]))
    return found


def measure(channels: int) -> Dict[str, object]:
    """Play a scene and return processor time, and with one channel the delays."""
    scene = make_scene(read_speech(), None, seed=10)
    samples = scene.samples[:, None] if channels == 1 else four_microphones()
    info = rospy.Publisher("audio_info", AudioInfo, queue_size=1, latch=True)
    info.publish(AudioInfo(channels=channels, sample_rate=RATE, sample_format="S16LE", coding_format="wave"))
    publisher = rospy.Publisher("audio", AudioData, queue_size=100, tcp_nodelay=True)
    listener = Listener()
    if not wait_until(lambda: publisher.get_num_connections() and info.get_num_connections() and node_pid(), WAIT_S):
        raise RuntimeError("the node {} does not listen".format(NODE))
    pid = node_pid()
    play(np.zeros((RATE, channels), np.float32), publisher)
    before, started = cpu_s(pid), time.time()
    begin = play(samples, publisher)
    passed = time.time() - started
    result: Dict[str, object] = {"cpu_percent": round(100.0 * (cpu_s(pid) - before) / passed, 1),
                                 "seconds": round(passed, 1),
                                 "voices": listener.voices, "feature_messages": listener.features}
    if channels == 1:
        delays = delays_ms(scene, begin, sorted(listener.changes))
        result.update(onsets=len(delays), p50=round(float(np.percentile(delays, 50)), 1),
                      p95=round(float(np.percentile(delays, 95)), 1), worst=round(max(delays), 1))
    return result


def main() -> int:
    """Run the command."""
    channels, path = int(sys.argv[1]), Path(sys.argv[2])
    rospy.init_node("voices_probe", anonymous=True, disable_signals=True)
    path.write_text(json.dumps(measure(channels)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
