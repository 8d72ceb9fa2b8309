import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from hri_fullbody.core.model.anthropometry import default_segments_file
from hri_fullbody.core.model.urdf import main

PACKAGE = Path(__file__).resolve().parents[2]


def test_it_writes_to_standard_output(capsys):
    assert main(["--height", "1.8", "--id", "x"]) == 0
    root = ElementTree.fromstring(capsys.readouterr().out)
    assert root.get("name") == "human_x" and root.find("link[@name='l_wrist_x']") is not None
    assert root.find("joint[@name='l_knee_x']/origin").get("xyz") == "0 0 -0.432"


def test_it_writes_to_a_file_and_takes_lengths_and_interface(tmp_path, capsys):
    path = tmp_path / "human.urdf"
    assert main(["--id", "x", "--interface", "rep155", "--length", "thigh=0.40", "--length", "forearm=0.25",
                 "--no-visuals", "--output", str(path)]) == 0
    root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    assert capsys.readouterr().out == ""
    assert root.find("joint[@name='l_y_hip_x']") is not None and not root.findall(".//visual")
    assert root.find("joint[@name='r_knee_x']/origin").get("xyz") == "0 0 -0.4"
    assert root.find("joint[@name='r_wrist_x']/origin").get("xyz") == "0 0 -0.25"


def test_a_table_of_ones_own(tmp_path, capsys):
    path = tmp_path / "mine.yaml"
    text = default_segments_file().read_text(encoding="utf-8")
    path.write_text(text.replace("{ratio: 0.241,", "{ratio: 0.3,"), encoding="utf-8")
    assert main(["--height", "1.0", "--id", "x", "--segments", str(path)]) == 0
    root = ElementTree.fromstring(capsys.readouterr().out)
    assert root.find("joint[@name='l_ankle_x']/origin").get("xyz") == "0 0 -0.3"


@pytest.mark.parametrize("arguments, message", [
    (["--id", "a;b"], "body id 'a;b' is not legal"),
    (["--id", "x", "--height", "17"], "stature is 17 m, legal: 0.4 to 2.6 m"),
    (["--id", "x", "--height", "nan"], "stature is nan m"),
    (["--id", "x", "--segments", "/nowhere.yaml"], "/nowhere.yaml cannot be read"),
    (["--id", "x", "--length", "thigh"], "--length thigh: expected SEGMENT=M"),
    (["--id", "x", "--length", "thigh=long"], "--length thigh=long: expected SEGMENT=M"),
    (["--id", "x", "--length", "tail=1"], "no segments tail"),
    (["--id", "x", "--output", "/nowhere/human.urdf"], "/nowhere/human.urdf"),
])
def test_what_is_wrong_is_one_line(arguments, message, capsys):
    assert main(arguments) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("make_human_urdf: ") and err.count("\n") == 1 and message in err


@pytest.mark.parametrize("arguments", [[], ["--id", "x", "--height", "tall"], ["--id", "x", "--interface", "rep120"]])
def test_a_wrong_option_gives_the_usage(arguments, capsys):
    with pytest.raises(SystemExit) as end:
        main(arguments)
    assert end.value.code == 2 and "usage: make_human_urdf" in capsys.readouterr().err


def test_the_script_itself():
    result = subprocess.run([sys.executable, str(PACKAGE / "nodes" / "make_human_urdf"), "--id", "x"],
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=30)
    assert result.returncode == 0, result.stderr
    ElementTree.fromstring(result.stdout)
