"""What is used must be declared in package.xml, and rosdep must know it; scripts/catkin_lint looks at our own."""

from __future__ import annotations

from pathlib import Path
from typing import List

import manifests
import pytest


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.fixture()
def root(tmp_path: Path) -> Path:
    """A repository with one nested package, and nothing wrong."""
    write(tmp_path / "package.xml",
          "<package><name>whole</name><exec_depend>rospy</exec_depend><exec_depend>python3-numpy</exec_depend>"
          "<exec_depend>rviz</exec_depend><test_depend>rostest</test_depend></package>")
    write(tmp_path / "part/package.xml",
          "<package><name>part</name><exec_depend>rospy</exec_depend><exec_depend>python3-numpy</exec_depend>"
          "<exec_depend>rviz</exec_depend><test_depend>rostest</test_depend></package>")
    write(tmp_path / "part/src/part/node.py", "import json\nimport rospy\nimport numpy.linalg\nimport "
                                              "onnxruntime\nfrom . import other\n")
    write(tmp_path / "part/nodes/node", "#!/usr/bin/env python3\nfrom part.node import main\n")
    write(tmp_path / "part/launch/look.launch", '<launch><!-- $(find nothing) --><node pkg="rviz" args="$(find '
                                                'part)/x.rviz"/></launch>')
    write(tmp_path / "part/test/node_test.py", "import stage\nimport rostest\nimport rospy\n")
    write(tmp_path / "part/test/stage.py", "import part\n")
    write(tmp_path / "scripts/requirements.txt", "onnxruntime ; python_version >= '3'\nnumpy\n")
    return tmp_path


def rewrite(path: Path, before: str, after: str) -> None:
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))


def test_nothing_is_wrong(root: Path) -> None:
    assert manifests.problems_of(root) == []


@pytest.mark.parametrize("name, before, after, told", [
    ("part/src/part/node.py", "import json", "import rosgraph", "part: rosgraph is used, but no depend or exec_depend"),
    ("part/src/part/node.py", "import json", "def late():\n    from cv2 import imread\n",
     "part: python3-opencv is used, but no depend or exec_depend"),
    ("part/src/part/node.py", "import json", "import rostest", "part: rostest is used, but no depend or exec_depend"),
    ("part/nodes/node", "part.node", "tf2_py", "part: tf2_py is used, but no depend or exec_depend"),
    ("part/launch/look.launch", 'pkg="rviz"', 'pkg="tf2_ros"', "part: tf2_ros is used, but no depend or exec_depend"),
    ("part/test/stage.py", "import part", "import genpy", "part: genpy is used, but no depend or exec_depend or "
                                                          "test_depend"),
    ("package.xml", "<exec_depend>rviz</exec_depend>", "", "whole: rviz of part is missing at run time"),
    ("package.xml", "<test_depend>rostest</test_depend>", "", "whole: rostest of part is missing for tests"),
    ("package.xml", "</package>", "<depend>python3-nobody</depend></package>", "whole: rosdep has no key "
                                                                               "python3-nobody; see rosdep_keys.txt")])
def test_what_is_wrong_is_told(root: Path, name: str, before: str, after: str, told: str) -> None:
    rewrite(root / name, before, after)
    problems: List[str] = manifests.problems_of(root)
    assert told in problems
