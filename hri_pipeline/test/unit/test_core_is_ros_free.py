"""No module of a core imports ROS: rospy, tf, messages; and packages depend on hri_pipeline alone, which depends on
none of them."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ("hri_pipeline", "hri_fullbody", "hri_person_manager")
ROS = re.compile(
    r"^(ros.*|tf.*|genpy|genmsg|message_filters|actionlib|dynamic_reconfigure|.*_msgs|cv_bridge|catkin.*)$"
)


def imported(tree):
    """Names of modules in import statements, wherever they stand."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            yield node.module


def modules():
    for package in PACKAGES:
        folder = ROOT / package / "src" / package / "core"
        if folder.is_dir():
            for path in sorted(folder.rglob("*.py")):
                yield pytest.param(path, id="{}/{}".format(package, path.name))


@pytest.mark.parametrize("path", modules())
def test_imports(path):
    names = list(imported(ast.parse(path.read_text(encoding="utf-8"))))
    assert not [name for name in names if ROS.match(name.split(".")[0])]
    # The ROS side of our own packages is as far away as rospy.
    assert not [name for name in names if name.split(".")[0] in PACKAGES and name.split(".")[1:2] == ["ros"]]


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_depend_on_the_pipeline_alone(package):
    others = set(PACKAGES) - {package, "hri_pipeline"}
    wrong = ["{}: {}".format(path.name, name) for path in sorted((ROOT / package / "src").rglob("*.py"))
             for name in imported(ast.parse(path.read_text(encoding="utf-8"))) if name.split(".")[0] in others]
    assert wrong == []


def test_the_check_itself_sees_an_import():
    tree = ast.parse("import os\ndef f():\n    import rospy\n    from tf2_ros import Buffer\n    from hri_msgs.msg "
                     "import X")
    assert [name for name in imported(tree) if ROS.match(name.split(".")[0])] == ["rospy", "tf2_ros", "hri_msgs.msg"]


def test_there_is_a_core():
    assert len(list(modules())) >= 12
