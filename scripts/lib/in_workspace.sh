#!/usr/bin/env bash
# Sets up what scripts/demo and scripts/test set up, then runs a command in the workspace's environment.
# Usage: in_workspace.sh NAME COMMAND...    All messages of the set-up go to standard error.
set -euo pipefail
# shellcheck disable=SC2034
R4H_NAME=$1
# shellcheck disable=SC2034
R4H_STEPS=4
shift
given=("${ROS_MASTER_URI:-}" "${ROS_IP:-}" "${ROS_HOSTNAME:-}")
lib=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
# shellcheck source-path=SCRIPTDIR source=common.sh
. "$lib/common.sh"
# shellcheck source-path=SCRIPTDIR source=platform.sh
. "$lib/platform.sh"
# shellcheck source-path=SCRIPTDIR source=setup.sh
. "$lib/setup.sh"
{
    install_traps
    clean_environment
    check_platform
    open_logs
    take_setup_lock
    ensure_packages build run
    ensure_venv
    ensure_models --models default,evaluation
    ensure_workspace
    release_setup_lock
    use_workspace
} 1>&2
if [ "$R4H_NAME" = docker ]; then
    use_given_master "${given[@]}"
    # The container ends with the command, and `docker stop` has to reach it, not this shell.
    rm -rf -- "$R4H_TMP"
    trap - INT TERM HUP
    exec "$@"
fi
"$@"
