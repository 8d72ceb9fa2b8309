"""What the node vision is made of. Needs the message packages, no master."""

from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import SimpleNamespace

from hri_fullbody.core.parameters import VISION
from hri_pipeline.core import process

NODE = Path(__file__).resolve().parents[2] / "nodes" / "vision"


def test_faces_and_bodies_take_turns_with_all_threads_of_the_share_and_have_one_person_detector(monkeypatch):
    loader = SourceFileLoader("node_vision", str(NODE))
    node = module_from_spec(spec_from_loader(loader.name, loader))
    loader.exec_module(node)
    given, detector = [], object()

    def faces(settings, threads, person_detector):
        given.append((threads, person_detector()))

    def bodies(settings, listen_for_faces, threads):
        given.append((threads, detector))
        return SimpleNamespace(person_detector=detector)
    monkeypatch.setattr(process.Cores, "count", 8.0)
    monkeypatch.setattr(node, "FaceProcessor", faces)
    monkeypatch.setattr(node, "BodyProcessor", bodies)
    for name in ("VisionWorker", "NodeDiagnostics", "CameraMounting", "image_input_of"):
        monkeypatch.setattr(node, name, lambda *arguments, **named: None)
    for wanted, count in ((0, 6), (2, 2)):
        node.build(VISION.resolve({"threads": wanted}))
        one, other = given[-2:]
        assert one == other and one[0].count == count
        one[0].close()
