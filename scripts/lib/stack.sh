# shellcheck shell=bash disable=SC2034,SC2153
# Running the stack: display, roslaunch, table of persons, screenshot.

R4H_VIEW=         # screen, hidden (Xvfb) or none
R4H_VIEW_TEXT=
R4H_SCREENSHOT=
R4H_STACK=        # process id of roslaunch

in_background() { # in_background LOG_NAME COMMAND...: in a session of its own; sets R4H_STARTED
    local log=$R4H_LOGS/$1.log
    shift
    "$R4H_SYSTEM_PYTHON" "$R4H_LIB/processes.py" detach "$@" >"$log" 2>&1 </dev/null &
    R4H_STARTED=$!
    # bash would tell, with a line of this file, of each that does not end by itself.
    disown "$R4H_STARTED"
}

wait_for() { # wait_for SECONDS COMMAND...
    local i
    for ((i = 0; i < $1 * 10; i++)); do
        "${@:2}" && return 0
        sleep 0.1
    done
    return 1
}

choose_sound() { # choose_sound SOUND: sets sound_arguments, arguments of demo.launch
    sound_arguments=()
    case $1 in
    '' | none) ;;
    speech)
        local cards=/usr/share/pocketsphinx/test/data/cards
        [ -d "$cards" ] || fail 1 "The package pocketsphinx-testdata holds no $cards." "Give sound of your own with --sound, or --sound none."
        sound_arguments=("sound:=$cards" "speech_grammar:=$cards/cards.gram")
        ;;
    *) sound_arguments=("sound:=$1") ;;
    esac
}

find_vtest() { # the path of vtest.avi; unpacked into the cache if the package holds it packed
    local path
    path=$(dpkg -L opencv-doc | grep -E '/vtest\.avi(\.gz)?$' | head -n 1) || true
    [ -n "$path" ] || fail 1 "The package opencv-doc holds no vtest.avi." "Give a video of your own with --source."
    case $path in
    *.gz)
        gzip -dc "$path" >"$R4H_CACHE/vtest.avi.part" && mv "$R4H_CACHE/vtest.avi.part" "$R4H_CACHE/vtest.avi"
        path=$R4H_CACHE/vtest.avi
        ;;
    esac
    printf '%s' "$path"
}

choose_view() { # choose_view RVIZ(yes|no) SCREENSHOT_FILE
    if [ "$1" = no ]; then
        R4H_VIEW=none R4H_VIEW_TEXT='none'
    elif [ -n "$2" ]; then
        R4H_VIEW=hidden R4H_SCREENSHOT=$2 R4H_VIEW_TEXT="rviz off screen, screenshot in $2"
    elif [ -n "${DISPLAY:-}" ] && "$R4H_SYSTEM_PYTHON" "$R4H_LIB/processes.py" display-answers "$DISPLAY"; then
        R4H_VIEW=screen R4H_VIEW_TEXT="rviz on display $DISPLAY"
    else
        R4H_VIEW=hidden R4H_SCREENSHOT=$R4H_CACHE/demo.png
        R4H_VIEW_TEXT="no display${DISPLAY:+ (nothing answers at $DISPLAY)}: rviz off screen, screenshot in $R4H_SCREENSHOT"
    fi
}

start_view() {
    [ "$R4H_VIEW" = hidden ] || return 0
    local number=$R4H_TMP/display
    mkdir -p "$R4H_TMP/fb" "$R4H_TMP/runtime"
    chmod 700 "$R4H_TMP/runtime"
    # shellcheck disable=SC2016
    in_background xvfb sh -c 'exec Xvfb -displayfd 3 -screen 0 1280x800x24 -fbdir "$1" -nolisten tcp 3>"$2"' sh "$R4H_TMP/fb" "$number"
    wait_for 20 test -s "$number" || { show_tail xvfb; fail 1 "Xvfb did not start." "Whole log: $R4H_LOGS/xvfb.log"; }
    export DISPLAY LIBGL_ALWAYS_SOFTWARE=1 XDG_RUNTIME_DIR=$R4H_TMP/runtime
    DISPLAY=:$(tr -d ' \n' <"$number")
    unset WAYLAND_DISPLAY QT_QPA_PLATFORM XAUTHORITY
}

choose_pace() { # choose_pace SOURCE PEOPLE ARG:=VALUE...: sets pace_arguments, for rviz that draws without a graphics card beside the stack
    local given=" ${*:3}"
    pace_arguments=()
    [ "$R4H_VIEW" = hidden ] || return 0
    sed 's/Frame Rate: .*/Frame Rate: 4/' "$R4H_ROOT/launch/ros4hri.rviz" >"$R4H_TMP/hidden.rviz"
    [[ $given == *' rviz_config:='* ]] || pace_arguments+=("rviz_config:=$R4H_TMP/hidden.rviz")
    # Pictures that stand still for longer can be shown in fewer images; a video has a speed of its own.
    [ -d "$1" ] || return 0
    [[ $given == *' rate:='* ]] || pace_arguments+=("rate:=10.0")
    # Who waits for many people waits for their picture.
    [[ $given == *' seconds_per_picture:='* ]] || (($2 > 3)) || pace_arguments+=("seconds_per_picture:=13.0")
}

show_reasons() { # show_reasons LOG_NAME: what nodes gave as the reason; it stands above what roslaunch prints at the end
    grep -aE '\[(FATAL|ERROR)\]' "$R4H_LOGS/$1.log" | head -n 5 | cut -c1-400 | sed 's/^/      | /' >&2 || true
}
show_tail() { tail -n 25 "$R4H_LOGS/$1.log" | sed 's/^/      | /' >&2; }

start_stack() {
    in_background roslaunch roslaunch -p "$R4H_PORT" ros4hri demo.launch "$@"
    R4H_STACK=$R4H_STARTED
}

watch_people() { # watch_people SECONDS PEOPLE: in the background; leaves $R4H_TMP/people as a sign, and the screenshot in its place
    local log=$R4H_LOGS/view.log
    local -a look=(--viewer '')
    # The picture is taken and judged before everything is ended.
    [ "$R4H_VIEW" != hidden ] || look=(--viewer /rviz --framebuffer "$R4H_TMP/fb/Xvfb_screen0" --picture "$R4H_TMP/shot.png")
    python3 "$R4H_LIB/wait_for_view.py" --seconds "$(($1 > 9 ? $1 - 4 : $1))" --people "$2" "${look[@]}" >"$log" 2>&1 || return 0
    [ "$R4H_VIEW" != hidden ] || mv -f "$R4H_TMP/shot.png" "$R4H_SCREENSHOT"
    touch "$R4H_TMP/people"
}

tell_page() { # where the web page is, with its token, once the node has said so
    local _
    for _ in $(seq 60); do
        if grep -q 'the page is at http:' "$R4H_LOGS/roslaunch.log" 2>/dev/null; then
            sleep 0.5 || return 0       # the line with the token comes next; or everything ends
            note "web page: $(grep -oE '(page is at|token:) http:[^ ]*' "$R4H_LOGS/roslaunch.log" | tail -n 1 | sed 's/.* //')"
            return 0
        fi
        sleep 0.5 || return 0
    done
}

show_table() { # show_table SECONDS PEOPLE: the live table until the end; the exit code of the run
    local code=0 limit=${1:-} table
    watch_people "${limit:-86400}" "$2" &
    tell_page &
    rosrun hri_person_manager show_persons ${limit:+--duration "$limit"} </dev/null &
    table=$!
    R4H_CHILD=$table        # ends first, so that nothing is drawn while the nodes end
    while kill -0 "$table" 2>/dev/null; do
        if ! kill -0 "$R4H_STACK" 2>/dev/null; then
            show_reasons roslaunch
            [ -n "$(show_reasons roslaunch 2>&1)" ] || show_tail roslaunch
            fail 1 "The stack has ended by itself." "Whole log: $R4H_LOGS/roslaunch.log"
        fi
        sleep 0.2
    done
    wait "$table" || code=$?
    R4H_CHILD=
    if ((code != 0)) || { [ "$R4H_VIEW" != hidden ] && (($2 > 1)) && [ ! -e "$R4H_TMP/people" ]; }; then
        show_reasons roslaunch
        show_tail roslaunch
        fail 1 "Fewer than $2 person(s) were seen (exit code $code of the table)." \
            "Is somebody in the picture? Log of the nodes: $R4H_LOGS/roslaunch.log"
    fi
    if [ "$R4H_VIEW" = hidden ] && [ ! -e "$R4H_TMP/people" ]; then
        show_tail view
        fail 1 "rviz did not show $2 person(s) at the same time within the time given." \
            "Give it longer with --seconds, or leave it out with --no-rviz. Log: $R4H_LOGS/roslaunch.log"
    fi
    echo
    [ "$R4H_VIEW" != hidden ] || note "screenshot: $R4H_SCREENSHOT ($(tail -n 1 "$R4H_LOGS/view.log"))"
    step_done "people were seen; logs: $R4H_LOGS"
}
