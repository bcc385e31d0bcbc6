#!/bin/sh
# viewer.sh PROGRAM [FOLDER] - examples/viewer draws what the program draws: headless Chromium against `oceanxl render`, PSNR of each picture.
# Needs chromium (Debian's package) and python3, which serves the folder, talks to the browser and reads the PNG; FOLDER keeps the pictures.
set -eu
program=$(realpath "${1:-build/oceanxl}")
here=$(realpath "$(dirname "$0")")
folder=${2:-$(mktemp -d)}
[ -n "${2:-}" ] || trap 'rm -rf "$folder"' EXIT
mkdir -p "$folder"
cd "$folder"
"$program" synth -o survey --views 16 --size 192x128 --origin 1000,-500,20 --quiet >/dev/null
for lobes in off selective; do
    "$program" train survey -o "$lobes" --iterations 400 --dog $lobes --dog-threshold 50% --threads 1 --quiet >/dev/null
    "$program" render "$lobes/scene.ply" survey -o "$lobes/drawn" --quiet >/dev/null
done
cp "$here/../examples/viewer/index.html" .
python3 "$here/viewer.py" selective/scene.ply:selective/drawn off/scene.ply:off/drawn
