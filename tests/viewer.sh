#!/bin/sh
# viewer.sh PROGRAM [FOLDER] - examples/viewer renders as the program does, of .ply and .spz: headless Chromium against `oceanxl render`, PSNR
# of each image. It begins at a camera of the survey, and measures places as deep as `render --depth`.
# Needs chromium (Debian's package) and python3, which serves the folder, controls the browser and reads the PNG; FOLDER keeps the images.
set -eu
program=$(realpath "${1:-build/oceanxl}")
here=$(realpath "$(dirname "$0")")
folder=${2:-$(mktemp -d)}
[ -n "${2:-}" ] || trap 'rm -rf "$folder"' EXIT
mkdir -p "$folder"
cd "$folder"
"$program" synth -o survey --views 16 --size 192x128 --origin 1000,-500,20 --quiet >/dev/null
for lobes in off all; do
    "$program" train survey -o "$lobes" --iterations 400 --medium off --dog $lobes --threads 1 --quiet >/dev/null
    "$program" render "$lobes/scene.ply" survey -o "$lobes/drawn" --depth --quiet >/dev/null
done
"$program" convert off/scene.ply off/scene.spz --quiet >/dev/null
"$program" render off/scene.spz survey -o off/quantised --quiet >/dev/null
cp "$here/../examples/viewer/index.html" .
python3 "$here/viewer.py" all/scene.ply:all/drawn off/scene.spz:off/quantised off/scene.ply:off/drawn

# ?file= draws at once: under virtual time no worker answers, and a page that waits for one stays black.
python3 -u -m http.server --bind 127.0.0.1 0 >port.txt 2>/dev/null &
server=$! kept=${2:-}
trap 'kill "$server"; [ -n "$kept" ] || rm -rf "$folder"' EXIT
while ! grep -q port port.txt; do sleep 0.1; done
port=$(sed 's/.* port \([0-9]*\).*/\1/' port.txt)
for name in chromium chromium-browser google-chrome; do command -v "$name" >/dev/null && break; done
"$name" --headless --no-sandbox --use-angle=swiftshader --enable-unsafe-swiftshader --window-size=320,240 --virtual-time-budget=4000 \
    --screenshot=shot.png "http://127.0.0.1:$port/index.html?file=off/scene.ply" >/dev/null 2>&1
size=$(wc -c <shot.png)
[ "$size" -gt 30000 ] || { echo "viewer: ?file= is black (a PNG of $size bytes)"; exit 1; }
