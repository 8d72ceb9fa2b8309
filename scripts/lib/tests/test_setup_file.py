"""The file that opens the environment of the two commands."""

import subprocess
from pathlib import Path

LIB = Path(__file__).resolve().parent.parent


def test_the_setup_file_opens_the_environment_and_the_workspace_of_this_checkout(tmp_path):
    checkout, environment, workspace = (tmp_path / name for name in ("check out", "environ ment", "work'space"))
    for path, word in ((environment / "bin/activate", "ENVIRONMENT"), (workspace / "devel/setup.bash", "WORKSPACE")):
        path.parent.mkdir(parents=True)
        path.write_text("{}=open\n".format(word))
    checkout.mkdir()
    write = 'R4H_CACHE=/nowhere R4H_ROOT=$2; . "$1"; R4H_ROOT=$2 R4H_VENV=$3 R4H_WS=$4; write_setup_file'
    subprocess.run(["bash", "-euc", write, "bash", str(LIB / "setup.sh"), str(checkout), str(environment),
                    str(workspace)], check=True)
    done = subprocess.run(["bash", "-euc", '. .ws/setup.bash; echo "$ENVIRONMENT $WORKSPACE"'], cwd=str(checkout),
                          check=True,
                          stdout=subprocess.PIPE, universal_newlines=True)
    assert done.stdout == "open open\n"


def test_a_checkout_that_cannot_be_written_does_not_end_the_command(tmp_path):
    (tmp_path / ".ws").write_text("in the way")
    write = 'R4H_CACHE=/nowhere R4H_ROOT=$2; . "$1"; R4H_ROOT=$2 R4H_VENV=/a R4H_WS=/b; write_setup_file; echo on'
    done = subprocess.run(["bash", "-euc", write, "bash", str(LIB / "setup.sh"), str(tmp_path)], check=True,
                          stdout=subprocess.PIPE,
                          universal_newlines=True)
    assert done.stdout == "on\n"
