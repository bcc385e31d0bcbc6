#!/bin/sh
# playground.sh [BUILD] - BUILD/playground/index.html trains a survey in headless Chromium: scene.ply has the bytes of the native build
# with OXL_ISA=base. Prints both times. Skipped without chromium or python3.
set -eu
build=$(realpath "${1:-build}")
here=$(realpath "$(dirname "$0")")
for name in chromium chromium-browser google-chrome; do command -v "$name" >/dev/null && break; done
command -v "$name" >/dev/null && command -v python3 >/dev/null || { echo 'skipped: no chromium or no python3'; exit 0; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cp "$build/playground/index.html" "$folder"
"$build/oceanxl" synth -o "$folder/survey" --views 12 --size 96x64 --points 800 --quiet >/dev/null
(cd "$folder/survey" && find images sparse -type f >files.txt)
OXL_ISA=base "$build/oceanxl" train "$folder/survey" -o "$folder/native" --preset draft --iterations 300 --threads 1 --quiet >/dev/null
OXL_ISA=base python3 "$here/playground.py" "$name" "$folder"
