"""The file that opens the environment of the two commands."""

import os
import subprocess
from pathlib import Path

import pytest

LIB = Path(__file__).resolve().parent.parent


def test_the_setup_file_opens_the_environment_and_the_workspace_of_this_checkout(tmp_path):
    checkout, environment, workspace = (tmp_path / name for name in ("check out", "environ ment", "work'space"))
    for path, word in ((environment / "bin/activate", "ENVIRONMENT"), (workspace / "devel/setup.bash", "WORKSPACE")):
        path.parent.mkdir(parents=True)
        path.write_text("{}=open\n".format(word))
    checkout.mkdir()
    write = '. "${1%/*}/common.sh"; . "$1"; R4H_ROOT=$2 R4H_VENV=$3 R4H_WS=$4; write_setup_file'
    subprocess.run(["bash", "-euc", write, "bash", str(LIB / "setup.sh"), str(checkout), str(environment),
                    str(workspace)], check=True)
    done = subprocess.run(["bash", "-euc", '. .ws/setup.bash; echo "$ENVIRONMENT $WORKSPACE"'], cwd=str(checkout),
                          check=True,
                          stdout=subprocess.PIPE, universal_newlines=True)
    assert done.stdout == "open open\n"


def test_a_checkout_that_cannot_be_written_does_not_end_the_command(tmp_path):
    (tmp_path / ".ws").write_text("in the way")
    write = '. "${1%/*}/common.sh"; . "$1"; R4H_ROOT=$2 R4H_VENV=/a R4H_WS=/b; write_setup_file; echo on'
    done = subprocess.run(["bash", "-euc", write, "bash", str(LIB / "setup.sh"), str(tmp_path)], check=True,
                          stdout=subprocess.PIPE,
                          universal_newlines=True)
    assert done.stdout == "on\n"


def sourced(command, directory, **variables):
    """Run a command after the scripts' library, with these variables beside PATH."""
    files = "".join('. "{}"; '.format(LIB / name) for name in ("common.sh", "platform.sh", "setup.sh"))
    return subprocess.run(["bash", "-euc", "R4H_NAME=here; " + files + command], cwd=str(directory),
                          env={"PATH": os.environ["PATH"], **variables}, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT, universal_newlines=True)


def test_a_directory_that_is_given_without_its_beginning_is_the_one_below_here(tmp_path):
    done = sourced('cd /; echo "$R4H_CACHE $R4H_WS"', tmp_path, ROS4HRI_CACHE="cache", ROS4HRI_WORKSPACE="build/ws")
    assert done.stdout == "{0}/cache {0}/build/ws\n".format(tmp_path)


def test_a_workspace_that_catkin_cannot_build_is_refused_before_anything_is_made(tmp_path):
    done = sourced("check_platform", tmp_path, ROS4HRI_CACHE="a cache")
    assert done.returncode == 2 and "{}/a cache/workspace".format(tmp_path) in done.stdout
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("setting", [
    "PYTHONOPTIMIZE=2", "PYTHONWARNINGS=error", "PYTHONINSPECT=1", "PYTHONHOME=/other"])
def test_how_the_users_python_runs_is_not_how_the_commands_run_theirs(setting):
    """Tests without assertions pass, and rospy does not get by where warnings are errors."""
    script = '. "$0"; clean_environment; env'
    told = subprocess.run(["bash", "-euc", script, str(LIB / "common.sh")], check=True, stdout=subprocess.PIPE,
                          universal_newlines=True, env=dict([setting.split("=")], PATH=os.environ["PATH"])).stdout
    assert setting.split("=")[0] not in told
