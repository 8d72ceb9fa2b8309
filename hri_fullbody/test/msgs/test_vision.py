"""What the node vision is made of. Needs the message packages, no master."""

from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path

from hri_fullbody.core.parameters import VISION
from hri_pipeline.core import process

NODE = Path(__file__).resolve().parents[2] / "nodes" / "vision"


def test_faces_and_bodies_that_take_turns_have_the_same_threads_for_all_of_the_share(monkeypatch):
    loader = SourceFileLoader("node_vision", str(NODE))
    node = module_from_spec(spec_from_loader(loader.name, loader))
    loader.exec_module(node)
    given = []
    monkeypatch.setattr(process.Cores, "count", 8.0)
    monkeypatch.setattr(node, "FaceProcessor", lambda settings, threads, person_detector: given.append(threads))
    monkeypatch.setattr(node, "BodyProcessor", lambda settings, listen_for_faces, threads: given.append(threads))
    for name in ("VisionWorker", "NodeDiagnostics", "CameraMounting", "image_input_of"):
        monkeypatch.setattr(node, name, lambda *arguments, **named: None)
    for wanted, count in ((0, 6), (2, 2)):
        node.build(VISION.resolve({"threads": wanted}))
        faces, bodies = given[-2:]
        assert faces is bodies and faces.count == count
        faces.close()
