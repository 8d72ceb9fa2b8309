# shellcheck shell=bash disable=SC2034,SC2153
# Which system this is, and its packages.

R4H_PLATFORM=   # debian-12 or ubuntu-20.04
R4H_ROS_SETUP=  # file to source before catkin is there, empty on Debian

check_platform() {
    local id version
    [ -r /etc/os-release ] || fail 2 "This is not Debian 12 nor Ubuntu 20.04 (no /etc/os-release)."
    id=$(. /etc/os-release && printf '%s' "${ID:-}")
    version=$(. /etc/os-release && printf '%s' "${VERSION_ID:-}")
    R4H_PLATFORM=$id-$version
    case $R4H_PLATFORM in
    debian-12) ;;
    ubuntu-20.04) R4H_ROS_SETUP=/opt/ros/noetic/setup.bash ;;
    *) fail 2 "This system is '$(. /etc/os-release && printf '%s' "${PRETTY_NAME:-$id $version}")'." \
        "ROS 1 packages exist for Debian 12 (Debian's own) and for Ubuntu 20.04 (ROS Noetic); use one of them, for example in a container." ;;
    esac
    case $(uname -m) in
    x86_64 | aarch64) ;;
    *) fail 2 "There is no onnxruntime for the processor type '$(uname -m)'; x86_64 and aarch64 work." ;;
    esac
    case $R4H_ROOT in
    *[[:space:]:\;]*) fail 2 "The checkout lies in '$R4H_ROOT': catkin cannot build in a path with white space, ':' or ';'." "Move the checkout." ;;
    esac
    case $R4H_WS in
    *[[:space:]:\;]*) fail 2 "The workspace would lie in '$R4H_WS': catkin cannot build in a path with white space, ':' or ';'." "Set ROS4HRI_CACHE, or ROS4HRI_WORKSPACE, to another directory." ;;
    esac
    if [ "$R4H_PLATFORM" = ubuntu-20.04 ] && [ ! -e "$R4H_ROS_SETUP" ] &&
        ! apt-cache show ros-noetic-rospy >/dev/null 2>&1; then
        fail 2 "The ROS package source is not set up on this Ubuntu, so there is no ros-noetic-rospy to install." \
            "Follow sections 1.1 to 1.3 of the ROS Noetic installation page for Ubuntu (source list and key)," \
            "then: sudo apt-get update, and run $R4H_NAME again."
    fi
}

apt_packages() { # apt_packages PURPOSE...: the names, one per line
    local purpose
    for purpose in "$@"; do
        awk -v purpose="$purpose" '$1 == purpose { for (i = 2; i <= NF; i++) print $i }' "$R4H_LIB/apt-$R4H_PLATFORM.txt"
    done
}

missing_packages() { # missing_packages PURPOSE...
    local -a names
    mapfile -t names < <(apt_packages "$@")
    # dpkg-query fails when it does not know one of the names.
    { dpkg-query -W -f '${db:Status-Status} ${Package}\n' "${names[@]}" 2>/dev/null || true; } |
        awk '$1 == "installed" { print $2 }' | sort -u >"$R4H_TMP/installed"
    printf '%s\n' "${names[@]}" | sort -u | comm -23 - "$R4H_TMP/installed"
}

apt_install() { # apt_install PACKAGE...; runs in run_logged
    # Not in the child's own session: sudo may need the terminal it was asked on.
    local -a as_root=(env DEBIAN_FRONTEND=noninteractive)
    [ "$(id -u)" = 0 ] || as_root=(sudo -n "${as_root[@]}")
    twice "${as_root[@]}" apt-get update -q -o DPkg::Lock::Timeout=120 &&
        twice "${as_root[@]}" apt-get install -q -y --no-install-recommends -o DPkg::Lock::Timeout=300 "$@"
}

ensure_packages() { # ensure_packages PURPOSE...
    local -a missing
    step "System packages ($*)"
    mapfile -t missing < <(missing_packages "$@")
    if ((${#missing[@]} == 0)); then
        step_done "all there"
        return
    fi
    note "missing ${#missing[@]}: $(printf '%s ' "${missing[@]}" | fold -s -w 88 | sed '2,$s/^/               /')"
    if [ "$(id -u)" != 0 ]; then
        if ! command -v sudo >/dev/null || ! { sudo -n true 2>/dev/null || { [ -t 0 ] && sudo -v; }; }; then
            fail 2 "Packages are missing, and this is neither root nor a user who may use sudo. Have this run by an administrator:" \
                "  apt-get update && apt-get install --no-install-recommends ${missing[*]}"
        fi
    fi
    R4H_CHILD_PATIENT=yes
    run_or_fail apt "see that the network and the package sources work ('apt-get update'), that the disk is not full ('df -h'), then run $R4H_NAME again." \
        apt_install "${missing[@]}"
    R4H_CHILD_PATIENT=
    mapfile -t missing < <(missing_packages "$@")
    ((${#missing[@]} == 0)) || fail 1 "Still not installed: ${missing[*]}" "Whole log: $R4H_LOGS/apt.log"
    [ -x "$R4H_SYSTEM_PYTHON" ] || fail 1 "$R4H_SYSTEM_PYTHON is missing although the packages are installed." "Install python3-minimal."
    step_done "installed"
}
