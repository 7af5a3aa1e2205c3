#!/bin/sh
# Checks the worlds here: check.sh VENVS [DROPJ]
# VENVS/car-racing-v3 and so on are Python environments; a world that has none there is passed over.
set -eu
venvs=$(cd "$1" && pwd) dropj=$(command -v "${2:-dropj}") here=$(cd "$(dirname "$0")" && pwd)
case $dropj in /*) ;; *) dropj=$PWD/$dropj ;; esac
cd "$here"
before=$PATH
for world in car-racing-v3 racetrack-v0 safety-point-goal1 push-t; do
    if [ ! -d "$venvs/$world" ]; then
        echo "== $world: passed over, as there is no $venvs/$world"
        continue
    fi
    echo "== $world"
    PATH=$venvs/$world/bin:$before
    "$dropj" world check "$world/world.toml" --run 300
    python3 check.py "$world" --episodes "${EPISODES:-3}"
    if [ "$world" = car-racing-v3 ]; then
        (cd car-racing-v3 && PYTHONPATH=../../../python python3 compare.py "$dropj")
    fi
done
