"""Recognition of speech with the real pocketsphinx in its own processes, which are killed, stopped and confused."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numpy as np
import pytest

from benchmarks.speech_files import ABSENT, SPEECH_DIRECTORY, available, read_speech
from hri_pipeline.core.asr import recognition
from hri_pipeline.core.asr.recognition import ERROR, OK, WARN, SpeechRecognition
from hri_pipeline.core.audio.parameters import SpeechSettings
from hri_pipeline.core.parameters import ParameterError

pytest.importorskip("pocketsphinx")
pytestmark = pytest.mark.skipif(not available(), reason=ABSENT)

LIMIT_S = 60.0
CARDS = str(SPEECH_DIRECTORY / "cards/cards.gram")
TEN_OF_CLUBS, FOUR_QUEEN = "cards/001.wav", "cards/002.wav"


def settings(**changes):
    return SpeechSettings(**{"speech_grammar": CARDS, "speech_nice": 0, **changes})


@pytest.fixture
def recognise():
    """Make a SpeechRecognition that is closed at the end."""
    made = []

    def make(hang_time=30.0, **changes):
        made.append(SpeechRecognition(settings(**changes), hang_time))
        return made[-1]
    yield make
    for speech in made:
        speech.close()
    assert all(not children(speech) for speech in made)


def wait_for(condition, limit=LIMIT_S):
    end = time.monotonic() + limit
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.01)
    raise AssertionError("nothing came within {:.0f} s".format(limit))


def feed(speech, voice, samples, stamp=100.0):
    for place in range(0, len(samples), 512):
        speech.feed(voice, samples[place:place + 512], stamp + place / 16000.0)


def say(speech, voice, name, stamp=100.0):
    samples = read_speech([name])[name]
    speech.start(voice, stamp)
    feed(speech, voice, samples, stamp)
    speech.end(voice)
    return len(samples) / 16000.0


def results_until_final(speech, voices=1, limit=LIMIT_S):
    found = []

    def done():
        found.extend(speech.poll())
        return sum(not result.incremental for result in found) >= voices
    wait_for(done, limit)
    return found


def children(speech):
    return [process.pid for process in speech._pool._processes]


def is_ready(speech, count=1):
    return lambda: speech.status()[2]["speech_ready"] >= count


def test_text_grows_while_somebody_speaks_and_the_whole_sentence_comes_last(recognise):
    speech = recognise()
    length = say(speech, "abcde", FOUR_QUEEN)
    results = results_until_final(speech)
    *partial, last = results
    assert last.final == "four queen of clubs" and last.incremental == "" and 0.1 < last.confidence <= 1.0
    assert partial and all(result.incremental and not result.final for result in partial)
    stamps = [result.stamp for result in results]
    assert stamps == sorted(stamps) and stamps[-1] == pytest.approx(100.0 + length, abs=0.01)
    assert {result.voice_id for result in results} == {"abcde"} and {result.language for result in results} == {"en-US"}
    level, _, values = speech.status()
    assert level == OK and values["speech_utterances"] == 1 and values["speech_real_time_factor"] > 0.0


def test_two_voices_speak_at_once(recognise):
    speech = recognise(speech_max_speakers=2)
    sounds = read_speech([TEN_OF_CLUBS, FOUR_QUEEN])
    for voice in ("first", "other"):
        speech.start(voice, 0.0)
    for voice, name in (("first", TEN_OF_CLUBS), ("other", FOUR_QUEEN)):
        feed(speech, voice, sounds[name])
    wait_for(is_ready(speech, 2))
    for voice in ("first", "other"):
        speech.end(voice)
    texts = {result.voice_id: result.final for result in results_until_final(speech, 2) if result.final}
    assert texts == {"first": "ten of clubs", "other": "four queen of clubs"}


def test_more_voices_than_processes_wait_for_each_other(recognise):
    speech = recognise(speech_max_speakers=1)
    for number in range(3):
        say(speech, "voice{}".format(number), TEN_OF_CLUBS)
    texts = [result.final for result in results_until_final(speech, 3) if result.final]
    assert texts == ["ten of clubs"] * 3 and len(children(speech)) == 1


def test_without_partial_texts_only_sentences_come(recognise):
    speech = recognise(speech_partial_rate=0.0)
    say(speech, "abcde", TEN_OF_CLUBS)
    assert [result.final for result in results_until_final(speech)] == ["ten of clubs"]


def test_what_is_no_sentence_of_the_grammar_is_taken_back(recognise):
    speech = recognise()
    say(speech, "abcde", "librivox/sense_and_sensibility_01_austen_64kb-0880.wav")
    last = results_until_final(speech)[-1]
    assert (last.incremental, last.final, last.confidence) == ("", "", 0.0)
    assert speech.status()[2]["speech_unsure"] == 1


def test_a_killed_process_is_replaced_and_the_sentence_is_heard_whole(recognise):
    speech = recognise()
    wait_for(is_ready(speech))
    sound = read_speech(["cards/005.wav"])["cards/005.wav"]
    half = len(sound) // 2
    speech.start("abcde", 0.0)
    feed(speech, "abcde", sound[:half])
    wait_for(speech.poll)
    os.kill(children(speech)[0], signal.SIGKILL)
    feed(speech, "abcde", sound[half:], half / 16000.0)
    speech.end("abcde")
    last = results_until_final(speech)[-1]
    assert last.final == "eight of spades four of clubs seven of hearts"
    assert last.stamp == pytest.approx(len(sound) / 16000.0, abs=0.01)
    level, message, values = speech.status()
    assert level == WARN and "signal 9" in message and values["speech_restarts"] == 1
    say(speech, "next1", TEN_OF_CLUBS)
    assert results_until_final(speech)[-1].final == "ten of clubs"


def test_a_sentence_that_kills_twice_is_given_up(recognise):
    speech = recognise()
    speech.start("abcde", 0.0)
    for restarts in range(2):
        wait_for(is_ready(speech))
        feed(speech, "abcde", read_speech([TEN_OF_CLUBS])[TEN_OF_CLUBS][:8000])
        wait_for(lambda: speech._pool._processes and speech._pool._processes[0].utterance is not None)
        os.kill(children(speech)[0], signal.SIGKILL)
        wait_for(lambda: speech.status()[2]["speech_restarts"] == restarts + 1)  # noqa: B023
    wait_for(lambda: speech.status()[2]["speech_lost"] == 1)
    speech.end("abcde")
    say(speech, "next1", TEN_OF_CLUBS)
    # Of the first one an empty text is told where something had been heard of it before.
    finals = {}
    wait_for(lambda: finals.update({result.voice_id: result.final for result in speech.poll()
                                    if not result.incremental})
             or "next1" in finals)
    assert finals.pop("next1") == "ten of clubs"
    assert finals in ({}, {"abcde": ""})


def test_a_process_that_hangs_is_replaced(recognise):
    speech = recognise(hang_time=3.0)
    wait_for(is_ready(speech))
    os.kill(children(speech)[0], signal.SIGSTOP)
    say(speech, "abcde", FOUR_QUEEN)
    wait_for(lambda: speech.status()[0] == WARN)
    assert "hung" in speech.status()[1] and speech.status()[2]["speech_hangs"] == 1
    say(speech, "next1", TEN_OF_CLUBS)
    texts = {result.voice_id: result.final for result in results_until_final(speech, 2) if result.final}
    assert texts == {"abcde": "four queen of clubs", "next1": "ten of clubs"}


def test_sound_that_finds_no_room_is_dropped_and_told(recognise):
    speech = recognise(speech_queue=2.0)
    wait_for(is_ready(speech))
    os.kill(children(speech)[0], signal.SIGSTOP)
    speech.start("abcde", 0.0)
    feed(speech, "abcde", np.zeros(16000 * 5))
    level, message, values = speech.status()
    assert values["speech_dropped_s"] == pytest.approx(3.0, abs=0.1) and values["speech_waiting_s"] <= 2.0
    assert level == WARN and "dropped" in message
    os.kill(children(speech)[0], signal.SIGCONT)


def test_rubbish_from_the_process_ends_it(recognise):
    speech = recognise()
    wait_for(is_ready(speech))
    child = children(speech)[0]
    outputs = {os.readlink("/proc/{}/fd/{}".format(child, fd)): fd for fd in os.listdir("/proc/{}/fd".format(child))}
    parent_end = os.readlink("/proc/self/fd/{}".format(speech._pool._processes[0].output.fileno()))
    with open("/proc/{}/fd/{}".format(child, outputs[parent_end]), "wb", buffering=0) as pipe:
        pipe.write(b"loading the model, please wait\n")
    wait_for(lambda: speech.status()[2]["speech_restarts"] == 1)
    assert "no message" in speech.status()[1]
    say(speech, "abcde", TEN_OF_CLUBS)
    assert results_until_final(speech)[-1].final == "ten of clubs"


def test_a_grammar_that_does_not_load_is_an_error_and_is_not_tried_again(recognise):
    speech = recognise(speech_grammar="#JSGF V1.0; grammar g; public <g> = flubberwobbel;")
    wait_for(lambda: speech.status()[0] == ERROR)
    assert "speech_grammar" in speech.status()[1]
    say(speech, "abcde", TEN_OF_CLUBS)
    assert speech.poll() == [] and speech.status()[2]["speech_lost"] == 1
    wait_for(lambda: speech.status()[2]["speech_processes"] == 0)
    assert speech.status()[2]["speech_restarts"] == 0


def test_settings_that_cannot_work_are_refused_at_once():
    with pytest.raises(ParameterError, match="speech_grammar"):
        SpeechRecognition(settings(speech_grammar="/no/such/file"))
    assert not SpeechRecognition.enabled(SpeechSettings(speech_engine=""))


def test_a_dropped_voice_says_nothing_more(recognise):
    speech = recognise()
    wait_for(is_ready(speech))
    sound = read_speech([FOUR_QUEEN])[FOUR_QUEEN]
    speech.start("gone1", 0.0)
    feed(speech, "gone1", sound)
    speech.drop("gone1")
    say(speech, "stays", TEN_OF_CLUBS)
    assert {result.voice_id for result in results_until_final(speech)} == {"stays"}


def test_a_turn_without_end_is_cut(recognise, monkeypatch):
    monkeypatch.setattr(recognition, "LONGEST_S", 1.0)
    speech = recognise()
    sound = read_speech([TEN_OF_CLUBS])[TEN_OF_CLUBS]
    speech.start("abcde", 0.0)
    for number in range(3):
        feed(speech, "abcde", sound, number * 2.0)
    speech.end("abcde")
    results_until_final(speech, 3)
    assert speech.status()[2]["speech_utterances"] >= 3


def test_unknown_voices_wrong_shapes_and_nothing_at_all(recognise):
    speech = recognise()
    feed(speech, "never", np.zeros(1600))
    speech.end("never")
    speech.drop("never")
    speech.start("abcde", 0.0)
    speech.feed("abcde", np.zeros(0), 0.0)
    with pytest.raises(ValueError, match="one channel"):
        speech.feed("abcde", np.zeros((5, 2)), 0.0)
    speech.end("abcde")
    say(speech, "next1", TEN_OF_CLUBS)
    assert [result.voice_id for result in results_until_final(speech)][-1] == "next1"


def test_after_close_nothing_is_left_and_calls_do_no_harm():
    threads, descriptors = threading.active_count(), len(os.listdir("/proc/self/fd"))
    speech = SpeechRecognition(settings())
    wait_for(is_ready(speech))
    child = children(speech)[0]
    speech.close()
    speech.close()
    say(speech, "abcde", TEN_OF_CLUBS)
    assert speech.poll() == [] and not os.path.exists("/proc/{}".format(child))
    assert threading.active_count() == threads and len(os.listdir("/proc/self/fd")) == descriptors


def test_close_is_never_overslept():
    for _ in range(30):
        speech = SpeechRecognition(settings())
        speech.start("abcde", 0.0)
        speech.close()
        assert not speech._thread.is_alive() and children(speech) == []


def test_a_hundred_turns_leave_nothing_behind(recognise):
    speech = recognise(speech_max_speakers=1)
    sound = read_speech([TEN_OF_CLUBS])[TEN_OF_CLUBS]

    def turn(number):
        voice = "turn{}".format(number)
        speech.start(voice, float(number))
        feed(speech, voice, sound, float(number))
        speech.end(voice)
        return results_until_final(speech)[-1].final

    turn(0)
    before = (threading.active_count(), len(os.listdir("/proc/self/fd")), children(speech))
    texts = [turn(number) for number in range(1, 101)]
    assert texts.count("ten of clubs") >= 98
    assert (threading.active_count(), len(os.listdir("/proc/self/fd")), children(speech)) == before
    assert speech._open == {} and speech._pool._utterances == {} and speech.status()[2]["speech_utterances"] == 101


def test_processes_stand_back_behind_others(recognise):
    speech = recognise(speech_nice=7)
    wait_for(is_ready(speech))
    assert os.getpriority(os.PRIO_PROCESS, children(speech)[0]) == os.getpriority(os.PRIO_PROCESS, 0) + 7


@pytest.mark.parametrize("stopped", [False, True])
def test_the_process_dies_with_its_owner(stopped):
    owner = subprocess.Popen([sys.executable, "-c", textwrap.dedent("""
        import sys, time
        from hri_pipeline.core.audio.parameters import SpeechSettings
        from hri_pipeline.core.asr.recognition import SpeechRecognition
        speech = SpeechRecognition(SpeechSettings(speech_grammar=sys.argv[1]))
        while not speech.status()[2]["speech_ready"]:
            time.sleep(0.01)
        print(speech._pool._processes[0].pid, flush=True)
        time.sleep(600.0)
        """), CARDS], stdout=subprocess.PIPE, env=dict(os.environ, PYTHONPATH=os.pathsep.join(sys.path)))
    try:
        child = int(owner.stdout.readline())
        if stopped:
            os.kill(child, signal.SIGSTOP)
        owner.kill()
        owner.wait()
        wait_for(lambda: not running(child))
    finally:
        owner.kill()
        owner.wait()
        owner.stdout.close()


def running(pid):
    try:
        with open("/proc/{}/stat".format(pid), "rb") as file:
            return file.read().rsplit(b")", 1)[1].split()[0] not in (b"Z", b"X")
    except (OSError, IndexError):
        return False
