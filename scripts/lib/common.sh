# shellcheck shell=bash disable=SC2034,SC2153
# Steps with progress, children that are ended for certain, one place for logs.
# Sourced by scripts/demo and scripts/test, which set R4H_NAME and R4H_STEPS first.

R4H_ROOT=$(cd -P "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd -P)
R4H_LIB=$R4H_ROOT/scripts/lib
absolute() { case $1 in /*) printf '%s' "$1" ;; *) printf '%s/%s' "$PWD" "$1" ;; esac; }
R4H_CACHE=$(absolute "${ROS4HRI_CACHE:-${HOME:-/root}/.cache/ros4hri}")
R4H_STEP=0
R4H_CHILD=            # process group id of the running child, empty between children
R4H_CHILD_PATIENT=    # "yes" while that child must be let end by itself (apt)
R4H_BESIDE=           # process id of what runs beside
R4H_TMP=
R4H_LOGS=
R4H_MARK=ros4hri-$$-${RANDOM}${RANDOM}
# Fixed over both supported systems; another interpreter may stand earlier on PATH.
R4H_SYSTEM_PYTHON=/usr/bin/python3

say() { printf '%s\n' "$*"; }
note() { printf '      %s\n' "$*"; }
fail() { # fail EXIT_CODE LINE...
    local code=$1 line
    shift
    printf '\n%s: cannot go on.\n' "$R4H_NAME" >&2
    for line in "$@"; do printf '  %s\n' "$line" >&2; done
    exit "$code"
}

step() { # step TITLE: begins a numbered step
    R4H_STEP=$((R4H_STEP + 1))
    R4H_STEP_BEGAN=$(now)
    printf '[%d/%d] %s\n' "$R4H_STEP" "$R4H_STEPS" "$1"
}
step_done() { note "$1 ($(seconds_since "$R4H_STEP_BEGAN") s)"; }

now() { date +%s.%N; }
seconds_since() { LC_ALL=C awk -v a="$1" -v b="$(now)" 'BEGIN { printf "%.1f", b - a }'; }

clean_environment() {
    # Nothing of another workspace, another Python or a user's site directory may leak in.
    local prefix kept='' entry name
    local -a entries
    IFS=: read -r -a entries <<<"${LD_LIBRARY_PATH:-}"
    for entry in ${entries[@]+"${entries[@]}"}; do
        [ -n "$entry" ] || continue
        for prefix in ${CMAKE_PREFIX_PATH:+${CMAKE_PREFIX_PATH//:/ }} /opt/ros; do
            case $entry in "$prefix"/*) continue 2 ;; esac
        done
        kept=${kept:+$kept:}$entry
    done
    if [ -n "$kept" ]; then export LD_LIBRARY_PATH=$kept; else unset LD_LIBRARY_PATH; fi
    while IFS='=' read -r name _; do
        case $name in
        ROS4HRI_*) ;;
        ROS_* | ROSLISP_* | CATKIN_* | _CATKIN_* | AMENT_* | COLCON_*) unset "$name" ;;
        esac
    done < <(env)
    unset PYTHONPATH PYTHONHOME PYTHONSTARTUP PYTHONOPTIMIZE PYTHONWARNINGS PYTHONINSPECT PYTHONSAFEPATH
    unset VIRTUAL_ENV CMAKE_PREFIX_PATH PKG_CONFIG_PATH
    unset PIP_USER PIP_TARGET PIP_PREFIX PIP_REQUIRE_VIRTUALENV PIP_CONSTRAINT PYTEST_ADDOPTS
    # Who wants no __pycache__ in the tree has it in our cache: nodes and tests would be compiled at each start.
    if [ -n "${PYTHONDONTWRITEBYTECODE:-}" ]; then
        unset PYTHONDONTWRITEBYTECODE
        export PYTHONPYCACHEPREFIX=$R4H_CACHE/pycache
    fi
    export PYTHONNOUSERSITE=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_INPUT=1 PIP_PROGRESS_BAR=off
    export PATH="/usr/sbin:/usr/bin:/sbin:/bin:$PATH"
    case ${TMPDIR:-/tmp} in *[[:space:]]*) export TMPDIR=/tmp ;; esac
    # Everything started from here on carries this mark, so that it can be found and ended.
    export ROS4HRI_RUN_MARK=$R4H_MARK
}

open_logs() {
    local old
    if ! mkdir -p "$R4H_CACHE/logs" 2>/dev/null || [ ! -w "$R4H_CACHE/logs" ]; then
        fail 2 "The cache directory $R4H_CACHE cannot be written." "Set ROS4HRI_CACHE to a directory of yours."
    fi
    R4H_LOGS=$R4H_CACHE/logs/$(date +%Y%m%d-%H%M%S)-${R4H_NAME##*/}-$$
    mkdir -p -m 700 "$R4H_LOGS"     # the output of nodes may hold the token of the web page
    R4H_TMP=$(mktemp -d)
    # Only the ten newest logs are kept, and those of who still runs; their names end with the process id.
    while IFS= read -r old; do
        [ -d "/proc/${old##*-}" ] || rm -rf -- "${R4H_CACHE:?}/logs/$old"
    done < <(LC_ALL=C command ls -1 "$R4H_CACHE/logs" | sort -r | tail -n +11)
}

end_child() {
    [ -n "$R4H_CHILD" ] || return 0
    if [ -n "$R4H_CHILD_PATIENT" ]; then
        note "waiting for the package installation to end cleanly ..."
        while kill -0 "$R4H_CHILD" 2>/dev/null; do sleep 0.5; done
    else
        # A shell function of ours would go on with its next command otherwise.
        kill -TERM "$R4H_CHILD" 2>/dev/null || true
    fi
    R4H_CHILD=
}

ignores_interrupts() { # ignores_interrupts PID: as all do that bash has started in the background, until they are what they shall be
    local ignored
    ignored=$(sed -n 's/^SigIgn:[[:space:]]*//p' "/proc/$1/status" 2>/dev/null) || return 1
    ((16#${ignored:-0} & 2))
}

end_stack() { # roslaunch first: it ends the master and the screen's nodes after those that still speak to them
    [ -n "${R4H_STACK:-}" ] || return 0
    note "ending the nodes ..."
    for _ in {1..50}; do
        ignores_interrupts "$R4H_STACK" || break
        sleep 0.1
    done
    kill -INT "$R4H_STACK" 2>/dev/null || return 0
    for _ in {1..100}; do
        kill -0 "$R4H_STACK" 2>/dev/null || return 0
        sleep 0.2
    done
}

on_exit() {
    local code=$?
    trap - EXIT ERR
    trap '' INT TERM HUP PIPE
    set +e      # nothing can be written any more where the terminal was closed, and all is to end all the same
    end_child
    [ -z "$R4H_BESIDE" ] || kill -TERM "$R4H_BESIDE" 2>/dev/null || true
    end_stack
    if [ -x "$R4H_SYSTEM_PYTHON" ]; then
        # Without the mark, or the helper would end itself.
        env -u ROS4HRI_RUN_MARK "$R4H_SYSTEM_PYTHON" "$R4H_LIB/processes.py" end "$R4H_MARK" "$$" || true
    fi
    [ -n "$R4H_TMP" ] && rm -rf -- "$R4H_TMP"
    exit "$code"
}
install_traps() {
    set -E
    trap 'printf "%s: unexpected failure in %s, line %s: %s\n" "$R4H_NAME" "${BASH_SOURCE[0]}" "$LINENO" "$BASH_COMMAND" >&2' ERR
    trap on_exit EXIT
    trap 'exit 130' INT
    trap 'exit 143' TERM
    trap 'exit 129' HUP
}

last_words() { # last_words LOG: the last line of a log, short enough for one line on a terminal
    tail -n 1 "$1" 2>/dev/null | tail -c 400 | tr '\r\t' '  ' | LC_ALL=C tr -cd ' -~' | cut -c1-90 || true
}

run_logged() { # run_logged LOG_NAME COMMAND...: quiet child, a sign of life every 15 s; returns its exit code
    local log=$R4H_LOGS/$1.log code=0 waited=0
    shift
    printf '$ %s\n' "$*" >>"$log"
    "$@" >>"$log" 2>&1 </dev/null &
    R4H_CHILD=$!
    while kill -0 "$R4H_CHILD" 2>/dev/null; do
        if ((waited > 0 && waited % 75 == 0)); then
            note "... $((waited / 5)) s: $(last_words "$log")"
        fi
        waited=$((waited + 1))
        sleep 0.2
    done
    wait "$R4H_CHILD" || code=$?
    R4H_CHILD=
    return "$code"
}

run_or_fail() { # run_or_fail LOG_NAME MEND COMMAND...
    local name=$1 mend=$2 code=0
    shift 2
    run_logged "$name" "$@" || code=$?
    ((code == 0)) && return 0
    printf '      failed with exit code %d. The last lines:\n' "$code" >&2
    tail -n 25 "$R4H_LOGS/$name.log" | sed 's/^/      | /' >&2
    fail 1 "What to do: $mend" "Whole log: $R4H_LOGS/$name.log"
}

twice() { # twice COMMAND...: a network step gets a second chance
    "$@" && return 0
    echo "--- failed; once more in 5 s ---"
    sleep 5
    "$@"
}
