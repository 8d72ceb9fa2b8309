"""Loading of models: missing, damaged, another model, providers that are not there."""


import threading

import numpy as np
import onnxruntime
import pytest

from hri_pipeline.core import onnx as onnx_models
from hri_pipeline.core.onnx import (
    BATCH_SIZES,
    ModelError,
    ModelLog,
    OnnxModel,
    choose_providers,
    missing_libraries,
    model_path,
    models_directory,
)
from hri_pipeline.core.process import Threads

onnx = pytest.importorskip("onnx")


@pytest.fixture
def doubler(tmp_path):
    """A model with y = x + x and z = x * x."""
    tensor = onnx.helper.make_tensor_value_info
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("Add", ["x", "x"], ["y"]), onnx.helper.make_node("Mul", ["x", "x"], ["z"])],
        "doubler", [tensor("x", onnx.TensorProto.FLOAT, ["n", 2])],
        [tensor(name, onnx.TensorProto.FLOAT, ["n", 2]) for name in "yz"])
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)])
    model.ir_version = 8
    path = tmp_path / "doubler.onnx"
    onnx.save(model, str(path))
    return path


def save_adder(path, shape):
    """Save a model with y = x + x; shape: of both."""
    tensor = onnx.helper.make_tensor_value_info
    graph = onnx.helper.make_graph([onnx.helper.make_node("Add", ["x", "x"], ["y"])], "adder", *(
        [tensor(name, onnx.TensorProto.FLOAT, shape)] for name in "xy"))
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 13)])
    model.ir_version = 8
    onnx.save(model, str(path))
    return path


def test_run(doubler):
    model = OnnxModel(doubler, inputs=["x"], outputs=["z"])
    feed = {"x": np.array([[3.0, 4.0]], np.float32)}
    np.testing.assert_array_equal(model.run(feed)["z"], [[9, 16]])
    assert list(model.run(feed)) == ["z"]
    assert (model.name, model.provider, model.input_names, model.output_names) == (
        "doubler", "cpu", ["x"], ["y", "z"])
    assert sorted(OnnxModel(doubler).run(feed)) == ["y", "z"]


def test_bad_input(doubler):
    with pytest.raises(ModelError, match=r"doubler.onnx refused input .*\(1, 3\)"):
        OnnxModel(doubler).run({"x": np.zeros((1, 3), np.float32)})
    with pytest.raises(ModelError, match="refused"):
        OnnxModel(doubler).run({"q": np.zeros((1, 2), np.float32)})


def test_missing_file(tmp_path):
    with pytest.raises(ModelError, match="none.onnx does not exist; .*rosrun hri_pipeline fetch_models"):
        OnnxModel(tmp_path / "none.onnx")


@pytest.mark.parametrize("content", [b"", b"hello" * 100, None])
def test_damaged_file(tmp_path, doubler, content):
    path = tmp_path / "bad.onnx"
    path.write_bytes(doubler.read_bytes()[:60] if content is None else content)
    with pytest.raises(ModelError, match="bad.onnx") as caught:
        OnnxModel(path, inputs=["x"])
    assert "rosrun hri_pipeline fetch_models" in str(caught.value) and "\n" not in str(caught.value)


def test_another_model(doubler):
    with pytest.raises(ModelError, match=r"doubler.onnx has no output scores \(it has y, z\)"):
        OnnxModel(doubler, outputs=["y", "scores"])
    with pytest.raises(ModelError, match="no input image"):
        OnnxModel(doubler, inputs=["image"])


def test_a_provider_that_is_not_there_is_told_once_and_skipped(doubler):
    absent = [name for name in ("cuda", "tensorrt", "openvino")
              if choose_providers([name], onnxruntime.get_available_providers())[1]]
    told = []
    model = OnnxModel(doubler, providers=absent + ["cpu"], notify=told.append)
    assert model.provider == "cpu"
    assert len(told) == (1 if absent else 0)
    assert all(name in told[0] for name in absent)
    OnnxModel(doubler, providers=absent)        # nobody listens


def test_order_of_providers():
    available = ["CUDAExecutionProvider", "CPUExecutionProvider"]
    assert choose_providers(["tensorrt", "cuda"], available) == (available, ["tensorrt"])
    assert choose_providers([], available) == (["CPUExecutionProvider"], [])
    assert choose_providers(["cuda", "cuda", "cpu"], available) == (available, [])
    with pytest.raises(ModelError, match="unknown execution provider 'gpu'; known: cpu, cuda, tensorrt, openvino"):
        choose_providers(["gpu"], available)


def test_models_directory(monkeypatch, tmp_path):
    monkeypatch.delenv("ROS4HRI_MODELS", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    assert models_directory() == tmp_path / ".cache" / "ros4hri" / "models"
    monkeypatch.setenv("ROS4HRI_MODELS", "~/models")
    assert models_directory() == tmp_path / "models"


def test_model_path(monkeypatch, tmp_path, doubler):
    monkeypatch.setenv("ROS4HRI_MODELS", str(tmp_path))
    assert model_path("", "doubler.onnx") == doubler
    assert model_path(str(doubler), "other.onnx") == doubler
    with pytest.raises(ModelError, match="other.onnx does not exist; .*fetch_models.*ROS4HRI_MODELS"):
        model_path("", "other.onnx")
    with pytest.raises(ModelError, match="/nowhere/x.onnx does not exist; correct the parameter"):
        model_path("/nowhere/x.onnx", "doubler.onnx")


class Sessions:
    """Makes sessions that run on the CPU and say that they run on `provider`, as onnxruntime falls back in silence.

    Those on a card raise what `fault` returns for a batch, if anything; asked for the CPU, they say so.
    """

    def __init__(self, provider):
        self._real, self.provider = onnxruntime.InferenceSession, provider
        self.asked, self.batches, self.made, self.fault = [], [], [], lambda size: None

    def __call__(self, path, options, providers):
        self.asked.append(providers)
        session = self._real(path, options, providers=["CPUExecutionProvider"])
        run = session.run
        used = self.provider if providers[0][0] != "CPUExecutionProvider" else "CPUExecutionProvider"

        def run_or_fail(wanted, feed):
            self.batches.append(len(feed["x"]))
            error = None if used == "CPUExecutionProvider" else self.fault(len(feed["x"]))
            if error is not None:
                raise error
            return run(wanted, feed)

        session.get_providers = lambda: list(dict.fromkeys([used, "CPUExecutionProvider"]))
        session.run = run_or_fail
        self.made.append(session)
        return session


@pytest.fixture
def machine(monkeypatch):
    """A machine whose onnxruntime lists CUDA; `machine(provider)` says on which its sessions run."""
    def make(provider):
        sessions = Sessions(provider)
        monkeypatch.setattr(onnx_models.onnxruntime, "get_available_providers",
                            lambda: ["CUDAExecutionProvider", "CPUExecutionProvider"])
        monkeypatch.setattr(onnx_models.onnxruntime, "InferenceSession", sessions)
        return sessions

    return make


def test_a_provider_that_does_not_load_is_named_with_what_is_missing(doubler, machine, monkeypatch):
    machine("CPUExecutionProvider")
    monkeypatch.setattr(onnx_models, "missing_libraries", lambda name: ["cuDNN (libcudnn.so.9)"])
    told = []
    log = ModelLog(told.append)
    assert OnnxModel(doubler, ["cuda", "cpu"], notify=log).provider == "cpu"
    OnnxModel(doubler, ["cuda", "cpu"], notify=log)
    assert told == ["execution provider cuda does not load here, the networks run on cpu: the loader does not find "
                    "cuDNN (libcudnn.so.9); see docs/gpu.md"]
    assert log.providers == {"doubler": "cpu"}
    assert log.values == {"networks": "cpu: doubler", "inferences_doubler": 0}


def test_a_gpu_gets_batches_of_a_few_sizes_that_were_warmed_up(doubler, machine):
    sessions = machine("CUDAExecutionProvider")
    log = ModelLog(lambda text: None)
    model = OnnxModel(doubler, ["cuda"], notify=log, threads=Threads(3))
    assert model.threads.count == 1, "its batches are not divided"
    assert model.provider == "cuda" and sorted(sessions.batches) == list(BATCH_SIZES)
    name, options = sessions.asked[0][0]
    assert name == "CUDAExecutionProvider"
    assert options["cudnn_conv_algo_search"] == "HEURISTIC" and options["use_tf32"] == "0"
    for count in (1, 2, 5, 12, 13, 30):
        x = np.arange(2 * count, dtype=np.float32).reshape(count, 2)
        del sessions.batches[:]
        found = model.run({"x": x})
        np.testing.assert_array_equal(found["y"], 2 * x)
        np.testing.assert_array_equal(found["z"], x * x)
        assert set(sessions.batches) <= set(BATCH_SIZES) and sum(sessions.batches) >= count
    assert log.inferences == {"doubler": 63}


@pytest.mark.parametrize(("cpu", "card", "few"), [
    (4.0, {3: 8.5, 6: 9.0}, 2), (9.0, {3: 8.5, 6: 9.1}, 0), (1.0, {3: 30.0, 6: 5.0}, 5), (1.0, {3: 30.0, 6: 60.0}, 6)])
def test_a_few_items_run_on_the_cpu_beside_a_gpu_while_that_is_as_fast(doubler, machine, monkeypatch, cpu, card, few):
    sessions = machine("CUDAExecutionProvider")
    monkeypatch.setattr(OnnxModel, "_seconds", lambda self, session, size: cpu if size == 1 else card[size])
    model = OnnxModel(doubler, ["cuda"], batch_sizes=(3, 6), few_on_cpu=True)
    assert [name for name, _ in sessions.asked[-1]] == ["CPUExecutionProvider"]
    assert (model._beside is None) == (few == 0), "nothing is held for nothing"
    for count in range(1, 8):
        del sessions.batches[:]
        x = np.ones((count, 2), np.float32)
        np.testing.assert_array_equal(model.run({"x": x})["y"], 2 * x)
        expected = [count] if count <= few else [3] if count <= 3 else [6] if count <= 6 else [6, 3]
        assert sessions.batches == expected
        assert model.together_on_card(count) == (min(count, 6) if count > few else 0)
    plain = machine("CPUExecutionProvider")
    assert not OnnxModel(doubler, ["cpu"], few_on_cpu=True).together_on_card(9)
    assert len(plain.asked) == 1


def test_a_gpu_has_a_session_for_each_shape_that_is_warmed_up(doubler, machine, monkeypatch):
    monkeypatch.setattr(OnnxModel, "_takes_batches", lambda self: False)
    sessions, told = machine("CUDAExecutionProvider"), []
    model = OnnxModel(doubler, ["cuda"], notify=told.append, shapes=[(1, 2), (2, 2)])
    assert sessions.batches == [1, 2] and len(sessions.asked) == 2
    for count in (1, 2, 1, 3, 2, 3):
        x = np.ones((count, 2), np.float32)
        np.testing.assert_array_equal(model.run({"x": x})["y"], 2 * x)
    assert sessions.batches == [1, 2, 1, 2, 1, 3, 3, 2, 3] and len(sessions.asked) == 3
    assert told[-1] == "doubler.onnx: cuda prepares inputs of (3, 2)"
    for count in range(4, 20):      # a camera that changes its size for ever
        model.run({"x": np.ones((count, 2), np.float32)})
        model.run({"x": np.ones((2, 2), np.float32)})
    assert len(model._shaped) == 6
    assert told.count("doubler.onnx: cuda prepares inputs of (2, 2)") == 1, "what comes again and again stays"


def out_of_memory(size):
    return RuntimeError("Failed to allocate memory for requested buffer of size 123\nmore")


@pytest.mark.parametrize("batches", [True, False])
def test_a_gpu_that_cannot_be_prepared_is_told_and_the_model_runs_on_the_cpu(doubler, machine, monkeypatch, batches):
    """As where another process has taken the memory of the card."""
    sessions, told = machine("CUDAExecutionProvider"), []
    monkeypatch.setattr(OnnxModel, "_takes_batches", lambda self: batches)
    sessions.fault = lambda size: out_of_memory(size) if len(sessions.batches) > 1 else None
    threads = Threads(2)
    log = ModelLog(told.append)
    model = OnnxModel(doubler, ["cuda"], notify=log, threads=threads, shapes=[(1, 2), (2, 2)], few_on_cpu=True)
    assert (model.provider, model.on_card, model.threads, log.providers) == ("cpu", False, threads, {"doubler": "cpu"})
    assert told[-1] == ("doubler.onnx cannot be prepared on cuda (Failed to allocate memory for requested buffer of "
                        "size 123); it runs on the CPU from now on")
    for count in (1, 7):
        x = np.ones((count, 2), np.float32)
        np.testing.assert_array_equal(model.run({"x": x})["y"], 2 * x)
        assert sessions.batches[-1] == count, "as it comes"
    assert "cpu prepares" not in " ".join(told)
    threads.close()


@pytest.mark.parametrize("batches", [True, False])
@pytest.mark.parametrize("bad", [lambda size: True, lambda size: size == 12])
def test_a_gpu_that_fails_while_it_runs_is_given_up_for_the_cpu_without_losing_an_image(
        doubler, machine, monkeypatch, batches, bad):
    """A card that fell off the bus, was lost in a suspend, or has no memory left for one size of batches."""
    sessions, told = machine("CUDAExecutionProvider"), []
    monkeypatch.setattr(OnnxModel, "_takes_batches", lambda self: batches)
    threads, log = Threads(2), ModelLog(told.append)
    model = OnnxModel(doubler, ["cuda"], notify=log, threads=threads, shapes=[(3, 2)])
    x = np.arange(24, dtype=np.float32).reshape(12, 2)
    np.testing.assert_array_equal(model.run({"x": x[:3]})["y"], 2 * x[:3])
    assert model.provider == "cuda"
    del told[:]
    sessions.fault = lambda size: RuntimeError("CUDA failure 700: illegal access") if bad(size) else None
    for _ in range(3):
        np.testing.assert_array_equal(model.run({"x": x})["z"], x * x)
    assert [line for line in told if "prepares" not in line] == [
        "doubler.onnx: cuda has failed (CUDA failure 700: illegal access); it runs on the CPU from now on"]
    assert (model.provider, model.on_card, model.threads) == ("cpu", False, threads)
    assert log.summary == "cpu: doubler" and log.inferences == {"doubler": 39}
    del sessions.batches[:], told[:]
    prepared, found = model.run_items(list(x), lambda item, place: np.copyto(place, item), (2,))
    np.testing.assert_array_equal(found["y"], 2 * x)
    assert sessions.batches == [6, 6] and not told, "shared by the threads as on any CPU, and the card is left alone"
    threads.close()


def test_input_that_the_cpu_refuses_too_is_no_fault_of_the_gpu(doubler, machine):
    sessions, told = machine("CUDAExecutionProvider"), []
    model = OnnxModel(doubler, ["cuda"], notify=told.append)
    del told[:]
    for _ in range(2):
        with pytest.raises(ModelError, match=r"refused input .*\(1, 3\)"):
            model.run({"x": np.zeros((1, 3), np.float32)})
    assert model.provider == "cuda" and not told and len(sessions.asked) == len(BATCH_SIZES) + 1
    assert model.run({"x": np.ones((1, 2), np.float32)})["y"].tolist() == [[2.0, 2.0]]
    assert sessions.batches[-1] == BATCH_SIZES[0]


def test_several_threads_that_see_a_gpu_fail_all_get_their_results_and_it_is_told_once(doubler, machine):
    sessions, told, threads = machine("CUDAExecutionProvider"), [], Threads(4)
    model = OnnxModel(doubler, ["cuda"], notify=told.append)
    del told[:]
    all_here = threading.Barrier(4, timeout=20.0)

    def fault(size):
        all_here.wait()
        return out_of_memory(size)

    sessions.fault = fault
    x = np.arange(8, dtype=np.float32).reshape(4, 2)
    np.testing.assert_array_equal(threads.in_parts(lambda part: list(model.run({"x": part})["y"]), x), 2 * x)
    threads.close()
    assert len(told) == 1 and model.provider == "cpu"


def test_a_session_that_comes_on_the_cpu_in_silence_is_none_on_the_gpu(doubler, machine, monkeypatch):
    """onnxruntime makes one on the CPU where the card has no memory for another; batches were filled up for it."""
    sessions, told = machine("CUDAExecutionProvider"), []
    monkeypatch.setattr(OnnxModel, "_takes_batches", lambda self: False)
    model = OnnxModel(doubler, ["cuda"], notify=told.append, shapes=[(1, 2)])
    sessions.provider = "CPUExecutionProvider"
    assert model.run({"x": np.ones((5, 2), np.float32)})["y"].shape == (5, 2)
    assert model.provider == "cpu" and "cuda has failed (onnxruntime has made it on" in told[-1]
    # Nor does a session change its provider itself, which nobody would know of.
    assert not any(session._enable_fallback for session in sessions.made)


@pytest.mark.parametrize(("provider", "count", "batches"), [
    ("CUDAExecutionProvider", 1, [4]), ("CUDAExecutionProvider", 3, [4]), ("CPUExecutionProvider", 1, [4]),
    ("CPUExecutionProvider", 3, [2, 2])])
def test_threads_prepare_items_and_divide_the_batch_on_a_cpu_only(doubler, machine, provider, count, batches):
    sessions, threads = machine(provider), Threads(count)
    model = OnnxModel(doubler, ["cuda", "cpu"], threads=threads)
    del sessions.batches[:]

    def prepare(item, place):
        place[:] = item
        return -item

    prepared, found = model.run_items([3, 1, 4, 5], prepare, (2,))
    threads.close()
    assert prepared == [-3, -1, -4, -5] and sorted(sessions.batches) == sorted(batches)
    np.testing.assert_array_equal(found["y"], [[6, 6], [2, 2], [8, 8], [10, 10]])


@pytest.mark.parametrize(("count", "batches"), [(1, [1]), (2, [4]), (9, [12]), (12, [12]), (15, [12, 4])])
def test_items_are_written_into_a_batch_that_is_filled_up_for_a_gpu_and_not_copied(
        doubler, machine, monkeypatch, count, batches):
    sessions, log, fed = machine("CUDAExecutionProvider"), ModelLog(lambda text: None), []
    monkeypatch.setattr(OnnxModel, "_seconds", lambda self, session, size: 1.0)
    model = OnnxModel(doubler, ["cuda"], notify=log, few_on_cpu=True)
    del sessions.batches[:]
    for last in (count, count - 1, count) if count > 2 else (count,):
        del sessions.batches[:]
        prepared, found = model.run_items(range(last), lambda item, place: fed.append(place) or place.fill(item), (2,))
        assert len(prepared) == len(found["y"]) == last and found["y"][:, 0].tolist() == [2.0 * i for i in range(last)]
    assert sessions.batches == batches
    assert len({place.base.ctypes.data for place in fed}) == 1, "the same memory each time"
    assert log.inferences == {"doubler": sum((count, count - 1, count) if count > 2 else (count,))}


def test_items_of_a_model_with_free_lengths_have_the_shape_that_its_user_gives(tmp_path):
    path = save_adder(tmp_path / "free.onnx", ["n", "length"])
    model = OnnxModel(path)
    for length in (2, 3):
        found = model.run_items([1.0, 5.0], lambda item, place: place.fill(item), (length,))[1]
        np.testing.assert_array_equal(found["y"], [[2.0] * length, [10.0] * length])
    with pytest.raises(ModelError, match=r"refused input .*\(1, 3\)"):
        OnnxModel(save_adder(tmp_path / "fixed.onnx", ["n", 2])).run_items([1.0], lambda item, place: None, (3,))


@pytest.mark.parametrize("count", [1, 4])
def test_threads_that_run_items_of_one_model_at_once_have_memory_of_their_own(doubler, count):
    threads, wrong = Threads(count), []
    model = OnnxModel(doubler, threads=threads)

    def work(base):
        def prepare(item, place):
            place[0] = item
            if item % 50 == 49:
                raise ValueError("no face there")
            place[1] = item
            return item

        for begin in range(base, base + 300, 5):
            items = list(range(begin, begin + 1 + begin % 7))
            try:
                prepared, found = model.run_items(items, prepare, (2,))
            except ValueError:
                continue
            if prepared != items or found["y"].tolist() != [[2.0 * item] * 2 for item in items]:
                wrong.append(items)

    workers = [threading.Thread(target=work, args=(1000 * number,)) for number in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    threads.close()
    assert not wrong


@pytest.mark.parametrize(("provider", "batches"), [("CPUExecutionProvider", [2, 2, 1]),
                                                   ("CUDAExecutionProvider", [12])])
def test_a_cpu_works_on_a_few_at_once_where_more_gain_nothing(doubler, machine, provider, batches):
    sessions, log = machine(provider), ModelLog(lambda text: None)
    model = OnnxModel(doubler, ["cuda", "cpu"], notify=log, most_on_cpu=2)
    del sessions.batches[:]
    x = np.arange(10, dtype=np.float32).reshape(5, 2)
    found = model.run({"x": x}, ["z", "y"])
    assert sessions.batches == batches and log.inferences == {"doubler": 5}
    np.testing.assert_array_equal(found["y"], x + x)
    np.testing.assert_array_equal(found["z"], x * x)


def test_several_threads_run_one_model_and_each_item_is_counted(doubler):
    log, threads = ModelLog(lambda text: None), Threads(4)
    model = OnnxModel(doubler, outputs=["y"], notify=log, threads=threads)
    x = np.arange(200, dtype=np.float32).reshape(100, 2)
    for _ in range(50):
        found = model.threads.in_parts(lambda part: list(model.run({"x": part})["y"]), x)
        np.testing.assert_array_equal(found, 2 * x)
    assert log.inferences == {"doubler": 5000}
    with pytest.raises(ModelError, match="refused input"):
        model.threads.in_parts(lambda part: list(model.run({"x": part})["y"]), x[:, :1])
    threads.close()


def test_threads_may_be_those_of_one_inference_instead(doubler, monkeypatch):
    made = []
    real = onnxruntime.InferenceSession
    monkeypatch.setattr(onnx_models.onnxruntime, "InferenceSession",
                        lambda path, options, providers: made.append(options.intra_op_num_threads) or real(
                            path, options, providers=providers))
    for by_items, within in ((True, 1), (False, 3)):
        monkeypatch.setattr(Threads, "BY_ITEMS", by_items)
        threads = Threads(3)
        OnnxModel(doubler, threads=threads)
        assert made.pop() == threads.within == within
        threads.close()


def test_missing_libraries_are_those_that_the_loader_does_not_find():
    def load(name):
        if not name.startswith("libcudnn.so.8"):
            raise OSError(name)

    missing = missing_libraries("cuda", load)
    assert "the NVIDIA driver (libcuda.so.1)" in missing and not any("cuDNN" in text for text in missing)
    assert missing_libraries("cuda", lambda name: None) == [] and missing_libraries("cpu", load) == []
