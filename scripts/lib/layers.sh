# shellcheck shell=bash disable=SC2034,SC2153
# The layers of scripts/test. Each layer_NAME adds to R4H_PASSED, R4H_FAILED and R4H_SKIPPED; one that cannot run says why in R4H_REMARK.

R4H_PACKAGES=(hri_msgs hri_pipeline hri_fullbody hri_person_manager)
R4H_ROSTEST_LIMIT=300  # seconds for one .test file
R4H_ROSTEST_PLACES=$((2 * $(nproc)))  # light .test files at a time: they wait most of the time
R4H_ROSTEST_REPEATS=8  # a few files fail by chance; where more fail, none is run again
R4H_PYTEST_LIMIT=1800  # seconds for one run of pytest
R4H_NICE=()  # the command before pytest, while rostests run beside it
R4H_NO_PYTHON38="no Python 3.8 here (/usr/bin, /usr/local/bin, pyenv)"

run_layers() { # run_layers NAME...: those of pytest beside the rostests, which wait most of the time
    local layer
    local -a beside=()
    for layer in "$@"; do
        if [[ $layer == pytest* && " $* " == *" rostest "* ]]; then
            beside+=("$layer")
        elif [ "$layer" = rostest ] && ((${#beside[@]})); then
            run_beside "${beside[@]}"
        else
            run_layer "$layer"
        fi
    done
}

run_beside() { # run_beside LAYER...: the rostests, and beside them these; each is told as a whole, at its end
    local layer
    note "beside the rostests: $*"
    : >"$R4H_TMP/beside"
    {
        R4H_NICE=(nice -n 5)
        for layer in "$@"; do
            run_layer "$layer" >"$R4H_TMP/$layer.said" 2>&1
            grep -vE '^ +\.\.\. [0-9]+ s: ' "$R4H_TMP/$layer.said" || true
        done
    } &
    R4H_BESIDE=$!
    run_layer rostest
    end_beside
    for layer in "$@"; do
        grep -q "^$layer"$'\t' "$R4H_TABLE" || printf '%s\t0\t1\t0\t0\tended without a result\n' "$layer" >>"$R4H_TABLE"
    done
}

end_beside() { # waits until nothing runs beside the rostests any more; what failed there is repeated now, alone
    [ -n "$R4H_BESIDE" ] || return 0
    rm -f "$R4H_TMP/beside"
    wait "$R4H_BESIDE" || true
    R4H_BESIDE=
}

run_layer() {
    local began
    began=$(now)
    R4H_PASSED=0 R4H_FAILED=0 R4H_SKIPPED=0 R4H_REMARK=
    printf '\n--- %s\n' "$1"
    "layer_$1"
    printf '%s\t%d\t%d\t%d\t%s\t%s\n' "$1" "$R4H_PASSED" "$R4H_FAILED" "$R4H_SKIPPED" "$(seconds_since "$began")" "$R4H_REMARK" >>"$R4H_TABLE"
    if [ -n "$R4H_REMARK" ] && ((R4H_PASSED + R4H_FAILED == 0)); then
        note "$1: skipped: $R4H_REMARK"
    else
        note "$1: $R4H_PASSED passed, $R4H_FAILED failed, $R4H_SKIPPED skipped ($(seconds_since "$began") s)"
    fi
}

add_counts() { # add_counts "PASSED<tab>FAILED<tab>SKIPPED"
    local passed failed skipped
    IFS=$'\t' read -r passed failed skipped <<<"$1"
    R4H_PASSED=$((R4H_PASSED + passed)) R4H_FAILED=$((R4H_FAILED + failed)) R4H_SKIPPED=$((R4H_SKIPPED + skipped))
}

show_log() { # show_log NAME LINES
    tail -n "$2" "$R4H_LOGS/$1.log" | sed 's/^/      | /'
}

check() { # check TITLE COMMAND...: one check of a layer, passed when the exit code is 0
    local title=$1 log=check-${1//[^A-Za-z0-9]/_} began
    shift
    began=$(now)
    if run_logged "$log" "$@"; then
        R4H_PASSED=$((R4H_PASSED + 1))
        note "ok      $title ($(seconds_since "$began") s)"
    else
        R4H_FAILED=$((R4H_FAILED + 1))
        note "FAILED  $title ($(seconds_since "$began") s)"
        show_log "$log" 40
    fi
}

check_counting() { # the same, for a command whose log holds a line 'N passed, N failed'
    local title=$1 log=check-${1//[^A-Za-z0-9]/_} began code=0 counts passed failed
    shift
    began=$(now)
    run_logged "$log" "$@" || code=$?
    counts=$(sed -n 's/^\([0-9]*\) passed, \([0-9]*\) failed.*$/\1 \2/p' "$R4H_LOGS/$log.log" | tail -n 1)
    read -r passed failed <<<"${counts:-0 0}"
    ((code == 0 || failed > 0)) || failed=1
    R4H_PASSED=$((R4H_PASSED + passed)) R4H_FAILED=$((R4H_FAILED + failed))
    note "$( ((failed)) && echo FAILED || echo 'ok    ')  $title: $passed passed, $failed failed ($(seconds_since "$began") s)"
    ((failed == 0)) || show_log "$log" 60
}

find_python38() { # a 3.8 interpreter, with the lock in an environment of its own
    local candidate root
    root=${PYENV_ROOT:-${HOME:-/root}/.pyenv}
    for candidate in /usr/bin/python3.8 /usr/local/bin/python3.8 "$root"/versions/3.8*/bin/python3.8 "$(command -v python3.8 || true)"; do
        if [ -x "$candidate" ] && "$candidate" -c 'import sys, venv; sys.exit(sys.version_info[:2] != (3, 8))' 2>/dev/null; then
            readlink -f "$candidate"
            return 0
        fi
    done
    return 1
}

make_venv38() { # make_venv38 INTERPRETER DIRECTORY
    "$1" -m venv "$2" || return 1
    twice "$2/bin/pip" install 'pip>=20.3,<25.1' || return 1
    twice "$2/bin/pip" install --only-binary :all: -r "$R4H_ROOT/scripts/requirements-test.txt" -c "$R4H_ROOT/scripts/constraints.txt" || return 1
    touch "$2/.complete"
}

venv38() { # sets R4H_VENV38; false where there is no 3.8 or its environment cannot be made
    local interpreter
    R4H_VENV38=
    interpreter=$(find_python38) || return 1
    R4H_VENV38=$R4H_CACHE/venv-pure-3.8-$(lock_hash)
    take_setup_lock
    if [ ! -e "$R4H_VENV38/.complete" ]; then
        note "making an environment for $interpreter"
        rm -rf -- "$R4H_VENV38"
        run_or_fail venv38 "see that the Python package index can be reached." make_venv38 "$interpreter" "$R4H_VENV38"
    fi
    release_setup_lock
}

python_sources() { # NUL separated: every Python file of ours
    find scripts/lib scripts/benchmarks hri_* rosbag_tests -type f -name '*.py' -print0
    find hri_*/nodes rosbag_tests scripts -maxdepth 1 -type f ! -name '*.*' -print0 2>/dev/null |
        xargs -0 -r grep -lZE '^#!.*python3' || true
}

compile_sources() { # compile_sources INTERPRETER: syntax only, nothing is written
    python_sources | xargs -0 "$1" -c '
import sys
for name in sys.argv[1:]:
    with open(name, "rb") as source:
        compile(source.read(), name, "exec", dont_inherit=True)
print(len(sys.argv) - 1, "files")'
}

shell_syntax() {
    local file code=0
    for file in scripts/lib/*.sh .ci/run $(grep -lE '^#!.*bash' scripts/* 2>/dev/null); do
        bash -n "$file" || code=1
    done
    return "$code"
}

lint_catkin() {
    if [ -x scripts/catkin_lint ]; then scripts/catkin_lint; else
        catkin_lint -q -W1 --explain "${R4H_PACKAGES[@]}"
    fi
}

layer_static() {
    local interpreter
    check "ruff" ruff check --config scripts/ruff.toml --no-cache .
    check "mypy" mypy --config-file scripts/mypy.ini --cache-dir "$R4H_WS/mypy"
    check "syntax, $(python3 -c 'import sys; print("Python %d.%d" % sys.version_info[:2])')" compile_sources python3
    if interpreter=$(find_python38); then
        check "syntax, Python 3.8" compile_sources "$interpreter"
    else
        R4H_SKIPPED=$((R4H_SKIPPED + 1))
        note "skipped syntax, Python 3.8: $R4H_NO_PYTHON38"
    fi
    check "shell syntax" shell_syntax
    check "catkin_lint" lint_catkin
    check_counting "contents" python3 "$R4H_LIB/contents.py" "$R4H_ROOT"
}

existing_dirs() { # existing_dirs SUBDIRECTORY...: those of every package that hold tests
    local package name
    for package in "${R4H_PACKAGES[@]}"; do
        for name in "$@"; do
            compgen -G "$package/$name/test_*.py" >/dev/null && printf '%s\n' "$package/$name"
        done
    done
    return 0
}

pytest_here() { # pytest_here NAME INTERPRETER ARGUMENT...: one run, its results in NAME.xml
    local name=$1 interpreter=$2
    shift 2
    HYPOTHESIS_STORAGE_DIRECTORY=$R4H_CACHE/hypothesis PYTEST_DEBUG_TEMPROOT=$R4H_TMP \
        run_logged "$name" ${R4H_NICE[@]+"${R4H_NICE[@]}"} timeout -k 20 "$R4H_PYTEST_LIMIT" \
        "$interpreter" -m pytest -q -c scripts/pytest.ini --rootdir .. \
        "--junitxml=$R4H_LOGS/$name.xml" "$@"
}

run_pytest() { # run_pytest NAME INTERPRETER DIRECTORY...: what fails is run once more, in one process
    local name=$1 interpreter=$2 code=0 counts failed
    local -a files=("$R4H_LOGS/$1.xml") again=()
    shift 2
    if (($# == 0)); then
        note "no test found"
        return 0
    fi
    pytest_here "$name" "$interpreter" -n "$(nproc)" --dist worksteal --durations=5 "$@" || code=$?
    show_log "$name" "$( ((code == 0)) && echo 8 || echo 120)"
    if ((code == 1)); then
        mapfile -t again < <("$R4H_SYSTEM_PYTHON" "$R4H_LIB/results.py" failed "${files[0]}" "$R4H_ROOT/..")
    fi
    if ((${#again[@]})); then
        while [ -e "$R4H_TMP/beside" ]; do sleep 1; done
        note "once more what failed, one after the other"
        files+=("$R4H_LOGS/$name-again.xml")
        pytest_here "$name-again" "$interpreter" -p no:xdist "${again[@]}" || true
        show_log "$name-again" 40
    fi
    counts=$("$R4H_SYSTEM_PYTHON" "$R4H_LIB/results.py" pytest "${files[@]}" "$R4H_DATA_REQUIRED" 2>"$R4H_TMP/problems")
    add_counts "$counts"
    grep -vE $'^second\t' "$R4H_TMP/problems" | grep -E 'skipped' | cut -c1-200 | head -n 6 | sed 's/^/      /' || true
    sed -n $'s/^second\t//p' "$R4H_TMP/problems" | cut -c1-300 >>"$R4H_SECOND"
    # An interrupted or broken run without a failed case.
    IFS=$'\t' read -r _ failed _ <<<"$counts"
    if ((code != 0 && failed == 0)) && ! { ((code == 1)) && grep -qE $'^second\t' "$R4H_TMP/problems"; }; then
        note "pytest ended with exit code $code"
        R4H_FAILED=$((R4H_FAILED + 1))
    fi
}

layer_pytest() { # with R4H_QUICK=yes without models and without what is marked slow
    local -a arguments
    if [ "${R4H_QUICK:-no}" = yes ]; then
        mapfile -t arguments < <(existing_dirs test/unit test/msgs)
        arguments+=(-m "not slow")
    else
        mapfile -t arguments < <(existing_dirs test/unit test/models test/msgs)
    fi
    run_pytest pytest python3 "${arguments[@]}" scripts/lib/tests scripts/benchmarks/tests
}

layer_pytest38() {
    local -a dirs
    local package path=''
    if ! venv38; then
        R4H_REMARK=$R4H_NO_PYTHON38
        return 0
    fi
    # Networks give the same numbers under both; mypy and ruff read all sources as of 3.8.
    mapfile -t dirs < <(existing_dirs test/unit)
    dirs+=(-m "not slow" scripts/benchmarks/tests)
    for package in "${R4H_PACKAGES[@]}"; do path=${path:+$path:}$R4H_ROOT/$package/src; done
    # Without ROS: the pure layer must not need it.
    PYTHONPATH=$path run_pytest pytest38 "$R4H_VENV38/bin/python" ${dirs[@]+"${dirs[@]}"}
}

cpu_seconds() { # cpu_seconds FILE: user and system time of the children, of what the builtin `times` wrote
    awk 'NR == 2 { split($1, a, /[ms]/); split($2, b, /[ms]/); printf "%.0f", 60 * (a[1] + b[1]) + a[2] + b[2] }' "$1"
}

run_rostest() { # run_rostest FILE NAME: leaves its counts in $R4H_TMP/NAME.counts and what is to be said in $R4H_TMP/NAME.report
    local file=$1 name=$2 code=0 began counts
    began=$(now)
    mkdir -p "$R4H_LOGS/results/$name"
    ROS_TEST_RESULTS_DIR=$R4H_LOGS/results/$name ROS_LOG_DIR=$R4H_LOGS/results/$name/ros ROS4HRI_RUN_MARK=$R4H_MARK-$name \
        run_logged "$name" timeout -k 20 -s INT "$R4H_ROSTEST_LIMIT" rostest "$R4H_WS/src/ros4hri/$file" || code=$?
    times >"$R4H_TMP/$name.times"
    env -u ROS4HRI_RUN_MARK "$R4H_SYSTEM_PYTHON" "$R4H_LIB/processes.py" end "$R4H_MARK-$name" || true
    counts=$("$R4H_SYSTEM_PYTHON" "$R4H_LIB/results.py" rostest "$R4H_LOGS/results/$name" "$code" "$R4H_DATA_REQUIRED" 2>"$R4H_TMP/$name.problems")
    {
        if [[ $counts == *$'\t0\t'* ]]; then
            note "ok      $file: ${counts%%$'\t'*} passed ($(seconds_since "$began") s, $(cpu_seconds "$R4H_TMP/$name.times") s of CPU)"
            sed 's/^/              /' "$R4H_TMP/$name.problems"
        else
            note "FAILED  $file ($(seconds_since "$began") s)"
            sed 's/^/              /' "$R4H_TMP/$name.problems"
            show_log "$name" 60
        fi
    } >"$R4H_TMP/$name.report"
    printf '%s\n' "$counts" >"$R4H_TMP/$name.counts.new"
    mv "$R4H_TMP/$name.counts.new" "$R4H_TMP/$name.counts"
}

take_rostests() { # counts and reports of the files that have ended since the last call; those that failed go to R4H_AGAIN
    local file path passed failed skipped
    for file in ${R4H_RUNNING[@]+"${!R4H_RUNNING[@]}"}; do
        path=$R4H_TMP/rostest-${file//\//_}
        [ -e "$path.counts" ] || continue
        IFS=$'\t' read -r passed failed skipped <"$path.counts"
        cat "$path.report"
        rm -f "$path.counts"
        unset "R4H_RUNNING[$file]"
        if ((failed)); then
            R4H_AGAIN[$file]=$passed$'\t'$failed$'\t'$skipped
        else
            add_counts "$passed"$'\t0\t'"$skipped"
        fi
    done
}

places_of() { # places_of FILE: how many of the R4H_ROSTEST_PLACES it takes; the file itself says so in a comment, with the reason
    if grep -q '<!-- runs alone: ' "$1"; then
        echo "$R4H_ROSTEST_PLACES"
    elif grep -q '<!-- heavy: ' "$1"; then
        echo $(((R4H_ROSTEST_PLACES + 1) / 2))
    else
        echo 1
    fi
}

in_order() { # in_order FILE...: as they shall be started: heavy before light, those with a long limit first, those that run alone at the end
    local file places limit
    for file in "$@"; do
        places=$(places_of "$file")
        ((places < R4H_ROSTEST_PLACES)) || places=0
        limit=$(sed -n 's/.*time-limit="\([0-9]*\)".*/\1/p' "$file" | sort -rn | head -n 1)
        printf '%d\t%d\t%s\n' "$places" "${limit:-0}" "$file"
    done | LC_ALL=C sort -t $'\t' -k 1,1nr -k 2,2nr -k 3,3 | cut -f 3
}

wait_for_places() { # wait_for_places COUNT: until no more than so many are taken
    local file taken
    while true; do
        take_rostests
        taken=0
        for file in ${R4H_RUNNING[@]+"${!R4H_RUNNING[@]}"}; do taken=$((taken + R4H_RUNNING[$file])); done
        ((taken > $1)) || return 0
        wait -n || (($? != 127)) || break
    done
    take_rostests
    for file in ${R4H_RUNNING[@]+"${!R4H_RUNNING[@]}"}; do
        note "FAILED  $file ended without a result"
        R4H_AGAIN[$file]=$'0\t1\t0'
    done
    R4H_RUNNING=()
}

repeat_rostest() { # repeat_rostest FILE: once more, alone; this time counts
    local name=rostest-${1//\//_} counts
    note "once more, alone: $1"
    run_rostest "$1" "$name-again"
    counts=$(cat "$R4H_TMP/$name-again.counts")
    cat "$R4H_TMP/$name-again.report"
    add_counts "$counts"
    if [[ $counts == *$'\t0\t'* ]]; then
        printf '%s: %s\n' "$1" "$(grep -v ': skipped: ' "$R4H_TMP/$name.problems" | head -n 1)" >>"$R4H_SECOND"
    fi
}

run_rostests() { # run_rostests FILE...: side by side, each with a master of its own; what fails is run once more, alone, after all others
    local -a files
    local -A R4H_RUNNING=() R4H_AGAIN=()
    local file places
    mapfile -t files < <(in_order "$@")
    for file in "${files[@]}"; do
        places=$(places_of "$file")
        wait_for_places $((R4H_ROSTEST_PLACES - places))
        ((places < R4H_ROSTEST_PLACES)) || end_beside
        R4H_RUNNING[$file]=$places
        run_rostest "$file" "rostest-${file//\//_}" &
    done
    wait_for_places 0
    end_beside
    for file in ${R4H_AGAIN[@]+"${!R4H_AGAIN[@]}"}; do
        if ((${#R4H_AGAIN[@]} > R4H_ROSTEST_REPEATS)); then add_counts "${R4H_AGAIN[$file]}"; else repeat_rostest "$file"; fi
    done
}

build_test_programs() { # what only tests need; two at once in one checkout share a workspace
    local code=0
    take_setup_lock
    # roscpp may have been installed after the workspace was configured.
    catkin_make_here --force-cmake tests || code=$?
    release_setup_lock
    return "$code"
}

layer_rostest() {
    local -a files
    check "build of the tests' programs" build_test_programs
    mapfile -t files < <(find hri_*/test/ros rosbag_tests -name '*.test' | LC_ALL=C sort)
    run_rostests "${files[@]}"
}

layer_layout() {
    check_counting "scripts/check_layout" scripts/check_layout
}
